"""`aminn_model.bin`: the model as one little-endian blob that the runtime uses in place (docs/model-format.md)."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath
from aminn_hand.hand import MAX_BRANCHES, MAX_COORDINATES, MIN_BRANCHES, Dims

from .known_answer import answered
from .layout import (
    DQ0_CODES,
    FORMAT_VERSION,
    NAME_ROOM,
    SCALARS,
    STAGE_SCALARS,
    TABLES_VERSION,
    WEIGHT_CODES,
    restored,
    stored_shape,
    stored_type,
    tensor_name,
    tensor_order,
)
from .packing import BODY, HEAD, MAGIC, content_crc, header_dims, output_words, pack, room, twisted
from .tables import STAGES, Exported, branch_joints, dims_of, shortest

_TWIST = 23  # of BODY's fields: how many fingertips resist twisting


@dataclass(frozen=True)
class BinModel:
    """A model read back from a blob; has the form of an exported model."""

    meta: dict
    tensors: dict[str, NDArray[Any]]


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


def _dims(found: tuple[int, ...], twist: int, path: Path) -> Dims:
    """The counts of the hand that a header states. Raises AminnError for those of none."""
    branches, coordinates, joints, _, _, gates = found
    dims = Dims(branches, coordinates, joints, gates, gates, twist > 0)
    inside = MIN_BRANCHES <= branches <= MAX_BRANCHES and 1 <= coordinates <= MAX_COORDINATES and gates <= branches
    inside = inside and twist == twisted(dims)
    if not inside or not branches <= joints <= branches * coordinates or found != tuple(header_dims(dims).values()):
        raise AminnError(f"{path}: dimensions {(*found, twist)} are those of no hand")
    return dims


def read_bin_model(path: AnyPath) -> BinModel:
    """Read a blob back. Raises AminnError on a damaged file, OSError if it cannot be read."""
    path = Path(path)
    blob = path.read_bytes()
    _check(blob, path)
    fields = BODY.unpack_from(blob, HEAD.size)
    dims = _dims(fields[1:7], fields[_TWIST], path)
    hc, h, hd, dq0, weights = fields[7:12]
    names = {code: name for name, code in DQ0_CODES.items()}, {code: name for name, code in WEIGHT_CODES.items()}
    if dq0 not in names[0] or weights not in names[1]:
        raise AminnError(f"{path}: dq0 {dq0} or weights {weights} is not what this program knows")
    tables = [
        (owner, field, stored_shape(dims, field, shape), np.dtype(stored_type(field, names[1][weights])))
        for owner, field, shape in tensor_order(dims, hc, h, hd)
    ]
    at = HEAD.size + BODY.size
    answer_room = room(4 * (dims.state + output_words(dims)))
    if at + sum(room(int(np.prod(shape)) * dtype.itemsize) for _, _, shape, dtype in tables) + answer_room != len(blob):
        raise AminnError(f"{path}: its length does not fit its widths {hc}, {h}, {hd}")
    tensors = {}
    for owner, field, shape, dtype in tables:
        flat = np.frombuffer(blob, dtype.newbyteorder("<"), int(np.prod(shape)), at)
        at += room(flat.nbytes)
        tensors[tensor_name(owner, field)] = restored(dims, field, flat, shape)
    if header_dims(dims_of(tensors)) != header_dims(dims):
        raise AminnError(f"{path}: coord_mask {tensors['coord_mask'].tolist()} does not fit its dimensions")
    known_state = np.frombuffer(blob, "<f4", dims.state, at)
    meta = dict(zip(SCALARS, fields[13:17], strict=True))
    meta |= {name: list(fields[19 + 2 * i : 21 + 2 * i]) for i, name in enumerate(STAGE_SCALARS)}
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
        "checkpoint_sha256": fields[17].hex(),
        "data_sha256": fields[18].hex(),
        "known_state": [float(v) for v in known_state],
        "eps_m": shortest(np.array([tensors[f"{stage}.eps_m"] for stage in STAGES])),
        "branch_joints": branch_joints(tensors),
    }
    return BinModel(meta, tensors)
