"""The machines and compilers that the runtime is replayed on: what to build, and how to run it.

A hosted target is the library's sources, an exported model and `aminn_replay` in one program, run on this machine or in
qemu's user mode. `WASM` is the library as a WebAssembly module in Node. A board is a firmware image in qemu. Each turns
a vector file into a result file; if all is well they all write the same bytes.
"""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from aminn_base.errors import AminnError
from aminn_base.run import run_program
from aminn_rt.sources import runtime_source

from ..files.hand_header import header_beside
from .firmware import IMAGES, build_firmware, run_firmware
from .options import own_options
from .runtime_place import REPLAY_SOURCES
from .wasm import build_wasm, replay_wasm

DEBIAN_PACKAGES = (
    "clang-14 qemu-user g++-aarch64-linux-gnu g++-arm-linux-gnueabihf g++-riscv64-linux-gnu g++-powerpc-linux-gnu "
    "g++-s390x-linux-gnu"
)


@dataclass(frozen=True)
class Hosted:
    """A compiler, its options, and the program that runs what it makes ("" for this machine)."""

    compiler: str
    flags: str
    emulator: str = ""

    @property
    def cxx(self) -> str:
        """The C++ compiler that belongs to the C compiler."""
        return self.compiler.replace("gcc", "g++").replace("clang", "clang++")


HOSTED = {
    "x86_64_gcc_O0": Hosted("gcc", "-O0"),
    "x86_64_gcc_O2": Hosted("gcc", "-O2"),
    "x86_64_gcc_O3": Hosted("gcc", "-O3"),
    "x86_64_gcc_O3_avx2_fma": Hosted("gcc", "-O3 -mavx2 -mfma"),
    "x86_64_gcc_O3_scalar": Hosted("gcc", "-O3 -DAMINN_RT_SCALAR"),
    "x86_64_clang_O0": Hosted("clang-14", "-O0"),
    "x86_64_clang_O2": Hosted("clang-14", "-O2"),
    "x86_64_clang_O3": Hosted("clang-14", "-O3"),
    "x86_64_clang_O3_avx2_fma": Hosted("clang-14", "-O3 -mavx2 -mfma"),
    "aarch64_gcc_O2": Hosted("aarch64-linux-gnu-gcc", "-O2", "qemu-aarch64"),
    "armhf_gcc_O3_neon": Hosted("arm-linux-gnueabihf-gcc", "-O3 -mfpu=neon", "qemu-arm"),
    "riscv64_gcc_O2": Hosted("riscv64-linux-gnu-gcc", "-O2", "qemu-riscv64"),
    "powerpc_gcc_O2": Hosted("powerpc-linux-gnu-gcc", "-O2", "qemu-ppc"),
    "s390x_gcc_O2": Hosted("s390x-linux-gnu-gcc", "-O2", "qemu-s390x"),
}
# The library as CMake builds it for x86-64, which asks the processor for its widest core: this machine's, and those of
# processors that qemu stands in for.
DISPATCHED = {
    "x86_64_library": "",
    "x86_64_library_avx2": "qemu-x86_64 -cpu Haswell",
    "x86_64_library_sse2": "qemu-x86_64 -cpu Nehalem",
}
WASM = "wasm32_clang_O2"
"""Runs in Node."""
TARGETS = (*HOSTED, *DISPATCHED, WASM, *IMAGES)
SLOW = frozenset(name for name, board in IMAGES.items() if board.slow)


def run(command: list[str], what: str) -> str:
    """`run_program` with what these targets need of Debian."""
    return run_program(command, what, packages=DEBIAN_PACKAGES)


