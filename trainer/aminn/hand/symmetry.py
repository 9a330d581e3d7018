"""Mirror images of grasps: what the hand's own symmetry says of a load case, said of its mirror image.

The plane of `hand.mirror` carries each branch onto one of the hand's. Polar vectors (positions, forces) are reflected
in it, axial ones (rotations, moments) reflected and reversed; joint angles stay, since an axis that is mirrored and
reversed turns the mirrored finger the same way. Parameters theta go to the parameters of the image's parts.
"""

from __future__ import annotations

from functools import cached_property
from itertools import accumulate

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import N_WRENCH
from aminn_hand.sensors import FRICTION, TENDON_TENSION, TOOL_WEIGHT
from aminn_hand.theta import Theta

from .nominal import nominal_of, stiffness_terms

Array = NDArray[np.float64]


class Reflection:
    """The mirror image of a symmetric hand's load cases. Raises AminnError for a hand that is not symmetric."""

    def __init__(self, hand: Hand) -> None:
        if hand.mirror is None:
            raise AminnError(
                f"hand {hand.name} has no mirror symmetry that its load cases could be shown in; leave mirror out"
            )
        _check(hand)
        self.hand = hand
        n = np.array(hand.mirror.normal)
        self.polar: Array = np.eye(3) - 2 * np.outer(n, n)
        """(3, 3)"""
        self.axial: Array = -self.polar
        """(3, 3)"""
        self.branches = list(hand.mirror.branches)
        """(B) branch that each branch is the image of."""
        self.joints = [j for b in self.branches for j in range(len(hand.joints))[hand.branch_joints[b]]]
        """(J) joint that each joint is the image of."""

    @cached_property
    def parameters(self) -> list[int]:
        """(P) parameter of theta that each one is the image of.

        Raises AminnError where the image of a hand with some theta is no hand with another theta.
        """
        theta, terms = Theta(self.hand), stiffness_terms(self.hand)
        image: list[int] = []
        for p, parameter in enumerate(theta.parameters[: theta.stiff]):
            same = [
                r
                for r, other in enumerate(theta.parameters[: theta.stiff])
                if r not in image
                and other.kind == parameter.kind
                and np.allclose(terms[1 + p], terms[1 + r, self.branches], rtol=1e-5, atol=1e-9)
            ]
            if not same:
                raise AminnError(
                    f"hand {self.hand.name}: the parts of {parameter.name} have no mirror images that vary together "
                    "with each other alone; train with --set mirror=false"
                )
            image.append(p if p in same else same[0])
        image += [theta.stiff + b for b in self.branches]
        return [*image, *(theta.factors + j for j in self.joints), len(theta) - 1]

    @cached_property
    def tendons(self) -> list[int]:
        """(T) tendon that each tendon is the image of. Raises AminnError where one has none in the image's branch."""
        starts = list(accumulate((len(b.tendons) for b in self.hand.branches), initial=0))
        image: list[int] = []
        for branch, b in zip(self.hand.branches, self.branches, strict=True):
            for tendon in branch.tendons:
                same = [
                    starts[b] + i
                    for i, other in enumerate(self.hand.branches[b].tendons)
                    if starts[b] + i not in image
                    and other.pull_only == tendon.pull_only
                    and np.allclose([*other.arm_m, other.stiffness_N_m], [*tendon.arm_m, tendon.stiffness_N_m], 1e-5)
                ]
                if not same:
                    raise AminnError(
                        f"hand {self.hand.name}: tendon {tendon.name} has no mirror image whose tension could be told; "
                        "train with --set mirror=false"
                    )
                image.append(same[0])
        return image

    def _polar(self, v: Tensor) -> Tensor:
        return _reflected(v, self.polar)

    def _axial(self, v: Tensor) -> Tensor:
        return _reflected(v, self.axial)

    def motion(self, v: Tensor) -> Tensor:
        """Images of motions, poses or wrenches (..., 6)."""
        return torch.cat([self._polar(v[..., :3]), self._axial(v[..., 3:])], -1)

    def inputs(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        """Images of inputs, shapes as in `Dims.inputs` after the batch; theta (n, P) and sensors if they are there."""
        touch, position, normal, force = x["contacts"].split([1, 3, 3, 1], -1)
        contacts = torch.cat([touch, self._polar(position), self._polar(normal), force], -1)
        rows_x, rows_q = (self._polar(x[name].transpose(-1, -2)).transpose(-1, -2) for name in ("j_x", "j_q"))
        more = {"theta": x["theta"][:, self.parameters]} if "theta" in x else {}
        more |= self._sensors(x)
        return more | {
            "q": x["q"][:, self.joints],
            "x_ht": self.motion(x["x_ht"]),
            "w_e": self.motion(x["w_e"]),
            "contacts": contacts[:, self.branches],
            "j_x": self.motion(rows_x)[:, self.branches].contiguous(),
            "j_q": rows_q[:, self.branches].contiguous(),
        }

    def _sensors(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        """Images of the sensors that are there; what is known and what is not stays so."""
        found = {FRICTION: x[FRICTION]} if FRICTION in x else {}
        if TOOL_WEIGHT in x:
            known, weight = x[TOOL_WEIGHT].split([1, 3], -1)
            found[TOOL_WEIGHT] = torch.cat([known, self._polar(weight)], -1)
        if TENDON_TENSION in x:
            found[TENDON_TENSION] = x[TENDON_TENSION][:, [0, *(1 + t for t in self.tendons)]]
        return found

    def targets(self, y: Tensor) -> Tensor:
        """Images of a stage's targets: stability (n) stays, motion and tendons (n, 6 or 6 + B) do not."""
        if y.ndim == 1:
            return y
        dx, taut = y[..., :N_WRENCH], y[..., N_WRENCH:]
        return torch.cat([self.motion(dx), taut[:, self.branches] if taut.shape[1] else taut], -1)


def _reflected(v: Tensor, matrix: Array) -> Tensor:
    """Vectors (..., 3) times a reflection; one along the axes of H changes signs and no more."""
    signs = np.diag(matrix)
    if np.array_equal(matrix, np.diag(signs)):
        return v * v.new_tensor(signs.tolist())
    return v @ v.new_tensor(matrix).T


def _check(hand: Hand) -> None:
    """Raises AminnError unless the hand is its own image in the plane that it names."""
    assert hand.mirror is not None
    swap, n = list(hand.mirror.branches), np.array(hand.mirror.normal)
    if sorted(swap) != list(range(len(hand.branches))) or abs(n @ n - 1) > 1e-6:
        raise AminnError(f"hand {hand.name}: mirror is no plane with an image for each branch; simulate again")
    nominal, polar = nominal_of(hand), np.eye(3) - 2 * np.outer(n, n)
    shift = np.cross(nominal.axis, nominal.anchor)  # of an axis from H's origin, whatever its anchor
    images = {
        "coordinates": (nominal.coord_mask, nominal.coord_mask[swap]),
        "axis": (nominal.axis, -nominal.axis[swap] @ polar),
        "anchor": (shift, shift[swap] @ polar),
        "springs": (nominal.chol, nominal.chol[swap]),
        "tendons": (nominal.tendon_dir, nominal.tendon_dir[swap]),
        "tendon stiffness": (nominal.tendon_gain, nominal.tendon_gain[swap]),
        "contact compliance": (nominal.eps_m, nominal.eps_m[swap]),
    }
    for name, (value, image) in images.items():
        if not np.allclose(value, image, rtol=1e-5, atol=1e-7):
            b = int(np.argmax(np.abs(value - image).reshape(len(swap), -1).max(1)))
            one, other = hand.branches[b].name, hand.branches[swap[b]].name
            raise AminnError(
                f"hand {hand.name}, {name}: {one} is not the mirror image of {other}; train with --set mirror=false"
            )
