"""A height field is as large as it says, and not too large: MuJoCo 2.2.2 may end the process on one that is not."""

from __future__ import annotations

import re
import struct
import zlib

import numpy as np

MAX_POINTS = 1 << 22
"""Each is 4 bytes in the model of every thread."""
_HEAD = struct.Struct("<2i")
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK = struct.Struct(">I4s")
_PNG_HEAD = struct.Struct(">2I5B")
_PNG_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Numbers that a point of each colour type has."""
WHOLE = re.compile(r"\s*[+-]?\d{1,18}\s*")
"""A number as the engines read it, of no more digits than any has."""


def check_field_file(end: str, content: bytes) -> None:
    """Raise ValueError with what is wrong in the file of a height field, by the end of its name."""
    if end.lower() == ".png":
        _check_png(content)
        return
    if len(content) < _HEAD.size:
        raise ValueError("it is cut short")
    rows, columns = _HEAD.unpack_from(content)
    _check_points(rows, columns)
    if len(content) != _HEAD.size + 4 * rows * columns:
        raise ValueError(
            f"it has {len(content)} bytes, {rows} rows of {columns} points have {_HEAD.size + 4 * rows * columns}"
        )
    if not np.isfinite(np.frombuffer(content, "<f4", offset=_HEAD.size)).all():
        raise ValueError("a height is no finite number")


def check_field_size(rows: str, columns: str) -> None:
    """The same of a height field without a file, which is flat."""
    for name, text in (("nrow", rows), ("ncol", columns)):
        if not WHOLE.fullmatch(text):
            raise ValueError(f"{name} is {text[:40]!r}, no whole number; a height field has a file, or nrow and ncol")
    _check_points(int(rows), int(columns))


def _check_points(rows: int, columns: int) -> None:
    if min(rows, columns) < 2 or rows * columns > MAX_POINTS:
        raise ValueError(
            f"it has {rows} rows of {columns} points; 2 or more of each are taken, and {MAX_POINTS} points in all"
        )


def _check_png(content: bytes) -> None:
    """The picture's size, and that what is packed in it is no more than that; its decoder sees to the rest."""
    if not content.startswith(_PNG) or len(content) < len(_PNG) + _PNG_CHUNK.size + _PNG_HEAD.size:
        raise ValueError("it is no PNG picture")
    at, packed = len(_PNG), []
    columns, rows, depth, colour, *_ = _PNG_HEAD.unpack_from(content, at + _PNG_CHUNK.size)
    _check_points(rows, columns)
    while at + _PNG_CHUNK.size <= len(content):
        length, kind = _PNG_CHUNK.unpack_from(content, at)
        if kind == b"IDAT":
            packed.append(content[at + _PNG_CHUNK.size : at + _PNG_CHUNK.size + length])
        at += _PNG_CHUNK.size + length + 4
    # a byte before each row; one that is interlaced has up to twice as many rows
    most = 2 * rows * (columns * _PNG_SAMPLES.get(colour, 4) * max(depth, 8) // 8 + 1)
    try:
        if len(zlib.decompressobj().decompress(b"".join(packed), most + 1)) > most:
            raise ValueError(f"more is packed in it than {rows} rows of {columns} points")
    except zlib.error as error:
        raise ValueError(f"its points cannot be unpacked ({error})") from error
