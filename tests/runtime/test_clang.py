"""Clang has no warning of the library, with which fuzz targets and the build for browsers are compiled."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror")
SOURCES = sorted([*ROOT.glob("runtime/src/*.cpp"), *ROOT.glob("runtime/host/*.cpp")])


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_no_warnings(source: Path) -> None:
    include = f"-I{ROOT / 'runtime/include'}"
    command = ["clang++-14", "-std=c++17", "-fsyntax-only", *WARNINGS, "-fno-exceptions", "-fno-rtti", include, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
