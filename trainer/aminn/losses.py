"""Training losses of stage 2; stage 1 has binary cross-entropy on its logit.

Norms, not squares: a few large slips carry most of the squared error and would drown the many small motions.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .dims import LENGTH_SCALE_M
from .mechanics import Response


@dataclass(frozen=True)
class LossWeights:
    """Weights of the stage 2 loss."""

    translation: float = 1.0
    """On |dp error| / 0.1 m."""
    rotation: float = 1.0
    """On the geodesic angle, rad."""
    relative: float = 0.02
    """Pose size above which an error counts by its share of the motion rather than by its size."""
    gate: float = 1e-4
    """On mean g (1 - g): gates that are open or shut."""
    tendon: float = 1e-5
    """On mean K_tendon^2, (N.m/rad)^2: no more tendon stiffness than the data asks for."""


def _quaternion(rotvec: Tensor) -> Tensor:
    half = 0.5 * torch.sqrt((rotvec * rotvec).sum(-1, keepdim=True) + 1e-24)
    return torch.cat([torch.cos(half), 0.5 * rotvec * torch.sinc(half / torch.pi)], -1)


def geodesic_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle (N) between rotation vectors a and b (N, 3), smooth at zero."""
    qa, qb = _quaternion(a), _quaternion(b)
    scalar = (qa * qb).sum(-1)
    vector = qa[..., :1] * qb[..., 1:] - qb[..., :1] * qa[..., 1:] - torch.linalg.cross(qa[..., 1:], qb[..., 1:])
    return 2 * torch.atan2(torch.sqrt((vector * vector).sum(-1) + 1e-14), scalar.abs())


def pose_loss(pred: Tensor, true: Tensor, weights: LossWeights) -> Tensor:
    """Mean over samples of the weighted pose error, (N, 6) against (N, 6)."""
    dp = (pred[:, :3] - true[:, :3]) / LENGTH_SCALE_M
    translation = torch.sqrt((dp * dp).sum(-1) + 1e-14)
    angle = geodesic_angle(pred[:, 3:], true[:, 3:])
    size = torch.sqrt((true[:, :3] ** 2).sum(-1) / LENGTH_SCALE_M**2 + (true[:, 3:] ** 2).sum(-1))
    scale = weights.relative / (weights.relative + size)
    return (scale * (weights.translation * translation + weights.rotation * angle)).mean()


def structural_loss(response: Response, weights: LossWeights) -> Tensor:
    """The paper's regularisers: decided gates and little tendon stiffness."""
    gate = (response.gate * (1 - response.gate)).mean()
    return weights.gate * gate + weights.tendon * (response.k_tendon**2).mean()
