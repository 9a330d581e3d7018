"""Read a table of pushes: CSV, Parquet or HDF5, told apart by what the file holds."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_bytes, read_text
from aminn_hand import Hand

from .checks import Fault, Rows, TableError, check, settled
from .columns import GROUPS, ON, PALM, STATE, Arrays, Column, Place, columns_of, shapes_of

FRAME = "frame"
"""What a file may say of itself: `frame = H`, or of one array `frame.w_e = tool`."""
PALM_NAMES = (PALM, "palm")
MAGIC = {b"PAR1": "Parquet", b"\x89HDF\r\n\x1a\n": "HDF5"}
FORMATS = {".csv": "CSV", ".parquet": "Parquet", ".h5": "HDF5", ".hdf5": "HDF5"}
"""Format of a file that is written, by the end of its name."""


@dataclass(frozen=True)
class Raw:
    """Named columns as a file has them, before anything is known of their meaning."""

    source: str
    columns: dict[str, NDArray]
    """Numbers, or texts (dtype object) of a file of text; an empty text is no number."""
    rows: Rows
    told: dict[str, str] = field(default_factory=dict)
    """What the file says of itself."""
    strange: tuple[Fault, ...] = ()
    """What was wrong with cells already."""


def read_table(path: AnyPath, hand: Hand, need: Sequence[str] = STATE, ignore: Sequence[str] = ()) -> Arrays:
    """Arrays of a table of pushes of this hand: those of `need`, and all others that it tells.

    Features of contacts that it does not tell are NaN (`complete` fills them in). Columns whose names match a pattern
    of `ignore` are left out. Raises TableError with every fault of the table, by column and row; AminnError where the
    file cannot be read.
    """
    return assemble(read_raw(path), hand, need, ignore)


def read_raw(path: AnyPath) -> Raw:
    """The columns of a file. Raises AminnError where it is none of the formats, or damaged."""
    content = read_bytes(path)
    if not content.strip():
        raise AminnError(f"{path}: is empty, expected a table of pushes")
    kind = next((kind for magic, kind in MAGIC.items() if content.startswith(magic)), "CSV")
    return {"CSV": _read_csv, "Parquet": _read_parquet, "HDF5": _read_hdf5}[kind](str(path), content)


def _read_csv(path: str, content: bytes) -> Raw:
    if b"\0" in content[:1000]:
        raise AminnError(f"{path}: no CSV, Parquet or HDF5 file; save the table as one of these")
    lines = read_text(path, content).split("\n")
    told, start = {}, 0
    while start < len(lines) and lines[start].startswith("#"):
        key, _, value = lines[start][1:].partition("=")
        told[key.strip()] = value.strip()
        start += 1
    delimiter = max(",;\t", key=lines[start].count) if start < len(lines) else ","
    reader = csv.reader(lines[start:], delimiter=delimiter, strict=True)
    try:
        header = [name.strip() for name in next(reader, [])]
        if twice := sorted({name for name in header if header.count(name) > 1}):
            raise AminnError(f"{path}: line {start + 1}: two columns are called {twice[0]!r}; give each its own name")
        cells, numbers = [], []
        for row in reader:
            line = start + reader.line_num
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                raise AminnError(f"{path}: line {line}: has {len(row)} cells, the header has {len(header)} columns")
            cells.append(row)
            numbers.append(line)
    except csv.Error as error:
        raise AminnError(f"{path}: line {start + reader.line_num}: not valid CSV ({error})") from error
    table = np.array(cells, object).reshape(len(cells), len(header))
    return Raw(
        path, {name: table[:, k] for k, name in enumerate(header)}, Rows("line", np.array(numbers, np.int64)), told
    )


def _read_parquet(path: str, content: bytes) -> Raw:
    try:
        table = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as error:
        raise AminnError(f"{path}: not a readable Parquet file ({_first_line(error)}); write it again") from error
    if twice := sorted({n for n in table.column_names if table.column_names.count(n) > 1}):
        raise AminnError(f"{path}: two columns are called {twice[0]!r}; give each its own name")
    columns, strange = {}, []
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = column.type
        if pa.types.is_integer(kind) and not column.null_count:
            columns[name] = column.to_numpy()
        elif pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
            columns[name] = column.cast(pa.float64(), safe=False).to_numpy()
        elif pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_dictionary(kind):
            columns[name] = np.array(column.to_pylist(), object)
        else:
            strange.append(Fault(name, f"holds {kind}, expected one number a row"))
    told = {k.decode(errors="replace"): v.decode(errors="replace") for k, v in (table.schema.metadata or {}).items()}
    return Raw(path, columns, Rows.counted(table.num_rows), told, tuple(strange))


def _read_hdf5(path: str, content: bytes) -> Raw:
    """Arrays of the design's names, spread into the columns that they are; others stay what they are."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            arrays = {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
            names = {name: item.attrs.get("columns") for name, item in file.items() if name in arrays}
            told = {name: str(value) for name, value in file.attrs.items()}
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:  # all of them h5py's
        raise AminnError(f"{path}: not a readable HDF5 file ({_first_line(error)}); write it again") from error
    lengths = {name: len(values) for name, values in arrays.items() if np.ndim(values)}
    if not lengths:
        raise AminnError(f"{path}: has no arrays at its root, expected q, x_ht, w_e, contacts with a row a push")
    if len(set(lengths.values())) > 1 or len(lengths) < len(arrays):
        raise AminnError(f"{path}: arrays have different lengths: " + ", ".join(f"{k} {n}" for k, n in lengths.items()))
    columns: dict[str, NDArray] = {}
    for name, values in arrays.items():
        if h5py.check_string_dtype(values.dtype):
            columns[name] = np.array([v.decode(errors="replace") for v in values], object)
            continue
        own = None if names[name] is None else [str(n) for n in np.ravel(names[name])]
        columns |= _spread(name, values, own)
    return Raw(path, columns, Rows.counted(next(iter(lengths.values()))), told)


