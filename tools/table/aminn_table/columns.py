"""The columns of a table of pushes, one row per push: the one list for reader, checks, messages and documentation.

A row says how hand, tool and contacts stood before the push, what the push was, and what it did. SI, palm frame H.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aminn_hand import Hand, Tendon
from aminn_hand.hand import N_CONTACT_FEATURE, N_WRENCH, STATE
from aminn_hand.sensors import CLASS_NAMES, DEFAULT_DEVIATION, FRICTION, TENDON_TENSION, TOOL_WEIGHT, UNITS
from aminn_hand.theta import Theta

Arrays = dict[str, NDArray]
"""Measured numbers by the names of a model's inputs and outputs, each with one row per push."""

PALM = "H"
PUSH = (*STATE, "dx_ht")
"""What a calibration needs."""
LABELLED = (*PUSH, "grasp_id")
"""What a data set needs."""
SENSORS = tuple(UNITS)
"""Arrays of what need not be known; those of a hand are in its `Dims.sensors`."""
MEASURED = ("time_s", "grasp_id", "q", "x_ht", "w_e", "contacts", "dx_ht", "stable", "theta", *SENSORS)
"""Arrays that a lab gives."""
FRICTION_CLASS = "friction_class"
"""Texts that a table may have in place of friction; `read_table` gives friction."""
RESULTS = ("p_stable", "holds", "pred_dx_ht", "p_slide", "bound_95", "friction_use", "notes", "status")
"""Arrays that predictions add."""

Place = tuple[int, ...]
"""Where a number stands in a row of its array."""


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    name: str
    array: str
    """Array that it is a part of."""
    at: Place
    unit: str
    """`m`, `rad`, `N`, `N.m`, `s`, `1`; `flag`: 0 or 1; `integer`; `text`."""


@dataclass(frozen=True)
class Group:
    """Columns that are told together or not at all; of contacts, those of one branch."""

    pattern: str
    """Their names, as documentation writes them."""
    array: str
    unit: str
    frame: str
    meaning: str
    """With sign and point of reference."""
    need: str
    """`always`, `data sets` (and what learns of them), `optional`, `results`."""
    names: Callable[[Hand], Iterator[tuple[str, Place]]]
    without: str = ""
    """What stands in where it is not told."""

    def columns(self, hand: Hand) -> tuple[Column, ...]:
        """Of a hand."""
        units = [p.unit for p in Theta(hand).parameters] if self.array == "theta" else []
        return tuple(
            Column(name, self.array, at, units[at[0]] if units else self.unit) for name, at in self.names(hand)
        )


def _one(name: str, at: Place = ()) -> Callable[[Hand], Iterator[tuple[str, Place]]]:
    return lambda hand: iter([(name, at)])


def _part(start: str, parts: str, first: int) -> Callable[[Hand], Iterator[tuple[str, Place]]]:
    return lambda hand: ((f"{start}_{part}", (first + i,)) for i, part in enumerate(parts.split()))


def _contact(parts: str, first: int) -> Callable[[Hand], Iterator[tuple[str, Place]]]:
    return lambda hand: (
        (f"contact_{branch.name}_{part}", (b, first + i))
        for b, branch in enumerate(hand.branches)
        for i, part in enumerate(parts.split())
    )


def _tensions(hand: Hand) -> Iterator[tuple[str, Place]]:
    return ((f"{TENDON_TENSION}_{t.name}", (1 + i,)) for i, t in enumerate(tendons_of(hand)))


def _known(name: str) -> Group:
    """The first number of a sensor's array."""
    return Group(
        f"{name}_known",
        name,
        "flag",
        "",
        "1: the row tells it; 0: whatever it tells is not known",
        "optional",
        lambda hand: iter([(f"{name}_known", (KNOWN,))] if name in hand.dims.sensors else ()),
        "1 where the row tells it",
    )


def tendons_of(hand: Hand) -> tuple[Tendon, ...]:
    """All tendons of a hand, in their order."""
    return tuple(tendon for branch in hand.branches for tendon in branch.tendons)


KNOWN = 0
"""Where a sensor's array says whether it is known."""
ON, FORCE = 0, 7
POINT, NORMAL = slice(1, 4), slice(4, 7)
"""Where the features of a contact stand."""

