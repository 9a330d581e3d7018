"""Teach a trained model how sure it is of its motion: the weights of `model.sure`, and what corrects its bound.

Weights come from the stable training cases, with all else of the model as it is. Both problems are convex, a logistic
regression and a quantile regression whose corner is rounded off, so that what comes out depends on neither an order nor
a seed. Errors on training cases are too small; the factors of the bound make up for that: they come from the stable
validation cases (conformal prediction). Each bin of p_slide has its own, since contacts that slide make errors of
another size. Sensors that may be known or not are drawn several times, so that both hold for any of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import softplus

from ..data.dataset import Dataset
from ..data.sensors import SEED, draw
from ..data.slides import slid_cases
from ..evaluation.metrics import COVERED, pose_error
from ..evaluation.predict import CHUNK
from ..model.baseline import Mlp
from ..model.config import SensorDraws
from ..model.network import Aminn
from ..model.sure import BINS, LEAST_SPREAD, Sure

Array = NDArray[np.float64]
Loss = Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]
"""Loss of each sample by the number that is learned (n), and its first and second derivative."""

DRAWS = 4
"""How often sensors of a load case are drawn."""
RIDGE = 1e-4
"""On squared weights of inputs that have a spread of 1."""
SMOOTHING = (0.5, 0.2, 0.1, 0.05)
"""Widths, in the logarithm of an error, over which the quantile loss is rounded off, one solution starting the next."""
NEWTON_STEPS = 25
UNFORESEEN = 0.03
"""Share of the cases that slid in the lowest bin of p_slide; the others share the rest evenly."""
SLID_COVERED = 0.94
"""Share of the cases that slid that the bound holds in each other bin."""
LOWEST_COVERED = (0.9, COVERED)
"""Least and largest share of the cases that it holds in the lowest bin, where the others hold more."""
LEAST_SLID = 20
"""Fewer validation cases that slid make no bins: one factor for all."""
ROUNDING = 1e-5
"""By how much a factor is more than the error of the case that it is from, which it is to hold in single precision."""
LEAST_ERROR = 1e-6
"""A pose error that is as good as none."""


class _Cases(NamedTuple):
    """Stable load cases as `Sure` sees them."""

    feature: Tensor  # (n, width)
    statics: Tensor  # (n, `Sure.norm`)
    error: Array  # (n,) pose error of the model's motion
    slid: NDArray[np.bool_] | None  # (n,), where it is known
    cases: int  # of load cases; n is a multiple


def _cases(model: Aminn | Mlp, part: Dataset, draws: SensorDraws) -> _Cases:
    """The stable load cases of a part of the data, which tells all that may be known of sensors."""
    held = part.take(part.samples["stable"] > 0)
    x, found = held.inputs(), []
    times = DRAWS if any(name in x for name in held.hand.dims.sensors) else 1
    for k in range(times):
        shown = draw(x, draws, torch.Generator().manual_seed(SEED + k))
        with torch.no_grad():
            for i in range(0, len(held), CHUNK):
                found.append(model.seen_by_sure({name: v[i : i + CHUNK] for name, v in shown.items()}))
    feature, statics, dx = (torch.cat(parts) for parts in zip(*found, strict=True))
    error = pose_error(dx.double().numpy(), np.tile(held.samples["dx_ht"], (times, 1)), held.hand.length_m)
    slid = None if held.measured else np.tile(slid_cases(held), times)
    return _Cases(feature, statics, error, slid, len(held))


def fit_sure(model: Aminn | Mlp, train: Dataset, validation: Dataset, draws: SensorDraws, started: bool) -> dict:
    """Fit `model.sure` once all else is trained; the parts of the data tell all that may be known of sensors.

    The bound does not see the use of friction: that is larger where the tool's weight is told, and errors are not.
    Measured data do not say what slid: then p_slide stays what it was in the model that was `started` from, whose
    features may have moved since, or says nothing. Returns what there is to say of it.
    """
    learn, check = _cases(model, train, draws), _cases(model, validation, draws)
    sure = model.sure
    if not started:
        sure.norm.fit(learn.statics, (LEAST_SPREAD,) * learn.statics.shape[1])
    seen = sure.seen(learn.feature, learn.statics).double()
    mean, spread = seen.mean(0), seen.std(0)
    scale = torch.where(spread > 0, 1 / spread.clamp_min(LEAST_SPREAD), 0.0)
    scaled = torch.cat([(seen - mean) * scale, torch.ones_like(seen[:, :1])], 1)

    seen_use = slice(learn.feature.shape[1] + 1, learn.feature.shape[1] + 1 + (learn.statics.shape[1] - 1) // 3)
    blind = scaled.clone()
    blind[:, seen_use] = 0

    def put(row: int, weight: Tensor) -> None:
        own = weight[:-1] * scale
        sure.out.weight[row], sure.out.bias[row] = own, weight[-1] - own @ mean

    with torch.no_grad():
        if learn.slid is not None:
            put(0, _slide_weights(scaled, learn.slid))
        elif not started:
            sure.out.weight[0], sure.out.bias[0] = 0.0, 0.0
        put(1, _bound_weights(blind, learn))
        _correct(sure, check)
    slides = "kept" if started else "unknown"
    return {"p_slide": slides if learn.slid is None else "learned", "cases": learn.cases, "checked": check.cases}


def _slide_weights(scaled: Tensor, slid: NDArray[np.bool_]) -> Tensor:
    """Weights (k) of the logit, on inputs (n, k) of which the last is 1."""
    start, share = torch.zeros_like(scaled[0]), (slid.sum() + 0.5) / (len(slid) + 1)
    start[-1] = float(np.log(share / (1 - share)))
    if slid.all() or not slid.any():
        return start
    target = torch.as_tensor(slid).to(scaled.dtype)

    def loss(z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        p = torch.sigmoid(z)
        return softplus(z) - target * z, p - target, p * (1 - p)

    return _newton(scaled, loss, start)


def _bound_weights(scaled: Tensor, learn: _Cases) -> Tensor:
    """Weights (k) of the logarithm of the error's quantile, on inputs (n, k) of which the last is 1."""
    log_error = torch.as_tensor(np.log(np.maximum(learn.error, LEAST_ERROR)))
    found = torch.zeros_like(scaled[0])
    found[-1] = float(np.quantile(log_error.numpy(), COVERED))

    def loss(width: float, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        over = (log_error - z) / width
        below = torch.sigmoid(-over)
        value = width * (COVERED * over + softplus(-over))
        return value, below - COVERED, below * (1 - below) / width

    for width in SMOOTHING:
        found = _newton(scaled, partial(loss, width), found)
    return found


def _newton(scaled: Tensor, loss: Loss, start: Tensor) -> Tensor:
    """The weights (k) of least mean loss of scaled (n, k) by them, and of RIDGE on all but the last."""
    ridge = torch.full_like(start, RIDGE)
    ridge[-1] = 0

    def value(w: Tensor) -> Tensor:
        return loss(scaled @ w)[0].mean() + 0.5 * (ridge * w * w).sum()

    w, now = start, value(start)
    for _ in range(NEWTON_STEPS):
        _, slope, curvature = loss(scaled @ w)
        gradient = scaled.mT @ slope / len(scaled) + ridge * w
        hessian = (scaled.mT * curvature) @ scaled / len(scaled) + torch.diag(ridge + 1e-9)
        step = torch.linalg.solve(hessian, gradient)
        promised = gradient @ step
        tried = [(w - step / 2**k) for k in range(12)]
        better = next((v for k, v in enumerate(tried) if value(v) <= now - 1e-4 / 2**k * promised), None)
        if better is None:
            break
        before, w, now = now, better, value(better)
        if before - now <= 1e-9 * before.abs():
            break
    return w


def _correct(sure: Sure, check: _Cases) -> None:
    """Take the bins of p_slide and the factors of the bound from cases that no weight was fitted to.

    Of all of them the bound holds 95 %, and in each bin but the lowest `SLID_COVERED` of those that slid.
    """
    sure.factor.fill_(1.0)
    p_slide, bound = (v.double().numpy() for v in sure(check.feature, check.statics))
    ratio, slid, times = check.error / bound, check.slid, len(check.error) // check.cases
    factors = np.full(BINS, _quantile(ratio, COVERED, times))
    if slid is not None and slid.sum() >= LEAST_SLID * times:
        levels = UNFORESEEN + (1 - UNFORESEEN) * np.arange(BINS - 1) / (BINS - 1)
        sure.edge.copy_(torch.as_tensor(np.quantile(p_slide[slid], levels)))
        own = sure.bin(torch.as_tensor(p_slide)).numpy()
        for k in set(own[slid].tolist()) - {0}:
            least = _quantile(ratio[(own == k) & slid], SLID_COVERED, times)
            factors[k] = max(least, _quantile(ratio[own == k], COVERED, times))
        lowest = own == 0
        if lowest.any():
            held = int((ratio <= factors[own])[~lowest].sum())
            left = float(np.clip((COVERED * len(ratio) - held) / lowest.sum(), *LOWEST_COVERED))
            factors[0] = _quantile(ratio[lowest], left, times)
    sure.factor.copy_(torch.as_tensor(factors * (1 + ROUNDING)))


def _quantile(ratio: Array, level: float, times: int) -> float:
    """What a new case is below with a probability of `level` at least; each case of `ratio` is there `times` times."""
    n = len(ratio) / times
    return float(np.quantile(ratio, min(np.ceil((n + 1) * level) / n, 1.0), method="inverted_cdf"))
