"""What the simulation raises where the user made a mistake."""

from __future__ import annotations

from importlib.util import find_spec

from aminn_base.errors import AminnError, OutdatedError


class SimulationError(AminnError):
    """Bad configuration or an unusable data set folder. The text says what was wrong, where, and what to do."""


class OutdatedDataError(SimulationError, OutdatedError):
    """The folder holds a data set that is damaged, or of another configuration or version."""


class MissingLibrary(SimulationError, ImportError):
    """The compiled part, or a library that it needs, is not there; also an ImportError."""


def missing_library(error: ImportError) -> MissingLibrary:
    """Of an import of the compiled part that failed: what is missing, and what to do."""
    fetch, install = "tools/setup/mujoco.sh build/mujoco python3", "pip install --force-reinstall --no-deps ."
    again = f"in the sources run `{fetch}`, then `{install}`"
    if find_spec("aminn_sim._core") is None:
        return MissingLibrary(
            "this installation has no simulation: MuJoCo 2.2.2 or Eigen 3.4 (libeigen3-dev) was not there when it was "
            f"built; {again}"
        )
    return MissingLibrary(
        f"the simulation's compiled part cannot be loaded ({error}); install Debian's libmujoco2.2.2, or {again}"
    )
