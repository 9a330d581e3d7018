"""Studies over seeds: AMINN beside the baseline, also off the training distribution (`make paper`), and choices of the
mechanics (`make ablation`).

A study trains each of its variants with each seed, on one thread a run, and reports mean and spread over the seeds.
Finished data sets and runs are kept: an interrupted study goes on where it stopped.
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np

from .checkpoint import write_json
from .cli import Messages
from .dataset import Dataset, load_dataset
from .evaluate import compare, format_columns, label_figures
from .mechanics import MechanicsConfig
from .metrics import COLUMNS
from .pipeline import anew_if_outdated, run_simulation
from .train import TrainConfig, train

Figures = dict[str, float]
BASE = TrainConfig()

# Grasps and settings of each data set: the first is trained on and tested on its own test grasps, the others are tests.
DATA: dict[str, tuple[int, dict]] = {
    "iid": (1000, {"families": ("handle", "block")}),
    "new_family": (120, {"families": ("ball",)}),
    "new_friction": (120, {"families": ("handle", "block"), "friction_min": 1.0, "friction_max": 1.4}),
    "larger_loads": (
        120,
        {"families": ("handle", "block"), "force_max_N": 26.0, "moment_max_Nm": 0.5, "load_decades": 0.5},
    ),
}
CASES = 16


def _mechanics(**changes: float | str) -> TrainConfig:
    both = (MechanicsConfig(**changes),) * 2
    return replace(BASE, model=replace(BASE.model, mechanics=both))


STUDIES: dict[str, dict[str, TrainConfig]] = {
    "paper": {"aminn": BASE, "mlp": replace(BASE, kind="mlp")},
    "ablation": {
        "shipped": BASE,
        "dq0_inverse": _mechanics(dq0="inverse"),
        "eps_m_1e-4": _mechanics(eps_m=1e-4),
        "eps_m_1e-6": _mechanics(eps_m=1e-6),
        "absolute_loss": replace(BASE, loss=replace(BASE.loss, relative=1e9)),
        "no_weight_decay": replace(BASE, weight_decay=0.0),
    },
}
"""Study -> variant -> configuration; the seed is filled in."""
SPLITS = {"paper": "test", "ablation": "validation"}
"""Which grasps of the first data set a study is judged on: a choice is never made on test grasps."""


def _simulate(folder: Path, names: list[str], seed: int) -> dict[str, Dataset]:
    for k, name in enumerate(names):
        grasps, settings = DATA[name]
        out = folder / "data" / name
        anew_if_outdated(out, partial(run_simulation, out, grasps, CASES, seed + k, **settings))
    return {name: load_dataset(folder / "data" / name) for name in names}


def _run(
    variant: str, config: TrainConfig, folder: Path, names: list[str], split: str, position: int
) -> dict[str, dict[str, Figures]]:
    """Train one run and test it: data set -> row of the table -> figures."""
    data = {name: load_dataset(folder / "data" / name) for name in names}
    out = folder / "runs" / f"{variant}-{config.seed}"
    checkpoint = anew_if_outdated(out, lambda: train(config, data["iid"], out, bar_position=position))
    validation = data["iid"].split("validation")
    results = {}
    for name, dataset in data.items():
        part = dataset.split(split) if name == "iid" else dataset
        table = compare([checkpoint], part, validation, name).table
        results[name] = {
            variant: table[config.kind],
            "analytical": table["analytical"],
            "no_motion": table["no_motion"],
        }
    return results


def _gather(runs: list[dict[str, dict[str, Figures]]], name: str) -> dict[str, dict[str, list[float]]]:
    """Row -> figure -> values over the runs, for data set `name`."""
    rows: dict[str, dict[str, list[float]]] = {}
    for run in runs:
        for row, figures in run[name].items():
            for key, value in figures.items():
                rows.setdefault(row, {}).setdefault(key, []).append(value)
    return rows


def spread(values: list[float]) -> float:
    """Standard deviation of a sample; 0 for a single value."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _format(rows: dict[str, dict[str, list[float]]]) -> str:
    cells = [
        ["mean ± standard", *(c.title for c in COLUMNS.values())],
        ["deviation", *(c.unit for c in COLUMNS.values())],
    ]
    for row, figures in rows.items():
        values = (
            c.form.format(np.mean(figures[k])) + " ± " + c.form.format(spread(figures[k])) for k, c in COLUMNS.items()
        )
        cells.append([row, *values])
    return format_columns(cells)


@click.command(cls=Messages)
@click.argument("study", type=click.Choice(list(STUDIES)))
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Runs of each variant.")
def main(study: str, build: Path, seeds: int) -> None:
    """Run a study and write its figures to build/reports/STUDY.json."""
    folder, names = build / "studies", list(DATA) if study == "paper" else ["iid"]
    data = _simulate(folder, names, seed=100)
    jobs = [
        (variant, replace(config, seed=seed)) for variant, config in STUDIES[study].items() for seed in range(seeds)
    ]
    workers = min(len(jobs), len(os.sched_getaffinity(0)))
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = [pool.submit(_run, v, c, folder, names, SPLITS[study], k % workers) for k, (v, c) in enumerate(jobs)]
        runs = [job.result() for job in waiting]
    report: dict[str, float | int | str] = {
        "seeds": seeds,
        "iid_split": SPLITS[study],
        **{f"{n}_n_samples": len(d) for n, d in data.items()},
    }
    for name in names:
        part = data[name].split(SPLITS[study]) if name == "iid" else data[name]
        report |= {f"{name}_label_{key}": value for key, value in label_figures(part).items()}
        rows = _gather(runs, name)
        click.echo(f"\n{name}\n{_format(rows)}")
        for row, figures in rows.items():
            for key, values in figures.items():
                report |= {
                    f"{name}_{row}_{key}_mean": float(np.mean(values)),
                    f"{name}_{row}_{key}_sd": spread(values),
                }
    write_json(build / "reports" / f"{study}.json", report)
    click.echo(f"\nfigures: {build / 'reports' / f'{study}.json'}")


if __name__ == "__main__":
    main()
