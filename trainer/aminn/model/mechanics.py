"""The two-pass statics layer: springs and tendons in, stiffness and displacement out.

With A_b and B_b the blocks of the closure A_b dx = B_b dq_b (J_x stacks A_b, J_q stacks -B_b), the stiffness of the
grasped tool is a sum over branches (the paper's eq. for K_x with block-diagonal K_q and J_q; `dense_stiffness` is the
undivided form, kept for the test that shows the two equal):

    K_x = sum_b c_b A_b^T (B_b K_b^-1 B_b^T + eps_M I)^-1 A_b + eps_Kx I

A fingertip is up to 1e5 times as stiff along its bones as across, and the inverse above would lose the one beside the
other. So the layer takes H = (K_b + B_b^T B_b / eps_M)^-1, how joints give by torques while the contact is held,
V = H B_b^T / eps_M, how they follow the contact, and the energy of both: V^T K_b V + (I - B_b V)^T (I - B_b V) / eps_M.

Pass 2 adds a tendon to each branch, k_b g_b d_b d_b^T, which changes what pass 1 found by matrices of rank 1. The layer
has one adjoint for both passes and for contacts that slide, written out: the gradient of a solve is a second solve with
the same inverse, far cheaper than differentiating each step.

c_b in [0, 1] is the branch's contact flag: a branch out of contact leaves the sum exactly. The 6x6 solve works on
lengths divided by the hand's L (`S = diag(1, 1, 1, 1/L, 1/L, 1/L)`), since metres and radians in one matrix cost a
factor of 1e3 in conditioning for nothing. What comes in and goes out leads with a batch dimension N, then the B
branches, C coordinates each; within, the batch stands last. Units are SI, axes are those of the hand.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from aminn_hand.hand import N_WRENCH

from .batched import (
    add_to_diagonal,
    batch_first,
    batch_last,
    inverse,
    inverse_3x3,
    inverse_stiff,
    outer,
    product,
    reversed_axes,
    times,
    transposed_times,
)
from .config import MechanicsConfig
from .sliding import AXES, Grip, Slide, Step, Stuck, slide, slide_adjoint, tangents


class Springs(NamedTuple):
    """What the mechanics head predicts for one stage."""

    k_spring: Tensor  # (N, B, C, C) joint stiffness K_s of each branch, N.m/rad, SPD
    tendon_dir: Tensor  # (N, B, C) tendon direction d_b, unit vector in branch coordinates
    tendon_gain: Tensor  # (N, B) k_b > 0, N.m/rad; 0 where a branch has no gated tendon
    gate_params: Tensor  # (N, B, 3) alpha (1/rad), beta (rad), rho


class Extras(NamedTuple):
    """What a model may add to the paper's layer; None leaves a term out."""

    eps_m: Tensor | None = None  # (), (B) or (N, B) contact compliance, m/N, in place of the constant
    twist: Tensor | None = None  # (N, B) stiffness of each contact about its normal (soft finger), N.m/rad
    normal: Tensor | None = None  # (N, B, 3) contact normals, for twist and friction
    normal_force: Tensor | None = None  # (N, B) before the load, N, with friction
    friction: Tensor | None = None  # (N, B) coefficients: contacts may slide
    preload: Tensor | None = None  # (N, B, 3) tangential force on each contact before the load, N, with friction


NO_EXTRAS = Extras()


class Constants(NamedTuple):
    """What the layer knows of the hand and of its own settings."""

    config: MechanicsConfig
    coord_mask: Tensor  # (B, C) 1 where the branch has the coordinate
    eps_m: Tensor  # (B) compliance of each contact, m/N; or () where all are the same
    gated: tuple[bool, ...]  # (B) whether the branch has a gated tendon
    length_m: float  # L
    limits: tuple[float, float] | None = None  # of a motion that is reported, m and rad; None: any


