"""Where the numbers of a binary model lie: what the mutants of the tests change."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_export.bin_model import TABLE_ALIGNMENT
from aminn_export.layout import SCALARS, STAGE_SCALARS, layout_of
from aminn_export.tables import Exported

HALF = 1 << 31
"""Set in the plan's word of a float16."""
HEADER_SCALARS = 88
HEADER_SIZE = 128


def plan_of(exported: Exported) -> tuple[NDArray[np.uint32], list[str]]:
    """(offset in the blob of each number, the table or constant that it belongs to)."""
    layout = layout_of(exported)
    names = [*SCALARS, *(f"{name}[{i}]" for name in STAGE_SCALARS for i in range(2))]
    offsets = [HEADER_SCALARS + 4 * i for i in range(len(names))]
    at = HEADER_SIZE
    for table in layout.tables:
        size = table.values.dtype.itemsize
        offsets += [(at + size * i) | (HALF if size == 2 else 0) for i in range(table.values.size)]
        names += ["_".join(filter(None, (table.owner, table.field)))] * table.values.size
        at += -(-size * table.values.size // TABLE_ALIGNMENT) * TABLE_ALIGNMENT
    return np.array(offsets, np.uint32), names
