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

from .config import MechanicsConfig

AXES = 3
"""Of space."""


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
    slip: Tensor | None = None  # (N, B, 2) friction coefficient, and compliance gained once it is used up, m/N
    normal: Tensor | None = None  # (N, B, 3) contact normals, for twist and slip
    normal_force: Tensor | None = None  # (N, B) before the load, N, for slip


NO_EXTRAS = Extras()


class Constants(NamedTuple):
    """What the layer knows of the hand and of its own settings."""

    config: MechanicsConfig
    coord_mask: Tensor  # (B, C) 1 where the branch has the coordinate
    eps_m: Tensor  # (B) compliance of each contact, m/N; or () where all are the same
    gated: tuple[bool, ...]  # (B) whether the branch has a gated tendon
    length_m: float  # L


class Response(NamedTuple):
    """What the layer returns; names as in `Dims.debug`."""

    dx0: Tensor  # (N, 6) displacement with springs alone
    dq0: Tensor  # (N, B, C) joint deflection of pass 1 in branch coordinates, rad
    gate: Tensor  # (N, B) tendon engagement g_b in (0, 1); 0 where a branch has no gated tendon
    k_tendon: Tensor  # (N, B, C, C) k_b g_b d_b d_b^T, N.m/rad
    k_scaled: Tensor  # (N, 6, 6) K_x with lengths divided by L, N/m
    x_scaled: Tensor  # (N, 6) displacement with rotations times L, m
    k_x: Tensor  # (N, 6, 6) K_x, SI
    dx: Tensor  # (N, 6) displacement, m and rad


def length_scaling(like: Tensor, length_m: float) -> Tensor:
    """Diagonal of S (6) for L = `length_m`, with the type and device of `like`."""
    return torch.tensor([1.0] * 3 + [1.0 / length_m] * 3, dtype=like.dtype, device=like.device)


# Within the layer the batch stands last: (..., branch, N). Products of small matrices are then a few products of long
# vectors, several times as fast as a batch of small products.


def batch_last(t: Tensor) -> Tensor:
    """(N, branch, ...) as (..., branch, N); nothing is copied where that is the order in memory already."""
    return t.movedim((0, 1), (-1, -2)).contiguous()


def _last(dtype: torch.dtype, *tensors: Tensor | None) -> list[Tensor]:
    """Those that are there, in that order and type."""
    return [batch_last(t).to(dtype) for t in tensors if t is not None]


def batch_first(t: Tensor) -> Tensor:
    """The way back, as a view."""
    return t.movedim((-1, -2), (0, 1))


def product(a: Tensor, b: Tensor) -> Tensor:
    """Products of matrices (i, k, ...) and (k, j, ...)."""
    return (a[:, :, None] * b[None]).sum(1)


def _mv(a: Tensor, v: Tensor) -> Tensor:
    """Matrices (i, k, ...) times vectors (k, ...)."""
    return (a * v).sum(1)


def inverse_3x3(m: Tensor) -> Tensor:
    """Inverses of matrices (3, 3, ...) by cofactors, read off the matrix continued cyclically to 5 x 5."""
    tall = torch.cat([m, m[:2]])
    wide = torch.cat([tall, tall[:, :2]], 1)  # (5, 5, ...)
    cofactors = wide[1:4, 1:4] * wide[2:5, 2:5] - wide[1:4, 2:5] * wide[2:5, 1:4]
    return cofactors.transpose(0, 1) / (m[0] * cofactors[0]).sum(0)


def inverse(m: Tensor) -> Tensor:
    """Inverses of symmetric positive definite matrices (n, n, ...), by blocks of at most 3."""
    n = m.shape[0]
    if n == 3:
        return inverse_3x3(m)
    if n == 1:
        return 1 / m
    if n == 2:
        (a, b), (c, d) = m
        return torch.stack([d, -b, -c, a]).unflatten(0, (2, 2)) / (a * d - b * c)
    head = inverse(m[:3, :3])
    coupling = product(head, m[:3, 3:])
    tail = inverse(m[3:, 3:] - product(m[3:, :3], coupling))
    mixed = -product(coupling, tail)
    upper = torch.cat([head - product(mixed, coupling.transpose(0, 1)), mixed], 1)
    return torch.cat([upper, torch.cat([mixed.transpose(0, 1), tail], 1)])


