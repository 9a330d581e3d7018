"""Figures of merit on cases whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from aminn.evaluation import metrics
from aminn.model import losses


def test_geodesic_angle_matches_rotation_matrices() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 100, 3))
    skew = lambda v: np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])  # noqa: E731
    matrix = lambda v: torch.linalg.matrix_exp(torch.tensor(skew(v))).numpy()  # noqa: E731
    expected = [
        np.arccos(np.clip((np.trace(matrix(u).T @ matrix(v)) - 1) / 2, -1, 1)) for u, v in zip(a, b, strict=True)
    ]
    np.testing.assert_allclose(metrics.geodesic_angle(a, b), expected, atol=1e-7)
    mine = losses.geodesic_angle(torch.tensor(a), torch.tensor(b)).numpy()
    np.testing.assert_allclose(mine, expected, atol=1e-6)


def test_geodesic_angle_of_small_rotations_is_exact() -> None:
    a = np.array([[1e-9, 0, 0]])
    np.testing.assert_allclose(metrics.geodesic_angle(a, -a), [2e-9], rtol=1e-12)


def test_pose_error_units() -> None:
    zero, pred = np.zeros((2, 6)), np.array([[0.01, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.1, 0]])
    np.testing.assert_allclose(metrics.pose_error(pred, zero, 0.1), [0.1, 0.1])
    figures = metrics.displacement_figures(zero, pred, 0.1)
    assert figures["rmse_mm"] == pytest.approx(10 / np.sqrt(2))
    assert figures["rmse_deg"] == pytest.approx(np.rad2deg(0.1) / np.sqrt(2))
    assert figures["rmse_to_no_motion"] == pytest.approx(1)
    assert figures["relative_error_median"] == pytest.approx(1)
    assert figures["n_size3"] == 2 and np.isnan(figures["rmse_pose_size0"])


def test_f1_and_passivity() -> None:
    true, pred = np.array([1, 1, 1, 0], bool), np.array([1, 1, 0, 1], bool)
    assert metrics.f1_score(pred, true) == pytest.approx(2 * 2 / 6)
    w = np.array([[1.0, 0, 0, 0, 0, 1]] * 4)
    dx = np.array([[-1.0, 0, 0, 0, 0, 2], [1, 0, 0, 0, 0, -2], [-9, 0, 0, 0, 0, -9], [1, 0, 0, 0, 0, 1]])
    assert metrics.violation_rate(w, dx, pred, full=False) == pytest.approx(1 / 3)
    assert metrics.violation_rate(w, dx, pred, full=True) == pytest.approx(1 / 3)


def test_tau_separates_and_keeps_its_distance() -> None:
    p = np.array([0.1, 0.2, 0.3, 0.7, 0.8, 0.9])
    tau = metrics.choose_tau(p, p > 0.5, np.ones(6))
    assert tau == pytest.approx(0.5)


def test_tau_prefers_the_threshold_with_less_error() -> None:
    """Dropping a truly stable sample with a large error costs little F1 and much RMSE."""
    p = np.linspace(0.5, 1, 400)
    stable, error = np.ones(400, bool), np.ones(400)
    error[0] = 100.0
    assert metrics.choose_tau(p, stable, error) > p[0]


def test_auroc_counts_pairs_and_halves_ties() -> None:
    rng = np.random.default_rng(1)
    score, positive = np.round(rng.uniform(size=60), 1), rng.uniform(size=60) < 0.4
    pairs = score[positive][:, None] - score[~positive]
    assert metrics.auroc(score, positive) == pytest.approx(((pairs > 0) + 0.5 * (pairs == 0)).mean())
    assert np.isnan(metrics.auroc(score, np.ones(60, bool)))


def test_calibration_of_probabilities_that_are_right_and_wrong() -> None:
    rng = np.random.default_rng(2)
    p = rng.uniform(size=20000)
    positive = rng.uniform(size=20000) < p
    assert metrics.calibration_figures(p, positive)["ece"] < 0.015
    assert metrics.calibration_figures(np.full(20000, 0.9), positive)["ece"] == pytest.approx(0.9 - positive.mean())
    assert sum(b["n"] for b in metrics.reliability(np.array([0.0, 0.5, 1.0]), np.array([False, True, True]))) == 3


def test_precision_and_recall() -> None:
    pred, true = np.array([1, 1, 0, 0], bool), np.array([1, 0, 1, 1], bool)
    assert metrics.precision_recall(pred, true) == (0.5, pytest.approx(1 / 3))
    assert np.isnan(metrics.precision_recall(np.zeros(4, bool), true)[0])


def test_operating_curve_follows_the_threshold() -> None:
    p = np.linspace(0, 1, 200)
    curve = metrics.operating_curve(p, p > 0.5, 1 - p)
    k = int(np.argmin(np.abs(np.array(curve["tau"]) - 0.5)))
    assert curve["passed"][k] == pytest.approx(0.5, abs=0.02) and curve["f1"][k] == pytest.approx(1, abs=0.02)
    assert curve["rmse_pose"][-1] < curve["rmse_pose"][0]


def test_refusing_the_unsure_leaves_the_others_errors() -> None:
    error, doubt = np.arange(1.0, 21.0), np.arange(20.0)
    assert metrics.refused_rms(error, doubt, 0.0) == pytest.approx(metrics.rms(error))
    assert metrics.refused_rms(error, doubt, 0.1) == pytest.approx(metrics.rms(error[:18]))
    assert metrics.refused_rms(error, -doubt, 0.1) == pytest.approx(metrics.rms(error[2:]))
    figures = metrics.refusal_figures(error / 1000, doubt)
    assert figures["large_error_share"] == 0.5 and figures["rmse_pose_refused_5pc"] == pytest.approx(
        metrics.rms(error[:19]) / 1000
    )
    assert np.isnan(metrics.refused_rms(np.zeros(0), np.zeros(0), 0.05))


def test_refusal_curve_goes_from_all_cases_to_the_surest() -> None:
    error = np.linspace(1.0, 0.1, 100)
    curve = metrics.refusal_curve(error, error, most=0.5, points=6)
    assert curve["refused"] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert curve["rmse_pose"] == pytest.approx([metrics.rms(error[k:]) for k in range(0, 60, 10)])


def test_a_model_that_is_equally_unsure_of_all_gains_nothing_by_refusing() -> None:
    """Whatever the order of the load cases: who says nothing must not look as if it knew."""
    error = np.arange(1.0, 21.0)
    for e in (error, error[::-1]):
        assert metrics.refused_rms(e, np.ones(20), 0.1) == pytest.approx(metrics.rms(error))


def test_slid_and_stuck_cases_are_told_apart() -> None:
    error, slid = np.array([3.0, 4.0, 1.0, 1.0]), np.array([1, 1, 0, 0], bool)
    figures = metrics.slide_figures(error, slid)
    assert figures["rmse_pose_slid"] == pytest.approx(np.sqrt(12.5)) and figures["rmse_pose_stuck"] == 1
    assert figures["slid_share"] == 0.5 and figures["slid_n"] == 2
    assert figures["error_share_slid"] == pytest.approx(25 / 27)
    none = metrics.slide_figures(np.zeros(2), np.zeros(2, bool))
    assert none["slid_n"] == 0 and np.isnan(none["rmse_pose_slid"]) and np.isnan(none["error_share_slid"])


def test_a_bound_covers_what_it_holds() -> None:
    error, size = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 2.0, 2.0, 2.0])
    bound, slid = np.array([1.0, 1.0, 4.0, 5.0]), np.array([0, 1, 1, 0], bool)
    figures = metrics.bound_figures(error, size, bound, slid)
    assert figures == {"bound_coverage": 0.75, "bound_coverage_slid": 0.5, "bound_width": 1.25}
    assert "bound_coverage_slid" not in metrics.bound_figures(error, size, bound)
