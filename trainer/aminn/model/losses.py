"""Training losses of stage 2; stage 1 has binary cross-entropy on its logit.

Norms, not squares: a few large slips carry most of the squared error and would drown the many small motions.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .config import LossWeights
from .mechanics import Response, Springs


def _quaternion(rotvec: Tensor) -> Tensor:
    half = 0.5 * torch.sqrt((rotvec * rotvec).sum(-1, keepdim=True) + 1e-24)
    return torch.cat([torch.cos(half), 0.5 * rotvec * torch.sinc(half / torch.pi)], -1)


def geodesic_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle (N) between rotation vectors a and b (N, 3), smooth at zero."""
    qa, qb = _quaternion(a), _quaternion(b)
    scalar = (qa * qb).sum(-1)
    vector = qa[..., :1] * qb[..., 1:] - qb[..., :1] * qa[..., 1:] - torch.linalg.cross(qa[..., 1:], qb[..., 1:])
    return 2 * torch.atan2(torch.sqrt((vector * vector).sum(-1) + 1e-14), scalar.abs())


def pose_terms(pred: Tensor, true: Tensor, weights: LossWeights, length_m: float) -> dict[str, Tensor]:
    """Weighted translation and rotation error, means over samples of (N, 6) against (N, 6); L = `length_m`."""
    dp = (pred[:, :3] - true[:, :3]) / length_m
    translation = torch.sqrt((dp * dp).sum(-1) + 1e-14)
    angle = geodesic_angle(pred[:, 3:], true[:, 3:])
    size = torch.sqrt((true[:, :3] ** 2).sum(-1) / length_m**2 + (true[:, 3:] ** 2).sum(-1))
    scale = weights.relative / (weights.relative + size)
    if weights.power != 1:
        translation, angle = translation**weights.power, angle**weights.power
    return {
        "translation": weights.translation * (scale * translation).mean(),
        "rotation": weights.rotation * (scale * angle).mean(),
    }


def structural_terms(
    springs: Springs, response: Response, taut: Tensor, weights: LossWeights, gated: Sequence[bool]
) -> dict[str, Tensor]:
    """The paper's regularisers, decided gates and little tendon stiffness, and gates that agree with `taut` (N, B).

    Nobody knows which tendons are taut where `taut` has no columns, and gates agree with nothing then.
    Over the branches that are `gated`; nothing for a hand without tendons. The mean of K_tendon^2 follows from gains
    and gates alone, since |d| = 1.
    """
    if not any(gated):
        return {}
    gates, gains = response.gate, springs.tendon_gain
    if not all(gated):
        own = [b for b, has in enumerate(gated) if has]
        gates, gains, taut = gates[:, own], gains[:, own], taut[:, own] if taut.shape[1] else taut
    gate = (gates * (1 - gates)).mean()
    tendon = ((gains * gates) ** 2).mean() / springs.tendon_dir.shape[-1] ** 2
    terms = {"gate": weights.gate * gate}
    if taut.shape[1]:
        engagement = torch.nn.functional.binary_cross_entropy(gates.clamp(1e-6, 1 - 1e-6), taut)
        terms["engagement"] = weights.engagement * engagement
    return terms | {"tendon": weights.tendon * tendon}
