"""Optional sensors: classes of friction, how much is trusted, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import HANDS, hand

from aminn_hand import sensors
from aminn_hand.sensors import CLASS_EDGES, CLASS_NAMES, FRICTION_CLASSES, FRICTION_RANGE, NOMINAL_FRICTION
from aminn_sim.config import SimulationConfig

DIMS = hand().dims


def test_sizes_follow_from_the_hand() -> None:
    assert DIMS.sensors == {"friction": (3,), "tool_weight": (4,), "tendon_tension": (1 + DIMS.tendons,)}
    assert DIMS.sensed == 2 + 4 + 1 + DIMS.tendons and DIMS.sensing == 0
    bare = HANDS["4x4 no tendons"].dims
    assert list(bare.sensors) == ["friction", "tool_weight"] and bare.sensed == 6
    sensing = replace(DIMS, sensing=DIMS.sensed)
    assert sensing.global_input == DIMS.global_input + DIMS.sensed and sensing.inputs == DIMS.inputs
    assert list(sensors.UNITS) == list(DIMS.sensors)


def test_classes_are_thirds_of_the_friction_that_is_simulated() -> None:
    assert FRICTION_RANGE == (SimulationConfig().friction_min, SimulationConfig().friction_max)
    mu = np.random.default_rng(0).uniform(*FRICTION_RANGE, 30_000)
    found = sensors.class_of(mu)
    for k, name in enumerate(CLASS_NAMES):
        known, middle, deviation = FRICTION_CLASSES[name]
        own = mu[found == k]
        assert known == 1 and len(own) / len(mu) == pytest.approx(1 / 3, abs=0.01)
        assert (middle, deviation) == pytest.approx((own.mean(), own.std()), rel=0.01)
    assert sensors.class_of(np.array([0.1, CLASS_EDGES[0], CLASS_EDGES[1], 5.0])).tolist() == [0, 1, 2, 2]


def test_trust_goes_from_exact_to_unknown() -> None:
    friction = np.array([[0, 0, 0], [0, 0.4, 0], [1, 0.4, 0], [1, 0.4, 0.12], [1, 0.4, 1e6]])
    np.testing.assert_allclose(sensors.trust(friction), [0, 0, 1, 0.5, 0], atol=1e-9)
    told = [NOMINAL_FRICTION, NOMINAL_FRICTION, 0.4, (0.4 * NOMINAL_FRICTION) ** 0.5, NOMINAL_FRICTION]
    np.testing.assert_allclose(sensors.told_friction(friction), told, rtol=1e-9)


def test_what_networks_see_of_sensors() -> None:
    weight, tension = np.array([[1, 0.5, -2, 3]]), np.array([[1, *range(DIMS.tendons)]])
    seen = sensors.sensed_numbers(DIMS, {"tool_weight": weight, "tendon_tension": tension}, 1)
    np.testing.assert_array_equal(seen, [[0, 0, 1, 0.5, -2, 3, 1, *range(DIMS.tendons)]])
    unknown = {"tool_weight": weight * [0, 1, 1, 1], "friction": np.array([[0, 0.4, 0.1]])}
    np.testing.assert_array_equal(sensors.sensed_numbers(DIMS, unknown, 1), np.zeros((1, DIMS.sensed)))
    exact = sensors.sensed_numbers(DIMS, {"friction": np.array([[1, 1.5, 0]])}, 1)
    np.testing.assert_allclose(exact[0, :2], [1, np.log(2)])


@pytest.mark.parametrize(
    ("name", "row", "message"),
    [
        ("friction", [1, np.nan, 0], "friction is not finite"),
        ("friction", [0.5, 0.7, 0], "friction: known is neither 0 nor 1"),
        ("friction", [1, 0, 0], "friction: the coefficient is not positive"),
        ("friction", [1, 0.7, -0.1], "friction: the standard deviation is negative"),
        ("tool_weight", [2, 0, 0, 0], "tool_weight: known is neither 0 nor 1"),
        ("tool_weight", [0, np.inf, 0, 0], "tool_weight is not finite"),
    ],
)
def test_what_no_sensor_says(name: str, row: list[float], message: str) -> None:
    good = np.zeros(len(row))
    found = {text: rows.tolist() for rows, text in sensors.faults(name, np.array([good, row])) if rows.any()}
    assert found == {message: [False, True]}
