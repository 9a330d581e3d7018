"""How much load grasps are let bear, and at what risk: build/reports/load.json (`make load`).

Grasps that no model was trained on, each loaded in three directions. The model finds the largest admissible load. So do
rules with a fixed safety factor: a constant load, a share of what the grasp presses with, and a share of what statics
allows before a contact slips. All have the same risk on validation grasps, where limits and factors are chosen; what
they allow on test grasps is simulated. What is measured is kept: a study that is cut continues where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from aminn.data.regimes import FRICTION_MAX, NEW_FAMILY, SELECTION
from aminn_base.files import write_atomically, write_json
from aminn_base.program import Messages
from aminn_hand.hand import STATE, Hand
from aminn_hand.sensors import FRICTION_CLASSES, NOMINAL_FRICTION, class_of
from aminn_rt import Model
from aminn_sim import SimulationConfig
from aminn_sim.config import TOOL_FAMILIES
from aminn_sim.open_hand import open_hand
from aminn_sim.replay import ReplayedGrasp, replay
from aminn_sim.simulate import config_sha256

Array = NDArray[np.float64]
Arrays = dict[str, NDArray]
Figures = dict[str, Any]
VERSION = 1
"""To be raised with every change of what is measured, so that kept records are made again."""


@dataclass(frozen=True)
class Scale:
    """How much of everything."""

    validation_grasps: int = 600
    test_grasps: int = 1750
    """Of which 1000 are like those of `make paper`'s training."""
    halvings: int = 7
    """Of the interval that a grasp's true capacity lies in."""
    chunk: int = 50
    """Grasps of one record."""


SEEDS = {"validation": 1801, "test": 1803}
"""How limits are chosen was settled with grasps of 1802 in view: they are no test any more."""
BOUNDS = (2e-3, 0.1)
"""Translation (m) and rotation (rad) that a load may cause: what 19 of 20 stable motions stay below, slips seldom."""
KINDS = ("force", "moment", "point")
"""Of the three directions: a force at the tool's origin, a moment, a force at a point of the tool."""
LEAST_SCALE = 5e-3
"""Of the largest load; a grasp that bears less bears nothing."""
RISK_AIM, RATIO_AIM = 0.02, 1.5
SURENESS = 1.645
"""Standard deviations by which the risk that is chosen on validation grasps lies below the aim: 19 of 20 times."""
P_STABLE = (0.0, 0.7, 0.8, 0.85, 0.9, 0.92, 0.94, 0.95, 0.96, 0.97, 0.975, 0.98, 0.985, 0.99, 0.993, 0.995, 0.998)
MARGINS = (0.0, 0.5, 1.0, 2.0)
P_SLIDE = (1.0, 0.5, 0.3, 0.1)
"""Among which validation grasps choose."""
SCANNED = 100
"""Loads of a dense scan, by which limits are chosen, and that the search is compared with."""
SEARCH_PREDICTIONS = 13
"""That `aminn_admissible_load` makes at most (AMINN_LOAD_PREDICTIONS)."""
TOLD = ("nothing", "class_weight", "friction_weight")
"""What a model is told beside the state."""


# --- grasps and what they bear ------------------------------------------------------------------------------------


def directions(config: SimulationConfig, grasp: ReplayedGrasp) -> Array:
    """(3, 6) loads in `KINDS`' directions, each the largest of the data set's range."""
    rng = np.random.default_rng([config.seed, grasp.grasp_id])
    force, moment, point = rng.normal(size=(3, 3))
    force *= config.force_max_N / np.linalg.norm(force)
    moment *= config.moment_max_Nm / np.linalg.norm(moment)
    point *= config.force_max_N / np.linalg.norm(point)
    arm = rotated(grasp.state["x_ht"][3:], rng.uniform(-1, 1, 3) * grasp.state["tool_size_m"])
    turn = np.cross(arm, point)
    part = min(1.0, config.moment_max_Nm / max(float(np.linalg.norm(turn)), 1e-12))
    nothing = np.zeros(3)
    return np.stack([np.r_[force, nothing], np.r_[nothing, moment], part * np.r_[point, turn]])


