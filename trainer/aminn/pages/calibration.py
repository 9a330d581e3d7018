"""The page of a calibration: theta with its uncertainty, and the errors of pushes before and after."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from aminn_base.page import picture, write_page
from aminn_base.read import AnyPath

from ..calibration.calibrate import Calibration
from ..calibration.fit import Z90
from ..calibration.store import KEPT
from .report import new_panel, tidy

BLUE, GREY = "#1f5fa8", "#9a9a9a"
LEGEND_GRASPS = 10


def theta_figures(found: Calibration) -> list[Figure]:
    """Every parameter with its interval, over that of the prior; one panel per unit."""
    kinds = {"1": "factor on nominal", "rad": "joint zero, deg", "m": "tip radius, mm"}
    scale = {"1": 1.0, "rad": 180 / math.pi, "m": 1e3}
    parameters, prior, sd = found.space.parameters, found.prior.sd(found.space), found.fit.sd
    units = list(dict.fromkeys(p.unit for p in parameters))
    figures = []
    for unit in units:
        own = [i for i, p in enumerate(parameters) if p.unit == unit]
        figure, ax = new_panel(4.4, 1.1 + 0.2 * len(own))
        figures.append(figure)
        for row, i in enumerate(own):
            colour = GREY if parameters[i].name in found.undetermined else BLUE
            _interval(ax, row, 0.0, scale[unit] * Z90 * prior[i], "#e3e3e3", 7)
            _interval(ax, row, scale[unit] * found.fit.mean[i], scale[unit] * Z90 * sd[i], colour, 2)
            ax.plot(scale[unit] * found.theta[i], row, "o", color=colour, markersize=5)
        ax.set_yticks(range(len(own)), [parameters[i].name for i in own])
        ax.set_ylim(len(own) - 0.5, -0.5)
        tidy(ax, kinds[unit], "")
        if unit == "1":
            factors = np.array([0.4, 0.5, 0.7, 1.0, 1.4, 2.0, 2.5])
            ax.set_xticks(np.log(factors), [f"{f:g}" for f in factors])
    return figures


def _interval(ax: Axes, row: int, middle: float, half: float, colour: str, width: float) -> None:
    ax.plot([middle - half, middle + half], [row, row], color=colour, linewidth=width, solid_capstyle="butt")


def error_figures(found: Calibration) -> list[Figure]:
    """Errors of the held-out pushes before and after, one point per push; and how much each push counted."""
    (errors, left), (weights, right) = new_panel(), new_panel()
    before, after = (100 * e for e in (found.held_out.before, found.held_out.after))
    low, high = 0.8 * min(before.min(), after.min()), 1.25 * max(before.max(), after.max())
    left.plot([low, high], [low, high], color="#111111", linewidth=0.9)
    numbers, grasps = np.unique(found.pushes.grasp_id, return_inverse=True)
    for g, number in enumerate(numbers):
        own, colour = np.flatnonzero(grasps == g), f"C{g % 10}"
        left.plot(before[own], after[own], "o", color=colour, markersize=5, alpha=0.8, label=f"grasp {number}")
        right.bar(own + 1, found.fit.weights[own], color=colour)
    left.set_xscale("log")
    left.set_yscale("log")
    for axis in (left.xaxis, left.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    if len(numbers) <= LEGEND_GRASPS:
        left.legend(fontsize=8, frameon=False)
    tidy(left, "error before, % of the motion", "error after, % of the motion", "held-out pushes, one colour per grasp")
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(right, "push that held, in the order of the data", "weight", "how much each push counted: a slip about 0")
    return [errors, weights]


def write_calibration_page(found: Calibration, out: AnyPath, provenance: Mapping[str, str]) -> None:
    """Write the page, one file of its own. provenance: run and data, name and value."""
    sd, prior, out_of = found.fit.sd, found.prior.sd(found.space), found.undetermined
    rows: list[list[str]] = []
    for i, p in enumerate(found.space.parameters):
        value = f"x {math.exp(found.theta[i]):.3f}" if p.unit == "1" else f"{found.theta[i]:+.5f} {p.unit}"
        rows.append(
            [
                p.name,
                value,
                f"{found.theta[i]:+.4f}",
                f"{found.fit.mean[i]:+.4f}",
                f"{sd[i]:.4f}",
                f"{prior[i]:.4f}",
                ", ".join(p.parts),
            ]
        )
    held_out = found.held_out

    def text(errors: np.ndarray) -> str:
        return f"{np.median(errors):.1%} median, {np.quantile(errors, 0.9):.1%} p90"

    summary = [
        ("pushes that held, grasps", f"{len(found.pushes)}, {found.pushes.grasps.max() + 1}"),
        ("of these slipped, or fit no hand", str(found.slipped.sum())),
        (f"error of the displacement before, each {held_out.by} left out in turn", text(held_out.before)),
        ("after", text(held_out.after)),
        ("parameters that the pushes do not determine", f"{len(out_of)} of {len(found.space)}"),
        ("mistakes in the data", "; ".join(m.mistake.detail for m in found.mistakes) or "none seen"),
    ]
    caption = (
        "Points: what is used, the theta that predicts best. Lines: 90 % intervals of the hand's own. Wide grey bars: "
        "what was assumed before any push (the prior). Grey points and lines: the pushes say little of these."
    )
    if not found.free.all():
        caption += f" {KEPT.capitalize()}."
    pictures = [
        picture("Parameters (theta)", caption, theta_figures(found)),
        picture("Errors", "Below the line a push is predicted better than before.", error_figures(found)),
    ]
    headings = ("parameter", "value", "theta", "mean", "sd", "sd of the prior", "parts")
    write_page(
        Path(__file__).with_name("calibration.html.j2"),
        out,
        hand=found.pushes.hand.name,
        conclusion=(
            f"Pushes that theta was not fitted to are predicted with a relative error of "
            f"{np.median(held_out.after):.1%} instead of {np.median(held_out.before):.1%} (median)."
        ),
        summary=summary,
        pictures=pictures,
        rows=rows,
        open=list(out_of),
        headings=headings,
        provenance=provenance.items(),
    )
