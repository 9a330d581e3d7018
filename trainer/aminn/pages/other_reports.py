"""What the report page says in tables of its own of hands, calibration and cost, where these were run."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

Figures = Mapping[str, float | int | str | bool | None]
Heading = str | tuple[str, str]


@dataclass(frozen=True)
class Told:
    """A report as a table."""

    title: str
    note: str
    head: Sequence[Heading]
    rows: Sequence[Sequence[str]]


def _text(value: object, form: str = "{:.4g}") -> str:
    """A cell; a dash where there is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–"
    return f"{value:d}" if isinstance(value, int) else form.format(value)


def _hands(figures: Figures) -> Told | None:
    """A row per hand that went the whole path."""
    names = [key.removesuffix("_aminn_f1") for key in figures if key.endswith("_aminn_f1")]
    shown: dict[Heading, tuple[str, str]] = {
        "joints": ("joints", "{:d}"),
        ("F1", "AMINN"): ("aminn_f1", "{:.3f}"),
        ("F1", "MLP"): ("mlp_f1", "{:.3f}"),
        ("relative error", "AMINN, median"): ("aminn_relative_error_median", "{:.3f}"),
        ("relative error", "MLP, median"): ("mlp_relative_error_median", "{:.3f}"),
        ("runtime to ONNX", "median"): ("cortex_m7_dx_relative_median", "{:.0e}"),
        ("Cortex-M7", "instructions"): ("cortex_m7_instructions_per_prediction", "{:.0f}"),
    }
    rows = [[name, *(_text(figures.get(f"{name}_{key}"), form) for key, form in shown.values())] for name in names]
    note = "Each hand from its description to a replayed C model (make hands)."
    return Told("Other hands", note, ["hand", *shown], rows) if rows else None


def _calibrate(figures: Figures) -> Told | None:
    """A row a number of pushes."""
    pattern = re.compile(r"pushes_(\d+)_after_relative_error_median")
    counts = sorted(int(found[1]) for key in figures if (found := pattern.fullmatch(key)))
    keys = ("before_relative_error_median", "after_relative_error_median", "after_relative_error_p90", "coverage_90")
    rows = [[str(n), *(_text(figures.get(f"pushes_{n}_{key}"), "{:.3f}") for key in keys)] for n in counts]
    head: list[Heading] = ["pushes", ("error before", "median"), ("error after", "median"), ("error after", "p90")]
    head.append(("within the interval", "of 90 %"))
    note = "Hands that no model was trained on, calibrated by measured pushes (make calibrate); errors are relative."
    return Told("Calibration of a hand", note, head, rows) if rows else None


def _cost(figures: Figures) -> Told | None:
    """A row a figure that several builds have."""
    builds = {"base": "earlier", "stuck": "contacts stick", "sliding": "contacts slide"}
    names = [key.removeprefix("stuck_") for key in figures if key.startswith("stuck_") and not key.endswith("_ratio")]
    rows = [[name.replace("_", " "), *(_text(figures.get(f"{b}_{name}")) for b in builds)] for name in names]
    beside = f"commit {figures.get('base_commit', '')} (make cost); times on {figures.get('cpu')}"
    return Told("Cost of a prediction", f"Beside {beside}.", ["", *builds.values()], rows) if rows else None


TELLERS: dict[str, Callable[[Figures], Told | None]] = {"hands": _hands, "calibrate": _calibrate, "cost": _cost}
"""By the report's name."""


def told_reports(reports: Mapping[str, Figures]) -> list[Told]:
    """Hands, calibration and cost, those that were run, each with what it says of missed aims."""
    found = []
    for name, teller in TELLERS.items():
        told = teller(reports[name]) if name in reports else None
        if told:
            missed = reports[name].get("aims_missed")
            note = told.note + (f" Aims missed: {missed}." if missed else "")
            found.append(Told(told.title, note, told.head, told.rows))
    return found
