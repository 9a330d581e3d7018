"""Figures of trained models on a split, beside the analytical model, no motion and the labels themselves."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from aminn_base.errors import AminnError

from ..data.dataset import MEASURED, Dataset
from ..data.origin import check_hand, same_configuration, states_of, training_set
from ..data.slides import slid_cases
from ..model.checkpoint import Checkpoint
from ..model.config import ModelConfig
from ..model.network import Backbone, scaled_pose
from .metrics import (
    COLUMNS,
    SURE_COLUMNS,
    Column,
    all_figures,
    bound_figures,
    calibration_figures,
    choose_tau,
    displacement_figures,
    f1_score,
    holds,
    pose_error,
    pose_size,
    refusal_figures,
    slide_figures,
    violation_rate,
)
from .predict import predict

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """One model's outputs on a split."""

    name: str
    dx: Array  # (n, 6)
    stable: NDArray[np.bool_]  # (n,)
    p_stable: Array | None = None  # (n,), of models that give a probability
    gate: Array | None = None  # (n, B), of AMINN
    p_slide: Array | None = None  # (n,), of models that say how sure they are
    bound_95: Array | None = None  # (n,), the pose error that is not exceeded in 95 of 100

    def take(self, index: NDArray) -> Prediction:
        """The samples that `index` (indices or a mask) selects."""
        arrays = {k: v[index] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)

    def doubt(self, length_m: float) -> Array:
        """By what a sample (n) would be refused: the bound, else how unlikely it is to hold, else how far it moves."""
        if self.bound_95 is not None:
            return self.bound_95
        return pose_size(self.dx, length_m) if self.p_stable is None else 1 - self.p_stable


@dataclass(frozen=True)
class Evaluation:
    """Figures and the predictions that they were taken from."""

    split: str
    table: dict[str, dict[str, float]]
    """Model name -> figures of `metrics.all_figures`."""
    labels: dict[str, float]
    """The ground truth's own figures: stable share, passivity, noise floor."""
    predictions: dict[str, Prediction]
    data: Dataset
    notes: tuple[str, ...] = ()
    """What must be said beside the figures."""


ALL = "all"
"""In place of a split: every load case."""
SPLIT_NAMES = {ALL: "data set"}
BASELINES = {
    "analytical": "analytical",
    "analytical_stick": "analytical, no sliding",
    "analytical_nominal": "analytical, theta unknown",
    "no_motion": "no motion",
    "label": "ground truth",
}
"""What stands beside the runs in every table, and how pages call it. No run has one of these names."""
FORMULAS: dict[str, tuple[bool, Literal["none", "secant"]]] = {
    "analytical": (True, "secant"),
    "analytical_stick": (True, "none"),
    "analytical_nominal": (False, "secant"),
}
"""Analytical models: whether theta is known to them, and whether contacts slide."""
KIND_NAMES = {"aminn": "AMINN", "mlp": "MLP"}


def names_of(checkpoints: list[Checkpoint]) -> list[str]:
    """A row's name for each run: its kind, or its folder where a kind stands more than once.

    As much of the folder's path as tells them apart; "run NAME" where a baseline or a kind has that name already.
    Raises AminnError for a run that is given twice.
    """
    places = [c.path.resolve() for c in checkpoints]
    if len(set(places)) < len(places):
        raise AminnError(f"{max(places, key=places.count)}: this run is given twice; give each run once")
    kinds = [c.model.kind for c in checkpoints]
    shared = [place for place, kind in zip(places, kinds, strict=True) if kinds.count(kind) > 1]
    taken = {flat_key(text) for names in (BASELINES, KIND_NAMES) for pair in names.items() for text in pair}
    names: list[str] = []
    for place, kind in zip(places, kinds, strict=True):
        name = _tail(place, shared) if place in shared else kind
        if place in shared and flat_key(name) in taken - {kind}:
            name = f"run {name}"
        while flat_key(name) in map(flat_key, names):
            name += "_"
        names.append(name)
    return names


def _tail(place: Path, others: list[Path]) -> str:
    """The end of a folder's path that no other has."""
    for n in range(1, len(place.parts)):
        tail = place.parts[-n:]
        if sum(other.parts[-n:] == tail for other in others) == 1:
            break
    return "/".join(tail)


def flat_key(name: str) -> str:
    """A name as part of a flat key."""
    return re.sub(r"\W+", "_", name).lower()


def learned(checkpoint: Checkpoint, data: Dataset, name: str) -> Prediction:
    """A trained cascade at its own tau."""
    return predicted(name, predict(checkpoint.model, data), checkpoint.meta["tau"])


