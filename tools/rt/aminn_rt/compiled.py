"""The compiled C runtime: the package's own for the reference hand; for another hand built when it is asked for.

What is built is kept in the user's cache folder, named by the hand's counts and by what it was compiled from.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError, WriteError
from aminn_base.files import write_atomically
from aminn_base.run import run_program
from aminn_hand.hand import INPUTS, Dims
from aminn_hand.sensors import UNITS

from .blob import output_words
from .hand_header import COUNTS, HAND_HEADER, counts_of, hand_header
from .sources import DEBIAN_PACKAGES, cache_folder, source_tree, sources_digest

MODULE = "aminn_rt._runtime"
LIBRARY = "_runtime.so"
QUICKLY = ("-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG", "-DAMINN_RT_DISPATCH=OFF")
"""Compiled in a third of the time, for a few predictions; the bits are the same."""
ALWAYS_STAGE2, DEBUG = 1, 2
"""Flags of a context (aminn_rt.h)."""
STAGES = 2
ADMISSIBLE_WORDS = 3
"""Of `aminn_admissible_t` before the output: scale, admissible, limited_by."""
THETA = "theta"

Floats = NDArray[np.float32]
Words = NDArray[np.uint32]
Codes = NDArray[np.int32]


class _Rows(ctypes.Structure):
    """`aminn_rows_t`."""

    _fields_ = (("first", ctypes.c_void_p), ("step", ctypes.c_size_t))


class _Batch(ctypes.Structure):
    """`aminn_batch_t`."""

    _fields_ = (
        ("begin", ctypes.c_size_t),
        ("n", ctypes.c_size_t),
        *((name, _Rows) for name in (*INPUTS, THETA, *UNITS)),
    )


class LoadLimits(ctypes.Structure):
    """`aminn_load_limits_t`."""

    _fields_ = tuple(
        (name, ctypes.c_float)
        for name in ("max_translation", "max_rotation", "margin", "p_stable", "p_slide", "max_scale")
    )


class Results(NamedTuple):
    """What rows became (N)."""

    outputs: Words
    """(N, .) words of `aminn_output_t`."""
    stages: Words
    """(N, .) words of both `aminn_stage_debug_t`, zeros after an error; (N, 0) where they were not asked for."""
    status: Codes
    """(N)"""


class Library:
    """A runtime that is compiled for the hands of some counts."""

    def __init__(self, path: Path) -> None:
        """Open a compiled library. Raises AminnError where it cannot be loaded."""
        self.path = path
        try:
            self._c = ctypes.CDLL(str(path))
        except OSError as error:
            raise AminnError(f"the compiled runtime cannot be loaded ({error}); install the package again") from error
        handle, size, text = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_char_p
        uint, status = ctypes.c_uint, ctypes.POINTER(ctypes.c_int32)
        batch, limits = (ctypes.POINTER(kind) for kind in (_Batch, LoadLimits))
        for name, result, arguments in (
            ("aminn_open", handle, (text, size, ctypes.c_uint32, status)),
            ("aminn_close", None, (handle,)),
            ("aminn_opened_context", handle, (handle,)),
            ("aminn_opened_ranges", None, (handle, handle, handle)),
            ("aminn_opened_self_test", ctypes.c_int32, (handle,)),
            ("aminn_predict_batch", ctypes.c_int32, (handle, batch, uint, handle, handle, handle, handle)),
            ("aminn_admissible_batch", ctypes.c_int32, (handle, batch, _Rows, limits, uint, handle, handle, handle)),
            ("aminn_status_name", text, (ctypes.c_int,)),
            ("aminn_status_text", text, (ctypes.c_int,)),
            ("aminn_field_name", text, (ctypes.c_int,)),
            ("aminn_theta_name", text, (ctypes.c_int,)),
            ("aminn_version", text, ()),
        ):
            function = getattr(self._c, name)
            function.restype, function.argtypes = result, arguments

    @functools.cached_property
    def dims(self) -> Dims:
        """The counts of the hand, and whether contacts slide."""
        counts = (ctypes.c_uint32 * len(COUNTS)).in_dll(self._c, "aminn_hand_counts")
        branches, coordinates, joints, gates, twist, stiff, tendons, slides = counts
        return Dims(branches, coordinates, joints, tendons, gates, twist > 0, stiff=stiff, slides=slides > 0)

    def status_name(self, status: int) -> str:
        """Name of a status code."""
        return str(self._c.aminn_status_name(status).decode())

    def status_text(self, status: int) -> str:
        """Meaning of a status code."""
        return str(self._c.aminn_status_text(status).decode())

    def field_name(self, index: int) -> str:
        """Name of a number of `aminn_state_t`."""
        return str(self._c.aminn_field_name(index).decode())

    @functools.cached_property
    def theta_names(self) -> tuple[str, ...]:
        """(P) in the order of theta; of a hand that the library was not made for by name they are numbered."""
        dims = self.dims
        n = dims.stiff + dims.branches + dims.joints + 1
        return tuple(self._c.aminn_theta_name(i).decode() for i in range(n))

    def version(self) -> str:
        """Of the library."""
        return str(self._c.aminn_version().decode())

    def open(self, blob: bytes, flags: int = 0) -> int:
        """A model that can be predicted with, to be closed. Raises ValueError if it is refused."""
        status = ctypes.c_int32()
        opened = self._c.aminn_open(blob, len(blob), flags, ctypes.byref(status))
        if not opened:
            raise Refused(status.value, self.status_text(status.value))
        return int(opened)

    def close(self, opened: int) -> None:
        """Give back what `open` gave."""
        self._c.aminn_close(opened)

    def predict(
        self,
        opened: int,
        inputs: Mapping[str, tuple[int, int]],
        n: int,
        threads: int = 1,
        stages: bool = False,
    ) -> Results:
        """Predict n rows on at most so many threads, without the interpreter's lock.

        inputs: of each array the address of its first number, and by how many numbers a row follows another; 0 where
        all rows are the same.
        """
        batch = _Batch(n=n, **{name: _Rows(*rows) for name, rows in inputs.items()})
        outputs, status = np.zeros((n, output_words(self.dims)), np.uint32), np.zeros(n, np.int32)
        words = STAGES * sum(prod(shape) for shape in self.dims.debug.values()) if stages else 0
        debug = np.zeros((n, words), np.uint32)
        where = debug.ctypes.data if stages else None
        context = self._c.aminn_opened_context(opened)
        if n:  # each row's status says what the one that is returned does
            self._c.aminn_predict_batch(
                context, ctypes.byref(batch), threads, outputs.ctypes.data, where, status.ctypes.data, None
            )
        return Results(outputs, debug, status)

    def admissible(
        self,
        opened: int,
        inputs: Mapping[str, tuple[int, int]],
        directions: tuple[int, int],
        limits: LoadLimits,
        n: int,
        threads: int = 1,
    ) -> tuple[Words, Codes]:
        """(N, .) words of `aminn_admissible_t` of n rows, and their status; inputs and directions as for `predict`."""
        batch = _Batch(n=n, **{name: _Rows(*rows) for name, rows in inputs.items()})
        context = self._c.aminn_opened_context(opened)
        found = np.zeros((n, ADMISSIBLE_WORDS + output_words(self.dims)), np.uint32)
        status = np.zeros(n, np.int32)
        if n:
            self._c.aminn_admissible_batch(
                context,
                ctypes.byref(batch),
                _Rows(*directions),
                ctypes.byref(limits),
                threads,
                found.ctypes.data,
                status.ctypes.data,
                None,
            )
        return found, status

    def ranges(self, opened: int) -> tuple[Floats, Floats]:
        """Smallest and largest value of each number of a state in training (S), widened."""
        low, high = (np.zeros(self.dims.state, np.float32) for _ in range(2))
        self._c.aminn_opened_ranges(opened, low.ctypes.data, high.ctypes.data)
        return low, high

    def run(self, blob: bytes, numbers: NDArray[np.float32]) -> Results:
        """Both stages of every row, with what they computed on their way; rows of whole states, or of whole inputs.

        Raises ValueError if the model is refused.
        """
        rows, dims = np.ascontiguousarray(numbers, np.float32), self.dims
        if rows.ndim != 2 or rows.shape[1] not in (dims.state, dims.input):
            raise ValueError(f"numbers: expected {dims.state} (a state) or {dims.input} (an input) a row")
        places, at = {}, 0
        for name, shape in dims.inputs.items():
            if at < rows.shape[1]:
                places[name] = (rows.ctypes.data + rows.itemsize * at, rows.shape[1])
            at += prod(shape)
        with self._opened(blob, ALWAYS_STAGE2 | DEBUG) as opened:
            return self.predict(opened, places, len(rows), stages=True)

    def ranges_of(self, blob: bytes) -> tuple[Floats, Floats]:
        """The same of a model that is not open. Raises ValueError if it is refused."""
        with self._opened(blob) as opened:
            return self.ranges(opened)

    def self_test(self, blob: bytes) -> int:
        """Status code of loading a model and of `aminn_self_test()`."""
        try:
            with self._opened(blob) as opened:
                return int(self._c.aminn_opened_self_test(opened))
        except Refused as error:
            return error.status

    @contextmanager
    def _opened(self, blob: bytes, flags: int = 0) -> Iterator[int]:
        opened = self.open(blob, flags)
        try:
            yield opened
        finally:
            self.close(opened)


class Refused(ValueError):
    """A library does not take a model."""

    def __init__(self, status: int, text: str) -> None:
        self.status = status
        super().__init__(f"model: {text}")


@functools.cache
def runtime() -> Library:
    """The package's own, for the reference hand. Raises AminnError if this installation lacks it."""
    found = importlib.util.find_spec(MODULE)
    if found is None or found.origin is None:
        raise AminnError("the compiled runtime is missing; install the package again")
    return Library(Path(found.origin))


