"""What a data set is like, and how far its labels can be trusted: flat figures for a report."""

from __future__ import annotations

import dataclasses

import numpy as np

from . import _core
from .config import SimulationConfig
from .errors import SimulationError
from .read import Array, SimulatedData
from .theory import ROTATION_ARM_M, relative_error

_SCALE = np.array([1.0] * 3 + [ROTATION_ARM_M] * 3)


def _percentiles(name: str, values: Array, which: tuple[int, ...]) -> dict[str, float]:
    return {f"{name}_{'median' if p == 50 else f'p{p:02d}'}": float(np.percentile(values, p)) for p in which}


def dataset_figures(data: SimulatedData) -> dict[str, float]:
    """Shares of labels and rejections, sizes of stable motions, passivity, tendons, and the labels' quality."""
    stable = data.samples["stable"] == 1
    if not stable.any():
        raise SimulationError("figures: the data set has no stable sample")
    out = {"dataset_samples": float(len(stable)), "dataset_grasps": float(len(data.grasps["grasp_id"]))}
    return (
        out
        | _shares(data, stable)
        | _stable_by_load(data, stable)
        | _motions(data, stable)
        | _tendons(data, stable)
        | _quality(data, stable)
    )


def _shares(data: SimulatedData, stable: Array) -> dict[str, float]:
    out = {}
    for index, reason in enumerate(data.manifest["reasons"]):
        out[f"share_{reason}"] = float((data.samples["reason"] == index).mean())
    family = data.of_grasp("tool_family")
    for index, name in enumerate(data.manifest["tool_families"]):
        if (family == index).any():
            out[f"share_stable_{name}"] = float(stable[family == index].mean())
    rejected = data.grasps["rejections"].sum(0)
    grasps = len(data.grasps["grasp_id"])
    out["grasp_yield"] = grasps / float(grasps + rejected.sum())
    for reason, count in zip(data.manifest["rejection_reasons"], rejected, strict=True):
        out[f"rejections_a_grasp_{reason}"] = float(count) / grasps
    return out


def _stable_by_load(data: SimulatedData, stable: Array) -> dict[str, float]:
    """Stable share of pure forces at the origin and of pure moments, by quarters of their logarithmic range."""
    w, out = data.samples["w_e"], {}
    force, moment = np.linalg.norm(w[:, :3], axis=1), np.linalg.norm(w[:, 3:], axis=1)
    for name, size, other in (("force_N", force, moment), ("moment_Nm", moment, force)):
        pure = (size > 0) & (other == 0)
        if not pure.any():
            continue
        edges = np.geomspace(size[pure].min(), size[pure].max(), 5)
        quarter = np.clip(np.searchsorted(edges, size, side="right"), 1, 4)
        for k in range(1, 5):
            mine = pure & (quarter == k)
            if mine.any():
                out[f"share_stable_pure_{name}_up_to_{edges[k]:.2g}"] = float(stable[mine].mean())
    return out


def _motions(data: SimulatedData, stable: Array) -> dict[str, float]:
    w, dx = data.samples["w_e"], data.samples["dx_ht"]
    translation, rotation = np.linalg.norm(dx[:, :3], axis=1), np.linalg.norm(dx[:, 3:], axis=1)
    force, moment = np.linalg.norm(w[:, :3], axis=1), np.linalg.norm(w[:, 3:], axis=1)
    pure = stable & (force > 0) & (moment == 0)
    out = _percentiles("stable_translation_m", translation[stable], (5, 50, 95))
    out |= _percentiles("stable_rotation_rad", rotation[stable], (5, 50, 95))
    if pure.any():
        out |= _percentiles("compliance_m_N", translation[pure] / force[pure], (5, 50, 95))
    out["negative_full_work_share"] = float(((w * dx).sum(1) < 0)[stable].mean())
    out["negative_translational_work_share"] = float(((w[:, :3] * dx[:, :3]).sum(1) < 0)[stable].mean())
    return out