def predicted(name: str, out: Mapping[str, Array], tau: float) -> Prediction:
    """What a cascade's outputs say with a threshold."""
    stable = holds(out["p_stable"], tau)
    return Prediction(name, out["dx_ht"], stable, out["p_stable"], out.get("gate"), out["p_slide"], out["bound_95"])


def analytical(data: Dataset, validation: Dataset, name: str = "analytical") -> Prediction:
    """Nominal springs, tendons taut, nothing learned; contacts slide at nominal friction and without preload.

    One of `FORMULAS`: with the data's theta, if they have it, or without; and with contacts that hold whatever they
    carry. Calls a grasp stable when the predicted motion is below a bound chosen on validation data by the same rule as
    tau.
    """
    known, friction = FORMULAS[name]
    config = ModelConfig(friction=friction)
    backbone = Backbone(config, 1, data.hand)

    def motion(part: Dataset) -> tuple[Array, Array]:
        x = part.inputs()
        if not known:
            x.pop("theta", None)
        with torch.no_grad():
            dx = backbone.nominal_response(x).dx
        return dx.double().numpy(), -scaled_pose(dx, data.hand.length_m).norm(dim=1).double().numpy()

    dx_v, score_v = motion(validation)
    error_v = pose_error(dx_v, validation.samples["dx_ht"], data.hand.length_m)
    bound = choose_tau(score_v, validation.samples["stable"] > 0, error_v)
    dx, score = motion(data)
    return Prediction(name, dx, score >= bound)


def baselines(data: Dataset, validation: Dataset) -> list[Prediction]:
    """What stands beside the runs: the analytical models, where the data have theta also without it, and no motion."""
    names = [name for name, (known, _) in FORMULAS.items() if known or data.has_theta]
    return [*(analytical(data, validation, name) for name in names), no_motion(data)]


def no_motion(data: Dataset) -> Prediction:
    """Every grasp holds and nothing moves."""
    return Prediction("no_motion", np.zeros((len(data), 6)), np.ones(len(data), bool))


def label_figures(data: Dataset) -> dict[str, float]:
    """The labels' own figures: stable share, passivity, and what simulating again with other settings changes."""
    s = data.samples
    stable = s["stable"] > 0
    figures = {
        "n_samples": len(data),
        "n_grasps": len(np.unique(s["grasp_id"])),
        "stable_share": float(stable.mean()),
        "motion_rms": float(np.sqrt(np.mean(pose_size(s["dx_ht"][stable], data.hand.length_m) ** 2))),
        "motion_median_mm": 1e3 * float(np.median(np.linalg.norm(s["dx_ht"][stable][:, :3], axis=1))),
        "passivity_violation_translational": violation_rate(s["w_e"], s["dx_ht"], stable, False),
        "passivity_violation_full": violation_rate(s["w_e"], s["dx_ht"], stable, True),
    }
    return figures | noise_floor(data)


def noise_floor(data: Dataset) -> dict[str, float]:
    """How far the labels agree with themselves: half the time step, and (`impratio_`) another impedance ratio.

    Errors are over the cases that hold both times, `flipped` is the share of those that hold once. Nothing of measured
    data.
    """
    if data.measured:
        return {}
    s = data.samples
    figures: dict[str, float] = {}
    again = np.flatnonzero(s["noise_row"] >= 0)
    rows = s["noise_row"][again]
    for setting, prefix in (("half_step", "noise_floor_"), ("impratio", "noise_floor_impratio_")):
        held = data.noise[f"stable_{setting}"][rows] > 0
        both = held & (s["stable"][again] > 0)
        errors = displacement_figures(
            data.noise[f"dx_{setting}"][rows][both], s["dx_ht"][again][both], data.hand.length_m
        )
        kept = ("rmse_pose", "relative_error_median", "relative_error_p90")
        figures |= {prefix + name: errors[name] for name in kept}
        figures[prefix + "n"] = int(both.sum())
        flips = held != (s["stable"][again] > 0)
        figures[prefix + "flipped"] = float(flips.mean()) if len(flips) else float("nan")
        figures[prefix + "f1"] = f1_score(held, s["stable"][again] > 0)
    return figures


