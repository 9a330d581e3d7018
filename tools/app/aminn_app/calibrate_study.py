"""What calibration is good for, on hands that no model was trained on: build/reports/calibrate.json (`make calibrate`).

Simulates grasps of hands of many stiffnesses, trains AMINN and the MLP told them and AMINN untold, then calibrates each
test hand by pushes of a few of its grasps and judges on its other grasps. What a model's errors are is found on
validation hands, and so is how long a model is fine-tuned. Records of each hand are kept: a study that is cut continues
where it stopped.
"""

from __future__ import annotations

import copy
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch
from numpy.typing import NDArray

from aminn.calibration.calibrate import calibrate, refusals
from aminn.calibration.fit import Z90, Errors, Prior
from aminn.calibration.mistakes import Mistake, find_mistakes, mistakes_of
from aminn.calibration.pushes import Predict, Pushes, predictor, pushes_of, relative_errors
from aminn.calibration.store import learn_errors as of_model
from aminn.data.dataset import Dataset, load_dataset
from aminn.evaluation.analysis import SensorNoise, noisy_state
from aminn.evaluation.metrics import all_figures, holds
from aminn.evaluation.predict import predict_states
from aminn.model.baseline import Mlp
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.model.config import Kind, ModelConfig, TrainConfig
from aminn.model.losses import pose_terms
from aminn.model.network import Aminn
from aminn.training.train import train
from aminn_base.files import write_json
from aminn_base.program import Messages
from aminn_export.judge.push_figures import push_figures
from aminn_hand.hand import STATE
from aminn_hand.theta import Theta

from .friction_study import friction_figures, learns
from .pipeline import anew_if_outdated
from .simulation import run_simulation

Array = NDArray[np.float64]
Figures = dict[str, Any]
VERSION = 2
"""To be raised with every change of the figures, so that kept records are made again."""


@dataclass(frozen=True)
class Scale:
    """How much of everything."""

    train_grasps: int = 2000
    reference_grasps: int = 80
    """Of the hand as described, for the reference model."""
    cases: int = 16
    vary: float = 0.5
    validation_hands: int = 6
    test_hands: int = 12
    grasps: int = 40
    """Of each test hand."""
    validation_grasps: int = 40
    """Of each validation hand."""
    epochs: int = TrainConfig().epochs
    seeds: int = 5
    """Draws of pushes of each test hand."""
    mistakes: int = 100
    """Data sets made with each mistake, and clean ones."""
    only: tuple[str, ...] = ()
    """Names of mistakes that are made; all where there is none."""
    tune_steps: tuple[int, ...] = (0, 30, 100)
    """Steps of fine-tuning, among which validation hands choose."""
    budgets: tuple[tuple[int, int], ...] = ((10, 2), (40, 5))
    """(pushes, grasps) of a calibration."""
    device: bool = True
    """Whether to build and replay on every target that there is."""


BUDGET_AIMS = (0.10, 0.06)
KNOWN_AIM, KNOWN_RATIO_AIM, F1_AIM = 0.05, 2.0, 0.01
COVERAGE_AIMS = (0.85, 0.95)
NAMED_AIM = 0.95
OFF_RADIUS_M, OFF_ZERO_RAD = 0.001, 0.02
SEEDS = {"train": 1700, "validation": 55, "test": 99, "reference": 1703}
REFERENCE_MODEL = Path(__file__).resolve().parents[3] / "tests" / "golden" / "aminn.onnx"
"""Trained on the hand as described, with the data of `make demo`."""


def config_of(name: str, scale: Scale) -> dict[str, Any]:
    """Arguments of the simulation of one data set."""
    if name == "reference":
        return {"grasps": scale.reference_grasps, "cases": scale.cases, "seed": SEEDS[name]}
    hands = {"train": scale.train_grasps, "validation": scale.validation_hands, "test": scale.test_hands}[name]
    per_hand = {"train": 1, "validation": scale.validation_grasps, "test": scale.grasps}[name]
    varied = {"vary_mechanics": scale.vary, "grasps_per_hand": per_hand}
    shards = {"shard_grasps": per_hand} if per_hand > 1 else {}
    return {"grasps": hands * per_hand, "cases": scale.cases, "seed": SEEDS[name], **varied, **shards}