def build_hosted(target: Hosted, model_dir: Path, prefix: str, build_dir: Path) -> Path:
    """Compile library, model and replay program; returns the program."""
    build_dir.mkdir(parents=True, exist_ok=True)
    header, runtime = header_beside(model_dir), runtime_source()
    include = [f"-I{runtime / 'include'}", f"-I{model_dir}"]
    include += [f'-DAMINN_HAND_HEADER="{header}"'] if header else []
    model = [f'-DAMINN_REPLAY_HEADER="{prefix}.h"', f"-DAMINN_REPLAY_MODEL={prefix}"]
    flags = target.flags.split()
    jobs = [
        [target.cxx, "-std=c++17", *own_options(), *flags, *include, "-c", str(s)]
        for s in (runtime / "src").glob("*.cpp")
    ]
    c_sources = [model_dir / f"{prefix}.c", *(runtime / "tools" / name for name in REPLAY_SOURCES)]
    jobs += [[target.compiler, "-std=c99", *flags, *model, *include, "-c", str(s)] for s in c_sources]
    objects = []
    for job in jobs:
        objects.append(str(build_dir / (Path(job[-1]).stem + ".o")))
        run([*job, "-o", objects[-1]], f"compiling {Path(job[-1]).name} with {job[0]} {target.flags}")
    program = build_dir / "aminn_replay"
    static = ["-static"] if target.emulator else []
    run([target.compiler, *static, *objects, "-lm", "-o", str(program)], f"linking with {target.compiler}")
    return program


def build_library(build_dir: Path, hand: Path | None) -> Path:
    """Build library and tools by CMake, for a hand's header; returns the replay program, which takes a binary model."""
    options = ["-DCMAKE_BUILD_TYPE=Release", f"-DAMINN_HAND={hand or ''}"]
    run(["cmake", "-S", str(runtime_source()), "-B", str(build_dir), *options], "cmake")
    run(["cmake", "--build", str(build_dir), "--target", "aminn_replay"], "building the library")
    return build_dir / "aminn_replay"


def _figures(text: str, name: str) -> dict[str, int]:
    """What the replay program tells of a calibration and of largest loads.

    Raises AminnError unless it found the library sound; a board's image stops by itself.
    """
    found = re.search(r"self-test (\w+)", text)
    if found is None or found[1] != "AMINN_OK":
        raise AminnError(f"{name}: the library's self-test says {found[1] if found else 'nothing'}")
    return {key: int(value) for key, value in re.findall(r"\b(pushes|calibration_crc|loads_crc) (\d+)", text)}


def replay(name: str, model_dir: Path, prefix: str, vectors: Path, work: Path) -> tuple[Path, dict[str, int]]:
    """Build target `name` with the C model PREFIX of `model_dir` and replay a vector file on it, in the folder `work`.

    Returns the result file and the target's own figures (`pushes`, `calibration_crc`, `loads_crc`; of boards also stack
    and instructions). Raises AminnError where something is missing, does not compile, or fails.
    """
    if name not in TARGETS:
        raise AminnError(f"no target {name!r}; there are {', '.join(TARGETS)}")
    work.mkdir(parents=True, exist_ok=True)
    out = work / "results.bin"
    if name in IMAGES:
        image = build_firmware(model_dir, work / "build", prefix, name)
        return out, run_firmware(image, vectors, out, name)
    blob = model_dir / f"{prefix}.bin"
    if name == WASM:
        module = build_wasm(work / "aminn.wasm", header_beside(model_dir))
        return out, _figures(replay_wasm(module, blob, vectors, out), name)
    if name in DISPATCHED:
        library = build_library(work / "build", header_beside(model_dir))
        command = [*DISPATCHED[name].split(), str(library), str(blob)]
        return out, _figures(run([*command, str(vectors), str(out)], f"replaying on {name}"), name)
    target = HOSTED[name]
    program = build_hosted(target, model_dir, prefix, work)
    emulator = [target.emulator] if target.emulator else []
    return out, _figures(run([*emulator, str(program), str(vectors), str(out)], f"replaying on {name}"), name)


def replay_all(
    names: tuple[str, ...], model_dir: Path, prefix: str, vectors: Path, work: Path, jobs: int
) -> dict[str, tuple[Path, dict[str, int]]]:
    """`replay` on several targets, `jobs` at a time."""
    with ThreadPoolExecutor(jobs) as pool:
        futures = {name: pool.submit(replay, name, model_dir, prefix, vectors, work / name) for name in names}
        return {name: future.result() for name, future in futures.items()}
