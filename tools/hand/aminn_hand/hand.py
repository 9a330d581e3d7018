"""A hand: branches (serial chains from the palm), their joints, springs, tendons and contacts. SI, palm frame H.

Everything is stated at q = 0. Column c of a branch's closure block B_b is z_c x (contact - anchor_c), with each
coordinate's own axis and anchor, turned by the coordinates before it.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from aminn_base.errors import AminnError

Array = NDArray[np.float64]
Vector = tuple[float, ...]

MIN_BRANCHES, MAX_BRANCHES = 2, 5
MAX_COORDINATES = 5
LENGTH_M = 0.1
"""Characteristic length of a hand that tells none."""
LEAST_MOTION_M = 1e-12
"""Least size of a motion that is divided by, so that no motion at all can be."""
UNIT_SLACK = 1e-6
"""By how much the length of a unit vector may differ from 1."""
N_WRENCH = 6
N_CONTACT_FEATURE = 8
"""In contact, position (3), normal (3), normal force."""
N_GATE = 3
"""alpha (1/rad), beta (rad), rho."""
STATE = ("q", "x_ht", "w_e", "contacts")
"""What is measured before a load, and the load (`aminn_state_t` of the C runtime)."""
INPUTS = (*STATE, "j_x", "j_q")
MAX_LOG_BOUND = 80.0
"""Of the logarithm of `bound_95`: where a network is far beyond its data its exponential is no number."""
OUTPUTS = ("p_stable", "dx_ht", "k_x", "gate", "p_slide", "bound_95", "friction_use")
"""Of a model, in their order; `Dims.inputs` and `Dims.outputs` have the shapes."""


@dataclass(frozen=True)
class Coordinate:
    """One joint of a branch."""

    joint: str
    """Its name in the model."""
    axis: Vector
    """(3) unit, H, at q = 0; positive turns follow the right hand."""
    anchor_m: Vector
    """(3) a point on the axis, H, at q = 0."""
    low_rad: float
    high_rad: float
    spring_Nm_rad: float
    """Of the joint itself."""
    servo_Nm_rad: float
    """Position gain of its actuator, or of what the hand file states; 0 where none holds it."""
    reference_rad: float = 0.0
    """Where its spring is relaxed."""

    @property
    def stiffness_Nm_rad(self) -> float:
        """Spring and servo together."""
        return self.spring_Nm_rad + self.servo_Nm_rad


@dataclass(frozen=True)
class Tendon:
    """A tendon of one branch."""

    name: str
    arm_m: Vector
    """(C) flexing torque of each coordinate for a tension of 1 N."""
    stiffness_N_m: float
    pull_only: bool
    max_tension_N: float
    """0 where the model states none."""


@dataclass(frozen=True)
class Coupling:
    """A spring between coordinates of one branch: energy 1/2 k (ratio . dq)^2."""

    name: str
    ratio: Vector
    """(C)"""
    stiffness_Nm_rad: float


@dataclass(frozen=True)
class Branch:
    """A finger or a thumb: a serial chain of joints from the palm to a fingertip."""

    name: str
    group: str
    """Branches of one group face those of the others."""
    coordinates: tuple[Coordinate, ...]
    tendons: tuple[Tendon, ...]
    couplings: tuple[Coupling, ...]
    tip: str
    """Body that touches the tool."""
    tip_point_m: Vector
    """(3) pad point of the tip, H, at q = 0."""
    eps_m: float
    """Nominal compliance of its contact, m/N."""
    tip_radius_m: float = 0.0
    """Of a round tip; 0 for another shape."""

    @property
    def gated_tendon(self) -> int | None:
        """The pull-only tendon that loads slacken first, which is the one with the least arm about the last joint."""
        loose = [i for i, t in enumerate(self.tendons) if t.pull_only]
        return min(loose, key=lambda i: abs(self.tendons[i].arm_m[-1])) if loose else None

    def stiffness(self, taut: Sequence[bool] | None = None) -> Array:
        """K_b (C, C), N.m/rad: springs, servos, couplings, and the tendons that are taut (default: all)."""
        k = np.diag([c.stiffness_Nm_rad for c in self.coordinates])
        for coupling in self.couplings:
            k = k + coupling.stiffness_Nm_rad * np.outer(coupling.ratio, coupling.ratio)
        for i, tendon in enumerate(self.tendons):
            if taut is None or taut[i]:
                k = k + tendon.stiffness_N_m * np.outer(tendon.arm_m, tendon.arm_m)
        return k

    def pose(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """At branch angles q (..., C): axes (..., C, 3), anchors (..., C, 3) m, and the tip's motion from q = 0.

        The motion is R (..., 3, 3), p (..., 3): a point x that the tip holds at q = 0 is at R x + p. All in H.
        """
        turn, origin, (axes, anchors) = np.eye(3), np.zeros(3), np.empty((2, *q.shape, 3))
        for c, coordinate in enumerate(self.coordinates):
            axes[..., c, :] = turn @ coordinate.axis
            anchors[..., c, :] = anchor = origin + turn @ coordinate.anchor_m
            step = rotation(axes[..., c, :] * q[..., c, None])
            origin, turn = anchor + times(step, origin - anchor), step @ turn
        return axes, anchors, turn, origin

    def jacobian(self, q: Array, point: Array | None = None) -> Array:
        """B_b (..., 3, C), m/rad: velocity of a point (..., 3), H, that the tip holds, at branch angles q (..., C).

        Without a point that of the pad point.
        """
        axes, anchors, turn, origin = self.pose(q)
        at = origin + times(turn, np.array(self.tip_point_m)) if point is None else point
        return np.cross(axes, at[..., None, :] - anchors).swapaxes(-1, -2)

    def moved(self, q: Array, point: Array) -> Array:
        """Where a point (..., 3), H, that the tip holds at q = 0 is at branch angles q (..., C)."""
        _, _, turn, origin = self.pose(q)
        return origin + times(turn, point)


def rotation(turn: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    unit, angle = turn / np.where(angle > 0, angle, 1.0), angle[..., None]
    k = np.zeros((*turn.shape, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        k[..., c, b], k[..., b, c] = unit[..., a], -unit[..., a]
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def times(matrix: Array, vector: Array) -> Array:
    """Matrices (..., 3, 3) times vectors (..., 3)."""
    return (matrix @ vector[..., None])[..., 0]


@dataclass(frozen=True)
class Dims:
    """Every count that follows from a hand.

    B branches, C coordinates (of the longest branch), J joints, T tendons, G branches with a gated tendon.
    A shorter branch lacks the coordinates next to the palm: its own are the last columns.
    """

    branches: int
    coordinates: int
    joints: int
    tendons: int
    gates: int
    twist: bool = False
    """Of an exported model: its head gives how much each contact resists twisting, of soft fingertips."""
    factors: int = 0
    """Of a told model: how many factors of theta its networks see; 0 in one that sees none."""
    stiff: int = 0
    """Of an exported model: how many of theta's factors are on springs, servos and tendons."""
    sensing: int = 0
    """Of a model with optional sensors: how many numbers of them its networks see (`sensed`); 0 in one without."""
    slides: bool = False
    """Of a model whose contacts may slide: its head gives each contact's friction and preload."""

    @property
    def state(self) -> int:
        """Numbers of q, x_ht, w_e, contacts."""
        return self.joints + 2 * N_WRENCH + self.branches * N_CONTACT_FEATURE

    @property
    def input(self) -> int:
        """Numbers of all inputs of a model."""
        return sum(math.prod(shape) for shape in self.inputs.values())

    @property
    def output(self) -> int:
        """Numbers of all outputs of a model."""
        return sum(math.prod(shape) for shape in self.outputs.values())

    @property
    def branch_feature(self) -> int:
        """What the contact network sees of a branch: its contact row and its block of j_q."""
        return N_CONTACT_FEATURE + 3 * self.coordinates

    @property
    def contact_input(self) -> int:
        """Of all branches."""
        return self.branches * self.branch_feature

    @property
    def global_input(self) -> int:
        """q, x_ht, w_e, w_e in signed logarithm; theta's factors in a told model; sensors in one that has them."""
        return self.joints + 3 * N_WRENCH + self.factors + self.sensing

    @property
    def cholesky_entries(self) -> tuple[tuple[int, int], ...]:
        """(row, column) of each number of a branch's packed Cholesky factor: the diagonal, then row by row below it."""
        c = range(self.coordinates)
        return (*((i, i) for i in c), *((i, j) for i in c for j in range(i)))

    @property
    def cholesky(self) -> int:
        """Numbers of a branch's packed Cholesky factor."""
        return len(self.cholesky_entries)

    @property
    def head_parts(self) -> dict[str, slice]:
        """Where each correction stands that the mechanics head gives for a branch. Tables, files and models follow it.

        Without gates and twist it gives the Cholesky factor alone.
        """
        c = self.coordinates
        sizes = {"diagonal": c, "below": self.cholesky - c}
        if self.gates:
            sizes |= {"direction": c, "gain": 1, "alpha": 1, "beta": 1, "rho": 1}
        if self.twist:
            sizes |= {"twist": 1}
        if self.slides:
            sizes |= {"friction": 1, "preload": 3}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        return {name: slice(a, b) for name, (a, b) in zip(sizes, pairwise(ends), strict=True)}

    @property
    def branch_head(self) -> int:
        """Corrections that the mechanics head gives for a branch."""
        return max(part.stop for part in self.head_parts.values())

    @property
    def head(self) -> int:
        """Of all branches."""
        return self.branches * self.branch_head

    @property
    def aux(self) -> int:
        """What stage 1's classifier sees of the statics: motion, diagonal of K_x; gates if any; of contacts that slide
        their use of friction, how far they softened, their normal force."""
        return 2 * N_WRENCH + (self.branches if self.gates else 0) + self.slid

    @property
    def sure(self) -> int:
        """What p_slide and bound_95 follow from beside stage 2's feature: size of the motion; contacts that slide."""
        return 1 + self.slid

    @property
    def slid(self) -> int:
        """Numbers on how contacts slide, if they can: use of friction, softening, normal force of each."""
        return 3 * self.branches if self.slides else 0

    @property
    def inputs(self) -> dict[str, tuple[int, ...]]:
        """Shape of each input of a model, without the batch."""
        b, c = self.branches, self.coordinates
        return {
            "q": (self.joints,),
            "x_ht": (N_WRENCH,),
            "w_e": (N_WRENCH,),
            "contacts": (b, N_CONTACT_FEATURE),
            "j_x": (b, 3, N_WRENCH),
            "j_q": (b, 3, c),
        }

    @property
    def sensors(self) -> dict[str, tuple[int, ...]]:
        """Shape of each optional sensor, without the batch: whether it is known, then its values (`sensors.py`)."""
        found: dict[str, tuple[int, ...]] = {"friction": (3,), "tool_weight": (4,)}
        return found | ({"tendon_tension": (1 + self.tendons,)} if self.tendons else {})

    @property
    def sensed(self) -> int:
        """What networks see of the sensors: trust and logarithm of friction, known and values of the others."""
        return sum(math.prod(shape) for shape in self.sensors.values()) - 1

    @property
    def outputs(self) -> dict[str, tuple[int, ...]]:
        """Shape of each output of a model, without the batch. Without tendons `gate` is 0, and `friction_use` where
        contacts cannot slide."""
        b = self.branches
        shapes: tuple[tuple[int, ...], ...] = ((), (N_WRENCH,), (N_WRENCH, N_WRENCH), (b,), (), (), (b,))
        return dict(zip(OUTPUTS, shapes, strict=True))

    @property
    def debug(self) -> dict[str, tuple[int, ...]]:
        """Shape of each intermediate value of a stage, without the batch. Without tendons those of tendons are 0, and
        those of friction where contacts cannot slide."""
        b, c = self.branches, self.coordinates
        return {
            "k_spring": (b, c, c),
            "tendon_dir": (b, c),
            "tendon_gain": (b,),
            "gate_params": (b, N_GATE),
            "friction": (b,),
            "preload": (b, 3),
            "slide": (b,),
            "dx0": (N_WRENCH,),
            "dq0": (b, c),
            "dx": (N_WRENCH,),
            "k_x": (N_WRENCH, N_WRENCH),
            "gate": (b,),
        }


