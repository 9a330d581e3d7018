"""docs/python.md and the example notebook: what they show runs as it stands."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "python.md").read_text()
NOTEBOOK = ROOT / "examples" / "predict.ipynb"
sys.path.insert(0, str(ROOT / "tests" / "trainer"))


def run(code: str, folder: Path) -> str:
    """What a program prints, without windows."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the README's quick start leaves, of a made-up hand and without training."""
    from synthetic import write_dataset
    from untrained import untrained_run

    from aminn_export.export import export

    folder = tmp_path_factory.mktemp("page")
    write_dataset(folder / "build" / "data", grasps=40, cases=8)
    untrained_run(folder / "build" / "runs" / "aminn", folder / "build" / "data", sensors=True)
    export(folder / "build" / "runs" / "aminn", folder / "build" / "export", data_dir=folder / "build" / "data")
    return folder


def test_the_page_runs_as_it_stands(place: Path, people: dict[str, object]) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 7
    said = run("\n".join(blocks), place)
    assert "of 320 hold" in said and "'pred_dx_ht_x'" in said and "changes the motion by" in said
    assert "with friction and weight given" in said
    assert (place / "predictions.csv").read_text().count("\n") == 322
    people["snippets_in_python"] = len(blocks)


def test_the_pages_commands_are_commands(place: Path) -> None:
    lines = re.findall(r"^ {4}aminn (predict .*)$", PAGE, re.MULTILINE)
    assert len(lines) == 4
    from aminn_app.cli import main

    known = {option for p in main.commands["predict"].params for option in p.opts}
    for line in lines:
        assert set(re.findall(r"--\w+", line)) <= known


def test_the_notebook_runs(tmp_path: Path, people: dict[str, object]) -> None:
    """Cell by cell, as a notebook does, in the folder where it lies."""
    notebook = json.loads(NOTEBOOK.read_text())
    assert notebook["nbformat"] == 4 and notebook["metadata"]["kernelspec"]["language"] == "python"
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) >= 4
    for cell in cells:
        assert not cell["outputs"] and cell["execution_count"] is None, "outputs are not kept"
    sources = ["".join(cell["source"]) for cell in cells]
    show = f"""
import matplotlib, matplotlib.pyplot as pictures
matplotlib.use("agg")
pictures.show = lambda: pictures.savefig({str(tmp_path)!r} + f"/{{len(pictures.get_fignums())}}.png")
"""
    run(show + "\n".join(sources), NOTEBOOK.parent)
    pictures = sorted(tmp_path.glob("*.png"))
    assert len(pictures) == 2 and all(p.stat().st_size > 5000 for p in pictures)
    people["example_predict_ipynb"] = True
