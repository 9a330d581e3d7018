"""The closure of a grasp from what a hand measures: joint angles, tool pose and contacts, with the hand's geometry.

As docs/mechanics.md has it: A_b = [I | -[r]x] with r from the tool's origin to the contact, B_b the motion of the
contact by the branch's joints. Data sets carry both; here they are computed anew, from readings with noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .dims import BRANCH_JOINTS, N_BRANCH
from .nominal import Nominal

Array = NDArray[np.float64]


def rotations(axis: Array, angle: Array) -> Array:
    """Rotation matrices (n, 3, 3) about one unit axis (3) by angles (n)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sin * k + (1 - cos) * (k @ k)


def closure(nominal: Nominal, q: Array, x_ht: Array, contacts: Array) -> tuple[Array, Array]:
    """j_x (n, 3, 3, 6) and j_q (n, 3, 3, 3) from q (n, 8), x_ht (n, 6), contacts (n, 3, 8); zero out of contact."""
    j_x, j_q = np.zeros((len(q), N_BRANCH, 3, 6)), np.zeros((len(q), N_BRANCH, 3, 3))
    for b in range(N_BRANCH):
        axes, point = nominal.axis[b], contacts[:, b, 1:4]
        turn, upper, _ = _links(nominal, b, q)
        s = point - nominal.base[b]
        columns = (
            np.cross(axes[0], s),
            np.cross(turn @ axes[1], s),
            np.cross(upper @ axes[2], s - upper @ nominal.link_a[b]),
        )
        r, zero = point - x_ht[:, :3], np.zeros(len(q))
        minus_cross = np.stack([zero, r[:, 2], -r[:, 1], -r[:, 2], zero, r[:, 0], r[:, 1], -r[:, 0], zero], -1).reshape(
            -1, 3, 3
        )
        j_x[:, b] = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 3, 3)), minus_cross], -1)
        j_q[:, b] = -np.stack(columns, -1)
    c = contacts[..., 0, None, None]
    return c * j_x, c * j_q


def fingertips(nominal: Nominal, q: Array, q_after: Array, points: Array) -> Array:
    """Where points (n, 3, 3) that the distal links hold at angles q (n, 8) are at angles q_after: (n, 3, 3), m."""
    moved = np.empty(points.shape)
    for b in range(N_BRANCH):
        (_, upper, lower), (_, upper_after, lower_after) = (_links(nominal, b, angles) for angles in (q, q_after))
        a, base = nominal.link_a[b], nominal.base[b]
        held = np.swapaxes(lower, -1, -2) @ (points[:, b] - base - upper @ a)[..., None]
        moved[:, b] = base + upper_after @ a + (lower_after @ held)[..., 0]
    return moved


def _links(nominal: Nominal, branch: int, q: Array) -> tuple[Array, Array, Array]:
    """Rotations (n, 3, 3) of what turns with a branch's roll joint, of its proximal and of its distal link."""
    roll, proximal, distal = (
        rotations(axis, q[:, j]) if j >= 0 else np.broadcast_to(np.eye(3), (len(q), 3, 3))
        for axis, j in zip(nominal.axis[branch], BRANCH_JOINTS[branch], strict=True)
    )
    return roll, roll @ proximal, roll @ proximal @ distal