def packed_cholesky(k: Tensor, entries: tuple[tuple[int, int], ...]) -> Tensor:
    """Cholesky factors of symmetric positive definite matrices; `entries` says where each number of k (n, ...) is."""
    at = dict(zip(entries, k, strict=True))
    low: dict[tuple[int, int], Tensor] = {}
    for row, col in sorted(entries, key=lambda entry: (entry[1], entry[0])):
        rest = at[row, col]
        for i in range(col):
            rest = rest - low[row, i] * low[col, i]
        low[row, col] = rest.sqrt() if row == col else rest / low[col, col]
    return torch.stack([low[entry] for entry in entries])


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
    rotation = _mv(factor.schur, w[3:] - _mv(factor.coupling.transpose(0, 1), w[:3]))
    return torch.cat([_mv(factor.inverse, w[:3]) - _mv(factor.coupling, rotation), rotation])


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
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Scaled K_x (6, 6, N), scaled displacement (6, N), joint deflections (C, B, N) and forces (3, B, N)."""
        compliance = inverse(k_q)  # (C, C, B, N)
        cb = product(compliance, b_t)  # (C, 3, B, N) K^-1 B^T
        p = inverse_3x3(product(b_t.transpose(0, 1), cb) + softness)  # (3, 3, B, N) stiffness of a fingertip
        wa = product(p, a)  # (3, 6, B, N) its force by motion of the tool
        k = sum(product(a[:, :, i].transpose(0, 1), c[i] * wa[:, :, i]) for i in range(c.shape[0]))
        k = k + floor  # (6, 6, N)
        factor = _factorise(k)
        x = _solve(factor, w)
        v = _mv(wa, x[:, None])  # (3, B, N) force on a fingertip in contact
        dq = _mv(cb, v)  # (C, B, N)
        ctx.save_for_backward(c, a, b_t, compliance, cb, p, wa, x, v, dq, *factor)
        ctx.set_materialize_grads(False)
        return k, x, c * dq, c * v

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple:  # type: ignore[override]
        g_k, g_x, g_dq, g_f = gradients  # None where a result was not used
        c, a, b_t, compliance, cb, p, wa, x, v, dq, *parts = ctx.saved_tensors
        factor = _Factor(*parts)
        g_x = wa.new_zeros(wa.shape[1], wa.shape[-1]) if g_x is None else g_x
        soft, y = torch.zeros_like(dq), torch.zeros_like(v)
        if g_dq is not None or g_f is not None:  # these depend on stiffness and contact directly, not only through x
            soft = soft if g_dq is None else c * _mv(compliance, g_dq)  # (C, B, N)
            y = _mv(p, _mv(b_t.transpose(0, 1), soft) + (0.0 if g_f is None else c * g_f))  # (3, B, N)
            g_x = g_x + _mv(a.transpose(0, 1), y).sum(1)
        adjoint = _solve(factor, g_x)  # (6, N)
        u = c * _mv(wa, adjoint[:, None]) - y  # (3, B, N)
        g_kq = (_mv(cb, u) + soft)[:, None] * -dq
        g_softness = u[:, None] * v
        if g_k is not None:
            cwg = c * product(wa, g_k[:, :, None])  # (3, 6, B, N)
            g_softness = g_softness - product(cwg, wa.transpose(0, 1))
            g_kq = g_kq + product(product(cb, cwg), product(cb, wa).transpose(0, 1))
        g_floor = None
        if ctx.needs_input_grad[6]:
            g_floor = -adjoint[:, None] * x + (0.0 if g_k is None else g_k)
        return g_kq, g_softness if ctx.needs_input_grad[1] else None, None, None, None, None, g_floor


def _joint_deflection_inverse(j_q: Tensor, j_x: Tensor, dx0: Tensor, config: MechanicsConfig) -> Tensor:
    """dq0 (3, B, N) by the regularised inverse of J_q, as the paper writes it; for C = 3 alone, where J_q is square."""
    eye = torch.eye(AXES, dtype=j_q.dtype)[..., None, None]
    return -_mv(inverse_3x3(j_q + config.eps_jq * eye), _mv(j_x, dx0[:, None]))


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
    softness = eps_m * torch.eye(AXES, dtype=dtype)[..., None, None]  # (3, 3, 1 or B, 1 or N)
    softness = softness.expand(AXES, AXES, *minus_b.shape[2:])
    floor = torch.diag(config.eps_kx * s * s)[..., None]  # (6, 6, 1)
    if extras.twist is not None:
        twist, normal = _last(dtype, extras.twist, extras.normal)
        floor = floor + _twist_stiffness(twist, normal, c, constants.length_m)
    rest = (w, c, a * s[:, None, None], -minus_b.transpose(0, 1), floor)
    k, x, dq, force = _Statics.apply(k_spring, softness, *rest)
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
            gate = gate * torch.tensor(gated, dtype=dtype)[:, None]
        k_tendon = (gain * gate * d)[:, None] * d  # (C, C, B, N)
    else:
        gate, k_tendon = torch.zeros_like(gain), torch.zeros_like(k_spring)
    if extras.slip is not None:
        softness = softness + _slip_softness(force, *_last(dtype, extras.slip, extras.normal, extras.normal_force))
    if any(gated) or extras.slip is not None:
        k, x, _, _ = _Statics.apply(k_spring + k_tendon, softness, *rest)
    k_scaled = k.movedim(-1, 0)
    branches = (batch_first(t) for t in (dq0, gate, k_tendon))
    response = (dx0.mT, *branches, k_scaled, x.mT, k_scaled / (s[:, None] * s), (x * s[:, None]).mT)
    return Response(*(t.to(w_e.dtype) for t in response))


def _twist_stiffness(twist: Tensor, normal: Tensor, c: Tensor, length_m: float) -> Tensor:
    """A soft finger's stiffness about its normal as part of the scaled K_x: (6, 6, N) from (B, N) and (3, B, N)."""
    about = (c * twist * normal)[:, None] * normal / length_m**2  # (3, 3, B, N)
    return torch.nn.functional.pad(about.sum(2), (0, 0, 3, 0, 3, 0))


def _slip_softness(force: Tensor, slip: Tensor, normal: Tensor, normal_force: Tensor) -> Tensor:
    """Compliance (3, 3, B, N) that contacts gain along their tangent planes as the load uses up their friction.

    force (3, B, N) is what pass 1 adds to each contact, slip (2, B, N) a friction coefficient and a compliance (m/N).
    """
    friction, compliance = slip
    along = (force * normal).sum(0)  # (B, N)
    tangential = force - along * normal
    size = torch.sqrt((tangential * tangential).sum(0) + 1e-8)
    limit = friction * torch.nn.functional.softplus(normal_force - along, beta=4.0) + 0.02
    excess = torch.nn.functional.softplus(4.0 * (size / limit - 1)) / 4.0
    eye = torch.eye(AXES, dtype=force.dtype)[..., None, None]
    return compliance * excess * (eye - normal[:, None] * normal)


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
    eye6 = torch.eye(N_WRENCH, dtype=k_q.dtype)
    return big_jx.mT @ torch.linalg.inv(middle) @ big_jx + config.eps_kx * eye6
