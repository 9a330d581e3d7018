"""The statics formula with the hand's true springs and tendons, compared with the simulated displacement.

Nothing is learned here: stiffnesses, moment arms and the tendons' tensions before the load come from the data set. A
tendon is a spring while it is taut and nothing while it is slack; which ones are taut under load is found by iteration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import Hand, rotation
from aminn_hand.theta import Theta

from . import _core
from .config import SimulationConfig
from .errors import SimulationError
from .statics import CAPSULE, CYLINDER, TWIST_RAD_NM, Contact, displacement, surface_curvature
from .vary import theta_of

Array = NDArray[np.float64]
T = TypeVar("T")
ROTATION_ARM_M = 0.1  # a rotation of 1 rad counts as this many metres in a relative error
OTHER_EPS_M = (1e-6, 2e-5)  # m/N, compliance of a contact, tried beside the hand's own
STICKING_RESIDUAL = 0.1  # closure residual below which every contact is taken to stick
LYING = rotation(np.array([0.0, np.pi / 2, 0.0]))
"""Cylinders and capsules lie along the tool's x, in MuJoCo along their z."""
_SCALE = np.array([1.0, 1.0, 1.0, ROTATION_ARM_M, ROTATION_ARM_M, ROTATION_ARM_M])


@dataclass(frozen=True)
class TrueMechanics:
    """Stiffnesses of the simulated hand; tendons branch by branch, as in a data set."""

    hand: Hand
    arms: list[Array]
    """(tendons, C) m of each branch, flexing torque for 1 N."""
    of_branch: list[slice]
    """Where a branch's tendons stand among all of them."""
    stiffness: Array
    """(T) N/m."""
    two_way: NDArray[np.bool_]
    """(T) tendons that pull and push: never slack."""

    @classmethod
    def of(cls, hand: Hand) -> TrueMechanics:
        """From a description."""
        ends = np.cumsum([0, *(len(b.tendons) for b in hand.branches)]).tolist()
        every = [t for b in hand.branches for t in b.tendons]
        return cls(
            hand,
            [np.array([t.arm_m for t in b.tendons]).reshape(-1, len(b.coordinates)) for b in hand.branches],
            [slice(a, b) for a, b in pairwise(ends)],
            np.array([t.stiffness_N_m for t in every]),
            np.array([not t.pull_only for t in every], bool),
        )

    def joint_stiffness(self, b: int, taut: NDArray[np.bool_]) -> Array:
        """K_b (C, C) of branch b with the tendons that are taut (T), N.m/rad."""
        return self.hand.branches[b].stiffness(taut[self.of_branch[b]].tolist())


def predict(
    mechanics: TrueMechanics,
    j_x: Array,
    j_q: Array,
    contacts: Array,
    tension: Array,
    w_e: Array,
    eps_m: float | None = None,
    iterations: int = 12,
) -> tuple[Array, Array]:
    """Displacement of the tool (6) and turns of the joints (J) of one sample.

    j_x (B,3,6), j_q (B,3,C), contacts (B,8), tension (T) N before the load, w_e (6); eps_m m/N is the contacts' own
    compliance, by default the hand's. A tendon that was taut and goes slack takes its former tension away, one that was
    slack starts at 0. Branches without a contact stay.
    """
    hand = mechanics.hand
    taut = (tension > 0) | mechanics.two_way
    twist = 1 / TWIST_RAD_NM if hand.contact.kind == "soft_finger" else 0.0
    seen = []
    for _ in range(iterations):
        k_x, rhs = np.zeros((6, 6)), w_e.astype(float).copy()
        parts = []
        for b, branch in enumerate(hand.branches):
            mine = mechanics.of_branch[b]
            off = ~taut[mine]
            loose = -mechanics.arms[b][off].T @ tension[mine][off]  # torque that a tendon gone slack no longer gives
            compliance = np.linalg.inv(mechanics.joint_stiffness(b, taut))
            big_b = -j_q[b][:, -len(branch.coordinates) :]
            give = branch.eps_m if eps_m is None else eps_m
            w_b = np.linalg.inv(big_b @ compliance @ big_b.T + give * np.eye(3)) * bool(contacts[b, 0])
            k_x += j_x[b].T @ w_b @ j_x[b]
            k_x[3:, 3:] += twist * np.outer(contacts[b, 4:7], contacts[b, 4:7])
            rhs += j_x[b].T @ w_b @ big_b @ compliance @ loose
            parts.append((compliance, big_b, w_b, loose))
        dx = np.linalg.solve(k_x, rhs) if len(parts) > 2 else np.linalg.lstsq(k_x, rhs, rcond=1e-12)[0]
        turns = []
        for b, (compliance, big_b, w_b, loose) in enumerate(parts):
            force = w_b @ (j_x[b] @ dx - big_b @ compliance @ loose)
            turns.append(compliance @ (big_b.T @ force + loose))
        shorter = [arms @ turn for arms, turn in zip(mechanics.arms, turns, strict=True)]
        now = (tension - mechanics.stiffness * np.concatenate(shorter) > 0) | mechanics.two_way
        if (now == taut).all() or now.tobytes() in seen:
            break
        seen.append(now.tobytes())
        taut = now
    return dx, np.concatenate(turns)


