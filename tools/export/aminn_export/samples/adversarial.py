"""States that are hard to compute with: what simulation hardly ever gives, made from what it gives.

Straight fingers, near-singular Jacobians, one or two contacts, large and tiny loads, contacts in one point, contacts
that are pressed so lightly that they slide. The state's
sensor values and the Jacobians need not belong to one hand any more; the model is a function of all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import INPUTS, N_WRENCH

from ..files.tables import Exported, branch_joints, dims_of

Array = NDArray[np.float64]
KINDS = (
    "straight_fingers",
    "near_singular_j_q",
    "one_contact",
    "two_contacts",
    "large_wrench",
    "tiny_wrench",
    "common_contact_point",
    "faded_contacts",
    "light_grip",
)


def _turned(axis: Array, angle: Array, v: Array) -> Array:
    """v (n, 3) turned about unit vectors (n, 3) by angles (n)."""
    s, c = np.sin(angle)[:, None], np.cos(angle)[:, None]
    return c * v + s * np.cross(axis, v) + (1 - c) * (axis * v).sum(1, keepdims=True) * axis


class _Chain:
    """Axes and anchors (C, n, 3) of a branch's coordinates at joint angles, H, in the order from the palm outwards."""

    def __init__(self, exported: Exported, branch: int, q: Array) -> None:
        joints, n = branch_joints(exported.tensors)[branch], len(q)
        own = [c for c, joint in enumerate(joints) if joint >= 0]
        tables = (np.asarray(exported.tensors[f"geom_{name}"][branch], np.float64) for name in ("axis", "anchor"))
        self.axes, self.anchors = ([np.broadcast_to(v, (n, 3)) for v in table[own]] for table in tables)
        for i in reversed(range(len(own))):
            axis, anchor, angle = self.axes[i], self.anchors[i], q[:, joints[own[i]]]
            for k in range(i + 1, len(own)):
                self.axes[k] = _turned(axis, angle, self.axes[k])
                self.anchors[k] = anchor + _turned(axis, angle, self.anchors[k] - anchor)


def closure(q: Array, x_ht: Array, contacts: Array, exported: Exported) -> tuple[Array, Array]:
    """j_x (n, B, 3, 6) and j_q (n, B, 3, C) in float64 from the model's hand geometry; zero for open contacts."""
    n, dims = len(q), dims_of(exported)
    j_x, j_q = np.zeros((n, dims.branches, 3, N_WRENCH)), np.zeros((n, dims.branches, 3, dims.coordinates))
    for b in range(dims.branches):
        point, chain = contacts[:, b, 1:4], _Chain(exported, b, q)
        columns = [np.cross(axis, point - anchor) for axis, anchor in zip(chain.axes, chain.anchors, strict=True)]
        j_q[:, b, :, dims.coordinates - len(columns) :] = -np.stack(columns, -1)
        r = point - x_ht[:, :3]
        j_x[:, b, :, :3] = np.eye(3)
        j_x[:, b, :, 3:] = np.cross(r[:, None], np.eye(3)[None])  # -[r]x row by row
    closed = (contacts[..., 0] > 0)[..., None, None]
    return j_x * closed, j_q * closed


def _straighten(x: dict[str, Array], exported: Exported, rng: np.random.Generator) -> None:
    """Contacts in line with the last two joints, but for an angle of 1e-7 to 0.1 rad; Jacobians to match.

    The last two columns of j_q are then nearly parallel. Of a branch of one joint the contact is near its axis, where
    the one column nearly vanishes.
    """
    n = len(x["q"])
    for b, joints in enumerate(branch_joints(exported.tensors)):
        bend = 10 ** rng.uniform(-7, -1, n)
        x["q"][:, joints[-1]] = bend
        chain, share = _Chain(exported, b, x["q"]), rng.uniform(0.5, 1)
        axis, anchor = chain.axes[-1], chain.anchors[-1]
        if len(chain.axes) > 1:
            reach = _turned(axis, bend, (anchor - chain.anchors[-2]) * share)
        else:
            reach = bend[:, None] * np.cross(axis, np.roll(axis, 1, 1))
        x["contacts"][:, b, 1:4] = anchor + reach
    x["j_x"], x["j_q"] = closure(x["q"], x["x_ht"], x["contacts"], exported)


def _near_singular(x: dict[str, Array], rng: np.random.Generator) -> None:
    """The smallest singular value of each joint-side block becomes 1e-7 to 0.1 of the largest."""
    u, s, vt = np.linalg.svd(x["j_q"], full_matrices=False)
    s[..., -1] = s[..., 0] * 10 ** rng.uniform(-7, -1, s.shape[:2])
    x["j_q"] = (u * s[..., None, :]) @ vt


def _open_contacts(x: dict[str, Array], closed: int, rng: np.random.Generator) -> None:
    """Only `closed` of the branches stay in contact."""
    order = np.argsort(rng.random(x["contacts"].shape[:2]), axis=1)
    opened = order >= closed
    for name in ("contacts", "j_x", "j_q"):
        x[name][opened] = 0


def adversarial_states(
    simulated: dict[str, NDArray[np.float32]], exported: Exported, n: int, seed: int = 0
) -> tuple[dict[str, NDArray[np.float32]], NDArray[np.int64]]:
    """(inputs, index into KINDS) of n states, made from simulated ones, as many of each kind."""
    rng, dims = np.random.default_rng(seed), dims_of(exported)
    kind = np.arange(n) % len(KINDS)
    parts = []
    for k, name in enumerate(KINDS):
        rows = rng.integers(0, len(simulated["q"]), (kind == k).sum())
        x = {key: np.array(simulated[key][rows], np.float64) for key in INPUTS}
        if name == "straight_fingers":
            _straighten(x, exported, rng)
        elif name == "near_singular_j_q":
            _near_singular(x, rng)
        elif name in ("one_contact", "two_contacts"):
            _open_contacts(x, 1 if name == "one_contact" else 2, rng)
        elif name in ("large_wrench", "tiny_wrench"):
            low, high = (1, 4) if name == "large_wrench" else (-12, -2)
            x["w_e"] *= 10 ** rng.uniform(low, high, (len(rows), 1))
        elif name == "common_contact_point":
            x["contacts"][:, :, 1:4] = x["contacts"][:, :1, 1:4] + rng.normal(0, 1e-6, (len(rows), dims.branches, 3))
            x["j_x"], x["j_q"] = closure(x["q"], x["x_ht"], x["contacts"], exported)
        elif name == "light_grip":
            x["contacts"][..., 7] *= 10 ** rng.uniform(-2, 0, (len(rows), dims.branches))
        else:
            x["contacts"][..., 0] *= 10 ** rng.uniform(-6, 0, (len(rows), dims.branches))
        parts.append(x)
    inputs = {}
    for key, shape in dims.inputs.items():
        inputs[key] = np.zeros((n, *shape), np.float32)
        for k, part in enumerate(parts):
            inputs[key][kind == k] = part[key]
    return inputs, kind
