"""What is disturbed: commands of `aminn` on small inputs, the folder before, and what a reader makes of it after."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from click.testing import CliRunner
from forks import forked
from lab import made_up
from synthetic import write_dataset

from aminn.calibration.store import read_calibration
from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import META, build_model, load_checkpoint, save_checkpoint
from aminn.model.config import ModelConfig, TrainConfig
from aminn.prediction.engines import open_engine
from aminn.training.train import identity_of
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_rt.model import model_file
from aminn_table import write_table

SIMULATE = "simulate --grasps {} --cases 2 --shard-grasps 2 --threads 1 --seed 7 --set noise_share=0.3 --out {}"


@dataclass(frozen=True)
class Said:
    """How a command ended."""

    code: int
    text: str

    @property
    def is_clear(self) -> bool:
        """Whether it did its work, or said in one line why not."""
        lines = [line for line in self.text.splitlines() if line.startswith("Error: ")]
        return self.code == 0 or (self.code == 1 and len(lines) == 1 and "fault of AMINN" not in self.text)


def call(line: str) -> Said:
    """Run a command of `aminn` in this process."""
    torch.set_num_threads(1)
    with contextlib.redirect_stderr(io.StringIO()):
        result = CliRunner().invoke(main, line.split())
    return Said(result.exit_code, result.output)


@dataclass(frozen=True)
class Scenario:
    """A command, what it is disturbed in, and how what it leaves is read."""

    name: str
    command: str
    """`{top}` is the folder that is watched, `{given}` that of the inputs."""
    reads: Callable[[Path], object]
    """Use what is in the folder as the next command would. Raises AminnError where it cannot be used."""
    before: str = ""
    """A command that has run there before."""


def _data(top: Path) -> object:
    return load_dataset(top / "data").sha256


def _run(top: Path) -> object:
    return load_checkpoint(top / "run").sha256


def _export(top: Path) -> object:
    """The files that belong together: all of one model."""
    model = model_file(top / "out")
    open_engine(top / "out")
    return sorted((f.name, f.read_bytes().hex()) for f in model.parent.iterdir() if not f.name.startswith("."))


def _calibration(top: Path) -> object:
    """Both files: of one fit."""
    header = top / "theta.h"
    if not header.is_file():
        raise AminnError(f"{header}: is missing")
    theta = read_calibration(top / "theta.json", load_checkpoint(top.parent / "given" / "told").model.hand)
    return [header.read_text(), theta.tolist()]


TRAIN = "train --data {given}/data --epochs 2 --no-tensorboard --set batch=64 --out {top}/run"
EXPORT = "export --data {given}/data --out {top}/out --run {given}/"
CALIBRATE = "calibrate --as-told --out {top}/theta.json --run {given}/told --data {given}/"
SCENARIOS = (
    Scenario("simulate", SIMULATE.format(4, "{top}/data"), _data),
    Scenario("simulate_more", SIMULATE.format(6, "{top}/data"), _data, before=SIMULATE.format(4, "{top}/data")),
    Scenario("train", TRAIN, _run),
    Scenario("export", EXPORT + "run", _export),
    Scenario("export_again", EXPORT + "run", _export, before=EXPORT + "other"),
    Scenario("calibrate", CALIBRATE + "pushes", _calibration),
    Scenario("calibrate_again", CALIBRATE + "pushes", _calibration, before=CALIBRATE + "more"),
    Scenario("import", "import {given}/pushes.csv --like {given}/data --out {top}/data", _data),
)


def prepare(given: Path) -> None:
    """The inputs of all commands."""
    assert forked(lambda: _prepare(given), 300).status == 0


def _prepare(given: Path) -> None:
    given.mkdir(parents=True)
    write_dataset(given / "data", grasps=24, cases=4)
    write_dataset(given / "pushes", grasps=3, cases=4, seed=1, vary=0.3)
    write_dataset(given / "more", grasps=4, cases=3, seed=2, vary=0.3)
    data = load_dataset(given / "data")
    write_table(given / "pushes.csv", data.hand, made_up(data.hand))
    identity = identity_of(TrainConfig(), data.sha256)
    for seed, (name, told) in enumerate({"run": False, "other": False, "told": True}.items()):
        torch.manual_seed(seed)
        model = build_model("aminn", ModelConfig(told=told), data.hand)
        config = data.manifest["config_sha256"]
        save_checkpoint(
            given / name, model, {"tau": 0.5, "identity": identity, "data_config_sha256": config, "data": {}}
        )
        assert (given / name / META).is_file()