def relative_error(predicted: Array, simulated: Array) -> Array:
    """|predicted - simulated| / |simulated| of displacements (n, 6), rotations scaled by `ROTATION_ARM_M`."""
    return np.linalg.norm((predicted - simulated) * _SCALE, axis=-1) / np.linalg.norm(simulated * _SCALE, axis=-1)


def predict_samples(hand: Hand, samples: dict[str, Array], grasps: dict[str, Array]) -> Array:
    """`predict` for every sample (n, 6), with the mechanics of its grasp's hand where the data set varies them."""
    order = np.argsort(grasps["grasp_id"])
    row = order[np.searchsorted(grasps["grasp_id"][order], samples["grasp_id"])]
    tension = grasps["tendon_tension_N"][row]
    thetas, which = np.zeros((1, len(Theta(hand)))), np.zeros(len(row), int)
    if "theta" in grasps:
        thetas, which = np.unique(grasps["theta"], axis=0, return_inverse=True)
        which = which.ravel()[row]
    mechanics = [TrueMechanics.of(Theta(hand).varied(theta)) for theta in thetas]
    return np.stack(
        [
            predict(mechanics[m], jx, jq, c, t, w)[0]
            for m, jx, jq, c, t, w in zip(
                which, samples["j_x"], samples["j_q"], samples["contacts"], tension, samples["w_e"], strict=True
            )
        ]
    )


