"""The layout of pages, and that what holds pages to it can fail."""

from __future__ import annotations

from pathlib import Path

import jinja2
import pytest
from matplotlib.figure import Figure
from page_checks import faults, overlapping_labels

from aminn_base.page import PANEL_IN, data_uri, picture, render, write_page

PAGE = """{% extends "page.html.j2" %}{% import "parts.html.j2" as parts %}
{% block body %}<h1>{{ title }}</h1>{{ parts.table(rows, ["name", ("force", "N")], ours="thumb") }}
{{ parts.facts(rows) }}{{ parts.pictures(shown) }}{% endblock %}"""


def panel(label: str = "force, N") -> Figure:
    figure = Figure(PANEL_IN, layout="constrained")
    figure.subplots().set_xlabel(label)
    return figure


def write(folder: Path, text: str = PAGE, **values: object) -> Path:
    (folder / "own.html.j2").write_text(text)
    shown = picture("Forces", "What it shows.", [panel()], [("thumb", "#123456")])
    write_page(folder / "own.html.j2", folder / "own.html", **{"rows": [("thumb", "3 < 4")], "shown": shown} | values)
    return folder / "own.html"


def test_a_page_has_tables_and_pictures_that_a_phone_can_show(tmp_path: Path) -> None:
    page = write(tmp_path, title="A & B")
    assert faults(page) == []
    text = page.read_text()
    assert "A &amp; B" in text and "3 &lt; 4" in text and "<small>N</small>" in text and "#123456" in text
    assert text.count('class="ours"') == 1
    assert data_uri(panel()) == data_uri(panel()) and data_uri(panel()) in text
    with pytest.raises(jinja2.UndefinedError):
        render(tmp_path / "own.html.j2", rows=[])


@pytest.mark.parametrize(
    ("bad", "fault"),
    [
        ("<table></table>", "a table that does not scroll"),
        ('<img alt="x" style="width: 900px">', "a img of a fixed width"),
        ('<img src="x">', "an image without a word on it"),
        ("<div><p></div></p>", "ends where it did not begin"),
    ],
)
def test_what_a_phone_cannot_show_is_found(bad: str, fault: str, tmp_path: Path) -> None:
    found = faults(write(tmp_path, PAGE.replace("<h1>", bad + "<h1>"), title=""))
    assert len(found) >= 1 and fault in found[0]


def test_labels_on_one_another_are_found() -> None:
    assert overlapping_labels(panel()) == []
    crowded = panel()
    crowded.axes[0].set_xticks([0, 0.01], ["zero point zero", "zero point one"])
    assert overlapping_labels(crowded) == ["'zero point zero' on 'zero point one'"]
    assert overlapping_labels(panel("far too long a label " * 8)) == ["'" + "far too long a label " * 8 + "' outside"]
