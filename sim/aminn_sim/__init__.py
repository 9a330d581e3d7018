"""Simulated grasps of a three-finger tendon hand, and their labels under load. Data flows out of here as files."""

from .errors import SimulationError, missing_library

try:
    from . import _core as _core
except ImportError as error:
    raise missing_library(error) from error

from .config import SimulationConfig
from .simulate import simulate

__all__ = ["SimulationConfig", "SimulationError", "simulate"]
