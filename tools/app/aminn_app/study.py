"""Studies over seeds on one data set: AMINN beside the baseline with a learning curve (`make paper`), and choices of
the model and its training (`make ablation`).

Both learn from the same part of the data set (`REGIMES["iid"]`): known tool families, moderate friction and loads. The
rest is what nobody has seen: another family, more friction, larger loads. A run is trained on one thread, runs stand
side by side. Finished runs and their figures are kept, and the report is written anew after each: a study that is cut
goes on where it stopped, and what it has is a whole table of fewer seeds.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.regimes import REGIMES, SELECTION, known, regimes, told
from aminn.evaluation.analysis import breakdown, compliance_figures, gate_figures, noise_figures
from aminn.evaluation.evaluate import baselines, figures_of, label_figures, learned
from aminn.model.checkpoint import Checkpoint
from aminn.model.config import TrainConfig
from aminn.training.train import LEAST_GRASPS, identity_of, train
from aminn_base.errors import AminnError
from aminn_base.files import write_json
from aminn_base.program import Messages

from .paper_table import read_study, write_tables
from .pipeline import anew_if_outdated
from .records import WHOLE, Facts, Parts, Row, Study, over_seeds

# To be raised with every change of the figures, so that those of kept runs are taken again.
FIGURES_VERSION = 4
BASE = TrainConfig()
BASELINE = replace(BASE, kind="mlp", weight_decay=0.0)
"""The MLP without weight decay: on validation grasps its RMSE is a sixth less so, AMINN's is not (`make ablation`)."""
FRACTIONS = (1.0, 0.1, 0.03, 0.3, 0.01)
"""Shares of the training grasps, in the order in which they are trained."""
ABLATION_FRACTION = 0.3


@dataclass(frozen=True)
class Job:
    """One run of a study."""

    variant: str
    config: TrainConfig
    secret: str = ""
    """What `told` adds to the inputs."""

    @property
    def name(self) -> str:
        return f"{self.variant}-{100 * self.config.train_fraction:g}pc-{self.config.seed}"


def _mechanics(**changes: Any) -> TrainConfig:
    return _model(mechanics=tuple(replace(stage, **changes) for stage in BASE.model.mechanics))


def _model(**changes: Any) -> TrainConfig:
    return replace(BASE, model=replace(BASE.model, **changes))


def _loss(**changes: float) -> TrainConfig:
    return replace(BASE, loss=replace(BASE.loss, **changes))


ABLATIONS: dict[str, TrainConfig] = {
    "shipped": BASE,
    "mlp": replace(BASE, kind="mlp"),
    "dq0_inverse": _mechanics(dq0="inverse"),
    "eps_m_1e-4": _mechanics(eps_m=1e-4, learn_eps_m=False),
    "eps_m_1e-5": _mechanics(eps_m=1e-5, learn_eps_m=False),
    "eps_m_1e-6": _mechanics(eps_m=1e-6, learn_eps_m=False),
    "eps_kx_1e-3": _mechanics(eps_kx=1e-3),
    "width_32": _model(width=32, contact_width=16),
    "width_128": _model(width=128, contact_width=64),
    "mlp_width_128": replace(_model(width=128, contact_width=64), kind="mlp"),
    "heads_blind_to_wrench": _model(heads_see_wrench=False),
    "heads_free": _model(heads="free"),
    "soft_finger": _model(soft_finger=True),
    "slip": _model(slip=True),
    "loss_norm": _loss(relative=1e9),
    "loss_square": _loss(relative=1e9, power=2.0),
    "no_engagement": _loss(engagement=0.0),
    "no_weight_decay": replace(BASE, weight_decay=0.0),
    "mlp_loss_norm": replace(_loss(relative=1e9), kind="mlp"),
    "mlp_no_weight_decay": BASELINE,
    "no_mirror": replace(BASE, mirror=False),
    "mlp_no_mirror": replace(BASELINE, mirror=False),
}
"""Choices that the method leaves open, each alone against what is shipped; the MLP gets those that concern it."""


def paper_jobs(seeds: int) -> Iterator[Job]:
    """Seed by seed, each time the whole training set first; a small share gets more epochs, for enough steps."""
    for seed in range(seeds):
        for fraction in FRACTIONS:
            epochs = round(BASE.epochs / fraction**0.5)
            for config in (BASE, BASELINE):
                yield Job(config.kind, replace(config, seed=seed, train_fraction=fraction, epochs=epochs))


def ablation_jobs(seeds: int) -> Iterator[Job]:
    for seed in range(seeds):
        for variant, config in ABLATIONS.items():
            yield Job(variant, replace(config, seed=seed, train_fraction=ABLATION_FRACTION))
        for secret in ("friction", "pretension"):
            for kind in ("aminn", "mlp"):
                config = replace(BASE, kind=kind, seed=seed, train_fraction=ABLATION_FRACTION)
                yield Job(f"{kind}_told_{secret}", config, secret)


JOBS = {"paper": paper_jobs, "ablation": ablation_jobs}


@cache
def _data(path: Path) -> Dataset:
    return load_dataset(path)


