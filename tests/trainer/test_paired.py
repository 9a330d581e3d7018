"""The bootstrap over grasps: exact on the test set itself, and as wide as grasps differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aminn.data.dataset import Dataset
from aminn.evaluation.evaluate import Prediction, figures_of
from aminn.evaluation.paired import compared, resampled


def scaled(data: Dataset, factors: np.ndarray | float) -> Prediction:
    """A model that errs by a share of each motion, and calls nine of ten cases as they are."""
    stable = (data.samples["stable"] > 0) ^ (np.arange(len(data)) % 10 == 0)
    return Prediction("scaled", data.samples["dx_ht"] * np.broadcast_to(factors, (6, len(data))).T, stable)


def factors(data: Dataset) -> np.ndarray:
    return 1 + np.random.default_rng(0).normal(0, 0.1, len(data))


def test_first_value_is_the_figure_itself(dataset: Dataset) -> None:
    p = scaled(dataset, factors(dataset))
    found, figures = resampled(p, dataset), figures_of(p, dataset)
    assert 0 < figures["slid_share"] < 1  # of these load cases some count as slid
    for name, values in found.items():
        assert values[0] == pytest.approx(figures[name]), name


def test_a_draw_is_the_figure_of_the_grasps_drawn(dataset: Dataset) -> None:
    """Two grasps: every draw is one of them twice, or the test set itself."""
    data = dataset.take(np.isin(dataset.samples["grasp_id"], [3, 4]))
    p = scaled(data, factors(data))
    found = resampled(p, data)
    parts = [data.samples["grasp_id"] == g for g in (3, 4)]
    alone = [figures_of(p.take(mask), data.take(mask)) for mask in parts]
    for name in ("f1", "rmse_pose_all", "rmse_pose", "large_error_share"):
        options = [found[name][0], alone[0][name], alone[1][name]]
        assert np.abs(found[name][1:, None] - options).min(1).max() < 1e-12, name
        assert min(np.abs(found[name] - v).min() for v in options) < 1e-12, name
    twice = data.take(np.concatenate([np.flatnonzero(parts[0])] * 2))
    q = scaled(data, factors(data)).take(np.concatenate([np.flatnonzero(parts[0])] * 2))
    for name in ("relative_error_median_all", "relative_error_p90_all"):
        assert np.isclose(found[name], figures_of(q, twice)[name], rtol=1e-12).any(), name


def test_a_ratio_is_surer_than_what_it_is_of(dataset: Dataset) -> None:
    """A model that errs half as much in every case does so in every draw; one of its own errors does not."""
    wrong = 1 + np.abs(factors(dataset) - 1)
    mine = resampled(scaled(dataset, wrong), dataset)
    other = resampled(scaled(dataset, 2 * wrong - 1), dataset)
    ratio = compared([mine], [other], "relative_error_median_all")
    assert ratio.low == pytest.approx(0.5) and ratio.high == pytest.approx(0.5) and ratio.value == pytest.approx(0.5)
    unpaired = {name: values[::-1] for name, values in other.items()}
    wide = compared([mine], [unpaired], "relative_error_median_all")
    assert wide.high - wide.low > 0.02
    assert compared([mine], [other], "f1").value == 0


def test_seeds_are_drawn_too(dataset: Dataset) -> None:
    one, two = (resampled(scaled(dataset, 1 + k * 0.01), dataset) for k in (1, 2))
    found = compared([one, two], [one, one], "rmse_pose_all")
    assert found.value == pytest.approx(1.5, rel=1e-3)
    assert found.low == pytest.approx(1, rel=1e-2) and found.high == pytest.approx(2, rel=1e-2)


def test_an_interval_without_slid_cases_is_no_number(dataset: Dataset) -> None:
    mine = resampled(scaled(dataset, 1.1), dataset) | {"rmse_pose_slid": np.full(1001, np.nan)}
    assert all(np.isnan(v) for v in compared([mine], [mine], "rmse_pose_slid"))


def test_a_bound_says_more_than_p_stable_and_that_more_than_a_motion() -> None:
    n = 10
    p = Prediction("p", np.zeros((n, 6)), np.ones(n, bool), np.linspace(0, 1, n), bound_95=np.arange(n))
    np.testing.assert_array_equal(p.doubt(0.1), np.arange(n))
    np.testing.assert_allclose(replace(p, bound_95=None).doubt(0.1), 1 - np.linspace(0, 1, n))
    assert not replace(p, bound_95=None, p_stable=None).doubt(0.1).any()
