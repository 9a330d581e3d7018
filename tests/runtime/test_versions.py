"""One version everywhere; PlatformIO's file names what is there and the options that matter."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[2]
OPTIONS = re.findall(
    r"(?<=\s)-f[\w=-]+(?=[\s)])", re.sub("#.*", "", (TREE / "runtime/cmake/options.cmake").read_text())
)


def header_version() -> str:
    text = (TREE / "runtime/include/aminn_rt.h").read_text()
    parts = [re.search(rf"#define AMINN_VERSION_{part} (\d+)", text)[1] for part in ("MAJOR", "MINOR", "PATCH")]
    assert re.search(r'#define AMINN_VERSION_STRING "([^"]+)"', text)[1] == ".".join(parts)
    return ".".join(parts)


def cmake_version(file: str) -> str:
    return re.search(r"project\(\w+ VERSION (\S+)", (TREE / file).read_text())[1]


def test_versions_are_equal_everywhere() -> None:
    version = header_version()
    assert cmake_version("runtime/CMakeLists.txt") == version
    assert cmake_version("CMakeLists.txt") == version
    assert tomllib.loads((TREE / "pyproject.toml").read_text())["project"]["version"] == version
    assert json.loads((TREE / "library.json").read_text())["version"] == version


def test_the_format_version_is_the_exporters() -> None:
    from aminn_rt.blob import FORMAT_VERSION

    text = (TREE / "runtime/include/aminn_rt.h").read_text()
    assert int(re.search(r"#define AMINN_FORMAT_VERSION (\d+)u", text)[1]) == FORMAT_VERSION


def test_platformio_builds_the_library_as_cmake_does(tmp_path: Path) -> None:
    library = json.loads((TREE / "library.json").read_text())
    build = library["build"]
    sources = sorted((TREE / build["srcDir"]).glob("*.cpp"))
    assert {s.name for s in sources} == set(
        re.findall(r"src/(\w+\.cpp)", (TREE / "runtime/CMakeLists.txt").read_text())
    )
    assert (TREE / build["includeDir"] / library["headers"]).is_file()
    assert "-ffp-contract=off" in OPTIONS and sorted(["-std=c++17", *OPTIONS]) == sorted(build["flags"])
    assert build["flags"].index("-fno-fast-math") < build["flags"].index("-fno-math-errno"), "which it would undo"
    for example in library["examples"]:
        assert all((TREE / example["base"] / name).is_file() for name in example["files"])
    for source in sources:  # compiles with these flags alone
        command = ["g++", *build["flags"], f"-I{TREE / build['includeDir']}", "-c", str(source)]
        subprocess.run([*command, "-o", str(tmp_path / f"{source.stem}.o")], check=True)


@pytest.mark.parametrize(
    ("flag", "message"),
    [
        ("-std=c++14", "the library is C++17"),
        ("-ffast-math", "without -ffast-math"),
        ("-U__GNUC__", "not gcc, not clang"),
    ],
)
def test_options_that_cannot_work_are_refused_by_name(flag: str, message: str, tmp_path: Path) -> None:
    source = TREE / "runtime/src/input.cpp"
    command = ["g++", "-std=c++17", flag, f"-I{TREE / 'runtime/include'}", "-c", str(source), "-o", str(tmp_path / "o")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert message in next(line for line in done.stderr.splitlines() if "error:" in line)