class Scene(NamedTuple):
    """A load case as the layer takes it, without gradients. Forces on a contact have the axes of `frame`."""

    w: Tensor  # (6, N) scaled wrench
    c: Tensor  # (B, N) contact flags
    a_t: Tensor  # (6, 3, B, N) scaled A_b^T
    b_t: Tensor  # (C, 3, B, N) B_b^T
    own: Tensor  # (C, B, N) or broadcast: c where the branch has the coordinate
    reach: Tensor | None  # (C, 6, B, N) dq0 by dx0, where the inverse of J_q gives it
    frame: Tensor | None  # (3, 3, B, N) rows: two tangents and the normal, where contacts slide; None: axes of H
    pressing: Tensor | None  # (B, N) normal forces before the load, where contacts slide


class Known(NamedTuple):
    """What a response follows from, the batch last."""

    scene: Scene
    k_spring: Tensor  # (C, C, B, N)
    d: Tensor  # (C, B, N)
    gain: Tensor  # (B, N)
    eps_m: Tensor  # (B, N)
    floor: Tensor  # (6, 6, N) or broadcast: added to the scaled K_x
    s: Tensor  # (6) `length_scaling`
    friction: Tensor | None  # (B, N)
    preload: Tensor | None  # (2, B, N) along the tangents


class Response(NamedTuple):
    """What the layer returns; names as in `Dims.debug`."""

    dx0: Tensor  # (N, 6) displacement with springs alone
    dq0: Tensor  # (N, B, C) joint deflection of pass 1 in branch coordinates, rad
    gate: Tensor  # (N, B) tendon engagement g_b in (0, 1); 0 where a branch has no gated tendon
    k_diagonal: Tensor  # (N, 6) diagonal of K_x with lengths divided by L if no contact slides, N/m
    x_scaled: Tensor  # (N, 6) displacement with rotations times L, m; not cut
    dx: Tensor  # (N, 6) displacement, m and rad
    friction_use: Tensor  # (N, B) share of its friction that each contact uses if none slides; 0 without friction
    slide: Tensor  # (N, B) compliance that sliding gives each contact, m/N
    slide_share: Tensor  # (N, B) that over the compliance that the contact meets
    pressed: Tensor  # (N, B) normal force under load if none slides, N
    known: Known  # what the rest follows from

    @property
    def k_tendon(self) -> Tensor:
        """(N, B, C, C) k_b g_b d_b d_b^T, N.m/rad."""
        return batch_first(self._k_tendon).to(self.dx.dtype)

    @property
    def k_scaled(self) -> Tensor:
        """(N, 6, 6) K_x with lengths divided by L if no contact slides, N/m."""
        return self._k(None).movedim(-1, 0).to(self.dx.dtype)

    @property
    def k_x(self) -> Tensor:
        """(N, 6, 6) K_x with contacts that slide, SI."""
        s = self.known.s
        return (self._k(self.known.scene.c * self.slide.mT).movedim(-1, 0) / (s[:, None] * s)).to(self.dx.dtype)

    @property
    def friction(self) -> Tensor:
        """(N, B) coefficient mu of each contact; 0 where none slides."""
        mu = self.known.friction
        return torch.zeros_like(self.gate) if mu is None else mu.mT.to(self.dx.dtype)

    @property
    def preload(self) -> Tensor:
        """(N, B, 3) tangential force T0 on each contact before the load, N."""
        frame, preload = self.known.scene.frame, self.known.preload
        if frame is None or preload is None:
            return self.gate.new_zeros(*self.gate.shape, AXES)
        return batch_first(transposed_times(frame[:2], preload)).to(self.dx.dtype)

    @property
    def _k_tendon(self) -> Tensor:
        known = self.known
        return (known.gain * self.gate.mT * known.d)[:, None] * known.d

    def _k(self, slide: Tensor | None) -> Tensor:
        """Scaled K_x (6, 6, N) with compliances (B, N) along the tangents."""
        scene, known = self.known.scene, self.known
        cb = product(inverse_stiff(known.k_spring + self._k_tendon), scene.b_t)
        m = add_to_diagonal(product(scene.b_t.transpose(0, 1), cb), known.eps_m[None])
        if slide is not None and scene.frame is not None:
            m = m + torch.diag_embed(torch.stack([slide, slide, 0 * slide], -1)).movedim((-2, -1), (0, 1))
        return outer(scene.a_t, product(scene.a_t, scene.c * inverse_stiff(m))) + known.floor


