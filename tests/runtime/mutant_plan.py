"""Where the numbers of a binary model lie: what the mutants of the tests change."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from aminn_export.files.layout import BINS, SCALARS, STAGE_SCALARS, layout_of
from aminn_export.files.packing import room
from aminn_export.files.tables import Exported
from aminn_rt.blob import BODY, HEAD

KINDS = {4: 0, 2: 1 << 31, 1: 1 << 30}
"""Bytes of a number -> what is set in the plan's word: of a float32, a float16, an int8."""
PLACE = (1 << 30) - 1
"""Of the plan's word, where the number lies."""
SCALARS_AT, STAGE_SCALARS_AT = (
    HEAD.size + struct.calcsize(BODY.format.partition(what)[0]) for what in ("14f", "4f56s")
)


def plan_of(exported: Exported) -> tuple[NDArray[np.uint32], NDArray[np.str_]]:
    """(offset in the blob of each number, the table or constant that it belongs to)."""
    layout = layout_of(exported)
    scalars = [*SCALARS, *(f"{name}[{i}]" for name, n in BINS.items() for i in range(n))]
    names = [*scalars, *(f"{name}[{i}]" for name in STAGE_SCALARS for i in range(2))]
    offsets = [SCALARS_AT + 4 * i for i in range(len(scalars))]
    offsets += [STAGE_SCALARS_AT + 4 * i for i in range(2 * len(STAGE_SCALARS))]
    at = HEAD.size + BODY.size
    for table in layout.tables:
        size = table.values.dtype.itemsize
        offsets += [(at + size * i) | KINDS[size] for i in range(table.values.size)]
        names += ["_".join(filter(None, (table.owner, table.field)))] * table.values.size
        at += room(size * table.values.size)
    return np.array(offsets, np.uint32), np.array(names)
