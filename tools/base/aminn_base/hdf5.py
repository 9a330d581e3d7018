"""Fields of HDF5 files that anybody may have written."""

from __future__ import annotations

import h5py
import numpy as np
from numpy.typing import NDArray

MOST_PACKED = 1032
"""Bytes that a byte of a file can stand for at most, by the compression that HDF5 has built in."""


def read_field(field: h5py.Dataset, file_bytes: int) -> NDArray:
    """All values of a field of a file of so many bytes.

    Raises ValueError where it says that it holds more than the file can: a few bytes can claim all memory.
    """
    claimed = int(np.prod(field.shape, dtype=object)) * field.dtype.itemsize if field.shape else 0
    if claimed > MOST_PACKED * file_bytes:
        raise ValueError(f"{field.name} claims {claimed:.1e} bytes, and the file has {file_bytes}")
    values: NDArray = np.asarray(field[()])
    return values
