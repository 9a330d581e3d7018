"""What all pictures of a hand have in common: a colour for each finger and for the load, and the arrow of a moment."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .hand import Hand

Array = NDArray[np.float64]

BRANCH_COLOURS = ("#1f5fa8", "#3a8f5c", "#8a5aa6", "#c2571a", "#2a8f9e")
"""One a branch, as many as a hand may have."""
LOAD_COLOUR = "#c2182b"
TURN_ANGLE = 1.5 * math.pi
"""How far the curved arrow of a moment goes round."""


def branch_key(hand: Hand) -> list[tuple[str, str]]:
    """Name and colour of each branch."""
    return list(zip((branch.name for branch in hand.branches), BRANCH_COLOURS, strict=False))


def turning(axis: Array, centre: Array, radius: float) -> tuple[Array, Array]:
    """A curved arrow that turns about `axis` by the right hand: its arc (n, 3), and its head (3, 3)."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(z, [1.0, 0, 0] if abs(z[0]) < 0.9 else [0, 1.0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    angle = np.linspace(0, TURN_ANGLE, 40)[:, None]
    arc = centre + radius * (np.cos(angle) * x + np.sin(angle) * y)
    out = math.cos(TURN_ANGLE) * x + math.sin(TURN_ANGLE) * y
    back, tip = 0.3 * radius * np.cross(out, z), arc[-1]  # against the motion there
    return arc, np.stack([tip + back + 0.15 * radius * out, tip, tip + back - 0.15 * radius * out])
