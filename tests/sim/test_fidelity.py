"""Theory against simulation: the statics formula with the true stiffnesses must reproduce small motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aminn_sim import SimulationConfig, SimulationError, _core
from aminn_sim.fidelity import TrueMechanics, fidelity, predict, read_arrays, relative_error, small_loads
from aminn_sim.quality import dataset_figures, label_noise


@pytest.mark.parametrize(("axis", "bound"), [("random", 0.15), ("compliant", 0.15)])
def test_small_motions_follow_the_formula(axis: str, bound: float) -> None:
    """A wrong sign gives a relative error of 2, a wrong frame or a lost tendon more than 0.5; measured: 0.06."""
    loads = [load for load in small_loads(SimulationConfig(), seed=2, grasps=25, axis=axis) if load.sticking]
    assert len(loads) >= 10
    errors = np.array([load.error for load in loads])
    print(f"{axis}: relative error median {np.median(errors):.3f}, 90th percentile {np.percentile(errors, 90):.3f}")
    assert np.median(errors) < bound and np.percentile(errors, 90) < 0.4
    assert all(load.w_e @ load.simulated > 0 for load in loads)  # the tool gives way, it does not push back


def test_a_lost_tendon_would_show() -> None:
    """The bound above has teeth: without the tendons the formula is far off."""
    hand = {
        "joint_stiffness_Nm_rad": [[4.0, 0.4, 0.2]] * 2 + [[0.0, 0.8, 0.4]],
        "tendons": [
            {"branch": b, "moment_arm_m": arm, "stiffness_N_m": 2e4}
            for b in range(3)
            for arm in ([0, 0.01, 0], [0, 0.01, 0.007])
        ],
    }
    rng = np.random.default_rng(0)
    j_x = rng.normal(size=(3, 3, 6)) * [1, 1, 1, 0.02, 0.02, 0.02]
    j_q = rng.normal(size=(3, 3, 3)) * 0.05
    mechanics, contact, w = TrueMechanics.from_hand(hand), np.ones(3), np.array([0.01, 0, 0, 0, 0, 0])
    taut, _ = predict(mechanics, j_x, j_q, contact, np.full(6, 10.0), w)
    slack, _ = predict(mechanics, j_x, j_q, contact, np.zeros(6), w)
    assert relative_error(slack, taut) > 0.2
    assert w @ taut > 0


def test_formula_on_the_data_set(dataset_dir: Path) -> None:
    manifest, samples, grasps = read_arrays(dataset_dir)
    figures = fidelity(manifest["hand"], samples, grasps)
    assert figures["dataset_relative_error_median"] < 0.35
    assert all(np.isfinite(v) for v in figures.values())


def test_figures_of_the_data_set(dataset_dir: Path) -> None:
    figures = dataset_figures(*read_arrays(dataset_dir))
    assert all(np.isfinite(v) for v in figures.values())
    reasons = [v for k, v in figures.items() if k[6:] in _core.REASONS]
    assert len(reasons) == 7 and abs(sum(reasons) - 1) < 1e-12
    assert figures["negative_full_work_share"] == 0


def test_a_longer_hold_changes_little() -> None:
    figures = label_noise(SimulationConfig(), threads=2, grasps=4, cases=4)
    assert figures["long_hold_labels_changed"] <= 1
    assert figures["long_hold_relative_median"] < 0.02


def test_folder_without_data_is_named(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="not a readable data set"):
        read_arrays(tmp_path)
