"""Which states the runtime notes as out of range (AMINN_NOTE_OUT_OF_RANGE), in NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import STATE


def state_values(inputs: Mapping[str, NDArray]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The states' numbers (N, S) in the order of the fields, and which count: a contact's where it is one."""
    contacts = np.asarray(inputs["contacts"], np.float64)  # (N, B, 8)
    closed = np.broadcast_to(contacts[..., :1] > 0, contacts.shape).copy()
    closed[..., 0] = True
    fields = [np.asarray(inputs[name], np.float64) for name in STATE]
    values = np.concatenate([v.reshape(len(v), prod(v.shape[1:])) for v in fields], 1)
    counts = np.ones_like(values, bool)
    size = prod(contacts.shape[1:])
    counts[:, values.shape[1] - size :] = closed.reshape(len(closed), size)
    return values, counts


def within_ranges(inputs: Mapping[str, NDArray], ranges: Mapping[str, NDArray[np.float32]]) -> NDArray[np.bool_]:
    """Which states (N,) the runtime does not note; `ranges` has `range_min` and `range_max` (S)."""
    values, counts = state_values(inputs)
    values = values.astype(np.float32)
    inside = (values >= ranges["range_min"]) & (values <= ranges["range_max"])
    return np.asarray((inside | ~counts).all(1))
