"""One table of tolerances: what C and the documentation say follows from it."""

from __future__ import annotations

from pathlib import Path

from aminn_export.judge.tolerances import TOLERANCES, generated

ROOT = Path(__file__).resolve().parents[2]


def test_header_and_document_follow_the_table() -> None:
    for file, text in generated(ROOT).items():
        assert file.read_text() == text, f"{file}: python -m aminn_export.judge.tolerances writes it anew"


def test_document_shows_every_limit() -> None:
    document = (ROOT / "docs" / "export.md").read_text()
    table = document.split("<!-- table: tolerances -->")[1].split("<!-- end of table -->")[0]
    for name, t in TOLERANCES.items():
        row = next(line for line in table.splitlines() if line.startswith(f"| `{name}` |"))
        for value in (t.floor, t.share, t.per_condition, t.per_m, t.median):
            assert not value or f"{value:g}".replace("e-0", "e-") in row
