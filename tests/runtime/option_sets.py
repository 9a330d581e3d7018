"""Sets of compiler options that users may build the library with, and what must become of each.

A set is compiled from the library's sources alone, with the options that it names and none of the project's own, linked
with the reference model, and run on this machine or on one of qemu's boards. It must give the bits of the project's own
build, not compile, with a message that says why, or be found by aminn_self_test().
"""

from __future__ import annotations

import functools
import re
import subprocess
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from runtime_models import DIMS

from aminn_export.files.bin_model import read_bin_model
from aminn_export.replay.targets import own_options
from aminn_export.samples.adversarial import KINDS, adversarial_states
from aminn_export.samples.vectors import pack, read_vectors

ROOT = Path(__file__).resolve().parents[2]
RUNTIME, GOLDEN, FIRMWARE = ROOT / "runtime", ROOT / "tests" / "golden", ROOT / "runtime" / "firmware"
SAME, REFUSED, FOUND, MISSING = "same bits", "refused", "found by the self-test", "not tried: there is no"
TIMEOUT_S = 300
FLT_MAX = float(np.finfo(np.float32).max)
QEMU = "-nographic -monitor none -serial none -semihosting-config enable=on,target=native -kernel"


@dataclass(frozen=True)
class Target:
    """Where a program runs: its C compiler, which links too, C++ compilers, options of all parts, what starts it."""

    gcc: str
    cxx: dict[str, str]
    processor: str = ""
    abi: str = ""
    emulator: str = ""
    flash: str = ""
    ram: str = ""


def _board(machine: str, cpu: str, abi: str, flash: str = "0x00000000", ram: str = "0x20000000") -> Target:
    cxx = {"gcc": "arm-none-eabi-g++", "clang": "clang++-14 --target=arm-none-eabi"}
    emulator = f"qemu-system-arm -M {machine} {QEMU}"
    return Target("arm-none-eabi-gcc", cxx, f"-mthumb -mcpu={cpu}", abi, emulator, flash, ram)


TARGETS = {
    "x86_64": Target("gcc", {"gcc": "g++", "clang": "clang++-14"}),
    "m3": _board("mps2-an385", "cortex-m3", "-mfloat-abi=soft"),
    "m4": _board("mps2-an386", "cortex-m4", "-mfpu=fpv4-sp-d16 -mfloat-abi=hard"),
    "m7": _board("mps2-an500", "cortex-m7", "-mfpu=fpv5-d16 -mfloat-abi=hard"),
    "m33": _board("mps2-an505", "cortex-m33", "-mfpu=fpv5-sp-d16 -mfloat-abi=hard", "0x10000000", "0x30000000"),
    "m55": _board("mps3-an547", "cortex-m55", "-mfloat-abi=hard"),
}


@dataclass(frozen=True)
class OptionSet:
    """Options of the library, and what must become of them: with `why`, in the compiler's message or the status."""

    target: str
    compiler: str
    options: str
    outcome: str = SAME
    why: str = ""
    abi: str = ""
    """In the place of the target's."""
    caller: str = ""
    """Options of the program that uses the library."""
    link: str = ""

    @property
    def name(self) -> str:
        """Key of the report."""
        text = f"{self.target} {self.compiler} {self.options} {self.abi}"
        text += f" caller {self.caller}" * bool(self.caller) + f" link {self.link}" * bool(self.link)
        return re.sub(r"\W+", "_", text).strip("_")


def _of(target: str, compiler: str, same: str, refused: dict[str, str], found: dict[str, str]) -> list[OptionSet]:
    """Sets whose outcome depends on the library's options alone; of the first, one a line."""
    sets = [OptionSet(target, compiler, line.strip()) for line in same.strip().splitlines()]
    sets += [OptionSet(target, compiler, options, REFUSED, why) for options, why in refused.items()]
    return sets + [OptionSet(target, compiler, options, FOUND, why) for options, why in found.items()]