RUNS: dict[str, tuple[Kind, bool]] = {"told": ("aminn", True), "mlp": ("mlp", True), "untold": ("aminn", False)}
"""Name -> kind, told."""


def train_config(name: str, scale: Scale) -> TrainConfig:
    """Settings of one run; the MLP without weight decay, which suits it better."""
    kind, told = RUNS[name]
    base = TrainConfig(kind=kind, epochs=scale.epochs, model=ModelConfig(told=None if told else False))
    return replace(base, weight_decay=0.0) if kind == "mlp" else base


def _train(name: str, scale: Scale, folder: Path, position: int) -> str:
    out, data = folder / "runs" / name, load_dataset(folder / "train")
    anew_if_outdated(out, lambda: train(train_config(name, scale), data, out, bar_position=position))
    return name


# --- one hand -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Condition:
    """How a hand is measured."""

    name: str
    noise: float = 0.0
    radius_m: float = 0.0
    zero_rad: float = 0.0

    def theta(self, space: Theta, rng: np.random.Generator) -> Array:
        """What the measurements are off by (P)."""
        theta = np.zeros(len(space))
        theta[space.zeros] = self.zero_rad * rng.choice([-1.0, 1.0], len(theta[space.zeros]))
        theta[-1] = self.radius_m
        return theta


CONDITIONS = (
    Condition("clean"),
    Condition("noise1", noise=1.0),
    Condition("radius", radius_m=OFF_RADIUS_M),
    Condition("zeros", zero_rad=OFF_ZERO_RAD),
)


@dataclass(frozen=True)
class World:
    """Test or validation hands, models, and what is known of their errors."""

    data: Dataset
    checkpoints: dict[str, Checkpoint]
    predicts: dict[str, Predict]
    errors: dict[str, Errors]


def hands_of(data: Dataset) -> list[Dataset]:
    """The samples of each hand."""
    hand_id = data.grasps["hand_id"][data.grasp_rows()]
    return [data.take(hand_id == h) for h in np.unique(hand_id)]


def measured(data: Dataset, off: Array, noise: float, rng: np.random.Generator) -> Dataset:
    """What sensors that are off by `off` (P), and noisy, say of true states."""
    hand, s = data.hand, dict(data.samples)
    contacts = s["contacts"].copy()
    contacts[..., 1:4] -= off[-1] * contacts[..., 4:7]
    s |= {"q": s["q"] - off[Theta(hand).zeros], "contacts": contacts}
    if noise:
        s |= noisy_state(hand, s, SensorNoise().scaled(noise), rng)
    return Dataset(data.manifest, s, data.grasps, data.noise, data.selection)


