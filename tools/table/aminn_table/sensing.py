"""Cells of optional sensors as the arrays that everything else takes (aminn_hand.sensors): known or not, then values.

An empty cell is not known. A row whose cells contradict each other is a fault, and NaN.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from aminn_hand import Hand
from aminn_hand.sensors import CLASS_NAMES, DEFAULT_DEVIATION, FRICTION, FRICTION_CLASSES

from .checks import Array, Fault, Mask, Rows
from .columns import FRICTION_CLASS, KNOWN, SENSORS, Arrays, Column, column_of, columns_of

Found = tuple[Column, Mask, str]
"""Column, rows that are at fault, and what is wrong with them; {} stands for what the cell holds."""


def with_sensors(hand: Hand, arrays: Arrays, rows: Rows) -> tuple[Arrays, list[Fault]]:
    """Arrays of a table with those of sensors made of their cells; sensors that no row tells are left out."""
    out = {name: values for name, values in arrays.items() if name not in (*SENSORS, FRICTION_CLASS)}
    faults: list[Fault] = []
    for name in SENSORS:
        texts = arrays.get(FRICTION_CLASS) if name == FRICTION else None
        if name not in arrays and texts is None:
            continue
        n = len(rows.numbers)
        cells = arrays[name] if name in arrays else np.full((n, *hand.dims.sensors[name]), np.nan)
        flag = cells[:, KNOWN]
        strange = ~np.isin(flag, (0, 1)) & ~np.isnan(flag)
        found = [(column_of(hand, name, (KNOWN,)), strange, "is {}, expected 0 or 1")]
        cells = np.where((flag == 0)[:, None], np.nan, cells)
        if name == FRICTION:
            texts = np.where(flag == 0, "", np.full(n, "", object) if texts is None else texts)
            values, more = _friction(hand, cells, texts)
        else:
            values, more = _vector(hand, name, cells)
        bad = np.zeros(n, bool)
        for column, mask, text in (*found, *more):
            held = texts if texts is not None and column.at == () else cells[:, column.at[0]]
            faults += rows.fault(column.name, mask & ~bad, lambda i, h=held, t=text: t.format(_shown(h[i])))  # type: ignore[misc]
            bad |= mask
        values[bad] = np.nan
        if bad.any() or values[:, KNOWN].any():
            out[name] = values
    return out, faults


def _shown(cell: object) -> str:
    return f"{cell:.4g}" if isinstance(cell, float) else repr(str(cell).strip())


def _friction(hand: Hand, cells: Array, texts: NDArray[np.object_]) -> tuple[Array, Iterator[Found]]:
    """friction (n, 3) of known, value, deviation and class."""
    flag, value, deviation = cells.T
    names = np.array([str(text).strip().lower() for text in texts])
    told, classed = ~np.isnan(value), np.array([text != "" for text in names])
    out = np.zeros_like(cells)
    share = np.where(np.isfinite(value), DEFAULT_DEVIATION * np.abs(value), 0.0)
    assumed = np.where(np.isnan(deviation), share, deviation)
    out[told] = np.stack([told, value, assumed], 1)[told]
    for name, numbers in FRICTION_CLASSES.items():
        out[np.array([text == name for text in names], bool)] = numbers

    def faults() -> Iterator[Found]:
        own = {c.name: c for c in columns_of(hand) if c.array in (FRICTION, FRICTION_CLASS)}
        kinds = f"{', '.join(CLASS_NAMES[:-1])} or {CLASS_NAMES[-1]}"
        yield own["friction_class"], classed & ~np.isin(names, CLASS_NAMES), f"is {{}}, expected {kinds}, or nothing"
        yield (
            own["friction_class"],
            classed & (told | ~np.isnan(deviation)),
            "is {} beside a number of friction: tell the class or the number",
        )
        yield own["friction_sd"], ~told & ~np.isnan(deviation), "is {}, and friction is empty: tell both, or none"
        yield own["friction"], ~told & ~classed & (flag == 1), "is empty, and friction_known is 1"

    return out, faults()


def _vector(hand: Hand, name: str, cells: Array) -> tuple[Array, Iterator[Found]]:
    """Known and values of cells (n, 1 + values)."""
    told = ~np.isnan(cells[:, KNOWN + 1 :])
    count = told.sum(1)
    whole, some = count == told.shape[1], count > 0
    out = np.where(whole[:, None], cells, 0.0)
    out[:, KNOWN] = whole

    def faults() -> Iterator[Found]:
        for i in range(told.shape[1]):
            column = column_of(hand, name, (KNOWN + 1 + i,))
            yield column, some & ~told[:, i], "is empty, and others of the row are not: tell all of them, or none"
            yield column, ~some & (cells[:, KNOWN] == 1), f"is empty, and {name}_known is 1"

    return out, faults()
