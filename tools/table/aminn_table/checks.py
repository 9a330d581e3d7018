"""What cannot be right in a table of pushes: every row is looked at, and each fault names its column and row."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.sensors import FRICTION, TENDON_TENSION, TOOL_WEIGHT

from .columns import (
    DTYPES,
    FORCE,
    KNOWN,
    MEASURED,
    NORMAL,
    ON,
    POINT,
    SENSORS,
    Arrays,
    column_of,
    numbers,
    shapes_of,
    tendons_of,
)

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]

FARTHEST_M = 1.0
"""A tool's origin is nearer to the palm; larger numbers are millimetres."""
FULL_TURN_RAD = 2 * math.pi
LARGEST_FORCE_N, LARGEST_MOMENT_NM = 200.0, 20.0
"""More than a hand holds; larger numbers are grams, millinewtons, N.mm."""
LEAST_FORCE_N, LEAST_MOMENT_NM = 0.02, 0.002
"""A file in which no load is larger is in kilonewtons."""
LARGEST_MOTION_M, LARGEST_TURN_RAD = 0.1, 1.0
"""A tool that moved further has left the grasp; numbers beyond are millimetres or degrees."""
BEYOND_RANGE_RAD = 0.5
"""A joint may read so far outside of its range."""
TIP_SLACK_M = 0.02
"""A contact may be so much further from the fingertip's point than the tip is large."""
UNIT_LENGTH = 0.01
"""By how much a normal's length may differ from 1; it is scaled to 1 then."""
AGAINST = 0.5
"""Share of pushes that may seem to move the tool against the load; the springs of a hand give none."""
FEWEST = 5
"""Pushes that such a share is taken of."""
LATEST_S = 1e11
"""In the year 5138; larger numbers are milliseconds or nanoseconds."""
LONGEST_WAIT_S = 3600.0
"""Between pushes of one grasp; a longer one is a jump of the clock."""
PAUSE_S = 0.5
"""Opening and closing a hand takes longer."""
LARGEST_FRICTION = 5.0
"""No skin has more; larger numbers are percent."""
LARGEST_WEIGHT_N, LEAST_WEIGHT_N = 50.0, 0.1
"""No fingertips hold more; a file in which no tool has more is in kilograms."""
CARRIED = 3.0
"""Contacts carry no more than so many times the sum of their normal forces."""
OVER_TENSION = 2.0
"""A tendon pulls with no more than so many times the greatest tension of its description."""


@dataclass(frozen=True)
class Fault:
    """What is wrong, and in how many rows."""

    column: str
    text: str
    row: int | None = None
    """The first one, numbered as in the file; None where it is a fault of the whole column."""
    label: str = "row"
    """What the file's rows are called: `line` of a text, `row` else, `message` of a recording."""
    count: int = 1

    def __str__(self) -> str:
        place = f"{self.label} {self.row}: {self.column}".strip() if self.row is not None else self.column
        more = f" (and {self.count - 1} more {self.label}s)" if self.count > 1 else ""
        return f"{place} {self.text}{more}"


class TableError(AminnError):
    """A table that cannot be right. `faults` has all of it, the text the first."""

    def __init__(self, source: str, faults: Iterable[Fault]) -> None:
        self.source, self.faults = source, tuple(faults)
        others = len(self.faults) - 1
        more = f"; and {others} other fault{'s' if others > 1 else ''}" if others else ""
        super().__init__(f"{source}: {self.faults[0]}{more}")

    def __reduce__(self) -> tuple:
        return TableError, (self.source, self.faults)


@dataclass(frozen=True)
class Rows:
    """How the rows of a table are numbered where it comes from."""

    label: str
    numbers: NDArray[np.int64]

    @staticmethod
    def counted(n: int) -> Rows:
        """From 0, as arrays are."""
        return Rows("row", np.arange(n))

    def fault(self, column: str, bad: Mask, text: Callable[[int], str] | str) -> Iterator[Fault]:
        """One fault for all rows of `bad`; `text` says what is wrong with the row of that index."""
        found = np.flatnonzero(bad)
        if len(found):
            i = int(found[0])
            yield Fault(
                column, text if isinstance(text, str) else text(i), int(self.numbers[i]), self.label, len(found)
            )


