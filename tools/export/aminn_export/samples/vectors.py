"""Vector files: inputs with reference outputs, and what a replay of them gave (docs/model-format.md).

The compiled runtime reads the first and writes the second, on the host and on the target.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn.hand.dims import INPUT_SHAPES, OUTPUT_SHAPES
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath

VECTOR_MAGIC = 0x564E4D41  # "AMNV"
RESULT_MAGIC = 0x4F4E4D41  # "AMNO"
VERSION = 1
_HEADER = struct.Struct("<8I")


def _size(shapes: dict[str, tuple[int, ...]]) -> int:
    return sum(int(np.prod(shape)) for shape in shapes.values())


N_IN = _size(INPUT_SHAPES)
N_OUT = _size(OUTPUT_SHAPES)


@dataclass(frozen=True)
class Vectors:
    """Contents of a vector file; arrays by name, each with leading dimension n."""

    inputs: dict[str, NDArray[np.float32]]
    reference: dict[str, NDArray[np.float32]]
    """ONNX Runtime's outputs."""
    reference_f64: dict[str, NDArray[np.float64]] | None
    """The same in float64, if the file has them."""
    model: int = 0
    """content_crc of the model that they are of; 0 if the file does not say."""


@dataclass(frozen=True)
class Results:
    """Contents of a result file."""

    outputs: dict[str, NDArray[np.float32]]
    decision: NDArray[np.float32]
    """The runtime's: 1 the grasp holds, 0 it does not; anything else is wrong."""
    status: NDArray[np.int32]
    """Its status code of each sample."""

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether the grasp holds."""
        return self.decision == 1


def pack(values: dict[str, NDArray], shapes: dict[str, tuple[int, ...]], dtype: str) -> NDArray:
    """Rows (n, sum of sizes) from arrays by name."""
    n = len(next(iter(values.values())))
    for name, shape in shapes.items():
        if name not in values:
            raise AminnError(f"vectors: {name} is missing")
        if np.shape(values[name]) != (n, *shape):
            raise AminnError(f"vectors: {name} has shape {np.shape(values[name])}, expected {(n, *shape)}")
    return np.concatenate(
        [np.asarray(values[name], dtype).reshape(n, int(np.prod(shape))) for name, shape in shapes.items()], 1
    )


def unpack(rows: NDArray, shapes: dict[str, tuple[int, ...]]) -> dict[str, NDArray]:
    """Arrays by name from rows (n, sum of sizes)."""
    out, at = {}, 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        out[name] = np.ascontiguousarray(rows[:, at : at + size]).reshape(len(rows), *shape)
        at += size
    return out


def write_vectors(
    path: AnyPath,
    inputs: dict[str, NDArray],
    reference: dict[str, NDArray],
    reference_f64: dict[str, NDArray] | None = None,
    model: int = 0,
) -> None:
    """Write a vector file; names and shapes as in `aminn.hand.dims`, float32 inputs and reference, optional float64.

    `model` is the content_crc of the model that the reference is of.
    """
    x, y = pack(inputs, INPUT_SHAPES, "<f4"), pack(reference, OUTPUT_SHAPES, "<f4")
    payload = x.tobytes() + y.tobytes()
    if len(x) != len(y):
        raise AminnError(f"vectors: {len(x)} inputs but {len(y)} reference outputs")
    if reference_f64 is not None:
        z = pack(reference_f64, OUTPUT_SHAPES, "<f8")
        if len(z) != len(x):
            raise AminnError(f"vectors: {len(x)} inputs but {len(z)} float64 outputs")
        payload += z.tobytes()
    has_f64 = int(reference_f64 is not None)
    header = _HEADER.pack(VECTOR_MAGIC, VERSION, len(x), N_IN, N_OUT, has_f64, zlib.crc32(payload), model)
    write_atomically(Path(path), header + payload)


def magic_of(path: AnyPath) -> int:
    """The first word of a file, which says of what kind it is; 0 if it is shorter."""
    with Path(path).open("rb") as file:
        return int.from_bytes(file.read(4).ljust(4, b"\0"), "little")


def _open(path: Path, magic: int, kind: str, n_in: int, n_out: int) -> tuple[bytes, int, bool, int]:
    """(payload, n, has_f64, model) of a checked file."""
    blob = path.read_bytes()
    if len(blob) < _HEADER.size:
        raise AminnError(f"{path}: truncated: {len(blob)} bytes, a {kind} file has at least {_HEADER.size}")
    found, version, n, file_in, file_out, has_f64, crc, model = _HEADER.unpack_from(blob)
    payload = blob[_HEADER.size :]
    if found != magic:
        raise AminnError(f"{path}: not a {kind} file (wrong magic)")
    if version != VERSION:
        raise AminnError(f"{path}: version {version}, this program reads {VERSION}; write it again")
    if (file_in, file_out) != (n_in, n_out):
        raise AminnError(f"{path}: {file_in} inputs and {file_out} outputs a sample, expected {n_in} and {n_out}")
    if has_f64 > 1 or (has_f64 and magic == RESULT_MAGIC):
        raise AminnError(f"{path}: damaged: has_f64 is {has_f64}")
    if model and magic == RESULT_MAGIC:
        raise AminnError(f"{path}: damaged: the last word of its header is {model}, expected 0")
    if zlib.crc32(payload) != crc:
        raise AminnError(f"{path}: damaged: its CRC-32 does not match")
    return payload, n, bool(has_f64), model


def read_vectors(path: AnyPath) -> Vectors:
    """Read a vector file. Raises AminnError on a damaged one, OSError if it cannot be read."""
    path = Path(path)
    payload, n, has_f64, model = _open(path, VECTOR_MAGIC, "vector", N_IN, N_OUT)
    if len(payload) != n * (4 * (N_IN + N_OUT) + 8 * N_OUT * has_f64):
        raise AminnError(f"{path}: {len(payload)} bytes do not fit {n} samples")
    x = np.frombuffer(payload, "<f4", n * N_IN).reshape(n, N_IN)
    y = np.frombuffer(payload, "<f4", n * N_OUT, 4 * n * N_IN).reshape(n, N_OUT)
    z = None
    if has_f64:
        z = np.frombuffer(payload, "<f8", n * N_OUT, 4 * n * (N_IN + N_OUT)).reshape(n, N_OUT)
    exact = None if z is None else unpack(z, OUTPUT_SHAPES)
    return Vectors(unpack(x, INPUT_SHAPES), unpack(y, OUTPUT_SHAPES), exact, model)


def read_results(path: AnyPath) -> Results:
    """Read what a replay wrote. Raises AminnError on a damaged file, OSError if it cannot be read."""
    path = Path(path)
    payload, n, _, _ = _open(path, RESULT_MAGIC, "result", 0, N_OUT + 1)
    if len(payload) != n * 4 * (N_OUT + 2):
        raise AminnError(f"{path}: {len(payload)} bytes do not fit {n} samples")
    rows = np.frombuffer(payload, "<f4", n * (N_OUT + 1)).reshape(n, N_OUT + 1)
    status = np.frombuffer(payload, "<i4", n, 4 * n * (N_OUT + 1))
    return Results(unpack(rows[:, :N_OUT], OUTPUT_SHAPES), np.ascontiguousarray(rows[:, N_OUT]), status)


def write_results(path: AnyPath, rows: NDArray[np.float32], status: NDArray[np.int32]) -> None:
    """Write a result file: outputs and decision (n, 47), and a status code for each sample (n)."""
    payload = np.ascontiguousarray(rows, "<f4").tobytes() + np.ascontiguousarray(status, "<i4").tobytes()
    header = _HEADER.pack(RESULT_MAGIC, VERSION, len(rows), 0, N_OUT + 1, 0, zlib.crc32(payload), 0)
    write_atomically(Path(path), header + payload)
