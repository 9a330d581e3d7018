"""Figures of trained models on a split, beside the analytical model, no motion and the labels themselves."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from aminn_base.errors import AminnError

from .checkpoint import Checkpoint
from .config import ModelConfig
from .dataset import Dataset
from .metrics import (
    COLUMNS,
    all_figures,
    calibration_figures,
    choose_tau,
    displacement_figures,
    f1_score,
    pose_error,
    pose_size,
    violation_rate,
)
from .model import Backbone, scaled_pose
from .nominal import nominal_from_hand
from .predict import predict

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """One model's outputs on a split."""

    name: str
    dx: Array  # (n, 6)
    stable: NDArray[np.bool_]  # (n,)
    p_stable: Array | None = None  # (n,), of models that give a probability
    gate: Array | None = None  # (n, 3), of AMINN


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


def names_of(checkpoints: list[Checkpoint]) -> list[str]:
    """A row's name for each: its kind, or its folder where a kind stands more than once."""
    kinds = [c.model.kind for c in checkpoints]
    names = [kind if kinds.count(kind) == 1 else c.path.name for kind, c in zip(kinds, checkpoints, strict=True)]
    if len(set(names)) < len(names):
        raise AminnError(
            f"two runs are both called {max(names, key=names.count)!r}; give runs in folders of other names"
        )
    return names


def check_hand(checkpoint: Checkpoint, data: Dataset) -> None:
    """Raises AminnError if the data are of another hand than the model."""
    mine, other = asdict(checkpoint.model.nominal), asdict(nominal_from_hand(data.manifest["hand"]))
    wrong = [name for name, value in mine.items() if not np.allclose(value, other[name], rtol=1e-5, atol=1e-9)]
    if wrong:
        raise AminnError(
            f"{checkpoint.path}: trained for another hand than that of the data set (they differ in "
            f"{', '.join(wrong)}); give data of its own hand"
        )


def learned(checkpoint: Checkpoint, data: Dataset, name: str) -> Prediction:
    """A trained cascade at its own tau."""
    out = predict(checkpoint.model, data)
    stable = out["p_stable"].astype(np.float32) >= np.float32(checkpoint.meta["tau"])
    return Prediction(name, out["dx_ht"], stable, out["p_stable"], out.get("gate"))


def analytical(data: Dataset, validation: Dataset, config: ModelConfig | None = None) -> Prediction:
    """Nominal springs, tendons taut, nothing learned.

    Calls a grasp stable when the predicted motion is below a bound chosen on validation data by the same rule as tau.
    """
    config = config or ModelConfig()
    backbone = Backbone(config, config.mechanics[1], nominal_from_hand(data.manifest["hand"]))

    def motion(part: Dataset) -> tuple[Array, Array]:
        with torch.no_grad():
            dx = backbone.nominal_response(part.inputs()).dx
        return dx.double().numpy(), -scaled_pose(dx).norm(dim=1).double().numpy()

    dx_v, score_v = motion(validation)
    error_v = pose_error(dx_v, validation.samples["dx_ht"])
    bound = choose_tau(score_v, validation.samples["stable"] > 0, error_v)
    dx, score = motion(data)
    return Prediction("analytical", dx, score >= bound)


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
        "motion_rms": float(np.sqrt(np.mean(pose_size(s["dx_ht"][stable]) ** 2))),
        "motion_median_mm": 1e3 * float(np.median(np.linalg.norm(s["dx_ht"][stable][:, :3], axis=1))),
        "passivity_violation_translational": violation_rate(s["w_e"], s["dx_ht"], stable, False),
        "passivity_violation_full": violation_rate(s["w_e"], s["dx_ht"], stable, True),
    }
    return figures | noise_floor(data)


