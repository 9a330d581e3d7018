"""Run the fuzz targets for a while, and add what was done to a report.

run.py --build build/fuzz --seconds 60 --report build/reports/reliability/fuzz.json

The time is shared by all targets. Three quarters are spent with BUILD/fast, which counts coverage alone; then
BUILD/sanitized tries all inputs that were kept, and goes on from them. What the fuzzer learns stays in BUILD/corpus and
is where the next run begins. Inputs that crash stay in BUILD/crashes and are tried first: the run fails until they no
longer crash. The report counts executions and time over all runs since it was begun. Standard library only.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from aminn_base.files import write_json

# bytes of the longest input: a model, or all that a target reads
MAX_LEN = {"batch": 3868, "blob": 16500, "calibrate": 784, "load": 256, "predict": 645, "serial": 2048, "vectors": 4096}
SHARES = {"fast": 0.75, "sanitized": 0.25}


@dataclass
class Campaign:
    """One target of one build."""

    folder: Path
    build: str
    target: str
    seconds: int

    @property
    def log(self) -> Path:
        return self.folder / f"{self.build}_{self.target}.log"

    def run(self) -> dict[str, int]:
        """Fuzz; figures of what was done."""
        kinds = ("corpus", "crashes", "seeds")
        folders = [self.folder / (f"fast/{kind}" if kind == "seeds" else kind) / self.target for kind in kinds]
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
        command = [str(self.folder / self.build / f"fuzz_{self.target}"), *map(str, folders)]
        command += [f"-max_total_time={self.seconds}", f"-max_len={MAX_LEN[self.target]}", "-print_final_stats=1"]
        command += ["-timeout=30", f"-artifact_prefix={folders[1]}/", "-rss_limit_mb=2048"]
        begun = time.monotonic()
        with self.log.open("wb") as log:
            status = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=False).returncode
        text = self.log.read_text(errors="replace")
        done = last_int(r"number_of_executed_units: (\d+)", text)
        took = time.monotonic() - begun
        print(f"fuzz_{self.target}, {self.build}: {done} executions, {done / took:.0f} a second", flush=True)
        if status != 0:
            self.explain(text)
        return {
            "executions": done,
            "seconds": round(took),
            "edges": last_int(r" cov: (\d+)", text),
            "corpus_files": sum(1 for _ in folders[0].iterdir()),
            "crashes": int(status != 0),
        }

    def explain(self, text: str) -> None:
        """End of the log and how to see it again."""
        print("\n".join(text.splitlines()[-60:]), file=sys.stderr)
        inputs = re.findall(r"Test unit written to (\S+)", text)
        program = self.folder / self.build / f"fuzz_{self.target}"
        replay = f"replay: {program} {inputs[-1]}" if inputs else "it left no input"
        print(f"fuzz_{self.target} failed (log: {self.log}); {replay}", file=sys.stderr)


def last_int(pattern: str, text: str) -> int:
    """The number of the last match, 0 without one."""
    found = re.findall(pattern, text)
    return int(found[-1]) if found else 0


def add(report: dict[str, int], campaign: Campaign, done: dict[str, int]) -> None:
    """What one campaign did, to the figures of all runs."""
    name = f"fuzz_{campaign.target}_{campaign.build}"
    for key in ("executions", "seconds"):
        for total in (f"{name}_{key}", f"fuzz_{campaign.build}_{key}", f"fuzz_{key}"):
            report[total] = report.get(total, 0) + done[key]
    report["fuzz_last_run_executions"] += done["executions"]
    report["fuzz_last_run_crashes"] += done["crashes"]
    report[f"{name}_edges"] = done["edges"]
    report[f"fuzz_{campaign.target}_corpus_files"] = done["corpus_files"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--build", type=Path, required=True, help="folder with both builds of tests/fuzz/CMakeLists.txt"
    )
    parser.add_argument("--seconds", type=int, default=60, help="time of the run, at least 10")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="targets that run side by side")
    parser.add_argument("--target", choices=MAX_LEN, action="append", help="one target of several; all unless given")
    parser.add_argument("--report", type=Path, required=True, help="figures of all runs so far, JSON")
    args = parser.parse_args()
    if args.seconds < 10:
        parser.error("--seconds must be 10 or more")
    targets = args.target or list(MAX_LEN)
    report = json.loads(args.report.read_text()) if args.report.is_file() else {}
    report |= {"fuzz_last_run_executions": 0, "fuzz_last_run_crashes": 0, "fuzz_last_run_seconds": args.seconds}
    report["fuzz_runs"] = report.get("fuzz_runs", 0) + 1
    for build, share in SHARES.items():
        each = max(1, round(args.seconds * share * args.jobs / len(targets)))
        campaigns = [Campaign(args.build, build, target, each) for target in targets]
        with ThreadPoolExecutor(args.jobs) as pool:
            for campaign, done in zip(campaigns, pool.map(Campaign.run, campaigns), strict=True):
                add(report, campaign, done)
                write_json(args.report, report)
    print(f"{report['fuzz_last_run_executions']} executions in this run, {report['fuzz_executions']} in all")
    return int(report["fuzz_last_run_crashes"] > 0)


if __name__ == "__main__":
    sys.exit(main())
