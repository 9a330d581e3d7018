"""The usual mistakes in the data of a hand: each tried by reading the data that way.

A mistake is named where the model with some theta explains the data far better if they are read so than as they are
told. That needs no knowledge of the hand beyond its description, since theta is fitted again to each reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from aminn_hand import Hand
from aminn_hand.hand import rotation, times
from aminn_hand.theta import Theta

from .fit import Errors, Fit, Prior, fit
from .pushes import FIELDS, Array, Predict, Pushes, relative_errors

MARGIN = 20.0
"""By how much the logarithm of the posterior density must rise for a mistake to be named."""
NEAR = 3.0
"""Readings whose logarithm is within so much of the best are told beside it."""
TRIED = 4
"""How many readings are fitted, those that fit best before it."""
ITERATIONS = 5
ROUGH = 0.3
"""Relative error that counts as none before a fit."""

Change = Callable[[Pushes], Pushes]


@dataclass(frozen=True)
class Mistake:
    """One way to get the data wrong."""

    name: str
    """Of its kind."""
    variant: str
    """Which of them; "" where there is one. Orders of fingers and turns of axes are many of one variant."""
    detail: str
    """What to do, as the rest of the sentence "the data look as if ..."."""
    made: Change
    """What pushes look like with it."""
    mended: Change
    """The way back."""


@dataclass(frozen=True)
class Found:
    """A reading that explains the data better than what they are told to be."""

    mistake: Mistake
    gain: float
    """Rise of the logarithm of the posterior density."""
    relative_error_median: float
    """Of all pushes, with the theta that fits that reading, deviations of grasps left out."""


def _with(change: Callable[[dict[str, Array]], dict[str, Array]]) -> Change:
    """A change of fields from a function of copies of them."""

    def changed(pushes: Pushes) -> Pushes:
        return pushes.told(**change({name: getattr(pushes, name).copy() for name in FIELDS}))

    return changed


def _times(factors: Mapping[str, Array | float]) -> Change:
    return _with(lambda s: {name: s[name] * factor for name, factor in factors.items()})


def _scaled(name: str, variant: str, detail: str, factors: Mapping[str, Array | float]) -> Mistake:
    """Numbers that are told larger by factors."""
    return Mistake(
        name, variant, detail, _times(factors), _times({field: 1 / np.asarray(f) for field, f in factors.items()})
    )


def _units(hand: Hand) -> Iterator[Mistake]:
    mm, deg = 1e3, 180 / np.pi
    first, last = np.repeat([mm, 1.0], 3), np.repeat([1.0, deg], 3)
    points = np.array([1.0, mm, mm, mm, 1.0, 1.0, 1.0, 1.0])
    places = {"x_ht": first, "contacts": points}
    moment = np.repeat([1.0, mm], 3)
    lengths = "all lengths are in mm"
    for variant, detail, factors in (
        ("positions", "positions are in mm: give contacts and x_ht in m", places),
        ("displacements", "displacements are in mm: give dx_ht in m", {"dx_ht": first}),
        ("moments", "moments are in N.mm: give them in N.m", {"w_e": moment}),
        ("lengths", f"{lengths}: give contacts, x_ht and dx_ht in m", places | {"dx_ht": first}),
        ("all", f"{lengths}: give m, and moments in N.m", places | {"dx_ht": first, "w_e": moment}),
    ):
        yield _scaled("millimetres", variant, detail, factors)
    yield _scaled("degrees", "joints", "joint angles are in degrees: give q in rad", {"q": deg})
    yield _scaled("degrees", "displacements", "rotations of dx_ht are in degrees: give them in rad", {"dx_ht": last})
    yield _scaled("degrees", "all", "all angles are in degrees: give rad", {"q": deg, "dx_ht": last, "x_ht": last})


def _exchanged(hand: Hand) -> Iterator[Mistake]:
    """Every order of branches that data can be told in: of contacts any, of joint angles those of equal chains."""
    at, n = hand.branch_joints, len(hand.branches)
    chains = [len(b.coordinates) for b in hand.branches]
    for order in permutations(range(n)):
        moved = [b for b in range(n) if order[b] != b]
        if not moved or (n > 4 and len(moved) > 2):
            continue
        alike = all(chains[b] == chains[order[b]] for b in moved)
        names = ", ".join(
            f"{hand.branches[order[b]].name}'s stand where {hand.branches[b].name}'s belong" for b in moved
        )
        back = np.argsort(order)
        kinds = [("contacts", True, False)]
        if alike:
            kinds += [("joints", False, True), ("all", True, True)]
        texts = {"contacts": "contacts", "joints": "joint angles", "all": "joint angles and contacts"}
        for variant, contacts, angles in kinds:
            made, mended = (_ordered(list(o), at, contacts, angles) for o in (order, back))
            detail = f"{texts[variant]} are exchanged: {names}"
            yield Mistake("fingers_exchanged", variant, detail, made, mended)


def _ordered(order: list[int], at: tuple[slice, ...], contacts: bool, angles: bool) -> Change:
    def change(s: dict[str, Array]) -> dict[str, Array]:
        out = {"contacts": s["contacts"][:, order]} if contacts else {}
        return out | ({"q": np.concatenate([s["q"][:, at[b]] for b in order], 1)} if angles else {})

    return _with(change)


def _moments(hand: Hand) -> Iterator[Mistake]:
    def about(point: Callable[[dict[str, Array]], Array], sign: float) -> Change:
        def change(s: dict[str, Array]) -> dict[str, Array]:
            arm = s["x_ht"][:, :3] - point(s)
            s["w_e"][:, 3:] += sign * np.cross(arm, s["w_e"][:, :3])
            return {"w_e": s["w_e"]}

        return _with(change)

    def centroid(s: dict[str, Array]) -> Array:
        c = s["contacts"]
        return (c[..., :1] * c[..., 1:4]).sum(1) / np.maximum(c[..., :1].sum(1), 1e-9)

    places: dict[str, tuple[str, Callable[[dict[str, Array]], Array]]] = {
        "hand": ("the hand's origin", lambda s: np.zeros((len(s["q"]), 3))),
        "contacts": ("the middle of the contacts", centroid),
    }
    for variant, (text, point) in places.items():
        detail = f"moments are about {text}: give them about the origin of the tool's frame"
        yield Mistake("moment_point", variant, detail, about(point, 1.0), about(point, -1.0))


def _quarter_turns() -> Iterator[Array]:
    """The 23 rotations that carry axes to axes, without none at all."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(turn) > 0 and not np.array_equal(turn, np.eye(3)):
                yield turn


