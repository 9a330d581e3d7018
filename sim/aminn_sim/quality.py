"""What a data set is like, and how far its labels can be trusted: flat figures for a report."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .config import SimulationConfig
from .errors import SimulationError
from .simulate import load_simulator

Array = NDArray[np.float64]
_SCALE = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # rotations count by an arm of 0.1 m


def _percentiles(name: str, values: Array, which: tuple[int, ...]) -> dict[str, float]:
    return {f"{name}_{'median' if p == 50 else f'p{p:02d}'}": float(np.percentile(values, p)) for p in which}


def dataset_figures(manifest: dict, samples: dict[str, Array], grasps: dict[str, Array]) -> dict[str, float]:
    """Shares of labels, sizes of stable motions, tendons that change state, and the labels' own quality."""
    stable = samples["stable"] == 1
    if not stable.any():
        raise SimulationError("figures: the data set has no stable sample")
    w, dx = samples["w_e"], samples["dx_ht"]
    row = np.searchsorted(grasps["grasp_id"], samples["grasp_id"])
    out = {"dataset_samples": float(len(stable)), "dataset_grasps": float(len(grasps["grasp_id"]))}
    for index, reason in enumerate(manifest["reasons"]):
        out[f"share_{reason}"] = float((samples["reason"] == index).mean())
    for index, family in enumerate(manifest["tool_families"]):
        mine = grasps["tool_family"][row] == index
        if mine.any():
            out[f"share_stable_{family}"] = float(stable[mine].mean())

    translation, rotation = np.linalg.norm(dx[:, :3], axis=1), np.linalg.norm(dx[:, 3:], axis=1)
    force, moment = np.linalg.norm(w[:, :3], axis=1), np.linalg.norm(w[:, 3:], axis=1)
    pure = stable & (force > 0) & (moment == 0)
    out |= _percentiles("stable_translation_m", translation[stable], (5, 50, 95))
    out |= _percentiles("stable_rotation_rad", rotation[stable], (5, 50, 95))
    if pure.any():
        out |= _percentiles("compliance_m_N", translation[pure] / force[pure], (5, 50, 95))
    out["negative_full_work_share"] = float(((w * dx).sum(1) < 0)[stable].mean())
    out["negative_translational_work_share"] = float(((w[:, :3] * dx[:, :3]).sum(1) < 0)[stable].mean())

    before, after = grasps["tendon_tension_N"][row] > 0, samples["tendon_tension_after_N"] > 0
    out["tendon_changes_state_share"] = float((before != after).any(1)[stable].mean())
    out["proximal_flexor_slack_share"] = float((grasps["tendon_tension_N"][:, 0::2] == 0).mean())
    out["distal_flexor_slack_share"] = float((~after[stable][:, 1::2]).mean())

    early = np.linalg.norm((dx - samples["dx_ht_early"]) * _SCALE, axis=1) / np.linalg.norm(dx * _SCALE, axis=1)
    out |= _percentiles("early_displacement_relative", early[stable], (50, 99))
    for name in ("creep_rate_m_s", "worst_penetration_m"):
        out |= _percentiles(name, samples[name][stable], (50, 99))
    return out


def label_noise(config: SimulationConfig, threads: int, grasps: int = 24, cases: int = 10) -> dict[str, float]:
    """The same load cases with the configured hold and with one of 2 s: labels that differ, displacements apart."""
    longer = dataclasses.replace(config, hold_s=2.0)
    simulator = load_simulator()
    short, long = (
        simulator.shard(c.options(), c.seed, 0, 0, grasps, cases, threads, c.family_indices())["samples"]
        for c in (config, longer)
    )
    both = (short["stable"] == 1) & (long["stable"] == 1)
    apart = np.linalg.norm((short["dx_ht"] - long["dx_ht"]) * _SCALE, axis=1)
    relative = (apart / np.linalg.norm(long["dx_ht"] * _SCALE, axis=1))[both]
    return {
        "long_hold_cases": float(grasps * cases),
        "long_hold_labels_changed": float((short["stable"] != long["stable"]).sum()),
        **_percentiles("long_hold_relative", relative, (50, 99)),
        **_percentiles("long_hold_creep_m_s", long["creep_rate_m_s"][both], (50, 99)),
    }
