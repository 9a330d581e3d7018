"""A hand opened for simulation: its description, the scene that it is in, and the simulator of both."""

from __future__ import annotations

import hashlib
import itertools
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aminn_base.read import AnyPath, read_bytes
from aminn_hand.hand import Hand

from . import _core
from .errors import SimulationError
from .understand import Understood, understand
from .vary import acts_on


def models_folder() -> Path:
    """Where the hands that come with the project are: in the installed package, or in the source tree."""
    here = Path(__file__)
    candidates = [here.parent / "models", here.parents[1] / "models", Path(_core.__file__).parent / "models"]
    for folder in candidates:
        if (folder / "hand.toml").is_file():
            return folder
    raise SimulationError(f"hand.toml is in none of {', '.join(map(str, candidates))}; install the package again")


def default_hand_file() -> Path:
    """The built-in hand's file."""
    return models_folder() / "hand.toml"


def shipped_hands() -> list[Path]:
    """The built-in hand's file, and those of the other shapes."""
    return [default_hand_file(), *sorted((models_folder() / "hands").glob("*.toml"))]


@dataclass(frozen=True)
class OpenHand:
    """A hand file, read once: what happens to its files later changes nothing."""

    path: Path
    understood: Understood
    text: bytes = field(repr=False)
    """The hand file's own content."""

    @property
    def hand(self) -> Hand:
        """The description."""
        return self.understood.hand

    def simulator(self) -> _core.Simulator:
        """The compiled scene. Raises SimulationError where the engine does not take it."""
        u = self.understood
        if u.hand.synergy is None:
            why = next((n for n in u.notes if "synergy" in n), "none is told")
            raise SimulationError(f"{self.path}: no postures to draw grasps from: {why}")
        try:
            return _core.Simulator(u.scene, u.assets, u.hand, u.parts, acts_on(u.hand))
        except _core.MujocoError as error:
            raise SimulationError(f"{self.path}: the hand cannot be simulated with a tool: {error}") from error

    def largest_gap_m(self, simulator: _core.Simulator) -> float:
        """Widest distance between the fingertips across the pinch within the sampled range."""
        assert self.hand.synergy is not None
        return max(simulator.gap(np.array(psi)) for psi in itertools.product(*self.hand.synergy.ranges))

    def model_hashes(self) -> dict[str, str]:
        """SHA-256 of the hand file, whatever it is called, and of its model's files, by place beside the model."""
        content = {os.path.relpath(path, self.understood.source.parent): c for path, c in self.understood.files.items()}
        content |= {"the hand file": self.text}
        return {name: hashlib.sha256(content[name]).hexdigest() for name in content}

    def files(self) -> list[Path]:
        """The hand file and every file that its model is made of."""
        return [self.path, *self.understood.files]


def open_hand(path: AnyPath | None = None) -> OpenHand:
    """Read a hand file and its model; without a path, the built-in hand's.

    Raises AminnError that says what is wrong, where, and what to do.
    """
    path = Path(path) if path is not None else default_hand_file()
    text = read_bytes(path)
    return OpenHand(path, understand(path, text), text)
