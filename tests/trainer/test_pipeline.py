"""Making again what an earlier version left, and the studies' tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aminn import study
from aminn.config import TrainConfig
from aminn.dataset import Dataset
from aminn.errors import AminnError
from aminn.metrics import COLUMNS
from aminn.pipeline import anew_if_outdated
from aminn.train import train


def test_outdated_folder_is_made_again(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = tmp_path / "run"
    train(TrainConfig(epochs=1, seed=1), dataset, folder)
    made = anew_if_outdated(folder, lambda: train(TrainConfig(epochs=1, seed=2), dataset, folder))
    assert made.meta["seed"] == 2
    assert "made again" in capsys.readouterr().out


def test_an_error_that_is_not_the_folder_s_fault_is_raised(tmp_path: Path) -> None:
    def fail() -> None:
        (tmp_path / "run").mkdir(exist_ok=True)
        raise AminnError("no data")

    with pytest.raises(AminnError, match="no data"):
        anew_if_outdated(tmp_path / "run", fail)
    with pytest.raises(AminnError, match="no data"):
        anew_if_outdated(tmp_path / "run", fail)


def test_variants_of_a_study_differ_and_share_the_rest() -> None:
    for variants in study.STUDIES.values():
        assert len(set(variants.values())) == len(variants)
        assert study.BASE in variants.values()


def test_study_gathers_mean_and_spread_over_runs() -> None:
    runs = [{"iid": {"aminn": {key: float(k) for key in COLUMNS}}} for k in (1, 3)]
    rows = study._gather(runs, "iid")
    assert all(rows["aminn"][key] == [1.0, 3.0] for key in COLUMNS)
    line = study._format(rows).splitlines()[-1]
    assert f"{np.mean([1, 3]):.3f} ± {np.std([1, 3], ddof=1):.3f}" in line
