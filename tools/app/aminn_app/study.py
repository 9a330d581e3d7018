"""Studies over seeds on one data set: AMINN beside other models, with a learning curve (`make paper`), and choices of
the model and its training (`make ablation`), and how wide a model must be (`make frontier`).

Both learn from the same part of the data set (`REGIMES["iid"]`): known tool families, moderate friction and loads. The
rest is what nobody has seen: another family, more friction, larger loads. A run is trained on one thread, runs stand
side by side. Finished runs and their figures are kept, and the report is written again after each: a study that is cut
continues where it stopped, and what it has is a whole table of fewer seeds.

One model a seed is judged with each set of `INPUTS` that optional sensors tell.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from aminn.data.dataset import Dataset
from aminn.data.regimes import REGIMES, SELECTION, known, regimes
from aminn.data.sensors import PRESETS, sensed
from aminn.evaluation.analysis import NOISE_FACTORS, breakdown, compliance_figures, gate_figures, noise_figures
from aminn.evaluation.evaluate import baselines, figures_of, label_figures, learned
from aminn.evaluation.metrics import spread
from aminn.evaluation.paired import Resampled, compared, resampled
from aminn.model.checkpoint import Checkpoint
from aminn.model.config import SensorDraws, TrainConfig
from aminn.training.device import CPU, device_of
from aminn.training.train import LEAST_GRASPS, identity_of, train
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically, write_json
from aminn_base.program import Messages

from .paper_table import aims_report, read_study, write_tables
from .pipeline import anew_if_outdated
from .processes import data_of, side_by_side, workers_for
from .records import WHOLE, Facts, Parts, Row, Study, against, over_seeds

# To be raised with every change of the figures, so that those of kept runs are taken again.
FIGURES_VERSION = 4
WIDTHS = (
    (64, 64, 32, 32),
    (48, 48, 24, 24),
    (32, 32, 16, 16),
    (16, 32, 16, 16),
    (24, 24, 16, 16),
    (16, 24, 16, 16),
    (16, 16, 16, 16),
)
"""Of the trunks of stage 1 and stage 2, contacts and classifier: models of `make frontier`, widest first."""
WIDE = WIDTHS[0]


def _of_widths(config: TrainConfig, widths: tuple[int, int, int, int]) -> TrainConfig:
    stage1, stage2, contacts, classifier = widths
    model = replace(config.model, width=(stage1, stage2), contact_width=contacts, classifier_width=classifier)
    return replace(config, model=model)


BASE = TrainConfig()
BASELINE = _of_widths(replace(BASE, kind="mlp", weight_decay=0.0), WIDE)
"""The MLP with as many parameters as a cascade of the widest networks: narrower ones cost it accuracy. Without weight
decay: on validation grasps its RMSE is a sixth less so (`make ablation`)."""
VARIANTS = {
    "aminn": BASE,
    "paper_layer": replace(BASE, model=replace(BASE.model, friction="none")),
    "mlp": BASELINE,
    "mlp_norm": replace(BASELINE, loss=replace(BASE.loss, relative=1e9)),
}
"""Models of `make paper`: AMINN, the same with contacts that hold whatever they carry, as in the paper, and two MLPs.
The one that learns plain norms errs less in RMSE, and more at the typical motion."""
LEARNING = ("aminn", "mlp")
FRACTIONS = (0.1, 0.03, 0.3, 0.01)
"""Shares of the training grasps for the learning curve, in the order in which they are trained."""
PAIRS = (("aminn", "mlp"), ("aminn", "mlp_norm"), ("aminn", "paper_layer"), ("paper_layer", "mlp"))
"""Models that are compared grasp by grasp."""
INPUTS = {"": "nothing", "class_weight": "class+weight", "friction_weight": "friction+weight"}
"""What optional sensors tell the models in an evaluation: names of `sensors.PRESETS`."""
ABLATION_FRACTION = 0.3
By = dict[str, dict[str, Parts]]
"""Figures by test set and what was told."""


@dataclass(frozen=True)
class Job:
    """One run of a study."""

    variant: str
    config: TrainConfig

    @property
    def name(self) -> str:
        return f"{self.variant}-{100 * self.config.train_fraction:g}pc-{self.config.seed}"


@dataclass(frozen=True)
class Found:
    """What was found of a run: figures, and for whole training sets what a bootstrap over test grasps makes of them."""

    figures: By
    draws: dict[tuple[str, str], Resampled]
    """By test set and what was told."""


def _mechanics(**changes: Any) -> TrainConfig:
    return _model(mechanics=tuple(replace(stage, **changes) for stage in BASE.model.mechanics))


def _model(**changes: Any) -> TrainConfig:
    return replace(BASE, model=replace(BASE.model, **changes))


def _loss(**changes: float) -> TrainConfig:
    return replace(BASE, loss=replace(BASE.loss, **changes))


ABLATIONS: dict[str, TrainConfig] = {
    "shipped": BASE,
    "mlp": replace(BASELINE, weight_decay=BASE.weight_decay),
    "dq0_inverse": _mechanics(dq0="inverse"),
    "eps_m_1e-4": _mechanics(eps_m=1e-4, learn_eps_m=False),
    "eps_m_1e-5": _mechanics(eps_m=1e-5, learn_eps_m=False),
    "eps_m_1e-6": _mechanics(eps_m=1e-6, learn_eps_m=False),
    "eps_kx_1e-3": _mechanics(eps_kx=1e-3),
    "width_64": _of_widths(BASE, WIDE),
    "mlp_width_32": replace(BASE, kind="mlp", weight_decay=0.0),
    "heads_blind_to_wrench": _model(heads_see_wrench=False),
    "heads_free": _model(heads="free"),
    "soft_finger": _model(soft_finger=True),
    "friction_none": _model(friction="none"),
    "friction_none_no_sensors": _model(friction="none", sensors=False),
    "no_sensors": _model(sensors=False),
    "sensors_always": replace(BASE, sensing=SensorDraws(friction=1.0, weight=1.0, tension=1.0)),
    "sensors_exact": replace(BASE, sensing=SensorDraws(0.6, 0.0, 0.0, weight_noise_N=0.0, tension_noise=0.0)),
    "mlp_no_sensors": replace(BASELINE, model=replace(BASELINE.model, sensors=False)),
    "loss_norm": _loss(relative=1e9),
    "loss_square": _loss(relative=1e9, power=2.0),
    "no_engagement": _loss(engagement=0.0),
    "weight_decay_0.5": replace(BASE, weight_decay=0.5),
    "no_weight_decay": replace(BASE, weight_decay=0.0),
    "mlp_loss_norm": replace(BASELINE, loss=replace(BASE.loss, relative=1e9)),
    "mlp_no_weight_decay": BASELINE,
    "no_mirror": replace(BASE, mirror=False),
    "mlp_no_mirror": replace(BASELINE, mirror=False),
}
"""Choices that the method leaves open, each alone against what is shipped; the MLP gets those that concern it."""


FRONTIER = {"-".join(map(str, widths)): _of_widths(BASE, widths) for widths in WIDTHS}


def paper_jobs(seeds: int, curve_seeds: int) -> Iterator[Job]:
    """Seed by seed all models on the whole training set; then the learning curve, of fewer seeds.

    A small share gets more epochs, for enough steps.
    """
    for seed in range(seeds):
        for variant, config in VARIANTS.items():
            yield Job(variant, replace(config, seed=seed))
    for seed in range(min(seeds, curve_seeds)):
        for fraction in FRACTIONS:
            epochs = round(BASE.epochs / fraction**0.5)
            for variant in LEARNING:
                yield Job(variant, replace(VARIANTS[variant], seed=seed, train_fraction=fraction, epochs=epochs))


def ablation_jobs(seeds: int, _: int) -> Iterator[Job]:
    for seed in range(seeds):
        for variant, config in ABLATIONS.items():
            yield Job(variant, replace(config, seed=seed, train_fraction=ABLATION_FRACTION))


def frontier_jobs(seeds: int, _: int) -> Iterator[Job]:
    for seed in range(seeds):
        for variant, config in FRONTIER.items():
            yield Job(variant, replace(config, seed=seed))


JOBS: dict[str, Callable[[int, int], Iterator[Job]]] = {
    "paper": paper_jobs,
    "ablation": ablation_jobs,
    "frontier": frontier_jobs,
}


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


def _kept(file: Path, identity: dict) -> Found | None:
    """What an earlier call found of a run with this identity, if it is there whole."""
    draws = file.with_suffix(".npz")
    if not file.is_file() or not draws.is_file():
        return None
    found = json.loads(file.read_text())
    if found["identity"] != identity:
        return None
    by: dict[tuple[str, str], Resampled] = {}
    with np.load(draws) as arrays:
        for key, values in zip(arrays["keys"].tolist(), arrays["values"].astype(float), strict=True):
            test, inputs, figure = key.split("/")
            by.setdefault((test, inputs), {})[figure] = values
    return Found(found["figures"], by)


def _keep(file: Path, identity: dict, found: Found) -> None:
    """Write what was found; the file of figures, which says that all is there, comes last."""
    draws = {"/".join((*key, figure)): v for key, by in found.draws.items() for figure, v in by.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, keys=np.array(list(draws), "U"), values=np.array(list(draws.values()), "f4"))
    file.unlink(missing_ok=True)
    write_atomically(file.with_suffix(".npz"), buffer.getvalue())
    write_json(file, {"identity": identity, "figures": found.figures})


def judge(checkpoint: Checkpoint, tests: dict[str, Dataset], study: str) -> Found:
    """All figures of a run: on each test set with each of the inputs; with parts and under noise on new grasps."""
    whole = study == "paper" and checkpoint.meta["identity"]["config"]["train_fraction"] == 1.0
    several = whole or study in ("ablation", "frontier")
    figures: By = {}
    draws: dict[tuple[str, str], Resampled] = {}
    for test, data in tests.items():
        for inputs, preset in INPUTS.items():
            if inputs and not (several and checkpoint.model.config.sensors):
                continue
            told = sensed(data, PRESETS[preset])
            prediction = learned(checkpoint, told, checkpoint.model.kind)
            parts = {"": figures_of(prediction, told) | gate_figures(prediction, told)}
            if whole:
                draws[test, inputs] = resampled(prediction, told)
            if whole and test == "iid":
                parts[""] |= compliance_figures(prediction, told)
                parts |= breakdown(prediction, told) if not inputs else {}
                parts |= noise_figures(checkpoint, told, NOISE_FACTORS if not inputs else (1.0,))
            figures.setdefault(test, {})[inputs] = parts
    return Found(figures, draws)


def _run(study: str, job: Job, folder: Path, path: Path, position: int, device: str = CPU) -> Found:
    """Train one run and judge it, or read what an earlier call found."""
    data = data_of(path)
    part = known(data)
    identity = identity_of(job.config, part.sha256) | {"figures_version": FIGURES_VERSION, "inputs": INPUTS}
    file = folder / "figures" / f"{job.name}.json"
    kept = _kept(file, identity)
    if kept is not None:
        return kept
    out = folder / "runs" / job.name
    start = time.process_time()
    checkpoint = anew_if_outdated(out, lambda: train(job.config, part, out, bar_position=position, device=device))
    seconds = time.process_time() - start
    found = judge(checkpoint, _tests(data, study, job.config.train_fraction), study)
    found.figures["iid"][""][""] |= {"seconds": seconds, "n_parameters": checkpoint.meta["n_parameters"]}
    _keep(file, identity, found)
    return _kept(file, identity) or found


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


def summarise(study: str, done: dict[Job, Found], facts: Facts, still: list[Row]) -> Study:
    """The study so far: figures of every variant by test set and share of the training grasps, over seeds."""
    groups: dict[tuple[str, str, str, float], list[tuple[int, Parts]]] = {}
    for job, found in done.items():
        share = WHOLE if study == "ablation" else 100 * job.config.train_fraction
        for name, by_inputs in found.figures.items():
            for inputs, parts in by_inputs.items():
                groups.setdefault((name, job.variant, inputs, share), []).append((job.config.seed, parts))
    rows = [
        row
        for (name, variant, inputs, share), runs in groups.items()
        for row in over_seeds(name, variant, share, runs, inputs)
    ]
    seconds = sum(found.figures["iid"][""][""]["seconds"] for found in done.values())
    return Study(facts | {"seconds_of_training": seconds}, [*still, *rows, *comparisons(done)])


def comparisons(done: dict[Job, Found]) -> Iterator[Row]:
    """Each of `PAIRS` on each test set with the same inputs: over the seeds that both have, and seed by seed."""
    draws = {(job.variant, job.config.seed, *key): d for job, f in done.items() for key, d in f.draws.items()}
    for mine, other in PAIRS:
        for test, inputs in dict.fromkeys(key[2:] for key in draws if key[0] == mine):
            seeds = sorted(seed for name, seed, *key in draws if name == mine and key == [test, inputs])
            seeds = [seed for seed in seeds if (other, seed, test, inputs) in draws]
            chosen = {"": seeds} | {f"seed{seed}": [seed] for seed in seeds} if seeds else {}
            for part, some in chosen.items():
                a, b = ([draws[name, seed, test, inputs] for seed in some] for name in (mine, other))
                yield _compared(Row(test, against(mine, other), {}, part=part, inputs=inputs), a, b)


def _compared(row: Row, mine: list[Resampled], other: list[Resampled]) -> Row:
    """The row with one model's figures against another's, in runs of the same seeds."""
    found = {figure: compared(mine, other, figure) for figure in mine[0]}
    found = {figure: value for figure, value in found.items() if np.isfinite(value).all()}
    pairs = list(zip(mine, other, strict=True))
    each = {figure: [compared([a], [b], figure).value for a, b in pairs] for figure in found}
    return replace(
        row,
        mean={figure: value.value for figure, value in found.items()},
        sd={} if row.part else {figure: spread(values) for figure, values in each.items()},
        seeds=0 if row.part else len(pairs),
        interval={figure: (value.low, value.high) for figure, value in found.items()},
    )


def _enough(data: Dataset, fraction: float) -> bool:
    """Whether a share of the training grasps is enough to train on; small data sets have a shorter learning curve."""
    return len(np.unique(data.split("train", fraction).samples["grasp_id"])) >= LEAST_GRASPS["train"]


@click.command(cls=Messages)
@click.argument("study", type=click.Choice(list(JOBS)))
@click.option("--data", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Runs of each variant.")
@click.option(
    "--curve-seeds", type=click.IntRange(0), default=5, show_default=True, help="The same of the learning curve."
)
@click.option("--jobs", type=click.IntRange(1), default=None, help="Runs side by side.  [default: all cores]")
@click.option("--device", default=CPU, show_default=True, help="Where they train: cpu, cuda or cuda:N, shared by all.")
def main(study: str, data: Path, build: Path, seeds: int, curve_seeds: int, jobs: int | None, device: str) -> None:
    """Run a study and write its figures to build/reports/STUDY.json, its tables to STUDY.md."""
    device_of(device)  # refused before any work
    folder, reports = build / "studies" / study, build / "reports"
    planned = JOBS[study](seeds, curve_seeds)
    waiting = [job for job in planned if _enough(known(data_of(data)), job.config.train_fraction)]
    facts, still = (_facts(data_of(data)), _still(data_of(data))) if study == "paper" else ({}, [])
    workers = workers_for(len(waiting), jobs)
    done: dict[Job, Found] = {}
    calls = {job: (study, job, folder, data, k % workers, device) for k, job in enumerate(waiting)}
    with closing(side_by_side(_run, calls, workers)) as ended:
        for job, of_run in ended:
            done[job] = of_run
            runs: Facts = {"runs": len(done), "runs_planned": len(waiting)}
            found = summarise(study, done, facts | runs, still)
            write_json(folder / "rows.json", found.as_json())
            write_json(reports / f"{study}.json", found.flat() | (aims_report(found) if study == "paper" else {}))
            write_tables(study, found, reports)
    text = write_tables(study, read_study(folder), reports)
    click.echo(f"\n{text}\nfigures: {reports / f'{study}.json'}")


if __name__ == "__main__":
    main()
