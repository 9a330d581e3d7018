"""The Zephyr module and its sample, held against the tree: Zephyr is in no package registry, so nothing builds it.

`test_bare_targets.py` stands in for its compiler; docs/runtime.md says what was built with the real one.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import kconfiglib
import pytest
import yaml

TREE = Path(__file__).resolve().parents[2]
SAMPLE = TREE / "zephyr/samples/grasp"
OPTIONS = re.findall(
    r"(?<=\s)-f[\w=-]+(?=[\s)])", re.sub("#.*", "", (TREE / "runtime/cmake/options.cmake").read_text())
)
DECLARED = """config CPP
\tbool "C++"
config FPU
\tbool "FPU"
config CPU_HAS_FPU
\tbool
\tdefault y
config MAIN_STACK_SIZE
\tint "Stack of main"
if CPP
choice STD_CPP
\tprompt "Standard"
\tdefault STD_CPP11
config STD_CPP11
\tbool "11"
config STD_CPP17
\tbool "17"
endchoice
endif
"""
"""What the module rests on of Zephyr's own settings, which come after those of modules."""


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
    (tmp_path / "Kconfig").write_text(f'source "{TREE}/zephyr/Kconfig"\n{DECLARED}')
    kconfig = kconfiglib.Kconfig(str(tmp_path / "Kconfig"), warn_to_stderr=False)
    ours = {symbol.name for symbol in kconfig.unique_defined_syms if symbol.name.startswith("AMINN")}
    assert ours == set(re.findall(r"CONFIG_(AMINN\w+)", (TREE / "zephyr/CMakeLists.txt").read_text()))
    assert kconfig.syms["AMINN_RT"].str_value == "n"
    assert kconfig.syms["STD_CPP11"].str_value == "n" and kconfig.syms["CPP"].str_value == "n"
    kconfig.load_config(str(SAMPLE / "prj.conf"))
    assert kconfig.syms["CPP"].str_value == "y"
    assert kconfig.syms["STD_CPP17"].str_value == "y" and kconfig.syms["STD_CPP11"].str_value == "n"
    width = re.search(r"#define AMINN_MAX_WIDTH (\d+)", (TREE / "runtime/include/aminn_rt.h").read_text())[1]
    assert kconfig.syms["AMINN_RT_MAX_WIDTH"].str_value == width
    assert kconfig.syms["FPU"].str_value == "y"
    assert not kconfig.warnings
    assert all(symbol.nodes[0].help for symbol in kconfig.unique_defined_syms if symbol.name in ours)


def test_the_sample_prints_what_twister_looks_for(tmp_path: Path, people: dict[str, object]) -> None:
    """Its program as it stands, on this machine: printk is the C library's printf."""
    tests = yaml.safe_load((SAMPLE / "sample.yaml").read_text())
    assert tests["tests"] and tests["common"]["harness"] == "console"
    sources = re.findall(r"app PRIVATE (src/\S+)", (SAMPLE / "CMakeLists.txt").read_text())
    assert yaml.safe_load((TREE / "zephyr/module.yml").read_text())["samples"] == ["zephyr/samples"]
    header = tmp_path / "zephyr/sys/printk.h"
    header.parent.mkdir(parents=True)
    header.write_text("#include <stdio.h>\n#define printk printf\n")
    golden, program = TREE / "tests/golden", tmp_path / "sample"
    library = tmp_path / "every.cpp"
    library.write_text("".join(f'#include "{source}"\n' for source in sorted((TREE / "runtime/src").glob("*.cpp"))))
    include = [f"-I{tmp_path}", f"-I{golden}", f"-I{TREE / 'runtime/include'}"]
    subprocess.run(
        ["g++", "-std=c++17", "-O0", "-DAMINN_RT_SCALAR", *include, "-c", library, "-o", tmp_path / "library.o"],
        check=True,
    )
    c = [*(SAMPLE / source for source in sources), golden / "aminn_model.c", tmp_path / "library.o"]
    subprocess.run(["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", *include, *c, "-lm", "-o", program], check=True)
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    for line in tests["common"]["harness_config"]["regex"]:
        assert re.search(line, said), said
    people["example_zephyr"] = True
