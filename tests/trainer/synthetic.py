"""Made-up hands and data sets of them, so that the tests of trainer, exporter and runtime need no simulator.

`hand()` has the shape of the built-in one (two mirrored fingers, a thumb) with round numbers, `HANDS` are of other
shapes. Labels come from the analytical statics with springs that differ from the nominal ones, so there is something
to learn.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from aminn_hand import Branch, Coordinate, Coupling, Hand, Tendon
from aminn_hand.hand import Mirror
from aminn_hand.theta import Theta

Array = np.ndarray
ARM_M = 0.008
FAMILIES = ["cylinder", "capsule", "ellipsoid", "screwdriver"]
HELD = 0.7
"""Share of the load cases that is stable."""


def _joint(name: str, axis: Sequence[float], anchor: Sequence[float], stiffness: float, reach: float) -> Coordinate:
    """A joint that grasps are drawn of at 0.15 to 0.65 rad, or about zero for a roll, which a servo holds too."""
    low, servo = (-reach, stiffness / 2) if reach else (0.15, 0.0)
    return Coordinate(name, tuple(axis), tuple(anchor), low, reach or 0.65, stiffness - servo, servo)


def _tendons(branch: str, width: int, count: int) -> tuple[Tendon, ...]:
    """The first flexes the joint before the last, each further one another joint as well."""
    arms = np.zeros((count, width))
    for i in range(count):
        arms[i, max(width - 2, 0) :] = ARM_M * np.array([1.0, 0.8 * i])[: min(width, 2)]
    return tuple(Tendon(f"{branch}_tendon{i}", tuple(arm), 2000.0, True, 40.0) for i, arm in enumerate(arms.tolist()))


def chain(
    name: str, base: Sequence[float], count: int, tendons: int = 0, roll: bool = False, eps_m: float = 1e-5
) -> Branch:
    """A branch of `count` joints at `base`, 0.09 m long, that bends towards y = 0; its first joint may be a roll."""
    side = 1.0 if base[1] > 0 else -1.0
    bends = count - roll
    heights = np.array([0.0, 0.05, 0.07, 0.08, 0.085][:bends])
    joints = [
        _joint(f"{name}_bend{i}", (side, 0, 0), (base[0], base[1], z), 0.05, 0) for i, z in enumerate(heights.tolist())
    ]
    if roll:
        joints.insert(0, _joint(f"{name}_roll", (0, 0, -side if base[0] < 0 else side), base, 0.4, 0.3))
    tip = (base[0], base[1], 0.09)
    group = "fingers" if side > 0 else "thumbs"
    return Branch(name, group, tuple(joints), _tendons(name, count, tendons), (), f"{name}_tip", tip, eps_m, 0.008)


def _named(hand: Hand, branch: int, joints: Sequence[str]) -> Hand:
    """The same hand with other names of a branch's joints."""
    own = hand.branches[branch]
    renamed = tuple(replace(c, joint=name) for c, name in zip(own.coordinates, joints, strict=True))
    branches = list(hand.branches)
    branches[branch] = replace(own, coordinates=renamed)
    return replace(hand, branches=tuple(branches))


def _hand(name: str, branches: Sequence[Branch], mirror: Sequence[int] | None = None) -> Hand:
    plane = Mirror((1.0, 0.0, 0.0), tuple(mirror)) if mirror else None
    return Hand(name, tuple(branches), (0.0, 0.0, 1.0), mirror=plane)


def hand() -> Hand:
    """Two fingers of three joints that mirror each other in the plane x = 0, a thumb of two; two tendons per branch."""
    branches = (
        chain("finger1", (-0.02, 0.06, 0), 3, 2, roll=True),
        chain("finger2", (0.02, 0.06, 0), 3, 2, roll=True),
        chain("thumb", (0, -0.06, 0), 2, 2),
    )
    found = _hand("synthetic", branches, (1, 0, 2))
    for b, branch in enumerate(branches):
        known = (*(("roll",) if b < 2 else ()), "proximal", "distal")
        found = _named(found, b, [f"{branch.name}_{joint}" for joint in known])
    return found


