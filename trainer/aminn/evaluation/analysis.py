"""Where a model is right and where it is not: figures by load, tool and tendon regime, what its springs and gates mean,
and what noisy sensors do to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn_hand import Hand
from aminn_hand.sensors import TENDON_TENSION, TOOL_WEIGHT

from ..data.dataset import Dataset
from ..hand.closure import closure
from ..hand.nominal import gated_tendons
from ..model.checkpoint import Checkpoint
from .evaluate import Prediction, figures_of, learned
from .metrics import auroc, pose_error, pose_size

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Fields = Mapping[str, NDArray]
"""Arrays of samples, by their names."""
Parts = dict[str, dict[str, float]]
"""Figures by part of the load cases; "" is all of them."""

MAGNITUDE_EDGES_N = (0.5, 2.0, 8.0)
DIRECTIONS = ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z")
BREAKDOWN_FIGURES = (
    "f1", "rmse_pose_all", "rmse_pose_stuck", "slid_share", "relative_error_median_all", "relative_error_p90_all",
    "ece", "passivity_violation_full",
)  # fmt: skip
NOISE_FACTORS = (0.5, 1.0, 2.0)
NOISE_FIGURES = (
    "f1", "ece", "rmse_pose_all", "rmse_pose_slid", "relative_error_median_all", "relative_error_p90_all",
    "large_error_share", "slide_auroc", "bound_coverage", "bound_coverage_slid", "rmse_pose",
)  # fmt: skip
SMALL_LOADS = 0.1
"""Share of the load cases that counts as the small-load regime."""


def load_size(w_e: Array, length_m: float) -> Array:
    """Size (n) of loads (n, 6) in N, moments divided by L."""
    return np.hypot(np.linalg.norm(w_e[:, :3], axis=1), np.linalg.norm(w_e[:, 3:], axis=1) / length_m)


def groups(data: Dataset) -> Iterator[tuple[str, Mask]]:
    """(name, mask) of every group of load cases: by size and direction of the load, by tool, by tendon regime."""
    w = data.samples["w_e"]
    size, edges = load_size(w, data.hand.length_m), (0.0, *MAGNITUDE_EDGES_N, np.inf)
    for k in range(len(edges) - 1):
        yield f"load{k}", (size >= edges[k]) & (size < edges[k + 1])
    main = np.abs(w / np.repeat([1.0, data.hand.length_m], 3)).argmax(1)
    for k, name in enumerate(DIRECTIONS):
        yield name, main == k
    rows = data.grasp_rows()
    for k, name in enumerate(data.manifest["tool_families"]):  # of measured data there are none
        yield f"tool_{name}", data.grasps["tool_family"][rows] == k
    gated = [i >= 0 for i in gated_tendons(data.hand)]
    taut = data.taut()
    if taut is None or not any(gated):
        return
    slack = (~taut[:, gated]).sum(1)
    yield from (("tendons_taut", slack == 0), ("tendons_slack_1", slack == 1), ("tendons_slack_more", slack > 1))


def breakdown(prediction: Prediction, data: Dataset) -> Parts:
    """Figures of every group that has load cases, errors over all truly stable ones, and its share of their squares."""
    figures: Parts = {}
    shares = squared_error_shares(prediction, data)
    for name, mask in groups(data):
        if not mask.any():
            continue
        found = figures_of(prediction.take(mask), data.take(mask))
        kept = {key: found[key] for key in BREAKDOWN_FIGURES if key in found}
        figures[name] = kept | {"n": int(mask.sum()), "error_share": shares[name]}
    return figures


def squared_errors(prediction: Prediction, data: Dataset) -> Array:
    """Squared pose error (n) of the truly stable cases, 0 of the others."""
    s = data.samples
    return np.where(s["stable"] > 0, pose_error(prediction.dx, s["dx_ht"], data.hand.length_m) ** 2, 0.0)


def squared_error_shares(prediction: Prediction, data: Dataset) -> dict[str, float]:
    """Which share of the stable cases' squared error each group carries: where RMSE_pose is made."""
    squares = squared_errors(prediction, data)
    whole = max(squares.sum(), np.finfo(float).tiny)
    return {name: float(squares[mask].sum() / whole) for name, mask in groups(data)}


def gate_figures(prediction: Prediction, data: Dataset) -> dict[str, float]:
    """Predicted engagement against the simulated tendons, over the gated branches of truly stable cases."""
    gated = [i >= 0 for i in gated_tendons(data.hand)]
    if prediction.gate is None or not any(gated):
        return {}
    stable, known = data.samples["stable"] > 0, data.taut()
    if known is None:
        return {}
    taut, gate = known[stable][:, gated], prediction.gate[stable][:, gated]
    return {
        "gate_auroc": auroc(gate.ravel(), taut.ravel()),
        "gate_taut_share": float(taut.mean()),
        "gate_mean_taut": float(gate[taut].mean()),
        "gate_mean_slack": float(gate[~taut].mean()) if (~taut).any() else float("nan"),
    }


