"""Figures of merit: F1, pose error, relative error, passivity. Plain numpy on float64; units in the names.

Displacements are (n, 6): translation (m), rotation vector (rad). The pose error of a sample is
sqrt(|dp|^2 / L^2 + theta^2) with the hand's characteristic length L (`length_m`) and theta the geodesic angle between
the two rotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Column(NamedTuple):
    """How the tables of models show a figure."""

    title: str
    unit: str
    form: str


COLUMNS: dict[str, Column] = {
    "f1": Column("F1", "stable", "{:.3f}"),
    "rmse_pose_all": Column("RMSE_pose", "all stable", "{:.4f}"),
    "rmse_pose_stuck": Column("of stuck", "cases", "{:.4f}"),
    "rmse_pose_slid": Column("of slid", "cases", "{:.3f}"),
    "rmse_mm_all": Column("RMSE", "mm", "{:.2f}"),
    "rmse_deg_all": Column("RMSE", "deg", "{:.2f}"),
    "rmse_to_no_motion_all": Column("RMSE", "/ no motion", "{:.3f}"),
    "relative_error_median_all": Column("relative", "median", "{:.3f}"),
    "relative_error_p90_all": Column("relative", "p90", "{:.3f}"),
    "large_error_share": Column("over 0.01", "share", "{:.1%}"),
    "rmse_pose_refused_5pc": Column("RMSE_pose", "5% refused", "{:.4f}"),
    "passivity_violation_translational": Column("f.dp < 0", "share", "{:.2%}"),
    "passivity_violation_full": Column("w.dx < 0", "share", "{:.2%}"),
    "rmse_pose": Column("RMSE_pose", "passed", "{:.4f}"),
}
"""Figure of `evaluate.figures_of` -> column, in the order of the tables. But for the last, which a model's threshold
decides as much as its errors do, errors are over all load cases that are truly stable."""

SURE_COLUMNS: dict[str, Column] = {
    "slide_auroc": Column("p_slide", "AUROC", "{:.3f}"),
    "slide_ece": Column("p_slide", "ECE", "{:.3f}"),
    "bound_coverage": Column("in bound", "of all", "{:.1%}"),
    "bound_coverage_slid": Column("in bound", "of slid", "{:.1%}"),
    "bound_width": Column("bound", "/ motion", "{:.3f}"),
    "rmse_pose_all": Column("RMSE_pose", "none refused", "{:.4f}"),
    "rmse_pose_refused_5pc": Column("RMSE_pose", "5% refused", "{:.4f}"),
    "rmse_pose_refused_10pc": Column("RMSE_pose", "10% refused", "{:.4f}"),
}
"""The same of models that say how sure they are: over all load cases that are truly stable; widths are medians."""

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Edges of |dx| (pose size, dimensionless) by which RMSE is broken down: at L = 0.1 m 0.5, 2 and 8 mm of translation.
SIZE_EDGES = (0.005, 0.02, 0.08)

LARGE_ERROR = 0.01
"""A pose error that a controller notices: 1 mm, or 0.6 degrees, at L = 0.1 m."""
REFUSED = (0.05, 0.1)
"""Shares of the load cases that are refused, by how unsure a model is of them."""
COVERED = 0.95
"""Share of the pose errors that a model's own bound promises to hold."""


def quaternion(rotvec: Array) -> Array:
    """Unit quaternions (n, 4), scalar first, of rotation vectors (n, 3)."""
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * rotvec * np.sinc(angle / (2 * np.pi))], -1)


def geodesic_angle(a: Array, b: Array) -> Array:
    """Angle (n), rad, of the rotation between rotation vectors a and b (n, 3)."""
    qa, qb = quaternion(a), quaternion(b)
    scalar = (qa * qb).sum(-1)
    vector = qa[..., :1] * qb[..., 1:] - qb[..., :1] * qa[..., 1:] - np.cross(qa[..., 1:], qb[..., 1:])
    return 2 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar))


def pose_size(dx: Array, length_m: float) -> Array:
    """Size (n) of displacements (n, 6): sqrt(|dp|^2 / L^2 + |rotation|^2)."""
    return np.hypot(
        np.linalg.norm(dx[:, :3], axis=1) / length_m,
        geodesic_angle(dx[:, 3:], np.zeros_like(dx[:, 3:])),
    )


def pose_error(pred: Array, true: Array, length_m: float) -> Array:
    """Pose error (n) of each sample."""
    translation = np.linalg.norm(pred[:, :3] - true[:, :3], axis=1) / length_m
    return np.hypot(translation, geodesic_angle(pred[:, 3:], true[:, 3:]))


def rms(v: Array) -> float:
    """Root of the mean square; nan where there is nothing to average."""
    return float(np.sqrt(np.mean(v**2))) if len(v) else float("nan")


