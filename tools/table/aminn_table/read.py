"""Read a table of pushes from a file or a bag into checked arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand import Hand

from .bags import is_bag, read_bag
from .checks import Fault, Rows, TableError, check, settled
from .columns import GROUPS, KNOWN, ON, SENSORS, STATE, Arrays, Column, Place, column_of, columns_of, shapes_of
from .files import FRAME, Raw, read_raw
from .mapping import PALM_NAMES, UNITS, ColumnTable, Frames, Map, in_palm
from .sensing import with_sensors


def read_table(path: AnyPath, hand: Hand, need: Sequence[str] = STATE, by: Map | None = None) -> Arrays:
    """Arrays of the pushes of this hand in a CSV, Parquet or HDF5 file, or in a ROS 2 bag.

    Those of `need`, and all others that it tells; features of contacts that it does not tell are NaN (`complete` fills
    them in). `by` says where a file has what is called otherwise here, and all of a bag. Raises TableError with every
    fault, by column and row, or topic and message; AminnError where the file cannot be read.
    """
    by = by or Map()
    return assemble(_raw(path, hand, by), hand, need, by)


def _raw(path: AnyPath, hand: Hand, by: Map) -> Raw:
    return read_bag(path, hand, by) if is_bag(path) else _renamed(read_raw(path), hand, by)


@dataclass(frozen=True)
class Rough:
    """Every row of a table, whatever is wrong with some of them."""

    arrays: Arrays
    """Columns that are told, as `read_table` gives them."""
    bad: NDArray[np.bool_]
    """(n) rows in which a number of the state is missing."""
    rows: Rows
    faults: tuple[Fault, ...]
    """What is wrong with states, theta and sensors: of bad rows, and of others that are hard to believe."""


def read_rough(table: AnyPath | Raw, hand: Hand, by: Map | None = None) -> Rough:
    """Every row of a file, bag or columns of states.

    Raises TableError for columns that are missing, unknown or no numbers, AminnError where a file cannot be read.
    """
    by = by or Map()
    raw = _renamed(table, hand, by) if isinstance(table, Raw) else _raw(table, hand, by)
    arrays, faults = _gathered(raw, hand, STATE, by)
    if whole := [fault for fault in faults if fault.row is None]:
        raise TableError(raw.source, whole)
    looked_at = {name: arrays[name] for name in (*STATE, "theta") if name in arrays}
    for name in (name for name in SENSORS if name in arrays):  # what contradicts itself is a fault already
        looked_at[name] = np.where(np.isnan(arrays[name][:, [KNOWN]]), 0.0, arrays[name])
    contacts = looked_at["contacts"]
    missing = np.isnan(contacts) & ~np.isnan(contacts).all(0)
    bad = missing[..., ON].any(1) | (missing & (contacts[..., ON:1] != 0)).any((1, 2))
    for name in looked_at.keys() - {"contacts", *SENSORS}:
        bad |= ~np.isfinite(looked_at[name]).all(1)
    faults += check(hand, looked_at, raw.rows)
    if bad.any() and not bad.all():  # of a table with gaps these alone were looked for
        kept = {name: values[~bad] for name, values in looked_at.items()}
        faults += check(hand, kept, Rows(raw.rows.label, raw.rows.numbers[~bad]))
    return Rough(settled(arrays), bad, raw.rows, tuple(dict.fromkeys(faults)))


def _renamed(raw: Raw, hand: Hand, by: Map) -> Raw:
    """The columns under the names that the map gives them."""
    columns, factors, strange = dict(raw.columns), dict(raw.factors), list(raw.strange)
    known = {c.name: c for c in columns_of(hand)}
    for name, source in by.columns.items():
        if name not in known:
            near = _near(name, list(known))
            hint = f"; did you mean {near}?" if near else ""
            raise AminnError(f"the map has columns.{name}, which is no column of a table of hand {hand.name}{hint}")
        told = source if isinstance(source, ColumnTable) else ColumnTable(column=source)
        unit, factor = UNITS[told.unit] if told.unit is not None else (known[name].unit, 1.0)
        if unit != known[name].unit:
            raise AminnError(f"the map has {name} in {told.unit}, and its unit is {known[name].unit}")
        if told.column not in raw.columns:
            near = _near(told.column, list(raw.columns))
            strange.append(
                Fault(told.column, f"is missing, which is to be {name}" + (f"; did you mean {near!r}?" if near else ""))
            )
            continue
        columns.pop(told.column, None)
        columns[name] = raw.columns[told.column]
        factors[name] = factor * told.sign
    return replace(raw, columns=columns, factors=factors, strange=tuple(strange))


def assemble(raw: Raw, hand: Hand, need: Sequence[str], by: Map) -> Arrays:
    """Arrays of named columns, checked and settled. Raises TableError with every fault."""
    arrays, faults = _gathered(raw, hand, need, by)
    if faults := faults or check(hand, arrays, raw.rows):
        raise TableError(raw.source, faults)
    return settled(arrays)


def _gathered(raw: Raw, hand: Hand, need: Sequence[str], by: Map) -> tuple[Arrays, list[Fault]]:
    """Arrays of named columns, and which cells are no numbers. Raises TableError for columns that cannot be."""
    columns = _told(hand, need, _by_names(raw, hand, by.ignore))
    faults = [*raw.strange, *_frames(raw, by), *_names(raw, hand, need, columns)]
    n = len(raw.rows.numbers)
    if not n and not faults:
        faults = [Fault("the table", "has no rows")]
    if faults:
        raise TableError(raw.source, faults)
    parts: dict[str, dict[Place, NDArray]] = {}
    for column in columns_of(hand):
        if column.name in columns:
            values, wrong = _converted(column, columns[column.name], raw.rows)
            factor = raw.factors.get(column.name, 1.0)
            parts.setdefault(column.array, {})[column.at] = values * factor if factor != 1 else values
            faults += wrong
    shapes = shapes_of(hand)
    cells = {name: _joined(shapes[name], found, n) for name, found in parts.items()}
    arrays, strange = with_sensors(hand, cells, raw.rows)
    return in_palm(Frames(hand, by.frames), arrays, _told_frames(raw)), faults + strange


def _joined(shape: Place, parts: dict[Place, NDArray], n: int) -> NDArray:
    """An array with rows of a shape from the numbers at its places; NaN where there is none."""
    if not shape:
        return parts[()]
    nothing = np.full(n, math.nan)
    return np.stack([parts.get(at, nothing) for at in np.ndindex(shape)], 1).reshape(n, *shape)


def _by_names(raw: Raw, hand: Hand, ignore: Sequence[str]) -> dict[str, NDArray]:
    """Columns by their proper names; those of arrays without names are found by their place.

    An array of a sensor that has one number less tells its values alone.
    """
    placed = {f"{c.array}[{', '.join(map(str, c.at))}]": c.name for c in columns_of(hand) if c.at}
    for name, (size,) in hand.dims.sensors.items():
        if f"{name}[{size - 2}]" in raw.columns and f"{name}[{size - 1}]" not in raw.columns:
            placed |= {f"{name}[{i}]": column_of(hand, name, (i + 1,)).name for i in range(size - 1)}
    named = {placed.get(name, name): values for name, values in raw.columns.items()}
    return {name: v for name, v in named.items() if not any(fnmatchcase(name, pattern) for pattern in ignore)}


def _told(hand: Hand, need: Sequence[str], found: dict[str, NDArray]) -> dict[str, NDArray]:
    """Columns but those of groups that nobody needs and that are empty in every row."""
    out = dict(found)
    for group in GROUPS:
        own = [c.name for c in group.columns(hand) if c.name in found]
        if group.array not in need and len(own) == len(group.columns(hand)) and all(_empty(found[n]) for n in own):
            out = {name: values for name, values in out.items() if name not in own}
    return out


def _empty(values: NDArray) -> bool:
    if values.dtype.kind == "f":
        return bool(np.isnan(values).all())
    return values.dtype.kind == "O" and not any(str("" if v is None else v).strip() for v in values)


def _told_frames(raw: Raw) -> dict[str, str]:
    """Frame of each array that the file says is in another one; of all of them under an empty name."""
    parts = {key: key.partition(".") for key in raw.told}
    return {p[2]: raw.told[key] for key, p in parts.items() if p[0] == FRAME and raw.told[key] not in PALM_NAMES}


def _frames(raw: Raw, by: Map) -> Iterator[Fault]:
    for array, frame in _told_frames(raw).items():
        if frame not in by.frames:
            how = f"tell in [frames.{frame}] of a map how that stands in it"
            yield Fault(array or "the table", f"is stated in frame {frame!r}, expected the palm's: {how}")


def _names(raw: Raw, hand: Hand, need: Sequence[str], found: Iterable[str]) -> Iterator[Fault]:
    """Columns that are missing or unknown, with the nearest name of the other kind."""
    known = {c.name: c for c in columns_of(hand)}
    unknown = [name for name in found if name not in known]
    absent = [name for name in known if name not in found]
    missing = list(_missing(hand, need, set(found)))
    for name in missing:
        near = _near(name, unknown)
        yield Fault(name, "is missing" + (f"; did you mean it with {near!r}?" if near else ""))
        unknown = [n for n in unknown if n != near]
    for name in unknown:
        near = _near(name, absent)
        hint = f"; did you mean {near}?" if near else "; leave it out, or name it in `ignore` of a map"
        yield Fault(name, f"is no column of a table of hand {hand.name}{hint}")


def _missing(hand: Hand, need: Sequence[str], found: set[str]) -> Iterator[str]:
    for group in GROUPS:
        columns = group.columns(hand)
        contacts = group.array == "contacts"  # each branch has its own sensors
        parts = [[c.name for c in columns if not contacts or c.at[0] == b] for b in range(hand.dims.branches)]
        wanted = group.array in need and (not contacts or columns[0].at[1] == ON)
        for names in parts if contacts else parts[:1]:
            if wanted or any(name in found for name in names):
                yield from (name for name in names if name not in found)


def _near(name: str, others: Sequence[str]) -> str | None:
    plain: dict[str, str] = {_plain(other): other for other in others}
    found = get_close_matches(_plain(name), list(plain), 1, 0.8)
    return plain[found[0]] if found else None


def _plain(name: str) -> str:
    return "".join(c for c in name.lower() if c.isalnum())


def _converted(column: Column, values: NDArray, rows: Rows) -> tuple[NDArray, list[Fault]]:
    """A column's numbers, and what is none."""
    if column.unit == "text":
        return np.array(["" if v is None else str(v) for v in values], object), []
    whole = column.unit == "integer"
    if values.dtype.kind in "iub":
        return values.astype(np.int64 if whole else np.float64), []
    if values.dtype.kind == "f":
        if not whole:
            return values.astype(np.float64), []
        bad = ~np.isfinite(values) | (values != np.round(values)) | (np.abs(values) > 2**53)
        faults = rows.fault(column.name, bad, lambda i: f"is {values[i]:g}, expected a whole number")
        return np.where(bad, 0, values).astype(np.int64), list(faults)
    if values.dtype.kind != "O":
        return np.zeros(len(values)), [Fault(column.name, f"holds {values.dtype}, expected one number per row")]
    parse: Callable[[str], float | None] = _whole if whole else _number
    read = [parse("" if v is None else str(v)) for v in values]
    bad = np.array([r is None for r in read], bool)
    faults = rows.fault(
        column.name,
        bad,
        lambda i: f"is {str(values[i]).strip()!r}, expected a {'whole ' if whole else ''}number{_comma(values[i])}",
    )
    none = 0 if whole else math.nan
    return np.array([none if r is None else r for r in read], np.int64 if whole else np.float64), list(faults)


WORDS = {"": math.nan, "true": 1.0, "false": 0.0}


def _number(text: str) -> float | None:
    text = text.strip()
    if text.lower() in WORDS:
        return WORDS[text.lower()]
    try:
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _whole(text: str) -> int | None:
    text = text.strip().removesuffix(".0")
    return int(text) if text.lstrip("-").isdecimal() and abs(int(text)) < 2**63 else None


def _comma(text: object) -> str:
    return " with a decimal point" if isinstance(text, str) and "," in text else ""