def length_scaling(like: Tensor, length_m: float) -> Tensor:
    """Diagonal of S (6) for L = `length_m`, with the type and device of `like`."""
    return torch.tensor([1.0] * 3 + [1.0 / length_m] * 3, dtype=like.dtype, device=like.device)


class _Springs(NamedTuple):
    """Pass 1, for its adjoint. Without the contact flag."""

    held: Tensor  # (C, C, B, N) joints by torques, the fingertip held by its contact
    p: Tensor  # (3, 3, B, N) stiffness of a fingertip
    v: Tensor  # (C, 3, B, N) joints by motion of a fingertip
    free: Tensor  # (6, 6, N) inverse of K_x
    x: Tensor  # (6, N) motion of the tool
    tip: Tensor  # (3, B, N) motion of the contacts
    dq: Tensor  # (C, B, N) joint deflections, 0 out of contact


class _Tendons(NamedTuple):
    """What the gates add to it, with fingertips held where it is said of them."""

    gate: Tensor  # (B, N)
    stretch: Tensor  # (B, N) of the tendon in pass 1, less beta
    stiff: Tensor  # (B, N) k g
    share: Tensor  # (B, N) of a tendon's pull that is left once its joints give way
    bent: Tensor  # (C, B, N) joints by a torque along the tendon, held
    pulled: Tensor  # (3, B, N) force on the fingertip by the same, held
    on_tool: Tensor  # (6, B, N) that as a wrench


class _Slides(NamedTuple):
    """What contacts do that slide. With the contact flag."""

    grip: Grip
    stuck: Stuck
    slide: Slide
    steps: list[Step]
    p: Tensor  # (3, 3, B, N) stiffness of a fingertip in pass 2
    wt: Tensor  # (6, 3, B, N) A_b^T of that: wrench by motion of a fingertip
    follow: Tensor  # (6, 2 B, N) motion of the tool by slides
    side: Tensor  # (C, 2, B, N) joints by forces along the tangents, the finger alone, without the flag


def _along(a_t: Tensor, x: Tensor) -> Tensor:
    """A_b x (3, B, N) for a motion x (6, N)."""
    return (a_t * x[:, None, None]).sum(0)


def _against(a_t: Tensor, f: Tensor) -> Tensor:
    """The wrench (6, N) of forces f (3, B, N): the sum of A_b^T f."""
    return (a_t * f).flatten(1, 2).sum(1)


def _solved(k: Tensor, free: Tensor, w: Tensor) -> Tensor:
    """K^-1 w (6, N), refined once: K is all but singular where contacts let the tool turn."""
    x = times(free, w)
    return x + times(free, w - times(k, x))


def _own_blocks(met: Tensor, branches: int) -> Tensor:
    """The blocks (3, 2, N, B) of met (3 B, 2 B, N) that are a contact's own, as a view."""
    return met.unflatten(0, (AXES, branches)).unflatten(2, (2, branches)).diagonal(dim1=1, dim2=3)