def check(hand: Hand, arrays: Arrays, rows: Rows | None = None) -> list[Fault]:
    """Every fault of measured arrays; `contacts` may have NaN in features that no sensor tells.

    Raises AminnError where arrays have other shapes than the hand's.
    """
    _check_shapes(hand, arrays)
    rows = rows or Rows.counted(len(next(iter(arrays.values()))))
    faults = [*_missing_numbers(hand, arrays, rows), *_flags(hand, arrays, rows)]
    if faults:
        return faults
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are faults themselves
        return [f for look in LOOKS for f in look(hand, arrays, rows)]


def _check_shapes(hand: Hand, arrays: Arrays) -> None:
    shapes = shapes_of(hand)
    if unknown := sorted(set(arrays) - set(shapes)):
        raise AminnError(f"{unknown[0]} is no array of a table; there are {', '.join(shapes)}")
    lengths = {name: len(values) if np.ndim(values) else -1 for name, values in arrays.items()}
    for name, values in arrays.items():
        if np.shape(values)[1:] != shapes[name] or lengths[name] < 0:
            wanted = ", ".join(map(str, ("n", *shapes[name])))
            raise AminnError(f"{name} has shape {np.shape(values)}, expected ({wanted}) for hand {hand.name}")
    if len(set(lengths.values())) > 1:
        raise AminnError("arrays have different lengths: " + ", ".join(f"{k} {n}" for k, n in lengths.items()))


def _numbers(hand: Hand, arrays: Arrays, names: Iterable[str]) -> Iterator[tuple[str, tuple[int, ...], Array]]:
    """(column, place, values) of each number of a row."""
    for name in names:
        if name in arrays:
            for at in np.ndindex(shapes_of(hand)[name]):
                yield column_of(hand, name, at).name, at, np.asarray(numbers(arrays[name], at), float)


