"""`aminn hand check`: what a hand file and its model say, drawn, and compared with the engine."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_hand.drawing import BRANCH_COLOURS
from aminn_hand.hand import Hand

from .acceptance import Acceptance, accept
from .understand import Understood, table, understand

PRELOADED_LIMIT, FORMULA_LIMIT = 0.05, 0.12
"""Largest median relative error of a right description: with the contact forces, and of the formula alone."""
AXIS_M = 0.015
Figures = dict[str, float | int | str | bool]


@dataclass(frozen=True)
class Check:
    """Outcome of a check."""

    understood: Understood
    acceptance: Acceptance
    pinch_N: float

    @property
    def medians(self) -> tuple[float, float]:
        """Median relative error with the contact forces, and of the formula alone."""
        return tuple(float(np.median(self.acceptance.errors(w))) for w in ("preloaded", "formula"))  # type: ignore[return-value]

    @property
    def worst_branch(self) -> str:
        """The branch whose share of the loads errs most."""
        return self.understood.hand.branches[int(np.argmax(self.acceptance.by_branch()))].name

    @property
    def problem(self) -> str:
        """Why the description is not accepted, or ""."""
        preloaded, formula = self.medians
        if preloaded > PRELOADED_LIMIT:
            return (
                f"the description does not tell this hand: small loads move the tool {preloaded:.1%} otherwise than "
                f"it says (at most {PRELOADED_LIMIT:.0%}), most of all where {self.worst_branch} carries them; look "
                "at its springs, servos, couplings, friction and axes in the table"
            )
        if formula > FORMULA_LIMIT:
            return (
                f"the springs are too soft for {self.pinch_N:g} N a contact: without the contact forces the statics "
                f"are {formula:.1%} off (at most {FORMULA_LIMIT:.0%}); use a smaller --pinch, or stiffer servos; "
                "where that changes nothing, it is the contacts that give way, which the formula counts along the "
                "surface too"
            )
        return ""

    def figures(self) -> Figures:
        """Flat figures for a report."""
        a, (preloaded, formula) = self.acceptance, self.medians
        by_branch: Figures = {
            f"error_of_{b.name}": float(e) for b, e in zip(self.understood.hand.branches, a.by_branch(), strict=True)
        }
        dims = self.understood.hand.dims
        figures: Figures = {
            "hand": self.understood.hand.name,
            "branches": dims.branches,
            "joints": dims.joints,
            "tendons": dims.tendons,
            "pinch_N": self.pinch_N,
            "grasps": a.grasps,
            "loads": len(a.trials),
            "loads_lost": a.lost,
            "preloaded_median": preloaded,
            "preloaded_p90": float(np.quantile(a.errors("preloaded"), 0.9)),
            "formula_median": formula,
            "formula_p90": float(np.quantile(a.errors("formula"), 0.9)),
            "accepted": not self.problem,
        }
        return figures | by_branch


def check(
    path: Path | str,
    pinch_N: float = 0.5,
    grasps: int = 16,
    seed: int = 0,
    picture: Path | str | None = None,
    progress: Callable[[int], object] = lambda done: None,
    echo: Callable[[str], object] = print,
) -> Check:
    """Print what was understood of a hand file, draw it, and run the acceptance test.

    pinch_N: mean force of a contact, N, at which the hand will be used. Raises AminnError for what cannot be described
    or held; `Check.problem` says whether the description tells the hand.
    """
    if not 0 < pinch_N < float("inf"):
        raise AminnError(f"pinch is {pinch_N} N, expected a finite number above 0")
    understood = understand(path)
    echo(f"{understood.hand.name}: palm {understood.palm}, {_counts(understood.hand)}")
    for line in columns(table(understood)):
        echo(line)
    if understood.locked:
        echo(f"not moving: {', '.join(understood.locked)}")
    for note in understood.notes:
        echo(f"note: {note}")
    if picture is not None:
        draw(understood, Path(picture))
        echo(f"picture: {picture}")
    done = Check(understood, accept(understood, pinch_N, grasps, seed, progress=progress), pinch_N)
    a, (preloaded, formula) = done.acceptance, done.medians
    p90 = {which: float(np.quantile(a.errors(which), 0.9)) for which in ("preloaded", "formula")}
    echo(
        f"acceptance: {len(a.trials)} small loads of {a.grasps} grasps of a ball at {pinch_N:g} N a contact"
        + (f", {a.lost} more let it slip" if a.lost else "")
    )
    echo(f"  statics with the contact forces: {preloaded:.1%} off (median), p90 {p90['preloaded']:.1%}")
    echo(f"  the formula alone:               {formula:.1%} off (median), p90 {p90['formula']:.1%}")
    for branch, error in zip(a.hand.branches, a.by_branch(), strict=True):
        echo(f"  {branch.name}: {error:.1%}, contact compliance {1e6 * branch.eps_m:.3g} um/N")
    return done


def _counts(hand: Hand) -> str:
    dims = hand.dims
    shape = " + ".join(str(len(b.coordinates)) for b in hand.branches)
    return f"{dims.branches} branches of {shape} joints, {dims.tendons} tendons"


def columns(rows: list[list[str]]) -> list[str]:
    """Rows of cells as lines, flush left, under a rule."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    return [lines[0], "-" * len(lines[0]), *lines[1:]]


def draw(understood: Understood, out: Path) -> None:
    """A picture of the branches half way of closing: joints by name, axes as arrows (turns are right-handed)."""
    hand = understood.hand
    q = hand.coupled(0.5 * (understood.postures[0] + understood.postures[1]))
    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    for branch, at, colour in zip(hand.branches, hand.branch_joints, BRANCH_COLOURS, strict=False):
        angles = q[at]
        stations = []
        for c, coordinate in enumerate(branch.coordinates):
            turned = np.where(np.arange(len(angles)) < c, angles, 0.0)
            anchor, end = (
                branch.moved(turned, np.array(coordinate.anchor_m) + k * AXIS_M * np.array(coordinate.axis))
                for k in (0, 1)
            )
            stations.append(anchor)
            axes.quiver(*(1e3 * anchor), *(1e3 * (end - anchor)), color=colour, arrow_length_ratio=0.3, linewidth=1)
            axes.text(*(1e3 * end), f" {coordinate.joint}", fontsize=6, color=colour)
        stations.append(branch.moved(angles, np.array(branch.tip_point_m)))
        line = 1e3 * np.array(stations)
        axes.plot(*line.T, color=colour, marker="o", markersize=3, linewidth=2, label=f"{branch.name} ({branch.group})")
        axes.plot(*line[-1:].T, color=colour, marker="*", markersize=9)
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        axes.quiver(0, 0, 0, *(30 * axis), color="k", arrow_length_ratio=0.15, linewidth=1)
        axes.text(*(33 * axis), name, fontsize=8)
    normal = 45 * np.array(hand.palm_normal)
    axes.quiver(0, 0, 0, *normal, color="grey", arrow_length_ratio=0.1, linewidth=1, linestyle="--")
    axes.text(*(1.1 * normal), "palm normal", fontsize=7, color="grey")
    axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm", title=f"{hand.name}, half closed, in the palm's frame H")
    axes.set_aspect("equal")
    axes.legend(fontsize=7, loc="upper left")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=out.suffix.removeprefix(".") or "png", dpi=150)
    write_atomically(out, buffer.getvalue())
