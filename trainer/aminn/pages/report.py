"""The report page: one self-contained HTML file with the table, the figures and the checks of a run.

`write_report` takes plain arrays and dictionaries (`ReportInputs`), so that anything that has figures can make a page.
Colours belong to a name ("aminn", "mlp", ...) and stay the same from figure to figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from aminn_base.page import PANEL_IN, Picture, picture, write_page
from aminn_base.read import AnyPath, read_json
from aminn_hand.drawing import branch_key

from ..evaluation.evaluate import BASELINES, KIND_NAMES
from ..evaluation.metrics import COLUMNS, SURE_COLUMNS, Column
from .grasp_picture import GraspPicture, draw_grasp
from .other_reports import told_reports

Array = NDArray[np.float64]
Value = float | int | str | bool | None

NAMES = KIND_NAMES | BASELINES
COLOURS = {
    "aminn": "#1f5fa8",
    "mlp": "#d9772b",
    "analytical": "#7a7a7a",
    "analytical_nominal": "#b5b5b5",
    "label": "#111111",
}
OTHER_COLOURS = ("#3a8f5c", "#8a5aa6", "#b03a48", "#5b8aa6")
GRID = "#dddddd"

# Rows of the table of differences: key after the target's name, text, format.
DIFFERENCES = (
    ("dx_relative_max", "displacement, relative, largest", "{:.1e}"),
    ("dx_relative_median", "displacement, relative, median", "{:.1e}"),
    ("dx_share_of_limit_max", "displacement, share of the limit, largest", "{:.2f}"),
    ("p_stable_abs_max", "p_stable, largest", "{:.1e}"),
    ("decisions_different", "stable decisions that differ", "{:d}"),
    ("k_x_relative_max", "K_x, relative, largest", "{:.1e}"),
    ("gate_abs_max", "gate, largest", "{:.1e}"),
    ("float64_dx_relative_median", "displacement against float64, relative, median", "{:.1e}"),
    ("float64_dx_relative_max", "displacement against float64, relative, largest", "{:.1e}"),
    ("refused", "samples refused", "{:d}"),
    ("instructions_worst", "instructions a prediction, worst", "{:d}"),
    ("stack_predict_bytes", "stack of a prediction, bytes", "{:d}"),
)
TARGETS = {
    "host_bin": "host, aminn_model.bin",
    "host_c": "host, aminn_model.c",
    "cortex_m7": "Cortex-M7 (qemu)",
    "onnx": "ONNX Runtime",
}


@dataclass(frozen=True)
class ReportInputs:
    """Everything that the page shows. What is left empty is left out of the page."""

    title: str = "AMINN"
    """Heading of the page."""
    rows: Sequence[Mapping[str, Value]] = ()
    """Table: one mapping per row, "model" and the keys of `metrics.COLUMNS`; a missing key or NaN shows as a dash."""
    signed_work: Mapping[str, Array] = field(default_factory=dict)
    """Name -> w.dx (n), J, of samples predicted stable; "label" is the ground truth."""
    signed_work_translational: Mapping[str, Array] = field(default_factory=dict)
    """The same with f.dp alone."""
    true_dx: Array | None = None
    """Simulated displacements (n, 6) of stable samples, m and rad."""
    predicted_dx: Mapping[str, Array] = field(default_factory=dict)
    """Name -> predicted displacements (n, 6) of the same samples."""
    histories: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]] = field(default_factory=dict)
    """Name -> stage -> {"train": [...], "validation": [...]}, one number per epoch."""
    operating: Mapping[str, tuple[Mapping[str, Sequence[float]], float]] = field(default_factory=dict)
    """Name -> (curve of `metrics.operating_curve` on validation data, the tau that was chosen)."""
    reliability: Mapping[str, Sequence[Mapping[str, float]]] = field(default_factory=dict)
    """Name -> curve of `metrics.reliability`, of p_stable."""
    slide_reliability: Mapping[str, Sequence[Mapping[str, float]]] = field(default_factory=dict)
    """The same of p_slide over stable load cases."""
    refusal: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    """Name -> curve of `metrics.refusal_curve` over stable load cases."""
    grasp: GraspPicture | None = None
    """A grasp before and under load."""
    verification: Mapping[str, Value] = field(default_factory=dict)
    """Flat report of `aminn verify`."""
    dataset: Mapping[str, Value] = field(default_factory=dict)
    """Name -> value: what the data set holds."""
    reports: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    """Name -> flat figures of other reports, which the page lists as they are."""
    notes: Sequence[str] = ()
    """Sentences under the table."""
    provenance: Mapping[str, Value] = field(default_factory=dict)
    """Name -> value: runs, data, version, settings."""


def colour_of(name: str, names: Sequence[str]) -> str:
    """The colour of a name; names that are not known get one by their order."""
    others = [n for n in names if n not in COLOURS]
    return COLOURS[name] if name in COLOURS else OTHER_COLOURS[others.index(name) % len(OTHER_COLOURS)]


def label_of(name: str) -> str:
    """The name as the page writes it."""
    return NAMES.get(name, name)


def new_panel(width: float = PANEL_IN[0], height: float = PANEL_IN[1]) -> tuple[Figure, Axes]:
    """A figure of one panel, inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def tidy(ax: Axes, x: str, y: str, title: str = "") -> None:
    ax.set_xlabel(x, fontsize=9)
    ax.set_ylabel(y, fontsize=9)
    ax.set_title(title, fontsize=10, loc="left")
    ax.tick_params(labelsize=8)
    ax.grid(color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _edges(values: Sequence[Array]) -> tuple[Array, float]:
    """Bin edges that are logarithmic on both sides of zero, and where they begin to be: (edges, linear limit)."""
    sizes = np.abs(np.concatenate(values))
    sizes = sizes[sizes > 0]
    top = float(sizes.max()) if len(sizes) else 1.0
    low = max(float(np.quantile(sizes, 0.02)) if len(sizes) else 0.1, 1e-5 * top)
    low = 10.0 ** math.floor(math.log10(low))
    decades = max(1, math.ceil(math.log10(top / low)))
    positive = low * 10.0 ** np.linspace(0, decades, 5 * decades + 1)
    return np.concatenate([-positive[::-1], [0.0], positive]), low


def _draw_work(ax: Axes, work: Mapping[str, Array], title: str) -> None:
    """Shares of samples by signed work, as outlines, on a scale that is logarithmic on both sides of zero."""
    edges, low = _edges(list(work.values()))
    peak = 0.0
    for name, values in work.items():
        counts, _ = np.histogram(np.clip(values[values != 0], edges[0], edges[-1]), edges)
        share = counts / max(len(values), 1)
        peak = max(peak, float(share.max(initial=0)))
        negative = float((values < 0).mean()) if len(values) else 0.0
        text = f"{label_of(name)}: {negative:.2%} below zero"
        ax.stairs(share, edges, color=colour_of(name, list(work)), linewidth=1.6, label=text)
    ax.set_xscale("symlog", linthresh=low, linscale=0.4)
    ax.axvspan(edges[0], 0, color="#b03a48", alpha=0.07, linewidth=0)
    ax.axvline(0, color="#b03a48", linewidth=0.8)
    tidy(ax, "signed work, J", "share of samples", title)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(0, 1.45 * peak if peak else 1)
    exponents = range(math.ceil(math.log10(low)) + 1, math.floor(math.log10(edges[-1]) + 1e-9) + 1, 2)
    ticks = [10.0**e for e in exponents]
    ax.set_xticks([-t for t in reversed(ticks)] + [0.0] + ticks)
    ax.minorticks_off()
    ax.legend(fontsize=8, frameon=False, loc="upper left")


def work_figures(full: Mapping[str, Array], translational: Mapping[str, Array]) -> list[Figure]:
    """Histograms of the signed work, full and translational."""
    figures = []
    for work, title in ((full, "w·dx (force and moment)"), (translational, "f·dp (force alone)")):
        if work:
            figure, ax = new_panel()
            _draw_work(ax, work, title)
            figures.append(figure)
    return figures


def _draw_scatter(ax: Axes, true: Array, pred: Array, colour: str, low: float, high: float) -> None:
    size = float(np.clip(4000 / max(len(true), 1), 2, 12))
    ax.scatter(np.clip(true, low, high), np.clip(pred, low, high), s=size, color=colour, alpha=0.35, linewidths=0)
    ax.plot([low, high], [low, high], color="#111111", linewidth=0.9)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(low, high)
    ax.set_ylim(low, high)
    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):  # as many labels as have room
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 100 * low else (1,)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())


