"""What every page and picture is held to without a browser; `make pages` looks at them in one."""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import pytest
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from aminn_base import page

VOID = {"meta", "img", "br", "hr", "link", "input"}
SLACK_PX = 1.5


class _Page(HTMLParser):
    """Collects what a phone could not show."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[dict[str, str]] = []
        self.faults: list[str] = []
        self.seen: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        own = {name: value or "" for name, value in attributes} | {"tag": tag}
        self.seen.append(tag + ("=viewport" if own.get("name") == "viewport" else ""))
        if tag == "table" and not any("box" in o.get("class", "").split() for o in self.open):
            self.faults.append("a table that does not scroll in a box of its own")
        if tag in ("img", "table", "div", "figure") and ("width" in own or "width:" in own.get("style", "")):
            self.faults.append(f"a {tag} of a fixed width")
        if tag == "img" and not own.get("alt"):
            self.faults.append("an image without a word on it")
        if tag not in VOID:
            self.open.append(own)

    def handle_endtag(self, tag: str) -> None:
        if self.open.pop()["tag"] != tag:
            self.faults.append(f"a {tag} that ends where it did not begin")


def faults(file: Path) -> list[str]:
    """What is wrong with a page."""
    text, read = file.read_text(), _Page()
    read.feed(text)
    read.close()
    found = read.faults + [f"{own['tag']} has no end" for own in read.open]
    found += [] if "meta=viewport" in read.seen else ["no viewport"]
    return found + (
        [] if "img { max-width: 100%" in text or "img" not in read.seen else ["images have no greatest width"]
    )


def _drawn_ticks(axis: Axis) -> Iterator[Text]:
    low, high = sorted(axis.get_view_interval())
    for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
        if low <= tick.get_loc() <= high:
            yield tick.label1


def _texts(figure: Figure) -> Iterator[Text]:
    yield from figure.texts
    for ax in figure.axes:
        yield from ax.texts
        flat = ax.name not in ("3d", "mollweide")
        for axis in (ax.xaxis, ax.yaxis):
            yield from (axis.label, axis.get_offset_text(), *(_drawn_ticks(axis) if flat and ax.axison else ()))
        yield from (ax.title, ax._left_title, ax._right_title)
        yield from ax.get_legend().get_texts() if ax.get_legend() else ()


def overlapping_labels(figure: Figure) -> list[str]:
    """Pairs of labels of a figure that lie on one another, and labels that leave it."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes: list[tuple[str, Bbox]] = []
    for text in _texts(figure):
        if text.get_visible() and text.get_text().strip():
            box = text.get_window_extent(canvas.get_renderer())
            boxes.append((text.get_text(), box.padded(-SLACK_PX)))
    whole = figure.bbox.padded(2 * SLACK_PX)
    found = [f"{a!r} on {b!r}" for (a, one), (b, other) in combinations(boxes, 2) if one.overlaps(other)]
    return found + [
        f"{name!r} outside" for name, box in boxes if not (whole.containsx(box.x0) and whole.containsx(box.x1))
    ]


def watch_labels(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """From here on, what overlaps in each figure that goes into a page."""
    found: list[str] = []
    original = page.data_uri

    def watched(figure: Figure) -> str:
        found.extend(overlapping_labels(figure))
        return original(figure)

    monkeypatch.setattr(page, "data_uri", watched)
    return found
