"""The statics of a grasp: how far a small load moves the tool, from a hand's description and its contacts.

Contacts stick. Without the contact forces it is the formula of docs/mechanics.md, with nothing learned. With them,
what that leaves out: when finger and tool turn, the contact forces keep their direction in H, so that their moments
about the joints and about the tool's origin change; and the fingertip rolls, so that the point of contact moves over
both surfaces by s = k_rel^-1 (w_rel x n), with w_rel the fingertip's turn against the tool, n the unit normal out of
the tool and k_rel the sum of both curvatures (D. J. Montana, The kinematics of contact and grasp, Int. J. Robotics
Research 7(3), 1988).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import Hand

Array = NDArray[np.float64]
TANGENT_M_N = 1e-9
"""Sticking contacts do not give way in their plane (the engine's last iterations see to that)."""
TWIST_RAD_NM = 1e-3
"""Nor do sticking soft fingers about their normal."""
# MuJoCo's numbers of shapes.
SPHERE, CAPSULE, ELLIPSOID, CYLINDER = 2, 3, 4, 5


@dataclass(frozen=True)
class Contact:
    """A settled contact of a branch."""

    point: Array
    """(3) m, H."""
    normal: Array
    """(3) unit, into the tool, H."""
    force: Array
    """(3) on the tool, N, H."""
    compliance_m_N: float
    """Of the contact along its normal."""
    curvature: Array
    """(3, 3) of the fingertip's and the tool's surface there, added, 1/m, H."""


def skew(v: Array) -> Array:
    """[v]x."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def tangential(normal: Array) -> Array:
    """(3, 3) takes the part along a unit normal out of a vector."""
    return np.eye(3) - np.outer(normal, normal)


def surface_curvature(kind: int, size: Array, position: Array, R: Array, point: Array) -> Array:
    """(3, 3) of a shape's surface at a point, 1/m, zero along the normal; flat and meshed surfaces count as flat.

    kind and size (3) as MuJoCo has them; position (3), R (3, 3) and point (3) in one frame, the result's too.
    """
    y = R.T @ (point - position)
    if kind == ELLIPSOID:
        inverse, gradient = 1 / size**2, y / size**2
    elif kind in (CAPSULE, CYLINDER) and abs(y[2]) < size[1] * 0.999:
        inverse, gradient = np.array([1.0, 1.0, 0.0]) / size[0] ** 2, np.array([y[0], y[1], 0]) / size[0] ** 2
    elif kind in (SPHERE, CAPSULE):
        end = y - np.array([0, 0, np.sign(y[2]) * size[1]]) if kind == CAPSULE else y
        inverse, gradient = np.ones(3) / size[0] ** 2, end / size[0] ** 2
    else:
        return np.zeros((3, 3))
    length = float(np.linalg.norm(gradient))
    if length == 0:
        return np.zeros((3, 3))
    tangent = tangential(gradient / length)
    return np.asarray(R @ (tangent @ np.diag(inverse) @ tangent / length) @ R.T)


def displacement(
    hand: Hand,
    q: Array,
    centre: Array,
    contacts: Mapping[int, Contact],
    w_e: Array,
    preload: bool,
    stiffness: Sequence[Array] | None = None,
) -> Array:
    """Displacement (6) under a small load w_e (6), with the changes that the contact forces bring or without.

    q (J), centre (3) of the tool, contacts by branch. stiffness: K_b (C, C) of each branch, N.m/rad; default: all taut.
    The unknowns are dx (6), dq (J), the changes of the contact forces (3 each) and of soft fingers' moments (1 each).
    Branches without a contact stay.
    """
    n_joint, soft = len(q), hand.contact.kind == "soft_finger"
    size = 6 + n_joint + (4 if soft else 3) * len(contacts)
    system, right = np.zeros((size, size)), np.zeros(size)
    right[:6] = -w_e
    turn = slice(3, 6)  # of the tool
    for b, (at, branch) in enumerate(zip(hand.branch_joints, hand.branches, strict=True)):
        free = slice(6 + at.start, 6 + at.stop)
        system[free, free] += branch.stiffness() if stiffness is None else stiffness[b]
    for k, (b, contact) in enumerate(contacts.items()):
        branch, at = hand.branches[b], hand.branch_joints[b]
        r, f = contact.point - centre, contact.force
        A = np.concatenate([np.eye(3), -skew(r)], 1)
        B = branch.jacobian(q[at], contact.point)
        dq, df = slice(6 + at.start, 6 + at.stop), slice(6 + n_joint + 3 * k, 9 + n_joint + 3 * k)
        system[:6, df] += A.T
        system[dq, df] += B.T
        system[df, :6] += A
        system[df, dq] -= B
        axes, anchors, _, _ = branch.pose(q[at])
        if soft:  # and a moment about the normal, which does not let tip and tool turn against each other
            moment = 6 + n_joint + 3 * len(contacts) + k
            system[turn, moment] = system[moment, turn] = contact.normal
            system[dq, moment] = axes @ contact.normal
            system[moment, dq] = -axes @ contact.normal
            system[moment, moment] = TWIST_RAD_NM
        if not preload:
            system[df, df] += contact.compliance_m_N * np.eye(3)
            continue
        # the contact gives way along its normal
        system[df, df] += contact.compliance_m_N * np.outer(contact.normal, contact.normal) + TANGENT_M_N * np.eye(3)
        tangent = tangential(contact.normal)
        roll = np.linalg.pinv(tangent @ contact.curvature @ tangent, rcond=1e-9) @ skew(contact.normal)
        by_joints, by_tool = roll @ axes.T, -roll  # the point's way over the tool
        # tool: the moments of the old forces at the moved point
        system[turn, turn] += -skew(f) @ (by_tool - skew(r))
        system[turn, dq] += -skew(f) @ by_joints
        # joints: turned axes and the moved point
        lever = np.cross(f, axes)  # torque that a way of the point takes away, row a joint
        system[dq, dq] += -torque_change(axes, contact.point - anchors, f) + lever @ by_joints
        system[dq, turn] += lever @ by_tool
    return np.asarray(np.linalg.lstsq(system, right, rcond=1e-12)[0][:6])


def torque_change(axes: Array, ways: Array, f: Array) -> Array:
    """How the torques of the force -f at the contact change as the joints turn, without rolling (C, C), N.m/rad.

    axes, ways (C, 3): from each joint to the contact.
    """
    order = [[(min(i, j), max(i, j)) for j in range(len(axes))] for i in range(len(axes))]
    return np.array([[-f @ np.cross(axes[i], np.cross(axes[j], ways[j])) for i, j in row] for row in order])