OPTION_SETS = (
    *_of(
        "x86_64",
        "gcc",
        """-O0 -fno-exceptions
        -Og
        -Os
        -O3
        -O3 -march=native
        -O2 -mavx2 -mfma -ffp-contract=fast
        -O2 -mfma -flto
        -Ofast -fno-fast-math
        -O2 -mrecip -fassociative-math
        -O2 -frounding-math -fsignaling-nans
        -O2 -fsingle-precision-constant -fcx-limited-range -fexcess-precision=16 -ffloat-store
        -O2 -funsigned-char -fshort-enums -fwrapv -fno-strict-aliasing
        -O2 -ftrapv -fno-builtin
        -O2 -funroll-loops -ftree-vectorize -fvisibility=hidden -fPIC
        -O1 -fsanitize=undefined,address -fno-sanitize-recover=all
        -O2 -std=c++2b -fno-exceptions -fno-rtti -DNDEBUG
        -O2 -DAMINN_RT_SCALAR -mfma""",
        {
            "-Ofast": "ffast-math",
            "-O2 -ffast-math": "ffast-math",
            "-O2 -funsafe-math-optimizations": "fassociative-math",
            "-O2 -fassociative-math -fno-signed-zeros -fno-trapping-math": "fassociative-math",
            "-O2 -freciprocal-math": "freciprocal-math",
            "-O2 -ffinite-math-only": "ffinite-math-only",
            "-O2 -fno-signed-zeros": "fno-signed-zeros",
            "-O2 -mfpmath=387": "mfpmath=sse",
            "-O2 -mfpmath=sse,387": "mfpmath=sse",
            "-O2 -m32 -mfpmath=387": "mfpmath=sse",
            "-O2 -fpack-struct": "fpack_struct",
            "-O2 -std=c++14": r"C\+\+17",
        },
        {},
    ),
    OptionSet("x86_64", "gcc", "-O2", caller="-fshort-enums"),
    OptionSet("x86_64", "gcc", "-O2", REFUSED, "fpack_struct", caller="-fpack-struct"),
    OptionSet("x86_64", "gcc", "-O2", FOUND, "AMINN_E_FLUSH", link="-Ofast"),
    *_of(
        "x86_64",
        "clang",
        """-O0
        -Os
        -O3
        -O3 -march=native
        -O2 -ffp-model=precise -mfma
        -O2 -ffp-model=strict -mfma
        -O2 -freciprocal-math -mrecip
        -O2 -fassociative-math -fno-signed-zeros
        -O2 -funsafe-math-optimizations
        -O2 -fapprox-func -fno-honor-nans
        -O2 -fdenormal-fp-math=preserve-sign
        -O2 -fshort-enums -funsigned-char""",
        {
            "-Ofast": "ffast-math",
            "-O2 -ffp-model=fast": "ffast-math",
            "-O2 -ffinite-math-only": "ffinite-math-only",
            "-O2 -fno-honor-nans -fno-honor-infinities": "ffinite-math-only",
            "-O2 -mno-sse": "mfpmath=sse",
        },
        {"-O2 -mfma -ffp-contract=fast": "AMINN_E_CONTRACTED"},
    ),
    *_of(
        "m7",
        "gcc",
        """-O0
        -Og
        -Os
        -O3
        -O2 -ffp-contract=fast -fno-short-enums
        -O2 -flto -funroll-loops
        -Os -mslow-flash-data -mno-unaligned-access""",
        {"-Ofast": "ffast-math", "-Os -funsafe-math-optimizations": "fassociative-math"},
        {},
    ),
    OptionSet("m7", "gcc", "-O2", abi="-mfpu=fpv5-sp-d16 -mfloat-abi=softfp"),
    OptionSet("m7", "gcc", "-O2", abi="-mfloat-abi=soft"),
    OptionSet("m7", "gcc", "-O2", FOUND, "AMINN_E_FLUSH", caller="-DAMINN_PROBE_FLUSH"),
    *_of(
        "m7",
        "clang",
        """-O0
        -Os
        -O3""",
        {"-Ofast": "ffast-math"},
        {
            "-O2 -ffp-contract=fast": "AMINN_E_CONTRACTED",
            "-O2 -freciprocal-math -fassociative-math -fno-signed-zeros": "AMINN_E_FAST_MATH",
        },
    ),
    *_of("m3", "gcc", "-Os", {}, {}),
    *_of("m4", "gcc", "-O3", {}, {}),
    *_of("m33", "gcc", "-O3", {}, {}),
    *_of("m55", "gcc", "-Os\n-O3", {}, {}),
    *_of("m55", "clang", "-O3 -mcpu=cortex-m55+nomve.fp", {"-O3": "Helium"}, {}),
)