@dataclass(frozen=True)
class Mirror:
    """A plane through H's origin that carries the hand onto itself."""

    normal: Vector
    """(3) unit, H."""
    branches: tuple[int, ...]
    """(B) branch that each branch is the image of."""


@dataclass(frozen=True)
class Synergy:
    """Synergy space psi = ((q - neutral) A) * delta that postures are drawn from; S axes, 1 to 3."""

    axes: tuple[str, ...]
    """(S) names."""
    neutral_rad: Vector
    """(J)"""
    columns: tuple[Vector, ...]
    """(S, J) columns of A, orthogonal to each other."""
    delta: Vector
    """(S) 1/rad."""
    ranges: tuple[Vector, ...]
    """(S, 2) of psi that is sampled."""

    def psi(self, q: Array) -> Array:
        """Synergy coordinates (S) of joint angles q (J)."""
        return np.asarray((np.array(self.columns) @ (q - self.neutral_rad)) * self.delta)

    def posture(self, psi: Array) -> Array:
        """The joint angles (J) of psi (S) that are nearest to the neutral ones; psi(posture(x)) = x."""
        a = np.array(self.columns)
        return np.asarray(np.array(self.neutral_rad) + a.T @ np.linalg.solve(a @ a.T, psi / np.array(self.delta)))


