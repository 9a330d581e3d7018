"""Vector files: inputs with reference outputs, and what a replay of them gave (docs/model-format.md).

The compiled runtime reads the first and writes the second, on the host and on the target.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath
from aminn_hand.hand import INPUTS, MAX_BRANCHES, MAX_COORDINATES, MIN_BRANCHES, Dims

VECTOR_MAGIC = 0x564E4D41  # "AMNV"
RESULT_MAGIC = 0x4F4E4D41  # "AMNO"
VERSION = 2
_HEADER = struct.Struct("<5I2BH2I")
THETA = "theta"
"""Input of told models, which samples may have behind `INPUTS`."""
SENSORS = tuple(Dims(2, 1, 2, 1, 0).sensors)
"""Inputs of models that see sensors, behind theta; all of a hand's or none."""


def _sizes() -> dict[tuple[int, int], Dims]:
    """Each hand's counts by the numbers of inputs and outputs; no two hands have the same of both."""
    counts = (
        Dims(b, c, joints, 0, 0)
        for b in range(MIN_BRANCHES, MAX_BRANCHES + 1)
        for c in range(1, MAX_COORDINATES + 1)
        for joints in range(b + c - 1, b * c + 1)
    )
    return {(dims.input, dims.output): dims for dims in counts}


_HANDS = _sizes()


def described(dims: Dims) -> str:
    """What messages say of a hand."""
    return f"{dims.branches} branches, {dims.joints} joints, at most {dims.coordinates} a branch"


def dims_of_inputs(inputs: Mapping[str, NDArray]) -> Dims:
    """The counts of the hand that inputs (arrays by name) are of; of gates, and of tendons not sensed, it has 0.

    Raises AminnError where one is missing or of no hand.
    """
    missing = [name for name in INPUTS if name not in inputs]
    if missing:
        raise AminnError(f"vectors: {', '.join(missing)} is missing")
    q, contacts, j_q = (np.shape(inputs[name]) for name in ("q", "contacts", "j_q"))
    if (len(q), len(contacts), len(j_q)) != (2, 3, 4):
        raise AminnError(
            f"vectors: q, contacts, j_q have shapes {q}, {contacts}, {j_q}, expected (N,J), (N,B,8), (N,B,3,C)"
        )
    tension = np.shape(inputs.get(SENSORS[-1], np.zeros((0, 1))))
    return Dims(contacts[1], j_q[3], q[1], tension[-1] - 1, 0)


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

    @property
    def dims(self) -> Dims:
        """Counts of the hand that they are of; tendons and gates unknown."""
        return dims_of_inputs(self.inputs)


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


def shapes_with(dims: Dims, n_theta: int, sensing: bool = False) -> dict[str, tuple[int, ...]]:
    """Shapes of a sample's numbers; with so many of theta behind the inputs, and sensors at the end."""
    return dims.inputs | ({THETA: (n_theta,)} if n_theta else {}) | (dims.sensors if sensing else {})


def write_vectors(
    path: AnyPath,
    inputs: dict[str, NDArray],
    reference: dict[str, NDArray],
    reference_f64: dict[str, NDArray] | None = None,
    model: int = 0,
) -> None:
    """Write a vector file; names and shapes as in `Dims`, float32 inputs and reference; also theta, sensors, float64.

    `model` is the content_crc of the model that the reference is of.
    """
    dims = dims_of_inputs(inputs)
    n_theta = np.shape(inputs[THETA])[-1] if THETA in inputs else 0
    shapes = shapes_with(dims, n_theta, any(name in inputs for name in SENSORS))
    x, y = pack(inputs, shapes, "<f4"), pack(reference, dims.outputs, "<f4")
    payload = x.tobytes() + y.tobytes()
    if len(x) != len(y):
        raise AminnError(f"vectors: {len(x)} inputs but {len(y)} reference outputs")
    if reference_f64 is not None:
        z = pack(reference_f64, dims.outputs, "<f8")
        if len(z) != len(x):
            raise AminnError(f"vectors: {len(x)} inputs but {len(z)} float64 outputs")
        payload += z.tobytes()
    also = int(reference_f64 is not None), x.shape[1] - dims.input - n_theta, n_theta
    header = _HEADER.pack(VECTOR_MAGIC, VERSION, len(x), dims.input, dims.output, *also, zlib.crc32(payload), model)
    write_atomically(Path(path), header + payload)


def magic_of(path: AnyPath) -> int:
    """The first word of a file, which says of what kind it is; 0 if it is shorter."""
    with Path(path).open("rb") as file:
        return int.from_bytes(file.read(4).ljust(4, b"\0"), "little")


@dataclass(frozen=True)
class _Open:
    """A checked file."""

    payload: bytes
    n: int
    n_in: int
    n_out: int
    has_f64: bool
    n_sensor: int
    n_theta: int
    model: int


