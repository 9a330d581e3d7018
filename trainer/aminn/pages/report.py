"""The report page: one self-contained HTML file with the table, the figures and the checks of a run.

`write_report` takes plain arrays and dictionaries (`ReportInputs`), so that anything that has figures can make a page.
Colours belong to a name ("aminn", "mlp", ...) and stay the same from figure to figure.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from aminn_base.files import write_atomically
from aminn_base.read import AnyPath, read_json

from ..evaluation.evaluate import BASELINES, KIND_NAMES
from ..evaluation.metrics import COLUMNS, SURE_COLUMNS, Column
from .grasp_picture import GraspPicture, draw_grasp

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
    """Table: one mapping a row with "model" and the keys of `metrics.COLUMNS`; a missing key or NaN shows as a dash."""
    signed_work: Mapping[str, Array] = field(default_factory=dict)
    """Name -> w.dx (n), J, of samples predicted stable; "label" is the ground truth."""
    signed_work_translational: Mapping[str, Array] = field(default_factory=dict)
    """The same with f.dp alone."""
    true_dx: Array | None = None
    """Simulated displacements (n, 6) of stable samples, m and rad."""
    predicted_dx: Mapping[str, Array] = field(default_factory=dict)
    """Name -> predicted displacements (n, 6) of the same samples."""
    histories: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]] = field(default_factory=dict)
    """Name -> stage -> {"train": [...], "validation": [...]}, one number an epoch."""
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


@dataclass(frozen=True)
class Picture:
    """A figure in the page."""

    title: str
    caption: str
    png: str
    """Base64."""


def colour_of(name: str, names: Sequence[str]) -> str:
    """The colour of a name; names that are not known get one by their order."""
    others = [n for n in names if n not in COLOURS]
    return COLOURS[name] if name in COLOURS else OTHER_COLOURS[others.index(name) % len(OTHER_COLOURS)]


def label_of(name: str) -> str:
    """The name as the page writes it."""
    return NAMES.get(name, name)


def new_figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=130, layout="constrained")


def tidy(ax: Axes, x: str, y: str, title: str = "") -> None:
    ax.set_xlabel(x, fontsize=9)
    ax.set_ylabel(y, fontsize=9)
    ax.set_title(title, fontsize=10, loc="left")
    ax.tick_params(labelsize=8)
    ax.grid(color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def to_png(figure: Figure) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", facecolor="white")
    return buffer.getvalue()


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


def work_figure(full: Mapping[str, Array], translational: Mapping[str, Array]) -> Figure:
    """Histogram of the signed work, full and translational."""
    panels = [(w, t) for w, t in ((full, "w·dx (force and moment)"), (translational, "f·dp (force alone)")) if w]
    figure = new_figure(5.2 * len(panels), 3.6)
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, (work, title) in zip(axes, panels, strict=True):
        _draw_work(ax, work, title)
    return figure


def _draw_scatter(ax: Axes, true: Array, pred: Array, colour: str, low: float, high: float) -> None:
    size = float(np.clip(4000 / max(len(true), 1), 2, 12))
    ax.scatter(np.clip(true, low, high), np.clip(pred, low, high), s=size, color=colour, alpha=0.35, linewidths=0)
    ax.plot([low, high], [low, high], color="#111111", linewidth=0.9)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(low, high)
    ax.set_ylim(low, high)
    ax.set_aspect("equal")


def _range(values: Array) -> tuple[float, float]:
    """Limits of a logarithmic axis that leave out the smallest half per cent."""
    values = values[values > 0]
    if not len(values):
        return 0.1, 1.0
    low, high = float(np.quantile(values, 0.005)), 1.3 * float(values.max())
    return 0.8 * max(low, 1e-4 * high), high


def displacement_figure(true: Array, predicted: Mapping[str, Array]) -> Figure:
    """Size of the predicted motion against the simulated one: a column a model, translation above rotation."""
    names = list(predicted)
    figure = new_figure(3.3 * len(names) + 0.4, 6.6)
    axes = figure.subplots(2, len(names), squeeze=False)
    kinds = ((slice(0, 3), 1e3, "translation, mm"), (slice(3, 6), 180 / math.pi, "rotation, deg"))
    for row, (part, unit, text) in enumerate(kinds):
        size = unit * np.linalg.norm(true[:, part], axis=1)
        low, high = _range(size)
        for column, name in enumerate(names):
            guess = unit * np.linalg.norm(predicted[name][:, part], axis=1)
            ax = axes[row, column]
            _draw_scatter(ax, size, guess, colour_of(name, names), low, high)
            title = label_of(name) if row == 0 else ""
            tidy(ax, f"simulated {text}", f"predicted {text}" if column == 0 else "", title)
    return figure


def training_figure(histories: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]]) -> Figure:
    """Loss by epoch; a panel a stage."""
    stages = sorted({stage for history in histories.values() for stage in history})
    texts = {"stage1": "stage 1: cross-entropy", "stage2": "stage 2: displacement loss"}
    figure = new_figure(5.2 * len(stages), 3.4)
    axes = figure.subplots(1, len(stages), squeeze=False)[0]
    for ax, stage in zip(axes, stages, strict=True):
        for name, history in histories.items():
            curves, colour = history.get(stage, {}), colour_of(name, list(histories))
            for part, style, width in (("train", (0, (3, 2)), 1.0), ("validation", "-", 1.7)):
                values = np.asarray(curves.get(part, []), float)
                label = f"{label_of(name)}, {part}"
                ax.plot(
                    np.arange(1, len(values) + 1), values, color=colour, linestyle=style, linewidth=width, label=label
                )
        ax.set_yscale("log")
        ax.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))  # more labels would touch
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("{x:g}")
        tidy(ax, "epoch", "loss", texts.get(stage, stage))
        ax.tick_params(which="minor", labelsize=7)
        ax.legend(fontsize=8, frameon=False)
    return figure


def operating_figure(curves: Mapping[str, tuple[Mapping[str, Sequence[float]], float]]) -> Figure:
    """F1 against displacement error and against the share passed on, along the threshold; a ring at the chosen one."""
    figure = new_figure(10.4, 3.6)
    axes = figure.subplots(1, 2)
    sides = (("rmse_pose", "RMSE_pose of what is stable and passed on"), ("passed", "share of load cases passed on"))
    for name, (curve, tau) in curves.items():
        chosen = int(np.argmin(np.abs(np.asarray(curve["tau"]) - tau)))
        for ax, (key, _) in zip(axes, sides, strict=True):
            colour = colour_of(name, list(curves))
            ax.plot(curve[key], curve["f1"], color=colour, linewidth=1.6, label=f"{label_of(name)}, tau {tau:.2f}")
            ax.plot(curve[key][chosen], curve["f1"][chosen], "o", color=colour, markersize=8, fillstyle="none")
    for ax, (_, text) in zip(axes, sides, strict=True):
        tidy(ax, text, "F1", "")
        ax.legend(fontsize=8, frameon=False, loc="lower right" if ax is axes[0] else "lower center")
    return figure


def reliability_figure(curves: Mapping[str, Sequence[Mapping[str, float]]]) -> Figure:
    """Share of cases that hold against the predicted probability; the size of a point is the number of cases."""
    figure = new_figure(4.6, 4.2)
    _draw_reliability(figure.subplots(), curves, "predicted p_stable", "share that holds")
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


def sure_figure(
    slides: Mapping[str, Sequence[Mapping[str, float]]], refusal: Mapping[str, Mapping[str, Sequence[float]]]
) -> Figure:
    """Share of cases that slid against p_slide, and the error that is left against the share of cases refused."""
    figure = new_figure(5.2 * (bool(slides) + bool(refusal)), 3.9)
    axes = list(figure.subplots(1, bool(slides) + bool(refusal), squeeze=False)[0])
    if slides:
        _draw_reliability(axes.pop(0), slides, "predicted p_slide", "share that slid")
    if refusal:
        for name, curve in refusal.items():
            shares = [100 * share for share in curve["refused"]]
            axes[0].plot(shares, curve["rmse_pose"], color=colour_of(name, list(refusal)), label=label_of(name))
        tidy(axes[0], "refused, % of the stable cases", "RMSE_pose of the others")
        axes[0].set_ylim(bottom=0)
        axes[0].legend(fontsize=8, frameon=False)
    return figure


def picture(title: str, caption: str, figure: Figure) -> Picture:
    return Picture(title, caption, base64.b64encode(to_png(figure)).decode())


def pictures(inputs: ReportInputs) -> list[Picture]:
    """All figures that the inputs have data for."""
    made = []
    if inputs.grasp is not None:
        figure, caption = draw_grasp(inputs.grasp)
        made.append(picture("A grasp under load", caption, figure))
    if inputs.true_dx is not None and inputs.predicted_dx:
        caption = "Stable load cases. A point on the line is a motion of the right size."
        made.append(
            picture(
                "Predicted against simulated displacement",
                caption,
                displacement_figure(inputs.true_dx, inputs.predicted_dx),
            )
        )
    if inputs.signed_work:
        caption = (
            "Load cases predicted stable. A passive grasp yields with the load: w·dx is above zero. For the force "
            "alone that is not so for every true motion when a moment acts as well. Loads without a force are left out "
            "of the drawing on the right."
        )
        figure = work_figure(inputs.signed_work, inputs.signed_work_translational)
        made.append(picture("Signed work", caption, figure))
    if inputs.operating:
        caption = "Validation data, along the threshold on p_stable. Rings: the thresholds stored with the models."
        made.append(picture("Operating point", caption, operating_figure(inputs.operating)))
    if inputs.reliability:
        caption = "On the line, a share p of the cases with probability p holds. Large points: many cases."
        made.append(picture("Calibration of p_stable", caption, reliability_figure(inputs.reliability)))
    if inputs.slide_reliability or inputs.refusal:
        caption = (
            "Stable load cases. On the line, a contact slid in a share p of the cases with p_slide p. Refused are the "
            "cases of which a model is least sure: few cases, most of which slid, make most of the error."
        )
        figure = sure_figure(inputs.slide_reliability, inputs.refusal)
        made.append(picture("How sure the models are of a motion", caption, figure))
    if inputs.histories:
        made.append(
            picture("Training", "Dashed: training data; solid: validation data.", training_figure(inputs.histories))
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
    """(headings, cells) of the runtime-to-ONNX differences, a column a target that was replayed."""
    targets = [t for t in TARGETS if any(k.startswith(f"{t}_") for k in verification)]
    cells = []
    for key, text, form in DIFFERENCES:
        values = [format_value(verification.get(f"{t}_{key}"), form) for t in targets]
        if any(v != "–" for v in values):
            cells.append([text, *values])
    return [TARGETS[t] for t in targets], cells


def write_page(template: str, out_html: AnyPath, **values: object) -> None:
    """Fill in a template of this folder and write the page, atomically."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    write_atomically(Path(out_html), environment.get_template(template).render(**values).encode())


def write_report(inputs: ReportInputs, out_html: AnyPath) -> None:
    """Write the page, atomically."""
    headings, differences = difference_table(inputs.verification)
    write_page(
        "report.html.j2",
        out_html,
        inputs=inputs,
        columns=COLUMNS.values(),
        rows=result_table(inputs.rows),
        sure_columns=SURE_COLUMNS.values(),
        sure_rows=result_table([row for row in inputs.rows if "bound_coverage" in row], SURE_COLUMNS),
        headings=headings,
        differences=differences,
        dataset=_cells(inputs.dataset),
        reports=[(name, _cells(figures)) for name, figures in inputs.reports.items()],
        pictures=pictures(inputs),
        verification=inputs.verification,
    )
