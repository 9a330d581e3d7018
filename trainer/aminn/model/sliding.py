"""Contacts that slide: how much each gives along its tangent plane once the load has used up its friction.

A contact that is pressed with N and carries the tangential force T0 before the load holds |T0 - t| <= mu N (Coulomb),
t what the load adds. Where that is exceeded the contact gets a tangential compliance s (m/N) of its own, in series
with its finger's: M_b + s (I - n n^T). s is found by secant steps, each on the forces that the last one left: the
largest share beta of t that friction bears says by how much the contact must give. s >= 0, so K_x stays positive
definite and w.dx >= 0, whatever mu and T0 are.

All of it happens among 2 B tangential numbers. E is the stiffness that slides meet when the tool is free to follow:

    (I + E S) t = t0,   slides S t,   normal forces n0 - F S t,   S = diag(s)

The steps start from the compliance c that the finger alone has, of which the tool's is left out: they come to less than
the whole slide. Models that are trained with these damped steps err less than with the compliance that a slide meets,
2 / trace(E_bb), which is all but exact after two.
The batch stands last, (..., B, N), as in the layer; lengths are metres, forces newtons, axes those of the hand.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from .batched import differentiable_inverse, inverse, product, times

AXES = 3
"""Of space."""
SLIDE_STEPS = 3
MOST_COMPLIANCE = 5e-3
"""m/N: a contact that gives more than this holds nothing."""
LEAST_PRESSURE_N = 0.01
"""Normal force below which a contact is taken for as good as lost."""
LEAST_RESERVE = 0.1
"""Share of mu N that a contact is believed to have left, whatever T0 is said to use of it."""
MOST_USE = 100.0
PRELOAD_N, FORCE_N, MOMENT_NM = 0.7, 0.3, 0.008
"""Standard deviations: of tangential forces before the load, and of what statics leaves of force and moment."""


class Grip(NamedTuple):
    """What is known and believed of the contacts before the load."""

    friction: Tensor  # (B, N) mu
    preload: Tensor  # (3, B, N) T0, N, tangential; 0 out of contact
    normal: Tensor  # (3, B, N)
    force: Tensor  # (B, N) N0, N


class Slide(NamedTuple):
    """What the load does to the contacts."""

    compliance: Tensor  # (B, N) s, m/N
    use: Tensor  # (B, N) |T0 - t| / (mu N) if no contact slid; 0 out of contact
    share: Tensor  # (B, N) s / c
    pressed: Tensor  # (B, N) N if no contact slid


def tangents(normal: Tensor) -> Tensor:
    """Two unit vectors across each normal (3, B, N), and the normal itself: (3 vectors, 3, B, N).

    A normal of length 0, of a contact that is not there, has any two.
    """
    size = normal.abs()
    least = torch.nn.functional.one_hot(size.argmin(0), AXES).movedim(-1, 0).to(normal.dtype)
    first = torch.linalg.cross(least, normal, dim=0)
    first = first / torch.linalg.vector_norm(first, dim=0).clamp_min(1e-6)
    return torch.stack([first, torch.linalg.cross(normal, first, dim=0), normal])


def preload_of_weight(weight: Tensor, c: Tensor, a: Tensor, normal: Tensor, force: Tensor, length_m: float) -> Tensor:
    """Tangential forces (3, B, N) that carry the tool's weight (3, N) with normal forces (B, N): a ridge estimate.

    They balance weight and normal forces within FORCE_N and MOMENT_NM, and are small beside PRELOAD_N. a (3, 6, B, N)
    is A_b with lengths divided by `length_m`, c (B, N) contact flags, normals (3, B, N).
    """
    pressing = c * force * normal  # (3, B, N)
    rest = -times(a.transpose(0, 1), pressing).sum(1)  # (6, N)
    rest = torch.cat([rest[:AXES] - weight, rest[AXES:]])
    eye = torch.eye(AXES, dtype=a.dtype, device=a.device)[..., None, None]
    across = product(eye - normal[:, None] * normal, a)  # (3, 6, B, N) P_b A_b
    ridge = a.new_tensor([FORCE_N] * AXES + [MOMENT_NM / length_m] * AXES) / PRELOAD_N
    k = product(across.transpose(0, 1), c * across).sum(2) + torch.diag(ridge**2)[..., None]  # (6, 6, N)
    return c * times(across, times(inverse(k), rest)[:, None])


class _Forces(torch.autograd.Function):
    """Tangential forces t (n, N) of (I + E S) t = t0, for E (n, n, N) symmetric, s (n, N) >= 0, t0 (n, N).

    Solved with I + R E R, R = S^1/2, which is symmetric and at least the identity; the gradient needs no root of s.
    """

    @staticmethod
    def forward(ctx: Any, e: Tensor, s: Tensor, t0: Tensor) -> Tensor:  # type: ignore[override]
        root = s.sqrt()
        inner = inverse(torch.eye(len(s), dtype=s.dtype, device=s.device)[..., None] + root[:, None] * e * root)
        t = t0 - times(e, root * times(inner, root * t0))
        ctx.save_for_backward(e, s, root, inner, t)
        return t

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:  # type: ignore[override]
        e, s, root, inner, t = ctx.saved_tensors
        (g,) = gradients
        adjoint = g - root * times(inner, root * times(e, g))
        return -adjoint[:, None] * (s * t), -times(e, adjoint) * t, adjoint


def slide(
    grip: Grip, force: Tensor, stiffness: Tensor, without_tendons: Tensor, a: Tensor, c: Tensor, k: Tensor
) -> Slide:
    """Where and how much contacts slide, from the last pass in which they stick.

    force (3, B, N) on each fingertip in contact, stiffness (3, 3, B, N) of each fingertip, the same without tendons, a
    (3, 6, B, N) scaled A_b, contact flags c (B, N), k (6, 6, N) scaled K_x.
    """
    branches, n = force.shape[1:]
    basis = tangents(grip.normal)  # (3, 3, B, N)
    held = product(basis, c * stiffness)  # (3, 3, B, N)
    on_tool = product(held, a)  # (3, 6, B, N) force along each direction by motion of the tool
    sticking = product(held, basis.transpose(0, 1))  # (3, 3, B, N)
    free = differentiable_inverse(k)[:, :, None, None]  # (6, 6, 1, 1, N)
    followed = (free * on_tool[:2].transpose(0, 1)).sum(1)  # (6, 2, B, N)
    freed = (on_tool[:, :, :, None, None] * followed[:, None]).sum(1)  # (3, B, 2, B, N)
    own = torch.eye(branches, dtype=k.dtype, device=k.device)[:, None, :, None]  # (B, 1, B, 1)
    met = sticking[:, :2].movedim(2, 1)[..., None, :] * own - freed  # (3, B, 2, B, N)
    e, f = met[:2].reshape(2 * branches, 2 * branches, n), met[2].reshape(branches, 2 * branches, n)

    along = times(basis, force)  # (3, B, N)
    t0, n0 = along[:2].reshape(2 * branches, n), along[2]
    preload = times(basis[:2], grip.preload)  # (2, B, N)
    size = (preload * preload).sum(0)
    soft = differentiable_inverse(without_tendons)  # (3, 3, B, N) M_b
    whole = soft[0, 0] + soft[1, 1] + soft[2, 2]
    give = (whole - (grip.normal * times(soft, grip.normal)).sum(0)) / 2  # (B, N) c

    def pressed(normal_force: Tensor) -> Tensor:
        return (grip.force - normal_force).clamp_min(LEAST_PRESSURE_N)

    first = pressed(n0)
    borne = preload - along[:2]
    use = c * torch.sqrt((borne * borne).sum(0) + 1e-12) / (grip.friction * first)
    s, t, normal = torch.zeros_like(first), along[:2], first
    for step in range(SLIDE_STEPS):
        if step:
            both = torch.cat([s, s])
            flat = _Forces.apply(e, both, t0)
            t, normal = flat.unflatten(0, (2, branches)), pressed(n0 - times(f, both * flat))
        limit = (grip.friction * normal) ** 2
        reserve = torch.maximum(limit - size, LEAST_RESERVE**2 * limit)
        aligned, squared = (preload * t).sum(0), (t * t).sum(0)
        over = (torch.sqrt(aligned**2 + squared * reserve + 1e-20) - aligned) / reserve  # 1 / beta
        s = ((give + s) * over - give).clamp(0, MOST_COMPLIANCE)
    return Slide(s, use.clamp_max(MOST_USE), s / give, first)
