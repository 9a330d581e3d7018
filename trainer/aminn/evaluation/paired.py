"""How much a figure owes to the grasps that it was measured on: a bootstrap over grasps, with the same draws for every
model, so that models are compared grasp by grasp.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data.dataset import Dataset
from ..data.slides import slid_cases
from .evaluate import Prediction
from .metrics import LARGE_ERROR, pose_error, pose_size

Array = NDArray[np.float64]
Resampled = dict[str, Array]
"""Figure -> its values (1 + DRAWS): of the test set as it is, then of its grasps drawn again, with replacement."""
DRAWS = 1000
LEVEL = 0.95
DIFFERENCES = ("f1",)
"""Figures that are compared by their difference; the others by their ratio."""


class Compared(NamedTuple):
    """A ratio, or a difference, and the interval that holds it with `LEVEL`."""

    value: float
    low: float
    high: float


def resampled(p: Prediction, data: Dataset) -> Resampled:
    """Figures of a model on simulated load cases, and on every draw of their grasps."""
    s = data.samples
    grasps, rows = np.unique(s["grasp_id"], return_inverse=True)
    counts = np.vstack([np.ones(len(grasps), int), _draws(len(grasps))])  # (1 + DRAWS, g)
    stable, slid = s["stable"] > 0, slid_cases(data)
    error = pose_error(p.dx, s["dx_ht"], data.hand.length_m)

    def total(v: NDArray) -> Array:
        return counts @ np.bincount(rows, v, len(grasps))

    def mean(v: Array, where: NDArray[np.bool_]) -> Array:
        with np.errstate(invalid="ignore"):  # a draw may have none of them
            return total(v * where) / total(where)

    figures = {"f1": 2 * total(p.stable & stable) / total(p.stable.astype(int) + stable)}
    sets = {"all": stable, "stuck": stable & ~slid, "slid": stable & slid, "passed": stable & p.stable}
    for name, where in sets.items():
        figures["rmse_pose" if name == "passed" else f"rmse_pose_{name}"] = np.sqrt(mean(error**2, where))
    figures["large_error_share"] = mean((error > LARGE_ERROR).astype(float), stable)
    relative = (error / np.maximum(pose_size(s["dx_ht"], data.hand.length_m), 1e-9))[stable]
    for name, q in (("median", 0.5), ("p90", 0.9)):
        figures[f"relative_error_{name}_all"] = _quantiles(relative, counts[:, rows[stable]], q)
    return figures


def _draws(grasps: int) -> NDArray[np.int64]:
    """How often each of the grasps is drawn (DRAWS, g)."""
    return np.random.default_rng(0).multinomial(grasps, np.full(grasps, 1 / grasps), DRAWS)


def _quantiles(v: Array, counts: NDArray[np.int64], q: float) -> Array:
    """Quantile q of the values v (n), each as often as counts (m, n) say: (m)."""
    order = np.argsort(v)
    reached = np.cumsum(counts[:, order], axis=1)
    place = q * np.maximum(reached[:, -1] - 1, 0)
    below = np.floor(place)
    low, high = (v[order][(reached > k[:, None]).argmax(1)] for k in (below, np.ceil(place)))
    return np.where(reached[:, -1] > 0, low + (place - below) * (high - low), np.nan)


def compared(mine: Sequence[Resampled], other: Sequence[Resampled], figure: str) -> Compared:
    """A model's figure against another's, each by the same seeds: the mean over seeds, which are drawn again too."""
    pairs = zip(mine, other, strict=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        each = np.stack([a[figure] - b[figure] if figure in DIFFERENCES else a[figure] / b[figure] for a, b in pairs])
    seeds, draws = len(each), each.shape[1] - 1
    chosen = np.random.default_rng(1).integers(seeds, size=(seeds, draws))
    drawn = each[chosen, np.arange(1, draws + 1)].mean(0)
    finite = drawn[np.isfinite(drawn)]
    low, high = np.quantile(finite, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) if len(finite) else (np.nan, np.nan)
    return Compared(float(each[:, 0].mean()), float(low), float(high))
