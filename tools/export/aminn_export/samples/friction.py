"""What pushes of one grasp tell of its friction, in float64: the oracle of what `aminn_calibrate_push()` learns of it.

A load asks for friction: the largest tangential over normal force among the contacts, if none of them slid. If none
did, friction is more than that, softly; if one did, it is less, but not much, since the grasp held. Whether one did
shows in how much further the tool moved than sticking contacts let it. So each push gives a likelihood of the
coefficient on a fixed grid. What its mean and deviation say beyond the grid's own, with what a sensor says, is what a
model is told.

Leading dimensions (...) are free. SI; scaled motions are m, rotations times the hand's length.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn_hand.sensors import FRICTION_RANGE

Array = NDArray[np.float64]
GRID = np.linspace(FRICTION_RANGE[0], FRICTION_RANGE[1], 16)
"""Coefficients whose likelihood is kept."""
NOTHING = np.ones(len(GRID))
"""Their likelihood before any push."""
UNKNOWN = np.zeros(3)
"""`friction` where no sensor knows it."""
LEAST_PRESSURE_N = 0.01
MOST_RATIO = 8.0
"""Of friction and what was asked for, either way, beyond which nothing changes."""
LEAST_LIKELIHOOD = 1e-6
"""Beside the most likely coefficient's, so that later pushes can contradict earlier ones."""
LEAST_NEWS = 0.02
"""By which share the square of the variance must be less than that of the grid's own for anything to be known."""
DEVIATIONS = np.linspace(-3.5, 3.5, 11)
"""Where a sensor's distribution is looked at, in its standard deviations."""


@dataclass(frozen=True)
class Slips:
    """How slides and friction hang together; found on validation grasps (`aminn_app.friction_study`)."""

    sharpness: float = 16
    """The odds that all contacts stick are the power of it of friction over what was asked for."""
    guessed: float = 8
    """The same where the tool's weight, and so the preload, is not known."""
    motion_m: float = 0.3e-3
    motion_share: float = 0.14
    """A motion that is off by so much, and by this share of its size, tells nothing of a slide."""
    least_odds: float = 0.01
    most_odds: float = 1000.0
    """Of a slide, by the motion: the least and the most."""


USUAL = Slips()


class Evidence(NamedTuple):
    """What a push says of friction."""

    asked: Array  # (...) coefficient that the load asks for if no contact slides
    off: Array  # (...) square of the motion beyond that of sticking contacts, m^2
    size: Array  # (...) square of the latter, m^2
    sharp: Array  # (...) 1 where the tool's weight was known, else 0


class Statics(NamedTuple):
    """Constants of a stage that its values do not tell."""

    eps_m: Array  # (..., B) compliance of each contact, m/N
    eps_kx: float
    twist: Array  # (..., B) stiffness of each contact about its normal, N.m/rad
    length_m: float
    limits: tuple[float, float]  # of a motion, m and rad


def sticking(stage: Mapping[str, Array], x: Mapping[str, Array], s: Statics) -> tuple[Array, Array]:
    """Scaled motion (..., 6) and contact forces (..., B, 3) of a stage's springs and tendons if no contact slides."""
    d, flag, normal = stage["tendon_dir"], x["contacts"][..., 0], x["contacts"][..., 4:7]
    taut = (stage["tendon_gain"] * stage["gate"])[..., None, None]
    k_q = stage["k_spring"] + taut * d[..., :, None] * d[..., None, :]
    b = -x["j_q"]
    scale = np.array([1.0] * 3 + [1.0 / s.length_m] * 3)
    a = x["j_x"] * scale
    m = b @ np.linalg.solve(k_q, np.swapaxes(b, -1, -2)) + s.eps_m[..., None, None] * np.eye(3)
    held = np.linalg.solve(m, a) * flag[..., None, None]  # (..., B, 3, 6)
    k = (np.swapaxes(a, -1, -2) @ held).sum(-3) + s.eps_kx * np.diag(scale**2)
    k[..., 3:, 3:] += np.einsum("...b,...bi,...bj->...ij", flag * s.twist / s.length_m**2, normal, normal)
    motion = np.linalg.solve(k, (x["w_e"] * scale)[..., None])
    return motion[..., 0], (held @ motion[..., None, :, :])[..., 0]


