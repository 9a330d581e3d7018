"""Theta from pushes: the most probable one, and how far it is determined.

What a model says of a push is wrong in two ways. Each push has an error of its own, relative to its motion and now and
then large (a slip): Student's t. And all pushes of a grasp share one, as if the hand had other stiffnesses in that
grasp: each grasp has deviations from theta of its own, drawn from a Gaussian. So ten pushes of one grasp say less than
ten of ten. Both are found together with theta, by Levenberg and Marquardt's method with weights for the t.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import lgamma
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import N_WRENCH
from aminn_hand.theta import MAX_LOG_FACTOR, MAX_RADIUS_M, MAX_ZERO_RAD, Theta

from .pushes import Array, Predict, Pushes, scaled

Mask = NDArray[np.bool_]
STEPS = {"zero": 1e-3, "radius": 1e-4}
"""Of central differences, rad and m; that of a logarithm is `LOG_STEP`."""
LOG_STEP = 0.02
LEAST_MOTION = 1e-6
"""Of a push, in units of the pose error: 0.1 um."""
ENOUGH, MOST_DAMPING = 0.05, 1.0
"""Gain of the loss below which a fit is done, and the damping above which it gives up."""
BIAS = {"spring": 0.34, "servo": 0.03, "tendon": 0.055, "contact": 0.95, "zero": 0.005, "radius": 0.0002}
"""Of a model told the stiffnesses of 2000 hands (`make calibrate`); kinds that are not named have none."""
MOST_GRASPS = 40
"""As many are looked at for a model's errors."""
BIAS_PUSHES, BIAS_DRAWS = ((10, 2), (40, 5)), 2
"""(pushes, grasps) of the fits that the bias is found from, and how many of each hand."""
BIAS_SWEEPS, HELD = 2, 0.9
"""Rounds over the kinds, and the share that intervals are to hold."""
MOST_BIAS = {"zero": 0.1, "radius": 0.01}
"""The greatest bias that is tried; 1 for logarithms."""
Z90 = 1.645
"""Standard deviations on each side of an interval that holds 90 %."""
FREEDOMS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
"""Degrees of freedom among which one is chosen."""


@dataclass(frozen=True)
class Prior:
    """Standard deviations of theta before anything is measured; its mean is zero, the hand's description."""

    log: float = 0.3
    """Of the logarithm of a factor: 0.3 is what a stiffness drawn within exp(+-0.5) has."""
    zero_rad: float = 0.02
    """Of a joint's zero."""
    radius_m: float = 0.001
    """Of the tips' radius."""

    def __post_init__(self) -> None:
        """Raises AminnError for what is no deviation, or beyond the bound of what it is of."""
        for name, most in (("log", MAX_LOG_FACTOR), ("zero_rad", MAX_ZERO_RAD), ("radius_m", MAX_RADIUS_M)):
            value = getattr(self, name)
            if not 0 < value <= most:  # nor where it is NaN
                raise AminnError(f"prior: {name} is {value:g}, expected more than 0 and at most {most:g}")

    def sd(self, space: Theta) -> Array:
        """(P) in the order of theta."""
        kinds = {"zero": self.zero_rad, "radius": self.radius_m}
        return np.array([kinds.get(p.kind, self.log) for p in space.parameters])


@dataclass(frozen=True)
class Errors:
    """How wrong a model is of a hand whose theta it is told; that of `make calibrate`, where nothing is known."""

    relative: float = 0.0076
    """Scale of a push's own error, each of six components, over the size of its motion."""
    deviation: float = 0.1
    """Standard deviation of each grasp's own deviations, in logarithms of factors."""
    freedom: float = 1.0
    """Of Student's t: the fewer, the more slips are expected."""
    bias: Mapping[str, float] = field(default_factory=lambda: dict(BIAS))
    """Standard deviations of what all grasps of a hand have in common and no number of pushes averages out, in
    units of theta, by kind of parameter."""
    floor: float = 1e-5
    """Of a push's error, in units of the pose error: what the measurement of motion is good for."""


START = Errors(relative=0.015, deviation=0.1, freedom=1.5)
"""What errors are looked for from; a tenth of it is the least that is found."""