def _tendons(data: SimulatedData, stable: Array) -> dict[str, float]:
    """Taut or slack, over the stable load cases: after the load, and changed by it; of cables alone."""
    branches = data.hand.branches
    loose = np.array([t.pull_only for b in branches for t in b.tendons], bool)
    gated = np.array([i == b.gated_tendon for b in branches for i in range(len(b.tendons))], bool)
    if not loose.any():
        return {}
    before, after = data.of_grasp("tendon_tension_N") > 0, data.samples["tendon_tension_after_N"] > 0
    out = {
        "cases_with_a_slack_tendon_share": float((~after[stable][:, loose]).any(1).mean()),
        "cases_with_all_tendons_taut_share": float(after[stable][:, loose].all(1).mean()),
        "cases_tendon_changes_state_share": float((before != after)[:, loose].any(1)[stable].mean()),
        "gated_tendons_slack_share": float((~after[stable][:, gated]).mean()),
    }
    others = loose & ~gated
    if others.any():
        out["other_tendons_slack_share"] = float((~after[stable][:, others]).mean())
    return out


def _quality(data: SimulatedData, stable: Array) -> dict[str, float]:
    s = data.samples
    out: dict[str, float] = {}
    for name in ("creep_rate_m_s", "drift_m_s", "worst_penetration_m", "settle_time_s", "hold_time_s"):
        out |= _percentiles(name, s[name][stable], (50, 99))
    for name in ("equilibrium_residual", "solver_residual"):
        out |= _percentiles(name, s[name][stable], (50, 99)) | {f"{name}_max": float(s[name][stable].max())}
    return out | noise_figures(data)


def noise_figures(data: SimulatedData) -> dict[str, float]:
    """How far labels move when the same case is simulated at half the time step or at ten times impratio."""
    rows = data.noise["sample"].astype(int)
    if len(rows) == 0:
        return {}
    stable, dx = data.samples["stable"][rows], data.samples["dx_ht"][rows]
    out = {"noise_cases": float(len(rows))}
    for name in ("half_step", "impratio"):
        other = data.noise[f"stable_{name}"]
        both = (stable == 1) & (other == 1)
        out[f"noise_{name}_labels_changed_share"] = float((stable != other).mean())
        if both.any():
            apart = data.noise[f"dx_{name}"][both] - dx[both]
            out |= _percentiles(f"noise_{name}_relative", relative_error(dx[both] + apart, dx[both]), (50, 90, 99))
            out[f"noise_{name}_rmse_pose"] = float(np.sqrt(np.mean(np.sum((apart * _SCALE / 0.1) ** 2, 1))))
    return out


def waiting_figures(
    simulator: _core.Simulator, config: SimulationConfig, threads: int, grasps: int, cases: int
) -> dict[str, float]:
    """The same load cases held at least as long as `hold_max_s`, and given up after twice that: labels that change."""
    config = dataclasses.replace(config, noise_share=0.0)
    longer = dataclasses.replace(config, hold_s=config.hold_max_s, hold_max_s=2 * config.hold_max_s)
    short, long = (
        simulator.shard(c.options(), c.seed, 0, 0, grasps, cases, threads, c.family_indices())["samples"]
        for c in (config, longer)
    )
    both = (short["stable"] == 1) & (long["stable"] == 1)
    doubled = long["hold_time_s"][both] >= 2 * short["hold_time_s"][both]
    return {
        "waiting_cases": float(grasps * cases),
        "waiting_at_least_doubled_share": float(doubled.mean()),
        "waiting_labels_changed_share": float((short["stable"] != long["stable"]).mean()),
        **_percentiles("waiting_relative", relative_error(long["dx_ht"][both], short["dx_ht"][both]), (50, 99)),
        **_percentiles("waiting_creep_rate_m_s", long["creep_rate_m_s"][both], (50, 99)),
    }
