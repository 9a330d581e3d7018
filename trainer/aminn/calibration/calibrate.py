"""A hand's calibration from measured pushes: theta with its uncertainty, shown on pushes that it was not fitted to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import STATE
from aminn_hand.theta import Theta, theta_bounds

from ..evaluation.analysis import SensorNoise, noisy_state
from .fit import Z90, Errors, Fit, Prior, fit
from .mistakes import Found, find_mistakes
from .pushes import Array, Predict, Pushes, relative_errors, scaled

LEAST_PUSHES = 4
FOLDS, FOLD_ITERATIONS = 5, 6
UNDETERMINED = 0.8
"""A parameter is not determined where its standard deviation stays above this share of the prior's."""
SLIPPED = 0.1
"""A push that counts less than this has slipped, or fits no hand."""
BLENDS = (1.0, 0.5)
"""Shares of the fitted theta that are tried on the held-out pushes."""
NOISE_DRAWS, MOST_NOISE = 24, 100.0
UNEXPLAINED = 0.5
"""Median relative error of held-out pushes above which no theta explains them; that of hands not calibrated is 0.4."""
GEOMETRY_EVIDENCE = 4.0
"""By how much the logarithm of the evidence must rise for joint zeros and tip radius to be changed."""


@dataclass(frozen=True)
class HeldOut:
    """Errors of pushes that theta was not fitted to, before and after."""

    by: str
    """`grasp` or `push`: what was left out at a time."""
    before: Array  # (n) relative errors with theta zero
    after: Array  # (n) with theta from the other grasps or pushes
    blend: float
    """Share of the fitted theta that is best."""

    @property
    def better(self) -> bool:
        """Whether errors are smaller on the whole, by the mean of their logarithms."""
        return _size(self.after) < _size(self.before)


@dataclass(frozen=True)
class Calibration:
    """What was found."""

    pushes: Pushes
    fit: Fit
    theta: Array  # (P) `fit.theta` times `held_out.blend`
    held_out: HeldOut
    prior: Prior
    errors: Errors
    noise: float
    fitted_before: Array  # (n) relative errors of all pushes with theta zero
    fitted_after: Array  # (n) with theta
    mistakes: tuple[Found, ...]
    """Readings that explain the data better; empty where they are as they are told to be."""
    free: NDArray[np.bool_]
    """(P) whether a parameter was fitted; the others stay at 0."""

    @property
    def space(self) -> Theta:
        return Theta(self.pushes.hand)

    @property
    def intervals(self) -> Array:
        """(2, P) ends of the intervals that hold the hand's own theta with 90 %."""
        return self.fit.mean + Z90 * np.array([[-1.0], [1.0]]) * self.fit.sd

    @property
    def slipped(self) -> NDArray[np.bool_]:
        """(n) whether a push counts for hardly anything."""
        return self.fit.weights < SLIPPED

    @property
    def undetermined(self) -> list[str]:
        """Names of parameters that the pushes say little of."""
        share = self.fit.sd / self.prior.sd(self.space)
        return [name for name, s in zip(self.space.names, share, strict=True) if s > UNDETERMINED]

    @property
    def beyond(self) -> list[str]:
        """Names of parameters that no model takes: beyond the bounds of aminn_rt.h."""
        bounds = theta_bounds(len(self.space), len(self.pushes.hand.joints))
        return [n for n, t, bound in zip(self.space.names, self.theta, bounds, strict=True) if not abs(t) <= bound]


def _size(errors: Array) -> float:
    return float(np.log(np.maximum(errors, 1e-6)).mean())


def noise_of(predict: Predict, pushes: Pushes, factor: float) -> Array | None:
    """What sensor noise of `factor` times `SensorNoise` does to each predicted displacement.

    (n) standard deviation of a component in units of the pose error; None without noise. Raises AminnError for a factor
    that no sensor has.
    """
    if not 0 <= factor <= MOST_NOISE:  # nor where it is NaN
        raise AminnError(f"noise is {factor:g}, expected 0 to {MOST_NOISE:g}")
    if factor == 0:
        return None
    state = {name: getattr(pushes, name) for name in STATE}
    zero = np.zeros((len(pushes), len(Theta(pushes.hand))))
    right, rng, squares = predict(pushes, zero), np.random.default_rng(0), []
    for _ in range(NOISE_DRAWS):
        drawn = noisy_state(pushes.hand, state, SensorNoise().scaled(factor), rng)
        moved = predict(pushes.told(**{name: drawn[name] for name in ("q", "w_e", "contacts")}), zero)
        squares.append((scaled(moved - right, pushes.hand.length_m) ** 2).mean(1))
    return np.sqrt(np.median(squares, 0))


