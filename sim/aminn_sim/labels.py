"""`make labels`: what labels cost on this build of the engine, on the system's, and in an earlier version.

The same shards, simulated in turns. Flat figures `labels_*` in build/reports/labels.json.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from aminn_base.errors import AminnError
from aminn_base.files import check_outputs, write_json
from aminn_base.program import Messages

from . import _core
from .build import simulator_build
from .errors import SimulationError

# A process of its own: a library is loaded once. Start and compiling of the model are not in the times.
_RUN = """
import hashlib, json, sys, time
from aminn_sim import SimulationConfig, simulate
out, grasps, cases, seed, threads = sys.argv[1], *map(int, sys.argv[2:])
start, cpu = time.monotonic(), time.process_time()
simulate(SimulationConfig(grasps=grasps, cases=cases, seed=seed), out, threads, progress=False)
seconds = {"wall_s": time.monotonic() - start, "cpu_s": time.process_time() - cpu}
library = next(line.split()[-1] for line in open("/proc/self/maps") if "libmujoco.so.2.2.2" in line)
print(json.dumps(seconds | {"library_sha256": hashlib.sha256(open(library, "rb").read()).hexdigest()}))
"""


def system_library() -> Path | None:
    """The system's library of the engine's version, where there is one and it is not the one that simulates here."""
    here = Path(_core.MUJOCO_LIBRARY).resolve()
    code = "import ctypes, sys; ctypes.CDLL(sys.argv[1]); print([line.split()[-1] for line in open('/proc/self/maps')"
    code += " if line.rstrip().endswith(sys.argv[1])][0])"
    found = subprocess.run([sys.executable, "-c", code, here.name], capture_output=True, text=True, check=False)
    path = Path(found.stdout.strip())
    return path if found.returncode == 0 and path.resolve() != here else None


@dataclass(frozen=True)
class Run:
    """What one simulation took, and what it gave."""

    wall_s: float
    cpu_s: float
    library_sha256: str
    shards_sha256: str


class Variant:
    """One way of simulating: a Python that has the project, and the library that its engine is loaded from."""

    def __init__(self, python: Path | str, library: Path | None = None) -> None:
        self.python, self.library = python, library

    def run(self, grasps: int, cases: int, seed: int, threads: int) -> Run:
        """Simulate a data set in a folder that is then dropped. Raises SimulationError where that fails."""
        environment = dict(os.environ)
        if self.library:  # the module names the folder of its own library, which comes after these
            environment["LD_LIBRARY_PATH"] = str(self.library.parent)
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(
                [str(self.python), "-c", _RUN, folder, *map(str, (grasps, cases, seed, threads))],
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
                raise SimulationError(f"{self.python}: cannot simulate ({said[-1]})")
            content = b"".join(path.read_bytes() for path in sorted(Path(folder).glob("*.h5")))
        return Run(**json.loads(done.stdout), shards_sha256=hashlib.sha256(content).hexdigest())


def compare(
    variants: dict[str, Variant], grasps: int, cases: int, seed: int, threads: int, rounds: int
) -> dict[str, float | int | bool | str]:
    """Figures of each variant beside `here`, taken in turns: medians of the times, and of their ratios by round."""
    runs: dict[str, list[Run]] = {name: [] for name in variants}
    for _ in range(rounds):
        for name, variant in variants.items():
            runs[name].append(variant.run(grasps, cases, seed, threads))
    figures: dict[str, float | int | bool | str] = {}
    for name, taken in runs.items():
        figures[f"labels_{name}_library_sha256"] = taken[0].library_sha256
        for kind in ("wall", "cpu"):
            seconds = {key: [getattr(run, f"{kind}_s") for run in runs[key]] for key in ("here", name)}
            figures[f"labels_{name}_{kind}_s"] = float(np.median(seconds[name]))
            if name != "here":
                figures[f"labels_{kind}_to_{name}"] = float(np.median(np.divide(seconds["here"], seconds[name])))
        if name != "here":
            figures[f"labels_same_bits_as_{name}"] = len({run.shards_sha256 for run in runs["here"] + taken}) == 1
    return figures


@click.command(cls=Messages)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Report to write (JSON).")
@click.option("--before", type=click.Path(path_type=Path, exists=True), help="Python of an earlier version, set up.")
@click.option("--grasps", type=click.IntRange(1), default=64, show_default=True)
@click.option("--cases", type=click.IntRange(1), default=16, show_default=True, help="Load cases a grasp.")
@click.option("--seed", type=click.IntRange(0), default=3, show_default=True)
@click.option("--threads", type=click.IntRange(1), default=2, show_default=True)
@click.option("--rounds", type=click.IntRange(1), default=3, show_default=True)
def main(out: Path, before: Path | None, grasps: int, cases: int, seed: int, threads: int, rounds: int) -> None:
    """Time labels on this build of the engine beside the system's and beside an earlier version; compare the bytes."""
    check_outputs([out], [])
    variants, build = {"here": Variant(sys.executable)}, simulator_build()
    if library := system_library():
        variants["system"] = Variant(sys.executable, library)
    if before:
        variants["before"] = Variant(before)
    if len(variants) == 1:
        raise AminnError("nothing to compare with: the system has no other MuJoCo 2.2.2 (libmujoco2.2.2), no --before")
    figures = {"labels_cases": grasps * cases, "labels_threads": threads, "labels_library_from": build["from"]}
    figures |= compare(variants, grasps, cases, seed, threads, rounds)
    for key, value in figures.items():
        click.echo(f"  {key:40s} {value if isinstance(value, str | bool) else format(value, '.4g')}")
    write_json(out, figures)


if __name__ == "__main__":
    main()
