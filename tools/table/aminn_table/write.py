"""Write a table of pushes; the same arrays give the same bytes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import finite, write_atomically
from aminn_base.read import AnyPath
from aminn_hand import Hand

from .columns import DTYPES, GROUPS, KNOWN, PALM, RESULTS, SENSORS, Arrays, column_of, columns_of, numbers, shapes_of
from .files import FRAME, format_of


def write_table(path: AnyPath, hand: Hand, arrays: Arrays) -> None:
    """Write arrays (leading dimension n) as a table, in the format that the end of the name says.

    CSV and Parquet have one column per number, HDF5 and lines of JSON one array per name. Columns that are NaN in every
    row are left out of CSV and Parquet, but for predictions. Raises AminnError for another name, WriteError where it
    cannot be written.
    """
    kind = format_of(path)
    shapes = shapes_of(hand)
    if unknown := sorted(set(arrays) - set(shapes)):
        raise AminnError(f"{unknown[0]} is no array of a table; there are {', '.join(shapes)}")
    typed: Arrays = {k: np.asarray(arrays[k], DTYPES.get(k, np.float64)) for k in shapes if k in arrays}
    form = {"CSV": _csv, "Parquet": _parquet, "HDF5": _hdf5, "JSON": _json}[kind]
    write_atomically(path, form(hand, typed))


def template(hand: Hand) -> str:
    """A table of a lab's pushes without rows: every column with unit, frame and meaning, then the header of a CSV.

    `read_table` takes it with rows below; columns that stay empty count as left out.
    """
    lines, names = [f"# {FRAME} = {PALM}"], list[str]()
    for group in GROUPS:
        if group.need == "results" or (group.unit == "flag" and group.array in SENSORS):  # an empty cell says as much
            continue
        for column in group.columns(hand):
            of = ", ".join(filter(None, (column.unit, group.frame and f"axes of {group.frame}", group.need)))
            lines.append(f"# {column.name} ({of}): {group.meaning}")
            names.append(column.name)
    return "\n".join([*lines, ",".join(names)]) + "\n"


def _columns(hand: Hand, arrays: Arrays) -> dict[str, NDArray]:
    found = {c: numbers(arrays[c.array], c.at) for c in columns_of(hand) if c.array in arrays}
    for c in [c for c in found if c.array in SENSORS]:  # that a cell is empty says as much as the flag
        unknown = arrays[c.array][:, KNOWN] == 0
        found[c] = np.where(unknown | (c.at == (KNOWN,)), np.nan, found[c])
    return {
        c.name: v
        for c, v in found.items()
        if c.array in RESULTS or v.dtype.kind != "f" or not len(v) or not np.isnan(v).all()
    }


def _csv(hand: Hand, arrays: Arrays) -> bytes:
    columns, out = _columns(hand, arrays), io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    texts = [
        ["" if v != v else str(v) if isinstance(v, str) else repr(v) for v in c.tolist()] for c in columns.values()
    ]
    writer.writerows(zip(*texts, strict=True))
    return f"# {FRAME} = {PALM}\n{out.getvalue()}".encode()


def _parquet(hand: Hand, arrays: Arrays) -> bytes:
    columns = {k: pa.array(v.tolist() if v.dtype.kind == "O" else v) for k, v in _columns(hand, arrays).items()}
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns).replace_schema_metadata({FRAME: PALM}), sink)
    return bytes(sink.getvalue())


def _hdf5(hand: Hand, arrays: Arrays) -> bytes:
    out = io.BytesIO()
    with h5py.File(out, "w", libver=("v110", "v110")) as file:
        file.attrs[FRAME] = PALM
        for name, values in arrays.items():
            text = h5py.string_dtype() if values.dtype.kind == "O" else None
            rows = file.create_dataset(name, data=values, dtype=text, track_times=False)
            own = [column_of(hand, name, at).name for at in np.ndindex(values.shape[1:])]
            rows.attrs["columns"] = np.array(own, h5py.string_dtype())
    return out.getvalue()


def _json(hand: Hand, arrays: Arrays) -> bytes:
    return "".join(line + "\n" for line in json_lines(hand, arrays)).encode()


def json_lines(hand: Hand, arrays: Arrays) -> Iterator[str]:
    """A line per row: an object of arrays by their names. What is no number is null, a flag true or false."""
    lists = {name: (values > 0 if _is_flag(hand, name) else values).tolist() for name, values in arrays.items()}
    for row in zip(*lists.values(), strict=True):
        yield json.dumps({name: finite(value) for name, value in zip(lists, row, strict=True)})


def _is_flag(hand: Hand, name: str) -> bool:
    return shapes_of(hand)[name] == () and column_of(hand, name, ()).unit == "flag"
