"""Friction learned from the loads of a grasp: of a world that moves as the model does, and the study's report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from numpy.typing import NDArray
from synthetic import hand, write_dataset

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.sensors import Told, sensed
from aminn.data.slides import slid_cases
from aminn.model.checkpoint import Checkpoint, save_checkpoint
from aminn.model.config import ModelConfig
from aminn.model.network import Aminn
from aminn_app.friction_study import KNOWN, SERIES, TOLD, Learner, chosen, friction_figures, gain, main, series
from aminn_base.errors import AminnError
from aminn_export.samples.friction import GRID, NOTHING, combined

CASES = 16
META = {"tau": 0.5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("friction") / "data"
    write_dataset(path, grasps=40, cases=CASES)
    return path


def checkpoint(path: Path, **config: object) -> Checkpoint:
    torch.manual_seed(0)
    model = Aminn(ModelConfig(**config), hand()).eval()  # type: ignore[arg-type]
    return Checkpoint(model, META, path, "")


@pytest.fixture(scope="module")
def sliding(folder: Path) -> Checkpoint:
    return checkpoint(folder, friction="secant", sensors=True)


@pytest.fixture(scope="module")
def world(folder: Path, sliding: Checkpoint) -> Dataset:
    """Load cases of a world that sticks as the model does; what asks for more friction than it has slides, or fails."""
    data = load_dataset(folder)
    w_e = 0.2 * data.samples["w_e"] * np.exp(np.random.default_rng(0).normal(0, 1.5, (len(data), 1)))
    data = replace(data, samples=data.samples | {"w_e": w_e})
    weighed, true = sensed(data, Told(weight=True)), sensed(data, Told("value")).samples["friction"][:, 1]
    learner, rows = Learner(sliding, weighed), np.arange(len(data))
    rough = np.tile([1.0, 50.0, 0.0], (len(data), 1))
    over = learner.evidence(rows, rough).asked / true
    dx = learner.run(rows, rough)["dx_ht"] * np.where(over > 1, 3.0, 1.0)[:, None]
    return replace(data, samples=data.samples | {"dx_ht": dx, "stable": (over < 1.2).astype(np.uint8)})


def test_each_load_is_judged_after_others_of_its_grasp(world: Dataset) -> None:
    kind = np.random.default_rng(1).random(len(world)) < 0.7
    found, ids = series(world, kind, 6), world.samples["grasp_id"]
    assert len(found.judged) > 100 and found.pushes.shape == (len(found.judged), 6)
    assert (ids[found.pushes] == ids[found.judged][:, None]).all() and kind[found.pushes].all()
    assert (found.pushes != found.judged[:, None]).all()
    others = np.array([kind[ids == ids[k]].sum() - kind[k] for k in range(len(world))])
    np.testing.assert_array_equal(np.sort(found.judged), np.flatnonzero(others >= 6))
    assert len(np.unique(found.pushes)) > 0.9 * kind[np.isin(ids, ids[found.judged])].sum()


def test_pushes_narrow_friction_to_the_truth(world: Dataset, sliding: Checkpoint) -> None:
    data = sensed(world, Told(weight=True))
    true = sensed(world, Told("value")).samples["friction"][:, 1]
    loads = series(world, world.samples["stable"] > 0, 6)
    learner = Learner(sliding, data)
    steps: Iterator[NDArray] = learner.learn(loads.pushes)
    gains = [gain(found, true[loads.judged]) for found in steps]
    assert gains[0] == pytest.approx(0, abs=1e-9) and gains[1] > 0.02 and gains[-1] > gains[1]
    *_, found = learner.learn(loads.pushes)
    mean = (found * GRID).sum(1) / found.sum(1)
    error, before = (np.sqrt(np.mean((m - true[loads.judged]) ** 2)) for m in (mean, GRID.mean()))
    assert error < 0.85 * before
    told = combined(found)
    assert (told[:, 0] > 0).mean() > 0.5


def test_the_report_has_every_figure(world: Dataset, sliding: Checkpoint) -> None:
    some = world.take(world.samples["grasp_id"] < 16)
    figures = friction_figures(sliding, some)
    for known in KNOWN:
        for name in SERIES:
            start = f"friction_{known}_{name}"
            assert {f"{start}_{key}" for key in ("grasps", "loads", "error", "error_before", "deviation")} <= set(
                figures
            )
            wanted = {f"{start}_{told}_{key}" for told in TOLD for key in ("f1", "auroc", "rmse_all", "rmse_slid")}
            assert wanted <= set(figures)
    assert figures["friction_weight_held_loads"] > 50


def test_constants_are_chosen_by_what_they_explain(world: Dataset, sliding: Checkpoint) -> None:
    slips, tried = chosen(sliding, world.take(world.samples["grasp_id"] < 16))
    assert tried[f"gain_sharpness_{slips.sharpness:g}"] == max(v for k, v in tried.items() if "sharpness" in k)
    assert np.isfinite(list(tried.values())).all() and gain(NOTHING[None], np.array([0.6])) == 0
    assert slid_cases(world).any()


def test_models_that_cannot_are_refused(world: Dataset, folder: Path, tmp_path: Path) -> None:
    for config in ({"friction": "none", "sensors": True}, {"friction": "secant", "sensors": False}):
        with pytest.raises(AminnError, match="contacts of this model do not slide, or it sees no sensors"):
            Learner(checkpoint(tmp_path, **config), world)
    model = checkpoint(tmp_path, friction="none", sensors=False).model
    save_checkpoint(tmp_path / "run", model, META)
    result = CliRunner().invoke(main, ["--run", str(tmp_path / "run"), "--data", str(folder)])
    assert result.exit_code == 1 and "do not slide" in result.output
