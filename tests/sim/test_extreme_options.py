"""No number of the configuration can crash the simulation, hang it for good, or make it allocate without bound."""

from __future__ import annotations

import math
import re
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aminn_sim import SimulationConfig, SimulationError, _core, simulate
from aminn_sim.config import RANGES
from aminn_sim.open_hand import default_hand_file, open_hand

EXAMPLES = 30
PATIENCE_S = 0.4  # after so long an example is stopped: that it can be is what is shown
DURATIONS = [name for name in _core.OPTION_RANGES if name.endswith("_s") and "_m_" not in name]


class Enough(Exception):
    """Raised where the simulation asks whether to go on."""


def stop_after(seconds: float):
    end = time.monotonic() + seconds

    def progress(done: int) -> None:
        if time.monotonic() > end:
            raise Enough

    return progress


def values(name: str) -> st.SearchStrategy[float]:
    """The ends of an option's range, and values in it, evenly over the decades."""
    low, high = _core.OPTION_RANGES[name]
    ends = st.sampled_from([low, high])
    if isinstance(low, int):
        return st.one_of(ends, st.integers(low, high))
    start = math.log(max(low, 1e-12))
    return st.one_of(ends, st.floats(start, math.log(high)).map(lambda x: min(max(math.exp(x), low), high)))


changes = st.lists(st.sampled_from(list(_core.OPTION_RANGES)), unique=True, min_size=1, max_size=8).flatmap(
    lambda names: st.fixed_dictionaries({name: values(name) for name in names})
)


def in_order(change: dict[str, float]) -> dict[str, float]:
    """The options with the partners that they need: a least value not above its greatest, shares of at most 1."""
    whole = {name: getattr(SimulationConfig(), name) for name in _core.OPTION_RANGES} | {"grasp_attempts": 3} | change
    partners = {name: name.replace("_min", "_max") for name in whole if "_min" in name}
    pairs = [(low, high) for low, high in partners.items() if high in whole]
    pairs += [("drift_stop_m_s", "drift_max_m_s"), ("hold_s", "hold_max_s")]
    for low, high in [*pairs, ("drift_window_s", "hold_s"), ("hold_s", "hold_max_s")]:
        if whole[low] > whole[high]:
            whole[low if high in change else high] = whole[high if high in change else low]
    if whole["drift_window_s"] > whole["hold_s"]:
        whole["drift_window_s"] = whole["hold_s"]
    shares = ("share_force", "share_moment", "share_point_force")
    total = max(1.0, sum(whole[name] for name in shares))
    return whole | {name: whole[name] / total * (1 - 1e-12) for name in shares}


def test_every_extreme_is_simulated_or_given_up_or_stopped(simulator: _core.Simulator, trust: dict) -> None:
    outcomes = {"simulated": 0, "given_up": 0, "stopped": 0}

    @settings(max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(change=changes, family=st.integers(0, 3))
    def examine(change: dict[str, float], family: int) -> None:
        config = SimulationConfig(**in_order(change))
        try:
            simulator.shard(config.options(), 1, 0, 0, 1, 1, 1, [family], stop_after(PATIENCE_S))
            outcomes["simulated"] += 1
        except RuntimeError as error:
            assert "attempts held the tool" in str(error) or isinstance(error, _core.MujocoError), error
            outcomes["given_up"] += 1
        except Enough:
            outcomes["stopped"] += 1

    examine()
    trust |= {f"inputs_extreme_options_{name}": count for name, count in outcomes.items()}
    assert all(count > 0 for count in outcomes.values()), outcomes


OUTSIDE = (math.nan, math.inf, -math.inf, -1, -5e-324, 1.8e308, 10**400, True, None, "1")


@pytest.mark.parametrize("name", RANGES)
def test_what_is_no_number_in_the_range_is_refused_by_name(name: str) -> None:
    for bad in OUTSIDE:
        with pytest.raises(SimulationError, match=f"^configuration: {name} is "):
            SimulationConfig(**{name: bad})


@pytest.mark.parametrize("name", _core.OPTION_RANGES)
def test_compiled_part_refuses_what_python_let_pass(simulator: _core.Simulator, name: str) -> None:
    low, high = _core.OPTION_RANGES[name]
    for bad in (low - 1, high + 1) if isinstance(low, int) else (math.nextafter(low, -1.0), 2 * high, math.nan):
        options = _core.Options()
        setattr(options, name, bad)
        with pytest.raises(ValueError, match=f"{name} is "):
            _core.Session(simulator, options, 1, 0, 0, 0, [0])


@pytest.mark.parametrize("timestep", ["1e-9", "0.002", "0.5"])
def test_the_time_step_is_the_protocols_whatever_the_models_is(tmp_path: Path, timestep: str) -> None:
    """A hand's file brings solver options of its own; the scene has the simulation's."""
    folder = tmp_path / "hand"
    shutil.copytree(default_hand_file().parent, folder)
    model = folder / "three_finger_hand.xml"
    text = model.read_text()
    told, found = re.subn(r"(<compiler [^>]*/>)", rf'\1<option timestep="{timestep}"/>', text, count=1)
    assert found
    model.write_text(told)
    config = SimulationConfig(**dict.fromkeys(DURATIONS, 0.001))
    simulator = open_hand(folder / "hand.toml").simulator()
    simulator.check(config.options())


def test_what_the_disk_cannot_hold_is_refused_before_any_work(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=10**9))
    with pytest.raises(SimulationError, match=r"30000000000 load cases need \S+ GB or more, 1 GB are free"):
        simulate(SimulationConfig(grasps=1_000_000, cases=30_000), tmp_path / "data", progress=False)
    assert not list((tmp_path / "data").iterdir())
