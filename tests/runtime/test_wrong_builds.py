"""aminn_self_test() finds a core that was compiled wrongly, and names how; one that was not passes.

The core alone is compiled with each option, without the sources' own guard against it (compiler.hpp).
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[2]
RUNTIME = TREE / "runtime"
UNGUARDED = "-DAMINN_SRC_COMPILER_HPP"
PROGRAM = """
#include <stdio.h>
#include "aminn_model.h"
static aminn_t ctx;
int main(void)
{
    aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
    status = status == AMINN_OK ? aminn_self_test(&ctx) : status;
    puts(aminn_status_name(status));
    return 0;
}
"""
OPTIONS = "-std=c++17 -fno-exceptions -fno-rtti -fno-math-errno -fno-trapping-math".split()
REORDERED = "-fassociative-math -fno-signed-zeros -fno-trapping-math"


def compile_cxx(compiler: str, flags: str, source: Path, out: Path) -> None:
    command = [compiler, *OPTIONS, "-O2", *flags.split(), f"-I{RUNTIME / 'include'}", "-c", str(source), "-o", str(out)]
    subprocess.run(command, check=True, capture_output=True)


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything but the core, compiled as it should be."""
    folder = tmp_path_factory.mktemp("objects")
    (folder / "program.c").write_text(PROGRAM)
    for source in (RUNTIME / "src").glob("*.cpp"):
        compile_cxx("g++", "-ffp-contract=off", source, folder / f"{source.stem}.o")
    for source in (folder / "program.c", TREE / "tests" / "golden" / "aminn_model.c"):
        include = [f"-I{RUNTIME / 'include'}", f"-I{source.parent}", f"-I{TREE / 'tests' / 'golden'}"]
        subprocess.run(["cc", *include, "-c", str(source), "-o", str(folder / f"{source.stem}.o")], check=True)
    return folder


def answer(objects: Path, tmp_path: Path, link: str = "", **other: Path) -> str:
    """What the program prints with some objects in the place of the good ones."""
    files = [other.get(file.stem, file) for file in sorted(objects.glob("*.o"))]
    program = tmp_path / "program"
    subprocess.run(["gcc", *link.split(), *map(str, files), "-lm", "-o", str(program)], check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True)
    return done.stdout.strip() or f"signal {-done.returncode}"


CASES = [
    ("g++", "-ffp-contract=off", "AMINN_OK"),
    ("g++", "-O3 -mavx2 -mfma -ffp-contract=off", "AMINN_OK"),
    ("g++", "-mavx2 -mfma -ffp-contract=fast", "AMINN_E_CONTRACTED"),
    ("g++", f"-ffp-contract=off {REORDERED}", "AMINN_E_FAST_MATH"),
    ("g++", "-ffp-contract=off -freciprocal-math", "AMINN_E_FAST_MATH"),
    ("g++", "-ffp-contract=off -funsafe-math-optimizations", "AMINN_E_FAST_MATH"),
    ("g++", "-ffp-contract=off -ffast-math -mrecip", "AMINN_E_FAST_MATH"),
    ("clang++-14", "-ffp-contract=off", "AMINN_OK"),
    ("clang++-14", "-mavx2 -mfma -ffp-contract=fast", "AMINN_E_CONTRACTED"),
    ("clang++-14", f"-ffp-contract=off {REORDERED}", "AMINN_E_FAST_MATH"),
    ("clang++-14", "-ffp-contract=off -freciprocal-math", "AMINN_E_FAST_MATH"),
]


@pytest.mark.parametrize(("compiler", "flags", "name"), CASES)
def test_a_wrong_core_is_named(
    objects: Path, tmp_path: Path, trust: dict[str, int], compiler: str, flags: str, name: str
) -> None:
    if shutil.which(compiler) is None or ("-mfma" in flags and "fma" not in Path("/proc/cpuinfo").read_text()):
        pytest.skip(f"no {compiler}, or a processor without FMA")
    core = tmp_path / "cascade.o"
    compile_cxx(compiler, f"{UNGUARDED} {flags}", RUNTIME / "src" / "cascade.cpp", core)
    assert answer(objects, tmp_path, cascade=core) == name
    if name != "AMINN_OK":
        trust["self_test_wrong_cores_named"] = trust.get("self_test_wrong_cores_named", 0) + 1


def test_a_wrong_closure_is_named(objects: Path, tmp_path: Path) -> None:
    """Two states of five have the same closure with fused products: the known answer alone would not tell."""
    if "fma" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("a processor without FMA")
    closure = tmp_path / "closure.o"
    compile_cxx("g++", f"{UNGUARDED} -mfma -ffp-contract=fast", RUNTIME / "src" / "closure.cpp", closure)
    assert answer(objects, tmp_path, closure=closure) == "AMINN_E_CONTRACTED"


def test_a_program_linked_with_fast_math_flushes_to_zero(objects: Path, tmp_path: Path) -> None:
    """gcc then adds a start-up object that sets the processor's mode, whatever the sources were compiled with."""
    assert answer(objects, tmp_path, link="-ffast-math") == "AMINN_E_FLUSH"
