"""The statics formula with the hand's true springs and tendons, held against the simulated displacement.

Nothing is learned here: stiffnesses, moment arms and the tendons' tensions before the load come from the data set. A
tendon is a spring while it is taut and nothing while it is slack; which ones are taut under load is found by iteration.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from . import _core
from .config import SimulationConfig
from .errors import SimulationError
from .quality import dataset_figures, label_noise
from .simulate import load_simulator

Array = NDArray[np.float64]
ROTATION_ARM_M = 0.1  # a rotation of 1 rad counts as this many metres in a relative error
STICKING_RESIDUAL = 0.1  # closure residual below which every contact is taken to stick
BRANCH_JOINTS = ((0, 1, 2), (3, 4, 5), (-1, 6, 7))
_SCALE = np.array([1.0, 1.0, 1.0, ROTATION_ARM_M, ROTATION_ARM_M, ROTATION_ARM_M])


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
    return np.linalg.norm((predicted - simulated) * _SCALE, axis=-1) / np.linalg.norm(simulated * _SCALE, axis=-1)


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
    """Figures of the comparison over the stable samples of a data set: flat keys, relative errors of the displacement.

    Quartiles are those of the simulated displacement's size (rotations times 0.1 m added).
    """
    stable = np.flatnonzero(samples["stable"])
    if len(stable) == 0:
        raise SimulationError("fidelity: the data set has no stable sample")
    mine = {k: samples[k][stable] for k in ("j_x", "j_q", "contacts", "w_e", "grasp_id", "dx_ht")}
    error = relative_error(predict_samples(hand, mine, grasps, eps_m), mine["dx_ht"])
    size = np.linalg.norm(mine["dx_ht"][:, :3], axis=1) + ROTATION_ARM_M * np.linalg.norm(mine["dx_ht"][:, 3:], axis=1)
    out = {
        "dataset_stable_samples": float(len(stable)),
        "dataset_relative_error_median": float(np.median(error)),
        "dataset_relative_error_p90": float(np.percentile(error, 90)),
    }
    edges = np.quantile(size, [0, 0.25, 0.5, 0.75, 1])
    for k in range(4):
        inside = (size >= edges[k]) & (size <= edges[k + 1])
        out[f"dataset_relative_error_median_quartile{k + 1}"] = float(np.median(error[inside]))
        out[f"dataset_size_m_median_quartile{k + 1}"] = float(np.median(size[inside]))
    return out


def branch_turns(dq: Array) -> Array:
    """Joint angles (8) as branch coordinates (3, 3), 0 where a branch has none."""
    out = np.zeros((3, 3))
    for b, joints in enumerate(BRANCH_JOINTS):
        for c, j in enumerate(joints):
            if j >= 0:
                out[b, c] = dq[j]
    return out


@dataclass(frozen=True)
class SmallLoad:
    """One small load on one grasp: what the formula says and what the simulation did."""

    w_e: Array  # (6)
    predicted: Array  # (6)
    simulated: Array  # (6)
    stable: bool
    closure_residual: float  # |J_x dx + J_q dq| / |J_x dx|, both simulated; small while every contact sticks

    @property
    def error(self) -> float:
        """Relative error of the prediction."""
        return float(relative_error(self.predicted, self.simulated))

    @property
    def sticking(self) -> bool:
        """Whether no contact slid."""
        return self.stable and self.closure_residual < STICKING_RESIDUAL


def small_loads(
    config: SimulationConfig, seed: int, grasps: int, axis: str, force_n: float = 0.3, eps_m: float = 1e-5
) -> list[SmallLoad]:
    """Loads of size `force_n` (a moment of 0.1 m times that counts the same) on fresh grasps.

    axis: "random" takes a random direction of the six, "compliant" the direction in which the formula gives most.
    """
    simulator = load_simulator()
    mechanics = TrueMechanics.from_hand(simulator.hand())
    rng = np.random.default_rng(seed)
    out = []
    for index in range(grasps):
        session = _core.Session(simulator, config.options(), seed, 0, index, config.family_indices())
        grasp = {k: v[0] for k, v in session.grasp().items()}

        def formula(w: Array, grasp: dict[str, Array] = grasp) -> Array:
            in_contact = grasp["contacts"][:, 0]
            return predict(mechanics, grasp["j_x"], grasp["j_q"], in_contact, grasp["tendon_tension_N"], w, eps_m)[0]

        direction = rng.normal(size=6)
        if axis == "compliant":
            tiny = 1e-3  # N: keeps every tendon as it is
            columns = np.stack(
                [formula(tiny * scale * e) / tiny for scale, e in zip(_SCALE, np.eye(6), strict=True)], 1
            )
            direction = np.linalg.svd(_SCALE[:, None] * columns)[2][0]
        w = force_n * _SCALE * direction / np.linalg.norm(direction)
        result = {k: v[0] for k, v in session.load(w).items()}
        tool_side = np.einsum("bij,j->bi", grasp["j_x"], result["dx_ht"])
        joint_side = np.einsum("bij,bj->bi", grasp["j_q"], branch_turns(result["q_after"] - grasp["q"]))
        residual = np.linalg.norm(tool_side + joint_side) / np.linalg.norm(tool_side)
        out.append(SmallLoad(w, formula(w), result["dx_ht"], bool(result["stable"]), float(residual)))
    return out


def small_load_figures(config: SimulationConfig, seed: int, grasps: int) -> dict[str, float]:
    """Flat figures of `small_loads` in the sticking regime, for random directions and along the most compliant axis."""
    out = {}
    for axis in ("random", "compliant"):
        loads = small_loads(config, seed, grasps, axis)
        sticking = [load for load in loads if load.sticking]
        if not sticking:
            raise SimulationError(f"fidelity: no {axis} small load left every contact sticking")
        errors = [load.error for load in sticking]
        out[f"{axis}_loads"] = float(len(loads))
        out[f"{axis}_sticking_share"] = len(sticking) / len(loads)
        out[f"{axis}_relative_error_median"] = float(np.median(errors))
        out[f"{axis}_relative_error_p90"] = float(np.percentile(errors, 90))
    return out


def read_arrays(folder: Path) -> tuple[dict, dict[str, Array], dict[str, Array]]:
    """Manifest, samples and grasps of the data set in `folder`."""
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        groups: dict[str, list[dict[str, Array]]] = {"samples": [], "grasps": []}
        for shard in manifest["shards"]:
            with h5py.File(folder / shard["file"], "r") as file:
                for group, parts in groups.items():
                    parts.append({name: data[()] for name, data in file[group].items()})
    except (OSError, ValueError, KeyError) as error:
        raise SimulationError(f"{folder}: not a readable data set ({error})") from error
    samples, grasps = ({k: np.concatenate([p[k] for p in parts]) for k in parts[0]} for parts in groups.values())
    return manifest, samples, grasps


def main() -> None:
    """`python -m aminn_sim.fidelity --data DIR --out REPORT.json`: theory and data quality, printed and written."""
    parser = argparse.ArgumentParser(description="Hold theory against simulation, and judge a data set's labels.")
    parser.add_argument("--data", type=Path, required=True, help="folder of a simulated data set")
    parser.add_argument("--out", type=Path, required=True, help="report to write (JSON)")
    parser.add_argument("--grasps", type=int, default=100, help="fresh grasps for the small loads")
    parser.add_argument("--seed", type=int, default=1, help="seed of the fresh grasps")
    arguments = parser.parse_args()
    try:
        manifest, samples, grasps = read_arrays(arguments.data)
        figures = dataset_figures(manifest, samples, grasps) | fidelity(manifest["hand"], samples, grasps)
        figures |= label_noise(SimulationConfig(), threads=len(os.sched_getaffinity(0)))
        figures |= small_load_figures(SimulationConfig(), arguments.seed, arguments.grasps)
    except SimulationError as error:
        parser.exit(1, f"error: {error}\n")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(figures, sort_keys=True, indent=1) + "\n")
    for name, value in figures.items():
        print(f"{name:45s} {value:.4g}")


if __name__ == "__main__":
    main()
