"""A model with random weights on a plausible hand, and plausible inputs: what the runtime is tested with.

Deterministic in the seed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn_export.files.layout import Widths, classifier_shapes, stage_shapes, stored_type, sure_shapes
from aminn_export.files.ranges import state_ranges
from aminn_export.files.tables import STAGES, by_branch, dims_of
from aminn_hand import Dims

HEADER = Path(__file__).resolve().parents[2] / "runtime" / "include" / "aminn_hand.h"
SLIDES = "#define AMINN_N_SLIDE 1" in HEADER.read_text()
"""Whether the compiled runtime's contacts can slide."""
DIMS = Dims(branches=3, coordinates=3, joints=8, tendons=6, gates=3, stiff=10, slides=SLIDES)
"""Of the built-in hand, which the compiled runtime is for."""
BRANCH_JOINTS = ((0, 1, 2), (3, 4, 5), (-1, 6, 7))
BRANCHES = ("finger1", "finger2", "thumb")
JOINTS = tuple(
    f"{branch}_{joint}"
    for branch in BRANCHES
    for joint in ("roll", "proximal", "distal")
    if branch != "thumb" or joint != "roll"
)
LINK_A_M = 0.055
LINK_B_M = 0.045
WRENCH_LOG_SCALE = (0.1, 0.1, 0.1, 0.005, 0.005, 0.005)
_MASK = (np.asarray(BRANCH_JOINTS) >= 0).astype(np.float32)


@dataclass(frozen=True)
class RandomModel:
    """An exported model (meta, tensors) that nobody trained."""

    meta: dict
    tensors: dict[str, NDArray[np.float32]]


def _geometry() -> dict[str, NDArray]:
    """Two fingers that roll about z and flex about x, a thumb opposite that flexes the other way; links along +z."""
    base = np.array([[-0.02, 0.04, 0.0], [0.02, 0.04, 0.0], [0.0, -0.04, 0.0]])
    axis = np.zeros((3, 3, 3))
    axis[:2, 0] = [0, 0, 1]
    axis[:2, 1:] = [1, 0, 0]
    axis[2, 1:] = [-1, 0, 0]
    anchor = np.where(_MASK[..., None] > 0, np.stack([base, base, base + np.array([0, 0, LINK_A_M])], 1), 0.0)
    return {"geom_axis": axis, "geom_anchor": anchor}


def _nominal() -> dict[str, NDArray]:
    chol = np.array([[1.5, 1.3, 1.2, 0.0, 0.0, 0.3]] * 3)
    chol[2, [0, 3, 4]] = [1.0, 0.0, 0.0]
    direction = np.array([[0.0, 0.8, 0.6]] * 3)
    return {
        "wrench_log_scale": np.array(WRENCH_LOG_SCALE),
        "chol_nom": chol,
        "tendon_dir_nom": direction,
        "tendon_gain_nom": np.array([3.0, 3.0, 5.0]),
        "gate_nom": np.array([20.0, 0.05, 2.0]),
        "coord_mask": _MASK,
        "theta_terms": _terms(chol, np.array([3.0, 3.0, 5.0])),
    } | _geometry()


def _terms(chol: NDArray, gain: NDArray) -> NDArray:
    """Springs K_b = L L^T as shares of L's columns: what does not change, ten stiffnesses; the last has the gain."""
    rng, n = np.random.default_rng(0), len(DIMS.cholesky_entries)
    rows, cols = np.transpose(DIMS.cholesky_entries)
    lower = np.zeros((DIMS.branches, DIMS.coordinates, DIMS.coordinates))
    lower[:, rows, cols] = chol
    outer = np.einsum("bik,bjk->bkij", lower, lower)[:, :, rows, cols]  # (B, C, K)
    share = rng.dirichlet(np.ones(DIMS.stiff), (DIMS.branches, DIMS.coordinates)) * 0.8 * _MASK[..., None]
    terms = np.zeros((1 + DIMS.stiff, DIMS.branches, n + 1))
    terms[1:, :, :-1] = np.einsum("bkp,bkn->pbn", share, outer)
    terms[0, :, :-1] = outer.sum(1) - terms[1:, :, :-1].sum(0)
    terms[-1, :, -1] = gain
    return terms


UNCUT = (1e3, 1e4)
"""Bounds of motion, m and rad, that cut nothing: limits of verify follow the size of motions."""
STABLE = (0.010, 0.35)
"""Those of a grasp that holds."""


WIDTHS = Widths(32, 64, 64, 32)


