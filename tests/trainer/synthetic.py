"""A small made-up hand and data set, so that the trainer's tests need no simulator.

The hand has the shape of the real one (two mirrored fingers, a thumb) with round numbers. Its labels come from the
analytical statics with springs that differ from the nominal ones, so there is something to learn.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import h5py
import numpy as np

from aminn.hand.dims import BRANCH_JOINTS, BRANCHES, JOINTS

ARM_M = 0.008
FAMILIES = ["cylinder", "capsule", "ellipsoid", "screwdriver"]


def hand() -> dict:
    """The `hand` entry of a manifest; the fingers are mirror images in the plane x = 0."""
    x, z = [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    stiffness = [0.4, 0.05, 0.05]
    tendons = []
    for branch in range(3):
        tendons.append(
            {"branch": branch, "moment_arm_m": [0, -ARM_M, 0], "stiffness_N_m": 2000.0, "max_tension_N": 40.0}
        )
        tendons.append(
            {
                "branch": branch,
                "moment_arm_m": [0, -ARM_M, -0.8 * ARM_M],
                "stiffness_N_m": 2000.0,
                "max_tension_N": 40.0,
            }
        )
    return {
        "name": "synthetic",
        "branches": list(BRANCHES),
        "joints": list(JOINTS),
        "branch_joints": [list(row) for row in BRANCH_JOINTS],
        "base_m": [[-0.02, 0.03, 0], [0.02, 0.03, 0], [0, -0.03, 0]],
        "axis": [[z, x, x], [[0.0, 0.0, -1.0], x, x], [[0.0, 0.0, 0.0], x, x]],
        "link_a_m": [(0.05 * np.array(z)).tolist()] * 3,
        "link_b_m": [(0.04 * np.array(z)).tolist()] * 3,
        "tip_radius_m": [0.008] * 3,
        "joint_stiffness_Nm_rad": [stiffness, stiffness, [0.0, *stiffness[1:]]],
        "tendons": tendons,
    }


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix about a unit axis."""
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def closure(h: dict, q: np.ndarray, tool: np.ndarray, contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J_x (3, 3, 6) and J_q (3, 3, 3) for joint angles q (8), tool origin (3) and contact points (3, 3)."""
    j_x, j_q = np.zeros((3, 3, 6)), np.zeros((3, 3, 3))
    for b in range(3):
        roll, proximal, _ = BRANCH_JOINTS[b]
        axes, base = np.array(h["axis"][b]), np.array(h["base_m"][b])
        r1 = rotation(axes[0], q[roll]) if roll >= 0 else np.eye(3)
        r2 = rotation(axes[1], q[proximal])
        a, s, r = r1 @ r2 @ np.array(h["link_a_m"][b]), contact[b] - base, contact[b] - tool
        columns = [np.cross(axes[0], s), np.cross(r1 @ axes[1], s), np.cross(r1 @ r2 @ axes[2], s - a)]
        j_q[b] = -np.stack(columns, 1)
        j_x[b] = np.hstack([np.eye(3), -np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])])
    return j_x, j_q


def draw_inputs(rng: np.random.Generator, h: dict) -> dict[str, np.ndarray]:
    """One grasp: q, x_ht, contacts, j_x, j_q, fingertips a little off the tool's origin."""
    q = rng.uniform(0.2, 0.9, 8)
    q[[0, 3]] = rng.uniform(-0.3, 0.3, 2)
    tool = np.array([0, 0, 0.075]) + rng.uniform(-0.01, 0.01, 3)
    offsets = np.array([[-0.015, 0.02, 0], [0.015, 0.02, 0], [0, -0.02, 0]])
    contact = tool + offsets + rng.uniform(-0.006, 0.006, (3, 3))
    normal = -offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    j_x, j_q = closure(h, q, tool, contact)
    contacts = np.hstack([np.ones((3, 1)), contact, normal, rng.uniform(2, 8, (3, 1))])
    return dict(q=q, x_ht=np.concatenate([tool, rng.uniform(-0.5, 0.5, 3)]), contacts=contacts, j_x=j_x, j_q=j_q)


def draw_wrench(rng: np.random.Generator) -> np.ndarray:
    """A random load: magnitude over two decades."""
    w = rng.normal(size=6)
    w[:3] *= 10 ** rng.uniform(-1, 1.2) / np.linalg.norm(w[:3])
    w[3:] *= 10 ** rng.uniform(-3, -1.3) / np.linalg.norm(w[3:])
    return w


def write_dataset(path: Path, grasps: int = 60, cases: int = 8, seed: int = 0) -> None:
    """Write a data set in the layout of the simulator."""
    rng, h = np.random.default_rng(seed), hand()
    rows: dict[str, list[np.ndarray]] = {}
    for grasp in range(grasps):
        x = draw_inputs(rng, h)
        softness = np.exp(0.8 * np.sin(5 * x["q"][1]))
        for _ in range(cases):
            w = draw_wrench(rng)
            k_x = np.zeros((6, 6))
            for b in range(3):
                k = np.diag([0.4 if b < 2 else 1.0, 0.2 / softness, 0.15])
                m = x["j_q"][b] @ np.linalg.inv(k) @ x["j_q"][b].T + 1e-4 * np.eye(3)
                k_x += x["j_x"][b].T @ np.linalg.inv(m) @ x["j_x"][b]
            dx = np.linalg.solve(k_x, w)
            stable = np.linalg.norm(dx[:3]) < 0.012
            tension = np.maximum(rng.normal(1, 1, 6), 0)
            row = x | {"w_e": w, "dx_ht": dx, "q_after": x["q"], "stable": np.uint8(stable),
                       "tendon_tension_after_N": tension, "grasp_id": np.int64(grasp)}  # fmt: skip
            for name, value in row.items():
                rows.setdefault(name, []).append(np.asarray(value))
    path.mkdir(parents=True)
    with h5py.File(path / "shard-00000.h5", "w") as file:
        for name, values in rows.items():
            file[f"samples/{name}"] = np.stack(values)
        file["grasps/grasp_id"] = np.arange(grasps)
        file["grasps/tool_family"] = np.arange(grasps) % len(FAMILIES)
        file["grasps/friction"] = np.random.default_rng(seed).uniform(0.4, 1.1, grasps)
        file["grasps/tendon_tension_N"] = np.random.default_rng(seed).uniform(0, 10, (grasps, 6))
        capsule = [[3, 0.015, 0.035, 0, 0, 0, 0, 0.5**0.5, 0, 0.5**0.5, 0], [-1] + [0] * 10, [-1] + [0] * 10]
        file["grasps/tool_geoms"] = np.tile(np.array(capsule, float), (grasps, 1, 1))
        file["grasps/tool_size_m"] = np.tile([0.05, 0.015, 0.015], (grasps, 1))
        again = np.arange(0, grasps * cases, 10)
        file["noise/sample"] = again
        for name, change in (("half_step", 0.999), ("impratio", 0.99)):
            file[f"noise/dx_{name}"] = change * file["samples/dx_ht"][()][again]
            file[f"noise/stable_{name}"] = file["samples/stable"][()][again]
    shard = {
        "file": "shard-00000.h5",
        "n_samples": grasps * cases,
        "n_grasps": grasps,
        "sha256": hashlib.sha256((path / "shard-00000.h5").read_bytes()).hexdigest(),
    }
    manifest = {"schema_version": 3, "seed": seed, "tool_families": FAMILIES,
                "config_sha256": hashlib.sha256(f"{grasps} {cases} {seed}".encode()).hexdigest(), "hand": h,
                "shards": [shard], "n_samples": grasps * cases, "n_grasps": grasps}  # fmt: skip
    (path / "manifest.json").write_text(json.dumps(manifest))
