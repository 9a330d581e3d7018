"""The whole path on one machine: simulate, train, compare, export, compile, replay, report (`make demo`).

Every stage is the real one at a modest scale, and each is skipped when its result is there already: an interrupted demo
continues where it stopped.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from aminn.evaluation.evaluate import format_table
from aminn_base.files import write_json
from aminn_base.program import Messages

from .pipeline import run_report
from .whole_path import Stopwatch, whole_path

GRASPS, CASES = 960, 16


@click.command(cls=Messages)
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--grasps", type=click.IntRange(1), default=GRASPS, show_default=True)
@click.option("--cases", type=click.IntRange(1), default=CASES, show_default=True)
def main(build: Path, grasps: int, cases: int) -> None:
    """Run the whole path and end with the table, the runtime's differences and the place of the report page."""
    reports, watch = build / "reports", Stopwatch()
    done = whole_path(build / "demo", grasps, cases, build / "host", watch)
    page = reports / "demo.html"
    make_page = partial(run_report, done.result, done.checkpoints, done.replay, done.data, page, reports)
    watch.run("report", "Write the report page", make_page)
    write_json(reports / "demo.json", done.figures() | watch.seconds)
    click.echo(f"\n{format_table(done.result)}\n")
    click.echo("\n".join([*done.lines, ""]))
    click.echo(f"figures: {reports / 'demo.json'}\nreport page: {page}")
    if not done.replay["ok"]:
        raise click.ClickException("the runtime does not repeat ONNX Runtime; the differences stand above")


if __name__ == "__main__":
    main()
