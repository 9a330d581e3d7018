"""Packages and their rooms import only what stands below them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = {
    "aminn_base": "tools/base",
    "aminn_hand": "tools/hand",
    "aminn_table": "tools/table",
    "aminn_rt": "tools/rt",
    "aminn": "trainer",
    "aminn_sim": "sim",
    "aminn_export": "tools/export",
    "aminn_app": "tools/app",
}
# Each may import those of the floors below, not those beside it.
FLOORS = (
    ("aminn_base",),
    ("aminn_hand",),
    ("aminn_rt", "aminn_table"),
    ("aminn", "aminn_sim"),
    ("aminn_export",),
    ("aminn_app",),
)
ROOMS = {
    "aminn": ("hand", "model", "data", "evaluation", "training", "calibration", "prediction", "pages"),
    "aminn_export": ("files", "samples", "replay", "judge", "export"),
}


def imports(package: str) -> Iterator[tuple[Path, str]]:
    """(file, dotted name) of everything that a package's files import, relative imports resolved."""
    top = ROOT / FOLDERS[package]
    for file in sorted((top / package).glob("**/*.py")):
        here = file.relative_to(top).parts[:-1]
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                yield from ((file, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                start = ".".join(here[: len(here) - node.level + 1]) if node.level else ""
                module = ".".join(part for part in (start, node.module) if part)
                yield file, module
                yield from ((file, f"{module}.{alias.name}") for alias in node.names)


def test_every_package_is_listed() -> None:
    found = {
        p.name for f in ("sim", "trainer", "tools/*") for p in ROOT.glob(f"{f}/aminn*") if (p / "__init__.py").is_file()
    }
    assert found == set(FOLDERS) == {name for floor in FLOORS for name in floor}


def test_packages_import_only_what_is_below_them() -> None:
    wrong = []
    for k, floor in enumerate(FLOORS):
        below = {name for lower in FLOORS[:k] for name in lower}
        for package in floor:
            for file, name in imports(package):
                other = name.split(".")[0]
                if other in FOLDERS and other != package and other not in below:
                    wrong.append(f"{file.relative_to(ROOT)} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_rooms_import_only_what_is_below_them() -> None:
    wrong, seen = [], set()
    for package, rooms in ROOMS.items():
        for file, name in imports(package):
            at, _, rest = name.partition(".")
            room = file.relative_to(ROOT / FOLDERS[package] / package).parts[0].removesuffix(".py")
            other = rest.split(".")[0]
            seen.add(room)
            if at == package and other in rooms and room in rooms and rooms.index(other) > rooms.index(room):
                wrong.append(f"{file.relative_to(ROOT)} imports {name}")
        assert set(rooms) <= seen
    assert not wrong, "\n".join(wrong)
