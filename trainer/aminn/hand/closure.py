"""The closure of a grasp from what a hand measures: joint angles, tool pose and contacts, with the hand's geometry.

As docs/mechanics.md has it: A_b = [I | -[r]x] with r from the tool's origin to the contact, B_b the motion of the
contact by the branch's joints. Data sets carry both; here they are computed anew, from readings with noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand import Branch, Hand

Array = NDArray[np.float64]


def rotations(axis: Array, angle: Array) -> Array:
    """Rotation matrices (n, 3, 3) about unit axes (n, 3) or (3) by angles (n)."""
    x, y, z = np.broadcast_to(axis, (len(angle), 3)).T
    zero = np.zeros(len(angle))
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sin * k + (1 - cos) * (k @ k)


def _turned(turn: Array, v: Array) -> Array:
    """Vectors (n, 3) or (3) turned by matrices (n, 3, 3)."""
    return (turn @ np.broadcast_to(v, (len(turn), 3))[..., None])[..., 0]


def poses(branch: Branch, q: Array) -> tuple[Array, Array, Array, Array]:
    """`Branch.pose` for many branch angles q (n, c): axes and anchors (n, c, 3), R (n, 3, 3), p (n, 3)."""
    n = len(q)
    turn, origin = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
    axes, anchors = np.empty((n, q.shape[1], 3)), np.empty((n, q.shape[1], 3))
    for c, coordinate in enumerate(branch.coordinates):
        axes[:, c] = _turned(turn, np.array(coordinate.axis))
        anchors[:, c] = origin + _turned(turn, np.array(coordinate.anchor_m))
        turn = turn @ rotations(np.array(coordinate.axis), q[:, c])
        origin = anchors[:, c] - _turned(turn, np.array(coordinate.anchor_m))
    return axes, anchors, turn, origin


def closure(hand: Hand, q: Array, x_ht: Array, contacts: Array) -> tuple[Array, Array]:
    """j_x (n, B, 3, 6) and j_q (n, B, 3, C) from q (n, J), x_ht (n, 6), contacts (n, B, 8); zero out of contact."""
    n, dims = len(q), hand.dims
    j_x, j_q = np.zeros((n, dims.branches, 3, 6)), np.zeros((n, dims.branches, 3, dims.coordinates))
    for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
        point = contacts[:, b, 1:4]
        axes, anchors, _, _ = poses(branch, q[:, at])
        r, zero = point - x_ht[:, :3], np.zeros(n)
        minus_cross = np.stack([zero, r[:, 2], -r[:, 1], -r[:, 2], zero, r[:, 0], r[:, 1], -r[:, 0], zero], -1)
        j_x[:, b] = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), minus_cross.reshape(-1, 3, 3)], -1)
        j_q[:, b, :, dims.coordinates - axes.shape[1] :] = -np.cross(axes, point[:, None] - anchors).swapaxes(1, 2)
    c = contacts[..., 0, None, None]
    return c * j_x, c * j_q


def fingertips(hand: Hand, q: Array, q_after: Array, points: Array) -> Array:
    """Where points (n, B, 3) that the tips hold at angles q (n, J) are at angles q_after: (n, B, 3), m."""
    moved = np.empty(points.shape)
    for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
        _, _, turn, origin = poses(branch, q[:, at])
        _, _, turn_after, origin_after = poses(branch, q_after[:, at])
        moved[:, b] = origin_after + _turned(turn_after @ turn.swapaxes(1, 2), points[:, b] - origin)
    return moved