def _range(values: Array) -> tuple[float, float]:
    """Limits of a logarithmic axis that leave out the smallest half per cent."""
    values = values[values > 0]
    if not len(values):
        return 0.1, 1.0
    low, high = float(np.quantile(values, 0.005)), 1.3 * float(values.max())
    return 0.8 * max(low, 1e-4 * high), high


def displacement_figures(true: Array, predicted: Mapping[str, Array]) -> list[Figure]:
    """Size of the predicted motion against the simulated one, a panel for each model's translation and rotation."""
    names, figures = list(predicted), []
    for part, unit, text in ((slice(0, 3), 1e3, "translation, mm"), (slice(3, 6), 180 / math.pi, "rotation, deg")):
        size = unit * np.linalg.norm(true[:, part], axis=1)
        low, high = _range(size)
        for name in names:
            figure, ax = new_panel(3.4, 3.6)
            guess = unit * np.linalg.norm(predicted[name][:, part], axis=1)
            _draw_scatter(ax, size, guess, colour_of(name, names), low, high)
            tidy(ax, f"simulated {text}", f"predicted {text}", label_of(name))
            figures.append(figure)
    return figures


STAGES = {"stage1": "stage 1: cross-entropy", "stage2": "stage 2: displacement loss"}
"""What each stage's loss is."""


