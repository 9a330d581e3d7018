"""Simulated grasps of a three-finger tendon hand, and their labels under load. Data flows out of here as files."""

from .errors import MissingLibrary, SimulationError

try:
    from . import _core as _core
except ImportError as error:
    raise MissingLibrary(
        f"the simulation's compiled part cannot be loaded ({error}); it needs MuJoCo 2.2: build it again (make "
        "setup-python), or install Debian's package (apt-get install libmujoco2.2.2)"
    ) from error

from .config import SimulationConfig
from .simulate import simulate

__all__ = ["SimulationConfig", "SimulationError", "simulate"]