def choose_pushes(data: Dataset, pushes: int, grasps: int, rng: np.random.Generator) -> tuple[Dataset, Dataset]:
    """Stable cases of a few grasps that hold often enough, evenly shared; and all cases of the other grasps."""
    ids, stable = data.samples["grasp_id"], data.samples["stable"] > 0
    each = -(-pushes // grasps)
    able = [g for g in np.unique(ids) if (stable & (ids == g)).sum() >= each]
    chosen = rng.permutation(able)[:grasps]
    rows = np.concatenate([rng.permutation(np.flatnonzero(stable & (ids == g)))[:each] for g in chosen])
    return data.take(rng.permutation(rows)[:pushes]), data.take(~np.isin(ids, chosen))


def judge(checkpoint: Checkpoint, data: Dataset, theta: Array | None) -> Figures:
    """Figures of a model on measured states of one hand, and the relative errors of all that hold."""
    s = data.samples
    out = predict_states(checkpoint.model, s["q"], s["x_ht"], s["w_e"], s["contacts"], theta)
    return judged(data, out["dx_ht"], holds(out["p_stable"], checkpoint.meta["tau"]))


def judged(data: Dataset, dx: Array, called: NDArray[np.bool_]) -> Figures:
    """Figures of displacements (n, 6) and of what is called stable (n)."""
    s, stable = data.samples, data.samples["stable"] > 0
    found = all_figures(s["w_e"], s["dx_ht"], stable, dx, called, data.hand.length_m)
    kept = ("relative_error_median", "relative_error_p90", "f1", "passivity_violation_full")
    both = stable & called
    work = (s["w_e"] * dx).sum(1)
    return {k: found[k] for k in kept} | {
        "hits": int(both.sum()),
        "called": int(called.sum()),
        "held": int(stable.sum()),
        "relative": relative_errors(dx[both], pushes_of(data.take(both))).round(5).tolist() if both.any() else [],
        "violations": int(((work < 0) & called).sum()),
    }


def reference_figures(data: Dataset) -> Figures:
    """Of the reference model on grasps of the hand as described, through ONNX Runtime."""
    import onnxruntime

    session = onnxruntime.InferenceSession(REFERENCE_MODEL, providers=["CPUExecutionProvider"])
    inputs = {i.name: data.samples[i.name].astype(np.float32) for i in session.get_inputs() if i.name in data.samples}
    p_stable, dx = session.run(["p_stable", "dx_ht"], inputs)
    tau = float(session.get_modelmeta().custom_metadata_map["tau"])
    return judged(data, dx.astype(np.float64), holds(p_stable, tau))


def one_calibration(world: World, name: str, data: Dataset, truth: Array, condition: Condition, budget: tuple[int, int],
                    seed: int) -> Figures:  # fmt: skip
    """Calibrate a hand by pushes drawn with a seed and judge on its other grasps, before, after, and theta known."""
    rng = np.random.default_rng([seed, *budget])
    space, checkpoint, predict = Theta(data.hand), world.checkpoints[name], world.predicts[name]
    off = condition.theta(space, rng)
    told, rest = (measured(part, off, condition.noise, rng) for part in choose_pushes(data, *budget, rng))
    pushes, theta = pushes_of(told), truth + off
    found = calibrate(predict, pushes, Prior(), world.errors[name], condition.noise, look_for_mistakes=False)
    refused = bool(list(refusals(found)))
    used = 0 * found.theta if refused else found.theta
    inside = np.abs(found.fit.mean - theta) <= Z90 * found.fit.sd
    share = found.fit.sd / found.prior.sd(space)
    return {
        "before": judge(checkpoint, rest, np.zeros(len(space))),
        "after": judge(checkpoint, rest, used),
        "known": judge(checkpoint, rest, theta),
        "refused": refused,
        "blend": found.held_out.blend,
        "inside": inside.tolist(),
        "sd_share": share.round(4).tolist(),
        "z": ((found.fit.mean - theta) / found.fit.sd).round(4).tolist(),
        "error": (used - theta).round(5).tolist(),
        "held_out": [float(np.median(e)) for e in (found.held_out.before, found.held_out.after)],
    }


# --- fine-tuning ----------------------------------------------------------------------------------------------------

TUNE_RATE = 1e-3


def fine_tuned(model: Aminn | Mlp, pushes: Pushes, steps: int) -> Aminn | Mlp:
    """The model with its second stage trained on pushes alone, theta zero."""
    tuned = copy.deepcopy(model)
    if not steps:
        return tuned
    from aminn.evaluation.predict import true_states

    states = true_states(pushes.hand, pushes.q, pushes.x_ht, pushes.w_e, pushes.contacts)
    x = {name: torch.as_tensor(value).float() for name, value in states.items()}
    dx = torch.as_tensor(pushes.dx_ht).float()
    optimiser = torch.optim.Adam(tuned.stage2.parameters(), lr=TUNE_RATE)
    weights = TrainConfig().loss
    for _ in range(steps):
        optimiser.zero_grad()
        out = tuned.stage2(x)
        terms = pose_terms(out[0] if isinstance(out, tuple) else out, dx, weights, pushes.hand.length_m)
        sum(terms.values(), torch.zeros(())).backward()
        optimiser.step()
    return tuned


def tune(world: World, name: str, data: Dataset, budget: tuple[int, int], seed: int, steps: int) -> Figures:
    """Fine-tune on pushes drawn with a seed and judge on the hand's other grasps."""
    rng = np.random.default_rng([seed, *budget])
    CONDITIONS[0].theta(Theta(data.hand), rng)
    told, rest = choose_pushes(data, *budget, rng)
    checkpoint = world.checkpoints[name]
    return judge(replace(checkpoint, model=fine_tuned(checkpoint.model, pushes_of(told), steps)), rest, None)


# --- mistakes -------------------------------------------------------------------------------------------------------


USUAL = (
    "load_sign",
    "millimetres_positions",
    "millimetres_displacements",
    "degrees_joints",
    "degrees_displacements",
    "fingers_exchanged_all",
    "fingers_exchanged_contacts",
    "fingertip_centre",
    "moment_point_hand",
    "moment_point_contacts",
    "frame_loads_in_tool",
    "frame_loads_axes",
    "frame_displacements_in_tool",
    "force_and_moment",
)
"""Mistakes that data sets are made with."""


def mistake_names(data: Dataset) -> dict[str, list[Mistake]]:
    """Every mistake by name and variant; one of many is drawn each time."""
    found: dict[str, list[Mistake]] = {}
    for m in mistakes_of(data.hand):
        found.setdefault("_".join(filter(None, (m.name, m.variant))), []).append(m)
    return found


def one_mistake(world: World, data: Dataset, name: str, seed: int, budget: tuple[int, int]) -> Figures:
    """Make a mistake in pushes drawn with a seed, and say what is named; `clean` makes none."""
    rng = np.random.default_rng([7, seed])
    told, _ = choose_pushes(data, *budget, rng)
    pushes = pushes_of(told)
    if name != "clean":
        made = mistake_names(data)[name]
        made_one = made[int(rng.integers(len(made)))]
        pushes = made_one.made(pushes)
    found = find_mistakes(world.predicts["told"], pushes, Prior(), world.errors["told"], margin=0.0)
    return {
        "seed": seed,
        "named": [[f.mistake.name, f.mistake.variant] for f in found],
        "gain": [round(f.gain, 2) for f in found],
    }


# --- the study ------------------------------------------------------------------------------------------------------


@cache
def world_of(folder: Path) -> World:
    """Test hands and all models."""
    torch.set_num_threads(1)
    checkpoints = {name: load_checkpoint(folder / "runs" / name) for name in RUNS}
    predicts = {name: predictor(c.model) for name, c in checkpoints.items()}
    kept = json.loads((folder / "errors.json").read_text())
    return World(
        load_dataset(folder / "test"), checkpoints, predicts, {k: Errors(**v) for k, v in kept["errors"].items()}
    )


def learn(folder: Path, scale: Scale) -> dict[str, Any]:
    """Of each model: its errors, and for how many steps it is fine-tuned, both from the validation hands."""
    out, checkpoints = (
        folder / "errors.json",
        {n: load_checkpoint(folder / "runs" / n) for n in RUNS},
    )
    identity = {"version": VERSION, **{name: c.sha256 for name, c in checkpoints.items()}}
    if out.is_file() and json.loads(out.read_text())["identity"] == identity:
        return json.loads(out.read_text())
    torch.set_num_threads(1)
    data = load_dataset(folder / "validation")
    errors = {name: of_model(c, data) for name, c in checkpoints.items()}
    world, steps = World(data, checkpoints, {}, {}), {}
    for name in ("told", "mlp"):
        for k, budget in enumerate(scale.budgets):
            tried = {
                n: np.concatenate([tune(world, name, hand, budget, 0, n)["relative"] for hand in hands_of(data)])
                for n in scale.tune_steps
            }
            steps[f"{name}_{k}"] = min(tried, key=lambda n: float(np.median(tried[n])))
    write_json(out, {"identity": identity, "errors": {k: asdict(e) for k, e in errors.items()}, "steps": steps})
    return json.loads(out.read_text())


PARTS = ("told", "others", "mistakes")
"""Of a hand's record, in the order in which they are made."""


def hand_record(folder: Path, part: str, number: int, scale: Scale) -> Figures:
    """One part of what there is to know of one test hand."""
    world = world_of(folder)
    data = hands_of(world.data)[number]
    truth, steps = data.samples["theta"][0], json.loads((folder / "errors.json").read_text())["steps"]

    def calibrated(name: str, condition: Condition, k: int) -> list[Figures]:
        budget = scale.budgets[k]
        return [one_calibration(world, name, data, truth, condition, budget, seed) for seed in range(scale.seeds)]

    budgets = range(len(scale.budgets))
    if part == "told":
        return {
            "known": {
                "told": judge(world.checkpoints["told"], data, truth),
                "nominal": judge(world.checkpoints["told"], data, 0 * truth),
            },
            "calibrated": {f"told_{c.name}_{k}": calibrated("told", c, k) for c in CONDITIONS for k in budgets},
        }
    if part == "others":
        others = ("mlp", "untold")
        seeds = range(scale.seeds)
        return {
            "known": {name: judge(world.checkpoints[name], data, truth) for name in others},
            "calibrated": {f"{name}_clean_{k}": calibrated(name, CONDITIONS[0], k) for name in others for k in budgets},
            "tuned": {
                f"{name}_{k}": [tune(world, name, data, scale.budgets[k], s, steps[f"{name}_{k}"]) for s in seeds]
                for name in ("told", "mlp")
                for k in budgets
            },
        }
    names = ["clean", *(scale.only or USUAL)]
    own = [seed for seed in range(scale.mistakes) if seed % scale.test_hands == number]
    return {"mistakes": {n: [one_mistake(world, data, n, seed, scale.budgets[0]) for seed in own] for n in names}}


def _kept(folder: Path, part: str, number: int, scale: Scale) -> Figures:
    """`hand_record`, or what an earlier call found."""
    identity = {
        "version": VERSION,
        "scale": asdict(scale),
        "runs": [load_checkpoint(folder / "runs" / name).sha256 for name in RUNS],
        "test": load_dataset(folder / "test").sha256,
        "learned": json.loads((folder / "errors.json").read_text()),
    }
    identity = json.loads(json.dumps(identity))
    kept = folder / "records" / f"{part}{number:02d}.json"
    if kept.is_file():
        old = json.loads(kept.read_text())
        if old["identity"] == identity:
            return old["record"]
    start = time.process_time()
    record = hand_record(folder, part, number, scale) | {"seconds": time.process_time() - start}
    write_json(kept, {"identity": identity, "record": record})
    return json.loads(kept.read_text())["record"]


def _spread(errors: Figures) -> Figures:
    """`Errors` as flat figures."""
    bias = {f"bias_{kind}": value for kind, value in errors["bias"].items()}
    return {k: v for k, v in errors.items() if k != "bias"} | bias


def _pooled(rows: Iterable[Figures]) -> Figures:
    """Figures over all load cases of rows of `judge`."""
    rows = list(rows)
    relative = np.concatenate([row["relative"] for row in rows])
    hits, called, held = (sum(row[k] for row in rows) for k in ("hits", "called", "held"))
    return {
        "relative_error_median": float(np.median(relative)),
        "relative_error_p90": float(np.quantile(relative, 0.9)),
        "f1": 2 * hits / max(called + held, 1),
        "full_work_violations": sum(row["violations"] for row in rows),
        "worst_hand_median": max(row["relative_error_median"] for row in rows),
    }


def _flat(start: str, figures: Figures) -> Figures:
    return {f"{start}_{key}": value for key, value in figures.items()}


def merged(records: Iterable[Figures]) -> Figures:
    """The parts of one hand as one record."""
    out: Figures = {}
    for record in records:
        for key, value in record.items():
            out[key] = out.get(key, {}) | value if isinstance(value, dict) else value
    return out


KNOWN = {"told": "known", "nominal": "uncalibrated", "untold": "untold_known", "mlp": "mlp_known"}


def summarise(records: list[Figures], reference: Figures, scale: Scale, space: Theta) -> Figures:
    """The flat report of hands that are all as far, but for `aims_missed`."""
    out: Figures = {"test_hands": len(records), "seeds": scale.seeds}
    out |= _flat("reference", _pooled([reference]))
    for name in (name for name in KNOWN if name in records[0]["known"]):
        out |= _flat(KNOWN[name], _pooled(r["known"][name] for r in records))
    out["known_ratio_to_reference"] = out["known_relative_error_median"] / out["reference_relative_error_median"]
    for key in records[0]["calibrated"]:
        name, condition, k = key.split("_")
        start = "_".join(filter(None, ("" if name == "told" else name, "" if condition == "clean" else condition)))
        start = f"{start}_{scale.budgets[int(k)][0]}".strip("_")
        start = f"pushes_{start}" if start[0].isdigit() else start
        runs = [run for r in records for run in r["calibrated"][key]]
        for when in ("before", "after", "known"):
            pooled = _pooled(run[when] for run in runs)
            per_hand = [_pooled(run[when] for run in r["calibrated"][key])["relative_error_median"] for r in records]
            out |= _flat(f"{start}_{when}", pooled | {"worst_hand_median": max(per_hand)})
        worse = [run["after"]["relative_error_median"] > run["before"]["relative_error_median"] for run in runs]
        hands = [
            _pooled(run["after"] for run in r["calibrated"][key])["relative_error_median"]
            > _pooled(run["before"] for run in r["calibrated"][key])["relative_error_median"]
            for r in records
        ]
        out |= _flat(start, {"worse_runs": int(sum(worse)), "worse_hands": int(sum(hands)), "runs": len(runs),
                             "refused": int(sum(run["refused"] for run in runs))})  # fmt: skip
        inside, share = (np.array([run[k2] for run in runs], float) for k2 in ("inside", "sd_share"))
        factors = slice(0, space.factors)
        clear = share[:, factors] <= 0.8
        out |= _flat(start, {
            "coverage_90": float(inside[:, factors].mean()),
            "coverage_90_determined": float(inside[:, factors][clear].mean()) if clear.any() else None,
            "coverage_90_zeros": float(inside[:, space.zeros].mean()),
            "coverage_90_radius": float(inside[:, -1].mean()),
            "determined_share": float(clear.mean()),
        })  # fmt: skip
    for key in records[0].get("tuned", {}):
        name, k = key.split("_")
        start = f"{'aminn' if name == 'told' else name}_tuned_{scale.budgets[int(k)][0]}"
        out |= _flat(start, _pooled(run for r in records for run in r["tuned"][key]))
    return out | _mistake_figures(records)


def _mistake_figures(records: list[Figures]) -> Figures:
    from aminn.calibration.mistakes import MARGIN

    out: Figures = {}
    for name in sorted({name for r in records for name in r.get("mistakes", {})}):
        sets = [m for r in records for m in r["mistakes"].get(name, [])]
        gains = [max(m["gain"], default=-1.0) for m in sets]
        sure = [m for m, gain in zip(sets, gains, strict=True) if gain >= MARGIN]
        if name == "clean":
            out |= {
                "mistake_clean_sets": len(sets),
                "mistake_clean_named": len(sure),
                "mistake_clean_gain_max": max(gains),
            }
            continue
        right = [m for m in sure if any("_".join(filter(None, f)) == name for f in m["named"])]
        kind = [m for m in sure if any(name.startswith(f[0]) for f in m["named"])]
        first = [m for m in sure if name.startswith(m["named"][0][0])]
        counts = {"named": len(kind), "named_first": len(first), "named_variant": len(right)}
        out |= _flat(f"mistake_{name}", {"sets": len(sets), **counts, "gain_p5": float(np.quantile(gains, 0.05))})
    return out


def missed(out: Figures, scale: Scale) -> list[str]:
    """Aims that a report does not meet."""
    wrong = []

    def aim(text: str, met: bool) -> None:
        if not met:
            wrong.append(text)

    known = out["known_relative_error_median"]
    aim(f"theta known: {known:.3f}, at most {KNOWN_AIM}", known <= KNOWN_AIM)
    ratio = out["known_ratio_to_reference"]
    aim(
        f"theta known: {ratio:.2f} times the reference hand's own, at most {KNOWN_RATIO_AIM:g}",
        ratio <= KNOWN_RATIO_AIM,
    )
    lost = out["reference_f1"] - out["known_f1"]
    aim(f"theta known: F1 {lost:.3f} below the reference hand's, at most {F1_AIM}", lost <= F1_AIM)
    aim("full-work violations with theta known", out["known_full_work_violations"] == 0)
    for (n, _), most in zip(scale.budgets, BUDGET_AIMS, strict=True):
        found = out[f"pushes_{n}_after_relative_error_median"]
        aim(f"{n} pushes: {found:.3f}, at most {most}", found <= most)
        aim(
            f"{n} pushes: worse than before on {out[f'pushes_{n}_worse_hands']} hands",
            not out[f"pushes_{n}_worse_hands"],
        )
        cover, (low, high) = out[f"pushes_{n}_coverage_90"], COVERAGE_AIMS
        aim(f"{n} pushes: 90 % intervals hold {cover:.0%}", low <= cover <= high)
    for name in sorted(k.removesuffix("_named") for k in out if k.startswith("mistake_") and k.endswith("_named")):
        if name == "mistake_clean":
            aim(f"mistakes named in {out['mistake_clean_named']} clean sets", not out["mistake_clean_named"])
        else:
            share = out[f"{name}_named"] / out[f"{name}_sets"]
            aim(f"{name.removeprefix('mistake_')} named in {share:.0%}", share >= NAMED_AIM)
    if out.get("device_aims_missed"):
        wrong.append(str(out["device_aims_missed"]))
    return wrong


@cache
def device_figures(work: Path) -> Figures:
    """What calibration costs on the device, `device_...`, of the reference model, where a checkout has it."""
    golden = Path(__file__).resolve().parents[3] / "tests" / "golden"
    return push_figures(golden, golden / "golden.bin", work) if (golden / "golden.bin").is_file() else {}


def learned_on_the_device(folder: Path, scale: Scale) -> Figures:
    """What the device's recursion makes of the pushes of each test hand, in float64: `device_learned_...`.

    Relative errors on the hand's other grasps before, after, and with theta known; how many draws of pushes made it
    worse; how often 90 % intervals hold the truth.
    """
    from aminn.model.export_tables import export_tables
    from aminn_export.samples.recursion import Recursion

    checkpoint = load_checkpoint(folder / "runs" / "told")
    out: Figures = {}
    exported = export_tables(checkpoint)
    for k, budget in enumerate(scale.budgets):
        errors: dict[str, list[float]] = {"before": [], "after": [], "known": []}
        worse, inside = 0, []
        for hand in hands_of(load_dataset(folder / "test")):
            truth = hand.samples["theta"][0]
            for seed in range(scale.seeds):
                told, rest = choose_pushes(hand, *budget, np.random.default_rng([seed, *budget]))
                learner = Recursion(exported)
                for i in np.argsort(told.samples["grasp_id"], kind="stable"):
                    state = {name: told.samples[name][i] for name in STATE}
                    learner.push(state, told.samples["dx_ht"][i])
                found = {
                    name: judge(checkpoint, rest, theta)
                    for name, theta in (("before", 0 * truth), ("after", learner.theta), ("known", truth))
                }
                for name, figures in found.items():
                    errors[name] += figures["relative"]
                medians = {name: figures["relative_error_median"] for name, figures in found.items()}
                worse += medians["after"] > medians["before"]
                at = slice(len(learner.sd))
                inside += (np.abs(learner.theta[at] - truth[at]) <= Z90 * learner.sd).tolist()
        out |= {f"device_learned_{k}_{name}_median": float(np.median(e)) for name, e in errors.items()}
        out |= {f"device_learned_{k}_worse": worse, f"device_learned_{k}_coverage": float(np.mean(inside))}
    return out


def learned_friction(folder: Path) -> Figures:
    """What the test hands' loads tell of friction (`friction_figures`), theta told; nothing where none slides."""
    checkpoint = load_checkpoint(folder / "runs" / "told")
    return friction_figures(checkpoint, load_dataset(folder / "test")) if learns(checkpoint) else {}


class _Here(Executor):
    """Does everything in this process, at once."""

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        done: Future = Future()
        done.set_result(fn(*args, **kwargs))
        return done


def _workers(jobs: int) -> Executor:
    return ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) if jobs > 1 else _Here()


