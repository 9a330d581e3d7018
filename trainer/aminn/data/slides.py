"""How far contacts slid under their loads: what a simulated load case tells beside its labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import rotation, times

from ..hand.closure import fingertips
from .dataset import Dataset

SLID_M = 0.5e-3
"""A contact that slides further has slipped."""


def slides(data: Dataset) -> NDArray[np.float64]:
    """How far each contact slid by the end of the load (n, B), m: what the tool's point and the finger's point at the
    contact before the load are apart in its tangent plane afterwards, the finger as its joint angles say.

    0 of a branch out of contact. Raises AminnError where the data are measured.
    """
    s = data.samples
    contacts, dx = s["contacts"], s["dx_ht"]
    r = contacts[..., 1:4] - s["x_ht"][:, None, :3]
    tool = s["x_ht"][:, None, :3] + dx[:, None, :3] + times(rotation(dx[:, None, 3:]), r)
    gap = tool - fingertips(data.hand, s["q"], data.simulated("samples", "q_after"), contacts[..., 1:4])
    normal = contacts[..., 4:7]
    return contacts[..., 0] * np.linalg.norm(gap - (gap * normal).sum(-1, keepdims=True) * normal, axis=-1)


def slid_cases(data: Dataset) -> NDArray[np.bool_]:
    """Whether a contact slid further than `SLID_M` (n)."""
    return slides(data).max(1) > SLID_M