class _TwoPass(torch.autograd.Function):
    """The layer and its adjoint."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        scene: Scene,
        has_tendon: Tensor | None,  # (B, 1) 1 where a branch has a gated tendon; None: pass 1 is all
        k_spring: Tensor,  # (C, C, B, N)
        eps_m: Tensor,  # (B, N)
        floor: Tensor,  # (6, 6, N) or broadcast: added to the scaled K_x, symmetric
        d: Tensor,  # (C, B, N)
        gain: Tensor,  # (B, N)
        gate_params: Tensor,  # (3, B, N)
        friction: Tensor | None,  # (B, N)
        preload: Tensor | None,  # (2, B, N) along the tangents
    ) -> tuple[Tensor, ...]:
        """dx0 and dx (6, N), scaled, dq0 (C, B, N), gate (B, N), diagonal of K_x (6, N); of `Slide` all but slid."""
        c, a_t = scene.c, scene.a_t
        exactly = torch.float64  # a fingertip is up to 1e5 times as stiff along its bones as across
        b_t, joints, stiff_tip = scene.b_t.to(exactly), k_spring.to(exactly), 1 / eps_m.to(exactly)
        held = inverse_stiff(joints + product(stiff_tip * b_t, b_t.transpose(0, 1)))
        v = stiff_tip * product(held, b_t)
        left = add_to_diagonal(-product(b_t.transpose(0, 1), v), 1.0)  # of a fingertip's motion, to its contact
        p = product(v.transpose(0, 1), product(joints, v)) + stiff_tip * product(left.transpose(0, 1), left)
        held, v, p = (t.to(c.dtype) for t in (held, v, p))
        wt = product(a_t, c * p)  # (6, 3, B, N)
        k = outer(a_t, wt) + floor  # (6, 6, N)
        free = inverse(k)
        x = x0 = _solved(k, free, scene.w)
        tip = _along(a_t, x0)
        dq0 = scene.own * (times(v, tip) if scene.reach is None else times(scene.reach, x0[:, None]))
        springs = _Springs(held, p, v, free, x0, tip, dq0)
        tendons, slides, gate = None, None, torch.zeros_like(c)
        slid: tuple[Tensor, ...] = ()
        if has_tendon is not None:
            alpha, beta, rho = gate_params
            stretch = (dq0 * d).sum(0) - beta
            gate = torch.sigmoid(alpha * stretch + rho) * has_tendon
            stiff = gain * gate
            bent, pulled = times(held, d), transposed_times(v, d)
            share = 1 / (1 + stiff * (d * bent).sum(0))
            on_tool = times(a_t, pulled)  # (6, B, N)
            pull = c * stiff * share
            k = k + (on_tool[:, None] * (pull * on_tool)).sum(2)
            free = inverse(k)
            x = _solved(k, free, scene.w)
            tendons = _Tendons(gate, stretch, stiff, share, bent, pulled, on_tool)
        x_stuck = x
        if friction is not None and preload is not None and scene.pressing is not None:
            branches, p_tip = len(c), c * p
            if tendons is not None:
                p_tip = p_tip + (pull * pulled)[:, None] * pulled
                wt = wt + on_tool[:, None] * (pull * pulled)
            rows = wt.flatten(1, 2)  # (6, 3 B, N)
            follow = product(free, rows[:, : 2 * branches])
            met = -(rows[:, :, None] * follow[:, None]).sum(0)  # (3 B, 2 B, N)
            _own_blocks(met, branches).add_(p_tip[:, :2].mT)
            tangential = b_t[:, :2]
            side = product(inverse(joints), tangential)
            give = (eps_m + 0.5 * (side * tangential).flatten(0, 1).sum(0)).to(c.dtype)
            stuck = Stuck(_along(wt, x).flatten(0, 1), met, give)
            grip = Grip(friction, preload, scene.pressing, c)
            found, steps = slide(grip, stuck)
            x = x + times(follow, found.slid)
            slides = _Slides(grip, stuck, found, steps, p_tip, wt, follow, side.to(c.dtype))
            slid = found[1:]
        ctx.kept = scene, springs, d, gain, gate_params, tendons, slides, free, x_stuck
        ctx.set_materialize_grads(False)
        return tuple(t.detach() for t in (x0, x, dq0, gate, k.diagonal().mT, *slid))  # what is kept is no result

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple:  # type: ignore[override]
        scene, springs, d, gain, gate_params, tendons, slides, free, x = ctx.kept
        c, a_t = scene.c, scene.a_t
        g_x0, g_x, g_dq, g_gate, g_diagonal, *g_slide = gradients  # None where a result was not used
        g_x = torch.zeros_like(scene.w) if g_x is None else g_x
        g_friction = g_preload = g_give = None
        if slides is not None:
            g_x, g_k, g_wt, g_p, g_give, g_friction, g_preload = _slides_adjoint(slides, free, x, g_x, g_slide)
            adjoint = times(free, g_x)
            g_k = g_k - adjoint[:, None] * x
            if g_diagonal is not None:
                add_to_diagonal(g_k, g_diagonal)
            g_wt = g_wt + product(g_k.transpose(0, 1), a_t.flatten(1, 2)).unflatten(1, a_t.shape[1:3])
            g_p = g_p + product(a_t.transpose(0, 1), g_wt)
        else:
            adjoint = times(free, g_x)
            g_p = -_along(a_t, adjoint)[:, None] * _along(a_t, x)
            if g_diagonal is not None:
                g_p = g_p + (a_t[:, :, None] * (a_t * g_diagonal[:, None, None])[:, None]).sum(0)
        q = (0.5 * c) * (g_p + g_p.transpose(0, 1))  # by the stiffness of fingertips, (3, 3, B, N)

        v, p, g_d, g_gain, g_gate_params, held = springs.v, springs.p, None, None, None, None
        if tendons is not None:
            alpha, gate, pulled = gate_params[0], tendons.gate, tendons.pulled
            theta = tendons.stiff * tendons.share
            v = v - (theta * tendons.bent)[:, None] * pulled  # those of pass 2
            p = p + (theta * pulled)[:, None] * pulled
            along = times(q, pulled)
            g_stiff = tendons.share**2 * (pulled * along).sum(0)
            g_gain = gate * g_stiff
            inner = gain * g_stiff if g_gate is None else gain * g_stiff + g_gate
            inner = inner * gate * (1 - gate)
            by_stretch = alpha * inner
            g_gate_params = torch.stack([inner * tendons.stretch, -by_stretch, inner])
            g_d = 2 * theta * times(v, along) + by_stretch * springs.dq
            if scene.reach is None:
                held = (c * by_stretch) * tendons.bent, (c * by_stretch) * pulled
            else:
                g_dq = by_stretch * d if g_dq is None else by_stretch * d + g_dq
        g_k_spring = product(product(v, q), v.transpose(0, 1))
        g_eps_m = -(product(p, q) * p).flatten(0, 1).sum(0)
        g_floor = None
        if ctx.needs_input_grad[4]:
            g_floor = -adjoint[:, None] * x if slides is None else g_k
            if slides is None and g_diagonal is not None:
                add_to_diagonal(g_floor, g_diagonal)
        if not (g_x0 is None and g_dq is None and held is None):
            by_springs, by_eps_m, by_floor = _springs_adjoint(scene, springs, g_x0, g_dq, held)
            g_k_spring, g_eps_m = g_k_spring + by_springs, g_eps_m + by_eps_m
            g_floor = None if g_floor is None else g_floor + by_floor
        if g_give is not None:
            side = slides.side
            g_k_spring = g_k_spring - product((0.5 * g_give) * side, side.transpose(0, 1))
            g_eps_m = g_eps_m + g_give
        return None, None, g_k_spring, g_eps_m, g_floor, g_d, g_gain, g_gate_params, g_friction, g_preload


def _springs_adjoint(
    scene: Scene, springs: _Springs, g_x: Tensor | None, g_dq: Tensor | None, held: tuple[Tensor, Tensor] | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients by k_spring, eps_m and floor from those by pass 1's motion (6, N) and joint deflections (C, B, N).

    `held` are joint deflections (C, B, N) and forces (3, B, N) by torques on joints whose fingertips are held.
    """
    v, p = springs.v, springs.p
    g_x = torch.zeros_like(scene.w) if g_x is None else g_x
    bend, force = held or (torch.zeros_like(springs.dq), torch.zeros_like(springs.tip))
    if g_dq is not None:
        turn = scene.own * g_dq
        if scene.reach is None:
            bend, force = bend + times(springs.held, turn), force + transposed_times(v, turn)
        else:
            g_x = g_x + transposed_times(scene.reach, turn).sum(1)
    adjoint = times(springs.free, g_x + _against(scene.a_t, force))
    tip = scene.c * _along(scene.a_t, adjoint)
    by_eps_m = ((times(p, tip) - force) * times(p, springs.tip)).sum(0)
    return (bend + times(v, tip))[:, None] * -times(v, springs.tip), by_eps_m, -adjoint[:, None] * springs.x


