"""A random model of plausible mechanics and random plausible states, for tests that need no training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn.dims import BRANCH_JOINTS, BRANCHES, JOINTS

F32 = np.float32
BASE_M = np.array([[0.04, 0.03, 0.0], [0.04, -0.03, 0.0], [-0.05, 0.0, 0.0]])
LINK_A_M, LINK_B_M = 0.06, 0.05
TOOL_M = np.array([0.0, 0.0, 0.09])


@dataclass
class RandomExported:
    """Same shape as the trainer's exported model."""

    meta: dict
    tensors: dict[str, NDArray[np.float32]]


def _stage(rng: np.random.Generator, hc: int, h: int) -> dict[str, NDArray]:
    def weight(rows: int, cols: int, gain: float = 1.0) -> NDArray:
        return rng.normal(0, gain / np.sqrt(cols), (rows, cols))

    return dict(
        contact_mean=rng.normal(0, 0.05, 51), contact_inv_std=rng.uniform(0.5, 20, 51),
        global_mean=rng.normal(0, 0.1, 26), global_inv_std=rng.uniform(0.3, 3, 26),
        contact_w=weight(hc, 51), contact_b=rng.normal(0, 0.1, hc),
        trunk1_w=weight(h, hc + 26), trunk1_b=rng.normal(0, 0.1, h),
        trunk2_w=weight(h, h), trunk2_b=rng.normal(0, 0.1, h),
        head_w=weight(39, h, 0.3), head_b=rng.normal(0, 0.05, 39),
    )  # fmt: skip


def random_exported(seed: int = 0, dq0: str = "statics", **meta: object) -> RandomExported:
    """Random weights around a nominal hand."""
    rng = np.random.default_rng(seed)
    hc, h, hd = 32, 64, 32
    tensors = {f"{s}.{k}": v for s in ("s1", "s2") for k, v in _stage(rng, hc, h).items()}
    tensors |= {
        "s1.aux_mean": rng.normal(0, 0.3, 15), "s1.aux_inv_std": rng.uniform(0.3, 1, 15),
        "s1.cls1_w": rng.normal(0, 1 / np.sqrt(h + 15), (hd, h + 15)), "s1.cls1_b": rng.normal(0, 0.1, hd),
        "s1.cls2_w": rng.normal(0, 2 / np.sqrt(hd), (1, hd)), "s1.cls2_b": np.zeros(1),
    }  # fmt: skip
    mask = (np.asarray(BRANCH_JOINTS) >= 0).astype(float)
    diag = np.sqrt(rng.uniform(0.05, 0.5, (3, 3))) * mask + (1 - mask)
    low = rng.normal(0, 0.02, (3, 3)) * mask[:, [1, 2, 2]] * mask[:, [0, 0, 1]]
    direction = np.array([[0.1, -0.7, -0.7], [0.1, -0.7, -0.7], [0, -0.6, -0.8]])
    tensors |= {
        "wrench_log_scale": np.array([0.1] * 3 + [0.005] * 3), "chol_nom": np.concatenate([diag, low], 1),
        "tendon_dir_nom": direction / np.linalg.norm(direction, axis=1, keepdims=True),
        "tendon_gain_nom": rng.uniform(0.2, 1.0, 3), "gate_nom": np.array([20.0, 0.05, 2.0]), "coord_mask": mask,
        "geom_base": BASE_M, "geom_axis": _axes(), "geom_link_a": np.tile([0, 0, LINK_A_M], (3, 1)),
    }  # fmt: skip
    settings = dict(
        format_version=1, length_scale=0.1, log_range=2.0, displacement_log_scale=1e-3, tau=0.43729817, dq0=dq0,
        eps_m=[1e-4, 2e-4], eps_kx=[1e-3, 1e-3], eps_jq=[1e-3, 1e-3], contact_width=hc, width=h, classifier_width=hd,
        branch_joints=[list(row) for row in BRANCH_JOINTS], joints=list(JOINTS), branches=list(BRANCHES),
        checkpoint_sha256="0123456789abcdef" * 4,
    )  # fmt: skip
    return RandomExported(settings | meta, {k: np.ascontiguousarray(v, F32) for k, v in tensors.items()})


def _axes() -> NDArray[np.float64]:
    """Joint axes at q = 0 (branch, coordinate, 3): the fingers bend towards the thumb, and the thumb towards them."""
    axes = np.zeros((3, 3, 3))
    axes[:2, 0], axes[:2, 1:], axes[2, 1:] = [1, 0, 0], [0, -1, 0], [0, 1, 0]
    return axes


def _rotate(axis: NDArray, angle: float) -> NDArray[np.float64]:
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def _branch(b: int, q: NDArray, tool: NDArray, rng: np.random.Generator) -> tuple[NDArray, NDArray, NDArray]:
    """(contact row (8), j_x (3, 6), j_q (3, 3)) of a branch in contact."""
    axis, angle = _axes()[b], [q[j] if j >= 0 else 0.0 for j in BRANCH_JOINTS[b]]
    r1 = _rotate(axis[0], angle[0]) if b < 2 else np.eye(3)
    r12 = r1 @ _rotate(axis[1], angle[1])
    r123 = r12 @ _rotate(axis[2], angle[2])
    a = r12 @ np.array([0, 0, LINK_A_M])
    contact = BASE_M[b] + a + r123 @ np.array([0, 0, LINK_B_M]) + rng.normal(0, 0.003, 3)
    z = np.array([axis[0], r1 @ axis[1], r12 @ axis[2]])
    arm = contact - BASE_M[b]
    columns = np.stack([np.cross(z[0], arm), np.cross(z[1], arm), np.cross(z[2], arm - a)], 1)
    r = contact - tool
    skew = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    normal = -r / np.linalg.norm(r)
    row = np.concatenate([[1.0], contact, normal, [rng.uniform(0.5, 8)]])
    return row, np.concatenate([np.eye(3), -skew], 1), -columns


def random_inputs(n: int, seed: int = 0, contact_share: float = 0.85) -> dict[str, NDArray[np.float32]]:
    """n plausible states of the hand; each branch is in contact with this probability."""
    rng = np.random.default_rng(seed)
    q = rng.normal([0, 0.3, 0.5, 0, 0.3, 0.5, 0.3, 0.5], 0.2, (n, 8))
    x_ht = np.concatenate([TOOL_M + rng.normal(0, 0.01, (n, 3)), rng.normal(0, 0.5, (n, 3))], 1)
    size = 10 ** rng.uniform(-1, 1, (n, 1))
    w_e = rng.normal(0, 1, (n, 6)) * size * np.array([0.6] * 3 + [0.01] * 3)
    contacts, j_x, j_q = np.zeros((n, 3, 8)), np.zeros((n, 3, 3, 6)), np.zeros((n, 3, 3, 3))
    for i in range(n):
        for b in range(3):
            if rng.random() < contact_share:
                contacts[i, b], j_x[i, b], j_q[i, b] = _branch(b, q[i], x_ht[i, :3], rng)
    values = dict(q=q, x_ht=x_ht, w_e=w_e, contacts=contacts, j_x=j_x, j_q=j_q)
    return {name: np.ascontiguousarray(v, F32) for name, v in values.items()}
