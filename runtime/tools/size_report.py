#!/usr/bin/env python3
"""Sizes of the runtime on a Cortex-M7: code, data, context, stack, model; as JSON with flat keys.

    python3 runtime/tools/size_report.py --build build/firmware --out build/reports/size.json

Reads the archive and the image that runtime/firmware builds (needs arm-none-eabi binutils), and the figures of its
replay (firmware.json) if they are there. Prints each figure with its change since the previous report. Needs nothing
but the standard library.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

TOOLS = "arm-none-eabi-"
RUN_FIGURES = ("context_bytes", "stack_predict_bytes", "stack_high_water_bytes", "instructions_worst")


def die(text: str) -> None:
    """Say what is wrong and stop."""
    sys.exit(f"size_report: {text}")


def tool(name: str, *args: str) -> str:
    """Output of a binutils program."""
    try:
        return subprocess.run([TOOLS + name, *args], capture_output=True, text=True, check=True).stdout
    except FileNotFoundError:
        die(f"{TOOLS}{name} is not installed; on Debian: apt-get install gcc-arm-none-eabi")
    except subprocess.CalledProcessError as error:
        die(f"{TOOLS}{name} {' '.join(args)}: {error.stderr.strip()}")
    raise AssertionError


def sections(path: Path) -> dict[str, tuple[int, int, int]]:
    """(text, data, bss) of each member of an archive, or of an image, in bytes."""
    rows = [line.split(None, 5) for line in tool("size", str(path)).splitlines()[1:]]
    return {row[5].split()[0]: (int(row[0]), int(row[1]), int(row[2])) for row in rows}


def model_bytes(image: Path, prefix: str) -> int:
    """Bytes of the model's tables in the image: constants whose names are the prefix or start with it."""
    rows = [row for line in tool("nm", "-S", str(image)).splitlines() if len(row := line.split()) == 4]
    return sum(int(size, 16) for _, size, kind, name in rows if kind in "rR" and f"{name}_".startswith(f"{prefix}_"))


def measure(build: Path, model: str) -> dict[str, int]:
    """All figures."""
    archive, image = build / "aminn_rt" / "libaminn_rt.a", build / "aminn_firmware.elf"
    for path in (archive, image):
        if not path.is_file():
            die(f"{path}: not there; build runtime/firmware first (make firmware)")
    members = sections(archive)
    report = {
        f"archive_{part}_bytes": sum(m[i] for m in members.values()) for i, part in enumerate(("text", "data", "bss"))
    }
    for name, (text, _, _) in sorted(members.items()):
        report[f"archive_text_{name.split('.')[0]}_bytes"] = text
    text, data, bss = next(iter(sections(image).values()))
    report |= {"image_text_bytes": text, "image_data_bytes": data, "image_bss_bytes": bss}
    report["image_stack_reserved_bytes"] = stack_reserved(image)
    report["model_bytes"] = model_bytes(image, model)
    return report


def stack_reserved(image: Path) -> int:
    """Bytes that the linker script keeps for the stack."""
    at = {row[2]: int(row[0], 16) for line in tool("nm", str(image)).splitlines() if len(row := line.split()) == 3}
    return at["__stack_top"] - at["__stack_limit"]


def with_run(report: dict[str, int], firmware_report: Path) -> dict[str, int]:
    """Add what the replay measured."""
    if not firmware_report.is_file():
        print(f"size_report: no {firmware_report}: stack and instructions are left out (make firmware measures them)")
        return report
    run = json.loads(firmware_report.read_text())
    return report | {name: run[name] for name in RUN_FIGURES if name in run}


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, default=Path("build/firmware"), help="build folder of runtime/firmware")
    parser.add_argument("--firmware-report", type=Path, default=Path("build/reports/firmware.json"))
    parser.add_argument("--out", type=Path, default=Path("build/reports/size.json"))
    parser.add_argument("--model", default="aminn_model", help="prefix of the model in the image")
    args = parser.parse_args()
    report = with_run(measure(args.build, args.model), args.firmware_report)
    before = json.loads(args.out.read_text()) if args.out.is_file() else {}
    for name, value in report.items():
        change = value - before.get(name, value)
        print(f"  {name:40s} {value:9d}" + (f"  {change:+d}" if change else ""))
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=2, sort_keys=True) + "\n")
    print(f"Sizes on Cortex-M7: {args.out}")


if __name__ == "__main__":
    main()
