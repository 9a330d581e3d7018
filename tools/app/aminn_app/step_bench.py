"""Time of one training step, AMINN beside the MLP, at the batch size that they are trained with (`make step`).

A step is what training does: pick the samples, draw what sensors tell, forward, backward, clip, AdamW. The models take
turns on one thread: AMINN, AMINN with the paper's layer (no contact slides), the MLP, and AMINN on data whose mechanics
parameters vary (`told`). The figure is the lower decile over steps of their processor time, which other programs
disturb least.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import torch

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.sensors import draw
from aminn.model.checkpoint import build_model
from aminn.model.config import ModelConfig, TrainConfig
from aminn.training.train import _Loop, _select, _stages, as_seen, mirror_of, model_config
from aminn_base.files import write_json
from aminn_base.program import Messages
from aminn_hand.theta import Theta

ROUNDS, STEPS = 15, 10
AMINN, MLP = TrainConfig(epochs=1000), TrainConfig(kind="mlp", epochs=1000)
PAPER_LAYER = replace(AMINN, model=ModelConfig(friction="none"))


def _loops(config: TrainConfig, data: Dataset) -> list[_Loop]:
    """Both stages of a model, each with its optimiser."""
    torch.manual_seed(config.seed)
    model = build_model(config.kind, model_config(config.model, data), data.hand)
    seen = as_seen(data, model.config)
    stages = _stages(model, config, seen, seen)
    mirror = mirror_of(config, data.hand)
    return [_Loop(stage, config, mirror) for stage in stages]


def _untold(data: Dataset) -> Dataset:
    """The data without mechanics parameters."""
    return replace(data, samples={name: values for name, values in data.samples.items() if name != "theta"})


def _told(data: Dataset) -> Dataset:
    """The data with mechanics parameters that are drawn, for what a step takes does not depend on which they are."""
    theta = np.random.default_rng(0).uniform(-0.5, 0.5, (len(data), len(Theta(data.hand))))
    return replace(data, samples=data.samples | {"theta": theta})


def _seconds(loop: _Loop) -> list[float]:
    """Processor times of `STEPS` steps."""
    (x, y), config, found = loop.samples, loop.config, []
    for index in torch.randint(len(y), (STEPS, config.batch)):
        start = time.process_time()
        loop._step(draw(_select(x, index), config.sensing, loop.rng), y[index])
        found.append(time.process_time() - start)
    return found


@click.command(cls=Messages)
@click.option("--data", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(data: Path, json_file: Path) -> None:
    """Time a training step of AMINN, of its paper's layer, of the MLP and of a told AMINN, and write the figures."""
    torch.set_num_threads(1)
    dataset = load_dataset(data).split("train")
    plain = _untold(dataset)
    loops = {"aminn": _loops(AMINN, plain), "paper_layer": _loops(PAPER_LAYER, plain), "mlp": _loops(MLP, plain)}
    loops["told"] = _loops(AMINN, _told(dataset))
    times: dict[str, list[float]] = {f"{kind}_stage{k}": [] for kind in loops for k in (1, 2)}
    for _ in range(ROUNDS):
        for kind, stages in loops.items():
            for k, loop in enumerate(stages, start=1):
                times[f"{kind}_stage{k}"] += _seconds(loop)
    report: dict[str, float | int] = {"batch": AMINN.batch, "threads": 1}
    report |= {f"{name}_step_ms": 1e3 * float(np.quantile(values, 0.1)) for name, values in times.items()}
    for k in (1, 2):
        report[f"stage{k}_ratio"] = report[f"aminn_stage{k}_step_ms"] / report[f"mlp_stage{k}_step_ms"]
    both = {kind: sum(report[f"{kind}_stage{k}_step_ms"] for k in (1, 2)) for kind in loops}
    report |= {"ratio": both["aminn"] / both["mlp"], "paper_layer_ratio": both["paper_layer"] / both["mlp"]}
    report["told_ratio"] = both["told"] / both["aminn"]
    write_json(json_file, report)
    each = ", ".join(f"{name.replace('_', ' ')} {value:.1f} ms" for name, value in both.items())
    ratios = {"AMINN": "ratio", "with the paper's layer": "paper_layer_ratio"}
    said = ", ".join(f"{name} {report[key]:.2f} times" for name, key in ratios.items())
    click.echo(
        f"A step of both stages at batch {AMINN.batch}: {each}\n{said} as long as the MLP; told, "
        f"{report['told_ratio']:.2f} times as long as untold\nfigures: {json_file}"
    )


if __name__ == "__main__":
    main()