def dataset_errors(
    hand: Hand, samples: dict[str, Array], grasps: dict[str, Array], most: int = 4000
) -> dict[str, float]:
    """The formula against stable load cases of a data set, of every size: flat figures of the relative error.

    At most `most` cases, evenly taken. Quartiles are those of the simulated displacement's size, rotations times 0.1 m.
    """
    stable = np.flatnonzero(samples["stable"])
    if len(stable) == 0:
        raise SimulationError("theory: the data set has no stable sample")
    stable = stable[:: max(1, len(stable) // most)]
    mine = {k: samples[k][stable] for k in ("j_x", "j_q", "contacts", "w_e", "grasp_id", "dx_ht")}
    error = relative_error(predict_samples(hand, mine, grasps), mine["dx_ht"])
    size = np.linalg.norm(mine["dx_ht"] * _SCALE, axis=1)
    out = {
        "theory_all_loads_cases": float(len(stable)),
        "theory_all_loads_relative_error_median": float(np.median(error)),
        "theory_all_loads_relative_error_p90": float(np.percentile(error, 90)),
    }
    edges = np.quantile(size, [0, 0.25, 0.5, 0.75, 1])
    for k in range(4):
        inside = (size >= edges[k]) & (size <= edges[k + 1])
        out[f"theory_all_loads_relative_error_median_quartile{k + 1}"] = float(np.median(error[inside]))
        out[f"theory_all_loads_size_m_median_quartile{k + 1}"] = float(np.median(size[inside]))
    return out


def branch_turns(hand: Hand, dq: Array) -> Array:
    """Joint angles (J) as branch coordinates (B, C), 0 where a branch has none."""
    joints = np.array(hand.coordinate_joints)
    return np.where(joints >= 0, dq[joints], 0.0)


class Grasp:
    """A simulated grasp of a configuration, with the statics of its hand beside it."""

    def __init__(self, hand: Hand, simulator: _core.Simulator, config: SimulationConfig, index: int) -> None:
        families, theta = config.family_indices(), theta_of(config, hand, index)
        self.session = _core.Session(simulator, config.options(), config.seed, 0, index, index, families, theta)
        self.state = {k: v[0] for k, v in self.session.grasp().items()}
        self.hand = hand if theta is None else Theta(hand).varied(theta)
        self.mechanics = TrueMechanics.of(self.hand)

    def formula(self, w_e: Array, eps_m: float | None = None) -> tuple[Array, Array]:
        """Displacement (6) and turns of the joints (J)."""
        s = self.state
        return predict(self.mechanics, s["j_x"], s["j_q"], s["contacts"], s["tendon_tension_N"], w_e, eps_m)

    @cached_property
    def contacts(self) -> dict[int, Contact]:
        """The settled contacts by branch, which give way as the engine's do."""
        state, forces, out = self.state, self.session.contact_forces(), {}
        R = rotation(state["x_ht"][3:])
        kind, size, along = int(state["tool_geoms"][0][0]), state["tool_geoms"][0][1:4], state["tool_geoms"][0][4:7]
        turned = R @ LYING if kind in (CAPSULE, CYLINDER) else R
        for b in np.flatnonzero(state["contacts"][:, 0]):
            point, normal = state["contacts"][b, 1:4], state["contacts"][b, 4:7]
            tool = surface_curvature(kind, size, state["x_ht"][:3] + R @ along, turned, point)
            shape, extent, place, axes, give = self.session.fingertip(int(b))
            tip = surface_curvature(shape, extent, place, axes, point)
            out[int(b)] = Contact(point, normal, forces[b], give, tool + tip)
        return out

    def with_preload(self, w_e: Array) -> Array:
        """Displacement (6) for a small load with the contact forces, tendons as they are before it."""
        taut = (self.state["tendon_tension_N"] > 0) | self.mechanics.two_way
        stiffness = [self.mechanics.joint_stiffness(b, taut) for b in range(len(self.hand.branches))]
        return displacement(self.hand, self.state["q"], self.state["x_ht"][:3], self.contacts, w_e, True, stiffness)

    def simulate(self, w_e: Array) -> dict[str, Array]:
        """The load case's fields."""
        return {k: v[0] for k, v in self.session.load(w_e).items() if k != "noise"}

    def closure_residual(self, case: dict[str, Array]) -> float:
        """|J_x dx + J_q dq| / |J_x dx|, both simulated: small while every contact sticks."""
        tool = np.einsum("bij,j->bi", self.state["j_x"], case["dx_ht"])
        joint = np.einsum("bij,bj->bi", self.state["j_q"], branch_turns(self.hand, case["q_after"] - self.state["q"]))
        return float(np.linalg.norm(tool + joint) / np.linalg.norm(tool))


@dataclass(frozen=True)
class Compliance:
    """The 6x6 compliance of one grasp, from small loads along and against each axis of the wrench."""

    simulated: Array  # (6, 6) m/N, m/(N.m), rad/N, rad/(N.m); column: load axis
    formula: Array  # (6, 6)
    errors: Array  # (12) relative errors of the displacements
    other_errors: Array  # (12, 2) the same with OTHER_EPS_M
    preload_errors: Array  # (12) the same with the contact forces taken into account
    sticking: Array  # (12) bool: stable, and no contact slid

    @property
    def matrix_error(self) -> float:
        """|formula - simulated| / |simulated|, Frobenius, rotations and moments scaled by 0.1 m."""
        scale = _SCALE[:, None] * _SCALE[None, :]
        difference = np.linalg.norm((self.formula - self.simulated) * scale)
        return float(difference / np.linalg.norm(self.simulated * scale))


def compliance(grasp: Grasp, force_N: float = 0.1) -> Compliance:
    """Loads of `force_N` and of 0.1 m times that about each axis, both ways."""
    simulated, formula = np.zeros((6, 6)), np.zeros((6, 6))
    errors, others, preloaded, sticking = [], [], [], []
    for k in range(6):
        size = force_N * _SCALE[k]
        for sign in (1.0, -1.0):
            w = np.zeros(6)
            w[k] = sign * size
            case, expected = grasp.simulate(w), grasp.formula(w)[0]
            simulated[:, k] += 0.5 * sign * case["dx_ht"] / size
            formula[:, k] += 0.5 * sign * expected / size
            errors.append(float(relative_error(expected, case["dx_ht"])))
            others.append([float(relative_error(grasp.formula(w, eps)[0], case["dx_ht"])) for eps in OTHER_EPS_M])
            preloaded.append(float(relative_error(grasp.with_preload(w), case["dx_ht"])))
            sticking.append(bool(case["stable"]) and grasp.closure_residual(case) < STICKING_RESIDUAL)
    return Compliance(simulated, formula, np.array(errors), np.array(others), np.array(preloaded), np.array(sticking))


def over_grasps(
    hand: Hand,
    simulator: _core.Simulator,
    config: SimulationConfig,
    grasps: int,
    threads: int,
    work: Callable[[Grasp], T],
) -> list[T]:
    """work(grasp) for grasps 0 to n - 1 of the configuration's seed, in order."""
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda index: work(Grasp(hand, simulator, config, index)), range(grasps)))


