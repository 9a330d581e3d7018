"""Where the fingertips of a hand pinch: the tool's long axis and the synergy space, from its closing motion.

The synergy space is that of a closing motion, for random postures have no few directions in common: principal axes of
the postures that put the fingertips on both sides of tools of several sizes and heights, nearest to half closed.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import Branch, Hand, Synergy

Array = NDArray[np.float64]
RADII_M = (0.008, 0.0122, 0.0165, 0.0208, 0.025)
"""Of tools, as `SimulationConfig` draws them by default."""
HEIGHTS_M = (-0.005, 0.0, 0.005)
SHIFTS_M = (0.0, 0.004, -0.004, 0.008, -0.008)
"""Along the pinch, tried in turn for a tool that is not reached in the middle."""
CLEARANCE_M = 0.0025
LIMIT_MARGIN_RAD = 0.05
"""Derived postures stay so far from the joints' limits."""
LEAST_SHARE = 0.01
"""An axis that carries less of the postures' variance is left out."""
SETTLED_M = 1e-7
NEAR_M = 1.5e-3
"""A fingertip that stays farther from its place does not reach it."""
LEAST_SINE = 0.2
"""Directions that are nearer to each other do not tell what is square to both."""
NAMES = ("size", "height", "spread")


def pinch_frame(hand: Hand, q: Array, tool_axis: Array) -> tuple[Array, Array]:
    """Middle of the pinch (3), m, and R (3, 3): columns are tool axis, pinch from the second side to the first, up."""
    tips, (first, second) = hand.tips(q), hand.sides
    ends = tips[list(first)].mean(0), tips[list(second)].mean(0)
    y = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
    x = tool_axis - (tool_axis @ y) * y
    x = x / np.linalg.norm(x)
    return 0.5 * (ends[0] + ends[1]), np.stack([x, y, np.cross(x, y)], 1)


def find_tool_axis(hand: Hand, q: Array) -> Array:
    """(3) unit, H: square to the pinch and to the last links of the wider side at q (J), so that a tool passes by them.

    Where these links lie along the pinch, square to the palm normal instead. Raises AminnError where that does too.
    """
    tips, (first, second) = hand.tips(q), hand.sides
    y = tips[list(first)].mean(0) - tips[list(second)].mean(0)
    y = y / np.linalg.norm(y)
    links = []
    for b in first if len(first) >= len(second) else second:
        _, anchors, _, _ = hand.branches[b].pose(q[hand.branch_joints[b]])
        links.append((tips[b] - anchors[-1]) / np.linalg.norm(tips[b] - anchors[-1]))
    for way in (np.mean(links, axis=0), np.array(hand.palm_normal)):
        axis = np.cross(y, way)
        if np.linalg.norm(axis) > LEAST_SINE:
            axis = axis / np.linalg.norm(axis)
            return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))])) + 0.0
    raise AminnError(
        f"hand {hand.name}: the pinch runs along the palm normal, so that the long axis of a tool does not follow; "
        "tell tool_axis"
    )


