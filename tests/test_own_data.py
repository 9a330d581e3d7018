"""docs/own-data.md to the letter: its table of columns is the code's, its example runs, its map reads a bag."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

import pytest
from followed import ROOT, commands, files, make_place

from aminn_table.columns import markdown

pytestmark = pytest.mark.long

PAGE = (ROOT / "docs" / "own-data.md").read_text()
START, END = "<!-- table: columns -->\n", "\n<!-- end of table -->"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_place(tmp_path_factory.mktemp("own"), PAGE)


def test_the_columns_are_those_of_the_code() -> None:
    assert PAGE.split(START)[1].split(END)[0] == markdown()


def test_the_page_leads_from_a_table_to_a_verified_model(place: Path, people: dict[str, object]) -> None:
    lines = commands(PAGE)
    assert [Path(line.split()[0]).name + " " + line.split()[1] for line in lines[2:5]] == [
        "aminn simulate",
        "python build/own/lab.py",
        "aminn import",
    ]
    errors = []
    for line in lines:
        done = subprocess.run(shlex.split(line), cwd=place, capture_output=True, text=True)
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        if " import " in line:
            assert "no contact normals" in done.stdout and "180 pushes of 30 grasps" in done.stdout
            assert "known of the pushes: friction 100%, tool_weight 0%, tendon_tension 0%" in done.stdout
        if "--split all" in line:
            assert "no measured push is known to it" in done.stdout
            rows = [row.split() for row in done.stdout.splitlines() if row.startswith("aminn ")]
            errors.append(float(rows[0][7]))  # of the first table: the second says how sure the model is
    before, calibrated = errors
    assert calibrated < before
    people["snippets_in_own_data"] = len(lines) + len(files(PAGE))