def rotated(vector: Array, x: Array) -> Array:
    """x turned by a rotation vector."""
    angle = float(np.linalg.norm(vector))
    axis = vector / max(angle, 1e-12)
    turned = x * np.cos(angle) + np.cross(axis, x) * np.sin(angle) + axis * (axis @ x) * (1 - np.cos(angle))
    return np.asarray(turned)


def borne(case: Mapping[str, NDArray]) -> bool:
    """Whether a simulated load was held, with no more motion than is allowed."""
    dx = case["dx_ht"]
    return bool(case["stable"]) and bool(np.linalg.norm(dx[:3]) <= BOUNDS[0] and np.linalg.norm(dx[3:]) <= BOUNDS[1])


def capacity(grasp: ReplayedGrasp, direction: Array, halvings: int) -> tuple[float, float]:
    """A scale of the direction that is borne, and a larger one that is not; (1, inf) where all is.

    By halvings on a logarithmic scale: what is borne is taken to be so for all smaller loads.
    """
    if borne(grasp.load(direction)):
        return 1.0, np.inf
    low, high = LEAST_SCALE, 1.0
    for _ in range(halvings):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if borne(grasp.load(middle * direction)) else (low, middle)
    return low if low > LEAST_SCALE else 0.0, high


def measure(config: SimulationConfig, ids: range, halvings: int, threads: int) -> Arrays:
    """Grasps of a configuration: their state, directions (n, 3, 6), and with halvings their capacities (n, 3, 2)."""

    def one(grasp: ReplayedGrasp) -> Arrays:
        loads = directions(config, grasp)
        found = grasp.state | {"directions": loads, "contact_forces": grasp.session.contact_forces()}
        return found | ({"capacity": np.array([capacity(grasp, w, halvings) for w in loads])} if halvings else {})

    found = replay(config, ids, one, threads)
    return {name: np.stack([one[name] for one in found]) for name in found[0]}


def config_of(name: str, scale: Scale) -> SimulationConfig:
    """Of the grasps of a part of the study."""
    grasps = {"validation": scale.validation_grasps, "test": scale.test_grasps}[name]
    return SimulationConfig(grasps=grasps, seed=SEEDS[name])


def grasps_of(name: str, scale: Scale, folder: Path, threads: int, echo: Callable[[str], object]) -> Arrays:
    """What `measure` gives, from records where they are there."""
    config, found = config_of(name, scale), []
    halvings = scale.halvings if name == "validation" else 0
    made_of = _made_of(config, halvings)
    for ids in _chunks(config, scale):
        file = folder / f"{name}-{ids.start:05d}-{len(ids)}.npz"
        found.append(_kept(file, made_of) or _keep(file, made_of, measure(config, ids, halvings, threads)))
        echo(f"{name}: {ids.stop} of {config.grasps} grasps")
    return {key: np.concatenate([part[key] for part in found]) for key in found[0]}


def like_the_training(grasps: Arrays) -> Arrays:
    """Those of the tools that the runs of `make paper` learn from."""
    alike = grasps["tool_family"] != TOOL_FAMILIES.index(NEW_FAMILY)
    alike &= grasps["friction"] <= FRICTION_MAX
    return {name: values[alike] for name, values in grasps.items()}


def _chunks(config: SimulationConfig, scale: Scale) -> list[range]:
    """Ids of the grasps of each record."""
    n = config.grasps
    return [range(first, min(first + scale.chunk, n)) for first in range(0, n, scale.chunk)]


def _made_of(config: SimulationConfig, halvings: int) -> str:
    return json.dumps([VERSION, config_sha256(config, open_hand()), BOUNDS, halvings])


def _kept(file: Path, made_of: str) -> Arrays | None:
    if not file.is_file():
        return None
    with np.load(file) as content:
        arrays = dict(content)
    return arrays if str(arrays.pop("made_of")) == made_of else None