def find_synergy(hand: Hand, closing: tuple[Array, Array], reach_m: Array) -> Synergy:
    """Synergy space of a hand that closes from one posture (J) to the other; `reach_m` (B) is the tips' half thickness.

    Raises AminnError where the fingertips reach no tool.
    """
    low, high = (
        np.array([getattr(c, n) for b in hand.branches for c in b.coordinates]) for n in ("low_rad", "high_rad")
    )
    margin = np.minimum(LIMIT_MARGIN_RAD, 0.25 * (high - low))
    limits = low + margin, high - margin
    middle = np.clip(hand.coupled(0.5 * (closing[0] + closing[1])), *limits)
    centre, R = pinch_frame(hand, middle, np.array(hand.tool_axis))
    tools = list(product(RADII_M, HEIGHTS_M, SHIFTS_M))
    centres = np.array([centre + shift * R[:, 1] + height * R[:, 2] for _, height, shift in tools])
    distances = np.array([radius + CLEARANCE_M + reach_m for radius, _, _ in tools])
    postures, reached = _reaching(hand, middle, centres, distances, R, limits)
    tries = reached.reshape(-1, len(SHIFTS_M))
    found = [q[np.argmax(ok)] for q, ok in zip(postures.reshape(*tries.shape, -1), tries, strict=True) if ok.any()]
    if len(found) < 2:
        if not (closing[1] - closing[0]).any():
            raise AminnError(
                f"hand {hand.name}: the fingertips reach no tool of {2e3 * RADII_M[0]:.0f} to {2e3 * RADII_M[-1]:.0f} "
                "mm, and no closing motion is told ([closing] open and closed)"
            )
        found = [closing[0], closing[1]]
    postures = np.array(found)
    neutral = postures.mean(0)
    _, sizes, axes = np.linalg.svd(postures - neutral, full_matrices=False)
    axes = axes[: max(1, min(len(NAMES), int(np.sum(sizes**2 > LEAST_SHARE * np.sum(sizes**2)))))]
    opening = np.array([hand.gap(neutral + 0.02 * a) - hand.gap(neutral - 0.02 * a) for a in axes])
    order = np.argsort(-np.abs(opening))  # the axis that opens most is the size; a larger one opens
    axes = (axes * np.where(opening < 0, -1.0, 1.0)[:, None])[order]
    half = np.abs((postures - neutral) @ axes.T).max(0)
    return Synergy(
        NAMES[: len(axes)],
        tuple(neutral.tolist()),
        tuple(tuple(a) for a in axes.tolist()),
        tuple((1 / (half * _within(neutral, axes * half[:, None], low + 0.6 * margin, high - 0.6 * margin))).tolist()),
        ((-1.0, 1.0),) * len(axes),
    )


def _within(neutral: Array, steps: Array, low: Array, high: Array) -> float:
    """The largest share of `steps` (S, J), to both sides together, that stays within the limits; at most 1."""
    room = np.minimum(high - neutral, neutral - low)
    most = np.abs(steps).sum(0)
    return float(min(1.0, np.min(room[most > 0] / most[most > 0])))


def _reaching(
    hand: Hand, start: Array, centres: Array, distances_m: Array, R: Array, limits: tuple[Array, Array]
) -> tuple[Array, NDArray[np.bool_]]:
    """Postures near `start` (J) whose fingertips lie `distances_m` (N, B) to their sides of `centres` (N, 3), at their
    height: q (N, J), and (N) whether they reach there.

    All are sought side by side, which takes a fiftieth of the time of one after the other. Each has the bits that it
    has alone: matrices are multiplied and solved one by one, so that none sees in which row it stands.
    """
    q, (first, _) = np.tile(start, (len(centres), 1)), hand.sides
    side = np.array([1.0 if b in first else -1.0 for b in range(len(hand.branches))])
    free = [_uncoupled(branch) for branch in hand.branches]
    left = np.arange(len(q))
    for _ in range(100):
        x = q[left]
        off = (hand.tips(x) - centres[left, None]) @ R
        missing = np.stack([side * distances_m[left] - off[..., 1], -off[..., 2]], -1)  # along the pinch, and up
        for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
            J = R[:, 1:].T @ branch.jacobian(x[:, at]) @ free[b]
            Jt = J.swapaxes(-1, -2)
            step = (free[b] @ Jt @ np.linalg.solve(J @ Jt + 1e-6 * np.eye(2), missing[:, b, :, None]))[..., 0]
            x[:, at] = x[:, at] + step * np.minimum(1.0, 0.1 / np.maximum(np.abs(step).max(1, keepdims=True), 1e-9))
        q[left] = hand.coupled(np.clip(x, *limits))
        left = left[~(np.abs(missing).max((1, 2)) < SETTLED_M)]
        if not len(left):
            break
    at_side = np.abs((hand.tips(q) - centres[:, None]) @ R[:, 1] - side * distances_m).max(1) < NEAR_M
    inside = (q >= limits[0] - 1e-9).all(1) & (q <= limits[1] + 1e-9).all(1)
    return q, at_side & inside


def _uncoupled(branch: Branch) -> Array:
    """(C, C) what leaves of a branch's motion that which its couplings let pass."""
    free = np.eye(len(branch.coordinates))
    for c in branch.couplings:
        ratio = np.array(c.ratio)
        free = free - free @ np.outer(ratio, ratio) @ free / max(float(ratio @ free @ ratio), 1e-12)
    return free
