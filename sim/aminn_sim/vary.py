"""Hands that differ from their description: mechanics parameters drawn hand by hand, around those of a given one.

A hand's draw depends on the seed and its number alone. Only factors change what is simulated: joint zeros and the tips'
radius say how a measured state is read, and are 0 in a simulated data set.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import replace
from difflib import get_close_matches
from functools import cache

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import Hand
from aminn_hand.theta import MAX_LOG_FACTOR, Theta

from .config import SimulationConfig
from .errors import SimulationError
from .scene import LEAST_CONTACT_LOG

Array = NDArray[np.float64]


def acts_on(hand: Hand) -> tuple[tuple[str, str, int], ...]:
    """(kind, part, place in theta) of every part of a model that a factor acts on."""
    theta = Theta(hand)
    return tuple((kind, part, i) for (kind, part), i in theta.index.items() if i < theta.factors)


def is_varied(config: SimulationConfig) -> bool:
    """Whether a data set of the configuration tells theta."""
    return config.vary_mechanics > 0 or bool(config.mechanics)


def hand_ids(config: SimulationConfig, grasp_ids: Iterable[int]) -> NDArray[np.int64]:
    """Number of the hand that makes each grasp."""
    return np.fromiter(grasp_ids, np.int64) // config.grasps_per_hand


def draw_theta(config: SimulationConfig, hand: Hand, grasp_ids: Iterable[int]) -> Array | None:
    """Theta (n, P) of each grasp; None where every hand is as described."""
    if not is_varied(config):
        return None
    theta = Theta(hand)
    centre = np.array([config.mechanics.get(p, 0.0) for p in theta.names])

    @cache
    def of_hand(number: int) -> Array:
        drawn = centre.copy()
        for i, name in enumerate(theta.names[: theta.factors]):
            drawn[i] += config.vary_mechanics * (2 * _uniform(config.seed, number, name) - 1)
        return drawn

    return np.stack([of_hand(number) for number in hand_ids(config, grasp_ids).tolist()])


def theta_of(config: SimulationConfig, hand: Hand, grasp_id: int) -> Array | None:
    """Theta (P) of one grasp; None where every hand is as described."""
    drawn = draw_theta(config, hand, [grasp_id])
    return None if drawn is None else drawn[0]


def _uniform(seed: int, hand: int, name: str) -> float:
    """In [0, 1)."""
    draw = hashlib.sha256(f"mechanics {seed} {hand} {name}".encode()).digest()
    return int.from_bytes(draw[:8]) / 2.0**64


def known_mechanics(config: SimulationConfig, hand: Hand) -> tuple[SimulationConfig, list[str]]:
    """The configuration with what of its `mechanics` can be simulated, and notes on the rest.

    Raises SimulationError for a name that is none of the hand's and for a factor that cannot be simulated.
    """
    theta, kept, left_out = Theta(hand), {}, []
    for name, value in config.mechanics.items():
        if name not in theta.names:
            near = get_close_matches(name, theta.names, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(theta.names)}"
            raise SimulationError(f"mechanics: {name!r} is no parameter of the hand {hand.name}; {hint}")
        if theta.names.index(name) < theta.factors:
            kept[name] = value
        elif value != 0:
            left_out.append(name)
    for p in theta.parameters[: theta.factors]:
        least = LEAST_CONTACT_LOG if p.kind == "contact" else -MAX_LOG_FACTOR
        centre, half, most = kept.get(p.name, 0.0), config.vary_mechanics, MAX_LOG_FACTOR
        if not least <= centre - half <= centre + half <= most:
            about = f"{centre:g}" + (f" +- {half:g}" if half else "")
            why = ": a contact's time constant is two time steps at least" if p.kind == "contact" else ""
            raise SimulationError(
                f"mechanics: {p.name} is {about} (logarithm of a factor), expected {_up(least)} to {most:g}{why}"
            )
    notes = [
        f"mechanics: {', '.join(left_out)} say how a measured state is read; they change nothing that is simulated"
    ]
    return replace(config, mechanics=kept), notes if left_out else []


def _up(least: float) -> str:
    """A least value as one reads it, never below."""
    return f"{math.ceil(1000 * least) / 1000:g}"
