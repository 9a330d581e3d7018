"""`aminn compare RUN...`, which ends `aminn sweep` as well: runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from aminn.data.dataset import load_dataset
from aminn.evaluation.evaluate import evaluate, names_of
from aminn.model.checkpoint import load_checkpoint
from aminn.pages.runs import write_runs_page
from aminn.training.runs import flat_runs, format_runs, grouped
from aminn_base.files import check_outputs, write_json


def compare_runs(
    folders: Sequence[Path],
    data: Path | None,
    page: Path | None,
    json_file: Path | None,
    provenance: Sequence[tuple[str, str]] = (),
) -> None:
    """Print the table of the runs; write their page and their figures where that is asked for.

    Figures are on the test grasps of `data`; without it on the validation grasps that chose each run.
    """
    check_outputs([page, json_file], [*folders, data])
    runs, split, figures = [load_checkpoint(folder) for folder in folders], "validation", None
    notes: tuple[str, ...] = ()
    if data is not None:
        split, result = "test", evaluate(runs, load_dataset(data))
        figures, notes = [result.table[name] for name in names_of(runs)], result.notes
        provenance = [*provenance, ("judged on", str(data))]
    groups = grouped(runs, figures)
    click.echo("\n".join([format_runs(groups, split), *notes]))
    if json_file:
        write_json(json_file, flat_runs(groups, split))
        click.echo(f"figures: {json_file}")
    if page:
        write_runs_page(groups, split, provenance, page)
        click.echo(f"page: {page}")
