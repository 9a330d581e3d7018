"""A compiled simulator, a few grasps and a small data set, made once a test run."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_data import SMALL

from aminn_sim import SimulationConfig, _core, simulate
from aminn_sim.open_hand import open_hand


@pytest.fixture(scope="session")
def simulator() -> _core.Simulator:
    return open_hand().simulator()


@pytest.fixture(scope="session")
def sessions(simulator: _core.Simulator) -> dict[str, _core.Session]:
    """A grasp of each tool family."""
    options = SimulationConfig().options()
    return {
        name: _core.Session(simulator, options, 11, 0, index, index, [index])
        for index, name in enumerate(_core.TOOL_FAMILIES)
    }


@pytest.fixture(scope="session")
def dataset_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of `SMALL`."""
    folder = tmp_path_factory.mktemp("simulated") / "data"
    simulate(SimulationConfig(**SMALL), folder, threads=2, progress=False)
    return folder
