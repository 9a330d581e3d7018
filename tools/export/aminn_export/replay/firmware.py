"""Build the firmware image with an exported model and run it in qemu, on one of its boards."""

from __future__ import annotations

import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.run import run_program
from aminn_rt.sources import runtime_source

from ..files.hand_header import header_beside


@dataclass(frozen=True)
class Toolchain:
    """What makes an image for a family of cores, and what runs it."""

    file: str
    """In runtime/firmware; it names each core's board."""
    compiler: str
    emulator: str
    """Program and options of qemu, but for the board."""
    packages: str
    """Of Debian."""

    def board_of(self, core: str) -> str:
        """qemu's name of the board that has a core."""
        text = (runtime_source() / "firmware" / self.file).read_text()
        return dict(re.findall(r"^set\(BOARD_(\S+) (\S+)\)", text, re.MULTILINE))[core]


CORTEX_M = Toolchain(
    "arm-none-eabi.cmake",
    "arm-none-eabi-gcc",
    "qemu-system-arm",
    "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm",
)
RISCV32 = Toolchain(
    "riscv32-unknown-elf.cmake",
    "riscv64-unknown-elf-gcc",
    "qemu-system-riscv32 -bios none",
    "gcc-riscv64-unknown-elf picolibc-riscv64-unknown-elf qemu-system-misc",
)


@dataclass(frozen=True)
class Board:
    """A core with its board in qemu, and how an image for it is compiled."""

    core: str
    float_abi: str = ""
    """softfp or soft, in the place of the core's own."""
    toolchain: Toolchain = CORTEX_M
    slow: bool = False
    """No FPU: a prediction takes millions of instructions."""


BOARDS = {"cortex_m4": Board("cortex-m4"), "cortex_m7": Board("cortex-m7"), "cortex_m33": Board("cortex-m33")}
"""By target: those whose cost the project states."""
MORE_BOARDS = {
    "cortex_m0plus": Board("cortex-m0plus", slow=True),
    "cortex_m3": Board("cortex-m3", slow=True),
    "cortex_m23": Board("cortex-m23", slow=True),
    "cortex_m4_softfp": Board("cortex-m4", float_abi="softfp"),
    "cortex_m55": Board("cortex-m55"),
    "riscv32_soft": Board("rv32imac", toolchain=RISCV32, slow=True),
    "riscv32_fpu": Board("rv32imafc", toolchain=RISCV32),
}
"""Those whose bits are looked at as well."""
IMAGES = BOARDS | MORE_BOARDS


def build_firmware(
    model_dir: Path | str,
    build_dir: Path | str,
    model: str = "aminn_model",
    target: str = "cortex_m7",
    source: Path | None = None,
) -> Path:
    """Cross-compile runtime, model and controller loop; returns the image.

    `model_dir` holds MODEL.c and MODEL.h as `aminn export` writes them, `source` is runtime/firmware of another tree
    than the program's own. The build also proves that the image holds no allocator. Raises AminnError if a program is
    missing or the build fails.
    """
    board = IMAGES[target]
    compiler, packages = board.toolchain.compiler, board.toolchain.packages
    if shutil.which(compiler) is None:
        raise AminnError(f"{compiler} is not installed; on Debian: apt-get install {packages}")
    source = source or runtime_source() / "firmware"
    build_dir, model_dir = Path(build_dir).resolve(), Path(model_dir).resolve()
    if not (model_dir / f"{model}.c").is_file():
        raise AminnError(f"{model_dir}: no {model}.c; run aminn export")
    configure = ["cmake", "-S", str(source), "-B", str(build_dir), f"-DMODEL_DIR={model_dir}", f"-DMODEL={model}"]
    configure += [f"-DAMINN_HAND={header_beside(model_dir) or ''}"]
    if not (build_dir / "CMakeCache.txt").is_file():
        configure += [f"-DCMAKE_TOOLCHAIN_FILE={source / board.toolchain.file}", f"-DCORE={board.core}"]
        configure += [f"-DFLOAT_ABI={board.float_abi}"] if board.float_abi else []
    run_program(configure, "configuring the firmware", packages=packages)
    run_program(["cmake", "--build", build_dir], "building the firmware")
    return build_dir / "aminn_firmware.elf"


def run_firmware(image: Path | str, vectors: Path | str, out: Path | str, target: str = "cortex_m7") -> dict[str, int]:
    """Replay a vector file on the emulated target; writes a result file (`vectors.read_results`), returns its figures.

    Figures: samples, refused, context_bytes, stack_predict_bytes, stack_high_water_bytes, instructions_per_prediction,
    instructions_worst (emulated instructions, not cycles). Raises AminnError if the image reports an error or a fault;
    `out` is then not written.
    """
    image, vectors, out = Path(image).resolve(), Path(vectors).resolve(), Path(out)
    for path in (image, vectors):
        if not path.is_file():
            raise AminnError(f"{path}: no such file")
    with tempfile.TemporaryDirectory(prefix="aminn-firmware-") as folder:
        work = Path(folder)
        # short names in the working folder: the target's command line has no quoting
        (work / "vectors.bin").symlink_to(vectors)
        semihosting = "enable=on,target=native,arg=firmware,arg=vectors.bin,arg=results.bin"
        board = IMAGES[target]
        command = [*board.toolchain.emulator.split(), "-M", board.toolchain.board_of(board.core)]
        command += ["-icount", "shift=0", "-nographic", "-monitor", "none"]
        command += ["-serial", "none"]
        command += ["-semihosting-config", semihosting, "-kernel", str(image)]
        packages = board.toolchain.packages
        text = run_program(command, f"firmware {image.name}", packages=packages, folder=work, merged=True)
        write_atomically(out, (work / "results.bin").read_bytes())
    return {name: int(value) for name, value in re.findall(r"^firmware: (\w+) (\d+)$", text, re.MULTILINE)}
