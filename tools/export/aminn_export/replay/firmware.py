"""Build the firmware image with an exported model and run it in qemu, on one of its boards."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.run import run_program
from aminn_rt.sources import runtime_source

from ..files.hand_header import header_beside

QEMU = "qemu-system-arm"
BOARDS = {"cortex_m4": "mps2-an386", "cortex_m7": "mps2-an500", "cortex_m33": "mps2-an505"}
"""qemu's name of the board by the target's name."""
COMPILER = "arm-none-eabi-gcc"
DEBIAN_PACKAGES = "gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib qemu-system-arm"


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
    if shutil.which(COMPILER) is None:
        raise AminnError(f"{COMPILER} is not installed; on Debian: apt-get install {DEBIAN_PACKAGES}")
    source = source or runtime_source() / "firmware"
    build_dir, model_dir = Path(build_dir).resolve(), Path(model_dir).resolve()
    if not (model_dir / f"{model}.c").is_file():
        raise AminnError(f"{model_dir}: no {model}.c; run aminn export")
    configure = ["cmake", "-S", str(source), "-B", str(build_dir), f"-DMODEL_DIR={model_dir}", f"-DMODEL={model}"]
    configure += [f"-DAMINN_HAND={header_beside(model_dir) or ''}", "-DAMINN_RT_WERROR=OFF"]
    if not (build_dir / "CMakeCache.txt").is_file():
        configure += [f"-DCMAKE_TOOLCHAIN_FILE={source / 'arm-none-eabi.cmake'}", f"-DBOARD={BOARDS[target]}"]
    run_program(configure, "configuring the firmware", packages=DEBIAN_PACKAGES)
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
        command = [QEMU, "-M", BOARDS[target], "-icount", "shift=0", "-nographic", "-monitor", "none"]
        command += ["-serial", "none"]
        command += ["-semihosting-config", semihosting, "-kernel", str(image)]
        text = run_program(command, f"firmware {image.name}", packages=DEBIAN_PACKAGES, folder=work, merged=True)
        write_atomically(out, (work / "results.bin").read_bytes())
    return {name: int(value) for name, value in re.findall(r"^firmware: (\w+) (\d+)$", text, re.MULTILINE)}
