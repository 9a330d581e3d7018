"""The configuration: one set of defaults in two languages, and clear words for what cannot be simulated."""

from __future__ import annotations

import dataclasses
import math

import pytest

from aminn_sim import SimulationConfig, SimulationError, _core, simulate


def test_defaults_are_those_of_the_compiled_part() -> None:
    config, options = SimulationConfig(), _core.Options()
    assert {n: getattr(config, n) for n in _core.OPTION_RANGES} == {n: getattr(options, n) for n in _core.OPTION_RANGES}
    python_only = {"grasps", "cases", "seed", "shard_grasps", "families"}
    python_only |= {"vary_mechanics", "grasps_per_hand", "mechanics"}
    assert {f.name for f in dataclasses.fields(config)} == python_only | set(_core.OPTION_RANGES)


def test_options_carry_every_value() -> None:
    changed = {n: getattr(SimulationConfig(), n) for n in _core.OPTION_RANGES}
    changed |= {"force_max_N": 5.0, "grasp_attempts": 17, "rotation_max_rad": 0.2}
    options = SimulationConfig(**changed).options()
    assert {n: getattr(options, n) for n in _core.OPTION_RANGES} == changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grasps": 0}, "grasps is 0, expected 1 to 4 294 967 296"),
        ({"grasps": 10**12}, "grasps is 1000000000000, expected 1 to"),
        ({"grasps": 2**32}, "4294967296 grasps make more than 100000 shards of 32"),
        ({"cases": 10**12}, "cases is 1000000000000, expected 1 to 1 000 000"),
        ({"cases": 10**6}, "1000000 cases a grasp make shards of 32000000 cases, the most is 1000000"),
        ({"seed": 2**64}, "seed is 18446744073709551616, expected 0 to 2^64 - 1"),
        ({"drift_window_s": 0.0004}, "drift_window_s is 0.0004, expected 0.001 to 60"),
        ({"hold_max_s": 1e12}, "hold_max_s is 1000000000000.0, expected 0.001 to 600"),
        ({"cases": 2.5}, "cases is 2.5, expected an integer"),
        ({"seed": -1}, "seed is -1"),
        ({"ramp_s": math.nan}, "ramp_s is nan, expected a finite number"),
        ({"force_max_N": "12"}, "force_max_N is '12'"),
        ({"families": ()}, "families are"),
        ({"families": ("capsule", "spoon")}, "expected some of cylinder, capsule, ellipsoid, screwdriver"),
        ({"families": ("capsule", "capsule")}, "names one twice"),
        ({"mass_min_kg": 0.5}, "mass_min_kg 0.5 is above mass_max_kg 0.3"),
        ({"share_force": 0.9}, "at most 1 together"),
        ({"drift_window_s": 0.5}, "longer than hold_s"),
        ({"noise_share": 1.5}, "noise_share is 1.5, expected 0 to 1"),
        ({"drift_stop_m_s": 1e-3}, "drift_stop_m_s 0.001 is above drift_max_m_s"),
        ({"stop_factor": 0.5}, "stop_factor is 0.5"),
        ({"vary_mechanics": -0.1}, "vary_mechanics is -0.1, expected 0 to 1.38629"),
        ({"mechanics": [0.1]}, "mechanics is [0.1], expected numbers by parameter"),
        ({"mechanics": {"contact_thumb": math.inf}}, "mechanics.contact_thumb is inf, expected a finite number"),
    ],
)
def test_impossible_configurations_say_why(change: dict, message: str) -> None:
    with pytest.raises(SimulationError) as caught:
        SimulationConfig(**change)
    assert message in str(caught.value)


def test_grasps_that_never_succeed_end_with_advice(tmp_path) -> None:
    config = SimulationConfig(grasps=2, cases=1, contact_force_min_N=100.0, grasp_attempts=3)
    with pytest.raises(SimulationError, match=r"shard 0: grasp [01]: none of 3 attempts held the tool .most often"):
        simulate(config, tmp_path / "data", threads=2, progress=False)
    assert list((tmp_path / "data").iterdir()) == []
