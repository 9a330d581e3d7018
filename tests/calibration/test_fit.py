"""Theta from pushes: how near, how sure, and whatever slips."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import Draw

from aminn.calibration.calibrate import calibrate, fit_parsimonious, hold_out, noise_of, refusals
from aminn.calibration.fit import BIAS, Z90, Errors, Prior, estimate_errors, fit
from aminn.calibration.pushes import Array, Predict, Pushes, relative_errors
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.theta import Theta

EXACT = Errors(relative=0.01, deviation=0.01, freedom=3.0, bias={})
"""What is true of the made-up pushes."""


def median(predict: Predict, pushes: Pushes, theta: Array) -> float:
    return float(np.median(relative_errors(predict(pushes, np.tile(theta, (len(pushes), 1))), pushes)))


def joined(pushes: list[Pushes]) -> Pushes:
    """Pushes of several grasps of one hand."""
    fields = ("q", "x_ht", "w_e", "contacts", "dx_ht")
    ids = np.concatenate([100 * i + p.grasp_id for i, p in enumerate(pushes)])
    return Pushes(pushes[0].hand, **{f: np.concatenate([getattr(p, f) for p in pushes]) for f in fields}, grasp_id=ids)


@pytest.mark.parametrize(("pushes", "grasps", "most"), [(10, 2, 0.06), (40, 5, 0.04)])
def test_other_grasps_are_predicted_better(
    predict: Predict, draw: Draw, pushes: int, grasps: int, most: float, trust: dict
) -> None:
    before, after = [], []
    for seed in range(4):
        both, theta = draw(seed, pushes + 20, grasps + 4)
        seen = both.grasp_id < grasps
        found = fit(predict, both.take(seen), errors=EXACT)
        rest = both.take(~seen)
        before.append(median(predict, rest, 0 * theta))
        after.append(median(predict, rest, found.theta))
    trust[f"calibrate_made_up_{pushes}_before"] = float(np.median(before))
    trust[f"calibrate_made_up_{pushes}_after"] = float(np.median(after))
    assert np.median(after) < most < np.median(before)


def test_intervals_hold_the_truth(predict: Predict, draw: Draw, lab_hand: Hand, trust: dict) -> None:
    factors = Theta(lab_hand).factors
    inside = []
    for seed in range(30):
        pushes, theta = draw(100 + seed, 12, 3)
        found = fit(predict, pushes, Prior(log=0.29), EXACT)
        inside.append(np.abs(found.theta - theta)[:factors] <= Z90 * found.sd[:factors])
    trust["calibrate_made_up_coverage_90"] = float(np.mean(inside))
    assert 0.84 <= np.mean(inside) <= 0.97


def test_slips_count_nothing(predict: Predict, draw: Draw) -> None:
    pushes, _ = draw(3, 20, 4)
    slipped = pushes.dx_ht.copy()
    slipped[[2, 7, 11, 16]] *= [[3.0], [-2.0], [5.0], [4.0]]
    clean, found = (fit(predict, p, errors=EXACT) for p in (pushes, pushes.told(dx_ht=slipped)))
    assert found.weights[[2, 7, 11, 16]].max() < 0.05 < np.delete(found.weights, [2, 7, 11, 16]).min()
    assert np.all(np.abs(found.theta - clean.theta) < 3 * clean.sd)


def test_pushes_of_one_grasp_say_less_than_of_many(predict: Predict, draw: Draw) -> None:
    errors = Errors(relative=0.01, deviation=0.1, freedom=3.0, bias={})
    shares = []
    for seed in range(5, 9):
        one, many = (fit(predict, draw(seed, 16, grasps)[0], errors=errors) for grasps in (1, 8))
        shares.append(np.prod(many.sd[:13] / one.sd[:13]))
    assert max(shares) < 0.7 and np.exp(np.mean(np.log(shares))) < 0.4


def test_bias_widens_intervals_up_to_the_prior(predict: Predict, draw: Draw, lab_hand: Hand) -> None:
    pushes, _ = draw(6, 30, 6)
    narrow, wide, huge = (
        fit(predict, pushes, errors=Errors(bias=dict.fromkeys(BIAS, bias))) for bias in (0.0, 0.2, 1e3)
    )
    factors, prior = Theta(lab_hand).factors, Prior().sd(Theta(lab_hand))
    assert np.all(narrow.sd[:factors] < wide.sd[:factors])
    assert np.all(wide.sd[:factors] < huge.sd[:factors] + 1e-9)
    assert np.allclose(huge.sd[:factors], prior[:factors], rtol=1e-3)
    assert np.array_equal(narrow.theta, huge.theta) and np.allclose(narrow.mean, narrow.theta, atol=1e-6)
    assert np.abs(huge.mean[:factors]).max() < 1e-3 < np.abs(wide.mean[:factors]).max() < np.abs(wide.theta).max()


@pytest.mark.parametrize("part", ["zeros", "radius"])
def test_zeros_and_radius_are_found_where_they_are_off(predict: Predict, draw: Draw, lab_hand: Hand, part: str) -> None:
    space = Theta(lab_hand)
    off = np.zeros(len(space))
    if part == "zeros":
        off[space.zeros] = 0.02 * np.array([1, -1, 1, 1, -1, -1, 1, -1.0])
    else:
        off[-1] = 0.001
    pushes, theta = draw(8, 40, 5, error=0.005, off=off)
    found, free = fit_parsimonious(predict, pushes, Prior(), EXACT, None)
    assert free.all()
    assert median(predict, pushes, found.theta) < 0.5 * median(predict, pushes, np.r_[theta[:-9], np.zeros(9)])
    where = space.zeros if part == "zeros" else slice(-1, None)
    assert np.abs(found.theta - theta)[where].mean() < 0.5 * np.abs(off[where]).mean()


def test_zeros_and_radius_stay_where_nothing_asks_for_them(predict: Predict, draw: Draw, lab_hand: Hand) -> None:
    factors = Theta(lab_hand).factors
    free = [fit_parsimonious(predict, draw(20 + s, 12, 3)[0], Prior(), EXACT, None)[1] for s in range(6)]
    assert np.mean([f[factors:].any() for f in free]) <= 1 / 6


def test_errors_of_a_model_are_found(predict: Predict, draw: Draw) -> None:
    drawn = [draw(40 + s, 8, 1, error=0.05) for s in range(12)]
    pushes = joined([p for p, _ in drawn])
    theta = np.concatenate([np.tile(t, (8, 1)) for _, t in drawn])
    found = estimate_errors(predict, pushes, theta)
    assert 0.5 < found.relative / (0.05 / 6**0.5) < 1.5
    assert found.deviation < 0.08 and found.freedom >= 4


def test_a_bias_is_found_from_hands_of_many_grasps(predict: Predict, draw: Draw) -> None:
    drawn = [draw(70 + s, 40, 5, vary=0.3) for s in range(4)]
    pushes, hands = joined([p for p, _ in drawn]), np.repeat(np.arange(4), 40)
    rng = np.random.default_rng(0)
    factors = np.arange(len(drawn[0][1])) < Theta(pushes.hand).factors
    told = [t + factors * 0.3 * rng.choice([-1.0, 1.0], len(t)) for _, t in drawn]  # as if theta were these
    right, wrong = (
        estimate_errors(predict, pushes, np.repeat(np.array(t), 40, axis=0), hands, rounds=2).bias
        for t in ([t for _, t in drawn], told)
    )
    assert right["contact"] < 0.1 < 0.15 < wrong["contact"]


def test_noise_of_sensors_widens(predict: Predict, draw: Draw) -> None:
    pushes, _ = draw(9, 10, 2)
    none, some, more = (noise_of(predict, pushes, level) for level in (0.0, 1.0, 2.0))
    assert none is None and some is not None and more is not None
    assert np.all(some > 0) and np.median(more / some) > 1.5
    assert np.all(fit(predict, pushes, noise=some).sd[:13] > 0.99 * fit(predict, pushes).sd[:13])


def test_grasps_are_left_out_whole(predict: Predict, draw: Draw, lab_hand: Hand) -> None:
    free = np.ones(len(Theta(lab_hand)), bool)
    for grasps, by in ((1, "push"), (2, "grasp")):
        assert hold_out(predict, draw(10, 8, grasps)[0], Prior(), EXACT, free, None).by == by


def test_a_calibration_that_makes_things_worse_is_refused(predict: Predict, draw: Draw) -> None:
    """Grasps that contradict each other: what one says of the hand is wrong for the other."""
    pushes, _ = draw(11, 12, 2, error=0.002, vary=0.0)
    factor = np.where(pushes.grasp_id == 0, 1.25, 0.8)[:, None]
    found = calibrate(predict, pushes.told(dx_ht=pushes.dx_ht * factor), errors=EXACT, look_for_mistakes=False)
    assert not found.held_out.better
    (reason,) = refusals(found)
    assert "makes the others worse" in reason


def test_too_few_pushes(predict: Predict, draw: Draw) -> None:
    with pytest.raises(AminnError, match="3 pushes were held; calibration needs 4 or more"):
        calibrate(predict, draw(12, 3, 1)[0])
