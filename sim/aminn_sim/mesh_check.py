"""What a mesh names must be there: MuJoCo 2.2.2 reads what a face names wherever that is, and ends the process."""

from __future__ import annotations

import re
import struct

import numpy as np
from numpy.typing import NDArray

CORNERS = 4
"""Least number of vertices of something that has a volume."""
KINDS = (("v", "vertex"), ("vt", "texture coordinate"), ("vn", "normal"))
_MSH_HEAD = struct.Struct("<4i")
_INTEGER = re.compile(r"[+-]?\d{1,18}")


def check_mesh_file(end: str, content: bytes) -> None:
    """Raise ValueError with what is wrong in a mesh file, by the end of its name. STL names no vertices."""
    if end.lower() == ".obj":
        _check_obj(content.partition(b"\0")[0].decode("latin-1"))
    elif end.lower() == ".msh":
        _check_msh(content)


def check_mesh_text(vertex: str, face: str) -> None:
    """The same of a mesh whose numbers are in the model itself; other numbers than these the engine refuses by name."""
    try:
        named = np.array(face.split(), np.int64)
    except (ValueError, OverflowError):
        raise ValueError(f"its faces are no whole numbers, {face[:40]!r}") from None
    _check_faces(named, len(vertex.split()) // 3)


def _check_faces(named: NDArray, vertices: int) -> None:
    wrong = named[(named < 0) | (named >= vertices)]
    if len(wrong):
        raise ValueError(f"a face names vertex {wrong[0]}, there are 0 to {vertices - 1}")


def _check_obj(text: str) -> None:
    there = dict.fromkeys((kind for kind, _ in KINDS), 0)
    faces: list[tuple[int, str, dict[str, int]]] = []
    for n, line in enumerate(re.split(r"\r\n|\n|\r", text), 1):
        kind, _, rest = line.strip(" \t").replace("\t", " ").partition(" ")
        if kind in there:
            there[kind] += 1
        elif kind == "f":
            faces.append((n, rest, dict(there)))
    if there["v"] < CORNERS:
        raise ValueError(f"it has {there['v']} vertices, a mesh has {CORNERS} or more")
    for n, rest, before in faces:
        for corner in rest.split():
            for (kind, what), word in zip(KINDS, corner.split("/"), strict=False):
                if word and not _is_there(word, there[kind], before[kind]):
                    raise ValueError(f"line {n}: a face names {what} {word[:40]!r}, there are 1 to {there[kind]}")


def _is_there(word: str, there: int, before: int) -> bool:
    """Whether a number of a face, from 1 on or back from the last before it, is one of those that are there."""
    if not _INTEGER.fullmatch(word):
        return False
    return 1 <= int(word) <= there or -before <= int(word) <= -1


def _check_msh(content: bytes) -> None:
    if len(content) < _MSH_HEAD.size:
        raise ValueError("it is cut short")
    vertices, normals, coordinates, faces = _MSH_HEAD.unpack_from(content)
    numbers = 3 * vertices + 3 * normals + 2 * coordinates
    if min(vertices, normals, coordinates, faces) < 0 or len(content) != _MSH_HEAD.size + 4 * (numbers + 3 * faces):
        raise ValueError("its size is not what its first numbers say")
    _check_faces(np.frombuffer(content, "<i4", 3 * faces, _MSH_HEAD.size + 4 * numbers), vertices)