@dataclass(frozen=True)
class ContactModel:
    """What a fingertip passes on to the tool."""

    kind: str = "point"
    """`point`: a force. `soft_finger`: and a moment about the normal."""
    torsional_friction_m: float = 0.0
    """Greatest moment of a soft finger over its normal force."""


@dataclass(frozen=True)
class Hand:
    """A hand."""

    name: str
    branches: tuple[Branch, ...]
    palm_normal: Vector
    """(3) unit, H: which way the palm faces."""
    tool_axis: Vector = (1.0, 0.0, 0.0)
    """(3) unit, H: along which the long axis of a tool lies, but for what the pinch turns it by."""
    length_m: float = LENGTH_M
    """Characteristic length: what a rotation of 1 rad counts as, in the 6x6 solve and in every pose error."""
    contact: ContactModel = ContactModel()
    synergy: Synergy | None = None
    mirror: Mirror | None = None
    """None where the hand is not its own mirror image."""

    def __post_init__(self) -> None:
        """Raises AminnError for what the method cannot hold."""
        n = len(self.branches)
        if not MIN_BRANCHES <= n <= MAX_BRANCHES:
            raise AminnError(f"hand {self.name}: {n} branches; {MIN_BRANCHES} to {MAX_BRANCHES} are supported")
        owner: dict[str, str] = {}
        names = [branch.name for branch in self.branches]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise AminnError(f"hand {self.name}: branches: two are called {twice[0]}; give each its own name")
        for branch in self.branches:
            if not 1 <= len(branch.coordinates) <= MAX_COORDINATES:
                found = f"{len(branch.coordinates)} joints"
                raise AminnError(
                    f"hand {self.name}: branch {branch.name} has {found}; 1 to {MAX_COORDINATES} are supported"
                )
            for c in branch.coordinates:
                if c.joint in owner:
                    raise AminnError(
                        f"hand {self.name}: joint {c.joint} moves both {owner[c.joint]} and {branch.name}; branches "
                        "that share a joint have no stiffness of their own: lock it, or leave one of them out"
                    )
                owner[c.joint] = branch.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names in the order of q: branch by branch, from the palm outwards."""
        return tuple(c.joint for branch in self.branches for c in branch.coordinates)

    @cached_property
    def branch_joints(self) -> tuple[slice, ...]:
        """Where each branch's angles stand in q."""
        ends = np.cumsum([0, *(len(b.coordinates) for b in self.branches)]).tolist()
        return tuple(slice(a, b) for a, b in pairwise(ends))

    @cached_property
    def dims(self) -> Dims:
        """Counts and shapes."""
        return Dims(
            len(self.branches),
            max(len(b.coordinates) for b in self.branches),
            len(self.joints),
            sum(len(b.tendons) for b in self.branches),
            sum(b.gated_tendon is not None for b in self.branches),
        )

    @cached_property
    def sides(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The branches that a pinch is between: the smallest group (of equal ones the last) second, all others first.

        Empty second side where all branches are of one group.
        """
        groups = [b.group for b in self.branches]
        named = list(dict.fromkeys(groups))
        thumb = min(reversed(named), key=groups.count)
        second = tuple(b for b, g in enumerate(groups) if g == thumb) if len(named) > 1 else ()
        return tuple(b for b in range(len(groups)) if b not in second), second

    def tips(self, q: Array) -> Array:
        """Pad points (..., B, 3), m, H, at joint angles q (..., J)."""
        own = zip(self.branches, self.branch_joints, strict=True)
        return np.stack([b.moved(q[..., at], np.array(b.tip_point_m)) for b, at in own], -2)

    def gap(self, q: Array) -> float:
        """Distance, m, between the middles of both sides' pad points at joint angles q (J)."""
        tips, (first, second) = self.tips(q), self.sides
        return float(np.linalg.norm(tips[list(first)].mean(0) - tips[list(second)].mean(0)))

    def coupled(self, q: Array) -> Array:
        """The joint angles (..., J) nearest to q at which the couplings are at rest."""
        q = q.copy()
        for branch, at in zip(self.branches, self.branch_joints, strict=True):
            for coupling in branch.couplings:
                ratio = np.array(coupling.ratio)
                along = (ratio[None] @ q[..., at, None])[..., 0]  # one product a row, so that the bits are those of one
                q[..., at] = q[..., at] - ratio * along / (ratio @ ratio)
        return q

    @cached_property
    def coordinate_joints(self) -> tuple[tuple[int, ...], ...]:
        """(B, C) index into q of each coordinate; -1 where a branch lacks it, which is next to the palm."""
        c = self.dims.coordinates
        return tuple((-1,) * (c - s.stop + s.start) + tuple(range(s.start, s.stop)) for s in self.branch_joints)

    @cached_property
    def coordinate_mask(self) -> Array:
        """(B, C) 1 where a branch has the coordinate, else 0."""
        return (np.array(self.coordinate_joints) >= 0).astype(float)

    def as_dict(self) -> dict[str, Any]:
        """What JSON can hold; `from_dict` reads it back without loss."""
        return asdict(self)

    @property
    def sha256(self) -> str:
        """Identity of the description."""
        return hashlib.sha256(json.dumps(self.as_dict(), sort_keys=True).encode()).hexdigest()

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> Hand:
        """Read what `as_dict` gave. Raises AminnError that names what is missing, or what cannot be."""
        try:
            hand = _HAND.validate_python(value)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise AminnError(f"not the description of a hand: {where}: {first['msg']}") from error
        for place, fault in _faults(hand):
            raise AminnError(f"not the description of a hand: {place}: {fault}")
        return hand


_HAND = TypeAdapter(Hand)


def _faults(hand: Hand) -> Iterator[tuple[str, str]]:
    """(place, what is wrong) of numbers that a hand cannot have."""

    def vector(place: str, values: Sequence[float], n: int, unit: bool = False) -> Iterator[tuple[str, str]]:
        if len(values) != n:
            yield place, f"has {len(values)} numbers, expected {n}"
        elif not np.isfinite(values).all():
            yield place, "is not finite"
        elif unit and abs(math.hypot(*values) - 1) > UNIT_SLACK:
            yield place, f"has length {math.hypot(*values):.3g}, expected 1"

    def number(place: str, value: float, least: float) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(value) and value >= least):
            yield place, f"is {value}, expected {'a positive number' if least > 0 else 'a number of 0 or more'}"

    for b, branch in enumerate(hand.branches):
        own, n = f"branches.{b}", len(branch.coordinates)
        yield from vector(f"{own}.tip_point_m", branch.tip_point_m, 3)
        yield from number(f"{own}.eps_m", branch.eps_m, sys.float_info.min)
        yield from number(f"{own}.tip_radius_m", branch.tip_radius_m, 0)
        for i, c in enumerate(branch.coordinates):
            place = f"{own}.coordinates.{i}"
            yield from vector(f"{place}.axis", c.axis, 3, unit=True)
            yield from vector(f"{place}.anchor_m", c.anchor_m, 3)
            yield from vector(f"{place}.limits", (c.low_rad, c.high_rad, c.reference_rad), 3)
            if c.low_rad > c.high_rad:
                yield f"{place}.high_rad", f"is {c.high_rad}, less than low_rad"
            yield from number(f"{place}.spring_Nm_rad", c.spring_Nm_rad, 0)
            yield from number(f"{place}.servo_Nm_rad", c.servo_Nm_rad, 0)
        for i, tendon in enumerate(branch.tendons):
            yield from vector(f"{own}.tendons.{i}.arm_m", tendon.arm_m, n)
            yield from number(f"{own}.tendons.{i}.stiffness_N_m", tendon.stiffness_N_m, 0)
        for i, coupling in enumerate(branch.couplings):
            yield from vector(f"{own}.couplings.{i}.ratio", coupling.ratio, n)
            yield from number(f"{own}.couplings.{i}.stiffness_Nm_rad", coupling.stiffness_Nm_rad, 0)
    yield from vector("palm_normal", hand.palm_normal, 3, unit=True)
    yield from vector("tool_axis", hand.tool_axis, 3, unit=True)
    yield from number("length_m", hand.length_m, sys.float_info.min)
    if hand.mirror is not None:
        yield from vector("mirror.normal", hand.mirror.normal, 3, unit=True)
        if sorted(hand.mirror.branches) != list(range(len(hand.branches))):
            yield (
                "mirror.branches",
                f"is {list(hand.mirror.branches)}, expected each of {len(hand.branches)} branches once",
            )