def _slides_adjoint(
    slides: _Slides, free: Tensor, x: Tensor, g_x: Tensor, g_slide: list[Tensor | None]
) -> tuple[Tensor, ...]:
    """Gradients from those by the motion (6, N) and by `Slide` all but slid.

    By the motion without slides, scaled K_x, wt, p of `slides`, give, friction, and preload.
    """
    follow, stuck = slides.follow, slides.stuck
    g_slid = transposed_times(follow, g_x)
    by, g_friction, g_preload = slide_adjoint(slides.grip, stuck, slides.slide, slides.steps, g_slid, g_slide)
    g_force, branches = by.force.unflatten(0, (AXES, -1)), slides.wt.shape[2]
    by_follow = g_x[:, None] * slides.slide.slid - (slides.wt.flatten(1, 2)[:, :, None] * by.met).sum(1)  # (6, 2 B, N)
    y = product(free, by_follow)
    g_wt = -(follow[:, None] * by.met).sum(2)  # (6, 3 B, N)
    g_wt[:, : 2 * branches] += y
    g_wt = g_force * x[:, None, None] + g_wt.unflatten(1, (AXES, branches))
    g_p = torch.zeros_like(slides.p)
    g_p[:, :2] = _own_blocks(by.met, branches).mT
    g_k = -(y[:, None] * follow).sum(2)
    return g_x + _against(slides.wt, g_force), g_k, g_wt, g_p, by.give, g_friction, g_preload


