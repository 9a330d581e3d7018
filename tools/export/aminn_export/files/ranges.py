"""What a model was trained on: the range of each field of the runtime's `aminn_state_t`.

The runtime notes a state outside of it (AMINN_NOTE_OUT_OF_RANGE).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import STATE, Dims

MARGIN = 0.05
"""Share of a field's range that it is widened by on both sides: unseen grasps of the same kind lie a little outside."""


def _values(inputs: dict[str, NDArray]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The states' numbers (N, S) in the order of the fields, and which count: a contact's where it is one."""
    contacts = np.asarray(inputs["contacts"], np.float64)  # (N, B, 8)
    closed = np.broadcast_to(contacts[..., :1] > 0, contacts.shape).copy()
    closed[..., 0] = True
    n = len(contacts)
    values = np.concatenate([np.asarray(inputs[name], np.float64).reshape(n, -1) for name in STATE], 1)
    counts = np.ones_like(values, bool)
    counts[:, -contacts[0].size :] = closed.reshape(n, -1)
    return values, counts


def state_ranges(inputs: dict[str, NDArray]) -> dict[str, NDArray[np.float32]]:
    """`range_min` and `range_max` (S) over samples; a contact's numbers count where it is one."""
    values, counts = _values(inputs)
    low = np.where(counts, values, np.inf).min(0)
    high = np.where(counts, values, -np.inf).max(0)
    seen = low <= high  # a branch that never was in contact has no range: nothing of it is within
    low, high = np.where(seen, low, 0.0), np.where(seen, high, 0.0)
    margin = MARGIN * (high - low)
    return {"range_min": (low - margin).astype(np.float32), "range_max": (high + margin).astype(np.float32)}


def within_ranges(inputs: dict[str, NDArray], ranges: Mapping[str, NDArray[np.float32]]) -> NDArray[np.bool_]:
    """Which states (N,) the runtime does not note as out of range; `ranges` as of `state_ranges`."""
    values, counts = _values(inputs)
    values = values.astype(np.float32)
    inside = (values >= ranges["range_min"]) & (values <= ranges["range_max"])
    return np.asarray((inside | ~counts).all(1))


def unknown_ranges(dims: Dims) -> dict[str, NDArray[np.float32]]:
    """Ranges that hold every state: for a model exported without its data."""
    largest = np.finfo(np.float32).max
    bounds = {"range_min": -largest, "range_max": largest}
    return {name: np.full(dims.state, bound, np.float32) for name, bound in bounds.items()}
