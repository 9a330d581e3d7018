"""Collect what the campaigns found in one report.

reliability.py build/reports/reliability build/reports/reliability.json

Each campaign writes a part, NAME.json, flat figures, whole. Parts and the targets that make them are in PARTS. What is
missing, and what misses its aim, is listed in `aims_missed`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from aminn_base.files import write_json
from aminn_base.read import read_json

Figures = dict[str, float]

PARTS = {
    "powercut": "make powercut",
    "powercut_seeds": "make powercut",
    "fuzz_files": "make fuzz-files",
    "corrupt": "make corrupt",
    "corrupt_files": "make corrupt",
    "soak_sim": "make soak-sim",
    "fuzz": "make fuzz",
    "properties": "make properties",
    "differential": "make differential",
    "soak": "make soak",
    "defects_runtime": "make defects",
    "races_simulator": "make races",
}
NONE = ("faults", "broken", "silent", "failed", "crashes", "different")
"""Ends of names of figures that are to be 0."""
SEEDS_AIM, EXECUTIONS_AIM = 20, 2e7


def total(figures: Figures, ending: str) -> float:
    """Sum of the figures whose names end so."""
    return sum(value for name, value in figures.items() if name.endswith(ending))


AIMS: dict[str, Callable[[Figures], bool]] = {
    f"{EXECUTIONS_AIM:.0e} executions of the runtime's fuzz targets": lambda f: (
        f.get("fuzz_executions", 0) >= EXECUTIONS_AIM
    ),
    f"{SEEDS_AIM} planted defects": lambda f: total(f, "_seeds") >= SEEDS_AIM,
}


def missed(figures: Figures) -> Iterator[str]:
    """Rules that hold for every part, by the ends of names: nothing broke, all survived, all seeds were found."""
    for name, value in figures.items():
        stem, _, end = name.rpartition("_")
        if end in NONE and value:
            yield f"{name} is {value:g}, expected 0"
        if end in ("survived", "found") and stem in figures and value != figures[stem]:
            yield f"{name} is {value:g} of {figures[stem]:g}"
    yield from (f"not reached: {text}" for text, is_met in AIMS.items() if not is_met(figures))


def main(parts: Path, report: Path) -> None:
    """Read the parts, judge, write."""
    figures: dict[str, float | str] = {}
    absent = [
        f"{name}: no figures yet ({target})" for name, target in PARTS.items() if not (parts / f"{name}.json").is_file()
    ]
    for file in sorted(parts.glob("*.json")):
        figures |= {
            name: value for name, value in read_json(file, "a part of the report").items() if name != "aims_missed"
        }
    numbers = {name: float(value) for name, value in figures.items() if isinstance(value, int | float)}
    lines = [*absent, *missed(numbers)]
    write_json(report, figures | {"aims_missed": "; ".join(lines)})
    print("\n".join(lines) or "All parts are there, every aim is met")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
