"""The library on bare targets: one line of CMake builds it, and it asks for no C++ library.

The compiler's own headers stand in for a build in Zephyr, which is in no package registry: its default C++ library has
no headers.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[2]
RUNTIME = TREE / "runtime"
COMPILER = "arm-none-eabi-g++"
ASKED_OF_C = {"memcmp", "memcpy", "memmove", "memset"}
"""What gcc calls in any program, freestanding or not."""
OPTIONS = "-std=c++17 -mthumb -Os -ffreestanding -nostdinc -fno-exceptions -fno-rtti -fno-math-errno -Wall -Werror"


@pytest.mark.parametrize(
    ("processor", "root"), [("cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard", set()), ("cortex-m0plus", {"sqrtf"})]
)
def test_the_compilers_own_headers_are_enough(
    processor: str, root: set[str], tmp_path: Path, people: dict[str, object]
) -> None:
    own = subprocess.run([COMPILER, "-print-file-name=include"], capture_output=True, text=True, check=True)
    every = tmp_path / "every.cpp"
    every.write_text("".join(f'#include "{source}"\n' for source in sorted((RUNTIME / "src").glob("*.cpp"))))
    command = [COMPILER, *f"{OPTIONS} -mcpu={processor}".split(), "-isystem", own.stdout.strip()]
    subprocess.run([*command, f"-I{RUNTIME / 'include'}", "-c", str(every), "-o", str(tmp_path / "o")], check=True)
    undefined = subprocess.run(["arm-none-eabi-nm", "-uj", tmp_path / "o"], capture_output=True, text=True, check=True)
    asked = {name for name in undefined.stdout.split() if not name.startswith("__aeabi_")}
    assert asked == ASKED_OF_C | root
    people["package_zephyr"] = "compiled"


def test_the_documented_line_builds_for_a_bare_target(tmp_path: Path) -> None:
    page = (TREE / "docs/runtime.md").read_text()
    line = re.search(r"^    cmake -S runtime -B (\S+) (--toolchain .*) && ", page, re.MULTILINE)
    build = tmp_path / "build"
    configure = ["cmake", "-S", RUNTIME, "-B", build, "-G", "Ninja", *line[2].split()]
    subprocess.run(configure, check=True, capture_output=True)
    subprocess.run(["cmake", "--build", build], check=True, capture_output=True)
    assert not (build / "aminn_replay").exists() and not (build / "aminn_replay.elf").exists()
    assert "CMAKE_BUILD_TYPE:STRING=MinSizeRel" in (build / "CMakeCache.txt").read_text()
    read = ["arm-none-eabi-readelf", "-A", build / "libaminn_rt.a"]
    attributes = subprocess.run(read, capture_output=True, text=True, check=True).stdout
    assert "Tag_FP_arch: VFPv4-D16" in attributes and "Tag_ABI_VFP_args: VFP registers" in attributes
    refused = subprocess.run([*configure, "-DCORE=cortex-m99", "--fresh"], capture_output=True, text=True)
    assert refused.returncode and "CORE=cortex-m99: expected cortex-m0plus" in refused.stderr
