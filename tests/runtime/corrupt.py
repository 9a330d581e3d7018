"""Try every damage of one byte, and every cut, on a binary model; report the figures.

corrupt.py PROGRAM MODEL.bin --report build/reports/reliability/corrupt.json
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path

from aminn_base.files import write_json

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--report", type=Path, required=True)
    args = parser.parse_args()
    done = subprocess.run([args.program.resolve(), args.model], stdout=subprocess.PIPE, text=True, check=True)
    found = json.loads(done.stdout)
    write_json(args.report, found)
    print("\n".join(f"{name} {value}" for name, value in found.items()))
