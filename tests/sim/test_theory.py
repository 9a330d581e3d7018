"""Theory against simulation: the statics formula with the true stiffnesses must reproduce small motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aminn_sim import SimulationConfig, SimulationError, _core
from aminn_sim.open_hand import open_hand
from aminn_sim.quality import dataset_figures, waiting_figures
from aminn_sim.read import read_data
from aminn_sim.theory import TrueMechanics, compliance, dataset_errors, over_grasps, predict, relative_error, slack_jump

HAND = open_hand().hand


def test_small_motions_follow_the_formula(simulator: _core.Simulator) -> None:
    """A wrong sign gives a relative error of 2, a wrong frame or a lost tendon more than 0.5; measured: 0.07."""
    results = over_grasps(HAND, simulator, SimulationConfig(seed=2), 16, 2, compliance)
    errors, sticking = np.concatenate([r.errors for r in results]), np.concatenate([r.sticking for r in results])
    print(f"relative error median {np.median(errors[sticking]):.3f}, p90 {np.percentile(errors[sticking], 90):.3f}")
    assert sticking.mean() > 0.8
    assert np.median(errors[sticking]) < 0.10 and np.percentile(errors[sticking], 90) < 0.30
    for r in results:  # the tool gives way, it does not push back
        assert (np.diag(r.simulated) > 0).all()


def test_small_motions_follow_the_statics_with_preload(simulator: _core.Simulator) -> None:
    """With the contact forces it closes to 1 %: geometry, springs, tendons, signs and frames are all as believed."""
    results = over_grasps(HAND, simulator, SimulationConfig(seed=3), 16, 2, compliance)
    errors, sticking = (
        np.concatenate([r.preload_errors for r in results]),
        np.concatenate([r.sticking for r in results]),
    )
    print(f"relative error median {np.median(errors[sticking]):.4f}, p90 {np.percentile(errors[sticking], 90):.4f}")
    assert np.median(errors[sticking]) < 0.02 and np.percentile(errors[sticking], 90) < 0.08


def test_compliance_jumps_where_a_tendon_goes_slack(simulator: _core.Simulator) -> None:
    jumps = [j for j in over_grasps(HAND, simulator, SimulationConfig(seed=1), 12, 2, slack_jump) if j is not None]
    assert len(jumps) >= 2
    assert np.median([j.slack_m_N / j.taut_m_N for j in jumps]) > 1.1
    assert all(j.formula_ratio > 1 for j in jumps)


def test_a_lost_tendon_would_show() -> None:
    """The bound above has teeth: without the tendons the formula is far off."""
    rng = np.random.default_rng(0)
    j_x = rng.normal(size=(3, 3, 6)) * [1, 1, 1, 0.02, 0.02, 0.02]
    j_q = rng.normal(size=(3, 3, 3)) * 0.05
    mechanics, contact, w = TrueMechanics.of(HAND), np.ones((3, 8)), np.array([0.01, 0, 0, 0, 0, 0])
    taut, _ = predict(mechanics, j_x, j_q, contact, np.full(6, 10.0), w)
    slack, _ = predict(mechanics, j_x, j_q, contact, np.zeros(6), w)
    assert relative_error(slack, taut) > 0.2
    assert w @ taut > 0


def test_formula_on_the_data_set(dataset_dir: Path) -> None:
    data = read_data(dataset_dir)
    figures = dataset_errors(data.hand, data.samples, data.grasps)
    assert figures["theory_all_loads_relative_error_median"] < 0.35
    assert all(np.isfinite(v) for v in figures.values())


def test_figures_of_the_data_set(dataset_dir: Path) -> None:
    data = read_data(dataset_dir)
    figures = dataset_figures(data)
    assert all(np.isfinite(v) for v in figures.values())
    reasons = [figures[f"share_{reason}"] for reason in _core.REASONS]
    assert len(reasons) == 7 and abs(sum(reasons) - 1) < 1e-12
    assert figures["negative_full_work_share"] == 0
    assert figures["noise_cases"] == len(data.noise["sample"]) > 0
    assert figures["noise_half_step_relative_median"] < 0.02
    assert figures["creep_rate_m_s_median"] < 1e-6 and figures["creep_rate_m_s_p99"] < 2e-5
    assert figures["equilibrium_residual_max"] < 0.01


def test_a_longer_hold_changes_little(simulator: _core.Simulator) -> None:
    figures = waiting_figures(simulator, SimulationConfig(), threads=2, grasps=4, cases=4)
    assert figures["waiting_labels_changed_share"] == 0
    assert figures["waiting_at_least_doubled_share"] > 0.9
    assert figures["waiting_relative_median"] < 0.002


def test_folder_without_data_is_named(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="not a readable data set"):
        read_data(tmp_path)
