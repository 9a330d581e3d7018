"""How sure a model is of its motion: what is learned of slides and errors, and what corrects the bound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from test_sensor_data import measured_data

from aminn.data import slides as slides_module
from aminn.data.dataset import Dataset
from aminn.data.slides import slid_cases, slides
from aminn.evaluation.evaluate import evaluate, format_table, learned
from aminn.evaluation.metrics import auroc, pose_error
from aminn.model.checkpoint import CARD, Checkpoint, build_model
from aminn.model.config import ModelConfig, SensorDraws, TrainConfig
from aminn.model.sure import Sure
from aminn.training import sure as sure_module
from aminn.training.sure import _correct, _newton, _quantile, fit_sure
from aminn.training.train import as_seen, train

SHORT = TrainConfig(epochs=2)


def held_back(run: Checkpoint, dataset: Dataset, split: str) -> tuple[Dataset, np.ndarray, np.ndarray, np.ndarray]:
    """The stable load cases of a split; p_slide, bound_95 and pose error of each."""
    part = dataset.split(split)
    part = part.take(part.samples["stable"] > 0)
    found = learned(run, part, "")
    assert found.p_slide is not None and found.bound_95 is not None
    return part, found.p_slide, found.bound_95, pose_error(found.dx, part.samples["dx_ht"], part.hand.length_m)


@pytest.fixture(scope="module")
def some_slid(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Checkpoint]]:
    """Models of the made-up data, in which all contacts slide, taught that three in ten did: those furthest."""
    far = float(np.quantile(slides(dataset)[dataset.samples["stable"] > 0].max(1), 0.7))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slides_module, "SLID_M", far)
        folder = tmp_path_factory.mktemp("slid")
        yield {k: train(TrainConfig(kind=k, epochs=8), dataset, folder / k) for k in ("aminn", "mlp")}


@pytest.mark.parametrize(("kind", "least", "ratio"), [("aminn", 0.85, 2.0), ("mlp", 0.65, 1.2)])
def test_what_slides_and_how_wrong_it_may_be_is_learned(
    some_slid: dict[str, Checkpoint], dataset: Dataset, kind: str, least: float, ratio: float
) -> None:
    part, p_slide, bound, error = held_back(some_slid[kind], dataset, "test")
    slid = slid_cases(part)
    assert 0.02 < slid.mean() < 0.5 and auroc(p_slide, slid) > least
    assert ((p_slide > 0) & (p_slide < 1) & (bound > 0)).all()
    within = error <= bound
    assert within.mean() > 0.85
    largest = bound >= np.quantile(bound, 0.8)
    assert np.median(error[largest]) > ratio * np.median(error[~largest])


@pytest.mark.parametrize("kind", ["aminn", "mlp"])
def test_bound_holds_what_it_promises_where_it_was_corrected(
    some_slid: dict[str, Checkpoint], dataset: Dataset, kind: str
) -> None:
    part, _, bound, error = held_back(some_slid[kind], dataset, "validation")
    sure, slid = some_slid[kind].model.sure, slid_cases(part)
    assert slid.sum() >= sure_module.LEAST_SLID and (np.diff(sure.edge.numpy()) > 0).all()
    within = error <= bound
    assert within.mean() >= 0.95 and within[slid].mean() >= 0.88
    assert some_slid[kind].meta["sure"] == {
        "p_slide": "learned",
        "cases": int(dataset.split("train").samples["stable"].sum()),
        "checked": len(part),
    }


def test_a_table_of_its_own_shows_it(some_slid: dict[str, Checkpoint], dataset: Dataset) -> None:
    result = evaluate(list(some_slid.values()), dataset)
    whole, sure = format_table(result).split("\n\n")
    assert "analytical" in whole and "analytical" not in sure
    assert "of slid" in sure and f"{result.table['mlp']['bound_coverage']:.1%}" in sure
    assert "in bound" not in format_table(replace(result, table={"no_motion": result.table["no_motion"]}))


def test_untrained_model_says_nothing(dataset: Dataset) -> None:
    x = dataset.take(np.arange(5)).inputs()
    for kind in ("aminn", "mlp"):
        out = build_model(kind, ModelConfig(), dataset.hand)(**x)
        assert (out["p_slide"] == 0.5).all() and (out["bound_95"] == 1).all()


def test_factor_is_that_of_the_bin_and_far_beyond_the_data_is_a_number() -> None:
    sure = Sure(1, 1)
    with torch.no_grad():
        sure.out.weight.copy_(torch.tensor([[1.0, 0.0], [0.0, 1.0]]))
        sure.edge.copy_(torch.tensor([0.2, 0.5, 0.9]))
        sure.factor.copy_(torch.tensor([1.0, 2.0, 3.0, 4.0]))
    logit = torch.tensor([-9.0, -1.0, 0.0, 2.0, 9.0, 0.0])
    log_bound = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 1e4])
    p_slide, bound = sure(logit[:, None], log_bound[:, None])
    torch.testing.assert_close(p_slide, torch.sigmoid(logit))
    assert bound[:5].tolist() == [1.0, 2.0, 3.0, 3.0, 4.0] and bound[5].isfinite()


@pytest.mark.parametrize("times", [1, 3])
def test_each_bin_holds_its_share_of_what_slid(times: int) -> None:
    """Errors whose size the bound does not see: a tenth slid, with errors of ten times the size."""
    rng = np.random.default_rng(0)
    n = 4000
    slid = rng.random(n) < 0.1
    logit = np.where(slid, 1.5, -1.5) + rng.normal(size=n)
    error = np.where(slid, 10.0, 1.0) * rng.exponential(size=n)
    sure = Sure(1, 1)
    with torch.no_grad():
        sure.out.weight[0, 0] = 1.0
    repeated = [np.tile(v, times) for v in (logit, error, slid)]
    feature = torch.as_tensor(repeated[0]).float()[:, None]
    check = sure_module._Cases(feature, torch.zeros(n * times, 1), repeated[1], repeated[2], n)
    with torch.no_grad():
        _correct(sure, check)
        p_slide, bound = (v.numpy() for v in sure(feature[:n], torch.zeros(n, 1)))
    within, own = error <= bound, sure.bin(torch.as_tensor(p_slide)).numpy()
    assert within.mean() == pytest.approx(0.95, abs=0.02)
    for k in range(1, 4):
        assert within[own == k].mean() >= 0.95 and within[(own == k) & slid].mean() >= sure_module.SLID_COVERED
    assert (slid & (own == 0)).sum() / slid.sum() == pytest.approx(0.03, abs=0.01)
    few = check._replace(slid=np.arange(n * times) < 3 * times)
    with torch.no_grad():
        _correct(sure, few)
    assert len(set(sure.factor.tolist())) == 1  # too few that slid to make bins of


def test_quantile_is_one_of_a_finite_sample() -> None:
    ratio = np.arange(1.0, 40.0)  # 39 of them: the 38th is above a new one with a probability of 38 / 40
    assert _quantile(ratio, 0.95, 1) == 38 and _quantile(np.repeat(ratio, 2), 0.95, 2) == 38
    assert _quantile(ratio[:18], 0.95, 1) == 18  # more than the largest cannot be promised


def test_newton_finds_the_least_loss() -> None:
    rng = np.random.default_rng(1)
    x = torch.as_tensor(np.hstack([rng.normal(size=(500, 3)), np.ones((500, 1))]))
    y = torch.as_tensor(rng.normal(size=500))
    found = _newton(x, lambda z: ((z - y) ** 2 / 2, z - y, torch.ones_like(z)), torch.zeros(4, dtype=x.dtype))
    torch.testing.assert_close(found, torch.linalg.lstsq(x, y[:, None]).solution[:, 0], rtol=1e-3, atol=1e-4)


def test_measured_data_tell_no_slides(runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path) -> None:
    lab = measured_data(tmp_path / "data", dataset, {})
    tuned = train(SHORT, lab, tmp_path / "tuned", finetune=runs["aminn"])
    anew = train(SHORT, lab, tmp_path / "anew")
    start = runs["aminn"].model.sure
    assert torch.equal(tuned.model.sure.out.weight[0], start.out.weight[0])
    assert tuned.meta["sure"]["p_slide"] == "kept" and anew.meta["sure"]["p_slide"] == "unknown"
    for run, said in ((tuned, "that of the model it was fine-tuned from"), (anew, "says nothing")):
        assert said in (run.path / CARD).read_text()
    out = anew.model(**lab.take(np.arange(9)).inputs())
    assert (out["p_slide"] == 0.5).all()
    part, _, bound, error = held_back(anew, lab, "validation")
    assert (error <= bound).mean() >= 0.95 and len(part)


def test_bound_is_blind_to_the_use_of_friction(dataset: Dataset) -> None:
    """Telling the tool's weight adds to the use of friction and not to errors."""
    model = build_model("aminn", ModelConfig(friction="secant"), dataset.hand)
    train_part, validation = (as_seen(dataset.split(name), model.config) for name in ("train", "validation"))
    fit_sure(model, train_part, validation, SensorDraws(), started=False)
    branches, width = dataset.hand.dims.branches, model.config.width[1]
    slide, bound = model.sure.out.weight.detach()
    use = slice(width + 1, width + 1 + branches)
    assert not bound[use].any() and slide[use].any() and bound[width + 1 + branches :].any()


def test_no_case_slid_and_all_did(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for slid, low, high in ((False, 0.0, 0.01), (True, 0.99, 1.0)):
        monkeypatch.setattr(sure_module, "slid_cases", lambda data, slid=slid: np.full(len(data), slid))
        run = train(replace(SHORT, epochs=1), dataset, tmp_path / str(slid))
        out = run.model(**dataset.take(np.arange(50)).inputs())
        assert ((out["p_slide"] >= low) & (out["p_slide"] <= high) & out["bound_95"].isfinite()).all()
