"""The two-pass statics layer: springs and tendons in, stiffness and displacement out.

With A_b and B_b the blocks of the closure A_b dx = B_b dq_b (J_x stacks A_b, J_q stacks -B_b), the stiffness of the
grasped tool is a sum over branches (the paper's eq. for K_x with block-diagonal K_q and J_q; `dense_stiffness` is the
undivided form, kept for the test that shows the two equal):

    K_x = sum_b c_b A_b^T (B_b K_b^-1 B_b^T + eps_M I)^-1 A_b + eps_Kx I

c_b in [0, 1] is the branch's contact flag: a branch out of contact leaves the sum exactly. The 6x6 solve works on
lengths divided by the hand's L (`S = diag(1, 1, 1, 1/L, 1/L, 1/L)`), since metres and radians in one matrix cost a
factor of 1e3 in conditioning for nothing. All tensors lead with a batch dimension N, then the B branches, C coordinates
each; units are SI, axes are those of the hand.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from aminn_hand.hand import N_WRENCH

from .batched import as_last, batch_first, batch_last, inverse, inverse_3x3, product, times
from .config import MechanicsConfig
from .sliding import AXES, Grip, Slide, slide


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


class Response(NamedTuple):
    """What the layer returns; names as in `Dims.debug`."""

    dx0: Tensor  # (N, 6) displacement with springs alone
    dq0: Tensor  # (N, B, C) joint deflection of pass 1 in branch coordinates, rad
    gate: Tensor  # (N, B) tendon engagement g_b in (0, 1); 0 where a branch has no gated tendon
    k_tendon: Tensor  # (N, B, C, C) k_b g_b d_b d_b^T, N.m/rad
    k_scaled: Tensor  # (N, 6, 6) K_x with lengths divided by L if no contact slides, N/m
    x_scaled: Tensor  # (N, 6) displacement with rotations times L, m; not cut
    k_x: Tensor  # (N, 6, 6) K_x with contacts that slide, SI
    dx: Tensor  # (N, 6) displacement, m and rad
    friction_use: Tensor  # (N, B) share of its friction that each contact uses if none slides; 0 without friction
    slide: Tensor  # (N, B) compliance that sliding gives each contact, m/N
    slide_share: Tensor  # (N, B) that over the compliance that the contact meets
    pressed: Tensor  # (N, B) normal force under load if none slides, N
    friction: Tensor  # (N, B) coefficient mu of each contact
    preload: Tensor  # (N, B, 3) tangential force T0 on each contact before the load, N


def length_scaling(like: Tensor, length_m: float) -> Tensor:
    """Diagonal of S (6) for L = `length_m`, with the type and device of `like`."""
    return torch.tensor([1.0] * 3 + [1.0 / length_m] * 3, dtype=like.dtype, device=like.device)


class _Factor(NamedTuple):
    """A symmetric positive definite K (6, 6, N) for solving with: translation eliminated first."""

    inverse: Tensor  # (3, 3, N) of the translational block
    coupling: Tensor  # (3, 3, N) that times the rows of rotation
    schur: Tensor  # (3, 3, N) inverse of what is left for rotation


def _factorise(k: Tensor) -> _Factor:
    inverse = inverse_3x3(k[:3, :3])
    coupling = product(inverse, k[:3, 3:])
    return _Factor(inverse, coupling, inverse_3x3(k[3:, 3:] - product(k[3:, :3], coupling)))


def _solve(factor: _Factor, w: Tensor) -> Tensor:
    """Solve K x = w for w (6, N)."""
    rotation = times(factor.schur, w[3:] - times(factor.coupling.transpose(0, 1), w[:3]))
    return torch.cat([times(factor.inverse, w[:3]) - times(factor.coupling, rotation), rotation])


class _Statics(torch.autograd.Function):
    """One pass of the layer and its adjoint.

    A pass is a linear solve. Its gradient is a second solve with the same factor, and all that reaches a branch's
    stiffness is an outer product of two joint deflections: far cheaper than differentiating each step of the pass.
    """

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        k_q: Tensor,  # (C, C, B, N) joint stiffness of each branch
        softness: Tensor,  # (3, 3, B, N) or broadcast: compliance of each contact, m/N
        w: Tensor,  # (6, N) scaled wrench
        c: Tensor,  # (B, N) contact flag
        a: Tensor,  # (3, 6, B, N) scaled A_b
        b_t: Tensor,  # (C, 3, B, N) B_b^T
        floor: Tensor,  # (6, 6, N) or broadcast: added to the scaled K_x, symmetric
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Scaled K_x (6, 6, N), scaled displacement (6, N), joint deflections (C, B, N), forces (3, B, N), and the
        stiffness of each fingertip (3, 3, B, N)."""
        compliance = inverse(k_q)  # (C, C, B, N)
        cb = product(compliance, b_t)  # (C, 3, B, N) K^-1 B^T
        p = inverse_3x3(product(b_t.transpose(0, 1), cb) + softness)  # (3, 3, B, N) stiffness of a fingertip
        wa = product(p, a)  # (3, 6, B, N) its force by motion of the tool
        k = sum(product(a[:, :, i].transpose(0, 1), c[i] * wa[:, :, i]) for i in range(c.shape[0]))
        k = k + floor  # (6, 6, N)
        factor = _factorise(k)
        x = _solve(factor, w)
        v = times(wa, x[:, None])  # (3, B, N) force on a fingertip in contact
        dq = times(cb, v)  # (C, B, N)
        ctx.save_for_backward(c, a, b_t, compliance, cb, p, wa, x, v, dq, *factor)
        ctx.set_materialize_grads(False)
        return k, x, c * dq, c * v, p

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple:  # type: ignore[override]
        g_k, g_x, g_dq, g_f, g_p = gradients  # None where a result was not used
        c, a, b_t, compliance, cb, p, wa, x, v, dq, *parts = ctx.saved_tensors
        factor = _Factor(*parts)
        g_x = wa.new_zeros(wa.shape[1], wa.shape[-1]) if g_x is None else g_x
        soft, y = torch.zeros_like(dq), torch.zeros_like(v)
        if g_dq is not None or g_f is not None:  # these depend on stiffness and contact directly, not only through x
            soft = soft if g_dq is None else c * times(compliance, g_dq)  # (C, B, N)
            y = times(p, times(b_t.transpose(0, 1), soft) + (0.0 if g_f is None else c * g_f))  # (3, B, N)
            g_x = g_x + times(a.transpose(0, 1), y).sum(1)
        adjoint = _solve(factor, g_x)  # (6, N)
        u = c * times(wa, adjoint[:, None]) - y  # (3, B, N)
        g_kq = (times(cb, u) + soft)[:, None] * -dq
        g_softness = u[:, None] * v
        if g_k is not None:
            cwg = c * product(wa, g_k[:, :, None])  # (3, 6, B, N)
            g_softness = g_softness - product(cwg, wa.transpose(0, 1))
            g_kq = g_kq + product(product(cb, cwg), product(cb, wa).transpose(0, 1))
        if g_p is not None:
            pgp = product(product(p, g_p), p)
            g_softness = g_softness - pgp
            g_kq = g_kq + product(product(cb, pgp), cb.transpose(0, 1))
        g_floor = None
        if ctx.needs_input_grad[6]:
            g_floor = -adjoint[:, None] * x + (0.0 if g_k is None else g_k)
        return g_kq, g_softness if ctx.needs_input_grad[1] else None, None, None, None, None, g_floor