def _keep(file: Path, made_of: str, arrays: Arrays) -> Arrays:
    content = BytesIO()
    np.savez_compressed(content, made_of=np.array(made_of), **arrays)  # type: ignore[arg-type]
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, content.getvalue())
    return arrays


# --- rules with a fixed safety factor -------------------------------------------------------------------------------


def slip_loads(hand: Hand, grasps: Arrays, friction: Array, preload: Array) -> Array:
    """(n, 3) scales at which statics lets the first contact slip, or the tool move by more than is allowed.

    Nominal stiffnesses, with every tendon taut. friction (n) of the contacts, preload (n, B, 3) their tangential forces
    on the tool before the load.
    """
    n, grid = len(friction), np.geomspace(LEAST_SCALE, 1.0, 400)
    out = np.zeros((n, len(KINDS)))
    for i in range(n):
        contacts, j_x, j_q = (grasps[name][i] for name in ("contacts", "j_x", "j_q"))
        soft = []
        for b, branch in enumerate(hand.branches):
            own = -j_q[b][:, j_q.shape[2] - len(branch.coordinates) :]
            soft.append(own @ np.linalg.solve(branch.stiffness(), own.T) + branch.eps_m * np.eye(3))
        held = np.flatnonzero(contacts[:, 0]).tolist()
        stiff = {b: np.linalg.solve(soft[b], j_x[b]) for b in held}
        dx = np.linalg.solve(sum(j_x[b].T @ stiff[b] for b in held), grasps["directions"][i].T)  # (6, 3 directions)
        beyond = np.linalg.norm(dx[:3], axis=0) * grid[:, None] > BOUNDS[0]
        beyond |= np.linalg.norm(dx[3:], axis=0) * grid[:, None] > BOUNDS[1]
        for b in held:
            normal, force = contacts[b, 4:7], stiff[b] @ dx  # (3, 3 directions), of the tool on the fingertip
            along = normal @ force
            across = force - normal[:, None] * along
            left = contacts[b, 7] - grid[:, None] * along
            slid = np.linalg.norm(preload[i, b][None, :, None] - grid[:, None, None] * across, axis=1)
            beyond |= slid > friction[i] * left
        out[i] = np.where(beyond.any(0), grid[np.argmax(beyond, 0)], 1.0)
    return out


def preload_of_weight(grasps: Arrays) -> Array:
    """(n, B, 3) tangential forces on the tool before the load, as its weight and the normal forces tell them.

    Least squares with a prior: forces are known to 0.3 N, moments to 0.008 N.m, tangential forces are about 0.7 N.
    """
    known = np.r_[np.full(3, 0.3), np.full(3, 0.008)]
    weight = grasps["tool_mass_kg"][:, None] * grasps["gravity_m_s2"]
    out = 0 * grasps["contact_forces"]
    for i, (contacts, j_x) in enumerate(zip(grasps["contacts"], grasps["j_x"], strict=True)):
        normal = contacts[:, 4:7]
        held = contacts[:, 0] > 0
        tangent = (np.eye(3) - normal[:, :, None] * normal[:, None, :]) * held[:, None, None]
        maps = np.concatenate([a.T @ t for a, t in zip(j_x, tangent, strict=True)], 1)  # (6, 3B)
        pressed = sum(a.T @ n * c[7] for a, n, c, h in zip(j_x, normal, contacts, held, strict=True) if h)
        rows = np.concatenate([maps / known[:, None], np.eye(maps.shape[1]) / 0.7])
        right = np.r_[-(pressed + np.r_[weight[i], np.zeros(3)]) / known, np.zeros(maps.shape[1])]
        forces = np.linalg.lstsq(rows, right, rcond=None)[0].reshape(-1, 3)
        out[i] = np.einsum("bij,bj->bi", tangent, forces)
    return out