def tidy_losses(ax: Axes) -> None:
    """A logarithmic axis of losses, with labels that do not touch."""
    ax.set_yscale("log")
    ax.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("{x:g}")
    ax.tick_params(which="minor", labelsize=7)


def training_figures(histories: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]]) -> list[Figure]:
    """Loss by epoch; one panel per stage."""
    figures = []
    for stage in sorted({stage for history in histories.values() for stage in history}):
        figure, ax = new_panel()
        for name, history in histories.items():
            curves, colour = history.get(stage, {}), colour_of(name, list(histories))
            for part, style, width in (("train", (0, (3, 2)), 1.0), ("validation", "-", 1.7)):
                values = np.asarray(curves.get(part, []), float)
                label = f"{label_of(name)}, {part}"
                ax.plot(
                    np.arange(1, len(values) + 1), values, color=colour, linestyle=style, linewidth=width, label=label
                )
        tidy_losses(ax)
        tidy(ax, "epoch", "loss", STAGES.get(stage, stage))
        ax.legend(fontsize=8, frameon=False)
        figures.append(figure)
    return figures


def operating_figures(curves: Mapping[str, tuple[Mapping[str, Sequence[float]], float]]) -> list[Figure]:
    """F1 against displacement error and against the share passed on, along the threshold; a ring at the chosen one."""
    figures = []
    sides = (("rmse_pose", "RMSE_pose of what is stable and passed on"), ("passed", "share of load cases passed on"))
    for key, text in sides:
        figure, ax = new_panel()
        for name, (curve, tau) in curves.items():
            chosen = int(np.argmin(np.abs(np.asarray(curve["tau"]) - tau)))
            colour = colour_of(name, list(curves))
            ax.plot(curve[key], curve["f1"], color=colour, linewidth=1.6, label=f"{label_of(name)}, tau {tau:.2f}")
            ax.plot(curve[key][chosen], curve["f1"][chosen], "o", color=colour, markersize=8, fillstyle="none")
        tidy(ax, text, "F1")
        ax.legend(fontsize=8, frameon=False, loc="lower right" if key == "rmse_pose" else "lower center")
        figures.append(figure)
    return figures