def _states() -> NDArray[np.float32]:
    """Rows of aminn_input_t: golden ones, hard ones, such that underflow or overflow, and such that are refused."""
    golden = read_vectors(GOLDEN / "golden.bin").inputs
    hard, _ = adversarial_states(golden, read_bin_model(GOLDEN / "aminn_model.bin"), 2 * len(KINDS))
    shapes = DIMS.inputs
    parts = [pack({k: golden[k][:12] for k in shapes}, shapes, "<f4"), pack(hard, shapes, "<f4")]
    rows = np.concatenate(parts)
    load, contact = 8 + 6, 8 + 6 + 6
    special = rows[:12].copy()
    for i, factor in enumerate((1e-30, 1e-38, 1e-40, 1e-44, 1e20, 1e38)):
        special[i, load : load + 6] = np.clip(special[i, load : load + 6].astype(float) * factor, -FLT_MAX, FLT_MAX)
    special[6, contact + 4 :: 8][:3] = np.float32(2.0)  # no unit normals
    special[7, 0], special[8, load], special[9, contact] = np.nan, np.inf, 2.0
    special[10, contact : contact + 24 : 8] = 0.0
    special[11, contact : contact + 24 : 8] = np.float32(1e-40)
    return np.concatenate([rows, special]).astype("<f4")


class Refused(Exception):
    """What a compiler said."""


