"""A hand's mechanics parameters theta: by how much one hand differs from its description. Zero is nominal.

theta (P) holds, in this order: logarithms of factors on joint springs, servos and tendons; on each branch's contact
compliance; offsets of joint zeros, rad (true angle minus measured one); the tips' radius beyond the stated one, m.
Like parts share a parameter: of one kind, in branches of one group, at the same place of the branch, with the same
nominal value.

The first `Theta.factors` change the mechanics. The rest says how a measured state is to be read (`corrected`), so that
neither formula nor network needs it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .hand import Array, Branch, Hand

KINDS = ("spring", "servo", "tendon", "contact", "zero", "radius")
UNITS = {"zero": "rad", "radius": "m"}
"""Of a parameter; those of other kinds are logarithms of factors."""
MAX_LOG_FACTOR, MAX_ZERO_RAD, MAX_RADIUS_M = 3.0, 1.0, 0.05
"""Bounds of theta, either way: those of aminn_rt.h, and of what is simulated."""


@dataclass(frozen=True)
class Parameter:
    """One number of theta."""

    name: str
    """Kind and first part, for instance `spring_finger1_proximal`; a table's column is `theta_` and this."""
    kind: str
    """One of `KINDS`."""
    parts: tuple[str, ...]
    """Joints, tendons or branches that share it."""

    @property
    def unit(self) -> str:
        """`rad`, `m`, or `1` for the logarithm of a factor."""
        return UNITS.get(self.kind, "1")


def _stiff_parts(branch: Branch) -> Iterator[tuple[str, str, int, float]]:
    """(kind, name, place from the tip, nominal stiffness) of each spring, servo and tendon of a branch."""
    n = len(branch.coordinates)
    for i, c in enumerate(branch.coordinates):
        yield "spring", c.joint, n - i, c.spring_Nm_rad
        yield "servo", c.joint, n - i, c.servo_Nm_rad
    for i, tendon in enumerate(branch.tendons):
        yield "tendon", tendon.name, i, tendon.stiffness_N_m


@dataclass(frozen=True)
class Theta:
    """The mechanics parameters of a hand."""

    hand: Hand

    @cached_property
    def _shared(self) -> dict[tuple[str, str, int, float], list[str]]:
        """Parts by what makes them alike."""
        found: dict[tuple[str, str, int, float], list[str]] = {}
        for branch in self.hand.branches:
            for kind, name, place, value in _stiff_parts(branch):
                if value > 0:
                    found.setdefault((kind, branch.group, place, value), []).append(name)
        return dict(sorted(found.items(), key=lambda item: KINDS.index(item[0][0])))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """(P) in the order of theta."""
        stiff = [Parameter(f"{key[0]}_{parts[0]}", key[0], tuple(parts)) for key, parts in self._shared.items()]
        contacts = [Parameter(f"contact_{b.name}", "contact", (b.name,)) for b in self.hand.branches]
        zeros = [Parameter(f"zero_{joint}", "zero", (joint,)) for joint in self.hand.joints]
        radius = Parameter("radius_tips", "radius", tuple(b.name for b in self.hand.branches))
        return (*stiff, *contacts, *zeros, radius)

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """(P) names."""
        return tuple(p.name for p in self.parameters)

    @property
    def stiff(self) -> int:
        """How many are factors on springs, servos and tendons; they stand first."""
        return len(self._shared)

    @property
    def factors(self) -> int:
        """How many are factors, contact compliances included; they stand first."""
        return self.stiff + len(self.hand.branches)

    @property
    def zeros(self) -> slice:
        """Where the offsets of the joint zeros stand, rad, in the order of q."""
        return slice(self.factors, self.factors + len(self.hand.joints))

    @cached_property
    def index(self) -> dict[tuple[str, str], int]:
        """Place in theta of each (kind, part) that it acts on."""
        return {(p.kind, part): i for i, p in enumerate(self.parameters) for part in p.parts}

    def varied(self, theta: Array) -> Hand:
        """The hand with the mechanics of theta (P)."""
        factor, at = np.exp(np.asarray(theta, float)), self.index

        def times(value: float, kind: str, part: str) -> float:
            return float(value * factor[at[kind, part]]) if (kind, part) in at else value

        branches = [
            replace(
                b,
                coordinates=tuple(
                    replace(
                        c,
                        spring_Nm_rad=times(c.spring_Nm_rad, "spring", c.joint),
                        servo_Nm_rad=times(c.servo_Nm_rad, "servo", c.joint),
                    )
                    for c in b.coordinates
                ),
                tendons=tuple(replace(t, stiffness_N_m=times(t.stiffness_N_m, "tendon", t.name)) for t in b.tendons),
                eps_m=times(b.eps_m, "contact", b.name),
            )
            for b in self.hand.branches
        ]
        return replace(self.hand, branches=tuple(branches))

    def corrected(self, theta: Array, q: Array, contacts: Array) -> tuple[Array, Array]:
        """Joint angles (..., J) and contacts (..., B, 8) as they are, of measured ones; theta is (P) or (..., P).

        A contact that is found from the fingertip's centre lies further out along its normal if the tip is larger.
        """
        theta = np.asarray(theta, float)
        moved = contacts.copy()
        moved[..., 1:4] += theta[..., -1, None, None] * contacts[..., 4:7]
        return q + theta[..., self.zeros], moved


def theta_bounds(size: int, joints: int) -> NDArray[np.float32]:
    """(P) largest size of each number of theta: factors, joint zeros, radius."""
    bounds = np.full(size, MAX_LOG_FACTOR, np.float32)
    if size:
        bounds[size - 1 - joints : -1], bounds[-1] = MAX_ZERO_RAD, MAX_RADIUS_M
    return bounds