def _turned(field: str, turn: Callable[[dict[str, Array]], Array]) -> Change:
    """Both vectors of a field (n, 6) turned."""

    def change(s: dict[str, Array]) -> dict[str, Array]:
        both = s[field].reshape(-1, 2, 3)
        return {field: times(turn(s)[:, None], both).reshape(-1, 6)}

    return _with(change)


def _frames(hand: Hand) -> Iterator[Mistake]:
    def tool(s: dict[str, Array]) -> Array:
        return rotation(s["x_ht"][:, 3:])

    def palm(s: dict[str, Array]) -> Array:
        return tool(s).swapaxes(1, 2)

    fields = {"w_e": "loads", "dx_ht": "displacements"}
    for field, text in fields.items():
        detail = f"{text} are in axes of the tool: turn them into those of the hand"
        yield Mistake("frame", f"{text}_in_tool", detail, _turned(field, palm), _turned(field, tool))
        detail = f"{text} are turned with the tool's pose, though they are in axes of the hand already"
        yield Mistake("frame", f"{text}_turned_twice", detail, _turned(field, tool), _turned(field, palm))
    for turn in _quarter_turns():
        axes = ", ".join("xyz"[int(np.abs(row).argmax())].rjust(2, "+-"[int(row.sum() < 0)]) for row in turn)
        made, mended = ((lambda s, t=t: np.broadcast_to(t, (len(s["q"]), 3, 3))) for t in (turn, turn.T))
        for field, text in fields.items():
            detail = f"{text} are in turned axes: what is told as x, y, z is {axes} of the hand"
            yield Mistake("frame", f"{text}_axes", detail, _turned(field, made), _turned(field, mended))


def _others(hand: Hand) -> Iterator[Mistake]:
    minus = _times({"w_e": -1.0})
    yield Mistake(
        "load_sign",
        "",
        "the load or the displacement has the other sign: give the load that acts on the tool, and where the tool goes",
        minus,
        minus,
    )
    radii = np.array([b.tip_radius_m for b in hand.branches])
    if radii.any():

        def along_normal(sign: float) -> Change:
            def change(s: dict[str, Array]) -> dict[str, Array]:
                s["contacts"][..., 1:4] += sign * radii[:, None] * s["contacts"][..., 4:7]
                return {"contacts": s["contacts"]}

            return _with(change)

        detail = "contacts are at the fingertips' centres: go the tip's radius along the normal"
        yield Mistake("fingertip_centre", "", detail, along_normal(-1.0), along_normal(1.0))
    swap = _with(lambda s: {"w_e": s["w_e"][:, [3, 4, 5, 0, 1, 2]]})
    yield Mistake("force_and_moment", "", "force and moment are exchanged: give the force first", swap, swap)


def mistakes_of(hand: Hand) -> list[Mistake]:
    """Every mistake that is tried on data of a hand."""
    return [m for kind in (_others, _units, _exchanged, _moments, _frames) for m in kind(hand)]


def _roughly(predict: Predict, readings: list[Pushes]) -> Array:
    """How far each reading is from what the nominal hand does: mean over pushes, from 0."""
    errors = [relative_errors(predict(p, np.zeros((len(p), len(Theta(p.hand))))), p) for p in readings]
    return np.array([np.log1p((e / ROUGH) ** 2).mean() for e in errors])


def find_mistakes(
    predict: Predict,
    pushes: Pushes,
    prior: Prior | None = None,
    errors: Errors | None = None,
    noise: Array | None = None,
    margin: float = MARGIN,
) -> list[Found]:
    """The readings that explain the data decisively better than what they are told to be, best first; mostly none.

    More than one where the data cannot tell them apart.
    """
    tried = mistakes_of(pushes.hand)
    free = np.arange(len(Theta(pushes.hand))) < Theta(pushes.hand).factors
    readings = [m.mended(pushes) for m in tried]
    best = np.argsort(_roughly(predict, readings), kind="stable")[:TRIED]

    def fitted(p: Pushes) -> Fit:
        return fit(predict, p, prior, errors, free, noise, ITERATIONS)

    told, found = fitted(pushes).loss, []
    for k in best:
        found_theta = fitted(readings[k])
        gain = told - found_theta.loss
        if gain >= margin:
            rows = np.tile(found_theta.theta, (len(pushes), 1))
            error = relative_errors(predict(readings[k], rows), readings[k])
            found.append(Found(tried[k], gain, float(np.median(error))))
    found.sort(key=lambda f: -f.gain)
    return [f for f in found if f.gain >= found[0].gain - NEAR]