def fixed_rules(hand: Hand, grasps: Arrays, told: str) -> dict[str, Array]:
    """(n, 3) scales, each to be multiplied by a factor, of every rule that has one."""
    friction = friction_of(grasps, told)
    none = 0 * grasps["contact_forces"]
    pressed = np.where(grasps["contacts"][..., 0] > 0, grasps["contacts"][..., 7], 0.0).sum(1)
    ones = np.ones((len(friction), len(KINDS)))
    rules = {
        "constant": ones,
        "pressed": ones * (pressed / np.median(pressed))[:, None],
        "statics": slip_loads(hand, grasps, friction, none),
    }
    if told != "nothing":
        rules["statics_preload"] = slip_loads(hand, grasps, friction, preload_of_weight(grasps))
    return rules


def friction_of(grasps: Arrays, told: str) -> Array:
    """(n) what a rule takes for the coefficient."""
    true = grasps["friction"]
    if told == "nothing":
        return np.full(len(true), NOMINAL_FRICTION)
    return friction_sensor(grasps, told)[:, 1]


def friction_sensor(grasps: Arrays, told: str) -> Array:
    """(n, 3) known, coefficient, deviation."""
    true = grasps["friction"]
    if told == "class_weight":
        return np.array(list(FRICTION_CLASSES.values()))[class_of(true)]
    return np.stack([np.ones_like(true), true, 0 * true], 1)


def failed(scales: Array, ends: Array) -> NDArray[np.bool_]:
    """(n, 3) which are larger than what is borne, by the middle of where that ends."""
    low, high = ends[..., 0], ends[..., 1]
    middle = np.where(np.isfinite(high), np.sqrt(np.maximum(low, LEAST_SCALE) * np.where(high > 1, 1, high)), np.inf)
    return scales > middle


def chosen_risk(n: int) -> float:
    """Largest share of n validation loads that may fail, for all such loads to have no more risk than the aim."""
    counts = np.arange(1, n + 1)
    surely = counts + SURENESS * np.sqrt(counts) + 1 <= RISK_AIM * n
    return float(counts[surely].max(initial=0)) / n


def factors_at(rule: Array, ends: Array, risk: float) -> Array:
    """(3) factors, the largest with which a share `risk` of the loads of each kind fails."""
    out = np.zeros(len(KINDS))
    for k in range(len(KINDS)):
        grid = np.geomspace(1e-3, 20, 800) / max(float(np.median(rule[:, k])), 1e-9)
        scales = np.minimum(grid[:, None] * rule[None, :, k], 1.0)
        shares = failed(scales, np.broadcast_to(ends[:, k], (len(grid), *ends[:, k].shape))).mean(1)
        allowed = np.flatnonzero(np.maximum.accumulate(shares) <= risk)
        out[k] = grid[allowed[-1]] if len(allowed) else 0.0
    return out


def relative_load(scales: Array, to: Array) -> tuple[float, float]:
    """Mean and median load relative to another rule's: of each kind of direction, averaged."""
    mean = np.mean(scales.mean(0) / np.maximum(to.mean(0), 1e-12))
    median = np.mean(np.median(scales, 0) / np.maximum(np.median(to, 0), 1e-12))
    return float(mean), float(median)


def best_rule(rules: Mapping[str, Array], ends: Array, risk: float) -> tuple[str, Array]:
    """Name and factors of the rule that allows the largest mean load at a risk."""
    choices = {name: factors_at(rule, ends, risk) for name, rule in rules.items()}
    loads = {
        name: relative_load(np.minimum(choices[name] * rule, 1.0), truly_borne(ends))[0] for name, rule in rules.items()
    }
    name = max(loads, key=lambda k: loads[k])
    return name, choices[name]


# --- the model ------------------------------------------------------------------------------------------------------