def _spread(name: str, values: NDArray, own: list[str] | None) -> dict[str, NDArray]:
    """An array as columns: `own` names, or `name[i, j]` for what `assemble` finds by its place."""
    flat = values.reshape(len(values), -1)
    if own is None or len(own) != flat.shape[1]:
        own = [f"{name}[{', '.join(map(str, at))}]" if at else name for at in np.ndindex(values.shape[1:])]
    return dict(zip(own, flat.T, strict=True))


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def assemble(raw: Raw, hand: Hand, need: Sequence[str] = STATE, ignore: Sequence[str] = ()) -> Arrays:
    """Arrays of named columns, checked and settled. Raises TableError with every fault."""
    columns = _by_names(raw, hand, ignore)
    faults = [*raw.strange, *_frames(raw), *_names(raw, hand, need, columns)]
    n = len(raw.rows.numbers)
    if not n and not faults:
        faults = [Fault("the table", "has no rows")]
    if faults:
        raise TableError(raw.source, faults)
    parts: dict[str, dict[Place, NDArray]] = {}
    for column in columns_of(hand):
        if column.name in columns:
            values, wrong = _converted(column, columns[column.name], raw.rows)
            parts.setdefault(column.array, {})[column.at] = values
            faults += wrong
    if faults:
        raise TableError(raw.source, faults)
    shapes = shapes_of(hand)
    arrays = {name: _joined(shapes[name], found, n) for name, found in parts.items()}
    if faults := check(hand, arrays, raw.rows):
        raise TableError(raw.source, faults)
    return settled(arrays)


def _joined(shape: Place, parts: dict[Place, NDArray], n: int) -> NDArray:
    """An array with rows of a shape from the numbers at its places; NaN where there is none."""
    if not shape:
        return parts[()]
    nothing = np.full(n, math.nan)
    return np.stack([parts.get(at, nothing) for at in np.ndindex(shape)], 1).reshape(n, *shape)


def _by_names(raw: Raw, hand: Hand, ignore: Sequence[str]) -> dict[str, NDArray]:
    """Columns by their proper names; those of arrays without names are found by their place."""
    placed = {f"{c.array}[{', '.join(map(str, c.at))}]": c.name for c in columns_of(hand) if c.at}
    named = {placed.get(name, name): values for name, values in raw.columns.items()}
    return {name: v for name, v in named.items() if not any(fnmatchcase(name, pattern) for pattern in ignore)}


def _frames(raw: Raw) -> Iterator[Fault]:
    for key, value in raw.told.items():
        name, _, array = key.partition(".")
        if name == FRAME and value not in PALM_NAMES:
            what = array or "the table"
            yield Fault(
                what,
                f"is stated in frame {value!r}, expected the palm's ({PALM}): tell how {value} stands in it in a map",
            )


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
        names = [c.name for c in group.columns(hand)]
        told = [name for name in names if name in found]
        wanted = group.array in need and (group.array != "contacts" or group.columns(hand)[0].at[1] == ON)
        if wanted or told:
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
        return np.zeros(len(values)), [Fault(column.name, f"holds {values.dtype}, expected one number a row")]
    parse: Callable[[str], float | None] = _whole if whole else _number
    read = [parse("" if v is None else str(v)) for v in values]
    bad = np.array([r is None for r in read], bool)
    faults = rows.fault(
        column.name,
        bad,
        lambda i: f"is {str(values[i]).strip()!r}, expected a {'whole ' if whole else ''}number{_comma(values[i])}",
    )
    return np.array([0 if r is None else r for r in read], np.int64 if whole else np.float64), list(faults)


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