def _run(*command: str | Path) -> str:
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    if done.returncode:
        raise Refused(f"{' '.join(words)}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr  # qemu prints on the latter


@functools.cache
def _system_headers() -> list[str]:
    """gcc's for Cortex-M, as options of clang."""
    command = ["arm-none-eabi-g++", "-E", "-v", "-x", "c++", "/dev/null"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    listed = text.partition("search starts here:\n#include <")[2].partition("End of search list")[0]
    folders = [line.strip() for line in listed.splitlines()[1:]]
    return [
        word
        for folder in folders
        if "/lib/gcc/arm-none-eabi/" not in str(Path(folder).resolve())
        for word in ("-isystem", folder)
    ]


class Prober:
    """Builds and runs sets in a folder. What several of them share is compiled once."""

    def __init__(self, work: Path) -> None:
        self.work = work
        sources = sorted((RUNTIME / "src").glob("*.cpp"))
        (work / "library.cpp").write_text("".join(f'#include "{source.name}"\n' for source in sources))
        (work / "states.bin").write_bytes(_states().tobytes())
        data = {"model": GOLDEN / "aminn_model.bin", "states": work / "states.bin"}
        lines = [
            f'.balign 64\n.globl {name}_begin, {name}_end\n{name}_begin:\n.incbin "{path}"\n{name}_end:\n'
            for name, path in data.items()
        ]
        (work / "data.S").write_text("\n".join([".section .rodata", *lines, '.section .note.GNU-stack,"",%progbits\n']))
        self._parts: dict[tuple[str, str], tuple[list[str], list[str]]] = {}
        self._lock = threading.Lock()

    def _program_parts(self, target_name: str, common: str) -> tuple[list[str], list[str]]:
        """What the library is linked with, and options of the linker."""
        target = TARGETS[target_name]
        folder = self.work / re.sub(r"\W+", "_", f"{target_name} {common}")
        folder.mkdir()
        sources = [self.work / "data.S", RUNTIME.parent / "tests" / "runtime" / "option_probe.c"]
        compile_it = [target.gcc, "-std=gnu99", "-O1", *common.split()]
        compile_it += [f"-I{RUNTIME / folder_}" for folder_ in ("include", "tools", "firmware")]
        linker = ["-lm"]
        if target.flash:
            script = (FIRMWARE / "mps2.ld.in").read_text()
            script = script.replace("@FLASH_ORIGIN@", target.flash).replace("@RAM_ORIGIN@", target.ram)
            (folder / "board.ld").write_text(script.replace("1024K", "512K"))
            sources += [FIRMWARE / name for name in ("startup.c", "machine_cortex_m.c", "semihosting.c")]
            compile_it += ["-DAMINN_PROBE_IMAGE"]
            linker += [f"-T{folder / 'board.ld'}", "-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections"]
        objects = []
        for source in sources:
            objects.append(str(folder / f"{source.stem}.o"))
            _run(*compile_it, "-c", source, "-o", objects[-1])
        return objects, linker

    def _build(self, options: OptionSet) -> Path:
        """The program of a set. Raises Refused."""
        target, folder = TARGETS[options.target], self.work / options.name
        folder.mkdir()
        machine = [*target.processor.split(), *(options.abi or target.abi).split()]
        compile_it = [*target.cxx[options.compiler].split(), "-std=c++17", *machine, *options.options.split()]
        if target.flash:
            compile_it += ["-fno-exceptions", "-fno-rtti"]
        if target.flash and options.compiler == "clang":
            compile_it += _system_headers()
        library, program = folder / "library.o", folder / "probe"
        include = [f"-I{RUNTIME / 'include'}", f"-I{RUNTIME / 'src'}"]
        _run(*compile_it, *include, "-c", self.work / "library.cpp", "-o", library)
        with self._lock:
            key = (options.target, " ".join([*machine, *options.caller.split()]))
            objects, linker = self._parts.get(key) or self._parts.setdefault(key, self._program_parts(*key))
        own = options.options.split() if re.search("-flto|-fsanitize", options.options) else []
        _run(target.gcc, *machine, *own, *options.link.split(), *objects, library, *linker, "-o", program)
        return program

    def probe(self, options: OptionSet) -> tuple[str, str]:
        """(status of the self-test, CRC-32 of the outputs) of a set. Raises Refused, also where the program fails."""
        text = _run(*TARGETS[options.target].emulator.split(), self._build(options))
        found = re.fullmatch(r"self_test (\w+)\noutputs (\w+)\n", text)
        assert found, text
        return found[1], found[2]

    def outcome(self, options: OptionSet, reference: str) -> str:
        """What becomes of a set: an outcome, and the compiler's or the self-test's word for it; or another text."""
        try:
            status, outputs = self.probe(options)
        except Refused as error:
            named = options.why and re.search(f"error: .*{options.why}.*", str(error))
            return f"{REFUSED}: {named[0].partition('error: ')[2]}" if named else str(error)
        except FileNotFoundError as error:
            return f"{MISSING} {error.filename}"
        if status != "AMINN_OK":
            return f"{FOUND}: {status}"
        return SAME if outputs == reference else f"other bits ({outputs}), and the self-test passes"


REFERENCE = OptionSet("x86_64", "gcc", " ".join(("-O3", *own_options())))
"""The project's own build."""


def outcomes(work: Path, jobs: int) -> dict[OptionSet, str]:
    """What becomes of each set."""
    prober = Prober(work)
    status, reference = prober.probe(REFERENCE)
    if status != "AMINN_OK":
        raise AssertionError(f"the project's own build: {status}")
    with ThreadPoolExecutor(jobs) as pool:
        results = pool.map(lambda options: prober.outcome(options, reference), OPTION_SETS)
        return dict(zip(OPTION_SETS, results, strict=True))
