"""Simulate for a while on a machine that does harm: nothing is lost, and the bytes are those of a quiet one.

soak_sim.py --seconds 3600 --work build/faults/soak --report build/reports/reliability/soak_sim.json

A data set is simulated in rounds, each disturbed: the process is killed, the disk is full or fails, the clock jumps
back and forth, another process wants the folder, Ray's workers are killed. After each round every shard must be whole;
a data set that is finished is compared byte by byte with an undisturbed one, and the next begins.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from forks import Disturber, forked, preloaded

SETTINGS = "--grasps 16 --cases 3 --shard-grasps 2 --seed 11"
LIMIT_S, TICK_S, RAY_EVERY_S = 600.0, 0.02, 240.0
DAY_S = 86400.0
MARK = "AMINN_SOAK_RUN"


class Soak:
    """Rounds in a folder, and what came of them."""

    def __init__(self, work: Path, seed: int) -> None:
        self.random, self.disturber = random.Random(seed), Disturber()
        self.top, self.work = work / "top", work
        shutil.rmtree(work, ignore_errors=True)
        self.top.mkdir(parents=True)
        self.figures: dict[str, float] = {"soak_sim_rounds": 0, "soak_sim_finished": 0, "soak_sim_faults": 0}
        self.ray_next = time.monotonic() + RAY_EVERY_S / 4
        started = time.monotonic()
        assert self._simulate() == 0
        self.seconds = time.monotonic() - started
        self.whole = self._files()
        shutil.rmtree(self.top / "data")

    def count(self, name: str) -> None:
        """One more."""
        self.figures[f"soak_sim_{name}"] = self.figures.get(f"soak_sim_{name}", 0) + 1

    def fault(self, what: str) -> None:
        """Something that must not be."""
        self.count("faults")
        print(f"round {self.figures['soak_sim_rounds']:.0f}: {what}", flush=True)

    def _files(self) -> dict[str, bytes]:
        folder = self.top / "data"
        return {p.name: p.read_bytes() for p in folder.iterdir()} if folder.is_dir() else {}

    def _simulate(self, arm: Callable[[], None] | None = None, limit_s: float = LIMIT_S) -> int:
        """Exit code; negative: killed after `limit_s`, or by what was armed."""

        def work() -> list[object]:
            self.disturber.watch(self.top)
            if arm:
                arm()
            said = call(f"simulate {SETTINGS} --threads {self.random.choice((1, 2))} --out {self.top / 'data'}")
            return [said.code, said.is_clear, said.text]

        done = forked(work, limit_s)
        if done.status != 0:
            return done.status
        code, clear, text = json.loads(json.dumps(done.value))
        if not clear:
            self.fault(f"ended with {code}: {text[-300:]}")
        return int(code)

    # --- disturbances -----------------------------------------------------------------------------------------------
    def killed(self) -> None:
        """At a random moment."""
        self._simulate(limit_s=self.random.uniform(0.02, 1.2 * self.seconds))

    def killed_at_a_call(self) -> None:
        """While it writes."""
        k = self.random.randint(1, 60)
        self._simulate(partial(self.disturber.arm, Disturber.KILL, k, k))

    def disk_full(self) -> None:
        """From some call on."""
        self._simulate(partial(self.disturber.arm, errno.ENOSPC, self.random.randint(1, 60), kinds="owtm"))

    def disk_fails(self) -> None:
        """Once."""
        k = self.random.randint(1, 60)
        self._simulate(partial(self.disturber.arm, errno.EIO, k, k))

    def clock_jumps(self) -> None:
        """A day back, and to and fro all the time."""
        offsets = [self.random.uniform(-DAY_S, DAY_S) for _ in range(50)]

        def arm() -> None:
            self.disturber.clock(-DAY_S)

            def jump() -> None:
                while True:
                    for offset in offsets:
                        self.disturber.clock(offset)
                        time.sleep(TICK_S)

            threading.Thread(target=jump, daemon=True).start()

        if self._simulate(arm) != 0:
            self.fault("a clock that jumps ended the simulation")

    def two_at_once(self) -> None:
        """The second is told who is there."""
        first = threading.Thread(target=self._simulate)
        first.start()
        lock = self.top / "data" / LOCK
        while first.is_alive() and not lock.exists():
            time.sleep(0.001)
        done = forked(lambda: call(f"simulate {SETTINGS} --threads 1 --out {self.top / 'data'}").text, LIMIT_S)
        if first.is_alive():
            self.count("second_refused" if "in use by" in str(done.value) else "second_came_late")
        first.join()

    def ray_worker_killed(self) -> None:
        """One of the cluster that the program started."""
        words = [sys.executable, "-m", "aminn_app.cli", "simulate", "--engine", "ray", "--threads", "2"]
        mark = f"{os.getpid()}"
        with (self.work / "ray.log").open("ab") as log:
            program = subprocess.Popen(
                [*words, *SETTINGS.split(), "--out", str(self.top / "data")],
                env=os.environ | {MARK: mark}, stdout=log, stderr=log,
            )  # fmt: skip
        until = time.monotonic() + LIMIT_S
        victim = 0
        while program.poll() is None and not victim and time.monotonic() < until:
            time.sleep(TICK_S)
            victim = next(iter(_workers(mark)), 0)
        if victim:
            time.sleep(self.random.uniform(0, 0.5))
            with _gone():
                os.kill(victim, signal.SIGKILL)
            self.count("ray_workers_killed")
        program.wait(timeout=LIMIT_S)
        for stray in _own(mark):
            with _gone():
                os.kill(stray, signal.SIGKILL)

    # --- rounds -----------------------------------------------------------------------------------------------------
    def round(self) -> None:
        """One disturbance, and what must hold after."""
        kinds = [
            self.killed,
            self.killed_at_a_call,
            self.disk_full,
            self.disk_fails,
            self.clock_jumps,
            self.two_at_once,
        ]
        kind = self.random.choice(kinds)
        if HAS_RAY and time.monotonic() > self.ray_next:
            kind, self.ray_next = self.ray_worker_killed, time.monotonic() + RAY_EVERY_S
        self.count("rounds")
        self.count(kind.__name__)
        kind()
        for name, content in self._files().items():
            if name in self.whole and content != self.whole[name]:
                self.fault(f"{name} is not whole after {kind.__name__}")
        if "manifest.json" in self._files():
            self.finish()

    def finish(self) -> None:
        """Go on undisturbed to the end, compare, begin anew."""
        if self._simulate() != 0:
            self.fault("does not go on")
        found = {name: content for name, content in self._files().items() if name != LOCK}
        if found != self.whole:
            odd = sorted(k for k in found.keys() | self.whole.keys() if found.get(k) != self.whole.get(k))
            self.fault(f"finished with other files: {', '.join(odd)}")
        self.count("finished")
        shutil.rmtree(self.top / "data")


def _own(mark: str) -> list[int]:
    """Processes with our mark in their environment."""
    found = []
    for file in Path("/proc").glob("[0-9]*/environ"):
        with _gone():
            if f"{MARK}={mark}".encode() in file.read_bytes().split(b"\0"):
                found.append(int(file.parent.name))
    return found


def _workers(mark: str) -> list[int]:
    found = []
    for process in _own(mark):
        with _gone():
            if Path(f"/proc/{process}/cmdline").read_bytes().startswith(b"ray::"):
                found.append(process)
    return found


def _gone() -> suppress:
    return suppress(OSError)


def main() -> int:
    """Rounds for so long, then to the end; report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--report", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    started = time.monotonic()
    soak = Soak(args.work.resolve(), args.seed)
    while time.monotonic() - started < args.seconds:
        soak.round()
    soak.finish()
    report = soak.figures | {"soak_sim_seconds": time.monotonic() - started}
    if args.report:
        write_json(args.report, report)
    print(json.dumps(report, indent=1))
    return int(report["soak_sim_faults"] > 0)


if __name__ == "__main__":
    preloaded()

from contextlib import suppress  # noqa: E402
from importlib.util import find_spec  # noqa: E402

from scenarios import call  # noqa: E402

from aminn_base.files import write_json  # noqa: E402
from aminn_base.lock import NAME as LOCK  # noqa: E402

HAS_RAY = find_spec("ray") is not None

if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    sys.exit(main())