def states_of(grasps: Arrays, told: str) -> dict[str, Any]:
    """Arguments of `Model.admissible_load` for each grasp in each direction."""
    n = len(grasps["q"])
    given: dict[str, Any] = {name: grasps[name] for name in STATE if name != "w_e"} | {"w_e": np.zeros((n, 6))}
    if told != "nothing":
        weight = grasps["tool_mass_kg"][:, None] * grasps["gravity_m_s2"]
        given |= {
            "friction": friction_sensor(grasps, told),
            "tool_weight": np.concatenate([np.ones((n, 1)), weight], 1),
        }
    return {name: np.repeat(values, len(KINDS), 0) for name, values in given.items()}


@dataclass(frozen=True)
class Limits:
    """What is asked of a load beside the bounds on motions."""

    p_stable: float
    margin: float
    p_slide: float


def model_scales(model: Model, grasps: Arrays, told: str, limits: Limits, threads: int) -> Array:
    """(n, 3) largest admissible scales."""
    found = model.admissible_load(
        **states_of(grasps, told),
        direction=grasps["directions"].reshape(-1, 6),
        max_translation=BOUNDS[0],
        max_rotation=BOUNDS[1],
        **asdict(limits),
        threads=threads,
    )
    return found.scale.astype(np.float64).reshape(-1, len(KINDS))


@dataclass(frozen=True)
class Scan:
    """Predictions for `SCANNED` scales of each direction, from zero on: (n, 3, scales)."""

    scale: Array
    """(scales)"""
    known: NDArray[np.bool_]
    """Held, and such a load as the model knows."""
    p_stable: Array
    p_slide: Array
    moved: Array
    """m"""
    turned: Array
    """rad"""
    bound: Array
    length_m: float

    def ends(self, limits: Limits) -> Array:
        """(n, 3) the largest scale up to which all is admissible; -1 where nothing is."""
        doubt = limits.margin * self.bound
        good = self.known & (self.p_stable >= limits.p_stable) & (self.p_slide <= limits.p_slide)
        good &= (self.moved + self.length_m * doubt <= BOUNDS[0]) & (self.turned + doubt <= BOUNDS[1])
        last = np.where(good.all(-1), good.shape[-1], np.argmin(good, -1)) - 1
        return np.where(last < 0, -1.0, self.scale[last])


def scan(model: Model, grasps: Arrays, told: str, length_m: float, threads: int) -> Scan:
    """Of all grasps. Scales grow as squares, as those of the search do."""
    scale = np.linspace(0, 1, SCANNED + 1) ** 2
    direction, states = grasps["directions"].reshape(-1, 6), states_of(grasps, told)
    rows = []
    for i in range(len(direction)):
        one = {name: values[i] for name, values in states.items()} | {"w_e": scale[:, None] * direction[i]}
        rows.append(model.predict(**one, threads=threads))
    shape = (-1, len(KINDS), len(scale))

    def whole(values: list[NDArray]) -> NDArray:
        return np.stack(values).reshape(shape)

    return Scan(
        scale,
        whole([r.holds & (r.notes == 0) for r in rows]),
        whole([r.p_stable for r in rows]),
        whole([r.p_slide for r in rows]),
        whole([np.linalg.norm(r.dx_ht[:, :3], axis=1) for r in rows]),
        whole([np.linalg.norm(r.dx_ht[:, 3:], axis=1) for r in rows]),
        whole([r.bound_95 for r in rows]),
        length_m,
    )


def truly_borne(ends: Array) -> Array:
    """(n, 3) largest scale that was borne."""
    return np.where(np.isfinite(ends[..., 1]), ends[..., 0], 1.0)


def choose(scanned: Scan, ends: Array) -> tuple[Limits, float]:
    """Limits that let the largest mean load at the risk, and their risk; where none is as safe, the safest."""
    tried: list[tuple[Limits, float, float]] = []
    for values in product(P_STABLE, MARGINS, P_SLIDE):
        limits = Limits(*values)
        scales = np.maximum(scanned.ends(limits), 0.0)
        tried.append((limits, float(failed(scales, ends).mean()), relative_load(scales, truly_borne(ends))[0]))
    safe = [t for t in tried if t[1] <= chosen_risk(ends[..., 0].size)]
    limits, risk, _ = max(safe, key=lambda t: t[2]) if safe else min(tried, key=lambda t: t[1])
    return limits, risk


