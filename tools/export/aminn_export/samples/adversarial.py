"""States that are hard to compute with: what simulation hardly ever gives, made from what it gives.

Straight fingers, near-singular Jacobians, one or two contacts, large and tiny loads, contacts in one point. The state's
sensor values and the Jacobians need not belong to one hand any more; the model is a function of all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn.hand.dims import BRANCH_JOINTS, INPUT_SHAPES, N_BRANCH, N_WRENCH

from ..files.tables import Exported

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
)


def _turned(axis: Array, angle: Array, v: Array) -> Array:
    """v (n, 3) turned about unit vectors (n, 3) by angles (n)."""
    s, c = np.sin(angle)[:, None], np.cos(angle)[:, None]
    return c * v + s * np.cross(axis, v) + (1 - c) * (axis * v).sum(1, keepdims=True) * axis


def closure(q: Array, x_ht: Array, contacts: Array, exported: Exported) -> tuple[Array, Array]:
    """j_x (n, 3, 3, 6) and j_q (n, 3, 3, 3) in float64 from the model's hand geometry; zero for open contacts."""
    n = len(q)
    axes, anchors = (np.asarray(exported.tensors[f"geom_{k}"], np.float64) for k in ("axis", "anchor"))
    base, link = anchors[:, 1], anchors[:, 2] - anchors[:, 1]
    j_x, j_q = np.zeros((n, N_BRANCH, 3, N_WRENCH)), np.zeros((n, N_BRANCH, 3, 3))
    for b in range(N_BRANCH):
        roll, proximal, _ = BRANCH_JOINTS[b]
        z = [np.broadcast_to(axes[b, i], (n, 3)) for i in range(3)]
        a = np.broadcast_to(link[b], (n, 3))
        z[2], a = (_turned(z[1], q[:, proximal], v) for v in (z[2], a))
        if roll >= 0:
            z[1], z[2], a = (_turned(z[0], q[:, roll], v) for v in (z[1], z[2], a))
        s = contacts[:, b, 1:4] - base[b]
        columns = [np.cross(z[0], s), np.cross(z[1], s), np.cross(z[2], s - a)]
        j_q[:, b] = -np.stack(columns, -1) * (np.asarray(BRANCH_JOINTS[b]) >= 0)
        r = contacts[:, b, 1:4] - x_ht[:, :3]
        j_x[:, b, :, :3] = np.eye(3)
        j_x[:, b, :, 3:] = np.cross(r[:, None], np.eye(3)[None])  # -[r]x row by row
    closed = (contacts[..., 0] > 0)[..., None, None]
    return j_x * closed, j_q * closed


def _straighten(x: dict[str, Array], exported: Exported, rng: np.random.Generator) -> None:
    """Contacts on the lines of the proximal links, but for an angle of 1e-7 to 0.1 rad; Jacobians to match."""
    n = len(x["q"])
    axes, anchors = (np.asarray(exported.tensors[f"geom_{k}"], np.float64) for k in ("axis", "anchor"))
    base, link = anchors[:, 1], anchors[:, 2] - anchors[:, 1]
    for b in range(N_BRANCH):
        roll, proximal, distal = BRANCH_JOINTS[b]
        bend = 10 ** rng.uniform(-7, -1, n)
        x["q"][:, distal] = bend
        axis = np.broadcast_to(axes[b, 1], (n, 3))
        a = _turned(axis, x["q"][:, proximal], np.broadcast_to(link[b], (n, 3)))
        tip = _turned(axis, x["q"][:, proximal] + bend, np.broadcast_to(link[b] * rng.uniform(0.5, 1), (n, 3)))
        reach = a + tip
        if roll >= 0:
            reach = _turned(np.broadcast_to(axes[b, 0], (n, 3)), x["q"][:, roll], reach)
        x["contacts"][:, b, 1:4] = base[b] + reach
    x["j_x"], x["j_q"] = closure(x["q"], x["x_ht"], x["contacts"], exported)


def _near_singular(x: dict[str, Array], rng: np.random.Generator) -> None:
    """The smallest singular value of each joint-side block becomes 1e-7 to 0.1 of the largest."""
    u, s, vt = np.linalg.svd(x["j_q"])
    s[..., 2] = s[..., 0] * 10 ** rng.uniform(-7, -1, s.shape[:2])
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
    rng = np.random.default_rng(seed)
    kind = np.arange(n) % len(KINDS)
    parts = []
    for k, name in enumerate(KINDS):
        rows = rng.integers(0, len(simulated["q"]), (kind == k).sum())
        x = {key: np.array(simulated[key][rows], np.float64) for key in INPUT_SHAPES}
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
            x["contacts"][:, :, 1:4] = x["contacts"][:, :1, 1:4] + rng.normal(0, 1e-6, (len(rows), N_BRANCH, 3))
            x["j_x"], x["j_q"] = closure(x["q"], x["x_ht"], x["contacts"], exported)
        else:
            x["contacts"][..., 0] *= 10 ** rng.uniform(-6, 0, (len(rows), N_BRANCH))
        parts.append(x)
    inputs = {}
    for key, shape in INPUT_SHAPES.items():
        inputs[key] = np.zeros((n, *shape), np.float32)
        for k, part in enumerate(parts):
            inputs[key][kind == k] = part[key]
    return inputs, kind
