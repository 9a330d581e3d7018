"""The hand's nominal mechanics as the manifest of a data set gives it, in the form of the mechanics layer.

A branch has two tendons, the layer one gated tendon a branch. The gated one is the proximal flexor, which loads do
slacken; the tendon that crosses the distal joint stays taut in every stable grasp, so its stiffness goes into the
springs. That is exact while both tendons are taut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError

from .dims import BRANCH_JOINTS, N_BRANCH, N_COORD

Array = NDArray[np.float64]
# Packed order of a 3x3 lower Cholesky factor in the model: diagonal first, then 10, 20, 21.
CHOL_ROWS = (0, 1, 2, 1, 2, 2)
CHOL_COLS = (0, 1, 2, 0, 0, 1)


@dataclass(frozen=True)
class Nominal:
    """Nominal mechanics and geometry of a hand; coordinates of a branch are roll, proximal, distal."""

    chol: Array  # (3, 6) packed Cholesky factor of the nominal springs; 1 on the diagonal where a coordinate is absent
    tendon_dir: Array  # (3, 3) unit
    tendon_gain: Array  # (3,) N.m/rad
    coord_mask: Array  # (3, 3) 1 where the branch has the coordinate
    base: Array  # (3, 3) m, where the roll and proximal axes of a branch meet
    axis: Array  # (3, 3, 3) unit joint axes at q = 0; zeros where absent
    link_a: Array  # (3, 3) m, base to distal joint at q = 0


NOMINAL_SHAPES: dict[str, tuple[int, ...]] = {
    "chol": (N_BRANCH, 6),
    "tendon_dir": (N_BRANCH, N_COORD),
    "tendon_gain": (N_BRANCH,),
    "coord_mask": (N_BRANCH, N_COORD),
    "base": (N_BRANCH, 3),
    "axis": (N_BRANCH, N_COORD, 3),
    "link_a": (N_BRANCH, 3),
}


def _tendons_of(hand: dict, branch: int) -> list[tuple[Array, float]]:
    """(moment arms (3) m, stiffness N/m) of a branch's tendons; `branch` is an index or a name in the manifest."""
    name = hand["branches"][branch]
    mine = [t for t in hand["tendons"] if t["branch"] in (branch, name)]
    return [(np.asarray(t["moment_arm_m"], float), float(t["stiffness_N_m"])) for t in mine]


def gated_tendons(hand: dict) -> list[int]:
    """For each branch, the number in `hand["tendons"]` of the tendon that the model's gate stands for."""
    gated = []
    for b, name in enumerate(hand["branches"]):
        mine = [i for i, t in enumerate(hand["tendons"]) if t["branch"] in (b, name)]
        gated.append(min(mine, key=lambda i: abs(hand["tendons"][i]["moment_arm_m"][-1])))
    return gated


def nominal_from_hand(hand: dict) -> Nominal:
    """Read the `hand` entry of a manifest. Raises AminnError if it does not describe a three-branch hand."""
    try:
        nominal = _nominal_from_hand(hand)
    except (KeyError, IndexError, TypeError, ValueError) as error:  # LinAlgError is a ValueError
        raise AminnError(f"manifest: hand is damaged ({type(error).__name__}: {error}); simulate again") from error
    for name, shape in NOMINAL_SHAPES.items():
        found = getattr(nominal, name)
        if found.shape != shape or not np.isfinite(found).all():
            raise AminnError(f"manifest: hand gives {name} of shape {found.shape}, expected {shape} finite numbers")
    return nominal


def _nominal_from_hand(hand: dict) -> Nominal:
    joints = tuple(tuple(row) for row in hand["branch_joints"])
    if joints != BRANCH_JOINTS:
        raise AminnError(f"manifest: hand.branch_joints is {joints}, this version knows {BRANCH_JOINTS} alone")
    mask = (np.asarray(BRANCH_JOINTS) >= 0).astype(float)
    chol, directions, gains = np.zeros((N_BRANCH, 6)), np.zeros((N_BRANCH, N_COORD)), np.zeros(N_BRANCH)
    for b in range(N_BRANCH):
        k_spring = np.diag(np.where(mask[b] > 0, np.asarray(hand["joint_stiffness_Nm_rad"][b], float), 1.0))
        tendons = _tendons_of(hand, b)
        if not tendons:
            raise AminnError(f"manifest: hand.tendons has none for branch {hand['branches'][b]}")
        gated = min(range(len(tendons)), key=lambda i: abs(tendons[i][0][-1]))
        for i, (arm, stiffness) in enumerate(tendons):
            if i == gated:
                gains[b] = stiffness * arm @ arm
                directions[b] = -arm / np.linalg.norm(arm)  # a flexor is stretched where its joints extend
            else:
                k_spring += stiffness * np.outer(arm, arm)
        chol[b] = np.linalg.cholesky(k_spring)[CHOL_ROWS, CHOL_COLS]
    geometry = (np.asarray(hand[k], float) for k in ("base_m", "axis", "link_a_m"))
    return Nominal(chol, directions, gains, mask, *geometry)
