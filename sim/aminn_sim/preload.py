"""The statics of a grasp with its contact forces: what the formula of `theory` leaves out.

Contacts stick. When finger and tool turn, the contact forces keep their direction in H, so that their moments about the
joints and about the tool's origin change; and the fingertip rolls, so that the point of contact moves over both
surfaces by s = k_rel^-1 (w_rel x n), with w_rel the fingertip's turn against the tool, n the unit normal out of the
tool and k_rel the sum of both curvatures (D. J. Montana, The kinematics of contact and grasp, Int. J. Robotics
Research 7(3), 1988).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import rotation

Array = NDArray[np.float64]
EPS_M = 1e-6  # m/N, compliance of a sticking contact; any less gives the same


def skew(v: Array) -> Array:
    """[v]x."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def joint_axes(hand: dict, b: int, q: Array, contact: Array) -> tuple[Array, Array]:
    """Axes (3, 3) of a branch in posture q (8), ways (3, 3) from each joint to the contact; a row a coordinate."""
    joints, axes = hand["branch_joints"][b], np.array(hand["axis"][b])
    angle = [q[j] if j >= 0 else 0.0 for j in joints]
    r1 = rotation(axes[0] * angle[0])
    r2 = r1 @ rotation(axes[1] * angle[1])
    base = np.array(hand["base_m"][b])
    knuckle = base + r2 @ np.array(hand["link_a_m"][b])
    return np.stack([axes[0], r1 @ axes[1], r2 @ axes[2]]), np.stack(
        [contact - base, contact - base, contact - knuckle]
    )


def tool_curvature(geom: Array, x_ht: Array, contact: Array) -> Array:
    """Curvature (3, 3; 1/m, H) of a tool's surface at the contact: zero along the normal.

    geom (11) is a row of `tool_geoms`: a cylinder or capsule along x, or an ellipsoid.
    """
    R = rotation(x_ht[3:])
    y = R.T @ (contact - x_ht[:3]) - geom[4:7]
    ellipsoid = int(geom[0]) == 4  # MuJoCo's geom type
    inverse_square = 1 / geom[1:4] ** 2 if ellipsoid else np.array([0, 1, 1]) / geom[1] ** 2
    gradient = inverse_square * y
    n = gradient / np.linalg.norm(gradient)
    tangent = np.eye(3) - np.outer(n, n)
    return R @ (tangent @ np.diag(inverse_square) @ tangent / np.linalg.norm(gradient)) @ R.T


def rolling(hand: dict, grasp: dict[str, Array], b: int) -> Array:
    """How the point of contact of branch b moves, (3, 3): s = rolling @ w_rel; m/rad, H."""
    contact, normal = grasp["contacts"][b, 1:4], grasp["contacts"][b, 4:7]  # the normal points into the tool
    tangent = np.eye(3) - np.outer(normal, normal)
    curvature = tangent @ tool_curvature(grasp["tool_geoms"][0], grasp["x_ht"], contact) @ tangent
    return np.linalg.pinv(curvature + tangent / hand["tip_radius_m"][b], rcond=1e-9) @ skew(normal)


def torque_change(axes: Array, ways: Array, f: Array) -> Array:
    """How the torques of the force -f at the contact change as the joints turn, without rolling (3, 3), N.m/rad."""
    order = [[(min(i, j), max(i, j)) for j in range(3)] for i in range(3)]
    return np.array([[-f @ np.cross(axes[i], np.cross(axes[j], ways[j])) for i, j in row] for row in order])


def displacement(hand: dict, grasp: dict[str, Array], forces: Array, stiffness: Array, w_e: Array) -> Array:
    """Displacement (6) under a small load w_e (6) of a grasp whose contacts press with `forces` (3, 3; N, on the tool).

    stiffness (3, 3, 3): K_b of springs and taut tendons, N.m/rad; any positive number for an absent coordinate.
    The linear system's unknowns are dx (6), dq (3, 3) and the changes of the contact forces (3, 3).
    """
    system, right = np.zeros((24, 24)), np.zeros(24)
    right[:6] = -w_e
    turn = slice(3, 6)  # of the tool
    for b, f in enumerate(forces):
        contact = grasp["contacts"][b, 1:4]
        r, A, B = contact - grasp["x_ht"][:3], grasp["j_x"][b], -grasp["j_q"][b]
        axes, ways = joint_axes(hand, b, grasp["q"], contact)
        roll = rolling(hand, grasp, b)
        by_joints, by_tool = roll @ axes.T, -roll  # the point's way over the tool
        dq, df = slice(6 + 3 * b, 9 + 3 * b), slice(15 + 3 * b, 18 + 3 * b)

        # tool: changed forces, and the moments of the old ones at the moved point, balance the load
        system[:6, df] += A.T
        system[turn, turn] += -skew(f) @ (by_tool - skew(r))
        system[turn, dq] += -skew(f) @ by_joints

        # joints: springs against changed forces, turned axes and the moved point
        lever = np.cross(f, axes)  # torque that a way of the point takes away, row a joint
        system[dq, dq] = stiffness[b] - torque_change(axes, ways, f) + lever @ by_joints
        system[dq, turn] += lever @ by_tool
        system[dq, df] += B.T
        for c in np.flatnonzero(np.linalg.norm(axes, axis=1) == 0):
            system[6 + 3 * b + c] = np.eye(24)[6 + 3 * b + c]  # an absent coordinate does not turn

        # contact: it gives way a little
        system[df, :6] += A
        system[df, dq] += -B
        system[df, df] += EPS_M * np.eye(3)
    return np.linalg.solve(system, right)[:6]