def _missing_numbers(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    """Cells without a finite number, where there must be one."""
    for name in (n for n in MEASURED if n in arrays):
        for column, at, values in _numbers(hand, arrays, [name]):
            bad = ~np.isfinite(values)
            if name == "contacts" and at[1] != ON:
                if np.isnan(values).all():
                    continue
                bad &= ~(np.isnan(values) & (arrays["contacts"][:, at[0], ON] == 0))
            if name == "dx_ht" and "stable" in arrays:
                bad &= ~(np.isnan(arrays["dx_ht"]).all(1) & (arrays["stable"] == 0))
            if name in SENSORS and at != (KNOWN,):
                bad &= arrays[name][:, KNOWN] != 0
            yield from rows.fault(
                column,
                bad,
                lambda i, v=values: "is empty or NaN" if math.isnan(v[i]) else "is infinite",  # type: ignore[misc]
            )


def _flags(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    names = ("contacts", "stable", *SENSORS)
    for column, _, values in (
        found
        for name in names
        for found in _numbers(hand, arrays, [name])
        if column_of(hand, name, found[1]).unit == "flag"
    ):
        bad = ~np.isin(values, (0, 1)) & np.isfinite(values)
        yield from rows.fault(column, bad, lambda i, v=values: f"is {v[i]:g}, expected 0 or 1")  # type: ignore[misc]


def _above(rows: Rows, column: str, values: Array, most: float, unit: str, hint: str) -> Iterator[Fault]:
    unit = f" {unit}".rstrip()
    yield from rows.fault(
        column, np.abs(values) > most, lambda i: f"is {values[i]:.6g}{unit}: more than {most:.3g}{unit}; {hint}"
    )


def _times(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if "time_s" not in arrays:
        return
    time = arrays["time_s"]
    late = list(_above(rows, "time_s", time, LATEST_S, "s", "are these milliseconds or nanoseconds?"))
    yield from late
    if late:
        return
    step = np.diff(time, prepend=time[:1] - 1)
    yield from rows.fault(
        "time_s",
        step < 0,
        lambda i: f"is {-step[i]:.6g} s before the row above: rows are to be sorted by time, from one clock",
    )
    yield from rows.fault("time_s", step == 0, "is that of the row above: one row per push")
    if "grasp_id" not in arrays or (step <= 0).any():
        return
    grasp = arrays["grasp_id"]
    same = np.append(False, grasp[1:] == grasp[:-1])
    yield from rows.fault(
        "time_s",
        same & (step > LONGEST_WAIT_S),
        lambda i: f"jumps by {step[i]:.6g} s within grasp {grasp[i]}: was the clock set, or is it another grasp?",
    )
    yield from rows.fault(
        "grasp_id",
        ~same & (step < PAUSE_S) & (np.arange(len(step)) > 0),
        lambda i: (
            f"changes to {grasp[i]} only {step[i]:.3g} s after the row above: no hand opens and closes in {PAUSE_S:g} s"
        ),
    )
    first = np.unique(grasp, return_index=True)[1]
    began = np.isin(np.arange(len(grasp)), first)
    yield from rows.fault(
        "grasp_id",
        ~same & ~began,
        lambda i: f"is {grasp[i]} again after another grasp: give each closing of the hand its own number",
    )


def _angles(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    coordinates = [c for b in hand.branches for c in b.coordinates]
    for (column, _, values), c in zip(_numbers(hand, arrays, ["q"]), coordinates, strict=False):
        turned = list(_above(rows, column, values, FULL_TURN_RAD, "rad", "are these degrees?"))
        yield from turned
        if not turned:
            outside = (values < c.low_rad - BEYOND_RANGE_RAD) | (values > c.high_rad + BEYOND_RANGE_RAD)
            yield from rows.fault(
                column,
                outside,
                lambda i, v=values, c=c: (
                    f"is {v[i]:.4g} rad, the joint's range is {c.low_rad:.3g} to "  # type: ignore[misc]
                    f"{c.high_rad:.3g}: degrees, another zero or sign, or another joint?"
                ),
            )


def _pose(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    for column, (at,), values in _numbers(hand, arrays, ["x_ht"]):
        if at < 3:
            yield from _above(
                rows, column, values, FARTHEST_M, "m", "are these millimetres, or not in the palm's frame?"
            )
        else:
            yield from _above(rows, column, values, FULL_TURN_RAD, "rad", "are these degrees?")


def _load(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if "w_e" not in arrays:
        return
    for column, (at,), values in _numbers(hand, arrays, ["w_e"]):
        if at < 3:
            yield from _above(rows, column, values, LARGEST_FORCE_N, "N", "are these grams or millinewtons?")
        else:
            yield from _above(rows, column, values, LARGEST_MOMENT_NM, "N.m", "are these N.mm?")
    force, moment = (np.linalg.norm(arrays["w_e"][:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    if len(force) >= FEWEST and 0 < force.max() < LEAST_FORCE_N and moment.max() < LEAST_MOMENT_NM:
        yield Fault(
            "w_e_fx, fy, fz", f"are at most {force.max():.3g} N in all {len(force)} rows: are these kilonewtons?"
        )


def _motion(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if "dx_ht" not in arrays:
        return
    held = arrays["stable"] > 0 if "stable" in arrays else np.ones(len(arrays["dx_ht"]), bool)
    held = held & np.isfinite(arrays["dx_ht"]).all(1)
    most = max(LARGEST_MOTION_M, hand.length_m)
    for column, (at,), values in _numbers(hand, arrays, ["dx_ht"]):
        of_held = np.where(held, values, 0.0)
        if at < 3:
            yield from _above(
                rows, column, of_held, most, "m", "did the tool stay in the hand, or are these millimetres?"
            )
        else:
            yield from _above(
                rows, column, of_held, LARGEST_TURN_RAD, "rad", "did the tool stay in the hand, or are these degrees?"
            )
    for name, text in (
        ("dx_ht", "the tool never moved; was it measured?"),
        ("w_e", "nothing pushed; was it measured?"),
    ):
        if name in arrays and held.sum() >= FEWEST and not arrays[name][held].any():
            yield Fault(name, f"is 0 in all {held.sum()} pushes that held: {text}")
            return
    if "w_e" in arrays and held.sum() >= FEWEST:
        work = (arrays["w_e"] * arrays["dx_ht"]).sum(1)[held]
        if (share := float((work < 0).mean())) > AGAINST:
            yield Fault(
                "w_e",
                f"points against the motion in {share:.0%} of the pushes that held: is it what the tool answers, "
                "in another frame, or about another point?",
            )


def _reach(hand: Hand, b: int) -> float:
    """How far a contact may be from the point of a branch's tip, m: as far as the last link is long, and some."""
    branch = hand.branches[b]
    link = np.linalg.norm(np.subtract(branch.tip_point_m, branch.coordinates[-1].anchor_m))
    return float(link) + branch.tip_radius_m + TIP_SLACK_M


def _contacts(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if "contacts" not in arrays:
        return
    for b, branch in enumerate(hand.branches):
        contact = arrays["contacts"][:, b]
        on = contact[:, ON] > 0
        name = f"contact_{branch.name}"
        yield from _force(rows, f"{name}_force", contact[:, FORCE], on)
        length = np.linalg.norm(contact[:, NORMAL], axis=1)
        yield from rows.fault(
            f"{name}_nx, ny, nz",
            on & (np.abs(length - 1) > UNIT_LENGTH),
            lambda i, v=length: f"has length {v[i]:.4g}, expected 1",  # type: ignore[misc]
        )
        if "q" not in arrays:
            continue
        tip = branch.moved(arrays["q"][:, hand.branch_joints[b]], np.array(branch.tip_point_m))
        away, most = np.linalg.norm(contact[:, POINT] - tip, axis=1), _reach(hand, b)
        far = on & (away > most)
        yield from rows.fault(
            f"{name}_x, y, z",
            far,
            lambda i, v=away, most=most: (
                f"is {v[i]:.4g} m from where the joint angles put the fingertip, more than "  # type: ignore[misc]
                f"{most:.3g} m: millimetres, another frame, or another finger?"
            ),
        )
        if branch.tip_radius_m > 0 and not far.any():
            outward = ((contact[:, POINT] - tip) * contact[:, NORMAL]).sum(1)[on]
            if len(outward) >= FEWEST and (outward < 0).mean() > AGAINST:
                yield Fault(f"{name}_nx, ny, nz", "points out of the tool: the normal is that into it")


def _force(rows: Rows, column: str, force: Array, on: Mask) -> Iterator[Fault]:
    known = np.where(on, force, 0.0)
    yield from rows.fault(
        column, known < 0, lambda i: f"is {known[i]:.4g} N: a contact pushes, its normal force is 0 or more"
    )
    yield from _above(rows, column, np.maximum(known, 0), LARGEST_FORCE_N, "N", "are these grams or millinewtons?")


def _twice(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    told = [n for n in ("grasp_id", "q", "x_ht", "w_e", "contacts", "dx_ht") if n in arrays]
    if "dx_ht" not in told:  # states may well repeat where nothing is measured of them
        return
    flat = np.hstack([np.asarray(arrays[n], float).reshape(len(arrays[n]), -1) for n in told])
    _, first, back = np.unique(flat, axis=0, return_index=True, return_inverse=True)
    of = first[back.ravel()]
    moved = np.abs(np.nan_to_num(arrays["dx_ht"])).max(1) > 0
    yield from rows.fault(
        "the row",
        moved & (of != np.arange(len(flat))),
        lambda i: f"repeats {rows.label} {rows.numbers[of[i]]}: every number is the same",
    )


def _theta(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    limits = {"1": (3.0, "expected the logarithm of a factor"), "rad": (0.5, "are these degrees?")}
    limits["m"] = (0.02, "are these millimetres?")
    for column, at, values in _numbers(hand, arrays, ["theta"]):
        unit = column_of(hand, "theta", at).unit
        most, hint = limits[unit]
        yield from _above(rows, column, values, most, "" if unit == "1" else unit, hint)


def _friction(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if FRICTION not in arrays:
        return
    known, value, deviation = arrays[FRICTION].T
    value, deviation = np.where(known, value, 1.0), np.where(known, deviation, 0.0)
    yield from rows.fault(
        "friction",
        value <= 0,
        lambda i: f"is {value[i]:.4g}, expected more than 0; leave it empty where nothing is known",
    )
    yield from _above(rows, "friction", np.maximum(value, 0), LARGEST_FRICTION, "", "is this percent?")
    yield from rows.fault("friction_sd", deviation < 0, lambda i: f"is {deviation[i]:.4g}, expected 0 or more")
    yield from rows.fault(
        "friction_sd",
        (value > 0) & (deviation > value),
        lambda i: f"is {deviation[i]:.4g}, more than friction itself, {value[i]:.4g}: is this percent?",
    )


def _weight(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if TOOL_WEIGHT not in arrays:
        return
    known = arrays[TOOL_WEIGHT][:, KNOWN] > 0
    weight, hint = np.where(known[:, None], arrays[TOOL_WEIGHT], 0.0), "are these grams or millinewtons?"
    heavy = list[Fault]()
    for column, at, _ in _numbers(hand, arrays, [TOOL_WEIGHT]):
        heavy += _above(rows, column, weight[:, at[0]], LARGEST_WEIGHT_N, "N", hint) if at != (KNOWN,) else ()
    yield from heavy
    size = np.linalg.norm(weight[:, KNOWN + 1 :], axis=1)
    force = arrays["contacts"][..., FORCE] if "contacts" in arrays else np.full((len(size), 1), math.nan)
    if not heavy and not np.isnan(force).all(0).any():
        force = np.where(arrays["contacts"][..., ON] > 0, force, 0.0).sum(1)
        yield from rows.fault(
            "tool_weight_x, y, z",
            size > CARRIED * force,
            lambda i: f"is {size[i]:.4g} N, more than contacts of {force[i]:.4g} N carry: {hint}",
        )
    if known.sum() >= FEWEST and size.max() < LEAST_WEIGHT_N:
        yield Fault(
            "tool_weight_x, y, z",
            f"is at most {size.max():.3g} N in all {known.sum()} rows that tell it: are these kilograms? Leave it "
            "out where tools have less than 10 g",
        )


def _tension(hand: Hand, arrays: Arrays, rows: Rows) -> Iterator[Fault]:
    if TENDON_TENSION not in arrays:
        return
    known = arrays[TENDON_TENSION][:, KNOWN] > 0
    for i, tendon in enumerate(tendons_of(hand)):
        at = (KNOWN + 1 + i,)
        column = column_of(hand, TENDON_TENSION, at).name
        values = np.where(known, numbers(arrays[TENDON_TENSION], at), 0.0)
        if tendon.pull_only:
            yield from rows.fault(
                column,
                values < 0,
                lambda i, v=values: f"is {v[i]:.4g} N: a tendon pulls, its tension is 0 or more",  # type: ignore[misc]
            )
        most = max(LARGEST_FORCE_N, OVER_TENSION * tendon.max_tension_N)
        pull = np.maximum(values, 0) if tendon.pull_only else values
        yield from _above(rows, column, pull, most, "N", "are these grams or millinewtons?")


LOOKS = (_times, _angles, _pose, _load, _motion, _contacts, _twice, _theta, _friction, _weight, _tension)


def settled(arrays: Arrays) -> Arrays:
    """Checked arrays in the form that everything else takes: normals exactly of unit length, whole turns left out.

    What is not told of a finger that does not touch is 0, and so is the motion of a push that did not hold, and what a
    sensor says that is not known.
    """
    out: Arrays = {name: np.array(values, DTYPES.get(name, np.float64)) for name, values in arrays.items()}
    if "contacts" in out:
        contacts = out["contacts"]
        length = np.linalg.norm(contacts[..., NORMAL], axis=-1, keepdims=True)
        off = np.abs(length - 1) > 1e-9
        contacts[..., NORMAL] = np.where(
            off & (length > 0), contacts[..., NORMAL] / np.where(length > 0, length, 1), contacts[..., NORMAL]
        )
        told = ~np.isnan(contacts).all((0, 1))
        contacts[contacts[..., ON] == 0] = np.where(told, 0.0, np.nan)
    for name in ("x_ht", "dx_ht"):
        if name in out:
            out[name][:, 3:] = _least_turn(out[name][:, 3:])
    if "dx_ht" in out:
        out["dx_ht"][np.isnan(out["dx_ht"]).all(1)] = 0.0
    for name in SENSORS:
        if name in out:
            out[name][out[name][:, KNOWN] == 0] = 0.0
    return out


def _least_turn(turn: Array) -> Array:
    """Rotation vectors (n, 3) with angles of at most half a turn."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    wound = angle > math.pi
    rest = angle - FULL_TURN_RAD * np.round(angle / FULL_TURN_RAD)
    return np.where(wound, turn * rest / np.where(wound, angle, 1.0), turn)
