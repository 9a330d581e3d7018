"""The whole path for one hand: simulate, train AMINN and the MLP, compare, export, compile, replay.

Every stage is skipped where its result is there already: what was interrupted continues where it stopped.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click

from aminn.data.dataset import Dataset, load_dataset
from aminn.evaluation.evaluate import Evaluation, evaluate, flat_report, training_grasps_in
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.model.config import Kind, TrainConfig
from aminn.training.train import train

from .pipeline import anew_if_outdated, run_export, run_verify
from .simulation import run_simulation

SEED = 0
KINDS: tuple[Kind, ...] = ("aminn", "mlp")
T = TypeVar("T")


class Stopwatch:
    """Announces stages and keeps their durations; a stage that found its result there has none."""

    def __init__(self) -> None:
        self.seconds: dict[str, float | None] = {}

    def run(self, name: str, title: str, work: Callable[[], T], result: Path | None = None) -> T:
        """Do `work`. `result` is what it makes: where that is there already, only part of the work is done."""
        click.secho(f"\n== {title}", bold=True)
        before, start = result is not None and result.exists(), time.monotonic()
        done = work()
        self.seconds[f"seconds_{name}"] = None if before else round(time.monotonic() - start, 1)
        return done


@dataclass(frozen=True)
class Outcome:
    """What the path gave."""

    data: Path
    """Folder of the data set."""
    dataset: Dataset
    checkpoints: list[Checkpoint]
    """AMINN and the MLP."""
    result: Evaluation
    """On the test grasps."""
    replay: dict[str, Any]
    """Flat figures of the replay, as `aminn verify` reports them; "ok"."""
    lines: list[str]
    """The same for people."""

    def figures(self) -> dict[str, Any]:
        """Flat figures of data, splits, models and replay."""
        stable = self.dataset.samples["stable"] > 0
        return flat_report(self.result) | {
            "n_grasps": int(self.dataset.manifest["n_grasps"]),
            "n_samples": len(self.dataset),
            "stable_share": float(stable.mean()),
            "grasps_in_train_and_test": training_grasps_in(self.dataset, self.result.split),
            **{f"{c.model.kind}_n_parameters": c.meta["n_parameters"] for c in self.checkpoints},
            **{f"{c.model.kind}_tau": c.meta["tau"] for c in self.checkpoints},
            **self.replay,
        }


def whole_path(
    folder: Path, grasps: int, cases: int, host: Path, watch: Stopwatch, hand: Path | None = None
) -> Outcome:
    """Go the path in `folder` for the hand of a hand file (default: the built-in one).

    `host` is where the runtime's host tools are built.
    """
    data, exported = folder / "data", folder / "export"
    title = f"Simulate {grasps} grasps under {cases} loads each"
    dataset = watch.run("simulate", title, lambda: _simulate(data, grasps, cases, hand), data)
    title = "Train AMINN and the MLP baseline"
    checkpoints = watch.run("train", title, lambda: _train_both(data, folder), folder / "aminn")
    result = watch.run("evaluate", "Evaluate on the test grasps", lambda: evaluate(checkpoints, dataset))
    watch.run("export", "Export to ONNX and C", lambda: run_export(folder / "aminn", data, exported))
    title = "Replay through ONNX Runtime, the compiled runtime and the emulated Cortex-M7"
    lines: list[str] = []
    replay = watch.run(
        "verify", title, lambda: run_verify(exported, data, host, firmware=True, echo=lines.append).report
    )
    return Outcome(data, dataset, checkpoints, result, replay, lines)


def _simulate(data: Path, grasps: int, cases: int, hand: Path | None) -> Dataset:
    anew_if_outdated(data, lambda: run_simulation(data, grasps, cases, SEED, hand=hand))
    return load_dataset(data)


def _train_one(kind: Kind, data: Path, out: Path, position: int) -> None:
    dataset = load_dataset(data)
    anew_if_outdated(out, lambda: train(TrainConfig(kind=kind, seed=SEED), dataset, out, bar_position=position))


def _train_both(data: Path, folder: Path) -> list[Checkpoint]:
    """AMINN and the baseline side by side, each in a process of its own and on one thread."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(len(KINDS), mp_context=context) as pool:
        jobs = [pool.submit(_train_one, kind, data, folder / kind, k) for k, kind in enumerate(KINDS)]
        for job in jobs:
            job.result()
    return [load_checkpoint(folder / kind) for kind in KINDS]
