"""One version in every file that states it, and the linters of pre-commit at those of constraints.txt."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PLACES = {
    "pyproject.toml": r'^version = "(.*)"$',
    "trainer/aminn/__init__.py": r'^__version__ = "(.*)"$',
    "CMakeLists.txt": r"^project\(aminn VERSION (\S+)",
    "runtime/CMakeLists.txt": r"^project\(aminn_rt VERSION (\S+)",
    "runtime/meson.build": r" version: '(.*?)',",
    "packaging/arduino/library.properties": r"^version=(.*)$",
    "packaging/cmsis/AMINN.aminn_rt.pdsc": r'(?:<release version|Cversion)="(.*?)"',
    "packaging/vcpkg/vcpkg.json": r'^  "version": "(.*)",$',
    "idf_component.yml": r'^version: "(.*)"$',
    "runtime/include/aminn_rt.h": r'^#define AMINN_VERSION_STRING "(.*)"$',
    "library.json": r'^  "version": "(.*)",$',
    "CITATION.cff": r"^version: (.*)$",
    "CHANGELOG.md": r"(?s)\A.*?^## (\d\S*),",  # the newest
}
VERSION = re.search(PLACES["pyproject.toml"], (ROOT / "pyproject.toml").read_text(), re.MULTILINE)[1]


@pytest.mark.parametrize("file", PLACES)
def test_the_version_is_the_same_everywhere(file: str) -> None:
    assert set(re.findall(PLACES[file], (ROOT / file).read_text(), re.MULTILINE)) == {VERSION}


def test_no_other_file_states_a_version() -> None:
    """Such as a recipe of another package manager: it is to be listed above."""
    stated = re.compile(rf"\bversion\b.{{0,12}}{re.escape(VERSION)}\b", re.IGNORECASE)
    kinds = {".cff", ".cmake", ".json", ".pdsc", ".properties", ".py", ".toml", ".txt", ".yaml", ".yml", ".build"}
    tops = [top for top in ROOT.iterdir() if top.name not in ("build", "tests", ".git", ".venv")]
    files = [file for top in tops for file in (top.rglob("*") if top.is_dir() else [top]) if file.suffix in kinds]
    assert {str(f.relative_to(ROOT)) for f in files if stated.search(f.read_text())} <= set(PLACES)


def test_pre_commit_has_the_linters_of_constraints() -> None:
    pins = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    named = re.findall(r"\[([\w-]+)==([^\]]+)\]", (ROOT / ".pre-commit-config.yaml").read_text())
    assert {name for name, _ in named} == {"ruff", "clang-format", "typos"}
    assert [(name, version) for name, version in named if pins[name] != version] == []