@dataclass(frozen=True)
class Fit:
    """The most probable theta, which predicts best; and what it says of the hand's own."""

    theta: Array  # (P)
    mean: Array  # (P) of the hand's own: `theta` drawn towards zero as far as the model's bias could have made it
    covariance: Array  # (P, P) of the hand's own, about `mean`
    deviations: Array  # (G, P) of each grasp, zeros and radius 0
    loss: float
    """Negative logarithm of the posterior density at theta and deviations, but for a constant."""
    weights: Array  # (n) what each push counts, 1 or more where it fits, about 0 for a slip
    evidence: float
    """Logarithm of the probability of the pushes, whatever theta and deviations are, but for a constant."""

    @property
    def sd(self) -> Array:
        """(P) standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def steps_of(space: Theta) -> Array:
    """(P) steps of central differences."""
    return np.array([STEPS.get(p.kind, LOG_STEP) for p in space.parameters])


class Problem:
    """Residuals and derivatives of one fit; unknown are theta's free entries, then each grasp's deviations.

    centre: theta (P) or (n, P) where the unknowns are zero. noise: (n) standard deviation of each component of a push's
    displacement beside the model's own error, in units of the pose error.
    """

    def __init__(
        self,
        predict: Predict,
        pushes: Pushes,
        prior: Prior,
        errors: Errors,
        free: Mask | None = None,
        centre: Array | None = None,
        noise: Array | None = None,
    ) -> None:
        self.predict, self.pushes, self.errors, self.space = predict, pushes, errors, Theta(pushes.hand)
        size = np.linalg.norm(scaled(pushes.dx_ht, pushes.hand.length_m), axis=1)
        own = np.hypot(errors.relative * np.maximum(size, LEAST_MOTION), errors.floor)
        self.scale = own if noise is None else np.hypot(own, noise)
        self.grasp = pushes.grasps
        self.n_grasps = int(self.grasp.max()) + 1
        self.centre = np.zeros(len(self.space)) if centre is None else centre
        self.places = np.arange(len(self.space)) if free is None else np.flatnonzero(free)
        self.own = np.arange(self.space.factors if errors.deviation > 0 else 0)
        of_grasps = np.full(self.n_grasps * len(self.own), max(errors.deviation, 1e-9) ** -2)
        self.precision = np.concatenate([prior.sd(self.space)[self.places] ** -2, of_grasps])

    def split(self, u: Array) -> tuple[Array, Array]:
        """theta (P) beyond the centre, and deviations (G, P), of unknowns u."""
        theta, deviations = np.zeros(len(self.space)), np.zeros((self.n_grasps, len(self.space)))
        theta[self.places] = u[: len(self.places)]
        deviations[:, self.own] = u[len(self.places) :].reshape(self.n_grasps, -1)
        return theta, deviations

    def _rows(self, u: Array) -> Array:
        """theta (n, P) of each push."""
        theta, deviations = self.split(u)
        return self.centre + theta + deviations[self.grasp]

    def _residual(self, dx: Array, times: int = 1) -> Array:
        measured, scale = np.tile(self.pushes.dx_ht, (times, 1)), np.tile(self.scale, times)
        return scaled(measured - dx, self.pushes.hand.length_m) / scale[:, None]

    def residual(self, u: Array) -> Array:
        """(n, 6) in standard deviations."""
        return self._residual(self.predict(self.pushes, self._rows(u)))

    def loss(self, u: Array, residual: Array) -> float:
        """Negative logarithm of the posterior density, but for a constant."""
        nu, square = self.errors.freedom, (residual**2).sum(1)
        return float(0.5 * (nu + N_WRENCH) * np.log1p(square / nu).sum() + 0.5 * (self.precision * u * u).sum())

    def weights(self, residual: Array) -> Array:
        """(n) of each push."""
        return (self.errors.freedom + N_WRENCH) / (self.errors.freedom + (residual**2).sum(1))

    def jacobian(self, u: Array) -> Array:
        """(n, 6, U) derivatives of the residuals."""
        rows, step, n = self._rows(u), steps_of(self.space), len(self.pushes)
        wanted = np.union1d(self.places, self.own)
        moved = [rows + sign * step[p] * np.eye(len(step))[p] for p in wanted for sign in (1, -1)]
        out = self._residual(self.predict(self.pushes.repeated(len(moved)), np.concatenate(moved)), len(moved))
        out = out.reshape(len(wanted), 2, n, N_WRENCH)
        slope = np.zeros((n, N_WRENCH, len(step)))
        slope[..., wanted] = np.moveaxis((out[:, 0] - out[:, 1]) / (2 * step[wanted, None, None]), 0, -1)
        own = np.zeros((n, N_WRENCH, self.n_grasps, len(self.own)))
        own[np.arange(n), :, self.grasp] = slope[..., self.own]
        return np.concatenate([slope[..., self.places], own.reshape(n, N_WRENCH, -1)], -1)

    def curvature(self, slope: Array, weights: Array) -> Array:
        """(U, U) of the loss, as Gauss and Newton have it."""
        flat = (slope * np.sqrt(weights)[:, None, None]).reshape(-1, slope.shape[-1])
        return flat.T @ flat + np.diag(self.precision)

    def solve(self, iterations: int, start: Array | None = None) -> Solution:
        """The most probable unknowns, from zero or from a theta (P) beyond the centre."""
        u = np.zeros(len(self.precision))
        if start is not None:
            u[: len(self.places)] = start[self.places]
        residual = self.residual(u)
        loss, damping, gained = self.loss(u, residual), 1e-3, np.inf
        for _ in range(iterations):
            slope, weights = self.jacobian(u), self.weights(residual)
            curvature = self.curvature(slope, weights)
            gradient = np.einsum("nki,n,nk->i", slope, weights, residual, optimize=True) + self.precision * u
            if gained < ENOUGH:
                break
            gained = 0.0
            while damping <= MOST_DAMPING:
                step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), -gradient)
                new = self.residual(u + step)
                new_loss = self.loss(u + step, new)
                if np.isfinite(new_loss) and new_loss <= loss:
                    gained, u, residual, loss = loss - new_loss, u + step, new, new_loss
                    damping /= 10
                    break
                damping = max(10 * damping, 1e-2)
            damping = min(damping, MOST_DAMPING)
        return Solution(u, loss, residual, slope, np.asarray(np.linalg.inv(curvature), np.float64))


class Solution(NamedTuple):
    """Of a `Problem`."""

    u: Array  # (U)
    loss: float
    residual: Array  # (n, 6) in standard deviations
    slope: Array  # (n, 6, U) about there
    covariance: Array  # (U, U)


def fit(
    predict: Predict,
    pushes: Pushes,
    prior: Prior | None = None,
    errors: Errors | None = None,
    free: Mask | None = None,
    noise: Array | None = None,
    iterations: int = 10,
    start: Array | None = None,
) -> Fit:
    """The most probable theta of pushes; entries that are not `free` (P) stay zero, with no variance.

    noise: as `Problem` has it. start: theta (P) to begin with.
    """
    prior, errors = prior or Prior(), errors or Errors()
    problem = Problem(predict, pushes, prior, errors, free, noise=noise)
    found = problem.solve(iterations, start)
    theta, deviations = problem.split(found.u)
    covariance, m = np.zeros((len(theta), len(theta))), len(problem.places)
    biased = variances_of(problem.space, errors.bias)[problem.places]
    own, mean = _widened(found.covariance[:m, :m], theta[problem.places], problem.precision[:m], biased)
    covariance[np.ix_(problem.places, problem.places)] = own
    occam = 0.5 * (np.linalg.slogdet(found.covariance)[1] + np.log(problem.precision).sum())
    weights = problem.weights(found.residual)
    whole_mean = np.zeros(len(theta))
    whole_mean[problem.places] = mean
    return Fit(theta, whole_mean, covariance, deviations, found.loss, weights, float(occam - found.loss))


def variances_of(space: Theta, bias: Mapping[str, float]) -> Array:
    """(P) of a bias."""
    return np.array([bias.get(p.kind, 0.0) ** 2 for p in space.parameters])


def _widened(covariance: Array, theta: Array, precision: Array, bias: Array) -> tuple[Array, Array]:
    """Covariance (m, m) and mean (m) of a posterior whose data are off by a bias with variances (m).

    covariance and theta (m) are those without bias, precision (m) the prior's. The data's own information is what the
    posterior's has beyond the prior's.
    """
    known = np.linalg.inv(covariance)
    values, vectors = np.linalg.eigh(known - np.diag(precision))
    half = vectors * np.sqrt(np.maximum(values, 0.0))  # (m, m) half half^T is the data's information D
    # (D^-1 + B)^-1 = H (I + H^T B H)^-1 H^T with D = H H^T, which needs no inverse of D; and so for what they say
    inner = np.linalg.inv(np.eye(len(values)) + half.T @ (bias[:, None] * half))
    told = known @ theta
    told = told - half @ inner @ half.T @ (bias * told)
    widened = np.linalg.inv(np.diag(precision) + half @ inner @ half.T)
    return np.asarray(widened, np.float64), np.asarray(widened @ told, np.float64)


def estimate_errors(
    predict: Predict, pushes: Pushes, theta: Array, hands: NDArray | None = None, rounds: int = 6
) -> Errors:
    """How wrong a model is, from pushes of hands whose theta (n, P) is known and of which it has seen none.

    By expectation and maximisation, from `START`. hands: number (n) of each push's hand; where there are grasps enough
    of one hand, the bias is found from them too.
    """
    errors, none = START, np.zeros(theta.shape[1], bool)
    chosen = np.random.default_rng(0).permutation(np.unique(pushes.grasp_id))[:MOST_GRASPS]
    grasps = [np.flatnonzero(pushes.grasp_id == g) for g in chosen]
    for _ in range(rounds):
        deviation, own, squares = [], [], []
        for rows in grasps:
            problem = Problem(predict, pushes.take(rows), Prior(), errors, none, theta[rows])
            found = problem.solve(6)
            deviation.append(found.u**2 + np.diag(found.covariance))
            spread = np.einsum("nki,ij,nkj->n", found.slope, found.covariance, found.slope, optimize=True)
            square = (found.residual**2).sum(1)
            own.append(problem.weights(found.residual) * (square + spread))
            squares.append(square + spread)
        grown = np.sqrt(np.concatenate(own).mean() / N_WRENCH)
        errors = replace(
            errors,
            relative=float(max(errors.relative * grown, 0.1 * START.relative)),
            deviation=float(max(np.sqrt(np.mean(deviation)), 0.1 * START.deviation)),
            freedom=_freedom(np.concatenate(squares) / grown**2),
        )
    return errors if hands is None else replace(errors, bias=_bias(predict, pushes, theta, hands, errors))


def _bias(predict: Predict, pushes: Pushes, theta: Array, hands: NDArray, errors: Errors) -> dict[str, float]:
    """The bias with which 90 % intervals of each kind of parameter hold 90 %, fitted to `BIAS_PUSHES`.

    Those of factors are of fits in which factors alone are free, those of zeros and radius of fits with all free.
    """
    rng, sure, space = np.random.default_rng(0), replace(errors, bias={}), Theta(pushes.hand)
    factors = np.arange(len(space)) < space.factors
    kinds = np.array([p.kind for p in space.parameters])
    precision = Prior().sd(space) ** -2
    fitted: list[tuple[Mask, Fit, Array]] = []
    for hand in np.unique(hands):
        own = np.flatnonzero(hands == hand)
        for count, of in (budget for budget in BIAS_PUSHES for _ in range(BIAS_DRAWS)):
            grasps = rng.permutation(np.unique(pushes.grasp_id[own]))[:of]
            rows = rng.permutation(own[np.isin(pushes.grasp_id[own], grasps)])[:count]
            for free in (factors, factors | True):
                fitted.append((free, fit(predict, pushes.take(rows), None, sure, free), theta[own[0]]))
    bias = dict.fromkeys(kinds.tolist(), 0.0)

    def held(kind: str, value: float) -> float:
        variances, inside = variances_of(space, bias | {kind: value}), []
        for free, found, true in fitted:
            if free.all() == (kind in MOST_BIAS):
                covariance = found.covariance[np.ix_(free, free)]
                spread, mean = _widened(covariance, found.theta[free], precision[free], variances[free])
                inside.append((np.abs(mean - true[free]) <= Z90 * np.sqrt(np.diag(spread)))[kinds[free] == kind])
        return float(np.mean(inside))

    for _ in range(BIAS_SWEEPS):
        for kind in bias:
            low, high = 0.0, MOST_BIAS.get(kind, 1.0)
            for _ in range(8):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if held(kind, middle) < HELD else (low, middle)
            bias[kind] = high
    return bias


def _freedom(squares: Array) -> float:
    """Degrees of freedom of Student's t that squared lengths (n) of 6 components are most likely under."""

    def likelihood(nu: float) -> float:
        size = len(squares) * (lgamma((nu + N_WRENCH) / 2) - lgamma(nu / 2) - N_WRENCH / 2 * np.log(nu))
        return float(size - 0.5 * (nu + N_WRENCH) * np.log1p(squares / nu).sum())

    return float(max(FREEDOMS, key=likelihood))