def is_own(dims: Dims) -> bool:
    """Whether the package's own runtime is that of a hand of these counts."""
    return counts_of(runtime().dims) == counts_of(dims)


def runtime_for(dims: Dims, quickly: bool = True) -> Library:
    """The runtime compiled for a hand of these counts; where it has to be built, for speed only if not `quickly`.

    Raises AminnError that says what is missing where it has to be built and cannot be.
    """
    return runtime() if is_own(dims) else _built(dims, QUICKLY if quickly else ())


@functools.cache
def _built(dims: Dims, options: tuple[str, ...]) -> Library:
    """The library of a hand; what was built from the same sources before is taken as it is."""
    # the hand's name does not change a bit, so hands of the same counts share one
    counts = "x".join(map(str, counts_of(dims).values()))
    text = hand_header(counts, dims)
    what = f"the C runtime for a hand of {dims.branches} branches and {dims.joints} joints"
    tree, folder = source_tree(), cache_folder()
    source = tree / "tools" / "rt"
    library = folder / f"{counts}-{sources_digest(tree, text, *options)}.so"
    if library.is_file():
        return Library(library)
    for compiler in (os.environ.get("CXX", "c++"), os.environ.get("CC", "cc")):
        if not shutil.which(compiler):
            raise AminnError(
                f"this model needs {what}, and {compiler}, which compiles it, is not installed; on Debian: apt-get "
                f"install {DEBIAN_PACKAGES}"
            )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".building-", dir=folder) as work:
            header = Path(work) / HAND_HEADER
            header.write_text(text)
            build = Path(work) / "build"
            configure = ["cmake", "-S", str(source), "-B", str(build), f"-DAMINN_HAND={header}", *options]
            run_program(configure, f"configuring {what}", packages=DEBIAN_PACKAGES)
            run_program(["cmake", "--build", str(build), "--parallel"], f"building {what}", packages=DEBIAN_PACKAGES)
            write_atomically(library, (build / LIBRARY).read_bytes())
    except OSError as error:
        raise WriteError(folder, error.strerror or str(error)) from error
    return Library(library)
