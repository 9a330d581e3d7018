"""The whole path on one machine: simulate, train, compare, export, compile, replay, report (`make demo`).

Every stage is the real one at a modest scale, and each is skipped when its result is there already: an interrupted demo
goes on where it stopped.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TypeVar

import click

from aminn.data.dataset import Dataset, load_dataset
from aminn.evaluation.evaluate import Evaluation, evaluate, flat_report, format_table, training_grasps_in
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.model.config import Kind
from aminn.training.train import TrainConfig, train
from aminn_base.files import write_json
from aminn_base.program import Messages

from .pipeline import anew_if_outdated, run_export, run_report, run_verify
from .simulation import run_simulation

GRASPS, CASES, SEED = 960, 16, 0
KINDS: tuple[Kind, ...] = ("aminn", "mlp")
T = TypeVar("T")


class _Stopwatch:
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


def _simulate(data: Path, grasps: int, cases: int) -> Dataset:
    anew_if_outdated(data, lambda: run_simulation(data, grasps, cases, SEED))
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


def _figures(dataset: Dataset, result: Evaluation, checkpoints: list[Checkpoint]) -> dict:
    """What the demo states about data, splits and models."""
    stable = dataset.samples["stable"] > 0
    return flat_report(result) | {
        "n_grasps": int(dataset.manifest["n_grasps"]),
        "n_samples": len(dataset),
        "stable_share": float(stable.mean()),
        "grasps_in_train_and_test": training_grasps_in(dataset, result.split),
        **{f"{c.model.kind}_n_parameters": c.meta["n_parameters"] for c in checkpoints},
        **{f"{c.model.kind}_tau": c.meta["tau"] for c in checkpoints},
    }


@click.command(cls=Messages)
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--grasps", type=click.IntRange(1), default=GRASPS, show_default=True)
@click.option("--cases", type=click.IntRange(1), default=CASES, show_default=True)
def main(build: Path, grasps: int, cases: int) -> None:
    """Run the whole path and end with the table, the runtime's differences and the place of the report page."""
    folder, reports, watch = build / "demo", build / "reports", _Stopwatch()
    data, exported = folder / "data", folder / "export"
    title = f"Simulate {grasps} grasps under {cases} loads each"
    dataset = watch.run("simulate", title, lambda: _simulate(data, grasps, cases), data)
    checkpoints = watch.run(
        "train", "Train AMINN and the MLP baseline", lambda: _train_both(data, folder), folder / "aminn"
    )
    result = watch.run("evaluate", "Evaluate on the test grasps", lambda: evaluate(checkpoints, dataset))
    watch.run("export", "Export to ONNX and C", lambda: run_export(folder / "aminn", data, exported))
    title = "Replay through ONNX Runtime, the compiled runtime and the emulated Cortex-M7"
    differences: list[str] = []
    host = build / "host"
    replay = watch.run(
        "verify", title, lambda: run_verify(exported, data, host, firmware=True, echo=differences.append).report
    )
    page = reports / "demo.html"
    watch.run("report", "Write the report page", lambda: run_report(result, checkpoints, replay, page, reports))
    report = _figures(dataset, result, checkpoints) | replay | watch.seconds
    write_json(reports / "demo.json", report)
    click.echo(f"\n{format_table(result)}\n")
    click.echo("\n".join([*differences, ""]))
    click.echo(f"figures: {reports / 'demo.json'}\nreport page: {page}")
    if not replay["ok"]:
        raise click.ClickException("the runtime does not repeat ONNX Runtime; the differences stand above")


if __name__ == "__main__":
    main()
