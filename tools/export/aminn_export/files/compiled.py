"""The compiled C runtime: the package's own for the reference hand; for another hand built when it is asked for.

What is built is kept in the user's cache folder, named by the hand's counts and by what it was compiled from.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib
import os
import shutil
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError, WriteError
from aminn_base.run import run_program
from aminn_hand.hand import Dims

from .hand_header import HAND_HEADER, hand_header
from .packing import header_dims, output_words, twisted
from .tables import STAGES

SOURCES = Path(__file__).resolve().parents[2] / "hand"
RUNTIME = SOURCES.parents[2] / "runtime"
LIBRARY = "libaminn_of_hand.so"
DEBIAN_PACKAGES = "cmake g++ make"
_SUFFIXES = {".c", ".cpp", ".h", ".hpp", ".txt", ".cmake"}


class Runtime(Protocol):
    """The C runtime for one hand."""

    def run(
        self, blob: bytes, numbers: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.int32]]:
        """Words of the outputs and of both stages, and status (n, 1), of rows of states or of whole inputs.

        Raises ValueError if the model is refused.
        """

    def self_test(self, blob: bytes) -> int:
        """Status code of loading a model and of `aminn_self_test()`."""


def runtime() -> ModuleType:
    """The package's own, for the reference hand. Raises AminnError if this installation lacks it."""
    try:
        return importlib.import_module("aminn_export._runtime")
    except ImportError as error:
        raise AminnError(f"export: the compiled runtime is missing ({error}); install the package again") from error


def is_own(dims: Dims) -> bool:
    """Whether the package's own runtime is that of a hand of these counts."""
    return tuple(runtime().hand) == (*header_dims(dims).values(), twisted(dims))


def runtime_for(dims: Dims) -> Runtime:
    """The runtime compiled for a hand of these counts.

    Raises AminnError that says what is missing where it has to be built and cannot be.
    """
    own: Any = runtime()
    return own if is_own(dims) else _Library(dims, _built(dims))


class _Library:
    """A runtime that was built for a hand."""

    def __init__(self, dims: Dims, path: Path) -> None:
        self._dims, self._library = dims, ctypes.CDLL(str(path))

    def run(
        self, blob: bytes, numbers: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.int32]]:
        rows, dims = np.ascontiguousarray(numbers, np.float32), self._dims
        if rows.shape[1] not in (dims.state, dims.input):
            raise ValueError(f"numbers: expected {dims.state} (a state) or {dims.input} (an input) a row")
        words = len(STAGES) * sum(int(np.prod(shape)) for shape in dims.debug.values())
        outputs = np.zeros((len(rows), output_words(dims)), np.uint32)
        stages, status = np.zeros((len(rows), words), np.uint32), np.zeros((len(rows), 1), np.int32)
        size = ctypes.c_size_t
        refused = self._library.aminn_batch_run(
            *(blob, size(len(blob)), rows.ctypes.data_as(ctypes.c_void_p), size(len(rows)), size(rows.shape[1])),
            *(array.ctypes.data_as(ctypes.c_void_p) for array in (outputs, stages, status)),
        )
        if refused:
            raise ValueError(f"model: {runtime().status_text(refused)}")
        return outputs, stages, status

    def self_test(self, blob: bytes) -> int:
        return int(self._library.aminn_batch_self_test(blob, ctypes.c_size_t(len(blob))))


def cache_folder() -> Path:
    """Where built runtimes are kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "aminn" / "runtime"


def _sources() -> list[Path]:
    folders = (RUNTIME / "src", RUNTIME / "include", RUNTIME / "cmake", SOURCES, SOURCES.parent / "src")
    found = [file for folder in folders for file in sorted(folder.glob("*")) if file.suffix in _SUFFIXES]
    return [RUNTIME / "CMakeLists.txt", *found]


@functools.cache
def _built(dims: Dims) -> Path:
    """The library of a hand; what was built from the same sources before is taken as it is."""
    # the hand's name does not change a bit, so hands of the same counts share one
    counts = "x".join(map(str, (dims.branches, dims.coordinates, dims.joints, dims.gates, twisted(dims))))
    text = hand_header(counts, dims)
    what = f"the C runtime for a hand of {dims.branches} branches and {dims.joints} joints"
    if not (SOURCES / "CMakeLists.txt").is_file():
        raise AminnError(f"export: {what} is compiled from a checkout of the repository: {SOURCES} is not there")
    digest = hashlib.sha256(text.encode())
    for file in _sources():
        digest.update(file.read_bytes())
    folder = cache_folder()
    library = folder / f"{counts}-{digest.hexdigest()[:16]}.so"
    if library.is_file():
        return library
    for compiler in (os.environ.get("CXX", "c++"), os.environ.get("CC", "cc")):
        if not shutil.which(compiler):
            raise AminnError(
                f"export: the known answer of this model needs {what}, and {compiler}, which compiles it, is not "
                f"installed; on Debian: apt-get install {DEBIAN_PACKAGES}"
            )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".building-", dir=folder) as work:
            header = Path(work) / HAND_HEADER
            header.write_text(text)
            build = Path(work) / "build"
            configure = ["cmake", "-S", str(SOURCES), "-B", str(build), f"-DAMINN_HAND={header}"]
            run_program(configure, f"configuring {what}", packages=DEBIAN_PACKAGES)
            run_program(["cmake", "--build", str(build), "--parallel"], f"building {what}", packages=DEBIAN_PACKAGES)
            os.replace(build / LIBRARY, library)
    except OSError as error:
        raise WriteError(folder, error.strerror or str(error)) from error
    return library
