"""What the exporter needs of a model: constants and tables, as `aminn.model.export_tables` gives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import MAX_BRANCHES, MAX_COORDINATES, MIN_BRANCHES, Dims

STAGES = ("s1", "s2")
HAND = "hand_description"
"""Of `meta`: what `Hand.as_dict` gives. A model that was read from a binary file lacks it."""
Tensors = Mapping[str, NDArray[Any]]


class Exported(Protocol):
    """An exported model; `aminn.model.export_tables.ExportedModel` is one."""

    @property
    def meta(self) -> dict:
        """Scalars and names."""

    @property
    def tensors(self) -> dict[str, NDArray[Any]]:
        """float32 tables by name, weights [out][in]; "s1." or "s2." before the name of a stage's own."""


def pair_of(value: object) -> tuple[float, float]:
    """A constant that may be one number or [stage 1, stage 2], as a pair."""
    first, second = value if isinstance(value, (list, tuple)) else (value, value)
    return float(first), float(second)


def dims_of(exported: Exported) -> Dims:
    """The counts of a model and its hand; of tendons those with a gate alone, where `meta` does not have all of them.

    Raises AminnError where `coord_mask` is not that of a hand.
    """
    meta, tensors = exported.meta, exported.tensors
    if "coord_mask" not in tensors:
        raise AminnError("model: tensor coord_mask is missing")
    mask = np.asarray(tensors["coord_mask"])
    hand = mask.ndim == 2 and MIN_BRANCHES <= len(mask) <= MAX_BRANCHES and 1 <= mask.shape[1] <= MAX_COORDINATES
    if not hand or not np.isin(mask, (0, 1)).all() or not mask[:, -1].all() or (np.diff(mask) < 0).any():
        raise AminnError(
            f"model: coord_mask is {mask.tolist()}, expected {MIN_BRANCHES} to {MAX_BRANCHES} branches of 1 to "
            f"{MAX_COORDINATES} coordinates, 1 where a branch has one, 0 for the first ones, which it may lack"
        )
    gates = max(1, int(np.count_nonzero(tensors["tendon_gain_nom"]))) if "tendon_gain_nom" in tensors else 0
    branches, coordinates = mask.shape
    tendons = int(meta.get("tendons", gates))
    dims = Dims(branches, coordinates, int(mask.sum()), tendons, gates, "twist_nom" in tensors)
    dims = replace(dims, slides=bool(meta.get("slides")), sensing=dims.sensed if meta.get("sensing") else 0)
    told = np.size(tensors.get("s1.global_mean", np.zeros(dims.global_input))) - dims.global_input
    stiff = len(tensors["theta_terms"]) - 1 if "theta_terms" in tensors else 0
    return replace(dims, factors=stiff + branches if told == stiff + branches else 0, stiff=stiff)


def by_branch(value: object, branches: int) -> NDArray[np.float64]:
    """(2, B) from a constant that is one number, [stage 1, stage 2], or [stage][branch]."""
    stages = value if isinstance(value, (list, tuple)) else (value, value)
    return np.array([np.broadcast_to(np.asarray(stage, np.float64), branches) for stage in stages])


def shortest(values: NDArray[np.floating]) -> float | list[Any]:
    """The inverse of `by_branch`: one number where all agree, [stage 1, stage 2] where the branches do."""
    if (values == values[:1, :1]).all():
        return float(values[0, 0])
    if (values == values[:, :1]).all():
        return [float(v) for v in values[:, 0]]
    return [[float(v) for v in stage] for stage in values]


def branch_joints(tensors: Tensors) -> list[list[int]]:
    """Index into q of each coordinate (B, C); -1 where a branch lacks it."""
    mask = np.asarray(tensors["coord_mask"])
    numbers = np.cumsum(mask).reshape(mask.shape) - 1
    return [[int(j) for j in row] for row in np.where(mask > 0, numbers, -1)]