GROUPS = (
    Group(
        "time_s",
        "time_s",
        "s",
        "",
        "when the push began, on one clock for the whole file; rises from row to row",
        "optional",
        _one("time_s"),
        "clock and pauses are not checked",
    ),
    Group(
        "grasp_id",
        "grasp_id",
        "integer",
        "",
        "which closing of the hand on which tool: pushes of one grasp share it, another grasp has another",
        "data sets",
        _one("grasp_id"),
    ),
    Group(
        "q_JOINT",
        "q",
        "rad",
        "",
        "angle of each joint before the push; zero and sign as in the hand's model",
        "always",
        lambda hand: ((f"q_{joint}", (i,)) for i, joint in enumerate(hand.joints)),
    ),
    Group(
        "x_ht_x, y, z",
        "x_ht",
        "m",
        PALM,
        "origin of the tool's frame before the push",
        "always",
        _part("x_ht", "x y z", 0),
    ),
    Group(
        "x_ht_rx, ry, rz",
        "x_ht",
        "rad",
        PALM,
        "rotation vector that turns the palm's axes into the tool's, before the push",
        "always",
        _part("x_ht", "rx ry rz", 3),
    ),
    Group(
        "w_e_fx, fy, fz",
        "w_e",
        "N",
        PALM,
        "force that pushes the tool, beyond its weight: on the tool, not what the tool answers",
        "always",
        _part("w_e", "fx fy fz", 0),
    ),
    Group(
        "w_e_mx, my, mz",
        "w_e",
        "N.m",
        PALM,
        "its moment about the origin of the tool's frame before the push",
        "always",
        _part("w_e", "mx my mz", 3),
    ),
    Group(
        "contact_BRANCH_on",
        "contacts",
        "flag",
        "",
        "1: the fingertip touches the tool before the push",
        "always",
        _contact("on", ON),
    ),
    Group(
        "contact_BRANCH_x, y, z",
        "contacts",
        "m",
        PALM,
        "where it touches: on the tool's surface, not the fingertip's centre",
        "optional",
        _contact("x y z", 1),
        "the fingertip's centre by the joint angles, and its radius along the normal",
    ),
    Group(
        "contact_BRANCH_nx, ny, nz",
        "contacts",
        "1",
        PALM,
        "unit normal of the surface there, into the tool",
        "optional",
        _contact("nx ny nz", 4),
        "from the fingertip's centre to the contact; of other tips, or without contact points, the pinch's direction",
    ),
    Group(
        "contact_BRANCH_force",
        "contacts",
        "N",
        "",
        "size of the contact's normal force before the push; 0 or more",
        "optional",
        _contact("force", FORCE),
        "the mean of the model's training, else a nominal one",
    ),
    Group(
        "dx_ht_x, y, z",
        "dx_ht",
        "m",
        PALM,
        "motion of the tool frame's origin by the push: under load minus before",
        "data sets",
        _part("dx_ht", "x y z", 0),
    ),
    Group(
        "dx_ht_rx, ry, rz",
        "dx_ht",
        "rad",
        PALM,
        "rotation vector of R_under_load R_before^T",
        "data sets",
        _part("dx_ht", "rx ry rz", 3),
    ),
    Group(
        "stable",
        "stable",
        "flag",
        "",
        "1: the grasp held, and came to rest under the load; 0: it did not, and dx_ht may be empty",
        "optional",
        _one("stable"),
        "every push with a displacement counts as held",
    ),
    Group(
        "theta_NAME",
        "theta",
        "1, rad, m",
        "",
        "the hand's mechanics where they are known: logarithms of factors, zeros of joints, radius of tips",
        "optional",
        lambda hand: ((f"theta_{name}", (i,)) for i, name in enumerate(Theta(hand).names)),
        "nominal",
    ),
    Group(
        "friction",
        FRICTION,
        UNITS[FRICTION],
        "",
        "friction between fingertips and tool: greatest tangential over normal force of a contact; more than 0",
        "optional",
        _one("friction", (1,)),
        "not known",
    ),
    Group(
        "friction_sd",
        FRICTION,
        UNITS[FRICTION],
        "",
        "its standard deviation, 0 or more; 0: exact",
        "optional",
        _one("friction_sd", (2,)),
        f"{DEFAULT_DEVIATION:.0%} of friction",
    ),
    Group(
        FRICTION_CLASS,
        FRICTION_CLASS,
        "text",
        "",
        f"in place of friction, where no more is known: {', '.join(CLASS_NAMES)}",
        "optional",
        _one(FRICTION_CLASS),
        "not known",
    ),
    Group(
        "tool_weight_x, y, z",
        TOOL_WEIGHT,
        UNITS[TOOL_WEIGHT],
        PALM,
        "force of gravity on the tool before the push; points down",
        "optional",
        _part("tool_weight", "x y z", 1),
        "not known",
    ),
    Group(
        "tendon_tension_TENDON",
        TENDON_TENSION,
        UNITS[TENDON_TENSION],
        "",
        "tension of each tendon before the push; 0: slack",
        "optional",
        _tensions,
        "not known",
    ),
    *(_known(name) for name in SENSORS),
    Group("p_stable", "p_stable", "1", "", "predicted: probability that the grasp holds", "results", _one("p_stable")),
    Group("holds", "holds", "flag", "", "predicted: p_stable reaches the model's threshold", "results", _one("holds")),
    Group(
        "pred_dx_ht_x, y, z",
        "pred_dx_ht",
        "m",
        PALM,
        "predicted: motion, as dx_ht",
        "results",
        _part("pred_dx_ht", "x y z", 0),
    ),
    Group(
        "pred_dx_ht_rx, ry, rz",
        "pred_dx_ht",
        "rad",
        PALM,
        "predicted: rotation, as dx_ht",
        "results",
        _part("pred_dx_ht", "rx ry rz", 3),
    ),
    Group(
        "p_slide",
        "p_slide",
        "1",
        "",
        "predicted: probability that a contact slides by more than 0.5 mm, if the grasp holds",
        "results",
        _one("p_slide"),
    ),
    Group(
        "bound_95",
        "bound_95",
        "1",
        "",
        "predicted: what the error of pred_dx_ht does not exceed in 95 of 100, translation over the hand's length and "
        "rotation in rad together",
        "results",
        _one("bound_95"),
    ),
    Group(
        "friction_use_BRANCH",
        "friction_use",
        "1",
        "",
        "predicted: share of its friction that the contact uses under the load; beyond 1 it slides",
        "results",
        lambda hand: ((f"friction_use_{branch.name}", (b,)) for b, branch in enumerate(hand.branches)),
    ),
    Group(
        "notes",
        "notes",
        "text",
        "",
        "predicted: why not to trust it, empty where nothing speaks against it",
        "results",
        _one("notes"),
    ),
    Group(
        "status",
        "status",
        "integer",
        "",
        "predicted: 0, or why nothing could be: a status code of `aminn_rt.h`, whose meaning `notes` says",
        "results",
        _one("status"),
    ),
)


