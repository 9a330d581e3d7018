"""The statics formula with the hand's true springs and tendons, held against the simulated displacement.

Nothing is learned here: stiffnesses, moment arms and the tendons' tensions before the load come from the data set. A
tendon is a spring while it is taut and nothing while it is slack; which ones are taut under load is found by iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROTATION_ARM_M = 0.1  # a rotation of 1 rad counts as this many metres in a relative error


@dataclass(frozen=True)
class TrueMechanics:
    """Stiffnesses of the simulated hand, from the `hand` entry of a manifest."""

    springs: Array  # (3 branches, 3 coordinates) N.m/rad, return springs and roll servos; 0 where absent
    arms: Array  # (6 tendons, 3 coordinates) m, flexing torque for 1 N
    stiffness: Array  # (6,) N/m
    branch: NDArray[np.int64]  # (6,)

    @classmethod
    def from_hand(cls, hand: dict) -> TrueMechanics:
        """Read a manifest's `hand`."""
        tendons = hand["tendons"]
        return cls(
            np.asarray(hand["joint_stiffness_Nm_rad"], float),
            np.asarray([t["moment_arm_m"] for t in tendons], float),
            np.asarray([t["stiffness_N_m"] for t in tendons], float),
            np.asarray([t["branch"] for t in tendons], int),
        )


def predict(
    mechanics: TrueMechanics,
    j_x: Array,
    j_q: Array,
    in_contact: Array,
    tension: Array,
    w_e: Array,
    eps_m: float = 1e-5,
    iterations: int = 12,
) -> tuple[Array, Array]:
    """Displacement of the tool (6) and turns of the branch coordinates (3, 3) of one sample.

    j_x (3,3,6), j_q (3,3,3), in_contact (3), tension (6) N before the load, w_e (6); eps_m m/N is the contacts' own
    compliance. A tendon that was taut and goes slack takes its former tension away, one that was slack starts at 0.
    """
    taut = tension > 0
    seen = []
    for _ in range(iterations):
        k_x, rhs = np.zeros((6, 6)), w_e.astype(float).copy()
        parts = []
        for b in range(3):
            present = mechanics.springs[b] > 0
            mine = mechanics.branch == b
            arms, stiff, t0, on = mechanics.arms[mine], mechanics.stiffness[mine], tension[mine], taut[mine]
            k_b = np.diag(np.where(present, mechanics.springs[b], 1.0)) + (arms[on].T * stiff[on]) @ arms[on]
            loose = -arms[~on].T @ t0[~on]  # torque that a tendon gone slack no longer gives
            compliance = np.linalg.inv(k_b) * np.outer(present, present)
            big_b = -j_q[b]
            w_b = np.linalg.inv(big_b @ compliance @ big_b.T + eps_m * np.eye(3)) * bool(in_contact[b])
            k_x += j_x[b].T @ w_b @ j_x[b]
            rhs += j_x[b].T @ w_b @ big_b @ compliance @ loose
            parts.append((compliance, big_b, w_b, loose))
        dx = np.linalg.solve(k_x, rhs)
        dq = np.zeros((3, 3))
        for b, (compliance, big_b, w_b, loose) in enumerate(parts):
            force = w_b @ (j_x[b] @ dx - big_b @ compliance @ loose)
            dq[b] = compliance @ (big_b.T @ force + loose)
        now = tension - mechanics.stiffness * np.einsum("tc,tc->t", mechanics.arms, dq[mechanics.branch]) > 0
        if (now == taut).all() or now.tobytes() in seen:
            break
        seen.append(now.tobytes())
        taut = now
    return dx, dq


def relative_error(predicted: Array, simulated: Array) -> Array:
    """|predicted - simulated| / |simulated| of displacements (n, 6), rotations scaled by `ROTATION_ARM_M`."""
    scale = np.array([1.0, 1.0, 1.0, ROTATION_ARM_M, ROTATION_ARM_M, ROTATION_ARM_M])
    return np.linalg.norm((predicted - simulated) * scale, axis=-1) / np.linalg.norm(simulated * scale, axis=-1)


def predict_samples(hand: dict, samples: dict[str, Array], grasps: dict[str, Array], eps_m: float = 1e-5) -> Array:
    """`predict` for every sample (n, 6)."""
    mechanics = TrueMechanics.from_hand(hand)
    order = np.argsort(grasps["grasp_id"])
    row = order[np.searchsorted(grasps["grasp_id"][order], samples["grasp_id"])]
    tension = grasps["tendon_tension_N"][row]
    return np.stack(
        [
            predict(mechanics, jx, jq, c[:, 0], t, w, eps_m)[0]
            for jx, jq, c, t, w in zip(
                samples["j_x"], samples["j_q"], samples["contacts"], tension, samples["w_e"], strict=True
            )
        ]
    )


def fidelity(hand: dict, samples: dict[str, Array], grasps: dict[str, Array], eps_m: float = 1e-5) -> dict[str, float]:
    """Figures of the comparison over the stable samples: flat keys, relative errors of the displacement."""
    stable = np.flatnonzero(samples["stable"])
    mine = {k: samples[k][stable] for k in ("j_x", "j_q", "contacts", "w_e", "grasp_id", "dx_ht")}
    error = relative_error(predict_samples(hand, mine, grasps, eps_m), mine["dx_ht"])
    size = np.linalg.norm(mine["dx_ht"][:, :3], axis=1) + ROTATION_ARM_M * np.linalg.norm(mine["dx_ht"][:, 3:], axis=1)
    out = {
        "n_stable": float(len(stable)),
        "relative_error_median": float(np.median(error)),
        "relative_error_p90": float(np.percentile(error, 90)),
    }
    edges = np.quantile(size, [0, 0.25, 0.5, 0.75, 1])
    for k in range(4):
        inside = (size >= edges[k]) & (size <= edges[k + 1])
        out[f"relative_error_median_quartile{k + 1}"] = float(np.median(error[inside]))
        out[f"size_m_quartile{k + 1}"] = float(np.median(size[inside]))
    return out
