"""`aminn_model.bin`: the model as one little-endian blob that the runtime uses in place (docs/model-format.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath
from aminn_rt.blob import BODY, HEAD, check_blob, dims_in, header_dims, names_in, output_words

from .known_answer import answered
from .layout import (
    BINS,
    DQ0_CODES,
    NAME_ROOM,
    SCALARS,
    STAGE_SCALARS,
    TABLES_VERSION,
    TOLD_TABLE,
    WEIGHT_CODES,
    Widths,
    has_steps,
    of_steps,
    restored,
    stored_shape,
    stored_type,
    tensor_name,
    tensor_order,
    weights_of_biases,
)
from .packing import content_crc, pack, room
from .tables import STAGES, Exported, branch_joints, dims_of, shortest


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


def read_bin_model(path: AnyPath) -> BinModel:
    """Read a blob back. Raises AminnError on a damaged file, OSError if it cannot be read."""
    path = Path(path)
    blob = path.read_bytes()
    check_blob(blob, path)
    fields = BODY.unpack_from(blob, HEAD.size)
    dims = dims_in(blob, path)
    widths, (dq0, weights) = Widths(*fields[13:17]), fields[17:19]
    names = {code: name for name, code in DQ0_CODES.items()}, {code: name for name, code in WEIGHT_CODES.items()}
    if dq0 not in names[0] or weights not in names[1]:
        raise AminnError(f"{path}: dq0 {dq0} or weights {weights} is not what this program knows")
    kind = names[1][weights]
    tables = [
        (owner, field, stored_shape(dims, field, shape), np.dtype(stored_type(field, kind)), 1 + has_steps(field, kind))
        for owner, field, shape in tensor_order(dims, widths)
    ]
    at = HEAD.size + BODY.size
    answer_room = room(4 * (dims.state + output_words(dims)))
    sizes = (room(times * int(np.prod(shape)) * dtype.itemsize) for _, _, shape, dtype, times in tables)
    if at + sum(sizes) + answer_room != len(blob):
        raise AminnError(f"{path}: its length does not fit its widths {', '.join(map(str, widths))}")
    tensors = {}
    for owner, field, shape, dtype, times in tables:
        flat = np.frombuffer(blob, dtype.newbyteorder("<"), times * int(np.prod(shape)), at)
        at += room(flat.nbytes)
        if field == TOLD_TABLE:
            continue
        numbers = flat.reshape(times, -1)
        tensors[tensor_name(owner, field)] = restored(dims, field, numbers[0], shape)
        if has_steps(field, kind):
            of = tensor_name(owner, weights_of_biases(field))
            tensors[of] = of_steps(tensors[of], restored(dims, field, numbers[1], shape))
    counts = {"tendons": dims.tendons, "slides": dims.slides, "sensing": dims.sensing > 0, "told": dims.factors > 0}
    try:
        found = dims_of(BinModel(counts, tensors))
    except AminnError as error:
        raise AminnError(f"{path}: {error}") from error
    if header_dims(found) != header_dims(dims):
        raise AminnError(f"{path}: coord_mask {tensors['coord_mask'].tolist()} does not fit its dimensions")
    known_state = np.frombuffer(blob, "<f4", dims.state, at)
    scalars = 20 + len(SCALARS)
    meta = counts | dict(zip(SCALARS, fields[20:scalars], strict=True))
    edges, factors = (list(fields[scalars : scalars + 3]), list(fields[scalars + 3 : scalars + 7]))
    meta |= dict(zip(BINS, (edges, factors), strict=True))
    meta |= {name: list(fields[36 + 2 * i : 38 + 2 * i]) for i, name in enumerate(STAGE_SCALARS)}
    meta |= dict(zip(NAME_ROOM, names_in(blob), strict=True))
    meta |= {
        "format_version": TABLES_VERSION,
        "weights": kind,
        "contact_width": widths.contact,
        "width": list(widths.trunks),
        "classifier_width": widths.classifier,
        "dq0": names[0][dq0],
        "checkpoint_sha256": fields[34].hex(),
        "data_sha256": fields[35].hex(),
        "known_state": [float(v) for v in known_state],
        "eps_m": shortest(np.array([tensors[f"{stage}.eps_m"] for stage in STAGES])),
        "branch_joints": branch_joints(tensors),
    }
    return BinModel(meta, tensors)