def cut(motion: Array, s: Statics) -> Array:
    """Scaled motions (..., 6) within the limits of a motion."""
    length, angle = (np.linalg.norm(v, axis=-1, keepdims=True) for v in (motion[..., :3], motion[..., 3:]))
    largest = np.maximum(length / s.limits[0], angle / (s.limits[1] * s.length_m))
    return motion / np.maximum(largest, 1.0)


def evidence(
    stage: Mapping[str, Array],
    x: Mapping[str, Array],
    dx_ht: Array,
    s: Statics,
) -> Evidence:
    """What measured motions dx_ht (..., 6) say, by stage 2's values and the inputs x."""
    motion, force = sticking(stage, x, s)
    flag, normal, pressed = x["contacts"][..., 0], x["contacts"][..., 4:7], x["contacts"][..., 7]
    along = (force * normal).sum(-1)
    borne = stage["preload"] - force
    across = borne - (borne * normal).sum(-1, keepdims=True) * normal
    asked = (flag * np.linalg.norm(across, axis=-1) / np.maximum(pressed - along, LEAST_PRESSURE_N)).max(-1)
    motion = cut(motion, s)
    scale = np.array([1.0] * 3 + [s.length_m] * 3)
    off, size = ((v * v).sum(-1) for v in (dx_ht * scale - motion, motion))
    known = x["tool_weight"][..., 0] if "tool_weight" in x else np.zeros(asked.shape)
    return Evidence(asked, off, size, known)


def likelihood(push: Evidence, slips: Slips = USUAL) -> Array:
    """Of each coefficient of `GRID`, (..., 16), up to a factor."""
    ratio = np.clip(GRID / np.maximum(push.asked, 1e-9)[..., None], 1 / MOST_RATIO, MOST_RATIO)
    sticks = ratio ** np.where(push.sharp > 0, slips.sharpness, slips.guessed)[..., None]
    odds = push.off / (slips.motion_m**2 + slips.motion_share**2 * push.size)
    slides = np.clip(odds, slips.least_odds, slips.most_odds)[..., None] * np.minimum(ratio, 1.0) ** 2
    return np.asarray((sticks + slides) / (sticks + 1.0))


def learned(before: Array, push: Evidence, slips: Slips = USUAL) -> Array:
    """Likelihoods (..., 16) after one more push."""
    product = before * likelihood(push, slips)
    return np.asarray(np.maximum(product / product.max(-1, keepdims=True), LEAST_LIKELIHOOD))


def _moments(coefficient: Array, weight: Array) -> tuple[Array, Array]:
    share = weight / weight.sum(-1, keepdims=True)
    mean = (share * coefficient).sum(-1)
    return mean, (share * (coefficient - mean[..., None]) ** 2).sum(-1)


def combined(likelihoods: Array, sensor: Array = UNKNOWN) -> Array:
    """Sensor values `friction` (..., 3) of likelihoods (..., 16) and of what a sensor says (..., 3).

    Without a sensor they are the likelihoods' mean and variance with the grid's own distribution taken out again, as
    networks bring it with them: the more so, the less is learned. Where pushes have told nothing, nothing is known.
    """
    sensor = np.broadcast_to(sensor, (*likelihoods.shape[:-1], 3))
    mean, variance = _moments(GRID, likelihoods)
    own = (variance / GRID.var()) ** 2
    known = 1 - own > LEAST_NEWS
    news = np.where(known, 1 - own, 1.0)
    mean = np.clip((mean - own * GRID.mean()) / news, *FRICTION_RANGE)
    alone = np.stack([np.ones_like(mean), mean, np.sqrt(variance / news)], -1) * known[..., None]
    at = sensor[..., 1:2] + sensor[..., 2:3] * DEVIATIONS
    place = np.clip((at - GRID[0]) / (GRID[1] - GRID[0]), 0, len(GRID) - 1)
    low = np.minimum(place.astype(int), len(GRID) - 2)
    below, above = (np.take_along_axis(likelihoods, low + k, -1) for k in (0, 1))
    weight = np.exp(-(DEVIATIONS**2) / 2) * (below + (place - low) * (above - below))
    weight *= (at > 0) | (sensor[..., :1] == 0)  # there is no coefficient below zero
    mean, variance = _moments(at, weight)
    both = np.stack([np.ones_like(mean), mean, np.sqrt(variance)], -1)
    return np.where(sensor[..., :1] > 0, both, alone)
