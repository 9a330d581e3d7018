"""A killed training run goes on to the same bytes. `make resume` kills each model 20 times."""

from __future__ import annotations

from pathlib import Path

import pytest
from resume import Resume
from synthetic import write_dataset

from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import WEIGHTS
from aminn.model.config import TrainConfig
from aminn.training.train import train


def test_killed_at_random_steps(tmp_path: Path) -> None:
    resume = Resume(tmp_path, "aminn", seed=1)
    while resume.figures["kills"] < 3:
        resume.kill()
    assert resume.finish()["finished_runs"] >= 1


def test_a_run_that_was_cut_off_behind_its_checkpoint_is_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_dataset(tmp_path / "data", grasps=24, cases=4)
    data, out, whole = load_dataset(tmp_path / "data"), tmp_path / "run", tmp_path / "whole"
    train(TrainConfig(epochs=1), data, whole)
    with monkeypatch.context() as patched:
        patched.setattr("aminn.training.train.write_card", lambda checkpoint: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            train(TrainConfig(epochs=1), data, out)
    train(TrainConfig(epochs=1), data, out)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == {p.name: p.read_bytes() for p in whole.iterdir()}


def test_other_bytes_would_be_found(tmp_path: Path) -> None:
    resume = Resume(tmp_path, "mlp", seed=1)
    assert resume.start(resume.killed, None) == 0
    weights = bytearray((resume.killed / WEIGHTS).read_bytes())
    weights[-1] ^= 1
    (resume.killed / WEIGHTS).write_bytes(weights)
    with pytest.raises(AssertionError):
        resume.compare()