def compliance_figures(prediction: Prediction, data: Dataset) -> dict[str, float]:
    """Predicted against simulated compliance where the hand is linear: stable cases of the smallest loads.

    A load case tells K_x along its own wrench: the compliance is w.dx / |w|^2. Beside it the error of the whole motion.
    """
    s, length_m = data.samples, data.hand.length_m
    size = load_size(s["w_e"], length_m)
    small = (size <= np.quantile(size, SMALL_LOADS)) & (s["stable"] > 0)
    w, true, dx = (v[small] for v in (s["w_e"], s["dx_ht"], prediction.dx))
    work, predicted = (w * true).sum(1), (w * dx).sum(1)
    moved = pose_error(dx, true, length_m) / np.maximum(pose_size(true, length_m), 1e-9)
    error = np.abs(predicted - work) / np.maximum(np.abs(work), 1e-15)
    return {
        "small_load_n": int(small.sum()),
        "small_load_max_N": float(size[small].max()) if small.any() else float("nan"),
        "small_load_compliance_error_median": float(np.median(error)) if small.any() else float("nan"),
        "small_load_relative_error_median": float(np.median(moved)) if small.any() else float("nan"),
    }


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of what a hand measures."""

    joint_rad: float = 0.01
    """Of each joint angle."""
    force: float = 0.02
    """Of the wrench, as a share of its force and of its moment, of contacts' normal forces, of tendons' tensions."""
    force_N: float = 0.02
    """The same, absolute; moments: times 0.02 m."""
    contact_m: float = 0.001
    """Of each coordinate of a contact point."""
    normal_rad: float = 0.05
    """Of a contact normal's direction."""
    weight_N: float = 0.05
    """Of each component of the tool's weight, where it is told. Friction is told with its own deviation."""

    def scaled(self, factor: float) -> SensorNoise:
        """Noise `factor` times as large."""
        return SensorNoise(**{name: factor * value for name, value in vars(self).items()})


def noisy_state(hand: Hand, state: Fields, noise: SensorNoise, rng: np.random.Generator) -> dict[str, NDArray]:
    """What noisy sensors give of states (n): q, w_e, contacts, and the closure that follows from these; and of
    the tool's weight and the tendons' tensions, where these are told."""
    n, x_ht = len(state["q"]), state["x_ht"]
    q = state["q"] + noise.joint_rad * rng.normal(size=state["q"].shape)
    w, parts = state["w_e"].copy(), ((slice(0, 3), noise.force_N), (slice(3, 6), 0.02 * noise.force_N))
    for part, absolute in parts:
        size = np.linalg.norm(w[:, part], axis=1, keepdims=True)
        w[:, part] += (noise.force * size + absolute) * rng.normal(size=(n, 3)) / np.sqrt(3)
    c = state["contacts"].copy()
    touching = c[..., 0] > 0
    c[..., 1:4] += touching[..., None] * noise.contact_m * rng.normal(size=(*touching.shape, 3))
    tilted = c[..., 4:7] + noise.normal_rad * rng.normal(size=(*touching.shape, 3)) / np.sqrt(2)
    unit = tilted / np.maximum(np.linalg.norm(tilted, axis=-1, keepdims=True), 1e-9)
    c[..., 4:7] = np.where(touching[..., None], unit, c[..., 4:7])
    c[..., 7] = np.maximum(c[..., 7] * (1 + noise.force * rng.normal(size=touching.shape)), 0) * touching
    j_x, j_q = closure(hand, q, x_ht, c)
    noisy = {"q": q, "w_e": w, "contacts": c, "j_x": j_x, "j_q": j_q}
    for name in (TOOL_WEIGHT, TENDON_TENSION):
        if name in state:
            known, value = np.split(state[name], [1], axis=1)
            spread = noise.weight_N if name == TOOL_WEIGHT else noise.force * value
            noisy[name] = np.hstack([known, known * (value + spread * rng.normal(size=value.shape))])
    return noisy


def with_noise(data: Dataset, noise: SensorNoise, seed: int = 0) -> Dataset:
    """The samples as noisy sensors would give them; the closure follows from the noisy readings."""
    noisy = noisy_state(data.hand, data.samples, noise, np.random.default_rng(seed))
    return Dataset(data.manifest, {**data.samples, **noisy}, data.grasps, data.noise, data.selection)


def noise_part(factor: float) -> str:
    """What figures at `factor` times the sensors' noise are called."""
    return f"noise{factor:g}"


def noise_figures(checkpoint: Checkpoint, data: Dataset, factors: Sequence[float] = NOISE_FACTORS) -> Parts:
    """Figures with sensor noise of some times `SensorNoise`, by `noise_part`."""
    figures: Parts = {}
    for factor in factors:
        noisy = with_noise(data, SensorNoise().scaled(factor))
        found = figures_of(learned(checkpoint, noisy, "noisy"), data)
        figures[noise_part(factor)] = {key: found[key] for key in NOISE_FIGURES if key in found}
    return figures
