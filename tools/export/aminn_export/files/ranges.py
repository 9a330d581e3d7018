"""What a model was trained on: the range of each field of the runtime's `aminn_state_t`.

The runtime notes a state outside of it (AMINN_NOTE_OUT_OF_RANGE).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import Dims
from aminn_rt.ranges import state_values

MARGIN = 0.05
"""Share of a field's range that it is widened by on both sides: unseen grasps of the same kind lie a little outside."""


def state_ranges(inputs: dict[str, NDArray]) -> dict[str, NDArray[np.float32]]:
    """`range_min` and `range_max` (S) over samples; a contact's numbers count where it is one."""
    values, counts = state_values(inputs)
    low = np.where(counts, values, np.inf).min(0)
    high = np.where(counts, values, -np.inf).max(0)
    seen = low <= high  # a branch that never was in contact has no range: nothing of it is within
    low, high = np.where(seen, low, 0.0), np.where(seen, high, 0.0)
    margin = MARGIN * (high - low)
    return {"range_min": (low - margin).astype(np.float32), "range_max": (high + margin).astype(np.float32)}


def unknown_ranges(dims: Dims) -> dict[str, NDArray[np.float32]]:
    """Ranges that hold every state: for a model exported without its data."""
    largest = np.finfo(np.float32).max
    bounds = {"range_min": -largest, "range_max": largest}
    return {name: np.full(dims.state, bound, np.float32) for name, bound in bounds.items()}