@lru_cache(maxsize=16)
def columns_of(hand: Hand) -> tuple[Column, ...]:
    """Every column that a table of this hand may have, in their order."""
    return tuple(column for group in GROUPS for column in group.columns(hand))


def shapes_of(hand: Hand) -> dict[str, tuple[int, ...]]:
    """Shape of a row of each array."""
    return {
        "time_s": (),
        "grasp_id": (),
        "q": (hand.dims.joints,),
        "x_ht": (N_WRENCH,),
        "w_e": (N_WRENCH,),
        "contacts": (hand.dims.branches, N_CONTACT_FEATURE),
        "dx_ht": (N_WRENCH,),
        "stable": (),
        "theta": (len(Theta(hand)),),
        **hand.dims.sensors,
        FRICTION_CLASS: (),
        "p_stable": (),
        "holds": (),
        "pred_dx_ht": (N_WRENCH,),
        "p_slide": (),
        "bound_95": (),
        "friction_use": (hand.dims.branches,),
        "notes": (),
        "status": (),
    }


_KINDS = {"grasp_id": "i8", "stable": "u1", "holds": "u1", "notes": "O", "status": "i8", FRICTION_CLASS: "O"}
DTYPES = {name: np.dtype(kind) for name, kind in _KINDS.items()}
"""Of arrays that are not float64."""


@lru_cache(maxsize=16)
def _by_place(hand: Hand) -> dict[tuple[str, Place], Column]:
    return {(c.array, c.at): c for c in columns_of(hand)}


def numbers(values: NDArray, at: Place) -> NDArray:
    """(n) what stands at one place of every row."""
    index: tuple[slice | int, ...] = (slice(None), *at)
    return values[index]


def column_of(hand: Hand, array: str, at: Place) -> Column:
    """The column that holds a number of an array."""
    return _by_place(hand)[array, at]


def markdown() -> str:
    """The columns as documentation shows them."""
    lines = ["| column | unit | frame | meaning and sign | needed | without it |", "|---|---|---|---|---|---|"]
    for g in GROUPS:
        need = {"results": "no: `aminn predict` writes it"}.get(g.need, g.need)
        lines.append(f"| `{g.pattern}` | {g.unit} | {g.frame} | {g.meaning} | {need} | {g.without or '-'} |")
    return "\n".join(lines)
