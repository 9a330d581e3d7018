#!/usr/bin/env python3
"""What the runtime costs on Cortex-M cores: text, model, RAM, worst-case stack, instructions; as JSON with flat keys.

    python3 runtime/tools/size_report.py cortex_m7=build/firmware:build/reports/firmware.json ...

Each argument names a core, the build folder of runtime/firmware for its board, and the report of its replay in qemu.
The stack is the deepest path of the compiler's own call graph (-fcallgraph-info=su), the instructions are qemu's.
Prints each figure with its change since the previous report, and the aims that are missed. Needs arm-none-eabi
binutils and the standard library alone.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

TOOLS = "arm-none-eabi-"
ENTRY = "aminn_predict_state"
SELF_TEST_ENTRY = "aminn_self_test"
# Frames of the C library's functions that the runtime calls (newlib-nano, read off their disassembly).
LIBRARY_FRAMES = {"memcpy": 8, "memset": 8, "memmove": 8, "memcmp": 8}
# What the call graph does not name: of the functions that a context may point to the one that is always linked. That of
# aminn_sense() lies no deeper than the prediction that follows it.
INDIRECT = {"__indirect_call": "aminn_correct"}
PUSH_ENTRY = "aminn_calibrate_push"
LOAD_ENTRY = "aminn_admissible_load"
RUN_FIGURES = (
    *("context_bytes", "stack_predict_bytes", "instructions_per_prediction", "instructions_worst"),
    *("self_test_instructions", "stack_load_bytes", "instructions_load_worst"),
    *("calibration_bytes", "calibrator_bytes", "stack_push_bytes", "instructions_per_push", "instructions_push_worst"),
)
AIMS = {
    "library_text_bytes": 8150,
    "self_test_text_bytes": 425,
    "context_bytes": 4000,
    "stack_worst_bytes": 3000,
    "instructions_per_mac": 3.0,
    "push_predictions": 2.0,
    "push_ram_bytes": 2048,
}
FORBIDDEN = re.compile(
    r"^_*(malloc|free|calloc|realloc|sbrk|cxa_\w+|Unwind_\w+|gxx_personality\w*|stack_chk_\w+|\w*printf\w*|f?puts|fopen|fwrite"
    r"|aeabi_d\w+|aeabi_\w+2d|\w+df[23]|Zn[wa]\w*|Zd[la]\w*)(_r)?$"
)


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


def listed(path: Path) -> list[str]:
    """Lines of nm for an image, or for an archive, whose members have a line with their name each."""
    return tool("nm", "-S", "--defined-only", str(path)).splitlines()


def symbols(lines: list[str]) -> dict[str, tuple[int, str]]:
    """(bytes, kind) of each symbol with a size."""
    rows = [line.split() for line in lines]
    return {row[3]: (int(row[1], 16), row[2]) for row in rows if len(row) == 4}


# Symbols that aminn_self_test() alone needs in an image without the loader of binary models.
SELF_TEST = re.compile(r"aminn_self_test|probe_arithmetic|probe_closure|5probeEvE|5crc32E")


# Members of the archive, and a function beside them, that an image which calibrates nothing has none of.
CALIBRATION = re.compile(r"^calibrate(_\w+)?\.cpp\.")
CALIBRATION_CORE = re.compile(r"10run_motion")
# And that of one which looks for no largest load.
LOAD = re.compile(r"^admissible\.cpp\.")
# And that of one which is told of no sensors.
SENSE = re.compile(r"^sense\.cpp\.")


def of_members(archive: Path, members: re.Pattern[str], core: re.Pattern[str] = re.compile(r"$^")) -> set[str]:
    """Symbols that some members of the archive alone need, and those of `core`."""
    alone: set[str] = set()
    others: set[str] = set()
    into = others
    for line in listed(archive):
        if line.endswith(":"):
            into = alone if members.match(line) else others
        else:
            into.update(symbols([line]))
    return {name for name in alone | others if name not in others or core.search(name)}


def library_text(archive: Path, image: Path) -> dict[str, int]:
    """Bytes of code and constants: in the image without what only some call, these parts, in the archive."""
    found = symbols(listed(archive))
    own = {name: size for name, (size, kind) in found.items() if kind in "tTwWrRvV"}
    linked = {name for name, (_, kind) in symbols(listed(image)).items() if kind in "tTwWrRvV"}
    writable = [name for name, (_, kind) in found.items() if kind in "dDbBC"]
    calibration, load = of_members(archive, CALIBRATION, CALIBRATION_CORE), of_members(archive, LOAD)
    sense = of_members(archive, SENSE)
    if writable:
        die(f"{archive}: holds writable data: {', '.join(writable)}")
    rest = {n: s for n, s in own.items() if n in linked and n not in calibration | load | sense}
    return {
        "library_text_bytes": sum(s for n, s in rest.items() if not SELF_TEST.search(n)),
        "self_test_text_bytes": sum(s for n, s in rest.items() if SELF_TEST.search(n)),
        "calibration_text_bytes": sum(s for n, s in own.items() if n in linked and n in calibration),
        "admissible_load_text_bytes": sum(s for n, s in own.items() if n in linked and n in load),
        "sense_text_bytes": sum(s for n, s in own.items() if n in linked and n in sense),
        "archive_text_bytes": sum(own.values()),
    }


def strings(linker_map: Path) -> int:
    """Bytes of the library's string literals in the image: the names of the status codes, which have no symbol."""
    layout = linker_map.read_text().partition("Linker script and memory map")[2]
    sections = re.findall(r"^ \.rodata(?:\S*\.str\S*)?\s+0x\w+\s+0x(\w+)\s+\S*libaminn_rt\.a\(", layout, re.MULTILINE)
    return sum(int(size, 16) for size in sections)


