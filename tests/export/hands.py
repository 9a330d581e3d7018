"""Hands of many shapes, made up or shipped, with random models and states of each: what nobody trained or simulated."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from runtime_models import SLIDES, UNCUT

from aminn.hand.nominal import nominal_of, stiffness_terms
from aminn_export.files.layout import Widths
from aminn_export.files.ranges import state_ranges
from aminn_export.files.tables import HAND, STAGES, dims_of
from aminn_export.samples.reference import Reference
from aminn_hand.hand import Branch, ContactModel, Coordinate, Hand, Tendon
from aminn_hand.theta import Theta
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

SHIPPED = default_hand_file().parent / "hands"
REFERENCE_HAND = "three_finger_hand"
WIDTHS = Widths(16, 24, 24, 12)
UNEVEN = Widths(16, 20, 24, 12)
SOFT = ContactModel("soft_finger", 0.003)
POINTS = ContactModel("point", 0.0)
WRENCH_LOG_SCALE = (0.1, 0.1, 0.1, 0.005, 0.005, 0.005)


@dataclass(frozen=True)
class Model:
    """An exported model of a hand, with random weights."""

    meta: dict
    tensors: dict[str, NDArray]


# --- hands ----------------------------------------------------------------------------------------------------------
def made_up(joints: tuple[int, ...], tendons: tuple[int, ...], name: str) -> Hand:
    """Branches in a circle about the palm's z axis, each with so many joints and so many cables; axes are askew."""
    rng, n = np.random.default_rng(len(joints)), len(joints)
    branches = []
    for b, (count, cables) in enumerate(zip(joints, tendons, strict=True)):
        angle = 2 * np.pi * b / n
        outwards = np.array([np.cos(angle), np.sin(angle), 0])
        base = 0.04 * outwards
        across = np.cross([0, 0, 1], outwards)
        coordinates = []
        for c in range(count):
            axis = (across if c or count < 3 else np.array([0, 0, 1])) + 0.1 * rng.normal(size=3)
            anchor = base + [0, 0, 0.025 * c] + 0.003 * rng.normal(size=3)
            unit = tuple((axis / np.linalg.norm(axis)).tolist())
            spring = float(rng.uniform(0.2, 1.5))
            coordinates.append(Coordinate(f"b{b}_j{c}", unit, tuple(anchor.tolist()), -0.5, 1.5, spring, 0.0))
        arms = [tuple((rng.uniform(0.004, 0.01, count)).tolist()) for _ in range(cables)]
        ropes = tuple(Tendon(f"b{b}_t{i}", arm, 2e4, True, 40.0) for i, arm in enumerate(arms))
        tip = tuple((base + np.array([0, 0, 0.025 * count + 0.02])).tolist())
        branches.append(Branch(f"b{b}", "finger", tuple(coordinates), ropes, (), f"b{b}_tip", tip, 2e-5 * (b + 1)))
    return Hand(name, tuple(branches), (0.0, 0.0, 1.0))


@cache
def shipped(name: str) -> Hand:
    """One of sim/models/hands."""
    return understand(SHIPPED / f"{name}.toml").hand


HANDS = {
    "gripper": lambda: shipped("gripper"),  # 2 x 2, gates, soft fingertips
    "allegro_like": lambda: shipped("allegro_like"),  # 4 x 4, no tendons
    "barrett_like": lambda: shipped("barrett_like"),  # 3, 3, 2, no tendons
    "aero_like": lambda: shipped("aero_like"),  # 3, 3, 3, 3, 4
    "five_by_five": lambda: made_up((5,) * 5, (1,) * 5, "five_by_five"),
    "two_by_one": lambda: made_up((1, 1), (0, 0), "two_by_one"),
    "point_gripper": lambda: replace(shipped("gripper"), name="point_gripper", contact=POINTS),
    "soft_three": lambda: replace(made_up((3, 1, 2), (0, 0, 0), "soft_three"), contact=SOFT),
    "one_cable": lambda: made_up((2, 4, 1), (0, 2, 0), "one_cable"),  # one branch of three has a gate
}


# --- models ---------------------------------------------------------------------------------------------------------
def _nominal(hand: Hand) -> dict[str, NDArray]:
    dims = hand.dims
    b, c = dims.branches, dims.coordinates
    rows, columns = zip(*dims.cholesky_entries, strict=True)
    chol = np.zeros((b, dims.cholesky))
    direction, gain = np.zeros((b, c)), np.zeros(b)
    axis, anchor = np.zeros((b, c, 3)), np.zeros((b, c, 3))
    for i, branch in enumerate(hand.branches):
        own = slice(c - len(branch.coordinates), c)
        axis[i, own], anchor[i, own] = zip(*((k.axis, k.anchor_m) for k in branch.coordinates), strict=True)
        taut = [t != branch.gated_tendon for t in range(len(branch.tendons))]
        springs = np.eye(c)
        springs[own, own] = branch.stiffness(taut)
        chol[i] = np.linalg.cholesky(springs)[list(rows), list(columns)]
        if branch.gated_tendon is not None:
            tendon = branch.tendons[branch.gated_tendon]
            arm = np.array(tendon.arm_m)
            direction[i, own] = -arm / np.linalg.norm(arm)
            gain[i] = tendon.stiffness_N_m * arm @ arm
    tables = {
        "wrench_log_scale": np.array(WRENCH_LOG_SCALE),
        "chol_nom": chol,
        "coord_mask": hand.coordinate_mask,
        "geom_axis": axis,
        "geom_anchor": anchor,
    }
    tendons = {"tendon_dir_nom": direction, "tendon_gain_nom": gain, "gate_nom": np.array([20.0, 0.05, 2.0])}
    soft = {"twist_nom": nominal_of(hand).twist} if hand.contact.kind == "soft_finger" else {}
    tables["theta_terms"] = stiffness_terms(hand)
    return tables | (tendons if dims.gates else {}) | soft


