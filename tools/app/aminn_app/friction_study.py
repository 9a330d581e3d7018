"""What a controller gains that learns friction on the way: build/reports/friction.json (`make friction`).

Each load of a test grasp is judged after pushes, which are other loads of that grasp that held: from how far each moved
the tool the learner of `aminn_calibrate_push()` narrows the coefficient, and the model is told it for the load that
follows, beside the same model told nothing, the class of friction, or friction itself. The weight is known or not.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch
from numpy.typing import NDArray

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.sensors import Told, sensed
from aminn.data.slides import slid_cases
from aminn.evaluation.metrics import auroc, f1_score, holds, pose_error, rms
from aminn.evaluation.predict import CHUNK
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.model.network import Aminn
from aminn_base.errors import AminnError
from aminn_base.files import write_json
from aminn_base.program import Messages
from aminn_export.samples.friction import (
    GRID,
    NOTHING,
    USUAL,
    Evidence,
    Slips,
    Statics,
    combined,
    evidence,
    learned,
    likelihood,
)
from aminn_hand.sensors import FRICTION

Array = NDArray[np.float64]
Figures = dict[str, Any]
Mask = NDArray[np.bool_]
PUSHES = 10
KNOWN = {"blind": Told(), "weight": Told(weight=True)}
"""What the model knows besides friction."""
TOLD = {"nothing": None, "learned": None, "class": Told("class"), "exact": Told("value")}
"""What it is told of friction."""


@dataclass(frozen=True)
class Series:
    """Loads that are judged (n), and for each its pushes: the first of a kind among the grasp's other loads."""

    judged: NDArray[np.int64]  # (n) samples
    pushes: NDArray[np.int64]  # (n, count) samples


