"""The two-pass statics layer: springs and tendons in, stiffness and displacement out.

With A_b and B_b the blocks of the closure A_b dx = B_b dq_b (J_x stacks A_b, J_q stacks -B_b), the stiffness of the
grasped tool is a sum over branches (the paper's eq. for K_x with block-diagonal K_q and J_q; `dense_stiffness` is the
undivided form, kept for the test that shows the two equal):

    K_x = sum_b c_b A_b^T (B_b K_b^-1 B_b^T + eps_M I)^-1 A_b + eps_Kx I

c_b in [0, 1] is the branch's contact flag: a branch out of contact leaves the sum exactly. The 6x6 solve works on
lengths divided by L = 0.1 m (`S = diag(1, 1, 1, 1/L, 1/L, 1/L)`), since metres and radians in one matrix cost a factor
of 1e3 in conditioning for nothing. All tensors lead with a batch dimension N; units are SI, axes are those of the hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from .dims import LENGTH_SCALE_M, N_COORD, N_WRENCH

DQ0_KINDS = ("statics", "inverse")


@dataclass(frozen=True)
class MechanicsConfig:
    """Constants of the layer."""

    eps_m: float = 1e-5
    """Isotropic contact compliance added to every branch, m/N. It also bounds the conditioning in float32."""
    eps_kx: float = 1e-3
    """Stiffness added to the diagonal of K_x: N/m for translation, N.m/rad for rotation."""
    eps_jq: float = 1e-3
    """Regularisation of J_q in the "inverse" form of dq0, m/rad."""
    dq0: str = "statics"
    """How pass 1 finds the joint deflection: "statics" (K^-1 B^T force) or "inverse" (of J_q, as in the paper)."""


class Springs(NamedTuple):
    """What the mechanics head predicts for one stage."""

    k_spring: Tensor  # (N, 3, 3, 3) joint stiffness K_s of each branch, N.m/rad, SPD
    tendon_dir: Tensor  # (N, 3, 3) tendon direction d_b, unit vector in branch coordinates
    tendon_gain: Tensor  # (N, 3) k_b > 0, N.m/rad
    gate_params: Tensor  # (N, 3, 3) alpha (1/rad), beta (rad), rho


class Response(NamedTuple):
    """What the layer returns; names as in `dims.DEBUG_SHAPES`."""

    dx0: Tensor  # (N, 6) displacement with springs alone
    dq0: Tensor  # (N, 3, 3) joint deflection of pass 1 in branch coordinates, rad
    gate: Tensor  # (N, 3) tendon engagement g_b in (0, 1)
    k_tendon: Tensor  # (N, 3, 3, 3) k_b g_b d_b d_b^T, N.m/rad
    k_scaled: Tensor  # (N, 6, 6) K_x with lengths divided by L, N/m
    x_scaled: Tensor  # (N, 6) displacement with rotations times L, m
    k_x: Tensor  # (N, 6, 6) K_x, SI
    dx: Tensor  # (N, 6) displacement, m and rad


def inverse_3x3(m: Tensor) -> Tensor:
    """Inverse of (..., 3, 3) matrices by cofactors: the columns' cross products over the determinant."""
    a, b, c = m.unbind(-1)
    rows = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], -2)
    det = (a * rows[..., 0, :]).sum(-1)
    return rows / det[..., None, None]


def solve_spd(k: Tensor, w: Tensor) -> Tensor:
    """Solve K x = w for symmetric positive definite K (..., n, n), w (..., n)."""
    return torch.cholesky_solve(w.unsqueeze(-1), torch.linalg.cholesky(k)).squeeze(-1)


def length_scaling(like: Tensor) -> Tensor:
    """Diagonal of S (6), with the type and device of `like`."""
    return torch.tensor([1.0] * 3 + [1.0 / LENGTH_SCALE_M] * 3, dtype=like.dtype, device=like.device)


class _Pass(NamedTuple):
    k_scaled: Tensor  # (N, 6, 6)
    x_scaled: Tensor  # (N, 6)
    dq: Tensor  # (N, 3, 3) joint deflection from statics