def _random_table(rng: np.random.Generator, name: str, shape: tuple[int, ...]) -> NDArray:
    if name.endswith("_w"):
        return (0.4 if name == "head_w" else 1.4) * rng.normal(size=shape) / np.sqrt(shape[-1])
    return 0.1 * rng.normal(size=shape)


def _normalisers(x: dict[str, NDArray]) -> dict[str, NDArray]:
    contacts = x["contacts"].astype(float)
    n, c = len(contacts), contacts[..., :1]
    z_c = np.concatenate([c, c * contacts[..., 1:], c * x["j_q"].reshape(*c.shape[:2], -1)], -1).reshape(n, -1)
    w_log = np.sign(x["w_e"]) * np.log1p(np.abs(x["w_e"]) / np.array(WRENCH_LOG_SCALE))
    z_g = np.concatenate([x["q"], x["x_ht"], x["w_e"], w_log], -1).astype(float)
    found = {}
    for name, z in (("contact", z_c), ("global", z_g)):
        std = z.std(0)
        found |= {f"{name}_mean": z.mean(0), f"{name}_inv_std": 1 / np.where(std > 1e-6, std, 1.0)}
    return found


def random_model(
    hand: Hand,
    seed: int = 0,
    told: bool = False,
    slides: bool | None = None,
    sensing: bool = False,
    widths: Widths = WIDTHS,
) -> Model:
    """Random weights on the hand's nominal mechanics; eps_m differs by branch and stage as the hand's does.

    slides: whether contacts can; None: of the reference hand as the compiled runtime has it, of others not.
    """
    if slides is None:
        slides = SLIDES and hand.name == REFERENCE_HAND
    rng, hc, hd = np.random.default_rng(seed), widths.contact, widths.classifier
    x = random_states(hand, 200, seed + 1)
    tensors = _nominal(hand)
    counts = {"tendons": hand.dims.tendons, "slides": slides, "sensing": sensing}
    dims = replace(dims_of(Model(counts, tensors)), factors=Theta(hand).factors if told else 0)
    for stage, h in zip(STAGES, widths.trunks, strict=True):
        sizes = {"contact": (hc, dims.contact_input), "trunk1": (h, hc + dims.global_input), "trunk2": (h, h)}
        sizes["head"] = (dims.head, h)
        for layer, shape in sizes.items():
            tensors[f"{stage}.{layer}_w"] = _random_table(rng, f"{layer}_w", shape)
            tensors[f"{stage}.{layer}_b"] = _random_table(rng, f"{layer}_b", shape[:1])
        found = _normalisers(x)
        found["global_mean"] = np.append(found["global_mean"], np.full(dims.factors + dims.sensing, 0.05))
        found["global_inv_std"] = np.append(found["global_inv_std"], np.full(dims.factors + dims.sensing, 3.0))
        tensors |= {f"{stage}.{k}": v for k, v in found.items()}
    for layer, shape in {"cls1": (hd, widths.stage1 + dims.aux), "cls2": (1, hd)}.items():
        tensors[f"s1.{layer}_w"] = _random_table(rng, f"{layer}_w", shape)
        tensors[f"s1.{layer}_b"] = _random_table(rng, f"{layer}_b", shape[:1])
    tensors["s2.sure_w"] = _random_table(rng, "sure_w", (2, widths.stage2 + dims.sure))
    tensors["s2.sure_b"] = _random_table(rng, "sure_b", (2,)) + np.array([0.0, -7.0])
    tensors["s2.sure_mean"], tensors["s2.sure_inv_std"] = np.full(dims.sure, 0.5), np.full(dims.sure, 0.7)
    gates = dims.aux - 12 - dims.slid
    tensors["s1.aux_mean"] = np.array([0.0] * 6 + [8.0] * 6 + [0.5] * gates + [1.0] * dims.slid)
    tensors["s1.aux_inv_std"] = np.array([0.5] * 6 + [0.7] * 6 + [2.0] * gates + [0.5] * dims.slid)
    tensors |= state_ranges(x)
    eps_m = [[branch.eps_m * factor for branch in hand.branches] for factor in (1.0, 0.8)]
    tensors |= {f"{stage}.eps_m": np.array(values) for stage, values in zip(STAGES, eps_m, strict=True)}
    tensors = {name: np.asarray(value, np.float32) for name, value in tensors.items()}
    meta = {
        "format_version": 1,
        "contact_width": hc,
        "width": list(widths.trunks),
        "classifier_width": hd,
        "length_scale": hand.length_m,
        "log_range": 2.0,
        "displacement_log_scale": 1e-3,
        "tau": 0.5,
        "eps_m": eps_m,
        "eps_kx": [1e-2, 1e-3],
        "eps_jq": [1e-3, 1e-3],
        "dq0": "statics",
        "friction_nominal": 0.75,
        "max_translation": UNCUT[0],
        "max_rotation": UNCUT[1],
        "bound_edge": [0.25, 0.5, 0.75],
        "bound_factor": [0.9, 1.1, 1.2, 1.5],
        **counts,
        "hand": f"{hand.name} {hand.sha256[:8]}",
        HAND: hand.as_dict(),
        "branches": [b.name for b in hand.branches],
        "joints": list(hand.joints),
        "told": told,
        "theta_names": list(Theta(hand).names),
        "theta_units": [p.unit for p in Theta(hand).parameters],
        "branch_joints": [list(row) for row in hand.coordinate_joints],
        "checkpoint_sha256": hashlib.sha256(f"random {hand.name} {seed}".encode()).hexdigest(),
    }
    p_stable = Reference(Model(meta, tensors))(x)["p_stable"]
    return Model(meta | {"tau": float(np.float32(np.median(p_stable)))}, tensors)