def _joint_deflection_inverse(j_q: Tensor, j_x: Tensor, dx0: Tensor, config: MechanicsConfig) -> Tensor:
    """dq0 (3, B, N) by the regularised inverse of J_q, as the paper writes it; for C = 3 alone, where J_q is square."""
    eye = torch.eye(AXES, dtype=j_q.dtype, device=j_q.device)[..., None, None]
    return -times(inverse_3x3(j_q + config.eps_jq * eye), times(j_x, dx0[:, None]))


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
    config = constants.config
    k_spring, d, gain, gate_params = (batch_last(t).to(dtype) for t in springs)
    c, a, minus_b = (batch_last(t).to(dtype) for t in (contact, j_x, j_q))
    mask = constants.coord_mask.to(dtype).mT[..., None]  # (C, B, 1)
    s = length_scaling(c, constants.length_m)
    w = (w_e.to(dtype) * s).mT.contiguous()  # (6, N)
    eps_m = (constants.eps_m if extras.eps_m is None else extras.eps_m).to(dtype)  # (), (B) or (N, B)
    eps_m = batch_last(eps_m) if eps_m.ndim == 2 else eps_m[..., None]
    eye = torch.eye(AXES, dtype=dtype, device=c.device)[..., None, None]  # (3, 3, 1, 1)
    softness = eps_m * eye  # (3, 3, 1 or B, 1 or N)
    softness = softness.expand(AXES, AXES, *minus_b.shape[2:])
    floor = torch.diag(config.eps_kx * s * s)[..., None]  # (6, 6, 1)
    if extras.twist is not None:
        twist, normal = as_last(dtype, extras.twist, extras.normal)
        floor = floor + _twist_stiffness(twist, normal, c, constants.length_m)
    rest = (w, c, a * s[:, None, None], -minus_b.transpose(0, 1), floor)
    k, x, dq, force, soft_tip = _Statics.apply(k_spring, softness, *rest)
    tip = soft_tip
    dx0 = x * s[:, None]  # (6, N)
    if config.dq0 == "statics":
        dq0 = dq * mask  # the contact flag is in the force already
    else:
        dq0 = _joint_deflection_inverse(minus_b, a, dx0, config) * mask * c
    gated = constants.gated
    if any(gated):
        alpha, beta, rho = gate_params
        gate = torch.sigmoid(alpha * ((dq0 * d).sum(0) - beta) + rho)  # (B, N)
        if not all(gated):
            gate = gate * c.new_tensor(gated)[:, None]
        k_tendon = (gain * gate * d)[:, None] * d  # (C, C, B, N)
    else:
        gate, k_tendon = torch.zeros_like(gain), torch.zeros_like(k_spring)
    if any(gated):
        k, x, _, force, tip = _Statics.apply(k_spring + k_tendon, softness, *rest)
    k_stuck, slid = k, Slide(*(torch.zeros_like(c),) * 4)
    friction, preload = torch.zeros_like(c), torch.zeros_like(force)
    if extras.friction is not None:
        friction, preload, normal, pressing = as_last(
            dtype, extras.friction, extras.preload, extras.normal, extras.normal_force
        )
        across = eye - normal[:, None] * normal  # (3, 3, B, N)
        preload = c * times(across, preload)
        slid = slide(Grip(friction, preload, normal, pressing), force, tip, soft_tip, rest[2], c, k)
        k, x, *_ = _Statics.apply(k_spring + k_tendon, softness + c * slid.compliance * across, *rest)
    k_scaled, k_x = (v.movedim(-1, 0) for v in (k_stuck, k))
    dx = _cut(x * s[:, None], constants.limits)
    branches = (batch_first(t) for t in (dq0, gate, k_tendon))
    of_contacts = (slid.use, slid.compliance, slid.share, slid.pressed, friction, preload)
    contacts = (batch_first(t) for t in of_contacts)
    response = (dx0.mT, *branches, k_scaled, x.mT, k_x / (s[:, None] * s), dx.mT, *contacts)
    return Response(*(t.to(w_e.dtype) for t in response))


def _cut(dx: Tensor, limits: tuple[float, float] | None) -> Tensor:
    """Motions (6, N), each shortened by one factor to `limits` of translation (m) and rotation (rad)."""
    if limits is None:
        return dx
    sizes = torch.stack([torch.linalg.vector_norm(part, dim=0) for part in (dx[:AXES], dx[AXES:])])  # (2, N)
    over = sizes / dx.new_tensor(limits)[:, None]
    return dx / over.amax(0).clamp_min(1)


def _twist_stiffness(twist: Tensor, normal: Tensor, c: Tensor, length_m: float) -> Tensor:
    """A soft finger's stiffness about its normal as part of the scaled K_x: (6, 6, N) from (B, N) and (3, B, N)."""
    about = (c * twist * normal)[:, None] * normal / length_m**2  # (3, 3, B, N)
    return torch.nn.functional.pad(about.sum(2), (0, 0, 3, 0, 3, 0))


def dense_stiffness(
    k_q: Tensor, contact: Tensor, j_x: Tensor, j_q: Tensor, eps_m: Tensor, config: MechanicsConfig
) -> Tensor:
    """K_x (N, 6, 6) by the undivided algebra of the paper; the tests compare it with the sum over branches.

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
