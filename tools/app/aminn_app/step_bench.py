"""Time of one training step, AMINN beside the MLP, at the batch size at which the two are compared (`make step`).

A step is what training does: pick the samples, forward, backward, clip, AdamW. The models take turns on one thread:
AMINN, the MLP, and AMINN on data whose mechanics parameters vary (`told`).
The figure is the median over rounds of a round's processor time, so that other programs disturb it little.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import torch

from aminn.data.dataset import Dataset, load_dataset
from aminn.model.checkpoint import build_model
from aminn.model.config import Kind, TrainConfig
from aminn.training.train import _Loop, _select, _stages, as_seen, mirror_of, model_config
from aminn_base.files import write_json
from aminn_base.program import Messages
from aminn_hand.theta import Theta

BATCH, ROUNDS, STEPS = 1024, 15, 10


def _loops(kind: Kind, data: Dataset) -> list[_Loop]:
    """Both stages of a model, each with its optimiser."""
    config = TrainConfig(kind=kind, batch=BATCH, epochs=1000)
    torch.manual_seed(config.seed)
    model = build_model(kind, model_config(config.model, data), data.hand)
    seen = as_seen(data, model.config)
    stages = _stages(model, config, seen, seen)
    mirror = mirror_of(config, data.hand)
    return [_Loop(stage, replace(config), mirror) for stage in stages]


def _untold(data: Dataset) -> Dataset:
    """The data without mechanics parameters."""
    return replace(data, samples={name: values for name, values in data.samples.items() if name != "theta"})


def _told(data: Dataset) -> Dataset:
    """The data with mechanics parameters that are drawn, for what a step takes does not depend on which they are."""
    theta = np.random.default_rng(0).uniform(-0.5, 0.5, (len(data), len(Theta(data.hand))))
    return replace(data, samples=data.samples | {"theta": theta})


def _seconds(loop: _Loop) -> float:
    """Processor time of a step, mean of `STEPS`."""
    x, y = loop.stage.train
    index = [torch.randint(len(y), (BATCH,)) for _ in range(STEPS)]
    start = time.process_time()
    for i in index:
        loop._step(_select(x, i), y[i])
    return (time.process_time() - start) / STEPS


@click.command(cls=Messages)
@click.option("--data", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(data: Path, json_file: Path) -> None:
    """Time a training step of AMINN, the MLP and a told AMINN, and write the figures."""
    torch.set_num_threads(1)
    dataset = load_dataset(data).split("train")
    plain = _untold(dataset)
    loops = {"aminn": _loops("aminn", plain), "mlp": _loops("mlp", plain), "told": _loops("aminn", _told(dataset))}
    times: dict[str, list[float]] = {f"{kind}_stage{k}": [] for kind in loops for k in (1, 2)}
    for _ in range(ROUNDS):
        for kind, stages in loops.items():
            for k, loop in enumerate(stages, start=1):
                times[f"{kind}_stage{k}"].append(_seconds(loop))
    report: dict[str, float | int] = {"batch": BATCH, "threads": 1}
    report |= {f"{name}_step_ms": 1e3 * float(np.median(values)) for name, values in times.items()}
    for k in (1, 2):
        report[f"stage{k}_ratio"] = report[f"aminn_stage{k}_step_ms"] / report[f"mlp_stage{k}_step_ms"]
    both = {kind: sum(report[f"{kind}_stage{k}_step_ms"] for k in (1, 2)) for kind in loops}
    report["ratio"], report["told_ratio"] = both["aminn"] / both["mlp"], both["told"] / both["aminn"]
    write_json(json_file, report)
    click.echo(
        f"AMINN {both['aminn']:.1f} ms, MLP {both['mlp']:.1f} ms for a step of both stages at batch {BATCH}: "
        f"{report['ratio']:.2f} times as long; told, AMINN takes {report['told_ratio']:.2f} times as long\n"
        f"figures: {json_file}"
    )


if __name__ == "__main__":
    main()
