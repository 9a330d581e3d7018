"""The order in which ONNX graph and C have the mechanics head's outputs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import Dims

PARTS = ("diagonal", "gain", "alpha", "twist", "below", "friction", "direction", "beta", "rho", "preload")
"""Of `Dims.head_parts`: what goes through tanh and then exp, what goes through tanh alone, the rest."""
TANH = ("diagonal", "gain", "alpha", "twist", "below", "friction")
EXP = ("diagonal", "gain", "alpha", "twist")


def head_order(dims: Dims, parts: tuple[str, ...] = PARTS) -> NDArray[np.int64]:
    """Places in a branch's row of the exported head, in the order of `parts`, of which it may lack some."""
    row = np.arange(dims.branch_head)
    return np.concatenate([row[dims.head_parts[part]] for part in parts if part in dims.head_parts])


def sizes(dims: Dims, parts: tuple[str, ...]) -> list[int]:
    """Numbers of a branch in each of these parts, those alone that the hand has."""
    return [part.stop - part.start for name in parts if (part := dims.head_parts.get(name)) is not None]