def spread(values: Sequence[float]) -> float:
    """Standard deviation of a sample; 0 for a single value."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def f1_score(stable_pred: Mask, stable_true: Mask) -> float:
    """F1 with stable as the positive class."""
    hits = int((stable_pred & stable_true).sum())
    total = int(stable_pred.sum() + stable_true.sum())
    return 2 * hits / total if total else float("nan")


def precision_recall(stable_pred: Mask, stable_true: Mask) -> tuple[float, float]:
    """Precision and recall of stable; nan where nothing is predicted, or is, stable."""
    hits = float((stable_pred & stable_true).sum())
    predicted, true = int(stable_pred.sum()), int(stable_true.sum())
    return hits / predicted if predicted else float("nan"), hits / true if true else float("nan")


def auroc(score: Array, positive: Mask) -> float:
    """Probability that a positive scores higher than a negative (ties count half); nan without both."""
    n, m = int(positive.sum()), int((~positive).sum())
    if not n or not m:
        return float("nan")
    _, inverse, counts = np.unique(score, return_inverse=True, return_counts=True)
    rank = (np.cumsum(counts) - 0.5 * (counts - 1))[inverse]  # average rank among ties, from 1
    return float((rank[positive].sum() - n * (n + 1) / 2) / (n * m))


CALIBRATION_BINS = 15


def reliability(p: Array, positive: Mask, bins: int = CALIBRATION_BINS) -> list[dict[str, float]]:
    """Reliability curve over equal bins of p: count, mean p and share of positives of each bin that is not empty."""
    index = np.minimum((p * bins).astype(int), bins - 1)
    found = [index == k for k in range(bins) if (index == k).any()]
    return [{"n": int(i.sum()), "p": float(p[i].mean()), "share": float(positive[i].mean())} for i in found]


def calibration_figures(p: Array, positive: Mask) -> dict[str, float]:
    """Expected calibration error over equal bins, Brier score, and AUROC."""
    curve = reliability(p, positive)
    total = sum(b["n"] for b in curve)
    return {
        "ece": sum(b["n"] * abs(b["p"] - b["share"]) for b in curve) / total if total else float("nan"),
        "brier": float(np.mean((p - positive) ** 2)) if total else float("nan"),
        "auroc": auroc(p, positive),
    }


def signed_work(w_e: Array, dx: Array, full: bool) -> Array:
    """Work (n), J: w.dx with the moment (full) or f.dp (translational, as in the paper)."""
    n = 6 if full else 3
    return (w_e[:, :n] * dx[:, :n]).sum(1)


def violation_rate(w_e: Array, dx: Array, where: Mask, full: bool) -> float:
    """Share of the samples in `where` whose signed work is negative; nan where there are none."""
    return float((signed_work(w_e, dx, full)[where] < 0).mean()) if where.any() else float("nan")


def _quantile(v: Array, q: float) -> float:
    return float(np.quantile(v, q)) if len(v) else float("nan")


def displacement_figures(pred: Array, true: Array, length_m: float) -> dict[str, float]:
    """Errors over the samples given: RMSE_pose, in mm and degrees, beside no motion, relative errors, RMSE by size."""
    error, size = pose_error(pred, true, length_m), pose_size(true, length_m)
    relative = error / np.maximum(size, 1e-9)
    figures = {
        "rmse_pose": rms(error),
        "rmse_mm": 1e3 * rms(np.linalg.norm(pred[:, :3] - true[:, :3], axis=1)),
        "rmse_deg": float(np.rad2deg(rms(geodesic_angle(pred[:, 3:], true[:, 3:])))),
        "rmse_to_no_motion": rms(error) / rms(size) if len(size) else float("nan"),
        "relative_error_median": _quantile(relative, 0.5),
        "relative_error_p90": _quantile(relative, 0.9),
    }
    edges = (0.0, *SIZE_EDGES, np.inf)
    for k, (low, high) in enumerate(pairwise(edges)):
        inside = (size >= low) & (size < high)
        figures[f"rmse_pose_size{k}"] = rms(error[inside])
        figures[f"n_size{k}"] = int(inside.sum())
    return figures


def refused_rms(error: Array, doubt: Array, share: float) -> float:
    """RMS of the errors (n) that are left when the `share` with the largest doubt (n) is refused.

    Of cases with the same doubt each is refused as much as the others.
    """
    if not len(error):
        return float("nan")
    _, tie, count = np.unique(doubt, return_inverse=True, return_counts=True)
    squares = (np.bincount(tie, error**2) / count)[np.sort(tie)]
    return float(np.sqrt(squares[: len(error) - round(share * len(error))].mean()))


def refusal_curve(error: Array, doubt: Array, most: float = 0.2, points: int = 41) -> dict[str, list[float]]:
    """ "rmse_pose" that is left against the "refused" share, from none to `most`."""
    shares = np.linspace(0, most, points).tolist()
    return {"refused": shares, "rmse_pose": [refused_rms(error, doubt, share) for share in shares]}


def refusal_figures(error: Array, doubt: Array) -> dict[str, float]:
    """RMSE against the share refused, `REFUSED`, and the share of large errors, over the samples given."""
    figures = {f"rmse_pose_refused_{100 * share:g}pc": refused_rms(error, doubt, share) for share in REFUSED}
    return figures | {"large_error_share": float((error > LARGE_ERROR).mean()) if len(error) else float("nan")}


def slide_figures(error: Array, slid: Mask) -> dict[str, float]:
    """RMSE of samples whose contacts stuck, and of those with one that slid; how many slid, and their squared error."""
    squares, n = error**2, len(error)
    whole = float(squares.sum())
    return {
        "rmse_pose_stuck": rms(error[~slid]),
        "rmse_pose_slid": rms(error[slid]),
        "slid_share": float(slid.mean()) if n else float("nan"),
        "slid_n": int(slid.sum()),
        "error_share_slid": float(squares[slid].sum()) / whole if whole else float("nan"),
    }


def bound_figures(error: Array, size: Array, bound: Array, slid: Mask | None = None) -> dict[str, float]:
    """How often the pose error stays within a model's own bound, and how wide that is; `slid`: among those as well."""
    within, width = error <= bound, bound / np.maximum(size, 1e-9)
    figures = {"bound_coverage": within, "bound_coverage_slid": within[slid] if slid is not None else within[:0]}
    return {name: float(v.mean()) for name, v in figures.items() if len(v)} | {"bound_width": _quantile(width, 0.5)}