def _statics(
    k_q: Tensor, w_s: Tensor, contact: Tensor, a_s: Tensor, b: Tensor, s: Tensor, config: MechanicsConfig
) -> _Pass:
    """One pass: joint stiffness k_q (N, 3, 3, 3), scaled wrench w_s (N, 6), a_s (N, 3, 3, 6), b (N, 3, 3, 3)."""
    eye = torch.eye(N_COORD, dtype=k_q.dtype, device=k_q.device)
    c_b = inverse_3x3(k_q) @ b.mT  # (N, 3, 3, 3) K^-1 B^T
    stiffness = inverse_3x3(b @ c_b + config.eps_m * eye)  # (N, 3, 3, 3) of each fingertip
    wa = contact[..., None, None] * (stiffness @ a_s)  # (N, 3, 3, 6)
    k_scaled = (a_s.mT @ wa).sum(1) + torch.diag(config.eps_kx * s * s)  # (N, 6, 6)
    x_s = solve_spd(k_scaled, w_s)  # (N, 6)
    force = (wa @ x_s[:, None, :, None]).squeeze(-1)  # (N, 3, 3) change of contact force on each fingertip
    return _Pass(k_scaled, x_s, (c_b @ force.unsqueeze(-1)).squeeze(-1))


def _joint_deflection_inverse(j_q: Tensor, j_x: Tensor, dx0: Tensor, config: MechanicsConfig) -> Tensor:
    """dq0 (N, 3, 3) by the regularised inverse of J_q, as the paper writes it."""
    eye = torch.eye(N_COORD, dtype=j_q.dtype, device=j_q.device)
    motion = j_x @ dx0[:, None, :, None]  # (N, 3, 3, 1)
    return -(inverse_3x3(j_q + config.eps_jq * eye) @ motion).squeeze(-1)


def two_pass(
    springs: Springs,
    w_e: Tensor,
    contact: Tensor,
    j_x: Tensor,
    j_q: Tensor,
    coord_mask: Tensor,
    config: MechanicsConfig,
) -> Response:
    """Displacement under w_e (N, 6) with contact (N, 3), j_x (N, 3, 3, 6), j_q (N, 3, 3, 3), coord_mask (3, 3).

    Pass 1 takes the springs alone and finds how far each tendon would be stretched. The gates follow from that, and
    pass 2 adds the engaged tendons. K_x is SPD, so w.dx > 0 for every wrench that is not zero. The arithmetic is in
    float64 whatever the inputs are (results come back in the type of w_e): forming K_x squares the conditioning, which
    the exported models avoid by the square-root form of docs/mechanics.md.
    """
    dtype = w_e.dtype
    springs = Springs(*(t.double() for t in springs))
    w_e, contact, j_x, j_q, coord_mask = (t.double() for t in (w_e, contact, j_x, j_q, coord_mask))
    s = length_scaling(w_e)
    a_s, b, w_s = j_x * s, -j_q, w_e * s
    first = _statics(springs.k_spring, w_s, contact, a_s, b, s, config)
    dx0 = first.x_scaled * s
    if config.dq0 == "statics":
        dq0 = first.dq * coord_mask  # the contact flag is in the force already
    else:
        dq0 = _joint_deflection_inverse(j_q, j_x, dx0, config) * coord_mask * contact[..., None]
    d = springs.tendon_dir
    alpha, beta, rho = springs.gate_params.unbind(-1)
    gate = torch.sigmoid(alpha * ((dq0 * d).sum(-1) - beta) + rho)  # (N, 3)
    k_tendon = (springs.tendon_gain * gate)[..., None, None] * d[..., :, None] * d[..., None, :]
    second = _statics(springs.k_spring + k_tendon, w_s, contact, a_s, b, s, config)
    k_x = second.k_scaled / (s[:, None] * s)
    response = (dx0, dq0, gate, k_tendon, second.k_scaled, second.x_scaled, k_x, second.x_scaled * s)
    return Response(*(t.to(dtype) for t in response))


def dense_stiffness(k_q: Tensor, contact: Tensor, j_x: Tensor, j_q: Tensor, config: MechanicsConfig) -> Tensor:
    """K_x (N, 6, 6) by the undivided 9x9 algebra of the paper; the tests hold it against the sum over branches.

    A branch out of contact is left out of the stacked matrices by scaling its rows of J_x.
    """
    n = k_q.shape[0]
    big_k = torch.stack([torch.block_diag(*blocks) for blocks in k_q])  # (N, 9, 9)
    big_jq = torch.stack([torch.block_diag(*blocks) for blocks in j_q])  # (N, 9, 9)
    big_jx = (j_x * contact.sqrt()[..., None, None]).reshape(n, -1, N_WRENCH)  # (N, 9, 6)
    eye9 = torch.eye(big_k.shape[-1], dtype=k_q.dtype)
    middle = big_jq @ torch.linalg.inv(big_k) @ big_jq.mT + config.eps_m * eye9
    eye6 = torch.eye(N_WRENCH, dtype=k_q.dtype)
    return big_jx.mT @ torch.linalg.inv(middle) @ big_jx + config.eps_kx * eye6
