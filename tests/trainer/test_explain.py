"""The explanation of a load case: numbers that belong together, a text, a picture."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aminn.checkpoint import Checkpoint
from aminn.cli import main
from aminn.dataset import Dataset
from aminn.dims import LENGTH_SCALE_M
from aminn.explain import as_text, draw, explain_sample
from aminn_base.errors import AminnError


def test_numbers_belong_together(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    s = np.repeat([1.0, 1.0 / LENGTH_SCALE_M], 3)
    compliances, directions = e.principal()
    whole = directions @ np.diag(compliances) @ directions.T  # of the scaled stiffness
    np.testing.assert_allclose(s * (whole @ (s * e.row("w_e"))), e.dx, rtol=1e-3)
    assert (np.diff(compliances) <= 0).all()
    assert e.flat()["thumb_proximal_stiffness_Nm_rad"] == e.stiffness[2, 1, 1]
    assert "thumb_roll_stiffness_Nm_rad" not in e.flat()


def test_text_names_every_finger_and_the_verdict(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    text = as_text(e)
    for word in ("finger1", "finger2", "thumb", "engaged", "mm/N", "holds" if e.p_stable >= e.tau else "gives way"):
        assert word in text
    samples = dataset.samples | {"contacts": np.where(np.arange(3)[:, None] == 2, 0, dataset.samples["contacts"])}
    assert "out of contact" in as_text(explain_sample(runs["aminn"], replace(dataset, samples=samples), 7))


def test_picture_is_written(runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    draw(e, tmp_path / "new" / "e.png")
    assert (tmp_path / "new" / "e.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(AminnError, match=r"written as \.png"):
        draw(e, tmp_path / "e.bmp")


def test_picture_into_a_fifo_and_through_a_link(
    runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path
) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    os.mkfifo(tmp_path / "fifo")
    with ThreadPoolExecutor(1) as pool:
        got = pool.submit((tmp_path / "fifo").read_bytes)
        draw(e, tmp_path / "fifo")
        assert got.result().startswith(b"\x89PNG") and (tmp_path / "fifo").is_fifo()
    (tmp_path / "e.svg").symlink_to("there.svg")
    draw(e, tmp_path / "e.svg")
    assert (tmp_path / "e.svg").is_symlink() and b"<svg" in (tmp_path / "there.svg").read_bytes()


def test_command(runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path) -> None:
    args = ["explain", "--data", str(data_dir), "--json", str(tmp_path / "e.json")]
    result = CliRunner().invoke(main, [*args, "--run", str(runs["aminn"].path), "--sample", "3"])
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "e.json").read_text())["sample"] == 3
    for run, sample, message in (("mlp", "3", "no mechanics to explain"), ("aminn", "99999", "load cases 0 to")):
        result = CliRunner().invoke(main, [*args, "--run", str(runs[run].path), "--sample", sample])
        assert result.exit_code == 1 and message in result.output and "Traceback" not in result.output
