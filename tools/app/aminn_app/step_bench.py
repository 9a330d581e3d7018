"""Time of one training step, AMINN beside the MLP, at the batch size at which the two are compared (`make step`).

A step is what training does: pick the samples, forward, backward, clip, AdamW. Both models take turns on one thread.
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
from aminn.training.train import _Loop, _select, _stages, mirror_of, model_config
from aminn_base.files import write_json
from aminn_base.program import Messages

BATCH, ROUNDS, STEPS = 1024, 15, 10


def _loops(kind: Kind, data: Dataset) -> list[_Loop]:
    """Both stages of a model, each with its optimiser."""
    config = TrainConfig(kind=kind, batch=BATCH, epochs=1000)
    torch.manual_seed(config.seed)
    model = build_model(kind, model_config(config.model, data), data.hand)
    stages = _stages(model, config, data, data)
    mirror = mirror_of(config, data.hand)
    return [_Loop(stage, replace(config), mirror) for stage in stages]


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
    """Time a training step of both models and write the figures."""
    torch.set_num_threads(1)
    dataset = load_dataset(data).split("train")
    loops = {kind: _loops(kind, dataset) for kind in ("aminn", "mlp")}
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
    report["ratio"] = both["aminn"] / both["mlp"]
    write_json(json_file, report)
    click.echo(
        f"AMINN {both['aminn']:.1f} ms, MLP {both['mlp']:.1f} ms for a step of both stages at batch {BATCH}: "
        f"{report['ratio']:.2f} times as long\nfigures: {json_file}"
    )


if __name__ == "__main__":
    main()
