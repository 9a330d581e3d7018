"""Contacts that slide: how much each gives along its tangent plane once the load has used up its friction.

A contact that is pressed with N and carries the tangential force T0 before the load holds |T0 - t| <= mu N (Coulomb),
t what the load adds. Where that is exceeded the contact gets a tangential compliance s (m/N) of its own, in series
with its finger's: M_b + s (I - n n^T). s is found by secant steps, each on the forces that the last one left: the
largest share beta of t that friction bears says by how much the contact must give. s >= 0, so K_x stays positive
definite and w.dx >= 0, whatever mu and T0 are.

All of it happens among 2 B tangential numbers. E is the stiffness that slides meet when the tool is free to follow:

    (I + E S) t = t0,   slides S t,   normal forces n0 - F S t,   S = diag(s)

and the tool follows the slides, so that no further solve of K_x is needed. The adjoint of the steps is written out
(`slide_adjoint`): dozens of small operations less than differentiating each.

The steps start from the compliance c that the finger alone has, of which the tool's is left out: they come to less than
the whole slide. Models that are trained with these damped steps err less than with the compliance that a slide meets,
2 / trace(E_bb), which is all but exact after two.
The batch stands last, (..., B, N), as in the layer; lengths are metres, forces newtons, axes those of the hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from .batched import add_to_diagonal, inverse, outer, product, times, transposed_times

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
    preload: Tensor  # (2, B, N) T0, N, along the tangents; 0 out of contact
    force: Tensor  # (B, N) N0, N
    c: Tensor  # (B, N) contact flag


class Stuck(NamedTuple):
    """What the last pass in which contacts stick says of them; rows are (tangent 1, tangent 2, normal) x contact."""

    force: Tensor  # (3 B, N) on each fingertip in contact
    met: Tensor  # (3 B, 2 B, N) E, then F: forces by slides when the tool is free to follow
    give: Tensor  # (B, N) compliance c of each finger alone


class Slide(NamedTuple):
    """What the load does to the contacts."""

    slid: Tensor  # (2 B, N) slides S t, m
    compliance: Tensor  # (B, N) s, m/N
    use: Tensor  # (B, N) |T0 - t| / (mu N) if no contact slid; 0 out of contact
    share: Tensor  # (B, N) s / c
    pressed: Tensor  # (B, N) N if no contact slid


class Step(NamedTuple):
    """One secant step, for the adjoint: from forces to a compliance, and that to the forces that it leaves."""

    t: Tensor  # (2, B, N) forces before
    squared: Tensor  # (B, N) their squares
    normal: Tensor  # (B, N)
    limit: Tensor  # (B, N) mu N
    fraction: Tensor  # (B, N) part of limit^2 that the reserve varies with
    reserve: Tensor  # (B, N)
    root: Tensor  # (B, N)
    over: Tensor  # (B, N) 1 / beta
    before: Tensor  # (B, N) compliance c + s before
    inside: Tensor  # (B, N) whether s was not cut
    s: Tensor  # (B, N) after
    free: Tensor  # (2 B, 2 B, N) (I + E S)^-1
    left: Tensor  # (2, B, N) forces after
    slid: Tensor  # (2 B, N)


def tangents(normal: Tensor) -> Tensor:
    """Rotations (3, 3, B, N) into contact frames: rows are two unit vectors across each normal (3, B, N), and its own.

    A normal of length 0, of a contact that is not there, is taken for the x axis.
    """
    size = torch.linalg.vector_norm(normal, dim=0)
    x_axis = torch.eye(AXES, dtype=normal.dtype, device=normal.device)[0, :, None, None]
    own = torch.where(size > 0, normal / size.clamp_min(1e-6), x_axis)
    least = torch.nn.functional.one_hot(own.abs().argmin(0), AXES).movedim(-1, 0).to(normal.dtype)
    first = torch.linalg.cross(least, own, dim=0)
    first = first / torch.linalg.vector_norm(first, dim=0)
    return torch.stack([first, torch.linalg.cross(own, first, dim=0), own])


def preload_of_weight(weight: Tensor, c: Tensor, a_t: Tensor, normal: Tensor, force: Tensor, length_m: float) -> Tensor:
    """Tangential forces (3, B, N) that carry the tool's weight (3, N) with normal forces (B, N): a ridge estimate.

    They balance weight and normal forces within FORCE_N and MOMENT_NM, and are small beside PRELOAD_N. a_t (6, 3, B, N)
    is A_b^T with lengths divided by `length_m`, c (B, N) contact flags, normals (3, B, N).
    """
    pressing = c * force * normal  # (3, B, N)
    rest = -times(a_t.flatten(1, 2), pressing.flatten(0, 1))  # (6, N)
    rest = torch.cat([rest[:AXES] - weight, rest[AXES:]])
    eye = torch.eye(AXES, dtype=a_t.dtype, device=a_t.device)[..., None, None]
    across = product(a_t, eye - normal[:, None] * normal)  # (6, 3, B, N) A_b^T P_b
    ridge = torch.tensor([FORCE_N] * AXES + [MOMENT_NM / length_m] * AXES, dtype=a_t.dtype, device=a_t.device)
    k = add_to_diagonal(outer(across, c * across), (ridge / PRELOAD_N)[:, None] ** 2)  # (6, 6, N)
    return c * transposed_times(across, times(inverse(k), rest)[:, None])


def slide(grip: Grip, stuck: Stuck) -> tuple[Slide, list[Step]]:
    """Where and how much contacts slide, and what the adjoint needs of it."""
    mu, preload, c = grip.friction, grip.preload, grip.c
    branches = len(c)
    tangential = 2 * branches
    e, f = stuck.met[:tangential], stuck.met[tangential:]
    t0, n0, give = stuck.force[:tangential], stuck.force[tangential:], stuck.give
    size = (preload * preload).sum(0)
    normal = first = (grip.force - n0).clamp_min(LEAST_PRESSURE_N)
    t, before, steps = t0.unflatten(0, (2, branches)), give, []
    borne = preload - t
    use = c * ((borne * borne).sum(0) + 1e-12).sqrt() / (mu * first)
    for step in range(SLIDE_STEPS):
        limit = mu * normal
        squared_limit = limit * limit
        reserve = squared_limit - size
        least = LEAST_RESERVE**2 * squared_limit
        fraction = torch.where(reserve > least, 1.0, LEAST_RESERVE**2)
        reserve = torch.maximum(reserve, least)
        aligned, squared = (preload * t).sum(0), (t * t).sum(0)
        root = torch.addcmul(aligned * aligned, squared, reserve).add_(1e-20).sqrt_()
        over = (root - aligned) / reserve  # 1 / beta
        wanted = torch.addcmul(-give, before, over)
        s = wanted.clamp(0, MOST_COMPLIANCE)
        both = torch.cat([s, s])
        free = inverse(add_to_diagonal(e * both, 1.0), symmetric=False)
        flat = times(free, t0)
        left, slid = flat.unflatten(0, (2, branches)), both * flat
        steps.append(
            Step(t, squared, normal, limit, fraction, reserve, root, over, before, s == wanted, s, free, left, slid)
        )
        if step < SLIDE_STEPS - 1:
            t, before = left, give + s
            normal = (grip.force - n0 + times(f, slid)).clamp_min(LEAST_PRESSURE_N)
    return Slide(slid, s, use.clamp_max(MOST_USE), s / give, first), steps


def slide_adjoint(
    grip: Grip, stuck: Stuck, found: Slide, steps: list[Step], g_slid: Tensor, g_found: Sequence[Tensor | None]
) -> tuple[Stuck, Tensor, Tensor]:
    """Gradients by `stuck`, friction (B, N) and preload (2, B, N), from those by slides and the rest of `found`.

    None stands for a result that was not used.
    """
    g_s, g_use, g_share, g_first = g_found
    mu, preload = grip.friction, grip.preload
    branches = len(mu)
    tangential = 2 * branches
    e, f = stuck.met[:tangential], stuck.met[tangential:]
    zero = torch.zeros_like(mu)
    g_force, g_met = torch.zeros_like(stuck.force), torch.zeros_like(stuck.met)
    g_give, g_mu, g_preload, g_size, g_normal, g_t = zero, zero, torch.zeros_like(preload), zero, zero, None
    g_s = zero if g_s is None else g_s
    if g_share is not None:
        by_give = g_share / stuck.give
        g_s, g_give = g_s + by_give, g_give - by_give * found.share
    for k in range(SLIDE_STEPS - 1, -1, -1):
        step = steps[k]
        by_left = step.s * g_slid.unflatten(0, (2, branches))
        by_left = by_left if g_t is None else by_left + g_t
        adjoint = transposed_times(step.free, by_left.flatten(0, 1))
        rows = torch.cat([adjoint, g_normal])
        g_force += rows
        g_met.addcmul_(rows[:, None], step.slid, value=-1)
        by_slid = (g_slid - transposed_times(e, adjoint)).unflatten(0, (2, branches))
        by_wanted = (g_s + (by_slid * step.left).sum(0)) * step.inside
        g_s = by_wanted * step.over
        g_give = g_give + g_s - by_wanted
        by_over = by_wanted * step.before
        by_root = by_over / step.root
        by_aligned = -step.over * by_root
        g_t = torch.addcmul(preload * by_aligned, step.t, by_root)
        g_preload.addcmul_(step.t, by_aligned)
        by_reserve = torch.addcmul(0.5 * step.squared * by_root, step.over, by_over, value=-1) / step.reserve
        by_limit = 2 * step.limit * step.fraction * by_reserve
        g_size = g_size - by_reserve * (step.fraction == 1)
        g_mu = g_mu + by_limit * step.normal
        by_normal = by_limit * mu
        if k:
            g_normal = -by_normal * (step.normal > LEAST_PRESSURE_N)
            g_slid = -transposed_times(f, g_normal)
    assert g_t is not None
    if g_first is not None:
        by_normal = by_normal + g_first
    if g_use is not None:
        borne = preload - steps[0].t
        by_log = g_use * (found.use < MOST_USE) * found.use
        by_borne = by_log / ((borne * borne).sum(0) + 1e-12) * borne
        g_preload, g_t = g_preload + by_borne, g_t - by_borne
        g_mu, by_normal = g_mu - by_log / mu, by_normal - by_log / found.pressed
    g_normal = -by_normal * (found.pressed > LEAST_PRESSURE_N)
    g_force += torch.cat([g_t.flatten(0, 1), g_normal])
    return Stuck(g_force, g_met, g_give), g_mu, g_preload.addcmul_(preload, g_size, value=2)
