"""The closure of a grasp from what a hand measures: joint angles, tool pose and contacts, with the hand's geometry.

As docs/mechanics.md has it: A_b = [I | -[r]x] with r from the tool's origin to the contact, B_b the motion of the
contact by the branch's joints. Data sets carry both; here they are computed again, from readings with noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand import Hand
from aminn_hand.hand import times

Array = NDArray[np.float64]


def closure(hand: Hand, q: Array, x_ht: Array, contacts: Array) -> tuple[Array, Array]:
    """j_x (n, B, 3, 6) and j_q (n, B, 3, C) from q (n, J), x_ht (n, 6), contacts (n, B, 8); zero out of contact."""
    n, dims = len(q), hand.dims
    j_x, j_q = np.zeros((n, dims.branches, 3, 6)), np.zeros((n, dims.branches, 3, dims.coordinates))
    for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
        point = contacts[:, b, 1:4]
        r, zero = point - x_ht[:, :3], np.zeros(n)
        minus_cross = np.stack([zero, r[:, 2], -r[:, 1], -r[:, 2], zero, r[:, 0], r[:, 1], -r[:, 0], zero], -1)
        j_x[:, b] = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), minus_cross.reshape(-1, 3, 3)], -1)
        j_q[:, b, :, dims.coordinates - len(branch.coordinates) :] = -branch.jacobian(q[:, at], point)
    c = contacts[..., 0, None, None]
    return c * j_x, c * j_q


def fingertips(hand: Hand, q: Array, q_after: Array, points: Array) -> Array:
    """Where points (n, B, 3) that the tips hold at angles q (n, J) are at angles q_after: (n, B, 3), m."""
    moved = np.empty(points.shape)
    for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
        _, _, turn, origin = branch.pose(q[:, at])
        held = times(turn.swapaxes(1, 2), points[:, b] - origin)
        moved[:, b] = branch.moved(q_after[:, at], held)
    return moved
