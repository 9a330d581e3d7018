"""`aminn_model.bin`: the model as one little-endian blob that the runtime uses in place (docs/model-format.md)."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn.hand.dims import BRANCH_JOINTS, BRANCHES, JOINTS
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath

from .known_answer import answered
from .layout import (
    DQ0_CODES,
    FORMAT_VERSION,
    N_STATE,
    NAME_ROOM,
    SCALARS,
    STAGE_SCALARS,
    TABLES_VERSION,
    WEIGHT_CODES,
    WEIGHT_TYPES,
    is_weight,
    restored,
    stored_shape,
    tensor_name,
    tensor_order,
)
from .packing import BODY, DIMS, HEAD, MAGIC, N_OUTPUT_WORDS, content_crc, pack, room
from .tables import Exported


@dataclass(frozen=True)
class BinModel:
    """A model read back from a blob; has the form of an exported model."""

    meta: dict
    tensors: dict[str, NDArray[np.float32]]


def bin_model_bytes(exported: Exported) -> bytes:
    """The blob. The same model gives the same bytes."""
    return pack(*answered(exported))


def model_crc(exported: Exported) -> int:
    """`aminn_model_t.content_crc`, by which vector files name a model."""
    return content_crc(*answered(exported))


def write_bin_model(exported: Exported, path: AnyPath) -> None:
    """Write `aminn_model.bin`. Raises AminnError if the model does not fit the runtime."""
    write_atomically(Path(path), bin_model_bytes(exported))


def _check(blob: bytes, path: Path) -> None:
    """Raise AminnError unless the blob is whole and of this version."""
    if len(blob) < HEAD.size + BODY.size:
        raise AminnError(f"{path}: truncated: {len(blob)} bytes")
    magic, version, size, crc = HEAD.unpack_from(blob)
    if magic != MAGIC:
        raise AminnError(f"{path}: not an AMINN model (wrong magic)")
    if version != FORMAT_VERSION:
        raise AminnError(f"{path}: format version {version}, this program reads {FORMAT_VERSION}; export it again")
    if size != len(blob):
        raise AminnError(f"{path}: {len(blob)} bytes, its header says {size}: truncated or overwritten")
    if zlib.crc32(blob[HEAD.size :]) != crc:
        raise AminnError(f"{path}: damaged: its CRC-32 does not match")


def read_bin_model(path: AnyPath) -> BinModel:
    """Read a blob back. Raises AminnError on a damaged file, OSError if it cannot be read."""
    path = Path(path)
    blob = path.read_bytes()
    _check(blob, path)
    fields = BODY.unpack_from(blob, HEAD.size)
    if fields[1:6] != DIMS:
        raise AminnError(f"{path}: dimensions {fields[1:6]}, this program knows {DIMS}")
    hc, h, hd, dq0, weights = fields[6:11]
    names = {code: name for name, code in DQ0_CODES.items()}, {code: name for name, code in WEIGHT_CODES.items()}
    if dq0 not in names[0] or weights not in names[1]:
        raise AminnError(f"{path}: dq0 {dq0} or weights {weights} is not what this program knows")
    weight_type = WEIGHT_TYPES[names[1][weights]]
    tables = [
        (owner, field, stored_shape(field, shape), np.dtype(weight_type if is_weight(field) else np.float32))
        for owner, field, shape in tensor_order(hc, h, hd)
    ]
    at = HEAD.size + BODY.size
    answer_room = room(4 * (N_STATE + N_OUTPUT_WORDS))
    if at + sum(room(int(np.prod(shape)) * dtype.itemsize) for _, _, shape, dtype in tables) + answer_room != len(blob):
        raise AminnError(f"{path}: its length does not fit its widths {hc}, {h}, {hd}")
    tensors = {}
    for owner, field, shape, dtype in tables:
        flat = np.frombuffer(blob, dtype.newbyteorder("<"), int(np.prod(shape)), at)
        at += room(flat.nbytes)
        tensors[tensor_name(owner, field)] = restored(field, flat, shape)
    known_state = np.frombuffer(blob, "<f4", N_STATE, at)
    meta = dict(zip(SCALARS, fields[12:16], strict=True))
    meta |= {name: list(fields[18 + 2 * i : 20 + 2 * i]) for i, name in enumerate(STAGE_SCALARS)}
    meta |= {
        kind: text.rstrip(b"\0").decode("ascii", "replace") for kind, text in zip(NAME_ROOM, fields[24:], strict=True)
    }
    meta |= {
        "format_version": TABLES_VERSION,
        "weights": names[1][weights],
        "contact_width": hc,
        "width": h,
        "classifier_width": hd,
        "dq0": names[0][dq0],
        "checkpoint_sha256": fields[16].hex(),
        "data_sha256": fields[17].hex(),
        "known_state": [float(v) for v in known_state],
        "branches": list(BRANCHES),
        "joints": list(JOINTS),
        "branch_joints": [list(row) for row in BRANCH_JOINTS],
    }
    return BinModel(meta, tensors)
