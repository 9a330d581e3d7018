"""Simulated grasps of a three-finger tendon hand, and their labels under load. Data flows out of here as files."""

from .config import SimulationConfig
from .errors import SimulationError
from .simulate import simulate

__all__ = ["SimulationConfig", "SimulationError", "simulate"]