def compliance_figures(
    hand: Hand, simulator: _core.Simulator, config: SimulationConfig, grasps: int, threads: int
) -> dict[str, float]:
    """Flat figures of `compliance` over fresh grasps."""
    results = over_grasps(hand, simulator, config, grasps, threads, compliance)
    errors, sticking = np.concatenate([r.errors for r in results]), np.concatenate([r.sticking for r in results])
    if not sticking.any():
        raise SimulationError("theory: no small load left every contact sticking")
    whole = [r for r in results if r.sticking.all()]
    axes = np.tile(np.repeat(("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z"), 2), len(results))
    by_axis = {
        f"theory_relative_error_median_{axis}": float(np.median(errors[sticking & (axes == axis)]))
        for axis in dict.fromkeys(axes.tolist())
        if (sticking & (axes == axis)).any()
    }
    preloaded = np.concatenate([r.preload_errors for r in results])[sticking]
    others = np.concatenate([r.other_errors for r in results])[sticking]
    by_eps = {
        f"theory_relative_error_median_eps_m_{e:.0e}": float(np.median(x))
        for e, x in zip(OTHER_EPS_M, others.T, strict=True)
    }
    return (
        by_axis
        | by_eps
        | {
            "theory_grasps": float(len(results)),
            "theory_loads": float(len(errors)),
            "theory_sticking_share": float(sticking.mean()),
            "theory_relative_error_median": float(np.median(errors[sticking])),
            "theory_relative_error_p90": float(np.percentile(errors[sticking], 90)),
            "theory_with_preload_relative_error_median": float(np.median(preloaded)),
            "theory_with_preload_relative_error_p90": float(np.percentile(preloaded, 90)),
            "theory_sliding_relative_error_median": float(np.median(errors[~sticking])) if (~sticking).any() else 0.0,
            "theory_compliance_grasps": float(len(whole)),
            "theory_compliance_error_median": float(np.median([r.matrix_error for r in whole]))
            if whole
            else float("nan"),
            "theory_compliance_error_p90": float(np.percentile([r.matrix_error for r in whole], 90)) if whole else 0.0,
        }
    )


