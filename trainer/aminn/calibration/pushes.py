"""Measured pushes of a hand, and what a model says of them with given mechanics."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand import Hand
from aminn_hand.hand import STATE
from aminn_table import Map, complete, read_table
from aminn_table.bags import is_bag
from aminn_table.columns import PUSH

from ..data.dataset import Dataset, load_dataset
from ..data.origin import check_hand
from ..evaluation.metrics import pose_error, pose_size
from ..evaluation.predict import true_states
from ..model.baseline import Mlp
from ..model.checkpoint import Checkpoint
from ..model.network import Aminn

Array = NDArray[np.float64]
CHUNK = 4096
HELD = "calibration needs pushes that move the tool and leave it in the grasp"
FIELDS = (*STATE, "dx_ht")


@dataclass(frozen=True)
class Pushes:
    """Pushes (n) that the grasp held: the state before the load as it was measured, the load, and the tool's motion.

    Units and frames are those of a data set.
    """

    hand: Hand
    q: Array  # (n, J) rad
    x_ht: Array  # (n, 6) m, rad
    w_e: Array  # (n, 6) N, N.m
    contacts: Array  # (n, B, 8)
    dx_ht: Array  # (n, 6) m, rad
    grasp_id: NDArray[np.int64]  # (n)

    def __len__(self) -> int:
        return len(self.grasp_id)

    def take(self, index: NDArray) -> Pushes:
        """Those that `index` (indices or a mask) selects."""
        return replace(self, **{name: getattr(self, name)[index] for name in (*FIELDS, "grasp_id")})

    def told(self, **fields: Array) -> Pushes:
        """The same pushes with other readings."""
        return replace(self, **cast(Any, fields))

    def repeated(self, count: int) -> Pushes:
        """All of them `count` times in turn."""
        return self.take(np.tile(np.arange(len(self)), count))

    @property
    def grasps(self) -> NDArray[np.int64]:
        """Number (n) of each push's grasp, from 0."""
        return np.unique(self.grasp_id, return_inverse=True)[1]


def pushes_of(data: Dataset) -> Pushes:
    """The stable load cases of a data set. Raises AminnError where there is none."""
    held = data.take(data.samples["stable"] > 0)
    if not len(held):
        raise AminnError(f"none of the {len(data)} pushes was held; {HELD}")
    fields = {name: np.asarray(held.samples[name], np.float64) for name in FIELDS}
    return Pushes(data.hand, **fields, grasp_id=np.asarray(held.samples["grasp_id"], np.int64))


def scaled(dx: Array, length_m: float) -> Array:
    """Displacements (..., 6) in units of the pose error: translations over L, rotations in rad."""
    return dx / np.repeat([length_m, 1.0], 3)


def relative_errors(predicted: Array, pushes: Pushes) -> Array:
    """Pose error of each push's displacement (n) over its size."""
    length_m = pushes.hand.length_m
    return pose_error(predicted, pushes.dx_ht, length_m) / np.maximum(pose_size(pushes.dx_ht, length_m), 1e-9)


Predict = Callable[[Pushes, Array], Array]
"""Displacements (n, 6) of pushes with theta (n, P)."""


def predictor(model: Aminn | Mlp) -> Predict:
    """The model's motion in double precision, of measured states: theta corrects these, the closure follows."""
    stage = copy.deepcopy(model.stage2).double().eval()

    def predict(pushes: Pushes, theta: Array) -> Array:
        x = true_states(pushes.hand, pushes.q, pushes.x_ht, pushes.w_e, pushes.contacts, theta)
        inputs = {name: torch.as_tensor(value) for name, value in x.items()}
        parts = []
        with torch.no_grad():
            for start in range(0, len(pushes), CHUNK):
                out = stage({name: value[start : start + CHUNK] for name, value in inputs.items()})
                parts.append(out[0] if isinstance(out, tuple) else out)
        return np.asarray(torch.cat(parts).numpy(), np.float64)

    return predict


def read_pushes(path: AnyPath, checkpoint: Checkpoint, by: Map | None = None) -> tuple[Pushes, tuple[str, ...]]:
    """The pushes that held of a data set, a table or a ROS 2 bag; and notes: missing sensors, pushes left out.

    `by` says where a table or bag has what is called otherwise here. Raises AminnError for another hand than the
    checkpoint's, and for whatever is wrong with the data.
    """
    if Path(path).is_dir() and not is_bag(path):
        if by is not None:
            raise AminnError(f"{path}: a data set takes no map; give --map with a table or a bag")
        data = load_dataset(path)
        check_hand(checkpoint, data)
        pushes = pushes_of(data)
        return pushes, _left_out(len(data), len(pushes))
    hand = checkpoint.model.hand
    table, notes = complete(hand, read_table(path, hand, PUSH, by))
    held = np.asarray(table.get("stable", np.ones(len(table["q"])))) > 0
    if not held.any():
        raise AminnError(f"{path}: none of the {len(held)} pushes was held; {HELD}")
    fields = {name: np.asarray(table[name], np.float64)[held] for name in FIELDS}
    states = np.concatenate([fields["q"], fields["x_ht"]], 1)
    grasps = table["grasp_id"][held] if "grasp_id" in table else np.unique(states, axis=0, return_inverse=True)[1]
    pushes = Pushes(hand, **fields, grasp_id=np.asarray(grasps, np.int64))
    return pushes, (*notes, *_left_out(len(held), len(pushes)))


def _left_out(given: int, held: int) -> tuple[str, ...]:
    return (f"{held} of {given} pushes held; the others are left out",) if held < given else ()