def all_figures(
    w_e: Array, dx_true: Array, stable_true: Mask, dx_pred: Array, stable_pred: Mask, length_m: float
) -> dict[str, float]:
    """Every figure of one model on one split.

    `rmse_*` are over samples truly stable and predicted stable; the same with `_all` are over all truly stable ones.
    """
    both = stable_true & stable_pred
    precision, recall = precision_recall(stable_pred, stable_true)
    figures: dict[str, float] = {
        "f1": f1_score(stable_pred, stable_true),
        "precision": precision,
        "recall": recall,
        "predicted_stable": int(stable_pred.sum()),
    }
    figures |= displacement_figures(dx_pred[both], dx_true[both], length_m)
    on_all = displacement_figures(dx_pred[stable_true], dx_true[stable_true], length_m)
    figures |= {f"{name}_all": value for name, value in on_all.items()}
    for name, full in (("translational", False), ("full", True)):
        figures[f"passivity_violation_{name}"] = violation_rate(w_e, dx_pred, stable_pred, full)
    return figures


def holds(p_stable: NDArray | float, tau: float | np.floating) -> Mask:
    """The decision of a model, in single precision as the runtime makes it."""
    return np.asarray(np.asarray(p_stable, np.float32) >= np.float32(tau))


def operating_curve(p: Array, stable_true: Mask, error: Array, points: int = 61) -> dict[str, list[float]]:
    """What each threshold on p gives: "tau", "f1", "rmse_pose" of what is stable and passed, "passed" (share of all).

    `error` (n) is the pose error; thresholds are quantiles of p, so that the curve is even in the share passed on.
    """
    taus = np.unique(np.quantile(p, np.linspace(0, 0.98, points), method="lower"))
    rows = [(t, f1_score(p >= t, stable_true), rms(error[(p >= t) & stable_true]), (p >= t).mean()) for t in taus]
    kept = [row for row in rows if np.isfinite(row).all()]
    names = ("tau", "f1", "rmse_pose", "passed")
    return {name: [float(row[k]) for row in kept] for k, name in enumerate(names)}


def choose_tau(p: Array, stable_true: Mask, error: Array, f1_slack: float = 0.001) -> float:
    """Threshold on a score p (n) from validation data (the paper's operating point).

    Among thresholds whose F1 is within `f1_slack` of the best, the one with the least RMSE of `error` (n) over samples
    truly and predicted stable. Thresholds lie halfway between neighbouring scores, so that rounding flips no sample.
    """
    scores = np.unique(p)
    if len(scores) < 2:
        return float(scores[0]) if len(scores) else 0.5
    candidates = np.unique(np.quantile(scores, np.linspace(0.01, 0.99, 197), method="lower"))
    at = np.clip(np.searchsorted(scores, candidates), 1, None)
    taus = 0.5 * (scores[at] + scores[at - 1])
    f1 = np.array([f1_score(p >= t, stable_true) for t in taus])
    error_rms = np.array([rms(error[(p >= t) & stable_true]) for t in taus])
    good = np.flatnonzero(f1 >= np.nanmax(f1) - f1_slack)
    return float(taus[good[np.nanargmin(error_rms[good])]])