def same_eps_m(model: Model, value: float) -> Model:
    """The model with one contact compliance."""
    tables = {f"{stage}.eps_m": np.full_like(model.tensors[f"{stage}.eps_m"], value) for stage in STAGES}
    return replace(model, meta=model.meta | {"eps_m": value}, tensors=model.tensors | tables)


# --- states ---------------------------------------------------------------------------------------------------------
def random_states(hand: Hand, n: int, seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """n states near the middle of the joints' ranges, contacts at the pads; one branch in twelve is out of contact."""
    rng, dims = np.random.default_rng(seed), hand.dims
    limits = np.array([(c.low_rad, c.high_rad) for b in hand.branches for c in b.coordinates])
    low, high = limits.T
    middle, reach = (low + high) / 2, np.minimum(high - low, 1.0)
    q = (middle + reach * rng.uniform(-0.4, 0.4, (n, dims.joints))).astype(np.float32)
    contacts = np.zeros((n, dims.branches, 8))
    contacts[..., 0] = rng.uniform(size=(n, dims.branches)) > 1 / 12
    contacts[contacts[..., 0].sum(1) == 0, 0, 0] = 1
    for i in range(n):
        for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
            contacts[i, b, 1:4] = branch.moved(q[i, at].astype(float), np.array(branch.tip_point_m))
    contacts[..., 1:4] += 0.004 * rng.normal(size=(n, dims.branches, 3))
    centre = contacts[..., 1:4].mean(1) + 0.01 * rng.normal(size=(n, 3))
    inward = centre[:, None] - contacts[..., 1:4]
    contacts[..., 4:7] = inward / np.linalg.norm(inward, axis=-1, keepdims=True)
    contacts[..., 7] = rng.uniform(0.5, 8, (n, dims.branches))
    contacts = (contacts * contacts[..., :1]).astype(np.float32)
    turn = rng.normal(size=(n, 3))
    turn *= (rng.uniform(0, np.pi, n) / np.linalg.norm(turn, axis=1))[:, None]
    x_ht = np.concatenate([centre, turn], 1).astype(np.float32)
    load = rng.normal(size=(n, 6))
    load[:, :3] *= (10 ** rng.uniform(-1, 1, n) / np.linalg.norm(load[:, :3], axis=1))[:, None]
    load[:, 3:] *= (10 ** rng.uniform(-2.7, -0.7, n) / np.linalg.norm(load[:, 3:], axis=1))[:, None]
    j_x, j_q = closure_of(hand, q, x_ht, contacts)
    inputs = {"q": q, "x_ht": x_ht, "w_e": load, "contacts": contacts, "j_x": j_x, "j_q": j_q}
    return {name: np.asarray(value, np.float32) for name, value in inputs.items()}


def closure_of(hand: Hand, q: NDArray, x_ht: NDArray, contacts: NDArray) -> tuple[NDArray, NDArray]:
    """j_x (n, B, 3, 6), j_q (n, B, 3, C) in float64, state by state with `Branch.jacobian`."""
    n, dims = len(q), hand.dims
    j_x, j_q = np.zeros((n, dims.branches, 3, 6)), np.zeros((n, dims.branches, 3, dims.coordinates))
    for i in range(n):
        for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
            if contacts[i, b, 0] > 0:
                point = contacts[i, b, 1:4].astype(float)
                x, y, z = point - x_ht[i, :3]
                j_x[i, b] = np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])
                own = slice(dims.coordinates - len(branch.coordinates), None)
                j_q[i, b, :, own] = -branch.jacobian(q[i, at].astype(float), point)
    return j_x, j_q
