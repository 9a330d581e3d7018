"""HTML pages: one file each, without scripts, readable on a phone. `page.html.j2` is their layout, `parts.html.j2` has
their tables and figures; a page's own template extends the one and imports the other."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

from .files import write_atomically
from .read import AnyPath

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 130
PANEL_IN = (4.0, 3.1)
"""Width and height of a panel, inches: wide enough that two stand side by side, and its text is read on a phone."""


@dataclass(frozen=True)
class Picture:
    """Figures under one heading; each is a picture of its own, so that a phone shows one below the other."""

    title: str
    caption: str
    panels: Sequence[str]
    """Data URIs, or names of files beside the page."""
    key: Sequence[tuple[str, str]] = ()
    """Names and their colours."""
    small: bool = False
    """Whether they are small, several in a row on a phone too."""


def data_uri(figure: Figure) -> str:
    """The figure as what an <img> takes. Equal figures give equal texts."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, facecolor="white", metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()


def picture(
    title: str, caption: str, figures: Sequence[Figure], key: Sequence[tuple[str, str]] = (), small: bool = False
) -> Picture:
    """The figures as a part of a page."""
    return Picture(title, caption, [data_uri(figure) for figure in figures], key, small)


def render(template: Path, **values: object) -> str:
    """The page that `template` makes of the values. Raises jinja2.UndefinedError for one that is missing."""
    folders = [template.parent, Path(__file__).parent]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(**values)


def write_page(template: Path, out_html: AnyPath, **values: object) -> None:
    """Fill in the template and write the page, whole or not at all."""
    write_atomically(Path(out_html), render(template, **values).encode())
