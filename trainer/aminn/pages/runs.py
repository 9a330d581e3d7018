"""The page of `aminn compare` and `aminn sweep`: runs side by side, with their training curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from aminn_base.page import picture, write_page
from aminn_base.read import AnyPath

from .. import __version__
from ..evaluation.metrics import COLUMNS
from ..model.checkpoint import Checkpoint
from ..training.runs import DATA, SEED, Group, cells, columns_of, conclusion, notes
from .report import STAGES, format_value, new_panel, tidy, tidy_losses

FEW, MANY = colormaps["tab10"], colormaps["tab20"]


def colours(count: int) -> list[str]:
    """A colour per group; beyond twenty they come again."""
    palette = FEW if count <= FEW.N else MANY
    return [to_hex(palette(k % palette.N)) for k in range(count)]


def curves(groups: Sequence[Group]) -> list[Figure]:
    """Validation loss by epoch; one panel per stage, one colour per group, one line per run."""
    figures = []
    for stage, text in STAGES.items():
        figure, ax = new_panel()
        for group, colour in zip(groups, colours(len(groups)), strict=True):
            for run in group.runs:
                losses = run.meta["history"].get(stage, {}).get("validation", [])
                ax.plot(np.arange(1, len(losses) + 1), losses, color=colour, linewidth=1.1)
        tidy_losses(ax)
        tidy(ax, "epoch", "validation loss", text)
        figures.append(figure)
    return figures


def _run(run: Checkpoint, group: Group, figures: dict) -> list[str]:
    """A run's row in the list of all."""
    best = [str(1 + int(np.argmin(v["validation"]))) for v in run.meta["history"].values()]
    seed = str(run.meta["identity"]["config"]["seed"])
    shown = [format_value(figures.get(k), COLUMNS[k].form) for k in ("f1", "rmse_pose_all")]
    return [str(run.path), group.name, seed, f"{run.meta['tau']:.3f}", ", ".join(best), *shown]


def write_runs_page(groups: Sequence[Group], split: str, provenance: Sequence[tuple[str, str]], out: AnyPath) -> None:
    """Write the page, one file of its own. provenance: what the groups do not tell, name and value."""
    every = [run for group in groups for run in group.runs]
    columns = columns_of(groups)
    facts = [
        *provenance,
        ("version", f"AMINN {__version__}"),
        ("hand", ", ".join(dict.fromkeys(run.model.hand.name for run in every))),
        ("trained on data", ", ".join(dict.fromkeys(run.meta["identity"][DATA][:16] for run in every))),
        ("training, load cases", ", ".join(dict.fromkeys(str(run.meta["data"]["train_samples"]) for run in every))),
        ("seeds", ", ".join(sorted({str(run.meta["identity"]["config"][SEED.split(".")[1]]) for run in every}))),
    ]
    caption = "Loss on validation data: one line per run, a colour for those that differ in the seed alone."
    key = list(zip([group.name for group in groups], colours(len(groups)), strict=True))
    write_page(
        Path(__file__).with_name("runs.html.j2"),
        out,
        conclusion=conclusion(groups),
        headings=["model", "runs", *((c.title, c.unit) for c in columns.values())],
        rows=[cells(group, columns) for group in groups],
        notes=notes(groups, split),
        pictures=[picture("Training", caption, curves(groups), key)],
        provenance=facts,
        runs=[_run(r, g, dict(f)) for g in groups for r, f in zip(g.runs, g.figures, strict=True)],
    )
