"""One version everywhere; the module files of Zephyr and PlatformIO name what is there and the options that matter."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from pathlib import Path

import kconfiglib
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
    ("flag", "message"), [("-std=c++14", "the library is C++17"), ("-ffast-math", "without -ffast-math")]
)
def test_options_that_cannot_work_are_refused_by_name(flag: str, message: str, tmp_path: Path) -> None:
    source = TREE / "runtime/src/input.cpp"
    command = ["g++", "-std=c++17", flag, f"-I{TREE / 'runtime/include'}", "-c", str(source), "-o", str(tmp_path / "o")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert message in next(line for line in done.stderr.splitlines() if "error:" in line)


@pytest.mark.parametrize("hand", ["", "src/aminn_hand.h"])
def test_zephyr_module_is_complete(hand: str, tmp_path: Path) -> None:
    """CMake runs the module's file with Zephyr's functions replaced by ones that print what they are given."""
    module = (TREE / "zephyr/module.yml").read_text()
    assert (TREE / re.search(r"cmake: (\S+)", module)[1] / "CMakeLists.txt").is_file()
    assert (TREE / re.search(r"kconfig: (\S+)", module)[1]).is_file()
    names = (
        "library_named",
        "library_sources",
        "library_compile_options",
        "include_directories",
        "compile_definitions",
    )
    functions = "\n".join(f'function(zephyr_{n})\n  message("{n} ${{ARGN}}")\nendfunction()' for n in names)
    settings = f'set(CONFIG_AMINN_RT y)\nset(CONFIG_AMINN_RT_MAX_WIDTH 64)\nset(CONFIG_AMINN_RT_HAND "{hand}")'
    settings += f'\nset(APPLICATION_SOURCE_DIR "{tmp_path}/my app")'
    script = f"{functions}\n{settings}\ninclude({TREE}/zephyr/CMakeLists.txt)\n"
    (tmp_path / "run.cmake").write_text(script)
    done = subprocess.run(["cmake", "-P", str(tmp_path / "run.cmake")], capture_output=True, text=True, check=True)
    assert "cascade.cpp" in done.stderr
    assert "AMINN_MAX_WIDTH=64" in done.stderr
    assert (f'AMINN_HAND_HEADER="{tmp_path}/my app/{hand}"' in done.stderr) == bool(hand)
    assert ("AMINN_HAND_HEADER" in done.stderr) == bool(hand)
    assert all(option in done.stderr for option in OPTIONS)


def test_zephyr_settings_are_what_the_module_reads(tmp_path: Path) -> None:
    """Zephyr's symbols that the file rests on are declared here; the rest is parsed as Zephyr parses it."""
    declared = "".join(f"config {name}\n\tbool {prompt}\n" for name, prompt in (("CPP", '"C++"'), ("FPU", '"FPU"')))
    (tmp_path / "Kconfig").write_text(
        f'{declared}config CPU_HAS_FPU\n\tbool\n\tdefault y\nsource "{TREE}/zephyr/Kconfig"\n'
    )
    kconfig = kconfiglib.Kconfig(str(tmp_path / "Kconfig"), warn_to_stderr=False)
    ours = {symbol.name for symbol in kconfig.unique_defined_syms if symbol.name.startswith("AMINN")}
    assert ours == set(re.findall(r"CONFIG_(AMINN\w+)", (TREE / "zephyr/CMakeLists.txt").read_text()))
    assert kconfig.syms["AMINN_RT"].str_value == "n"
    for name in ("CPP", "AMINN_RT"):
        kconfig.syms[name].set_value("y")
    width = re.search(r"#define AMINN_MAX_WIDTH (\d+)", (TREE / "runtime/include/aminn_rt.h").read_text())[1]
    assert kconfig.syms["AMINN_RT_MAX_WIDTH"].str_value == width
    assert kconfig.syms["FPU"].str_value == "y"
    assert not kconfig.warnings
