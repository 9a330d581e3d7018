"""How sure a model is of its motion: how likely a contact slides, and a bound that its pose error seldom passes.

Both are linear in what stage 2 knows: its feature, and in logarithm the size of the motion and, where contacts can
slide, what their friction says. The bound is corrected by one factor for each bin of the probability, so that it holds
on load cases that no weight was fitted to (`training.sure`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from aminn_hand.hand import MAX_LOG_BOUND

from .normaliser import Normaliser

BINS = 4
"""Of p_slide."""
LEAST_SPREAD = 0.1
"""Of a logarithm, as of the inputs of networks."""


class Sure(nn.Module):
    """p_slide and bound_95 of a model; without a fit 0.5 and 1, which say nothing."""

    edge: Tensor
    factor: Tensor

    def __init__(self, feature: int, statics: int) -> None:
        """Sizes of what `forward` takes."""
        super().__init__()
        self.norm = Normaliser(statics)
        self.out = nn.utils.skip_init(nn.Linear, feature + statics, 2)  # which draws nothing
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.register_buffer("edge", torch.arange(1, BINS) / BINS)  # (3) where a bin begins, ascending
        self.register_buffer("factor", torch.ones(BINS))  # (4)

    def seen(self, feature: Tensor, statics: Tensor) -> Tensor:
        """What the weights are applied to: (N, feature + statics)."""
        return torch.cat([feature, self.norm(statics)], -1)

    def bin(self, p_slide: Tensor) -> Tensor:
        """Bin (N) of each probability (N), 0 to 3."""
        return (p_slide[..., None] >= self.edge).sum(-1)

    def forward(self, feature: Tensor, statics: Tensor) -> tuple[Tensor, Tensor]:
        """p_slide (N): the probability that a contact slides by more than 0.5 mm, if the grasp holds.

        bound_95 (N): the pose error (translation by L, and angle) that is not exceeded in 95 of 100.
        """
        logit, log_bound = self.out(self.seen(feature, statics)).unbind(-1)
        p_slide = torch.sigmoid(logit)
        return p_slide, torch.exp(log_bound.clamp_max(MAX_LOG_BOUND)) * self.factor[self.bin(p_slide)]