def _reach(j_q: Tensor, j_x: Tensor, mask: Tensor, config: MechanicsConfig) -> Tensor:
    """dq0 by dx0 (C, 6, B, N) by the regularised inverse of J_q, as the paper writes it; C = 3 alone: J_q is square."""
    eye = torch.eye(AXES, dtype=j_q.dtype, device=j_q.device)[..., None, None]
    return -mask[:, None] * product(inverse_3x3(j_q + config.eps_jq * eye), j_x)


def two_pass(
    springs: Springs,
    w_e: Tensor,
    contact: Tensor,
    j_x: Tensor,
    j_q: Tensor,
    constants: Constants,
    extras: Extras = NO_EXTRAS,
    dtype: torch.dtype = torch.float64,
) -> Response:
    """Displacement under w_e (N, 6) with contact (N, B), j_x (N, B, 3, 6), j_q (N, B, 3, C).

    Pass 1 takes the springs alone and finds how far each tendon would be stretched. The gates follow from that, and
    pass 2 adds the engaged tendons; a hand without gated tendons has pass 1 alone. K_x is SPD, so w.dx > 0 for every
    wrench that is not zero. The arithmetic is in `dtype` whatever the inputs are (results come back in the type of
    w_e): forming K_x squares the conditioning, which the exported models avoid by the square-root form of
    docs/mechanics.md. Gradients of a training step do well with float32, predictions are made in float64.
    """
    config, length_m = constants.config, constants.length_m
    k_spring, d, gain, gate_params = (batch_last(t).to(dtype) for t in springs)
    c = contact.to(dtype).mT.contiguous()  # (B, N)
    s = length_scaling(c, length_m)
    a_t, minus_b_t = (reversed_axes(t).to(dtype) for t in (j_x, j_q))  # (6, 3, B, N), (C, 3, B, N)
    mask = constants.coord_mask.to(dtype).mT[..., None]  # (C, B, 1)
    reach = None
    if config.dq0 == "inverse":
        reach = _reach(minus_b_t.transpose(0, 1), a_t.transpose(0, 1), mask, config) * s[:, None, None]
    a_t = a_t * s[:, None, None, None]
    frame = pressing = friction = preload = None
    if extras.friction is not None:
        assert extras.preload is not None and extras.normal is not None and extras.normal_force is not None
        frame = tangents(batch_last(extras.normal).to(dtype))  # (3, 3, B, N)
        a_t, minus_b_t = (product(t, frame.transpose(0, 1)) for t in (a_t, minus_b_t))
        pressing = extras.normal_force.to(dtype).mT
        friction = extras.friction.to(dtype).mT.contiguous()
        preload = c * times(frame[:2], batch_last(extras.preload).to(dtype))  # (2, B, N)
    scene = Scene((w_e.to(dtype) * s).mT.contiguous(), c, a_t, -minus_b_t, c * mask, reach, frame, pressing)
    eps_m = (constants.eps_m if extras.eps_m is None else extras.eps_m).to(dtype)  # (), (B) or (N, B)
    eps_m = (eps_m.mT if eps_m.ndim == 2 else eps_m[..., None]).expand_as(c)
    floor = torch.diag(config.eps_kx * s * s)[..., None]  # (6, 6, 1)
    if extras.twist is not None:
        assert extras.normal is not None
        floor = floor + _twist_stiffness(extras.twist.to(dtype).mT, batch_last(extras.normal).to(dtype), c, length_m)
    has_tendon = None
    if any(constants.gated):
        has_tendon = torch.tensor(constants.gated, dtype=dtype, device=c.device)[:, None]
    x0, x, dq0, gate, k_diagonal, *slid = _TwoPass.apply(
        scene, has_tendon, k_spring, eps_m, floor, d, gain, gate_params, friction, preload
    )
    slide_, use, share, pressed = slid or (torch.zeros_like(c),) * 4
    results = dict(
        dx0=(x0 * s[:, None]).mT,
        dq0=batch_first(dq0),
        gate=gate.mT,
        k_diagonal=k_diagonal.mT,
        x_scaled=x.mT,
        dx=_cut(x * s[:, None], constants.limits).mT,
        friction_use=use.mT,
        slide=slide_.mT,
        slide_share=share.mT,
        pressed=pressed.mT,
    )
    known = Known(scene, k_spring, d, gain, eps_m, floor, s, friction, preload)
    return Response(**{name: value.to(w_e.dtype) for name, value in results.items()}, known=known)