def series(data: Dataset, kind: Mask, count: int) -> Series:
    """Of every load whose grasp has `count` others of a kind (n). They come in turn, from the next one on."""
    ids, judged, pushes = data.samples["grasp_id"], [], []
    order = np.argsort(ids, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        for k in range(len(rows)):
            others = np.roll(rows, -k)[1:]
            others = others[kind[others]][:count]
            if len(others) == count:
                judged.append(rows[k])
                pushes.append(others)
    return Series(np.array(judged, int), np.array(pushes, int).reshape(-1, count))


SERIES: dict[str, tuple[int, Callable[[Mask, Mask], Mask]]] = {
    "stuck": (PUSHES, lambda stable, slid: stable & ~slid),
    "slid": (1, lambda stable, slid: stable & slid),
    "held": (PUSHES, lambda stable, slid: stable),
}
"""How many pushes, and of which loads: that held without a slide, that held after a slide, that held."""


def many_series(data: Dataset) -> dict[str, Series]:
    """All of `SERIES`."""
    stable, slid = data.samples["stable"] > 0, slid_cases(data)
    return {name: series(data, kind(stable, slid), count) for name, (count, kind) in SERIES.items()}


def _joined(parts: Iterable[dict[str, torch.Tensor]]) -> dict[str, Array]:
    parts = list(parts)
    return {name: torch.cat([p[name] for p in parts]).double().numpy() for name in parts[0]}


def learns(checkpoint: Checkpoint) -> bool:
    """Whether friction can be learned with a model: its contacts slide, and its networks see sensors."""
    config = checkpoint.model.config
    return isinstance(checkpoint.model, Aminn) and config.friction == "secant" and bool(config.sensors)


class Learner:
    """Follows pushes of many grasps side by side."""

    def __init__(self, checkpoint: Checkpoint, data: Dataset, slips: Slips = USUAL) -> None:
        model = checkpoint.model
        if not (isinstance(model, Aminn) and learns(checkpoint)):
            raise AminnError(
                f"{checkpoint.path}: contacts of this model do not slide, or it sees no sensors; train it again"
            )
        self.model, self.data, self.slips = model, data, slips
        self.samples = data.samples
        self.inputs = {name: value.float() for name, value in data.inputs().items()}
        self.inputs.pop(FRICTION, None)
        back = model.stage2.backbone
        softer = np.ones((1, model.hand.dims.branches))
        if data.has_theta:
            softer = np.exp(data.samples["theta"][:, back.contacts])
        self.softer = np.broadcast_to(softer * np.array(back.eps_m), (len(data), softer.shape[1]))

    def _told(self, rows: NDArray[np.int64], friction: Array | None) -> Iterator[dict[str, torch.Tensor]]:
        """Inputs of samples (n) that are told friction (n, 3), some at a time."""
        x = {name: value[rows] for name, value in self.inputs.items()}
        if friction is not None:
            x[FRICTION] = torch.as_tensor(friction).float()
        yield from ({k: v[i : i + CHUNK] for k, v in x.items()} for i in range(0, max(len(rows), 1), CHUNK))

    def run(self, rows: NDArray[np.int64], friction: Array | None) -> dict[str, Array]:
        """Outputs of the model for samples (n), told friction (n, 3)."""
        with torch.no_grad():
            return _joined(self.model(**x) for x in self._told(rows, friction))

    def _stage(self, x: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """What stage 2 says of contacts before any slides, by names of `Dims.debug`."""
        back = self.model.stage2.backbone
        f = back.features(x if back.config.heads_see_wrench else x | {"w_e": 0 * x["w_e"]})
        y = back.head(f)
        springs, extras = back.springs_from_head(y, x.get("theta")), back.extras(f, y, x)
        found = {"gate": back.respond(springs, x, extras).gate, "preload": extras.preload, "twist": extras.twist}
        return springs._asdict() | {name: value for name, value in found.items() if value is not None}

    def evidence(self, rows: NDArray[np.int64], friction: Array) -> Evidence:
        """What the measured motions of samples (n) say, friction (n, 3) told."""
        with torch.no_grad():
            stage = _joined(self._stage(x) for x in self._told(rows, friction))
        config, length_m = self.model.config, self.model.hand.length_m
        softer = self.softer[rows]
        twist = stage.get("twist", 0 * softer)
        statics = Statics(softer, config.mechanics[1].eps_kx, twist, length_m, config.motion_limits)
        x = {name: value[rows].double().numpy() for name, value in self.inputs.items()}
        return evidence(stage, x, self.samples["dx_ht"][rows], statics)

    def learn(self, pushes: NDArray[np.int64]) -> Iterator[Array]:
        """Likelihoods (g, 16) before the pushes (g, count), and after each of them."""
        found = np.broadcast_to(NOTHING, (len(pushes), len(NOTHING)))
        yield found
        for rows in pushes.T:
            found = learned(found, self.evidence(rows, combined(found)), self.slips)
            yield found


def judged(data: Dataset, out: dict[str, Array], rows: NDArray[np.int64], tau: float) -> Figures:
    """Of load cases (n): whether they hold, and the pose errors of those that do."""
    stable, slid = data.samples["stable"][rows] > 0, slid_cases(data)[rows]
    error = pose_error(out["dx_ht"], data.samples["dx_ht"][rows], data.hand.length_m)
    return {
        "f1": f1_score(holds(out["p_stable"], tau), stable),
        "auroc": auroc(out["p_stable"], stable),
        "rmse_all": rms(error[stable]),
        "rmse_slid": rms(error[stable & slid]),
        "rmse_stuck": rms(error[stable & ~slid]),
        "p_slide_auroc": auroc(out["p_slide"][stable], slid[stable]) if "p_slide" in out else float("nan"),
    }


def friction_figures(checkpoint: Checkpoint, data: Dataset, slips: Slips = USUAL) -> Figures:
    """The flat report of the grasps of a data set: `friction_<weight or blind>_<pushes>_<told>_<figure>`."""
    tau, all_series = float(checkpoint.meta["tau"]), many_series(data)
    figures: Figures = {}
    true = sensed(data, Told("value")).samples[FRICTION][:, 1]
    for known, other in KNOWN.items():
        learner = Learner(checkpoint, sensed(data, other), slips)
        for name, s in all_series.items():
            if not len(s.judged):
                continue
            start = f"friction_{known}_{name}"
            *_, found = learner.learn(s.pushes)
            belief, truth = combined(found), true[s.judged]
            mean, sd = (found * GRID).sum(1) / found.sum(1), 0.0
            sd = np.sqrt((found * (GRID - mean[:, None]) ** 2).sum(1) / found.sum(1))
            figures |= {
                f"{start}_grasps": len(np.unique(data.samples["grasp_id"][s.judged])),
                f"{start}_loads": len(s.judged),
                f"{start}_error": rms(mean - truth),
                f"{start}_error_before": rms(GRID.mean() - truth),
                f"{start}_deviation": rms(sd),
            }
            for told, how in TOLD.items():
                values = belief if told == "learned" else None
                if how is not None:
                    values = sensed(data, how).samples[FRICTION][s.judged]
                found_figures = judged(data, learner.run(s.judged, values), s.judged, tau)
                figures |= {f"{start}_{told}_{key}": value for key, value in found_figures.items()}
    return figures


CHOICES: dict[str, tuple[float, ...]] = {
    "sharpness": (8, 16, 32),
    "guessed": (4, 8, 16),
    "motion_m": (0.25e-3, 0.35e-3, 0.5e-3, 0.7e-3),
    "motion_share": (0.07, 0.1, 0.14, 0.2, 0.28),
    "least_odds": (0.003, 0.01, 0.03, 0.1),
    "most_odds": (100.0, 1000.0, 10000.0),
}


def gain(before: Array, truth: Array) -> float:
    """What likelihoods (g, 16) add to the mean logarithm of the density of the true coefficients (g)."""
    density = before / before.mean(1, keepdims=True)
    place = np.clip((truth - GRID[0]) / (GRID[1] - GRID[0]), 0, len(GRID) - 1)
    low = np.minimum(place.astype(int), len(GRID) - 2)
    below, above = (np.take_along_axis(density, low[:, None] + k, 1)[:, 0] for k in (0, 1))
    return float(np.log(below + (place - low) * (above - below)).mean())


def chosen(checkpoint: Checkpoint, data: Dataset, slips: Slips = USUAL) -> tuple[Slips, Figures]:
    """The constants, one after another, that explain the coefficients of grasps best, and what each gives."""
    parts, true = [], sensed(data, Told("value")).samples[FRICTION][:, 1]
    for other in KNOWN.values():
        learner = Learner(checkpoint, sensed(data, other))
        for s in filter(lambda s: len(s.judged), many_series(data).values()):
            rows = s.pushes.ravel()
            seen = learner.evidence(rows, np.zeros((len(rows), 3)))
            parts.append((Evidence(*(v.reshape(s.pushes.shape) for v in seen)), true[s.judged]))

    def value(candidate: Slips) -> float:
        total = 0.0
        for seen, truth in parts:
            found = np.prod(likelihood(seen, candidate), axis=1)
            total += gain(np.maximum(found / found.max(1, keepdims=True), 1e-6), truth)
        return total / len(parts)

    tried: Figures = {}
    for _ in range(2):
        for name, values in CHOICES.items():
            found = {v: value(replace(slips, **{name: v})) for v in values}
            tried |= {f"gain_{name}_{v:g}": g for v, g in found.items()}
            slips = replace(slips, **{name: max(found, key=lambda v: found[v])})
    return slips, tried


@click.command(cls=Messages)
@click.option(
    "--run", "runs", type=click.Path(path_type=Path), required=True, help="Folder of a trained model with sensors."
)
@click.option("--data", type=click.Path(path_type=Path), default=Path("build/dataset"), show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("build/reports/friction.json"), show_default=True)
@click.option("--choose", is_flag=True, help="Choose the learner's constants on validation grasps instead.")
def main(runs: Path, data: Path, out: Path, choose: bool) -> None:
    """Let friction be learned from loads of test grasps, and judge the loads that follow."""
    torch.set_num_threads(1)
    checkpoint, whole = load_checkpoint(runs), load_dataset(data)
    if choose:
        slips, tried = chosen(checkpoint, whole.split("validation"))
        for name, value in tried.items():
            click.echo(f"{name}: {value:.4f}")
        click.echo(str(slips))
        return
    figures = friction_figures(checkpoint, whole.split("test"))
    write_json(out, figures)
    for known, name in itertools.product(KNOWN, SERIES):
        start = f"friction_{known}_{name}"
        for told in TOLD:
            f = {k: figures[f"{start}_{told}_{k}"] for k in ("f1", "auroc", "rmse_all", "rmse_slid")}
            click.echo(f"{known:7} {name:6} {told:8} " + " ".join(f"{k} {v:.4f}" for k, v in f.items()))
    click.echo(f"figures: {out}")


if __name__ == "__main__":
    main()