def random_model(
    seed: int = 0,
    widths: Widths = WIDTHS,
    dq0: str = "statics",
    eps_m: float = 1e-4,
    motion_limits: tuple[float, float] = UNCUT,
) -> RandomModel:
    """Random weights of a trained model's size; normalisation fitted to `random_inputs`; tau at the median p_stable."""
    rng = np.random.default_rng(seed)
    tensors = dict(_nominal())
    counts = {"tendons": DIMS.tendons, "slides": DIMS.slides, "sensing": False}
    dims = dims_of(RandomModel(counts, tensors))
    eps = by_branch([eps_m, 0.8 * eps_m], dims.branches)
    for stage, width, eps_of_stage in zip(STAGES, widths.trunks, eps, strict=True):
        for name, shape in stage_shapes(dims, widths.contact, width).items():
            tensors[f"{stage}.{name}"] = eps_of_stage if name == "eps_m" else _random_table(rng, name, shape)
        tensors |= {f"{stage}.{k}": v for k, v in _fit_normalisers(random_inputs(512, seed + 1)).items()}
    for name, shape in classifier_shapes(dims, widths.stage1, widths.classifier).items():
        tensors[f"s1.{name}"] = _random_table(rng, name, shape)
    for name, shape in sure_shapes(dims, widths.stage2).items():
        tensors[f"s2.{name}"] = _random_table(rng, name, shape)
    tensors["s2.sure_b"] += [0.0, -7.0]
    tensors |= state_ranges(random_inputs(512, seed + 1))
    tensors["s1.aux_mean"][:] = [0] * 6 + [8] * 6 + [0.5] * 3 + [1] * DIMS.slid
    tensors["s1.aux_inv_std"][:] = [0.5] * 6 + [0.7] * 6 + [2.0] * 3 + [0.5] * DIMS.slid
    tensors = {name: np.asarray(value, stored_type(name, "float32")) for name, value in tensors.items()}
    meta = {
        "format_version": 1,
        "contact_width": widths.contact,
        "width": list(widths.trunks),
        "classifier_width": widths.classifier,
        "length_scale": 0.1,
        "log_range": 2.0,
        "displacement_log_scale": 1e-3,
        "tau": 0.5,
        "eps_m": [eps_m, 0.8 * eps_m],
        "eps_kx": [1e-3, 2e-3],
        "eps_jq": [1e-3, 1e-3],
        "dq0": dq0,
        "friction_nominal": 0.75,
        "max_translation": motion_limits[0],
        "max_rotation": motion_limits[1],
        "bound_edge": [0.25, 0.5, 0.75],
        "bound_factor": [0.9, 1.1, 1.2, 1.5],
        "branches": list(BRANCHES),
        "joints": list(JOINTS),
        "branch_joints": [list(row) for row in BRANCH_JOINTS],
        "checkpoint_sha256": hashlib.sha256(f"random {seed} {widths} {dq0} {eps_m}".encode()).hexdigest(),
    }
    return RandomModel(meta | counts, tensors)


def _random_table(rng: np.random.Generator, name: str, shape: tuple[int, ...]) -> NDArray:
    if name.endswith("_w"):
        gain = 0.4 if name == "head_w" else 1.4
        return gain * rng.normal(size=shape) / np.sqrt(shape[1])
    return 0.1 * rng.normal(size=shape)


def _fit_normalisers(x: dict[str, NDArray]) -> dict[str, NDArray]:
    contacts = x["contacts"].astype(float)
    c = contacts[..., :1]
    j_q = x["j_q"].reshape(len(c), DIMS.branches, 9)
    z_c = np.concatenate([c, c * contacts[..., 1:], c * j_q], -1).reshape(len(c), -1)
    w_log = np.sign(x["w_e"]) * np.log1p(np.abs(x["w_e"]) / np.array(WRENCH_LOG_SCALE))
    z_g = np.concatenate([x["q"], x["x_ht"], x["w_e"], w_log], -1).astype(float)
    out = {}
    for name, z in (("contact", z_c), ("global", z_g)):
        std = z.std(0)
        out[f"{name}_mean"] = z.mean(0)
        out[f"{name}_inv_std"] = 1 / np.where(std > 1e-6, std, 1.0)
    return out