def search_figures(scanned: Scan, limits: Limits, found: Array) -> Figures:
    """What the search misses of what a dense scan finds."""
    ends = scanned.ends(limits)
    able = ends > 0
    step = np.sqrt(ends[able]) + 1 / SCANNED  # of the scan, on the scale on which it is even
    return {
        "search_rows": int(able.sum()),
        "search_beyond_a_gap_share": float((np.sqrt(found[able]) > step * 1.0001).mean()),
        "search_share_of_end_mean": float(np.minimum(found[able] / ends[able], 1).mean()),
        "search_predictions": SEARCH_PREDICTIONS,
    }


# --- the study ------------------------------------------------------------------------------------------------------


def outcomes(
    grasps: Arrays, config: SimulationConfig, scales: Array, scale: Scale, folder: Path, threads: int
) -> Arrays:
    """Each load simulated, (n, 3): whether it was unstable, and beyond the bounds; from records where they are there.

    A load of nothing is borne.
    """

    def one(grasp: ReplayedGrasp) -> NDArray[np.bool_]:
        i = row_of[grasp.grasp_id]
        found = np.zeros((len(KINDS), 2), bool)
        for k, (part, direction) in enumerate(zip(scales[i], grasps["directions"][i], strict=True)):
            if part > 0:
                case = grasp.load(part * direction)
                found[k] = not case["stable"], bool(case["stable"]) and not borne(case)
        return found

    made_of, parts, numbers = _made_of(config, 0), [], grasps["grasp_id"]
    row_of = {number: row for row, number in enumerate(numbers.tolist())}
    for chunk in _chunks(config, scale):
        ids = [number for number in chunk if number in row_of]
        if not ids:
            continue
        loads = np.concatenate([np.append(scales[row_of[number]], number) for number in ids])
        file = folder / f"outcomes-{chunk.start:05d}-{hashlib.sha256(loads.tobytes()).hexdigest()[:16]}.npz"
        kept = _kept(file, made_of)
        parts.append(kept or _keep(file, made_of, {"wrong": np.stack(replay(config, ids, one, threads))}))
    found = np.concatenate([part["wrong"] for part in parts])
    return {"unstable": found[..., 0], "beyond": found[..., 1]}


def judged(name: str, out: Arrays) -> Figures:
    """Shares of loads that went wrong."""
    wrong = out["unstable"] | out["beyond"]
    figures = {f"{name}_risk": float(wrong.mean())}
    figures |= {f"{name}_{what}": float(values.mean()) for what, values in out.items()}
    return figures | {f"{name}_risk_{kind}": float(wrong[:, k].mean()) for k, kind in enumerate(KINDS)}