def reliability_figure(curves: Mapping[str, Sequence[Mapping[str, float]]], x: str, y: str) -> Figure:
    """How often something is so against its predicted probability; the size of a point is the number of cases."""
    figure, ax = new_panel()
    _draw_reliability(ax, curves, x, y)
    return figure


def _draw_reliability(ax: Axes, curves: Mapping[str, Sequence[Mapping[str, float]]], x_text: str, y_text: str) -> None:
    ax.plot([0, 1], [0, 1], color="#111111", linewidth=0.9)
    for name, bins in curves.items():
        total, colour = sum(b["n"] for b in bins), colour_of(name, list(curves))
        sizes = [20 + 400 * b["n"] / total for b in bins]
        x, y = [b["p"] for b in bins], [b["share"] for b in bins]
        ax.plot(x, y, color=colour, linewidth=1.2, label=label_of(name))
        ax.scatter(x, y, s=sizes, color=colour, alpha=0.4, linewidths=0)
    tidy(ax, x_text, y_text)
    ax.legend(fontsize=8, frameon=False)


def refusal_figure(curves: Mapping[str, Mapping[str, Sequence[float]]]) -> Figure:
    """The error that is left against the share of cases refused."""
    figure, ax = new_panel()
    for name, curve in curves.items():
        shares = [100 * share for share in curve["refused"]]
        ax.plot(shares, curve["rmse_pose"], color=colour_of(name, list(curves)), label=label_of(name))
    tidy(ax, "refused, % of the stable cases", "RMSE_pose of the others")
    ax.set_ylim(bottom=0)
    ax.legend(fontsize=8, frameon=False)
    return figure


def pictures(inputs: ReportInputs) -> list[Picture]:
    """All figures that the inputs have data for."""
    made = []
    if inputs.grasp is not None:
        figures, caption = draw_grasp(inputs.grasp)
        made.append(picture("A grasp under load", caption, figures, branch_key(inputs.grasp.hand)))
    if inputs.true_dx is not None and inputs.predicted_dx:
        caption = "Stable load cases. A point on the line is a motion of the right size."
        made.append(
            picture(
                "Predicted against simulated displacement",
                caption,
                displacement_figures(inputs.true_dx, inputs.predicted_dx),
            )
        )
    if inputs.signed_work:
        caption = (
            "Load cases predicted stable. A passive grasp yields with the load: w·dx is above zero. For the force "
            "alone that is not so for every true motion when a moment acts as well. Loads without a force are left out "
            "of its own drawing."
        )
        figures = work_figures(inputs.signed_work, inputs.signed_work_translational)
        made.append(picture("Signed work", caption, figures))
    if inputs.operating:
        caption = "Validation data, along the threshold on p_stable. Rings: the thresholds stored with the models."
        made.append(picture("Operating point", caption, operating_figures(inputs.operating)))
    if inputs.reliability:
        caption = "On the line, a share p of the cases with probability p holds. Large points: many cases."
        figure = reliability_figure(inputs.reliability, "predicted p_stable", "share that holds")
        made.append(picture("Calibration of p_stable", caption, [figure]))
    if inputs.slide_reliability or inputs.refusal:
        caption = (
            "Stable load cases. On the line, a contact slid in a share p of the cases with p_slide p. Refused are the "
            "cases of which a model is least sure: few cases, most of which slid, make most of the error."
        )
        slides, refusal = inputs.slide_reliability, inputs.refusal
        figures = [reliability_figure(slides, "predicted p_slide", "share that slid")] if slides else []
        figures += [refusal_figure(refusal)] if refusal else []
        made.append(picture("How sure the models are of a motion", caption, figures))
    if inputs.histories:
        made.append(
            picture("Training", "Dashed: training data; solid: validation data.", training_figures(inputs.histories))
        )
    return made