def _open(path: Path, magic: int, kind: str) -> _Open:
    blob = path.read_bytes()
    if len(blob) < _HEADER.size:
        raise AminnError(f"{path}: truncated: {len(blob)} bytes, a {kind} file has at least {_HEADER.size}")
    found, version, n, n_in, n_out, has_f64, n_sensor, n_theta, crc, model = _HEADER.unpack_from(blob)
    payload = blob[_HEADER.size :]
    if found != magic:
        raise AminnError(f"{path}: not a {kind} file (wrong magic)")
    if version != VERSION:
        raise AminnError(f"{path}: version {version}, this program reads {VERSION}; write it again")
    if has_f64 > 1 or ((has_f64 or n_theta or n_sensor) and magic == RESULT_MAGIC):
        raise AminnError(f"{path}: damaged: has_f64 is {has_f64}, n_sensor {n_sensor}, n_theta {n_theta}")
    if model and magic == RESULT_MAGIC:
        raise AminnError(f"{path}: damaged: the last word of its header is {model}, expected 0")
    if zlib.crc32(payload) != crc:
        raise AminnError(f"{path}: damaged: its CRC-32 does not match")
    return _Open(payload, n, n_in, n_out, bool(has_f64), n_sensor, n_theta, model)


def read_vectors(path: AnyPath, hand: Dims | None = None) -> Vectors:
    """Read a vector file, of `hand` where it is given.

    Raises AminnError on a damaged one and one of another hand, OSError if it cannot be read.
    """
    path = Path(path)
    file = _open(path, VECTOR_MAGIC, "vector")
    dims = _HANDS.get((file.n_in, file.n_out))
    if dims is None:
        raise AminnError(f"{path}: {file.n_in} inputs and {file.n_out} outputs a sample, which is no hand's")
    check_hand(dims, hand, path)
    stiff = file.n_theta - dims.branches - dims.joints - 1
    if file.n_theta and (stiff < 0 or (hand is not None and stiff != hand.stiff)):
        raise AminnError(f"{path}: {file.n_theta} numbers of theta a sample, which are not those of the hand")
    if file.n_sensor:
        bare = replace(dims, tendons=0)
        dims = replace(dims, tendons=max(0, file.n_sensor - bare.sensed - 2))
        if file.n_sensor != dims.sensed + 1 or (hand is not None and dims.sensors != hand.sensors):
            raise AminnError(f"{path}: {file.n_sensor} numbers of sensors a sample, which are not those of the hand")
    n, n_in, n_out = file.n, file.n_in + file.n_theta + file.n_sensor, file.n_out
    if len(file.payload) != n * (4 * (n_in + n_out) + 8 * n_out * file.has_f64):
        raise AminnError(f"{path}: {len(file.payload)} bytes do not fit {n} samples")
    x = np.frombuffer(file.payload, "<f4", n * n_in).reshape(n, n_in)
    y = np.frombuffer(file.payload, "<f4", n * n_out, 4 * n * n_in).reshape(n, n_out)
    exact = None
    if file.has_f64:
        z = np.frombuffer(file.payload, "<f8", n * n_out, 4 * n * (n_in + n_out)).reshape(n, n_out)
        exact = unpack(z, dims.outputs)
    shapes = shapes_with(dims, file.n_theta, file.n_sensor > 0)
    return Vectors(unpack(x, shapes), unpack(y, dims.outputs), exact, file.model)


def check_hand(found: Dims, hand: Dims | None, path: Path) -> None:
    """Raises AminnError where what is in `path` is of a hand of other counts than `hand`."""
    if hand is not None and found.inputs != hand.inputs:
        raise AminnError(f"{path}: of another hand ({described(found)}) than the model ({described(hand)})")


def read_results(path: AnyPath) -> Results:
    """Read what a replay wrote. Raises AminnError on a damaged file, OSError if it cannot be read."""
    path = Path(path)
    file = _open(path, RESULT_MAGIC, "result")
    n, n_out = file.n, file.n_out - 1
    shapes = next((dims.outputs for dims in _HANDS.values() if dims.output == n_out), None)
    if file.n_in or shapes is None:
        raise AminnError(f"{path}: {file.n_in} inputs and {file.n_out} outputs a sample, which is no hand's results")
    if len(file.payload) != n * 4 * (n_out + 2):
        raise AminnError(f"{path}: {len(file.payload)} bytes do not fit {n} samples")
    rows = np.frombuffer(file.payload, "<f4", n * (n_out + 1)).reshape(n, n_out + 1)
    status = np.frombuffer(file.payload, "<i4", n, 4 * n * (n_out + 1))
    return Results(unpack(rows[:, :n_out], shapes), np.ascontiguousarray(rows[:, n_out]), status)


def write_results(path: AnyPath, rows: NDArray[np.float32], status: NDArray[np.int32]) -> None:
    """Write a result file: outputs and decision (n, outputs + 1), and a status code for each sample (n)."""
    payload = np.ascontiguousarray(rows, "<f4").tobytes() + np.ascontiguousarray(status, "<i4").tobytes()
    header = _HEADER.pack(RESULT_MAGIC, VERSION, len(rows), 0, rows.shape[1], 0, 0, 0, zlib.crc32(payload), 0)
    write_atomically(Path(path), header + payload)
