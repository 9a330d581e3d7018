"""Kill a simulation at random moments, go on each time, and compare what comes out with an undisturbed run.

    crash.py --kills 50 --report build/reports/crash.json

After each kill every shard under its final name must be whole: equal, byte by byte, to the undisturbed one. A data set
that is finished is compared as a whole, and a new one is begun until all kills are spent.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from aminn_base.lock import NAME as LOCK
from aminn_sim.simulate import UNFINISHED

GRASPS, SHARD_GRASPS, CASES = 40, 8, 16  # five shards of a second or two each
MARK = "AMINN_CRASH_RUN"  # in the environment of what was started here, so that nothing else is ever killed


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of the files under their final names."""
    files = folder.iterdir() if folder.is_dir() else ()
    others = (UNFINISHED, LOCK)  # of a simulation that is under way
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest()
        for p in files
        if p.suffix != ".partial" and p.name not in others
    }


@dataclass
class Crash:
    """A data set that is killed again and again in `scratch`. Raises AssertionError where a kill did harm."""

    scratch: Path
    seed: int
    grasps: int = GRASPS
    shard_grasps: int = SHARD_GRASPS
    cases: int = CASES
    directly: bool = False
    """Call the function instead of the program, which takes longer to start."""
    figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.folder, self.mark = self.scratch / "killed", f"{os.getpid()}-{self.seed}"
        self.count("kills", 0)
        started = time.monotonic()
        assert self.start(self.scratch / "whole").wait() == 0
        self.seconds = time.monotonic() - started
        self.whole = hashes(self.scratch / "whole")
        assert "manifest.json" in self.whole and len(self.whole) == -(-self.grasps // self.shard_grasps) + 1

    def count(self, name: str, more: float = 1) -> None:
        """Add to a figure."""
        self.figures[name] = self.figures.get(name, 0) + more

    def start(self, folder: Path, engine: str = "threads") -> subprocess.Popen:
        """The program, on its way."""
        settings = {"seed": 3, "grasps": self.grasps, "cases": self.cases, "shard_grasps": self.shard_grasps}
        if self.directly:
            code = f"from aminn_sim import *; simulate(SimulationConfig(**{settings}), {str(folder)!r}, 2, False)"
            command = ["-c", code]
        else:
            options = [f"--{name.replace('_', '-')}={value}" for name, value in settings.items()]
            command = ["-m", "aminn_app.cli", "simulate", "--engine", engine, "--threads=2", *options]
            command += ["--out", str(folder)]
        environment = os.environ | {MARK: self.mark}
        with (self.scratch / "log").open("a") as log:
            return subprocess.Popen([sys.executable, *command], env=environment, stdout=log, stderr=log)

    def kill(self, engine: str = "threads", while_writing: bool = False) -> None:
        """Go on with the data set, end the program at a random moment, look at what is left."""
        shards = len(self.whole) - 1
        process = self.start(self.folder, engine)
        until = time.monotonic() + self.random.uniform(0, 2.5 * self.seconds / shards)
        while process.poll() is None and time.monotonic() < until:
            time.sleep(0.001)
        while while_writing and process.poll() is None and not list(self.folder.glob("*.partial")):
            time.sleep(0.0002)
        process.send_signal(signal.SIGKILL)
        status = process.wait()
        self.end_strays()
        if status != -signal.SIGKILL:
            assert status == 0, (self.scratch / "log").read_text()[-2000:]
            self.finish_one()
            return
        self.count("kills")
        self.count(f"kills_{engine}")
        self.count("kills_that_left_a_partial_file", bool(list(self.folder.glob("*.partial"))))
        found = hashes(self.folder)
        self.count("whole_shards_after_kills", len(found))
        assert found.items() <= self.whole.items(), f"not whole: {set(found.items()) - set(self.whole.items())}"

    def finish_one(self) -> None:
        """The data set is complete: nothing may tell it from an undisturbed one. The next begins anew."""
        left = {p.name for p in self.folder.iterdir()}
        assert left == set(self.whole), left
        assert hashes(self.folder) == self.whole
        self.count("finished_data_sets")
        shutil.rmtree(self.folder)

    def finish(self) -> dict[str, float]:
        """Go on to the end with the last data set; the figures."""
        assert self.start(self.folder).wait() == 0
        self.finish_one()
        return self.figures | {"shards": len(self.whole) - 1, "seed": self.seed, "undisturbed_s": self.seconds}

    def end_strays(self) -> None:
        """Processes of a Ray cluster that outlived the program that started it."""
        for environment in Path("/proc").glob("[0-9]*/environ"):
            try:
                if f"{MARK}={self.mark}".encode() in environment.read_bytes().split(b"\0"):
                    os.kill(int(environment.parent.name), signal.SIGKILL)
            except (OSError, ValueError):
                continue  # ended meanwhile, or somebody else's


def main() -> None:
    """Kill, compare, report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--ray-kills", type=int, default=5, help="of these, kills of a program that runs on Ray")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--report", type=Path, required=True)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        crash = Crash(Path(scratch), arguments.seed)
        while (done := int(crash.figures["kills"])) < arguments.kills:
            ray = done >= arguments.kills - arguments.ray_kills
            crash.kill("ray" if ray else "threads", while_writing=not ray and done % 5 == 4)
            print(f"\r{done} of {arguments.kills} kills", end="", file=sys.stderr)
        figures = crash.finish()
    arguments.report.parent.mkdir(parents=True, exist_ok=True)
    arguments.report.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n")
    print(f"\n{figures['kills']:.0f} kills, {figures['finished_data_sets']:.0f} data sets, every file as undisturbed")


if __name__ == "__main__":
    main()