def _asymmetric() -> Hand:
    """One finger longer and softer than the other, contacts of each branch another compliance, one without a cable."""
    first, second, thumb = hand().branches
    soft = [replace(c, spring_Nm_rad=0.7 * c.spring_Nm_rad) for c in second.coordinates]
    soft[-1] = replace(soft[-1], anchor_m=(0.02, 0.06, 0.06))
    second = replace(second, coordinates=tuple(soft), eps_m=4e-5, tip_point_m=(0.02, 0.06, 0.1))
    rigid = tuple(replace(t, pull_only=False) for t in thumb.tendons)
    return _hand("asymmetric", (first, second, replace(thumb, tendons=rigid, eps_m=7e-6)))


def _coupled() -> Hand:
    """Distal joints that follow the ones before them."""
    fingers = [chain(f"f{i}", (0.03 * (i - 1), 0.06, 0), 3) for i in range(3)]
    spring = Coupling("follows", (0.0, -0.8, 1.0), 0.3)
    branches = [replace(f, couplings=(spring,)) for f in fingers]
    return _hand("coupled", (*branches, chain("thumb", (0, -0.06, 0), 2)), (2, 1, 0, 3))


def _row(count: int, joints: int, thumb: int, tendons: int = 0, roll: bool = True) -> list[Branch]:
    places = np.linspace(-0.03, 0.03, count) if count > 1 else [0.0]
    fingers = [chain(f"finger{i}", (float(x), 0.06, 0), joints, tendons, roll) for i, x in enumerate(places)]
    return [*fingers, chain("thumb", (0.004, -0.06, 0), thumb, tendons, thumb > 2)]


HANDS: dict[str, Hand] = {
    "reference": hand(),
    "gripper 2x2": _hand("gripper", (chain("left", (0, 0.06, 0), 2), chain("right", (0, -0.06, 0), 2)), (0, 1)),
    "4x4 no tendons": _hand("four", _row(3, 4, 4)),
    "2x3+2": _hand("barrett", _row(2, 3, 2)),
    "4x3+4": _hand("many", _row(4, 3, 4, tendons=1)),
    "5x5": _hand("five", _row(4, 5, 5, tendons=2)),
    "one joint per branch": _hand("pegs", _row(2, 1, 1, tendons=1, roll=False)),
    "asymmetric": _asymmetric(),
    "coupled": _coupled(),
    "renamed": _named(hand(), 2, ("zeta", "alpha/2")),
}
"""Shapes that a hand may have."""


def closure(h: Hand, q: Array, tool: Array, contact: Array) -> tuple[Array, Array]:
    """J_x (B, 3, 6) and J_q (B, 3, C) for joint angles q (J), tool origin (3) and contact points (B, 3)."""
    j_x, j_q = (np.zeros(h.dims.inputs[name]) for name in ("j_x", "j_q"))
    for b, (branch, at) in enumerate(zip(h.branches, h.branch_joints, strict=True)):
        r = contact[b] - tool
        j_q[b, :, h.dims.coordinates - len(branch.coordinates) :] = -branch.jacobian(q[at], contact[b])
        j_x[b] = np.hstack([np.eye(3), -np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])])
    return j_x, j_q


def draw_inputs(rng: np.random.Generator, h: Hand) -> dict[str, Array]:
    """One grasp: q, x_ht, contacts, j_x, j_q; contacts at the fingertips, the tool between them."""
    joints = [c for branch in h.branches for c in branch.coordinates]
    q = np.array([rng.uniform(c.low_rad, c.high_rad) for c in joints])
    tips = [
        b.moved(q[at], np.array(b.tip_point_m)) + rng.uniform(-0.005, 0.005, 3)
        for b, at in zip(h.branches, h.branch_joints, strict=True)
    ]
    contact = np.array(tips)
    tool = contact.mean(0) + rng.uniform(-0.01, 0.01, 3)
    inwards = tool - contact
    normal = inwards / np.linalg.norm(inwards, axis=1, keepdims=True)
    j_x, j_q = closure(h, q, tool, contact)
    n = len(h.branches)
    contacts = np.hstack([np.ones((n, 1)), contact, normal, rng.uniform(2, 8, (n, 1))])
    return dict(q=q, x_ht=np.concatenate([tool, rng.uniform(-0.5, 0.5, 3)]), contacts=contacts, j_x=j_x, j_q=j_q)


def draw_wrench(rng: np.random.Generator) -> Array:
    """A random load: magnitude over two decades."""
    w = rng.normal(size=6)
    w[:3] *= 10 ** rng.uniform(-1, 1.2) / np.linalg.norm(w[:3])
    w[3:] *= 10 ** rng.uniform(-3, -1.3) / np.linalg.norm(w[3:])
    return w