def _rotation(axis: NDArray, angle: NDArray) -> NDArray:
    """Rotation matrices (n, 3, 3) about one axis (Rodrigues)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = angle[:, None, None]
    return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * (k @ k)


def closure(q: NDArray, x_ht: NDArray, contacts: NDArray, tensors: dict[str, NDArray]) -> tuple[NDArray, NDArray]:
    """j_x (n, 3, 3, 6) and j_q (n, 3, 3, 3) in float64 from the geometry, written from the definition."""
    q, x_ht, contacts = (np.asarray(v, float) for v in (q, x_ht, contacts))
    axis, anchor = (np.asarray(tensors[k], float) for k in ("geom_axis", "geom_anchor"))
    n = len(q)
    j_x, j_q = np.zeros((n, 3, 3, 6)), np.zeros((n, 3, 3, 3))
    for b in range(3):
        turn, arm, before = np.broadcast_to(np.eye(3), (n, 3, 3)), contacts[:, b, 1:4], np.zeros(3)
        for i, joint in enumerate(BRANCH_JOINTS[b]):
            arm, before = arm - turn @ (anchor[b, i] - before), anchor[b, i]
            j_q[:, b, :, i] = -np.cross(turn @ axis[b, i], arm) * (joint >= 0)
            if joint >= 0:
                turn = turn @ _rotation(axis[b, i], q[:, joint])
        r = contacts[:, b, 1:4] - x_ht[:, :3]
        j_x[:, b, :, :3] = np.eye(3)
        for i in range(3):
            j_x[:, b, :, 3 + i] = np.cross(np.eye(3)[i], r)
        out = contacts[:, b, 0] == 0
        j_x[out, b], j_q[out, b] = 0, 0
    return j_x, j_q


def random_inputs(n: int, seed: int = 0, fade: bool = False) -> dict[str, NDArray[np.float32]]:
    """n plausible states of the hand (float32, consistent closure); one branch in twelve is out of contact.

    With `fade` the contact flags of the others lie between 0.1 and 1 instead of being 1.
    """
    rng = np.random.default_rng(seed)
    geometry = _geometry()
    roll, flex = rng.uniform(-0.4, 0.4, (n, 2)), rng.uniform(0.1, 0.9, (n, 3))
    bend = rng.uniform(0.1, 1.1, (n, 3))
    q = np.stack([roll[:, 0], flex[:, 0], bend[:, 0], roll[:, 1], flex[:, 1], bend[:, 1], flex[:, 2], bend[:, 2]], 1)
    contacts = np.zeros((n, 3, 8))
    contacts[..., 0] = rng.uniform(size=(n, 3)) > 1 / 12
    contacts[contacts[..., 0].sum(1) == 0, 0, 0] = 1
    for b in range(3):
        roll_joint, proximal, distal = BRANCH_JOINTS[b]
        axis, anchor = geometry["geom_axis"][b], geometry["geom_anchor"][b]
        r1 = _rotation(axis[0], q[:, roll_joint]) if roll_joint >= 0 else np.broadcast_to(np.eye(3), (n, 3, 3))
        r12 = r1 @ _rotation(axis[1], q[:, proximal])
        r123 = r12 @ _rotation(axis[2], q[:, distal])
        tip = r12 @ (anchor[2] - anchor[1]) + r123 @ np.array([0, 0, LINK_B_M])
        contacts[:, b, 1:4] = anchor[1] + tip + 0.004 * rng.normal(size=(n, 3))
    centre = contacts[..., 1:4].mean(1) + 0.01 * rng.normal(size=(n, 3))
    inward = centre[:, None] - contacts[..., 1:4]
    contacts[..., 4:7] = inward / np.linalg.norm(inward, axis=-1, keepdims=True)
    contacts[..., 7] = rng.uniform(0.5, 8, (n, 3))
    contacts *= contacts[..., :1]
    turn = rng.normal(size=(n, 3))
    turn *= (rng.uniform(0, np.pi, n) / np.linalg.norm(turn, axis=1))[:, None]
    x_ht = np.concatenate([centre, turn], 1)
    load = rng.normal(size=(n, 6))
    load[:, :3] *= (10 ** rng.uniform(-1, 1, n) / np.linalg.norm(load[:, :3], axis=1))[:, None]
    load[:, 3:] *= (10 ** rng.uniform(-2.7, -0.7, n) / np.linalg.norm(load[:, 3:], axis=1))[:, None]
    q, x_ht, contacts = (v.astype(np.float32) for v in (q, x_ht, contacts))
    j_x, j_q = closure(q, x_ht, contacts, geometry)
    if fade:
        contacts[..., 0] *= rng.uniform(0.1, 1, (n, 3)).astype(np.float32)
    inputs = {"q": q, "x_ht": x_ht, "w_e": load, "contacts": contacts, "j_x": j_x, "j_q": j_q}
    return {name: np.asarray(value, np.float32) for name, value in inputs.items()}


def random_sensors(dims: Dims, n: int, seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """What sensors of n states say: each is known of two thirds of them; a class of friction, or a measured value."""
    rng = np.random.default_rng(seed)
    found = {name: rng.uniform(0, 2, (n, size)) for name, (size,) in dims.sensors.items()}
    for value in found.values():
        value[:, 0] = rng.uniform(size=n) < 2 / 3
        value[value[:, 0] == 0] = 0
    known = found["friction"][:, 0] > 0
    found["friction"][known, 1:] = np.stack([rng.uniform(0.4, 1.1, n), rng.uniform(0, 0.2, n)], 1)[known]
    found["tool_weight"][:, 1:] -= found["tool_weight"][:, :1]
    return {name: value.astype(np.float32) for name, value in found.items()}
