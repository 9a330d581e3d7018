"""The simulator under ThreadSanitizer, sound and with seeded races.

races.py --work build/races --report build/reports/reliability/races_simulator.json

The compiled part is built anew with the sanitizer; the engine and Python are as they are, so races within these are not
seen. A small data set is simulated by more threads than the machine may have, so that they take cases of each other's
grasps; then one is broken off. Each seeded defect is a change of one line, and must be found.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

from defects import ROOT, build, run

from aminn_base.files import write_json

SIM, MUJOCO = ROOT / "sim", ROOT / "build/mujoco"
THREADS = 4
DEFECTS = {
    "shard_added_without_the_lock": (
        "src/shard.cpp",
        "        const std::lock_guard lock(mutex_);\n        shards_.push_back",
        "        shards_.push_back",
    ),
    "steps_counted_without_the_lock": (
        "src/shard.cpp",
        "            lock.lock();\n            shard.result.cases",
        "            ++shard.result.steps;\n            lock.lock();\n            shard.result.cases",
    ),
    "case_taken_without_the_lock": (
        "src/shard.cpp",
        "        const std::size_t i = grasp->begun++;\n"
        "        const std::int64_t steps_before = worker.steps();\n"
        "        lock.unlock();\n",
        "        lock.unlock();\n"
        "        const std::size_t i = grasp->begun++;\n"
        "        const std::int64_t steps_before = worker.steps();\n",
    ),
    "workers_share_a_result": (
        "src/shard.cpp",
        "            CaseResult result = worker.load(",
        "            static CaseResult result;\n            result = worker.load(",
    ),
}
"""File below sim/, what stands there, and what takes its place."""


class Build:
    """A copy of the simulator and what is compiled of it, with the sanitizer in it."""

    def __init__(self, work: Path) -> None:
        self.tree, self.folder = work / "sim", work / "build"
        shutil.rmtree(self.tree, ignore_errors=True)
        shutil.copytree(SIM, self.tree, ignore=shutil.ignore_patterns("__pycache__"))
        settings = {
            "CMAKE_CXX_FLAGS": "-fsanitize=thread",
            "CMAKE_CXX_FLAGS_RELWITHDEBINFO": "-O1 -g1",
            "CMAKE_BUILD_TYPE": "RelWithDebInfo",
            "Python_EXECUTABLE": sys.executable,
            "AMINN_MUJOCO": MUJOCO,
        }
        given = [f"-D{name}={value}" for name, value in settings.items()]
        build(["cmake", "-S", self.tree, "-B", self.folder, *given])

    def core(self) -> Path:
        """The compiled part of what stands in the copy."""
        build(["cmake", "--build", self.folder, "--parallel", len(os.sched_getaffinity(0))])
        return next(self.folder.glob("_core*.so"))

    def seeded(self, name: str) -> Path:
        """The compiled part with a defect in it."""
        source = self.tree / DEFECTS[name][0]
        text = source.read_text()
        source.write_text(changed(name, text))
        try:
            return self.core()
        finally:
            source.write_text(text)


def changed(name: str, text: str) -> str:
    """A source with a defect in it."""
    file, sound, defect = DEFECTS[name]
    if text.count(sound) != 1:
        raise SystemExit(f"{name}: sim/{file} does not have this once:\n{sound}")
    return text.replace(sound, defect)


def simulate_with(core: Path) -> None:
    """In a process of its own, with the sanitizer loaded: a data set, and one that is broken off."""
    spec = importlib.util.spec_from_file_location("aminn_sim._core", core)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["aminn_sim._core"] = module
    spec.loader.exec_module(module)
    from aminn_sim import SimulationConfig, simulate
    from aminn_sim.engines import ShardTask, on_threads
    from aminn_sim.open_hand import open_hand

    class Enough(Exception):
        pass

    def enough(done: int) -> None:
        if done >= 2:
            raise Enough

    config = SimulationConfig(grasps=5, cases=5, seed=7, shard_grasps=3)
    with tempfile.TemporaryDirectory() as scratch:
        simulate(config, Path(scratch) / "data", progress=False, threads=THREADS)
    tasks = [ShardTask(config, n, 3, lambda: open_hand().simulator()) for n in range(2)]
    try:
        list(on_threads(tasks, THREADS, enough))
    except Enough:
        print("broken off")


def races(core: Path) -> int:
    """How many races the sanitizer reports, the first of them printed. Raises where the simulation itself fails."""
    runtime = run(["g++", "-print-file-name=libtsan.so"]).stdout.strip()
    options = "ignore_noninstrumented_modules=1 report_signal_unsafe=0"
    environment = {**os.environ, "LD_PRELOAD": runtime, "TSAN_OPTIONS": options, "OMP_NUM_THREADS": "1"}
    # without random places in memory, of which a sanitizer of this age knows not all
    done = run(["setarch", "-R", sys.executable, __file__, "--core", core], 1800, env=environment)
    found = re.findall(r"SUMMARY: ThreadSanitizer: data race (.*)", done.stdout)
    if not found and (done.returncode != 0 or "broken off" not in done.stdout):
        raise SystemExit(f"the simulation ended with {done.returncode}:\n{done.stdout[-3000:]}")
    for line in found[:1]:
        print(f"    {line}", flush=True)
    return len(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, default=ROOT / "build/races")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--core", type=Path, help="simulate with this compiled part, and no more")
    args = parser.parse_args()
    if args.core:
        simulate_with(args.core)
        return 0
    figures: dict[str, float] = {}
    simulator = Build(args.work)
    found = races(simulator.core())
    print(f"sound: {found} races", flush=True)
    figures["races_simulator_failed"] = found
    named = 0
    for name in DEFECTS:
        n = races(simulator.seeded(name))
        print(f"{name}: {f'found, {n} reports' if n else 'NOT FOUND'}", flush=True)
        named += n > 0
    figures |= {"races_simulator_seeds": len(DEFECTS), "races_simulator_seeds_found": named}
    if args.report:
        write_json(args.report, figures)
    return int(found > 0 or named < len(DEFECTS))


if __name__ == "__main__":
    sys.exit(main())