def _cut(dx: Tensor, limits: tuple[float, float] | None) -> Tensor:
    """Motions (6, N), each shortened by one factor to `limits` of translation (m) and rotation (rad)."""
    if limits is None:
        return dx
    sizes = torch.stack([torch.linalg.vector_norm(part, dim=0) for part in (dx[:AXES], dx[AXES:])])  # (2, N)
    over = sizes / torch.tensor(limits, dtype=dx.dtype, device=dx.device)[:, None]
    return dx / over.amax(0).clamp_min(1)


def _twist_stiffness(twist: Tensor, normal: Tensor, c: Tensor, length_m: float) -> Tensor:
    """A soft finger's stiffness about its normal as part of the scaled K_x: (6, 6, N) from (B, N) and (3, B, N)."""
    about = (c * twist * normal)[:, None] * normal / length_m**2  # (3, 3, B, N)
    return torch.nn.functional.pad(about.sum(2), (0, 0, 3, 0, 3, 0))


def dense_stiffness(
    k_q: Tensor, contact: Tensor, j_x: Tensor, j_q: Tensor, eps_m: Tensor, config: MechanicsConfig
) -> Tensor:
    """K_x (N, 6, 6) by the undivided algebra of the paper; the tests hold it against the sum over branches.

    k_q (N, B, C, C), contact (N, B), eps_m (B). A branch out of contact is left out of the stacked matrices by scaling
    its rows of J_x.
    """
    n, branches = contact.shape
    big_k = torch.stack([torch.block_diag(*blocks) for blocks in k_q])  # (N, BC, BC)
    big_jq = torch.stack([torch.block_diag(*blocks) for blocks in j_q])  # (N, 3B, BC)
    big_jx = (j_x * contact.sqrt()[..., None, None]).reshape(n, -1, N_WRENCH)  # (N, 3B, 6)
    give = torch.diag(eps_m.expand(branches).repeat_interleave(AXES))
    middle = big_jq @ torch.linalg.inv(big_k) @ big_jq.mT + give
    eye6 = torch.eye(N_WRENCH, dtype=k_q.dtype, device=k_q.device)
    return big_jx.mT @ torch.linalg.inv(middle) @ big_jx + config.eps_kx * eye6