def evaluate(
    checkpoints: list[Checkpoint], dataset: Dataset, split: str = "test", trained_on: Dataset | None = None
) -> Evaluation:
    """Figures on one split of `dataset`, or on `ALL` of it.

    More grasps of the data that a model was trained on are welcome: they do not move between splits. Notes say where a
    split may leak, and why. `trained_on`, the data set of the training, says which of its grasps are among the data,
    and these are left out. Raises AminnError for data of another hand, for a split without a load case, and where none
    of its cases is stable.
    """
    notes, unsure = [], False
    for checkpoint in checkpoints:
        check_hand(checkpoint, dataset)
        note, leaks = _leak(checkpoint, dataset, split)
        notes += [note] if note else []
        unsure |= leaks
    notes += _sensors_told(checkpoints, dataset)
    data = dataset if split == ALL else dataset.split(split)
    validation = data if split == ALL else dataset.split("validation")
    if trained_on is not None:
        data, left_out = _without_training(checkpoints, data, trained_on)
        notes.append(f"{left_out} load cases of training grasps are left out")
    elif unsure:
        place = SPLIT_NAMES.get(split, f"{split} split")
        notes.append(f"its training grasps may stand in this {place}; give --trained-on to leave them out")
    if split not in (ALL, "train") and any(same_configuration(c, dataset) for c in checkpoints):
        notes += _hands_seen(dataset, data)
    if split == ALL:
        notes.append("the analytical model's bound of stability was chosen on these load cases themselves")
    for name, part in ((split, data), ("validation", validation)):
        text = SPLIT_NAMES.get(split, f"{name} split")
        make = "measure" if dataset.measured else "simulate"
        if not len(part):
            other = "" if split == ALL else f", or take --split {ALL}"
            raise AminnError(f"the {text} is empty; {make} more grasps{other}")
        if not (part.samples["stable"] > 0).any():
            raise AminnError(
                f"none of the {len(part)} load cases of the {text} is stable, and figures are over stable ones; "
                f"{make} more grasps, or smaller loads"
            )
    return replace(compare(checkpoints, data, validation, split), notes=tuple(notes))


def _sensors_told(checkpoints: list[Checkpoint], data: Dataset) -> list[str]:
    """What there is to say of sensors: which are told, and of a model that does not see them."""
    told = [name for name in data.hand.dims.sensors if name in data.samples]
    if not told:
        return []
    blind = [f"{c.path} was trained without sensors, and sees none" for c in checkpoints if not c.model.config.sensors]
    shares = [f"{name} of {np.mean(data.samples[name][:, 0]):.0%}" for name in told]
    return [f"told of the load cases: {', '.join(shares)}", *blind]


def _leak(checkpoint: Checkpoint, data: Dataset, split: str) -> tuple[str, bool]:
    """What there is to say of a model's training grasps in a split of the data, and whether they may stand in it."""
    if same_configuration(checkpoint, data):
        return (f"{checkpoint.path} was trained on a part of these load cases", True) if split == ALL else ("", False)
    if "finetuned" in checkpoint.meta:
        return f"{checkpoint.path} went on from another run, whose training grasps may be among these", True
    learned_from_lab = checkpoint.meta.get("data", {}).get("simulator") == MEASURED
    if data.measured and not learned_from_lab:
        return f"{checkpoint.path} was trained on simulated data, so that no measured push is known to it", False
    if learned_from_lab and not data.measured:
        return f"{checkpoint.path} was trained on measured data, so that no simulated load case is known to it", False
    other = "other measured data" if data.measured else "data of another configuration or seed"
    return f"{checkpoint.path} was trained on {other}, of which grasps may be among these", True


def _hands_seen(dataset: Dataset, data: Dataset) -> list[str]:
    """What there is to say of simulated hands that both `data` and the training split have grasps of."""
    if dataset.measured or not dataset.has_theta:
        return []
    train, own = (
        {theta.tobytes() for theta in np.unique(part.samples["theta"], axis=0)}
        for part in (dataset.split("train"), data)
    )
    if not own & train:
        return []
    return [
        f"{len(own & train)} of its {len(own)} hands are hands of the training split too; for hands that no model was "
        "trained on, simulate with another seed"
    ]


def _without_training(checkpoints: list[Checkpoint], data: Dataset, trained_on: Dataset) -> tuple[Dataset, int]:
    """`data` without grasps that a model was trained or chosen on, and how many load cases those are."""
    seen = np.zeros(len(data), bool)
    for checkpoint in checkpoints:
        used = training_set(checkpoint, trained_on)
        for part in ("train", "validation"):
            seen |= np.isin(states_of(data), states_of(used.split(part)))
    return data.take(~seen), int(seen.sum())


