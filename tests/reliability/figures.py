"""Run programs that print figures as JSON, sum up what they print, and write it as one part of the reliability report.

figures.py --report build/reports/reliability/soak.json -- build/host/tests/runtime/aminn_soak 20000 2
figures.py --prefix properties_ --report ... --each 'build/host/tests/runtime/test_hands_*' -- --properties 1000

Standard library only. Exits 1 where a program fails, with its part written all the same.
"""

import argparse
import glob
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from aminn_base.files import write_json


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--report", type=Path, required=True)
    parser.add_argument("--prefix", default="", help="stands before every figure's name")
    parser.add_argument("--each", help="pattern of programs, each of which gets the arguments")
    parser.add_argument(
        "command", nargs="+", help="behind --: a program and its arguments, or arguments alone with --each"
    )
    args = parser.parse_args()
    programs = sorted(p for p in glob.glob(args.each) if os.access(p, os.X_OK)) if args.each else args.command[:1]
    arguments = args.command if args.each else args.command[1:]
    if not programs:
        parser.error(f"no program is called {args.each}")
    totals: dict[str, float] = {}
    failed, begun = 0, time.monotonic()
    for program in programs:
        done = subprocess.run([program, *arguments], stdout=subprocess.PIPE, text=True, check=False)
        failed += done.returncode != 0
        for name, value in json.loads(done.stdout or "{}").items():
            totals[args.prefix + name] = totals.get(args.prefix + name, 0) + value
        if args.each:
            print(f"{Path(program).name}: {'as promised' if done.returncode == 0 else 'FAILED'}", flush=True)
    if args.each:
        totals[f"{args.prefix}programs"] = len(programs)
        totals[f"{args.prefix}seconds"] = round(time.monotonic() - begun, 1)
    totals[f"{args.prefix or 'programs_'}failed"] = failed
    write_json(args.report, totals)
    print("\n".join(f"{name} {value}" for name, value in totals.items()))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
