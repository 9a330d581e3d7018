"""The runtime as a WebAssembly module, and `aminn_replay` on it in Node.

The module holds the library for one hand and imports nothing. `runtime/wasm/aminn.mjs` is its JavaScript side: what
that calls is exported. A model is given to it as the bytes of its binary form.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from aminn_base.files import write_atomically
from aminn_base.run import run_program
from aminn_rt.sources import runtime_source

from .options import own_options

DEBIAN_PACKAGES = "clang-14 lld-14 wasi-libc libclang-rt-14-dev-wasm32 nodejs"
COMPILER = "clang-14"
TARGET = "--target=wasm32-wasi"


def javascript_side() -> Path:
    """The module's JavaScript side."""
    return runtime_source() / "wasm" / "aminn.mjs"


def build_wasm(out: Path, hand: Path | None = None) -> Path:
    """Compile the module for the hand of a header (`aminn_hand.h`; None: the reference hand); returns `out`.

    Raises AminnError with what is missing or what the compiler said.
    """
    runtime = runtime_source()
    include = [f"-I{runtime / 'include'}", f"-I{runtime / 'tools'}"]
    include += [f'-DAMINN_HAND_HEADER="{hand.resolve()}"'] if hand else []
    exports = sorted(set(re.findall(r"\.(aminn_\w+|__heap_base)\b", javascript_side().read_text())))
    link = ["-nostartfiles", "-Wl,--no-entry", "-Wl,--stack-first", "-Wl,--strip-all"]
    link += [f"-Wl,--export={name}" for name in exports]
    with tempfile.TemporaryDirectory(prefix="aminn-wasm-") as folder:
        _run(["-std=c++17", *own_options(), *include, "-c", *sorted((runtime / "src").glob("*.cpp"))], folder)
        _run(["-std=c99", *include, "-c", runtime / "wasm" / "aminn_wasm.c"], folder)
        module = Path(folder) / "aminn.wasm"
        _run([*link, *sorted(Path(folder).glob("*.o")), "-o", module], folder)
        write_atomically(out, module.read_bytes())
    return out


def replay_wasm(module: Path, blob: Path, vectors: Path, out: Path) -> str:
    """Replay a vector file in Node; returns what the program says. Raises AminnError where it fails."""
    command: list[str | Path] = ["node", runtime_source() / "wasm" / "replay.mjs", module, blob, vectors, out]
    return run_program(command, "replaying on WebAssembly in Node", packages=DEBIAN_PACKAGES)


def _run(arguments: list[str | Path], folder: str) -> None:
    what = "compiling the runtime to WebAssembly"
    run_program([COMPILER, TARGET, "-O2", *arguments], what, packages=DEBIAN_PACKAGES, folder=Path(folder))
