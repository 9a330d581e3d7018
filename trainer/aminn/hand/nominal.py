"""A hand's nominal mechanics in the form of the mechanics layer: matrices over branch coordinates, right-aligned.

The layer has one gated tendon a branch, the one that loads do slacken (`Branch.gated_tendon`). All others go into the
springs, as couplings and servos do; that is exact while they are taut.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand import Branch, Hand
from aminn_hand.sensors import NOMINAL_FRICTION
from aminn_hand.theta import Theta

Array = NDArray[np.float64]
LEAST_RADIUS_M = 1e-4
"""Nominal radius of the patch of a contact that the hand calls a point, where it is to resist twisting all the same.

A patch of radius r is as stiff about its normal as springs of its compliance at a distance r from the middle.
"""


@dataclass(frozen=True)
class Nominal:
    """Nominal mechanics of a hand of B branches and C coordinates; a shorter branch lacks the first ones."""

    chol: Array  # (B, C(C+1)/2) packed Cholesky factor of the nominal springs; 1 on the diagonal where absent
    tendon_dir: Array  # (B, C) unit; 0 where a branch has no gated tendon
    tendon_gain: Array  # (B,) N.m/rad; 0 where a branch has no gated tendon
    coord_mask: Array  # (B, C) 1 where the branch has the coordinate
    eps_m: Array  # (B,) compliance of each contact, m/N
    twist: Array  # (B,) stiffness of each contact about its normal where fingertips are soft, N.m/rad
    axis: Array  # (B, C, 3) unit joint axes, H, at q = 0; 0 where absent
    anchor: Array  # (B, C, 3) m, a point on each axis, H, at q = 0; 0 where absent


def gated_tendons(hand: Hand) -> list[int]:
    """For each branch, where the tendon that the model's gate stands for is among all tendons; -1 where it has none."""
    starts = accumulate((len(b.tendons) for b in hand.branches), initial=0)
    gated = (b.gated_tendon for b in hand.branches)
    return [-1 if i is None else start + i for start, i in zip(starts, gated, strict=False)]


def nominal_of(hand: Hand) -> Nominal:
    """The layer's constants. Raises AminnError for a branch whose springs do not hold it."""
    n, width = hand.dims.branches, hand.dims.coordinates
    rows, cols = np.transpose(hand.dims.cholesky_entries)
    chol, axis, anchor = np.zeros((n, len(rows))), np.zeros((n, width, 3)), np.zeros((n, width, 3))
    direction, gain = np.zeros((n, width)), np.zeros(n)
    for b, branch in enumerate(hand.branches):
        own = slice(width - len(branch.coordinates), width)
        axis[b, own] = [c.axis for c in branch.coordinates]
        anchor[b, own] = [c.anchor_m for c in branch.coordinates]
        gated = branch.gated_tendon
        springs = np.eye(width)
        springs[own, own] = branch.stiffness([i != gated for i in range(len(branch.tendons))])
        chol[b] = _cholesky(hand, branch, springs)[rows, cols]
        if gated is not None:
            arm = np.zeros(width)
            arm[own] += branch.tendons[gated].arm_m
            gain[b] = branch.tendons[gated].stiffness_N_m * arm @ arm
            direction[b] = -arm / np.linalg.norm(arm)  # a flexor is stretched where its joints extend
    eps_m = np.array([b.eps_m for b in hand.branches])
    twisting = hand.contact.torsional_friction_m
    radius = twisting / NOMINAL_FRICTION if twisting > 0 else LEAST_RADIUS_M
    return Nominal(chol, direction, gain, hand.coordinate_mask, eps_m, radius**2 / eps_m, axis, anchor)


def stiffness_terms(hand: Hand) -> Array:
    """What each part adds to springs and gains, (1 + S, B, C (C + 1)/2 + 1), N.m/rad.

    Springs and gains with theta are row 0 + sum over its S stiffnesses of exp(theta) times their row:
    of each branch K_b packed as its Cholesky factor is, then the gain of the gated tendon.
    """
    theta, width = Theta(hand), hand.dims.coordinates
    rows, cols = np.transpose(hand.dims.cholesky_entries)
    terms = np.zeros((1 + theta.stiff, hand.dims.branches, len(rows) + 1))
    for b, branch in enumerate(hand.branches):
        n = len(branch.coordinates)

        def add(row: int, arm: Array, stiffness: float, b: int = b, n: int = n) -> None:
            whole = np.concatenate([np.zeros(width - n), arm])
            terms[row, b, :-1] += stiffness * np.outer(whole, whole)[rows, cols]

        terms[0, b, :-1] = np.diag([1.0] * (width - n) + [0.0] * n)[rows, cols]
        for coupling in branch.couplings:
            add(0, np.array(coupling.ratio), coupling.stiffness_Nm_rad)
        for i, c in enumerate(branch.coordinates):
            for kind, value in (("spring", c.spring_Nm_rad), ("servo", c.servo_Nm_rad)):
                if value > 0:
                    add(1 + theta.index[kind, c.joint], np.eye(n)[i], value)
        for i, tendon in enumerate(branch.tendons):
            if tendon.stiffness_N_m > 0:
                row, arm = 1 + theta.index["tendon", tendon.name], np.array(tendon.arm_m)
                if i == branch.gated_tendon:
                    terms[row, b, -1] = tendon.stiffness_N_m * arm @ arm
                else:
                    add(row, arm, tendon.stiffness_N_m)
    return terms


def _cholesky(hand: Hand, branch: Branch, springs: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(springs), float)
    except np.linalg.LinAlgError as error:
        raise AminnError(
            f"hand {hand.name}: the springs of branch {branch.name} do not hold it once its gated tendon is slack; "
            "give its joints springs, or tell the gain of what holds them"
        ) from error