def _tests(data: Dataset, study: str, fraction: float) -> dict[str, Dataset]:
    """Where a run is judged. The one place that reads test grasps, and for `paper` alone."""
    if study != "paper":
        return {"iid": known(data).split("validation")}
    names = REGIMES if fraction == 1.0 else REGIMES[:1]
    tests = {name: data.where(mask, name).split("test") for name, mask in regimes(data).items() if name in names}
    empty = [name for name, test in tests.items() if not (test.samples["stable"] > 0).any()]
    if empty:
        raise AminnError(f"no stable test case of {', '.join(empty)}: the data set is too small, simulate more grasps")
    return tests


def figures_on(checkpoint: Checkpoint, name: str, data: Dataset, deep: bool) -> Parts:
    """All figures of a run on one test set; `deep`: with its parts and under noise."""
    prediction = learned(checkpoint, data, name)
    whole = figures_of(prediction, data) | gate_figures(prediction, data)
    if not deep:
        return {"": whole}
    whole |= compliance_figures(prediction, data)
    return {"": whole} | breakdown(prediction, data) | noise_figures(checkpoint, data)


def _run(study: str, job: Job, folder: Path, path: Path, position: int) -> dict[str, Parts]:
    """Train one run and judge it, or read what an earlier call found: test set -> figures."""
    data = _data(path)
    part = told(known(data), job.secret)
    identity = identity_of(job.config, part.sha256) | {"figures_version": FIGURES_VERSION}
    kept = folder / "figures" / f"{job.name}.json"
    if kept.is_file():
        found = json.loads(kept.read_text())
        if found["identity"] == identity:
            return found["figures"]
    out = folder / "runs" / job.name
    start = time.process_time()
    checkpoint = anew_if_outdated(out, lambda: train(job.config, part, out, bar_position=position))
    seconds = time.process_time() - start
    tests = {k: told(v, job.secret) for k, v in _tests(data, study, job.config.train_fraction).items()}
    deep = study == "paper" and job.config.train_fraction == 1.0
    figures = {name: figures_on(checkpoint, name, test, deep and name == "iid") for name, test in tests.items()}
    figures["iid"][""] |= {"seconds": seconds, "n_parameters": checkpoint.meta["n_parameters"]}
    write_json(kept, {"identity": identity, "figures": figures})
    return json.loads(kept.read_text())["figures"]


def _facts(data: Dataset) -> Facts:
    """Size of the data set and of its training part."""
    train_part = known(data).split("train")
    n_grasps = len(np.unique(train_part.samples["grasp_id"]))
    return {
        "trained_on": SELECTION,
        "train_n_samples": len(train_part),
        "train_n_grasps": n_grasps,
        "dataset_n_samples": len(data),
    }


def _still(data: Dataset) -> list[Row]:
    """What no seed changes: labels of the test sets, the analytical model and no motion on them."""
    rows, validation = [], known(data).split("validation")
    for name, test in _tests(data, "paper", 1.0).items():
        rows.append(Row(name, "label", label_figures(test)))
        for prediction in baselines(test, validation):
            rows.append(Row(name, prediction.name, figures_of(prediction, test)))
    return rows


def summarise(study: str, done: dict[Job, dict[str, Parts]], facts: Facts, still: list[Row]) -> Study:
    """The study so far: figures of every variant by test set and share of the training grasps, over seeds."""
    groups: dict[tuple[str, str, float], list[tuple[int, Parts]]] = {}
    for job, tests in done.items():
        share = WHOLE if study == "ablation" else 100 * job.config.train_fraction
        for name, parts in tests.items():
            groups.setdefault((name, job.variant, share), []).append((job.config.seed, parts))
    rows = [row for (name, variant, share), runs in groups.items() for row in over_seeds(name, variant, share, runs)]
    seconds = sum(tests["iid"][""]["seconds"] for tests in done.values())
    return Study(facts | {"seconds_of_training": seconds}, [*still, *rows])


def _enough(data: Dataset, fraction: float) -> bool:
    """Whether a share of the training grasps is enough to train on; small data sets have a shorter learning curve."""
    return len(np.unique(data.split("train", fraction).samples["grasp_id"])) >= LEAST_GRASPS["train"]


@click.command(cls=Messages)
@click.argument("study", type=click.Choice(list(JOBS)))
@click.option("--data", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Runs of each variant.")
@click.option("--jobs", type=click.IntRange(1), default=None, help="Runs side by side.  [default: all cores]")
def main(study: str, data: Path, build: Path, seeds: int, jobs: int | None) -> None:
    """Run a study and write its figures to build/reports/STUDY.json, its tables to STUDY.md."""
    folder, reports = build / "studies" / study, build / "reports"
    waiting = [job for job in JOBS[study](seeds) if _enough(known(_data(data)), job.config.train_fraction)]
    facts, still = (_facts(_data(data)), _still(_data(data))) if study == "paper" else ({}, [])
    workers = min(len(waiting), jobs or len(os.sched_getaffinity(0)))
    done: dict[Job, dict[str, Parts]] = {}
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(_run, study, job, folder, data, k % workers): job for k, job in enumerate(waiting)}
        for future in as_completed(futures):
            done[futures[future]] = future.result()
            runs: Facts = {"runs": len(done), "runs_planned": len(waiting)}
            found = summarise(study, done, facts | runs, still)
            write_json(folder / "rows.json", found.as_json())
            write_json(reports / f"{study}.json", found.flat())
    text = write_tables(study, read_study(folder), reports)
    click.echo(f"\n{text}\nfigures: {reports / f'{study}.json'}")


if __name__ == "__main__":
    main()
