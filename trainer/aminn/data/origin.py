"""Which data set a model was trained on, and whether another one may stand in for it.

A checkpoint records the hand, the hash of the configuration, and the hash of all that it was trained on. Data of
another hand are never right. Another configuration or seed is a fair test of a model, but its grasps may be those of
the training.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand import Hand

from ..hand.nominal import nominal_of
from ..model.checkpoint import Checkpoint
from .dataset import Dataset
from .regimes import known


def check_hand(checkpoint: Checkpoint, data: Dataset) -> None:
    """Raises AminnError if the data are of another hand than the model."""
    wrong = differences(checkpoint.model.hand, data.hand)
    if wrong:
        raise AminnError(
            f"{checkpoint.path}: trained for another hand than that of the data set (they differ in "
            f"{', '.join(wrong)}); give data of its own hand"
        )


CONSTANTS = {
    "chol": "springs",
    "tendon_dir": "arms of tendons",
    "tendon_gain": "stiffness of tendons",
    "eps_m": "compliance of contacts",
    "axis": "axes of joints",
    "anchor": "anchors of joints",
}
"""Field of `Nominal` -> what it is of a hand."""


def differences(mine: Hand, other: Hand) -> list[str]:
    """In what two hands differ for a model."""
    if _names(mine) != _names(other):
        return ["branches and joints"]
    own, others = vars(nominal_of(mine)), vars(nominal_of(other))
    wrong = [text for name, text in CONSTANTS.items() if not np.allclose(own[name], others[name], rtol=1e-5, atol=1e-9)]
    if mine.contact.kind != other.contact.kind:
        wrong.append("kind of contact")
    if mine.length_m != other.length_m:
        wrong.append("length_m")
    return wrong


def _names(hand: Hand) -> list[list[str]]:
    return [[branch.name, *(c.joint for c in branch.coordinates)] for branch in hand.branches]


def same_configuration(checkpoint: Checkpoint, data: Dataset) -> bool:
    """Whether the model was trained on data of this configuration and seed, if not on all of them."""
    return bool(checkpoint.meta["data_config_sha256"] == data.manifest["config_sha256"])


def training_set(checkpoint: Checkpoint, data: Dataset) -> Dataset:
    """The part of `data` that the model was made from: all of it, or what the studies train on.

    Its splits are those of the training. Raises AminnError, with what differs, where `data` are not what it was made
    from.
    """
    check_hand(checkpoint, data)
    wanted = checkpoint.meta["identity"]["data_sha256"]
    if data.sha256 == wanted:
        return data
    if same_configuration(checkpoint, data):
        part = _studied(data)
        if part is not None and part.sha256 == wanted:
            return part
    raise AminnError(f"{checkpoint.path}: was not trained on these data: {_difference(checkpoint, data)}")


def training_part(checkpoint: Checkpoint, data: Dataset) -> Dataset:
    """The samples of `training_set` that the weights were fitted to."""
    return data.split("train", float(checkpoint.meta["identity"]["config"].get("train_fraction", 1.0)))


def _studied(data: Dataset) -> Dataset | None:
    try:
        return known(data)
    except (AminnError, KeyError):  # no data set of a study
        return None


def _difference(checkpoint: Checkpoint, data: Dataset) -> str:
    """What tells them apart, and what to do."""
    do = "give the data set that it was trained on"
    if not same_configuration(checkpoint, data):
        mine, other = checkpoint.meta["data_config_sha256"][:12], data.manifest["config_sha256"][:12]
        seed = data.manifest.get("seed", "unknown")
        return f"they are of another configuration or seed (hash {other}, seed {seed}; the model's is {mine}); {do}"
    found = data.split("train").samples["grasp_id"]
    recorded = checkpoint.meta["data"]
    return (
        f"they are of the same configuration, but its training split has {len(found)} load cases of "
        f"{len(np.unique(found))} grasps, the model learned from {recorded.get('train_samples')} of "
        f"{recorded.get('train_grasps')}, or from other shards or another part; {do}"
    )


def states_of(data: Dataset) -> NDArray[np.void]:
    """The grasp that each sample (n) is a load of, by its joint angles and tool pose."""
    rows = np.ascontiguousarray(np.hstack([data.samples["q"], data.samples["x_ht"]]), np.float64)
    return rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