def true_stiffness(h: Hand, x: dict[str, Array]) -> Array:
    """K_x (6, 6) of a grasp: all tendons taut, springs softer or stiffer than the nominal ones as q says."""
    softness = np.exp(0.8 * np.sin(5 * x["q"][1]))
    # what a pinch of two points leaves to the tool's own contact patches
    k_x = np.diag([0.0] * 3 + [0.02 if h.dims.branches == 2 else 1e-4] * 3)
    for b, branch in enumerate(h.branches):
        own = slice(h.dims.coordinates - len(branch.coordinates), None)
        b_b = x["j_q"][b][:, own]
        m = b_b @ np.linalg.inv(branch.stiffness() / softness) @ b_b.T + 1e-4 * np.eye(3)
        k_x += x["j_x"][b].T @ np.linalg.inv(m) @ x["j_x"][b]
    return k_x


def draw_theta(rng: np.random.Generator, h: Hand, size: int, half_range: float = 0.5) -> Array:
    """Mechanics parameters (size, P): factors drawn log-uniformly, joint zeros and radius as described."""
    theta = np.zeros((size, len(Theta(h))))
    theta[:, : Theta(h).factors] = rng.uniform(-half_range, half_range, (size, Theta(h).factors))
    return theta


def write_dataset(
    path: Path, grasps: int = 60, cases: int = 8, seed: int = 0, of: Hand | None = None, vary: float = 0.0
) -> None:
    """Write a data set of a hand (default: `hand()`) in the simulator's layout; `vary` draws one theta per grasp."""
    rng, h = np.random.default_rng(seed), of or hand()
    theta = draw_theta(np.random.default_rng([seed, 1]), h, grasps, vary)
    rows: dict[str, list[Array]] = {}
    for grasp in range(grasps):
        x = draw_inputs(rng, h)
        k_x = true_stiffness(Theta(h).varied(theta[grasp]), x)
        for _ in range(cases):
            w = draw_wrench(rng)
            tension = np.maximum(rng.normal(1, 1, h.dims.tendons), 0)
            row = x | {"w_e": w, "dx_ht": np.linalg.solve(k_x, w), "q_after": x["q"],
                       "tendon_tension_after_N": tension, "grasp_id": np.int64(grasp)}  # fmt: skip
            for name, value in row.items():
                rows.setdefault(name, []).append(np.asarray(value))
    moved = np.linalg.norm(np.stack(rows["dx_ht"])[:, :3], axis=1)
    path.mkdir(parents=True)
    with h5py.File(path / "shard-00000.h5", "w") as file:
        for name, values in rows.items():
            file[f"samples/{name}"] = np.stack(values)
        file["samples/stable"] = (moved < np.quantile(moved, HELD)).astype(np.uint8)
        file["grasps/grasp_id"] = np.arange(grasps)
        file["grasps/tool_family"] = np.arange(grasps) % len(FAMILIES)
        file["grasps/friction"] = np.random.default_rng(seed).uniform(0.4, 1.1, grasps)
        weight = np.random.default_rng([seed, 2])
        file["grasps/tool_mass_kg"] = weight.uniform(0.05, 0.3, grasps)
        down = weight.normal(size=(grasps, 3))
        file["grasps/gravity_m_s2"] = 9.81 * down / np.linalg.norm(down, axis=1, keepdims=True)
        file["grasps/tendon_tension_N"] = np.random.default_rng(seed).uniform(0, 10, (grasps, h.dims.tendons))
        capsule = [[3, 0.015, 0.035, 0, 0, 0, 0, 0.5**0.5, 0, 0.5**0.5, 0], [-1] + [0] * 10, [-1] + [0] * 10]
        file["grasps/tool_geoms"] = np.tile(np.array(capsule, float), (grasps, 1, 1))
        file["grasps/tool_size_m"] = np.tile([0.05, 0.015, 0.015], (grasps, 1))
        if vary:
            file["grasps/theta"], file["grasps/hand_id"] = theta, np.arange(grasps)
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
    manifest = {"schema_version": 4, "seed": seed, "tool_families": FAMILIES,
                "config_sha256": hashlib.sha256(f"{grasps} {cases} {seed}".encode()).hexdigest(), "hand": h.as_dict(),
                "shards": [shard], "n_samples": grasps * cases, "n_grasps": grasps}  # fmt: skip
    if vary:
        manifest["theta_names"] = list(Theta(h).names)
    (path / "manifest.json").write_text(json.dumps(manifest))