def compare(checkpoints: list[Checkpoint], data: Dataset, validation: Dataset, name: str) -> Evaluation:
    """Figures on all samples of `data`; `validation` is where the analytical model takes its bound from."""
    predictions = [learned(c, data, name) for c, name in zip(checkpoints, names_of(checkpoints), strict=True)]
    predictions += baselines(data, validation)
    table = {p.name: figures_of(p, data) for p in predictions}
    return Evaluation(name, table, label_figures(data), {p.name: p for p in predictions}, data)


def figures_of(p: Prediction, data: Dataset) -> dict[str, float]:
    """Every figure of one model's predictions on `data`."""
    s = data.samples
    stable = s["stable"] > 0
    figures = all_figures(s["w_e"], s["dx_ht"], stable, p.dx, p.stable, data.hand.length_m)
    figures |= calibration_figures(p.p_stable, stable) if p.p_stable is not None else {}
    return figures | _stable_figures(p.take(stable), data.take(stable))


def _stable_figures(p: Prediction, held: Dataset) -> dict[str, float]:
    """What a threshold does not touch: figures over all truly stable cases, and those that need to know what slid."""
    true, length_m = held.samples["dx_ht"], held.hand.length_m
    error, size = pose_error(p.dx, true, length_m), pose_size(true, length_m)
    slid = None if held.measured else slid_cases(held)
    figures = refusal_figures(error, p.doubt(length_m))
    figures |= slide_figures(error, slid) if slid is not None else {}
    figures |= bound_figures(error, size, p.bound_95, slid) if p.bound_95 is not None else {}
    if p.p_slide is not None and slid is not None:
        figures |= {f"slide_{k}": v for k, v in calibration_figures(p.p_slide, slid).items()}
    return figures


def flat_report(evaluation: Evaluation) -> dict[str, float | str]:
    """The evaluation as flat keys, `<model>_<figure>` and `label_<figure>`; NaN where there is nothing to average.

    Raises AminnError where names of two runs are such that their keys are the same.
    """
    report: dict[str, float | str] = {"split": evaluation.split, "notes": "; ".join(evaluation.notes)}
    for name, figures in (*evaluation.table.items(), ("label", evaluation.labels)):
        for key, value in figures.items():
            whole = f"{flat_key(name)}_{key}"
            if whole in report:
                raise AminnError(f"two figures are both called {whole}; rename the folder of the run {name}")
            report[whole] = value
    return report


def truth(evaluation: Evaluation) -> dict[str, float]:
    """The ground truth's row of the table: its noise floor as error, and its own passivity."""
    labels = evaluation.labels
    return {
        "rmse_pose_all": labels.get("noise_floor_rmse_pose", np.nan),
        "relative_error_median_all": labels.get("noise_floor_relative_error_median", np.nan),
        "relative_error_p90_all": labels.get("noise_floor_relative_error_p90", np.nan),
        "passivity_violation_translational": labels["passivity_violation_translational"],
        "passivity_violation_full": labels["passivity_violation_full"],
    }


def format_table(evaluation: Evaluation) -> str:
    """The tables that the commands print: of all models, and of those that say how sure they are."""
    whole = _format_rows(COLUMNS, evaluation.table | {"ground truth": truth(evaluation)})
    sure = {name: figures for name, figures in evaluation.table.items() if "bound_coverage" in figures}
    return "\n".join([whole, *(["", _format_rows(SURE_COLUMNS, sure)] if sure else []), *evaluation.notes])


def _format_rows(columns: Mapping[str, Column], table: Mapping[str, Mapping[str, float]]) -> str:
    """Figures by model, a dash where there is no number."""
    rows = [["model", *(c.title for c in columns.values())], ["", *(c.unit for c in columns.values())]]
    for name, figures in table.items():
        found = {k: figures.get(k, np.nan) for k in columns}
        rows.append([name, *(c.form.format(found[k]) if np.isfinite(found[k]) else "-" for k, c in columns.items())])
    return format_columns(rows)


def align_columns(rows: list[list[str]]) -> list[str]:
    """Rows of cells as lines; the first column is flush left, the others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows]


def format_columns(rows: list[list[str]]) -> str:
    """Rows of cells, the first two of them headings, as text with a rule under the headings."""
    lines = align_columns(rows)
    return "\n".join([*lines[:2], "-" * len(lines[0]), *lines[2:]])


def training_grasps_in(dataset: Dataset, split: str) -> int:
    """Number of grasps of `split` that training has seen, by number or by state (q, x_ht)."""
    part, train = dataset.split(split), dataset.split("train")
    same_id = np.intersect1d(part.samples["grasp_id"], train.samples["grasp_id"])
    same_state = {s.tobytes() for s in states_of(part)} & {s.tobytes() for s in states_of(train)}
    return max(len(same_id), len(same_state))
