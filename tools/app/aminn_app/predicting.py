"""`aminn predict`: a table in, predictions out."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import numpy as np

from aminn.prediction.predictor import Predictions, Predictor, Table
from aminn_base.errors import AminnError
from aminn_base.files import check_outputs
from aminn_base.progress import note, progress_bar
from aminn_table import read_map
from aminn_table.files import format_of, from_json, raw_of
from aminn_table.write import json_lines

SHOWN = 30
STDIN = "-"


def run_prediction(
    model: Path,
    table: str,
    out: Path | None,
    engine: str | None = None,
    calibration: Path | None = None,
    map_file: Path | None = None,
    threads: int = 0,
) -> None:
    """Predict for a table as the command line has it; write to `out`, else print lines of JSON.

    What is wrong with rows goes to standard error. Raises AminnError where no row can be predicted from, after all is
    written.
    """
    given = _table(table)
    check_outputs([out], [model, calibration, map_file, *([given] if isinstance(given, Path) else [])])
    if out is not None:
        format_of(out)
    predictor = Predictor(model, engine)
    by = read_map(map_file) if map_file else None
    with progress_bar("predicting", None, "row", delay=1.0, leave=False) as bar:
        found = predictor.predict(
            given, calibration=calibration, by=by, threads=threads, progress=lambda n: bar.update(n - bar.n)
        )
    _tell(found)
    held, bad = int(found.holds.sum()), np.count_nonzero(found.status)
    if out is None:
        for line in json_lines(found.hand, found.arrays):
            click.echo(line)
    else:
        found.write(out)
        noted = np.count_nonzero(found.notes[found.status == 0])
        counts = f"{len(found)} rows, {held} predicted to hold, {bad} without a prediction, {noted} with notes"
        click.echo(f"{counts}: {out}")
    if bad and bad == len(found):
        source = given if isinstance(given, Path) else "the table"
        raise AminnError(f"{source}: none of {bad} rows can be predicted from: {found.texts[0]}")


def _table(table: str) -> Table:
    if table == STDIN:
        return raw_of("standard input", sys.stdin.buffer.read())
    return from_json("TABLE", table) if table.lstrip().startswith("{") else Path(table)


def _tell(found: Predictions) -> None:
    for line in found.given.fallbacks:
        note(line)
    complaints = found.complaints()
    for line in complaints[:SHOWN]:
        click.echo(line, err=True)
    if len(complaints) > SHOWN:
        click.echo(f"and {len(complaints) - SHOWN} more", err=True)