def preload_figures(
    hand: Hand, simulator: _core.Simulator, config: SimulationConfig, grasps: int, threads: int
) -> dict[str, float]:
    """Error of the formula by pinch force, with light tools: what it leaves out turns with the contact forces."""
    out = {}
    for pinch in (1.0, 3.0, 9.0):
        light = dataclasses.replace(
            config, mass_min_kg=0.02, mass_max_kg=0.021, contact_force_min_N=0.1,
            pinch_force_min_N=pinch, pinch_force_max_N=1.001 * pinch,
        )  # fmt: skip
        results = over_grasps(hand, simulator, light, grasps, threads, lambda grasp: compliance(grasp, force_N=0.05))
        errors, sticking = np.concatenate([r.errors for r in results]), np.concatenate([r.sticking for r in results])
        out[f"theory_relative_error_median_pinch_{pinch:.0f}N"] = float(np.median(errors[sticking]))
    return out


@dataclass(frozen=True)
class SlackJump:
    """Compliance along a load before and after a tendon goes slack under it."""

    taut_m_N: float
    slack_m_N: float
    formula_ratio: float


def slack_jump(grasp: Grasp, levels: int = 10, most_N: float = 6.0) -> SlackJump | None:
    """Loads of growing size along the direction that slackens a tendon soonest, by the formula.

    None where no tendon goes slack in the simulation between two stable levels with at least two on either side.
    """
    tension, mechanics = grasp.state["tendon_tension_N"], grasp.mechanics
    gated = [(b, i) for b, branch in enumerate(grasp.hand.branches) if (i := branch.gated_tendon) is not None]
    cables = [(b, mechanics.of_branch[b].start + i, mechanics.arms[b][i]) for b, i in gated]
    cables = [(b, t, arm) for b, t, arm in cables if tension[t] > 0]
    if not cables:
        return None
    small = 1e-3
    turns = np.stack([grasp.formula(small * _SCALE * e)[1] / small for e in np.eye(6)], -1)  # (J, 6 scaled axes)
    loosening = [arm @ turns[grasp.hand.branch_joints[b]] for b, _, arm in cables]
    proximal = [t for _, t, _ in cables]
    loads = [
        tension[t] / (mechanics.stiffness[t] * np.linalg.norm(g)) for t, g in zip(proximal, loosening, strict=True)
    ]
    first = int(np.argmin(loads))
    t, direction = proximal[first], _SCALE * loosening[first] / np.linalg.norm(loosening[first])
    sizes = np.linspace(0.2, 1.8, levels) * loads[first]
    sizes = sizes[sizes <= most_N]
    cases = [grasp.simulate(size * direction) for size in sizes]
    along = np.array([case["dx_ht"] @ direction for case in cases])
    slack = np.array([case["tendon_tension_after_N"][t] == 0 for case in cases])
    held = np.array([bool(case["stable"]) for case in cases])

    def slope(where: NDArray[np.bool_], values: Array) -> float | None:
        return float(np.polyfit(sizes[where], values[where], 1)[0]) if where.sum() >= 2 else None

    formula = np.array([grasp.formula(size * direction)[0] @ direction for size in sizes])
    pairs = [(slope(held & ~slack, v), slope(held & slack, v)) for v in (along, formula)]
    (taut, loose), (formula_taut, formula_loose) = pairs
    if taut is None or loose is None or not formula_taut or formula_loose is None:
        return None
    return SlackJump(taut, loose, formula_loose / formula_taut)


def slack_figures(
    hand: Hand, simulator: _core.Simulator, config: SimulationConfig, grasps: int, threads: int
) -> dict[str, float]:
    """How far the compliance along a load jumps where a tendon goes slack."""
    jumps = [j for j in over_grasps(hand, simulator, config, grasps, threads, slack_jump) if j is not None]
    if not jumps:
        raise SimulationError("theory: no tendon went slack under the loads tried")
    ratios = np.array([j.slack_m_N / j.taut_m_N for j in jumps])
    return {
        "slack_jump_grasps": float(len(jumps)),
        "slack_jump_ratio_median": float(np.median(ratios)),
        "slack_jump_ratio_p10": float(np.percentile(ratios, 10)),
        "slack_jump_ratio_p90": float(np.percentile(ratios, 90)),
        "slack_jump_formula_ratio_median": float(np.median([j.formula_ratio for j in jumps])),
    }
