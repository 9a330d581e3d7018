"""Kill a training run at random steps, go on each time, and compare what comes out with an undisturbed run.

    resume.py --kills 20 --report build/reports/resume.json

The process ends itself with SIGKILL after a drawn number of optimiser steps, so that nothing of Python's can tidy up.
A run that is finished is compared byte by byte, and a new one is begun until all kills are spent.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import shutil
import signal
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

from synthetic import write_dataset

from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import META, WEIGHTS
from aminn.model.config import ModelConfig, TrainConfig
from aminn.training import train as train_module
from aminn_base.files import write_json

GRASPS, CASES = 60, 8
CONFIG = TrainConfig(epochs=6, batch=32, model=ModelConfig(sensors=True))
"""With sensors, which are drawn anew at each step."""


def _run(data: Path, out: Path, kind: str, kill_after: int | None) -> None:
    """Train, or go on with, a run; end without a word after `kill_after` steps."""
    step, done = train_module._Loop._step, 0

    def counted(self, x: dict, y: object) -> float:
        nonlocal done
        done += 1
        if done == kill_after:
            os.kill(os.getpid(), signal.SIGKILL)
        return step(self, x, y)

    train_module._Loop._step = counted
    train_module.train(replace(CONFIG, kind=kind), load_dataset(data), out)


@dataclass
class Resume:
    """A run that is killed again and again in `scratch`. Raises AssertionError where a kill did harm."""

    scratch: Path
    kind: str
    seed: int
    figures: dict[str, int] = field(default_factory=lambda: {"kills": 0, "finished_runs": 0, "steps_of_a_run": 0})

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.context = multiprocessing.get_context("forkserver")
        self.context.set_forkserver_preload(["aminn.training.train"])
        self.data, self.whole, self.killed = (self.scratch / name for name in ("data", "whole", "killed"))
        write_dataset(self.data, GRASPS, CASES)
        assert self.start(self.whole, None) == 0
        parts = load_dataset(self.data).split("train")
        steps = [-(-n // CONFIG.batch) for n in (len(parts), int(parts.samples["stable"].sum()))]
        self.figures["steps_of_a_run"] = CONFIG.epochs * sum(steps)

    def start(self, out: Path, kill_after: int | None) -> int:
        """Exit status of a run in a process of its own."""
        process = self.context.Process(target=_run, args=(self.data, out, self.kind, kill_after))
        process.start()
        process.join()
        return process.exitcode

    def kill(self) -> None:
        """Go on with the run until a random step; a run that gets to its end before is compared."""
        status = self.start(self.killed, self.random.randint(1, self.figures["steps_of_a_run"] // 2))
        if status == -signal.SIGKILL:
            self.figures["kills"] += 1
        else:
            assert status == 0, status
            self.compare()

    def compare(self) -> None:
        """The finished run against the undisturbed one; a new one may begin."""
        for name in (WEIGHTS, META):
            assert (self.killed / name).read_bytes() == (self.whole / name).read_bytes(), name
        shutil.rmtree(self.killed)
        self.figures["finished_runs"] += 1

    def finish(self) -> dict[str, int]:
        """Let the last run end, compare it, return the figures."""
        if self.killed.exists():
            assert self.start(self.killed, None) == 0
            self.compare()
        return self.figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--report", type=Path, required=True)
    args = parser.parse_args()
    report: dict[str, int] = {}
    for kind in ("aminn", "mlp"):
        with tempfile.TemporaryDirectory() as scratch:
            resume = Resume(Path(scratch), kind, seed=0)
            while resume.figures["kills"] < args.kills:
                resume.kill()
            report |= {f"{kind}_{name}": value for name, value in resume.finish().items()}
    write_json(args.report, report | {"identical": 1})
    print(f"{args.kills} kills of each model, the same bytes each time. Report: {args.report}")


if __name__ == "__main__":
    main()
