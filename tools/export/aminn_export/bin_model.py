"""`aminn_model.bin`: the model as one little-endian blob that the runtime uses in place (docs/model-format.md)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn.dims import BRANCH_JOINTS, BRANCHES, JOINTS, N_BRANCH, N_CONTACT_FEATURE, N_COORD, N_JOINT, N_WRENCH
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically

from .layout import (
    DQ0_CODES,
    FORMAT_VERSION,
    SCALARS,
    STAGE_SCALARS,
    TABLES_VERSION,
    WEIGHT_CODES,
    WEIGHT_TYPES,
    is_weight,
    layout_of,
    restored,
    stored_shape,
    tensor_name,
    tensor_order,
)
from .tables import Exported

MAGIC = 0x4D4E4D41  # "AMNM"
DIMS = (N_BRANCH, N_COORD, N_JOINT, N_CONTACT_FEATURE, N_WRENCH)
TABLE_ALIGNMENT = 64
"""Each table begins at a multiple of it, counted from the blob's start."""
_HEAD = struct.Struct("<4I")  # magic, format version, size, CRC-32 of what follows
_BODY = struct.Struct("<5I3I2I32s4f6f")  # dimensions, widths, dq0 and weights, SHA-256, scalars, stage scalars


@dataclass(frozen=True)
class BinModel:
    """A model read back from a blob; has the form of an exported model."""

    meta: dict
    tensors: dict[str, NDArray[np.float32]]


def _room(n_bytes: int) -> int:
    """What a table of so many bytes takes of the blob."""
    return -(-n_bytes // TABLE_ALIGNMENT) * TABLE_ALIGNMENT


def bin_model_bytes(exported: Exported) -> bytes:
    """The blob. The same model gives the same bytes."""
    layout = layout_of(exported)
    scalars = [float(layout.scalars[name]) for name in SCALARS]
    stage_scalars = [float(v) for name in STAGE_SCALARS for v in layout.stage_scalars[name]]
    codes = (DQ0_CODES[layout.dq0], WEIGHT_CODES[layout.weights])
    body = _BODY.pack(*DIMS, *layout.widths, *codes, layout.sha256, *scalars, *stage_scalars)
    for table in layout.tables:
        values = table.values.astype(table.values.dtype.newbyteorder("<")).tobytes()
        body += values.ljust(_room(len(values)), b"\0")
    return _HEAD.pack(MAGIC, FORMAT_VERSION, _HEAD.size + len(body), zlib.crc32(body)) + body


def write_bin_model(exported: Exported, path: Path | str) -> None:
    """Write `aminn_model.bin`. Raises AminnError if the model does not fit the runtime."""
    write_atomically(Path(path), bin_model_bytes(exported))


def _check(blob: bytes, path: Path) -> None:
    """Raise AminnError unless the blob is whole and of this version."""
    if len(blob) < _HEAD.size + _BODY.size:
        raise AminnError(f"{path}: truncated: {len(blob)} bytes")
    magic, version, size, crc = _HEAD.unpack_from(blob)
    if magic != MAGIC:
        raise AminnError(f"{path}: not an AMINN model (wrong magic)")
    if version != FORMAT_VERSION:
        raise AminnError(f"{path}: format version {version}, this program reads {FORMAT_VERSION}; export it again")
    if size != len(blob):
        raise AminnError(f"{path}: {len(blob)} bytes, its header says {size}: truncated or overwritten")
    if zlib.crc32(blob[_HEAD.size :]) != crc:
        raise AminnError(f"{path}: damaged: its CRC-32 does not match")


def read_bin_model(path: Path | str) -> BinModel:
    """Read a blob back. Raises AminnError on a damaged file, OSError if it cannot be read."""
    path = Path(path)
    blob = path.read_bytes()
    _check(blob, path)
    fields = _BODY.unpack_from(blob, _HEAD.size)
    if fields[:5] != DIMS:
        raise AminnError(f"{path}: dimensions {fields[:5]}, this program knows {DIMS}")
    hc, h, hd, dq0, weights = fields[5:10]
    names = {code: name for name, code in DQ0_CODES.items()}, {code: name for name, code in WEIGHT_CODES.items()}
    if dq0 not in names[0] or weights not in names[1]:
        raise AminnError(f"{path}: dq0 {dq0} or weights {weights} is not what this program knows")
    weight_type = WEIGHT_TYPES[names[1][weights]]
    tables = [
        (owner, field, stored_shape(field, shape), np.dtype(weight_type if is_weight(field) else np.float32))
        for owner, field, shape in tensor_order(hc, h, hd)
    ]
    at = _HEAD.size + _BODY.size
    if at + sum(_room(int(np.prod(shape)) * dtype.itemsize) for _, _, shape, dtype in tables) != len(blob):
        raise AminnError(f"{path}: its length does not fit its widths {hc}, {h}, {hd}")
    tensors = {}
    for owner, field, shape, dtype in tables:
        flat = np.frombuffer(blob, dtype.newbyteorder("<"), int(np.prod(shape)), at)
        at += _room(flat.nbytes)
        tensors[tensor_name(owner, field)] = restored(field, flat, shape)
    meta = dict(zip(SCALARS, fields[11:15], strict=True))
    meta |= {name: list(fields[15 + 2 * i : 17 + 2 * i]) for i, name in enumerate(STAGE_SCALARS)}
    meta |= {
        "format_version": TABLES_VERSION,
        "weights": names[1][weights],
        "contact_width": hc,
        "width": h,
        "classifier_width": hd,
        "dq0": names[0][dq0],
        "checkpoint_sha256": fields[10].hex(),
        "branches": list(BRANCHES),
        "joints": list(JOINTS),
        "branch_joints": [list(row) for row in BRANCH_JOINTS],
    }
    return BinModel(meta, tensors)
