"""Breakdowns, gates and compliance on predictions whose figures are known, and what noise does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aminn.data.dataset import Dataset
from aminn.data.slides import slides
from aminn.evaluation import analysis
from aminn.evaluation.evaluate import Prediction, learned, noise_floor
from aminn.hand.closure import closure
from aminn.model.checkpoint import Checkpoint


def perfect(data: Dataset) -> Prediction:
    s = data.samples
    stable = s["stable"] > 0
    return Prediction("perfect", s["dx_ht"], stable, stable.astype(float), data.taut().astype(float))


def test_closure_is_that_of_the_data(dataset: Dataset) -> None:
    s = dataset.samples
    j_x, j_q = closure(dataset.hand, s["q"], s["x_ht"], s["contacts"])
    np.testing.assert_allclose(j_x, s["j_x"], atol=1e-12)
    np.testing.assert_allclose(j_q, s["j_q"], atol=1e-12)


def test_groups_of_each_kind_cover_all_load_cases_once(dataset: Dataset) -> None:
    masks = dict(analysis.groups(dataset))
    for kind in (["load0", "load1", "load2", "load3"], list(analysis.DIRECTIONS)):
        assert (sum(masks[name].astype(int) for name in kind) == 1).all()
    for start in ("tool_", "tendons_"):
        assert (sum(m.astype(int) for name, m in masks.items() if name.startswith(start)) == 1).all()


def test_a_perfect_prediction_has_perfect_figures(dataset: Dataset) -> None:
    right = perfect(dataset)
    found = analysis.breakdown(right, dataset)
    assert found["load0"]["f1"] == 1 and found["tool_capsule"]["rmse_pose_all"] == 0
    assert found["tendons_taut"]["ece"] == 0
    assert analysis.gate_figures(right, dataset)["gate_auroc"] == 1
    assert analysis.compliance_figures(right, dataset)["small_load_compliance_error_median"] == 0


def test_compliance_error_is_that_along_the_load(dataset: Dataset) -> None:
    right = perfect(dataset)
    soft = Prediction("soft", 1.1 * right.dx, right.stable)
    found = analysis.compliance_figures(soft, dataset)
    assert found["small_load_compliance_error_median"] == pytest.approx(0.1)
    assert found["small_load_relative_error_median"] == pytest.approx(0.1)


def test_gates_that_are_the_wrong_way_round_are_found(dataset: Dataset) -> None:
    right = perfect(dataset)
    wrong = Prediction("wrong", right.dx, right.stable, gate=1 - right.gate)
    assert analysis.gate_figures(wrong, dataset)["gate_auroc"] == 0


def test_a_contact_that_sticks_has_not_slid(dataset: Dataset) -> None:
    """The tool moves as the closure says of joints that move: no slip; then one fingertip slides along its tangent."""
    s, rng = dataset.samples, np.random.default_rng(0)
    dx = np.hstack([rng.normal(0, 1e-5, (len(dataset), 3)), rng.normal(0, 1e-4, (len(dataset), 3))])
    motion = (s["j_x"] @ dx[:, None, :, None])[..., 0]  # (n, 3, 3) of the contacts
    fingers = np.linalg.solve(-s["j_q"][:, :2], motion[:, :2, :, None])[..., 0].reshape(len(dataset), 6)
    thumb = (np.linalg.pinv(-s["j_q"][:, 2, :, 1:]) @ motion[:, 2, :, None])[..., 0]
    after = s["q"] + np.hstack([fingers, thumb])
    moved = replace(dataset, samples=s | {"dx_ht": dx, "q_after": after})
    slip = slides(moved)[:, :2]  # of second order in the motion; a straight finger moves far
    assert np.quantile(slip, 0.95) < 1e-6 and slip.max() < 1e-4
    slid = replace(moved, samples=moved.samples | {"q_after": s["q"]})
    gap = motion - (motion * s["contacts"][..., 4:7]).sum(-1, keepdims=True) * s["contacts"][..., 4:7]
    np.testing.assert_allclose(slides(slid), np.linalg.norm(gap, axis=-1), atol=1e-7)


def test_error_shares_add_up(dataset: Dataset) -> None:
    still = Prediction("still", np.zeros((len(dataset), 6)), np.ones(len(dataset), bool))
    shares = analysis.squared_error_shares(still, dataset)
    assert sum(shares[name] for name in analysis.DIRECTIONS) == pytest.approx(1)


def test_noise_changes_inputs_as_it_says_and_no_labels(dataset: Dataset) -> None:
    noise = analysis.SensorNoise()
    noisy = analysis.with_noise(dataset, noise)
    change = noisy.samples["q"] - dataset.samples["q"]
    assert change.std() == pytest.approx(noise.joint_rad, rel=0.05)
    moved = noisy.samples["contacts"][..., 1:4] - dataset.samples["contacts"][..., 1:4]
    assert moved.std() == pytest.approx(noise.contact_m, rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(noisy.samples["contacts"][..., 4:7], axis=-1), 1)
    np.testing.assert_array_equal(noisy.samples["dx_ht"], dataset.samples["dx_ht"])
    still = analysis.with_noise(dataset, noise.scaled(0.0)).samples
    for name in ("q", "w_e", "j_x", "j_q"):
        np.testing.assert_allclose(still[name], dataset.samples[name], atol=1e-12)


def test_noise_makes_predictions_worse(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    figures = analysis.noise_figures(runs["aminn"], dataset)
    errors = [figures[analysis.noise_part(f)]["relative_error_median_all"] for f in analysis.NOISE_FACTORS]
    assert errors == sorted(errors)


def test_gates_learn_from_the_tendons(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    """The made-up tensions are random: there is nothing to learn, and the figure says so."""
    found = analysis.gate_figures(learned(runs["aminn"], dataset.split("test"), "aminn"), dataset.split("test"))
    assert 0.35 < found["gate_auroc"] < 0.65


def test_noise_floor_of_the_labels(dataset: Dataset) -> None:
    found = noise_floor(dataset)
    assert found["noise_floor_relative_error_median"] == pytest.approx(0.001, rel=1e-3)
    assert found["noise_floor_impratio_relative_error_median"] == pytest.approx(0.01, rel=1e-3)
    assert found["noise_floor_f1"] == 1 and found["noise_floor_flipped"] == 0