def noise_floor(data: Dataset) -> dict[str, float]:
    """How far the labels agree with themselves: half the time step, and (`impratio_`) another impedance ratio.

    Errors are over the cases that hold both times, `flipped` is the share of those that hold once.
    """
    s, figures = data.samples, {}
    again = np.flatnonzero(s["noise_row"] >= 0)
    rows = s["noise_row"][again]
    for setting, prefix in (("half_step", "noise_floor_"), ("impratio", "noise_floor_impratio_")):
        held = data.noise[f"stable_{setting}"][rows] > 0
        both = held & (s["stable"][again] > 0)
        errors = displacement_figures(data.noise[f"dx_{setting}"][rows][both], s["dx_ht"][again][both])
        kept = ("rmse_pose", "relative_error_median", "relative_error_p90")
        figures |= {prefix + name: errors[name] for name in kept}
        figures[prefix + "n"] = int(both.sum())
        flips = held != (s["stable"][again] > 0)
        figures[prefix + "flipped"] = float(flips.mean()) if len(flips) else float("nan")
        figures[prefix + "f1"] = f1_score(held, s["stable"][again] > 0)
    return figures


def evaluate(checkpoints: list[Checkpoint], dataset: Dataset, split: str = "test") -> Evaluation:
    """Figures on one split of `dataset`.

    Raises AminnError if a checkpoint was trained on data of another configuration. More grasps of the same one are
    welcome: they do not move between splits.
    """
    for checkpoint in checkpoints:
        check_hand(checkpoint, dataset)
        if checkpoint.meta["data_config_sha256"] != dataset.manifest["config_sha256"]:
            raise AminnError(
                f"{checkpoint.path}: trained on another data set (configuration "
                f"{checkpoint.meta['data_config_sha256'][:12]}, this one is {dataset.manifest['config_sha256'][:12]}); "
                "its training grasps may stand in this split"
            )
    data = dataset.split(split)
    if not len(data):
        raise AminnError(f"the {split} split is empty; simulate more grasps")
    return compare(checkpoints, data, dataset.split("validation"), split)


def compare(checkpoints: list[Checkpoint], data: Dataset, validation: Dataset, name: str) -> Evaluation:
    """Figures on all samples of `data`; `validation` is where the analytical model takes its bound from."""
    predictions = [learned(c, data, name) for c, name in zip(checkpoints, names_of(checkpoints), strict=True)]
    predictions += [analytical(data, validation), no_motion(data)]
    table = {p.name: figures_of(p, data) for p in predictions}
    return Evaluation(name, table, label_figures(data), {p.name: p for p in predictions}, data)


def figures_of(p: Prediction, data: Dataset) -> dict[str, float]:
    """Every figure of one model's predictions on `data`."""
    s = data.samples
    stable = s["stable"] > 0
    figures = all_figures(s["w_e"], s["dx_ht"], stable, p.dx, p.stable)
    return figures | (calibration_figures(p.p_stable, stable) if p.p_stable is not None else {})


def flat_report(evaluation: Evaluation) -> dict[str, float | str]:
    """The evaluation as flat keys, `<model>_<figure>` and `label_<figure>`; NaN where there is nothing to average."""
    report: dict[str, float | str] = {"split": evaluation.split}
    for name, figures in (*evaluation.table.items(), ("label", evaluation.labels)):
        report |= {f"{name}_{key}": value for key, value in figures.items()}
    return report


def truth(evaluation: Evaluation) -> dict[str, float]:
    """The ground truth's row of the table: its noise floor as error, and its own passivity."""
    labels = evaluation.labels
    return {
        "rmse_pose": labels["noise_floor_rmse_pose"],
        "relative_error_median": labels["noise_floor_relative_error_median"],
        "passivity_violation_translational": labels["passivity_violation_translational"],
        "passivity_violation_full": labels["passivity_violation_full"],
    }


def format_table(evaluation: Evaluation) -> str:
    """The table that the commands print."""
    rows = [["model", *(c.title for c in COLUMNS.values())], ["", *(c.unit for c in COLUMNS.values())]]
    for name, figures in evaluation.table.items():
        rows.append([name, *(c.form.format(figures[key]) for key, c in COLUMNS.items())])
    own = truth(evaluation)
    cells = (c.form.format(own[key]) if key in own else "-" for key, c in COLUMNS.items())
    rows.append(["ground truth", *cells])
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

    def seen(name: str) -> tuple[set[int], set[bytes]]:
        s = dataset.split(name).samples
        return set(s["grasp_id"].tolist()), {row.tobytes() for row in np.hstack([s["q"], s["x_ht"]])}

    (ids, states), (train_ids, train_states) = seen(split), seen("train")
    return max(len(ids & train_ids), len(states & train_states))
