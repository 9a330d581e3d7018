"""The study of admissible loads, on a few grasps; and how it chooses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aminn_app import load_study
from aminn_app.load_study import (
    BOUNDS,
    KINDS,
    Limits,
    Scale,
    Scan,
    best_rule,
    choose,
    factors_at,
    failed,
    fixed_rules,
    missed,
    relative_load,
    study,
)
from aminn_rt import Model
from aminn_sim.open_hand import open_hand

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FEW = Scale(validation_grasps=6, test_grasps=4, halvings=3, chunk=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("load")


@pytest.fixture(scope="module")
def report(folder: Path) -> dict:
    return study(Model.load(GOLDEN), folder, FEW, 2, lambda text: None)


def test_the_report_is_flat_and_whole(report: dict) -> None:
    json.dumps(report)
    assert all(isinstance(value, (int, float, str)) for value in report.values())
    assert report["loads"] == 12 and 0 <= report["nothing_model_risk"] <= 1
    for name in ("ratio_mean", "ratio_median", "fixed_risk", "chosen_p_stable", "search_share_of_end_mean"):
        assert np.isfinite(report[f"nothing_{name}"]), name
    assert report["nothing_search_beyond_a_gap_share"] == 0
    assert report["nothing_search_share_of_end_mean"] > 0.8


def test_what_was_measured_is_kept(report: dict, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the same scale alone, and whole records."""
    names = sorted(file.name for file in folder.iterdir())
    assert [n for n in names if "outcomes" not in n] == [
        "test-00000-4.npz",
        "validation-00000-4.npz",
        "validation-00004-2.npz",
    ]
    assert 1 <= len(names) - 3 <= 2 * len(load_study.TOLD)  # what the loads of both rules did, each kept once

    def measured_again(*args: object) -> None:
        raise AssertionError

    monkeypatch.setattr(load_study, "measure", measured_again)
    again = load_study.grasps_of("validation", FEW, folder, 1, lambda text: None)
    assert again["capacity"].shape == (6, 3, 2) and len(again["q"]) == 6
    alike = load_study.like_the_training(again)
    assert 0 < len(alike["q"]) < 6 and (alike["friction"] <= 0.95).all()
    with pytest.raises(AssertionError):
        load_study.grasps_of("validation", replace(FEW, halvings=4), folder, 1, lambda text: None)


def test_capacities_lie_between_what_statics_says(report: dict, folder: Path) -> None:
    """With the true friction the first slip is near where the simulated grasp gives up, seldom far above."""
    grasps = load_study.grasps_of("validation", FEW, folder, 1, lambda text: None)
    low, high = np.moveaxis(grasps["capacity"], -1, 0)
    assert (low < high).all() and (high <= 1).sum() > 12
    rules = fixed_rules(open_hand().hand, grasps, "friction_weight")
    share = rules["statics_preload"] / np.sqrt(np.maximum(low, 1e-3) * np.minimum(high, 1))
    assert 0.3 < np.median(share) < 1.5
    assert set(fixed_rules(open_hand().hand, grasps, "nothing")) == {"constant", "pressed", "statics"}


def ends_of(middle: np.ndarray) -> np.ndarray:
    return np.stack([middle / 1.01, middle * 1.01], -1)


def test_factors_are_the_largest_at_a_risk() -> None:
    rng = np.random.default_rng(0)
    true = rng.uniform(0.05, 0.9, (2000, 3))
    ends = ends_of(true)
    for risk in (0.01, 0.1):
        factors = factors_at(np.ones_like(true), ends, risk)
        shares = failed(np.minimum(factors, 1.0) * np.ones_like(true), ends).mean(0)
        assert (shares <= risk).all() and (shares > 0.5 * risk).all()
    noisy = np.minimum(true * rng.lognormal(0, 0.2, true.shape), 1)
    name, factors = best_rule({"constant": np.ones_like(true), "seen": noisy}, ends, 0.02)
    assert name == "seen" and (0.4 < factors).all() and (factors < 0.9).all()
    everything = np.stack([np.ones((5, 3)), np.full((5, 3), np.inf)], -1)
    assert not failed(np.ones((5, 3)), everything).any()


def test_limits_are_chosen_for_load_at_the_risk() -> None:
    """Only p_stable tells here where a load fails; a threshold too low is too dangerous, one too high a waste."""
    rng = np.random.default_rng(1)
    n, scale = 400, np.linspace(0, 1, 101)
    true = rng.uniform(0.2, 0.8, (n, 3))
    p = 1 - np.clip((scale - 0.5 * true[..., None]) / true[..., None], 0, 1)  # 0.5 where it fails
    zero = np.zeros((n, 3, len(scale)))
    scanned = Scan(scale, zero == 0, p, zero, zero, zero, zero, 0.1)
    limits, risk = choose(scanned, ends_of(true))
    assert limits.p_stable == 0.7 and risk == 0
    assert relative_load(scanned.ends(limits), true)[0] == pytest.approx(0.8, abs=0.02)
    none = Scan(scale, zero > 0, p, zero, zero, zero, zero, 0.1)
    assert (none.ends(limits) == -1).all()
    turned = Scan(scale, zero == 0, zero + 1, zero, zero, zero + scale, zero + 0.01, 0.1)
    assert turned.ends(Limits(0.9, 2.0, 1.0)).max() == pytest.approx(BOUNDS[1] - 0.02)


def test_aims_that_are_missed_are_told() -> None:
    good = {"nothing_model_risk": 0.019, "nothing_ratio_mean": 1.6}
    assert not missed(good)
    assert missed(good | {"nothing_model_risk": 0.031}) == ["nothing: 3.1% of the loads are not borne"]
    assert missed(
        {"friction_weight_model_risk": 0, "friction_weight_ratio_mean": 1.2, "friction_weight_fixed_rule": "statics"}
    ) == ["friction_weight: 1.20 times the load of the best fixed factor"]
    assert len(KINDS) == 3
