"""Finished runs side by side: the settings in which they differ, and their figures over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from aminn_base.errors import AminnError

from ..evaluation.evaluate import KIND_NAMES, flat_key, format_columns
from ..evaluation.metrics import COLUMNS, SURE_COLUMNS, Column, spread
from ..model.checkpoint import Checkpoint
from .run_state import flat_settings

SEED, KIND, DATA = "config.seed", "config.kind", "data_sha256"
SHOWN = (
    "f1",
    "rmse_pose_all",
    "rmse_pose_stuck",
    "rmse_pose_slid",
    "relative_error_median_all",
    "relative_error_p90_all",
    "rmse_pose_refused_5pc",
    "bound_coverage",
    "passivity_violation_full",
)
"""Figures of the table; all others are in the flat report."""
Figures = Mapping[str, float | None]


@dataclass(frozen=True)
class Group:
    """Runs that differ in nothing but their seed."""

    name: str
    """The model's kind, and each setting in which it differs from another group."""
    runs: tuple[Checkpoint, ...]
    figures: tuple[Figures, ...]
    """Of each run, all on the same load cases if the runs are of one data set."""

    def over_seeds(self, figure: str) -> tuple[float, float] | None:
        """Mean and standard deviation of a figure; None where no run has it."""
        values = [v for run in self.figures if (v := run.get(figure)) is not None and np.isfinite(v)]
        return (float(np.mean(values)), spread(values)) if values else None


def grouped(runs: Sequence[Checkpoint], figures: Sequence[Figures] | None = None) -> list[Group]:
    """The runs by all but their seed, in the order given.

    figures: of each run; without them those on the validation grasps that chose it, which each run keeps. Raises
    AminnError for a folder whose training is not on record, and for one that is given twice.
    """
    places = [run.path.resolve() for run in runs]
    if len(set(places)) < len(places):
        raise AminnError(f"{max(places, key=places.count)}: this run is given twice; give each run once")
    settings = [_settings(run) for run in runs]
    found = [run.meta["validation"] for run in runs] if figures is None else figures
    members: dict[tuple, list[int]] = {}
    for i, own in enumerate(settings):
        members.setdefault(tuple(sorted((k, repr(v)) for k, v in own.items() if k != SEED)), []).append(i)
    firsts = [settings[own[0]] for own in members.values()]
    varied = sorted(k for k in set().union(*firsts) - {SEED, KIND} if len({repr(s.get(k)) for s in firsts}) > 1)
    return [
        Group(_name(settings[own[0]], varied), tuple(runs[i] for i in own), tuple(found[i] for i in own))
        for own in members.values()
    ]


def _settings(run: Checkpoint) -> dict[str, object]:
    if "identity" not in run.meta:
        raise AminnError(f"{run.path}: says nothing of its training; give folders that `aminn train` wrote")
    return flat_settings(run.meta["identity"])


def _name(settings: Mapping[str, object], varied: Sequence[str]) -> str:
    """The kind, then NAME VALUE of each setting that differs; of a hash its beginning."""
    values = {k: str(settings.get(k)) for k in varied}
    parts = [f"{k.removeprefix('config.')} {v[:8] if k in (DATA, 'finetune') else v}" for k, v in values.items()]
    kind = str(settings[KIND])
    return ", ".join([KIND_NAMES.get(kind, kind), *parts])


def notes(groups: Sequence[Group], split: str) -> list[str]:
    """What must be said beside the figures."""
    every = [run for group in groups for run in group.runs]
    hashes = {run.meta["identity"][DATA] for run in every}
    found = [f"figures on {split} grasps; ±: standard deviation over runs that differ in the seed alone"]
    if len(hashes) > 1:
        found.append("the runs were trained on different data sets; --data judges all of them on the same load cases")
    return found


def conclusion(groups: Sequence[Group], figure: str = "rmse_pose_all") -> str:
    """Which group errs least, and by how much; whether that is more than seeds make."""
    known = [(found, group) for group in groups if (found := group.over_seeds(figure))]
    if not known:
        return "No run has figures."
    known.sort(key=lambda entry: entry[0][0])
    (mean, sd), best = known[0]
    seeds = f" ± {sd:.4f} over {len(best.runs)} seeds" if len(best.runs) > 1 else ""
    text = f"{best.name} has the least RMSE_pose, {mean:.4f}{seeds}"
    if len(known) == 1:
        return text.replace("has the least RMSE_pose", "has an RMSE_pose of", 1).replace(", ", " ", 1) + "."
    (other, other_sd), second = known[1]
    text += f"; next is {second.name} with {other:.4f}"
    if len(best.runs) == 1 or len(second.runs) == 1:
        return text + ". One seed does not say whether that is chance."
    sure = other - mean > 2 * float(np.hypot(sd, other_sd))
    return text + (". Seeds do not explain that." if sure else ". Seeds alone differ by as much.")


def columns_of(groups: Sequence[Group]) -> dict[str, Column]:
    """The columns for which any run has a figure."""
    known = COLUMNS | {k: v for k, v in SURE_COLUMNS.items() if k not in COLUMNS}
    return {k: known[k] for k in SHOWN if any(group.over_seeds(k) for group in groups)}


def cells(group: Group, columns: Mapping[str, Column]) -> list[str]:
    """A group's row: name, number of runs, and the figures with their spread where there are several."""
    row = [group.name, str(len(group.runs))]
    for key, column in columns.items():
        found = group.over_seeds(key)
        values = ("-",) if found is None else found if len(group.runs) > 1 else found[:1]
        row.append(" ± ".join(v if isinstance(v, str) else column.form.format(v) for v in values))
    return row


def format_runs(groups: Sequence[Group], split: str) -> str:
    """The table for a terminal, with what must be said of it."""
    columns = columns_of(groups)
    rows = [["model", "runs", *(c.title for c in columns.values())], ["", "", *(c.unit for c in columns.values())]]
    rows += [cells(group, columns) for group in groups]
    return "\n".join([format_columns(rows), *notes(groups, split), conclusion(groups)])


def flat_runs(groups: Sequence[Group], split: str) -> dict[str, Any]:
    """Flat keys GROUP_FIGURE_mean, _sd and GROUP_runs, with the split that they are of."""
    flat: dict[str, Any] = {"split": split}
    for group in groups:
        start = flat_key(group.name)
        flat[f"{start}_runs"] = len(group.runs)
        for figure in group.figures[0]:
            found = group.over_seeds(figure)
            if found:
                flat |= {f"{start}_{figure}_mean": found[0], f"{start}_{figure}_sd": found[1]}
    return flat