def model_bytes(image: Path, prefix: str) -> int:
    """Bytes of the model's tables in the image: constants whose names are the prefix or start with it."""
    found = symbols(listed(image)).items()
    return sum(size for name, (size, kind) in found if kind in "rR" and f"{name}_".startswith(f"{prefix}_"))


def forbidden(image: Path) -> list[str]:
    """Symbols that must not be in the image: allocator, exceptions, guards, stdio, double precision in software."""
    rows = [line.split() for line in tool("nm", str(image)).splitlines()]
    return sorted({row[-1] for row in rows if FORBIDDEN.match(row[-1])})


class CallGraph:
    """Frames and calls of all objects below a folder, from the compiler's .ci files."""

    def __init__(self, folder: Path) -> None:
        self.frames: dict[str, int] = {}
        self.calls: dict[str, set[str]] = {}
        files = sorted(folder.rglob("*.ci"))
        if not files:
            die(f"{folder}: no call graph (*.ci); build with the project's CMake files")
        for file in files:
            self._read(file.read_text())

    def _read(self, text: str) -> None:
        for title, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', text):
            frame = re.search(r"(\d+) bytes \((\w+(?:,\w+)?)\)", label)
            if frame:
                if frame[2] not in ("static", "dynamic,bounded"):
                    die(f"{title}: its frame is {frame[2]}: the stack has no bound")
                self.frames[self._name(title)] = int(frame[1])
        for source, target in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            self.calls.setdefault(self._name(source), set()).add(self._name(target))

    @staticmethod
    def _name(title: str) -> str:
        name = title.rsplit(":", 1)[-1]
        return INDIRECT.get(name, name)

    def depth(self, name: str, above: tuple[str, ...] = ()) -> int:
        """Bytes of the deepest path from a function on."""
        if name in above:
            die(f"{name} calls itself: {' '.join(above)}")
        if name not in self.frames and name not in LIBRARY_FRAMES:
            die(f"{name} is called by {above[-1] if above else 'nobody'} and has no known frame")
        own = self.frames.get(name, LIBRARY_FRAMES.get(name, 0))
        return own + max((self.depth(callee, (*above, name)) for callee in self.calls.get(name, ())), default=0)


def multiply_accumulates(source: Path, model: str) -> int:
    """Weights of the model but for zeros, which fill up rows: each is used once in a prediction with both stages."""
    tables = re.findall(rf"static const \w+ {model}_\w+_w\[\d+\] = {{(.*?)}};", source.read_text(), re.DOTALL)
    return sum(literal.strip() not in ("0.0f", "0x0000u") for table in tables for literal in table.split(","))


def measure(build: Path, report: Path, model_source: Path) -> dict[str, float]:
    """All figures of one core."""
    archive, image = build / "aminn_rt" / "libaminn_rt.a", build / "aminn_firmware.elf"
    for path in (archive, image, report, model_source):
        if not path.is_file():
            die(f"{path}: not there; build and run runtime/firmware first (make size does)")
    bad = forbidden(image)
    if bad:
        die(f"{image} holds what it must not: {', '.join(bad)}")
    run = json.loads(report.read_text())
    macs = multiply_accumulates(model_source, model_source.stem)
    figures: dict[str, float] = dict(library_text(archive, image))
    figures["library_strings_bytes"] = strings(build / "aminn_firmware.map")
    figures["model_flash_bytes"] = model_bytes(image, model_source.stem)
    figures |= {name: run[name] for name in RUN_FIGURES if name in run}
    calls = CallGraph(build / "aminn_rt")
    figures["stack_worst_bytes"] = calls.depth(ENTRY)
    figures["self_test_stack_bytes"] = calls.depth(SELF_TEST_ENTRY)
    figures["push_stack_worst_bytes"] = calls.depth(PUSH_ENTRY)
    figures["admissible_load_stack_worst_bytes"] = calls.depth(LOAD_ENTRY)
    figures["push_ram_bytes"] = (
        run["calibrator_bytes"] - run["calibration_bytes"] + calls.depth(PUSH_ENTRY) - calls.depth(ENTRY)
    )
    figures["push_predictions"] = round(run["instructions_per_push"] / run["instructions_per_prediction"], 3)
    figures["multiply_accumulates"] = macs
    figures["instructions_per_mac"] = round(run["instructions_per_prediction"] / macs, 3)
    return figures


def missed_aims(report: dict[str, float | str], cores: list[str]) -> list[str]:
    """Aims that a core does not meet."""
    return [
        f"{core}_{name}" for core in cores for name, aim in AIMS.items() if not float(report[f"{core}_{name}"]) <= aim
    ]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cores", nargs="+", help="CORE=BUILD_FOLDER:REPLAY_REPORT")
    parser.add_argument("--out", type=Path, default=Path("build/reports/size.json"))
    parser.add_argument("--model", type=Path, default=Path("tests/golden/aminn_model.c"), help="C model in the images")
    args = parser.parse_args()
    report: dict[str, float | str] = {}
    names = []
    for item in args.cores:
        core, _, paths = item.partition("=")
        build, _, run = paths.rpartition(":")
        names.append(core)
        report |= {f"{core}_{key}": value for key, value in measure(Path(build), Path(run), args.model).items()}
    report["aims_missed"] = ", ".join(missed_aims(report, names))
    before = json.loads(args.out.read_text()) if args.out.is_file() else {}
    for name, value in report.items():
        if isinstance(value, str):
            continue
        old = before.get(name, value)
        print(f"  {name:44s} {value:>10}" + (f"  {value - old:+g}" if value != old else ""))
    print(f"  aims missed: {report['aims_missed'] or 'none'}")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=2, sort_keys=True) + "\n")
    print(f"Sizes on {', '.join(names)}: {args.out}")


if __name__ == "__main__":
    main()
