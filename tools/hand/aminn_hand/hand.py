"""A hand: branches (serial chains from the palm), their joints, springs, tendons and contacts. SI, palm frame H.

Everything is stated at q = 0. Column c of a branch's closure block B_b is z_c x (contact - anchor_c), with each
coordinate's own axis and anchor, turned by the coordinates before it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError

Array = NDArray[np.float64]
Vector = tuple[float, ...]

MIN_BRANCHES, MAX_BRANCHES = 2, 5
MAX_COORDINATES = 5
N_WRENCH = 6
N_CONTACT_FEATURE = 8
"""In contact, position (3), normal (3), normal force."""


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
        """At branch angles q (C): axes (C, 3), anchors (C, 3) m, and the tip's motion from q = 0: R (3, 3), p (3).

        A point x that the tip holds at q = 0 is at R x + p. All in H.
        """
        turn, origin, axes, anchors = np.eye(3), np.zeros(3), [], []
        for angle, coordinate in zip(q, self.coordinates, strict=True):
            axis, anchor = turn @ coordinate.axis, origin + turn @ coordinate.anchor_m
            axes.append(axis)
            anchors.append(anchor)
            step = rotation(axis * angle)
            origin, turn = anchor + step @ (origin - anchor), step @ turn
        return np.array(axes), np.array(anchors), turn, origin

    def jacobian(self, q: Array, point: Array) -> Array:
        """B_b (3, C), m/rad: velocity of a point (3), H, that the tip holds, at branch angles q (C)."""
        axes, anchors, _, _ = self.pose(q)
        return np.cross(axes, point - anchors).T

    def moved(self, q: Array, point: Array) -> Array:
        """Where a point (3), H, that the tip holds at q = 0 is at branch angles q (C)."""
        _, _, turn, origin = self.pose(q)
        return np.asarray(origin + turn @ point)


def rotation(turn: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3)."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return np.eye(3)
    x, y, z = turn / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@dataclass(frozen=True)
class Dims:
    """Every count that follows from a hand. B branches, C coordinates (of the longest branch), J joints, T tendons."""

    branches: int
    coordinates: int
    joints: int
    tendons: int

    @cached_property
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

    @cached_property
    def outputs(self) -> dict[str, tuple[int, ...]]:
        """Shape of each output of a model, without the batch."""
        return {"p_stable": (), "dx_ht": (N_WRENCH,), "k_x": (N_WRENCH, N_WRENCH), "gate": (self.branches,)}


@dataclass(frozen=True)
class Hand:
    """A hand."""

    name: str
    branches: tuple[Branch, ...]
    palm_normal: Vector
    """(3) unit, H: which way the palm faces."""

    def __post_init__(self) -> None:
        """Raises AminnError for what the method cannot hold."""
        n = len(self.branches)
        if not MIN_BRANCHES <= n <= MAX_BRANCHES:
            raise AminnError(f"hand {self.name}: {n} branches; {MIN_BRANCHES} to {MAX_BRANCHES} are supported")
        owner: dict[str, str] = {}
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
        )

    def as_dict(self) -> dict[str, Any]:
        """What JSON can hold; `from_dict` reads it back without loss."""
        return asdict(self)

    @property
    def sha256(self) -> str:
        """Identity of the description."""
        return hashlib.sha256(json.dumps(self.as_dict(), sort_keys=True).encode()).hexdigest()

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> Hand:
        """Read what `as_dict` gave. Raises AminnError that names what is missing."""
        try:
            return Hand(
                str(value["name"]),
                tuple(
                    Branch(
                        **{
                            k: v
                            for k, v in b.items()
                            if k not in ("coordinates", "tendons", "couplings", "tip_point_m")
                        },
                        coordinates=tuple(
                            Coordinate(**{**c, "axis": tuple(c["axis"]), "anchor_m": tuple(c["anchor_m"])})
                            for c in b["coordinates"]
                        ),
                        tendons=tuple(Tendon(**{**t, "arm_m": tuple(t["arm_m"])}) for t in b["tendons"]),
                        couplings=tuple(Coupling(**{**s, "ratio": tuple(s["ratio"])}) for s in b["couplings"]),
                        tip_point_m=tuple(b["tip_point_m"]),
                    )
                    for b in value["branches"]
                ),
                tuple(value["palm_normal"]),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise AminnError(f"not the description of a hand: {error}") from error
