"""What the exporter needs of a model: constants and float32 tables, as `aminn.model.export_tables` gives them."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

STAGES = ("s1", "s2")


class Exported(Protocol):
    """An exported model; `aminn.model.export_tables.ExportedModel` is one."""

    @property
    def meta(self) -> dict:
        """Scalars and names."""

    @property
    def tensors(self) -> dict[str, NDArray[np.float32]]:
        """Tables by name, weights [out][in]; "s1." or "s2." before the name of a stage's own."""


def pair_of(value: object) -> tuple[float, float]:
    """A constant that may be one number or [stage 1, stage 2], as a pair."""
    first, second = value if isinstance(value, (list, tuple)) else (value, value)
    return float(first), float(second)
