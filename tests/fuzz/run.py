"""Run the fuzz targets of a build folder side by side for a while, and report.

run.py --build build/fuzz --seconds 60 --report build/reports/fuzz.json

What the fuzzer learns stays in BUILD/corpus and is where the next run begins. Inputs that crash stay in BUILD/crashes
and are tried first: the run fails until they no longer crash. Standard library only.
"""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

MAX_LEN = {"blob": 480_000, "predict": 512}  # bytes: the largest model; an input and some more


def prepare(build: Path, target: str) -> list[Path]:
    """Folders of inputs; the fuzzer writes to the first."""
    folders = [build / "corpus" / target, build / "crashes" / target, build / "seeds" / target]
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
    return folders


def start(build: Path, target: str, seconds: int) -> subprocess.Popen[bytes]:
    """Begin to fuzz; messages go to BUILD/TARGET.log."""
    folders = prepare(build, target)
    command = [str(build / f"fuzz_{target}"), *map(str, folders)]
    command += [f"-max_total_time={seconds}", f"-max_len={MAX_LEN[target]}", "-print_final_stats=1", "-timeout=10"]
    command += [f"-artifact_prefix={folders[1]}/", "-rss_limit_mb=2048"]
    with (build / f"{target}.log").open("wb") as log:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)


def last_int(pattern: str, text: str) -> int:
    """The number of the last match, 0 without one."""
    found = re.findall(pattern, text)
    return int(found[-1]) if found else 0


def figures(build: Path, target: str, status: int) -> dict[str, int]:
    """What the log of a target says."""
    log = (build / f"{target}.log").read_text(errors="replace")
    return {
        "executions": last_int(r"number_of_executed_units: (\d+)", log),
        "executions_per_s": last_int(r"average_exec_per_sec: +(\d+)", log),
        "edges": last_int(r" cov: (\d+)", log),
        "edges_in_library": last_int(r"\((\d+) inline 8-bit counters", log),
        "corpus_files": sum(1 for _ in (build / "corpus" / target).iterdir()),
        "crashes": int(status != 0),
    }


def explain(build: Path, target: str) -> None:
    """End of the log and how to see it again."""
    path = build / f"{target}.log"
    log = path.read_text(errors="replace")
    print("\n".join(log.splitlines()[-60:]), file=sys.stderr)
    inputs = re.findall(r"Test unit written to (\S+)", log)
    replay = f"replay: {build / f'fuzz_{target}'} {inputs[-1]}" if inputs else "it left no input"
    print(f"fuzz_{target} failed (log: {path}); {replay}", file=sys.stderr)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, required=True, help="folder of tests/fuzz/CMakeLists.txt's build")
    parser.add_argument("--seconds", type=int, default=60, help="time of the run")
    parser.add_argument("--report", type=Path, required=True, help="figures, JSON")
    args = parser.parse_args()
    if args.seconds < 1:
        parser.error("--seconds must be 1 or more")
    running = {target: start(args.build, target, args.seconds) for target in MAX_LEN}
    report: dict[str, int] = {"seconds": args.seconds}
    for target, process in running.items():
        status = process.wait()
        result = figures(args.build, target, status)
        report |= {f"{target}_{key}": value for key, value in result.items()}
        print(f"fuzz_{target}: " + ", ".join(f"{key} {value}" for key, value in result.items()))
        if status != 0:
            explain(args.build, target)
    args.report.parent.mkdir(parents=True, exist_ok=True)
    args.report.write_text(json.dumps(report, indent=2, sort_keys=True) + "\n")
    return int(any(report[f"{target}_crashes"] for target in running))


if __name__ == "__main__":
    sys.exit(main())