def format_value(value: Value, form: str | None = None) -> str:
    """A cell of a table; a dash where there is no number."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, int | float):
        return str(value)
    if form is None:
        form = "{:d}" if isinstance(value, int) else "{:.4g}"
    return form.format(int(value) if form == "{:d}" else value)


def _cells(figures: Mapping[str, Value]) -> list[tuple[str, str]]:
    return [(key, format_value(value)) for key, value in figures.items()]


def read_reports(folder: AnyPath, page: AnyPath) -> dict[str, dict[str, Value]]:
    """The reports in `folder` by name, but the one that `page` shows anyway. Raises AminnError for a damaged one."""
    found = {}
    for file in sorted(Path(folder).glob("*.json")):
        if file.stem == Path(page).stem:
            continue
        found[file.stem] = read_json(file, "a report (remove it, or run again what wrote it)")
    return found


def result_table(rows: Sequence[Mapping[str, Value]], columns: Mapping[str, Column] = COLUMNS) -> list[list[str]]:
    """Cells of a table of models, row by row."""
    return [
        [label_of(str(row["model"]))] + [format_value(row.get(key), column.form) for key, column in columns.items()]
        for row in rows
    ]


def difference_table(verification: Mapping[str, Value]) -> tuple[list[str], list[list[str]]]:
    """(headings, cells) of the runtime-to-ONNX differences, one column per target that was replayed."""
    targets = [t for t in TARGETS if any(k.startswith(f"{t}_") for k in verification)]
    cells = []
    for key, text, form in DIFFERENCES:
        values = [format_value(verification.get(f"{t}_{key}"), form) for t in targets]
        if any(v != "–" for v in values):
            cells.append([text, *values])
    return [TARGETS[t] for t in targets], cells


def headings_of(columns: Mapping[str, Column]) -> list[str | tuple[str, str]]:
    """The headings of a table of models."""
    return ["model", *((column.title, column.unit) for column in columns.values())]


def conclusion(rows: Sequence[Mapping[str, Value]]) -> str:
    """What the table says, in a sentence; nothing where no trained model is in it."""
    error = "relative_error_median_all"
    known = {str(row["model"]): row for row in rows if _number(row, error)}
    learned = sorted((name for name in known if name not in BASELINES), key=lambda name: _number(known[name], error))
    if not learned:
        return ""
    best, *others = [*learned, *(name for name in ("analytical",) if name in known)]
    beside = ", ".join(f"{label_of(name)} {_number(known[name], error):.1%}" for name in others)
    return (
        f"{label_of(best)} tells whether a grasp holds with an F1 of {_number(known[best], 'f1'):.3f}, and how far the "
        f"tool moves with a median relative error of {_number(known[best], error):.1%}"
        + (f"; {beside}." if beside else ".")
    )


def _number(row: Mapping[str, Value], key: str) -> float:
    """A figure; 0 where there is none."""
    value = row.get(key)
    return value if isinstance(value, float) and math.isfinite(value) else 0.0


def write_report(inputs: ReportInputs, out_html: AnyPath) -> None:
    """Write the page, atomically."""
    targets, differences = difference_table(inputs.verification)
    write_page(
        Path(__file__).with_name("report.html.j2"),
        out_html,
        inputs=inputs,
        conclusion=conclusion(inputs.rows),
        ours=label_of("aminn"),
        headings=headings_of(COLUMNS),
        rows=result_table(inputs.rows),
        sure_headings=headings_of(SURE_COLUMNS),
        sure_rows=result_table([row for row in inputs.rows if "bound_coverage" in row], SURE_COLUMNS),
        targets=targets,
        differences=differences,
        told=told_reports(inputs.reports),
        provenance=_cells(inputs.provenance),
        dataset=_cells(inputs.dataset),
        reports=[(name, _cells(figures)) for name, figures in inputs.reports.items()],
        pictures=pictures(inputs),
        verification=inputs.verification,
    )
