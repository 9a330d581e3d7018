"""The bytes of `aminn_model.bin` from a model's layout and its known answer (docs/model-format.md)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn_rt.blob import BODY, FORMAT_VERSION, HEAD, MAGIC, header_dims

from .layout import BINS, DQ0_CODES, SCALARS, STAGE_SCALARS, WEIGHT_CODES, Layout, Table

TABLE_ALIGNMENT = 64
"""Each table begins at a multiple of it, counted from the blob's start."""


@dataclass(frozen=True)
class KnownAnswer:
    """A state and what the runtime makes of it (`aminn_known_answer_t`)."""

    state: NDArray[np.float32]
    """Fields of `aminn_state_t`."""
    output: NDArray[np.uint32]
    """Words of `aminn_output_t`: floats, then stable and notes."""
    stages_crc: int
    """CRC-32 of both stages' `aminn_stage_debug_t`."""

    @property
    def words(self) -> bytes:
        """The struct's bytes, little endian."""
        return self.state.astype("<f4").tobytes() + self.output.astype("<u4").tobytes()


def room(n_bytes: int) -> int:
    """What a table of so many bytes takes of the blob."""
    return -(-n_bytes // TABLE_ALIGNMENT) * TABLE_ALIGNMENT


def _little_endian(table: Table) -> bytes:
    return table.values.astype(table.values.dtype.newbyteorder("<")).tobytes()


def _numbers(layout: Layout, answer: KnownAnswer) -> bytes:
    codes = (DQ0_CODES[layout.dq0], WEIGHT_CODES[layout.weights])
    scalars = [float(layout.scalars[name]) for name in SCALARS]
    scalars += [float(v) for name in BINS for v in layout.bins[name]]
    dims = header_dims(layout.dims).values()
    return struct.pack("<12I4I2II14f", *dims, *layout.widths, *codes, answer.stages_crc, *scalars)


def content_crc(layout: Layout, answer: KnownAnswer) -> int:
    """CRC-32 of what the runtime computes with (`aminn_model_t.content_crc`): the same for every form of the model."""
    stages = zip(*(layout.stage_scalars[name] for name in STAGE_SCALARS), strict=True)
    eps = b"".join(struct.pack("<2f", *map(float, stage)) for stage in stages)
    tables = b"".join(_little_endian(table) for table in layout.tables)
    return zlib.crc32(_numbers(layout, answer) + layout.sha256 + layout.data_sha256 + eps + tables + answer.words)


def pack(layout: Layout, answer: KnownAnswer) -> bytes:
    """The blob."""
    eps = [float(v) for name in STAGE_SCALARS for v in layout.stage_scalars[name]]
    body = struct.pack("<I", content_crc(layout, answer)) + _numbers(layout, answer)
    body += layout.sha256 + layout.data_sha256 + struct.pack("<4f", *eps)
    body += struct.pack("56s56s40s", *(text.encode() for text in layout.names))
    assert len(body) == BODY.size
    for values in (*map(_little_endian, layout.tables), answer.words):
        body += values.ljust(room(len(values)), b"\0")
    return HEAD.pack(MAGIC, FORMAT_VERSION, HEAD.size + len(body), zlib.crc32(body)) + body
