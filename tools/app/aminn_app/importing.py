"""Measured pushes on their way into a data set: whose hand they are of, what is missing, and the folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from aminn.data.dataset import load_dataset
from aminn.data.measured import FALLBACKS, KNOWN_SHARES, mean_forces, write_measured
from aminn.model.checkpoint import META, load_checkpoint
from aminn_base.errors import AminnError
from aminn_base.files import refuse_inputs
from aminn_hand import Hand
from aminn_table import Map, TableError, complete, format_of, read_map, read_table, write_table
from aminn_table.columns import FORCE, LABELLED, MEASURED, ON, SENSORS, Arrays

SHOWN_FAULTS = 30
Like = tuple[Hand, list[float] | None]
"""A hand, and the mean normal force of each branch's contacts (B), N, where that is known."""


def hand_of(file: Path | None, like: Path | None) -> Like:
    """The hand of a hand file, or that of a run or data set. Raises AminnError unless it is one of them."""
    if (file is None) == (like is None):
        raise AminnError("say whose hand it is: --hand HAND.toml, or --like a run or data set of the same hand")
    if file is not None:
        from aminn_sim.understand import understand

        return understand(file).hand, None
    assert like is not None
    if (like / META).is_file():
        model = load_checkpoint(like).model
        return model.hand, mean_forces(model)
    data = load_dataset(like)
    contacts = data.samples["contacts"]
    on = contacts[..., ON] > 0
    return data.hand, ((contacts[..., FORCE] * on).sum(0) / np.maximum(on.sum(0), 1)).tolist()


def run_import(
    tables: Sequence[Path],
    hand: Path | None,
    like: Path | None,
    out: Path,
    echo: Callable[[str], object],
    map_file: Path | None = None,
    table: Path | None = None,
) -> dict:
    """Check tables and bags of pushes and write them as one data set to folder `out`; returns its manifest.

    `echo` gets every fault of a table before the error is raised, a line for each sensor that something stands in for,
    and the shares of pushes that tell the optional ones. Nothing is written where a table has a fault. What was read is
    written to `table` as well, as one table.
    """
    if table:
        format_of(table)
        refuse_inputs(table, tables)
    of, forces = hand_of(hand, like)
    by = read_map(map_file) if map_file else Map()
    measured = _together(tables, [_read(file, of, by, echo) for file in tables])
    arrays, notes = complete(of, measured, forces)
    manifest = write_measured(out, of, arrays, notes)
    if table:
        write_table(table, of, measured)
    for note in manifest[FALLBACKS]:
        echo(note)
    echo(f"known of the pushes: {', '.join(f'{name} {share:.0%}' for name, share in manifest[KNOWN_SHARES].items())}")
    return manifest


def _read(table: Path, hand: Hand, by: Map, echo: Callable[[str], object]) -> Arrays:
    try:
        return read_table(table, hand, LABELLED, by)
    except TableError as error:
        tell_faults(error, echo)
        raise


def tell_faults(error: TableError, echo: Callable[[str], object]) -> None:
    """Every fault of a table but the first, which the error itself names."""
    for fault in error.faults[1 : SHOWN_FAULTS + 1]:
        echo(f"{error.source}: {fault}")


def _together(tables: Sequence[Path], parts: Sequence[Arrays]) -> Arrays:
    """Tables one after the other; sensors that one does not tell are not known of its pushes.

    Raises AminnError where they do not tell the same else, or share a grasp.
    """
    shapes = {name: part[name].shape[1:] for part in parts for name in SENSORS if name in part}
    parts = [{name: np.zeros((len(part["q"]), *shape)) for name, shape in shapes.items()} | part for part in parts]
    first, holder = parts[0], dict[int, Path]()
    for table, part in zip(tables, parts, strict=True):
        told, wanted = (set(p) & set(MEASURED) for p in (part, first))
        if odd := sorted(told ^ wanted):
            has, lacks = (table, tables[0]) if odd[0] in told else (tables[0], table)
            raise AminnError(f"{has}: tells {odd[0]}, {lacks} does not; import them as data sets of their own")
        for grasp in np.unique(part["grasp_id"]).tolist():
            if grasp in holder:
                raise AminnError(
                    f"{table}: grasp_id {grasp} is in {holder[grasp]} too; give each closing of the hand its own number"
                )
            holder[grasp] = table
    return {name: np.concatenate([part[name] for part in parts]) for name in first if name in MEASURED}
