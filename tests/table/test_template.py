"""`aminn hand columns`: a template of the table for one's own hand, which the import takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic import HANDS, write_dataset
from test_import import aminn

from aminn.data.dataset import load_dataset
from aminn_hand import Hand
from aminn_sim.open_hand import default_hand_file
from aminn_table import columns_of, read_table, template, write_table
from aminn_table.columns import LABELLED, RESULTS, SENSORS, Arrays


def header(text: str) -> list[str]:
    return text.splitlines()[-1].split(",")


@pytest.mark.parametrize("name", ["reference", "gripper 2x2", "5x5"])
def test_every_column_is_there_with_its_meaning(name: str) -> None:
    hand = HANDS[name]
    text = template(hand)
    own = [c for c in columns_of(hand) if c.array not in RESULTS and not (c.array in SENSORS and c.unit == "flag")]
    assert header(text) == [c.name for c in own]
    for column in own:
        (line,) = (line for line in text.splitlines() if line.startswith(f"# {column.name} ("))
        assert f"({column.unit}" in line and len(line.split("): ")[1]) > 10
    assert ("tendon_tension_" in text) == bool(hand.dims.tendons)


def test_a_template_is_filled_in(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """With what a lab has, the rest left empty."""
    write_table(tmp_path / "p.csv", lab_hand, pushes)
    lines = (tmp_path / "p.csv").read_text().splitlines()[1:]
    rows = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]
    rows = [row | {"friction_class": "mid"} for row in rows]
    text = template(lab_hand)
    filled = [",".join(row.get(name, "") for name in header(text)) for row in rows]
    (tmp_path / "own.csv").write_text(text + "\n".join(filled) + "\n")
    read = read_table(tmp_path / "own.csv", lab_hand, LABELLED)
    assert set(read) == {*pushes, "friction"}
    for name, values in pushes.items():
        np.testing.assert_array_equal(read[name], values, err_msg=name)
    write_dataset(tmp_path / "like", grasps=4, cases=2)
    aminn("import", tmp_path / "own.csv", "--like", tmp_path / "like", "--out", tmp_path / "data")
    assert (load_dataset(tmp_path / "data").samples["friction"][:, 0] == 1).all()


def test_the_command(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", grasps=4, cases=2)
    said = aminn("hand", "columns", tmp_path / "data").stdout
    assert said == template(load_dataset(tmp_path / "data").hand)
    said = aminn("hand", "columns", default_hand_file(), "--out", tmp_path / "own.csv").stdout
    assert said == f"columns: {tmp_path / 'own.csv'}\n"
    assert "tendon_tension_" in header((tmp_path / "own.csv").read_text())[-1]
    assert "is CSV" in aminn("hand", "columns", default_hand_file(), "--out", tmp_path / "own.h5", code=1).stderr
    said = aminn("hand", "columns", tmp_path / "data", "--out", tmp_path / "data" / "manifest.json", code=1).stderr
    assert "which this command needs itself" in said
    aminn("hand", "columns", tmp_path / "own.csv", code=1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "own.csv"]