def study(
    folder: Path,
    scale: Scale,
    jobs: int,
    echo: Callable[[str], object] = click.echo,
    found: Callable[[Figures], object] = lambda report: None,
) -> Figures:
    """Make what is not there yet, and the flat report; `found` gets it each time when it grows."""
    for name in SEEDS:
        echo(f"== data: {name}")
        run_simulation(folder / name, threads=jobs, **config_of(name, scale))
    with _workers(jobs) as pool:
        echo("== training")
        for done in as_completed([pool.submit(_train, name, scale, folder, k) for k, name in enumerate(RUNS)]):
            echo(f"trained: {done.result()}")
    echo("== errors of the models, on validation hands")
    learned = learn(folder, scale)
    for name, errors in learned["errors"].items():
        echo(f"{name}: " + ", ".join(f"{k} {v:.3g}" for k, v in _spread(errors).items()))
    nominal = load_dataset(folder / "reference")
    reference = reference_figures(nominal)
    records: dict[int, dict[str, Figures]] = {}
    report: Figures = {}
    with _workers(jobs) as pool:
        futures = {
            pool.submit(_kept, folder, part, h, scale): (part, h) for part in PARTS for h in range(scale.test_hands)
        }
        for future in as_completed(futures):
            part, h = futures[future]
            records.setdefault(h, {})[part] = future.result()
            echo(f"hand {h}, {part}: {future.result()['seconds']:.0f} s of processor time")
            finished = [p for p in PARTS if all(p in records.get(k, {}) for k in range(scale.test_hands))]
            if finished[:1] == ["told"] and part in finished:
                whole = [merged(records[k][p] for p in finished) for k in sorted(records)]
                report = summarise(whole, reference, scale, Theta(nominal.hand))
                report |= {f"errors_{m}_{k}": v for m, e in learned["errors"].items() for k, v in _spread(e).items()}
                report |= {f"tune_steps_{k}": v for k, v in learned["steps"].items()}
                report |= device_figures(folder / "device") if scale.device else {}
                report |= learned_on_the_device(folder, scale)
                report |= learned_friction(folder)
                report |= {"parts": " ".join(finished), "aims_missed": "; ".join(missed(report, scale))}
                found(report)
    return report


@click.command(cls=Messages)
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--jobs", type=click.IntRange(1), default=None, help="Processes side by side.  [default: all cores]")
def main(build: Path, jobs: int | None) -> None:
    """Calibrate hands that no model was trained on, and judge: build/reports/calibrate.json."""
    out = build / "reports" / "calibrate.json"
    workers = jobs or len(os.sched_getaffinity(0))
    report = study(build / "calibrate", Scale(), workers, found=lambda grown: write_json(out, grown))
    for (n, grasps), most in zip(Scale().budgets, BUDGET_AIMS, strict=True):
        before, after = (report[f"pushes_{n}_{when}_relative_error_median"] for when in ("before", "after"))
        click.echo(f"{n} pushes in {grasps} grasps: error {before:.3f} before, {after:.3f} after (aim {most})")
    click.echo(f"aims missed: {report['aims_missed'] or 'none'}\nfigures: {out}")


if __name__ == "__main__":
    main()
