"""What pushes tell of friction: likelihoods and their combination with a sensor."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from aminn_export.samples.friction import GRID, NOTHING, Evidence, combined, learned
from aminn_hand.sensors import FRICTION_CLASSES, FRICTION_RANGE


def after(*pushes: tuple[float, float], sharp: bool = True) -> NDArray:
    """Likelihoods after pushes: what each asked for, and how far it was off (mm) of a motion of 1 mm."""
    found = NOTHING
    for asked, off in pushes:
        found = learned(found, Evidence(*(np.array(float(v)) for v in (asked, (off * 1e-3) ** 2, 1e-6, sharp))))
    return found


def test_without_pushes_nothing_is_known_but_what_a_sensor_says() -> None:
    assert combined(NOTHING).tolist() == [0, 0, 0]
    for sensor in ([1, 0.6, 0.0], [1, 0.6, 0.05], [1, 0.2, 0.02], [1, 1.4, 0.1]):
        found = combined(NOTHING, np.array(sensor))
        assert found[0] == 1 and abs(found[1] - sensor[1]) < 1e-12
        assert abs(found[2] - sensor[2]) <= 0.01 * sensor[2] + 1e-12, "tails beyond 3.5 deviations are left out"


def test_what_asks_for_little_and_sticks_tells_nothing() -> None:
    assert combined(after(*[(0.2, 0.02)] * 10)).tolist() == [0, 0, 0]


def test_loads_that_stick_say_that_friction_is_more_and_a_slide_that_it_is_less() -> None:
    stuck, slid = combined(after((0.8, 0.05))), combined(after((0.6, 2.0)))
    assert stuck[0] == slid[0] == 1
    assert stuck[1] > 0.85 > 0.65 > slid[1]
    both = combined(after((0.8, 0.05), (0.95, 3.0)))
    assert both[1] - 2 * both[2] < 0.88 < both[1] + 2 * both[2] and both[2] < min(stuck[2], slid[2])


def test_a_guessed_preload_tells_less() -> None:
    sharp, guessed = (combined(after((0.8, 0.05), sharp=s)) for s in (True, False))
    assert guessed[2] > sharp[2]


def test_later_pushes_contradict_earlier_ones() -> None:
    found = after(*[(1.3, 0.02)] * 20)
    assert combined(found)[1] > 1.0
    found = after(*[(1.3, 0.02)] * 20, *[(0.5, 4.0)] * 6)
    assert combined(found)[1] < 0.75


@pytest.mark.parametrize(("name", "least", "most"), [("low", 0.03, 0.2), ("mid", 0.03, 0.1), ("high", 0.0, 0.01)])
def test_a_sensor_and_pushes_are_put_together(name: str, least: float, most: float) -> None:
    sensor, pushed = np.array(FRICTION_CLASSES[name]), after((0.8, 0.05))
    moved = combined(pushed, sensor)[1] - sensor[1]
    assert least < moved < most
    exact = combined(pushed, np.array([1, 0.5, 0.0]))
    np.testing.assert_allclose(exact, [1, 0.5, 0.0], atol=1e-12)


def test_what_is_told_stays_within_the_range() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        pushes = [(rng.uniform(0.1, 2), rng.exponential(1.0)) for _ in range(rng.integers(1, 12))]
        known, mean, deviation = combined(after(*pushes))
        assert known in (0, 1) and 0 <= deviation < 3 and (not known or FRICTION_RANGE[0] <= mean <= FRICTION_RANGE[1])
    assert len(GRID) == 16
