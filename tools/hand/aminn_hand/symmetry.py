"""The plane that carries a hand onto itself, if there is one."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from .hand import Branch, Hand, Mirror

Array = NDArray[np.float64]
NEAR_M = 1e-6
"""Points that are nearer than this are one; of unit vectors the same number."""
NEAR = 1e-6
"""Relative difference of stiffnesses and limits that are one."""


def mirror_in(hand: Hand, normal: Array) -> Mirror | None:
    """The mirror of a plane through H's origin with this normal (3), or None where the hand is not its own image."""
    length = float(np.linalg.norm(normal))
    if length == 0:
        return None
    unit = normal / length
    numbers = range(len(hand.branches))
    images = [[j for j in numbers if _is_image(hand.branches[i], hand.branches[j], unit)] for i in numbers]
    for order in permutations(numbers):
        if all(j in images[i] for i, j in enumerate(order)):
            return Mirror(tuple(unit.tolist()), order)
    return None


def find_mirror(hand: Hand) -> Mirror | None:
    """A mirror under which branches change places, found from their fingertips at q = 0."""
    tips = [np.array(b.tip_point_m) for b in hand.branches]
    for i, j in combinations(range(len(tips)), 2):
        mirror = mirror_in(hand, tips[i] - tips[j])
        if mirror is not None and mirror.branches[i] == j:
            return mirror
    return None


def _is_image(one: Branch, other: Branch, n: Array) -> bool:
    """Whether equal joint angles of both branches are mirror images of each other."""
    if len(one.coordinates) != len(other.coordinates):
        return False
    flip = np.eye(3) - 2 * np.outer(n, n)
    if np.abs(flip @ one.tip_point_m - other.tip_point_m).max() > NEAR_M:
        return False
    for a, b in zip(one.coordinates, other.coordinates, strict=True):
        apart = flip @ a.anchor_m - b.anchor_m
        if (
            np.abs(-(flip @ a.axis) - b.axis).max() > NEAR  # an axis turns, so its image is the other way round
            or np.abs(np.cross(apart, b.axis)).max() > NEAR_M
            or not _close(
                (a.low_rad, a.high_rad, a.spring_Nm_rad, a.servo_Nm_rad, a.reference_rad),
                (b.low_rad, b.high_rad, b.spring_Nm_rad, b.servo_Nm_rad, b.reference_rad),
            )
        ):
            return False
    taut = one.stiffness(), other.stiffness()
    return _close(taut[0].ravel(), taut[1].ravel()) and _close((one.eps_m,), (other.eps_m,))


def _close(a: object, b: object) -> bool:
    return bool(np.allclose(np.asarray(a, float), np.asarray(b, float), rtol=NEAR, atol=1e-12))