def fit_parsimonious(
    predict: Predict, pushes: Pushes, prior: Prior, errors: Errors, noise: Array | None
) -> tuple[Fit, NDArray[np.bool_]]:
    """The fit, and which parameters (P) were free: joint zeros and tip radius only where the pushes ask for it.

    Where they do not, their uncertainty is that of the fit with all free.
    """
    space = Theta(pushes.hand)
    factors = np.arange(len(space)) < space.factors
    few = fit(predict, pushes, prior, errors, factors, noise)
    whole = fit(predict, pushes, prior, errors, factors | True, noise, start=few.theta)
    if whole.evidence > few.evidence + GEOMETRY_EVIDENCE:
        return whole, factors | True
    covariance = np.where(factors[:, None] & factors, few.covariance, whole.covariance)
    covariance[factors[:, None] != factors] = 0.0
    return replace(few, mean=np.where(factors, few.mean, whole.mean), covariance=covariance), factors


def _folds(pushes: Pushes) -> tuple[str, list[NDArray[np.bool_]]]:
    """What is left out at a time, and the masks (n) of it: whole grasps where there are two or more."""
    grasps = np.unique(pushes.grasp_id)
    by = "grasp" if len(grasps) > 1 else "push"
    units = pushes.grasps if by == "grasp" else np.arange(len(pushes))
    parts = np.array_split(np.random.default_rng(0).permutation(units.max() + 1), min(FOLDS, units.max() + 1))
    return by, [np.isin(units, part) for part in parts]


def hold_out(
    predict: Predict,
    pushes: Pushes,
    prior: Prior,
    errors: Errors,
    free: NDArray[np.bool_],
    noise: Array | None,
) -> HeldOut:
    """Errors of each push with theta from the others alone."""
    by, folds = _folds(pushes)
    thetas = np.zeros((len(pushes), len(Theta(pushes.hand))))
    for left_out in folds:
        rest = ~left_out
        own = None if noise is None else noise[rest]
        found = fit(predict, pushes.take(rest), prior, errors, free, own, FOLD_ITERATIONS)
        thetas[left_out] = found.theta
    before = relative_errors(predict(pushes, 0 * thetas), pushes)
    after = {blend: relative_errors(predict(pushes, blend * thetas), pushes) for blend in BLENDS}
    best = min(after, key=lambda blend: _size(after[blend]))
    return HeldOut(by, before, after[best], best)


def calibrate(
    predict: Predict,
    pushes: Pushes,
    prior: Prior | None = None,
    errors: Errors | None = None,
    noise: float = 0.0,
    look_for_mistakes: bool = True,
) -> Calibration:
    """Theta of the hand that was pushed. Raises AminnError for too few pushes."""
    prior, errors = prior or Prior(), errors or Errors()
    if len(pushes) < LEAST_PUSHES:
        raise AminnError(
            f"{len(pushes)} pushes were held; calibration needs {LEAST_PUSHES} or more, and ten in two grasps do well"
        )
    spread = noise_of(predict, pushes, noise)
    found, free = fit_parsimonious(predict, pushes, prior, errors, spread)
    held_out = hold_out(predict, pushes, prior, errors, free, spread)
    theta = held_out.blend * found.theta
    before, after = (relative_errors(predict(pushes, np.tile(t, (len(pushes), 1))), pushes) for t in (0 * theta, theta))
    mistakes = find_mistakes(predict, pushes, prior, errors, spread) if look_for_mistakes else []
    return Calibration(pushes, found, theta, held_out, prior, errors, noise, before, after, tuple(mistakes), free)


def refusals(found: Calibration) -> Iterator[str]:
    """Why a calibration is not to be used, if it is not."""
    if found.mistakes:
        named = "; or as if ".join(dict.fromkeys(m.mistake.detail for m in found.mistakes))
        error = found.mistakes[0].relative_error_median
        yield (
            f"the data look as if {named} (read so, the model's error is {error:.1%} of the motion, as they are told "
            f"{np.median(found.fitted_after):.1%}); mend them, or give --as-told"
        )
    elif not found.held_out.better:
        b, a = (float(np.median(e)) for e in (found.held_out.before, found.held_out.after))
        yield (
            f"theta from some of the pushes makes the others worse: their error goes from {b:.1%} to {a:.1%} of the "
            "motion; the hand's description is kept. Give more pushes of more grasps, or look at these"
        )
    elif (left := float(np.median(found.held_out.after))) > UNEXPLAINED:
        yield (
            f"even with theta from the others the model's error is {left:.1%} of the motion: most pushes slipped, or "
            "were not measured as they are told; the hand's description is kept. Push less, or look at these"
        )
    elif found.beyond:
        yield (
            f"theta would be beyond what any prediction takes ({', '.join(found.beyond)}); the hand's description is "
            "kept. Give more pushes of more grasps, or a narrower --prior"
        )
