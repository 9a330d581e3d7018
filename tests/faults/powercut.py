"""Cut the power, and let calls fail, at each step of what writes files: the old state or the new one is there, whole.

powercut.py --work build/faults/powercut --report build/reports/reliability/powercut.json [--sample N] [--only NAME]

A command runs once and every change of its folder is recorded (interpose.c). From the record follows what a cut of
power may leave at each call (disk.py). Each such folder is put there: every file in it must be an old or a new one,
whole; what reads it must take it or say what is wrong; and the same command must end in the bytes of an undisturbed
run, with nothing left over. Then the calls fail one by one, with the errors that a disk has, and the same must hold.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import random
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from forks import Disturber, Ended, forked, preloaded

LIMIT_S = 120.0
SAID = "the same command says what to do"


@dataclass
class Campaign:
    """One scenario, disturbed. Its folder is the same each time, so that no path can differ."""

    scenario: Scenario
    work: Path
    disturber: Disturber
    seed: Callable[[], None] | None = None
    """A defect to plant in the process that is disturbed."""
    faults: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.top, self.given = self.work / "warm", self.work / "given"
        self._renew({})
        assert (
            call(self.scenario.command.format(top=self.top, given=self.given)).code == 0
        )  # loads what forks then have
        self.top = self.work / "top"
        self.start: Tree = {}
        self._renew({})
        if self.scenario.before:
            self._succeed(self.scenario.before)
            self.start = read_tree(self.top)
        self.readings = [self._reading()] if self.start else []
        self._renew(self.start)
        record = self.work / "record"
        done = forked(partial(self._run, self.scenario.command, record=record), LIMIT_S)
        self._expect_success(done)
        self.end = read_tree(self.top)
        self.readings.append(self._reading())
        assert all(isinstance(r, dict) and "read" in r for r in self.readings), self.readings
        self.calls = read_record(record, self.top)
        disk = Disk(self.start)
        for c in self.calls:
            disk.follow(c)
        assert disk.tree() == self.end, "the record is not what happened"
        self.whole = disk.whole
        if lost := sorted(k for k in self.end if disk.for_sure().get(k, b"?") != self.end[k]):
            self._fault("at the end", f"not on the disk for sure: {', '.join(lost)}")
        self.count("runs_to_the_end")
        self.n = int(json.loads(str(done.value))["calls"]) if isinstance(done.value, str) else 0

    # --- a run ------------------------------------------------------------------------------------------------------
    def _run(self, command: str, record: Path | None = None, arm: Callable[[], None] | None = None) -> str:
        if self.seed:
            self.seed()
        self.disturber.watch(self.top, record)
        if arm:
            arm()
        said = call(command.format(top=self.top, given=self.given))
        calls = self.disturber.calls()
        self.disturber.arm(0, 1, 0)
        return json.dumps({"code": said.code, "text": said.text, "clear": said.is_clear, "calls": calls})

    def _succeed(self, command: str) -> None:
        self._expect_success(forked(partial(self._run, command), LIMIT_S))

    def _expect_success(self, done: Ended) -> None:
        said = json.loads(str(done.value)) if done.status == 0 else {"code": done.status, "text": str(done.value)}
        assert said["code"] == 0, f"{self.scenario.name} undisturbed: {said['text']}"

    def _renew(self, tree: Tree) -> None:
        shutil.rmtree(self.top, ignore_errors=True)
        write_tree(tree, self.top)

    def _reading(self) -> object:
        """What a reader makes of the folder; a text where it refuses."""

        def read() -> object:
            if self.seed:
                self.seed()
            try:
                return {"read": self.scenario.reads(self.top)}
            except AminnError as error:
                return {"refused": str(error)}

        done = forked(read, LIMIT_S)
        return done.value if done.status == 0 else {"broke": str(done.value)[-300:]}

    # --- what must hold ---------------------------------------------------------------------------------------------
    def _fault(self, where: str, what: str) -> None:
        self.faults.append(f"{self.scenario.name}, {where}: {what}")
        print(f"\n{self.faults[-1]}", flush=True)

    def count(self, name: str, more: float = 1) -> None:
        """Add to a figure."""
        self.figures[name] = self.figures.get(name, 0) + more

    def judge(self, where: str) -> bool:
        """The folder after a disturbance, and after the same command again; whether all is well."""
        before = len(self.faults)
        for path, content in read_tree(self.top).items():
            known = self.whole.get(path, set())
            if content is not None and not _hidden(path) and content not in known:
                self._fault(where, f"{path} is neither the old one nor the new one ({len(content)} bytes)")
        found = self._reading()
        if isinstance(found, dict) and "broke" in found:
            self._fault(where, f"the reader broke: {found['broke']}")
        elif isinstance(found, dict) and "read" in found and found not in self.readings:
            self._fault(where, "what is read is neither the old state nor the new one")
        elif isinstance(found, dict) and "refused" in found:
            self.count("readers_refused")
        done = forked(partial(self._run, self.scenario.command), LIMIT_S)
        said = json.loads(str(done.value)) if done.status == 0 else {}
        if said.get("code") == 0:
            after = {p: c for p, c in read_tree(self.top).items() if Path(p).name != LOCK}  # which holds nobody up
            if after != self.end:
                odd = sorted(k for k in after.keys() | self.end.keys() if after.get(k, 0) != self.end.get(k, 0))
                self._fault(where, f"the same command ends in other files: {', '.join(odd)}")
        elif said.get("clear"):
            self._fault(where, f"the same command does not go on: {said['text'].strip()[-200:]}")
        else:
            self._fault(where, f"the same command broke: {done.status} {str(done.value)[-400:]}")
        return len(self.faults) == before

    # --- disturbances -----------------------------------------------------------------------------------------------
    def cuts(self) -> Iterator[tuple[str, Tree]]:
        """Each different state of the disk, once."""
        disk, seen = Disk(self.start), set()
        for k in range(len(self.calls) + 1):
            for how, tree in disk.cuts():
                if (key := hash(tuple(sorted((p, c or b"") for p, c in tree.items())))) not in seen:
                    seen.add(key)
                    yield f"power cut after call {k} of {len(self.calls)}, {how}", tree
            if k < len(self.calls):
                disk.follow(self.calls[k])

    def cut(self, where: str, tree: Tree) -> None:
        """The power goes and comes."""
        self._renew(tree)
        self.count("cuts")
        self.count("cuts_survived", self.judge(where))

    def killed(self) -> Iterator[int]:
        """Calls before which the process can be killed."""
        yield from range(1, self.n + 1)

    def kill(self, k: int) -> None:
        """End the process before a call, and see that the record says the same of it."""
        self._renew(self.start)
        arm = partial(self.disturber.arm, Disturber.KILL, k, k)
        done = forked(partial(self._run, self.scenario.command, arm=arm), LIMIT_S)
        where = f"killed before call {k} of {self.n}"
        if done.status != -9:
            self._fault(where, f"ended with {done.status} instead")
        self.count("kills")
        self.count("kills_survived", self.judge(where))

    def failures(self) -> Iterator[tuple[str, Callable[[], None], bool]]:
        """(what fails, how to arm it, whether the command must succeed all the same)."""
        arm = self.disturber.arm
        yield "half of each write", partial(arm, Disturber.HALF, kinds="w"), True
        for k in range(1, self.n + 1):
            yield f"EIO at call {k} of {self.n}", partial(arm, errno.EIO, k, k), False
            yield f"disk full from call {k} of {self.n}", partial(arm, errno.ENOSPC, k, kinds="owtm"), False
        for odd in (1, 2):
            yield f"EINTR at calls {odd}, {odd + 2}, ...", partial(arm, errno.EINTR, odd, step=2, kinds="ows"), True

    def fail(self, where: str, arm: Callable[[], None], must_succeed: bool) -> None:
        """Run with calls that fail."""
        self._renew(self.start)
        record = self.work / "record"
        done = forked(partial(self._run, self.scenario.command, record=record, arm=arm), LIMIT_S)
        said = json.loads(str(done.value)) if done.status == 0 else {"code": done.status, "clear": False}
        before = len(self.faults)
        if not said["clear"] or (must_succeed and said["code"]):
            self._fault(where, f"ended with {said['code']}: {str(done.value)[-400:]}")
        if said["code"] == 0:
            shown = {p: c for p, c in read_tree(self.top).items() if not _hidden(p)}
            if shown != {p: c for p, c in self.end.items() if not _hidden(p)}:
                self._fault(where, "success was told, and not all is there")
            disk = Disk(self.start)
            for c in read_record(record, self.top):
                disk.follow(c)
            if any(disk.for_sure().get(k) != v for k, v in self.end.items()):
                self._fault(where, "success was told, and not all is on the disk for sure")
        elif "full" in where and (left := [p for p in read_tree(self.top) if p.endswith(".partial")]):
            self._fault(where, f"{left[0]} is left over")
        good = len(self.faults) == before
        self.count("failures")
        self.count("failures_survived", self.judge(where) and good)


def _hidden(path: str) -> bool:
    return any(part.startswith(".") for part in path.split("/"))


def campaign(
    scenario: Scenario, work: Path, sample: int | None, seed: Callable[[], None] | None = None, stop: bool = False
) -> Campaign:
    """All of a scenario, or `sample` of each kind of disturbance; with `stop`, up to the first fault."""
    rng, run = random.Random(scenario.name), Campaign(scenario, work, Disturber(), seed)
    jobs: list[Callable[[], None]] = []
    for every in (
        [partial(run.cut, *c) for c in run.cuts()],
        [partial(run.kill, k) for k in run.killed()],
        [partial(run.fail, *f) for f in run.failures()],
    ):
        jobs += every if sample is None else rng.sample(every, min(sample, len(every)))
    if stop:
        rng.shuffle(jobs)
    for k, job in enumerate(jobs):
        if stop and run.faults:
            break
        job()
        print(
            f"\r{scenario.name}: {k + 1} of {len(jobs)}, {len(run.faults)} faults ", end="", file=sys.stderr, flush=True
        )
    print(file=sys.stderr)
    return run


def find_seeds(work: Path, report: Path | None, names: Sequence[str]) -> int:
    """Plant each defect; the number of those that were not found."""
    found = {}
    for name in names:
        seed = SEEDS[name]
        scenario = next(s for s in SCENARIOS if s.name == seed.scenario)
        faults = campaign(scenario, work, None, seed.plant, stop=True).faults
        found[f"powercut_seed_{name}_found"] = bool(faults)
    figures = {"powercut_seeds": len(found), "powercut_seeds_found": sum(found.values())}
    if report:
        write_json(report, figures | found)
    print(json.dumps(figures | found, indent=1))
    return len(found) - sum(found.values())


def main() -> int:
    """Disturb, judge, report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--report", type=Path)
    parser.add_argument(
        "--sample", type=int, help="so many of each kind of disturbance of a scenario; all where not told"
    )
    parser.add_argument("--only", action="append", choices=[s.name for s in SCENARIOS])
    parser.add_argument("--seeds", action="store_true", help="plant each defect that is known to be found, and find it")
    parser.add_argument("--seed", action="append", choices=list(SEEDS), help="of these the ones to plant")
    args = parser.parse_args()
    work = args.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    prepare(work / "given")
    if args.seeds:
        return find_seeds(work, args.report, args.seed or list(SEEDS))
    started, report, faults = time.monotonic(), {}, []
    for scenario in SCENARIOS:
        if args.only and scenario.name not in args.only:
            continue
        run = campaign(scenario, work, args.sample)
        faults += run.faults
        for name, value in run.figures.items():
            report[f"powercut_{name}"] = report.get(f"powercut_{name}", 0) + value
        report[f"powercut_{scenario.name}_calls"] = run.n
    report |= {"powercut_faults": len(faults), "powercut_seconds": time.monotonic() - started}
    if args.report:
        write_json(args.report, report)
    print(json.dumps(report, indent=1))
    return bool(faults)


if __name__ == "__main__":
    preloaded()

from disk import Disk, Tree, read_record, read_tree, write_tree  # noqa: E402
from scenarios import SCENARIOS, Scenario, call, prepare  # noqa: E402
from seeds import SEEDS  # noqa: E402

from aminn_base.errors import AminnError  # noqa: E402
from aminn_base.files import write_json  # noqa: E402
from aminn_base.lock import NAME as LOCK  # noqa: E402

if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    sys.exit(main())