def row_figures(
    hand: Hand, model: Model, told: str, parts: Mapping[str, Arrays], scale: Scale, folder: Path, threads: int
) -> Figures:
    """Of a model that is told something: `TOLD_...`."""
    validation, test, config = parts["validation"], parts["test"], config_of("test", scale)
    scanned, ends = scan(model, validation, told, hand.length_m, threads), validation["capacity"]
    allowed = chosen_risk(ends[..., 0].size)
    limits, risk = choose(scanned, ends)
    chosen = model_scales(model, validation, told, limits, threads)
    rules = {name: fixed_rules(hand, part, told) for name, part in (("validation", validation), ("test", test))}
    rule, factors = best_rule(rules["validation"], ends, allowed)
    scales = model_scales(model, test, told, limits, threads)
    figures: Figures = {f"chosen_{k}": v for k, v in asdict(limits).items()}
    figures |= {"validation_risk": risk, "fixed_rule": rule} | search_figures(scanned, limits, chosen)
    figures |= {f"fixed_factor_{kind}": float(f) for kind, f in zip(KINDS, factors, strict=True)}
    true = truly_borne(ends)
    figures["validation_model_share_of_truth"] = relative_load(chosen, true)[0]
    for name, values in rules["validation"].items():
        other = np.minimum(factors_at(values, ends, allowed) * values, 1.0)
        figures[f"validation_{name}_share_of_truth"] = relative_load(other, true)[0]
        figures[f"validation_ratio_mean_to_{name}"] = relative_load(chosen, other)[0]
    fixed = np.minimum(factors * rules["test"][rule], 1.0)
    figures |= judged("model", outcomes(test, config, scales, scale, folder, threads))
    figures |= judged("fixed", outcomes(test, config, fixed, scale, folder, threads))
    figures["ratio_mean"], figures["ratio_median"] = relative_load(scales, fixed)
    size = np.linalg.norm(test["directions"][..., :3], axis=2) + (np.arange(3) == 1) * np.linalg.norm(
        test["directions"][..., 3:], axis=2
    )
    for k, kind in enumerate(KINDS):
        unit = "Nm" if kind == "moment" else "N"
        for what, values in (("model", scales), ("fixed", fixed)):
            figures[f"{what}_load_mean_{unit}_{kind}"] = float((values * size)[:, k].mean())
    return {f"{told}_{name}": value for name, value in figures.items()}


def missed(report: Figures) -> list[str]:
    """Aims that figures miss, in words."""
    out = []
    for told in TOLD:
        risk, ratio = (report.get(f"{told}_{name}") for name in ("model_risk", "ratio_mean"))
        if risk is not None and risk > RISK_AIM:
            out.append(f"{told}: {risk:.1%} of the loads are not borne")
        if ratio is not None and ratio < RATIO_AIM:
            out.append(f"{told}: {ratio:.2f} times the load of the best fixed factor")
    return out


def study(
    model: Model,
    folder: Path,
    scale: Scale,
    threads: int,
    echo: Callable[[str], object] = click.echo,
    iid: bool = False,
) -> Figures:
    """Measure what is not there yet; the flat report. iid: of tools like those that `make paper` trains on."""
    parts = {name: grasps_of(name, scale, folder, threads, echo) for name in SEEDS}
    parts = {name: like_the_training(part) if iid else part for name, part in parts.items()}
    hand = open_hand().hand
    report: Figures = {
        "model": model.name,
        "validation_grasps": len(parts["validation"]["q"]),
        "test_grasps": len(parts["test"]["q"]),
        "loads": len(parts["test"]["q"]) * len(KINDS),
        "grasps_are": SELECTION if iid else "all",
        "bound_translation_m": BOUNDS[0],
        "bound_rotation_rad": BOUNDS[1],
    }
    for told in TOLD if model.senses else TOLD[:1]:
        report |= row_figures(hand, model, told, parts, scale, folder, threads)
        echo(
            told
            + ": "
            + ", ".join(f"{k} {report[f'{told}_{k}']:.3g}" for k in ("model_risk", "fixed_risk", "ratio_mean"))
        )
    report["aims_missed"] = "; ".join(missed(report))
    return report


@click.command(cls=Messages)
@click.option("--model", type=click.Path(path_type=Path), default=Path("tests/golden"), show_default=True)
@click.option("--iid", is_flag=True, help="Judge on tools like those that the runs of `make paper` learn from.")
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--jobs", type=click.IntRange(1), default=None, help="Threads side by side.  [default: all cores]")
def main(model: Path, iid: bool, build: Path, jobs: int | None) -> None:
    """Let a model say what grasps bear, and simulate it: build/reports/load.json."""
    out = build / "reports" / "load.json"
    report = study(Model.load(model), build / "load", Scale(), jobs or len(os.sched_getaffinity(0)), iid=iid)
    write_json(out, report)
    click.echo(f"aims missed: {report['aims_missed'] or 'none'}\nfigures: {out}")


if __name__ == "__main__":
    main()
