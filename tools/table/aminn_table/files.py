"""Files of tables: CSV, Parquet, HDF5 and lines of JSON, told apart by what they hold, as named columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import ArrayLike, NDArray

from aminn_base.errors import AminnError
from aminn_base.hdf5 import read_field
from aminn_base.read import AnyPath, json_object, read_bytes, read_text

from .checks import Fault, Rows

FRAME = "frame"
"""What a file may say of itself: `frame = H`, or of one array `frame.w_e = tool`."""
MAGIC = {b"PAR1": "Parquet", b"\x89HDF\r\n\x1a\n": "HDF5"}
FORMATS = {".csv": "CSV", ".parquet": "Parquet", ".h5": "HDF5", ".hdf5": "HDF5", ".jsonl": "JSON"}
"""Format of a file that is written, by the end of its name."""


def format_of(path: AnyPath) -> str:
    """Format of a table that is to be written. Raises AminnError where the end of its name says none."""
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise AminnError(f"{path}: tables are {', '.join(FORMATS)}; give the file one of these ends")
    return kind


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
    factors: dict[str, float] = field(default_factory=dict)
    """What to multiply numbers of columns by."""


def read_raw(path: AnyPath) -> Raw:
    """The columns of a file. Raises AminnError where it is none of the formats, or damaged."""
    if Path(path).is_dir():
        raise AminnError(
            f"{path}: a folder without metadata.yaml is no ROS 2 bag; give its .mcap or .db3 file, or a table"
        )
    return raw_of(path, read_bytes(path))


def raw_of(path: AnyPath, content: bytes) -> Raw:
    """The columns in what a file holds; `path` is what messages call it."""
    if not content.strip():
        raise AminnError(f"{path}: is empty, expected a table of pushes")
    kind = next((kind for magic, kind in MAGIC.items() if content.startswith(magic)), "CSV")
    if content.lstrip().startswith(b"{"):
        return from_json(str(path), read_text(path, content))
    return {"CSV": _read_csv, "Parquet": _read_parquet, "HDF5": _read_hdf5}[kind](str(path), content)


def from_json(source: str, text: str) -> Raw:
    """A line per row: an object of columns, or of arrays of the design's names."""
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    rows: list[dict] = []
    for k, line in lines:
        try:
            rows.append(json_object(line))
        except ValueError as error:
            raise AminnError(f"{source}: line {k}: {error}") from error
        if rows[-1].keys() != rows[0].keys():
            other = sorted(rows[-1].keys() ^ rows[0].keys())[0]
            raise AminnError(f"{source}: line {k}: {other} is told in some lines and not in others")
    columns: dict[str, NDArray] = {}
    for name in rows[0] if rows else ():
        columns |= _spread(name, _values_of(source, name, [row[name] for row in rows]), None)
    return Raw(source, columns, Rows("line", np.array([k for k, _ in lines], np.int64)))


def _values_of(source: str, name: str, values: list) -> NDArray:
    """Numbers or texts of all lines (n, ...)."""
    if any(isinstance(v, str) for v in values):
        return np.array(values, object)
    whole = all(isinstance(v, int) for v in values)
    try:
        return np.array(values, np.int64 if whole else np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise AminnError(f"{source}: {name} is not numbers of one shape in all lines") from error


def from_columns(source: str, columns: Mapping[str, ArrayLike]) -> Raw:
    """Columns that a program has."""
    found = {str(name): np.asarray(values) for name, values in columns.items()}
    found = {name: _texts(v) if v.dtype.kind in "USO" else v for name, v in found.items()}
    if odd := [name for name, v in found.items() if v.ndim != 1]:
        raise AminnError(f"{source}: {odd[0]} has shape {found[odd[0]].shape}, expected one number per row")
    if len({len(v) for v in found.values()}) > 1:
        lengths = ", ".join(f"{k} {len(v)}" for k, v in found.items())
        raise AminnError(f"{source}: columns have different lengths: {lengths}")
    return Raw(source, found, Rows.counted(len(next(iter(found.values()), ()))))


NOTHING = ("None", "nan", "NaT", "<NA>")
"""How data frames say that a cell is empty, as text."""


def _texts(values: NDArray) -> NDArray:
    """Cells of any kind, those that are empty None."""
    flat = [None if not isinstance(v, str) and str(v) in NOTHING else v for v in values.ravel().tolist()]
    out = np.empty(values.size, object)
    out[:] = flat
    return out.reshape(values.shape)


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
    columns, strange = {}, []
    try:
        table = pq.read_table(pa.BufferReader(content))
        names = table.column_names
        for name, column in zip(names, table.columns, strict=True):
            if pa.types.is_null(column.type):
                columns[name] = np.full(table.num_rows, np.nan)
            elif not _is_text(column.type) and not _is_number(column.type):
                strange.append(Fault(name, f"holds {column.type}, expected one number per row"))
            elif _is_text(column.type):
                columns[name] = np.array(column.to_pylist(), object)
            elif pa.types.is_integer(column.type) and not column.null_count:
                columns[name] = column.to_numpy()
            else:
                columns[name] = column.cast(pa.float64(), safe=False).to_numpy()
        pairs = (table.schema.metadata or {}).items()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise AminnError(f"{path}: not a readable Parquet file ({_first_line(error)}); write it again") from error
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise AminnError(f"{path}: two columns are called {twice[0]!r}; give each its own name")
    told = {key.decode(errors="replace"): value.decode(errors="replace") for key, value in pairs}
    return Raw(path, columns, Rows.counted(table.num_rows), told, tuple(strange))


def _is_number(kind: pa.DataType) -> bool:
    return any(of(kind) for of in (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_decimal))


def _is_text(kind: pa.DataType) -> bool:
    return any(of(kind) for of in (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary))


def _read_hdf5(path: str, content: bytes) -> Raw:
    """Arrays of the design's names, spread into the columns that they are; others stay what they are."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            arrays = {n: read_field(item, len(content)) for n, item in file.items() if isinstance(item, h5py.Dataset)}
            names = {name: item.attrs.get("columns") for name, item in file.items() if name in arrays}
            told = {name: str(value) for name, value in file.attrs.items()}
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:  # all of them h5py's
        raise AminnError(f"{path}: not a readable HDF5 file ({_first_line(error)}); write it again") from error
    lengths = {name: len(values) for name, values in arrays.items() if np.ndim(values)}
    if not lengths:
        raise AminnError(f"{path}: has no arrays at its root, expected q, x_ht, w_e, contacts with one row per push")
    if len(set(lengths.values())) > 1 or len(lengths) < len(arrays):
        raise AminnError(f"{path}: arrays have different lengths: " + ", ".join(f"{k} {n}" for k, n in lengths.items()))
    columns: dict[str, NDArray] = {}
    for name, values in arrays.items():
        if h5py.check_string_dtype(values.dtype):
            if values.ndim != 1:
                raise AminnError(f"{path}: {name} holds texts in {values.ndim} dimensions, expected one text per row")
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
