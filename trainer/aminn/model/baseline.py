"""The black box to compare with: a cascade of two MLPs with AMINN's inputs, budget, schedule and seeds.

Each stage has as many trainable parameters as AMINN's stage, within 2 %. It has the same care too: normalised inputs,
the wrench also in signed logarithm, outputs in units of the data's spread.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from aminn_hand import Dims, Hand
from aminn_hand.hand import N_WRENCH

from .config import ModelConfig
from .mechanics import AXES
from .network import (
    Cascade,
    Stage1,
    Stage2,
    contact_input,
    contact_spread,
    global_input,
    global_spread,
    log_motion,
    scaled_pose,
    sensing_columns,
)
from .normaliser import Normaliser
from .sure import Sure


def input_spread(dims: Dims) -> tuple[float, ...]:
    """Of all that AMINN sees. The translation columns of J_x are identities times the contact flag, there already."""
    return contact_spread(dims) + global_spread(dims) + (0.005,) * (dims.branches * AXES * AXES)


def n_parameters(module: nn.Module) -> int:
    """Trainable parameters."""
    return sum(p.numel() for p in module.parameters() if p.requires_grad)


def width_for(budget: int, n_in: int, n_out: int) -> int:
    """Hidden width whose MLP has the parameter count nearest to `budget`."""

    def count(width: int) -> int:
        return (n_in + 1) * width + (width + 1) * width + (width + 1) * n_out

    return min(range(1, 1024), key=lambda width: abs(count(width) - budget))


class MlpStage(nn.Module):
    """Two hidden layers; the output is a logit, or a displacement in units of the training data's spread."""

    wrench_log_scale: Tensor
    out_scale: Tensor

    def __init__(self, config: ModelConfig, dims: Dims, budget: int, n_out: int) -> None:
        super().__init__()
        self.spread, self.dims = input_spread(dims), dims
        n_in = len(self.spread)
        width = width_for(budget, n_in, n_out)
        self.register_buffer("wrench_log_scale", torch.tensor(config.wrench_log_scale))
        self.register_buffer("out_scale", torch.ones(n_out))
        self.norm = Normaliser(n_in)
        self.hidden1 = nn.Linear(n_in, width)
        self.hidden2 = nn.Linear(width, width)
        self.out = nn.Linear(width, n_out)

    def network_input(self, x: dict[str, Tensor]) -> Tensor:
        """(N, B (17 + 3C) + `Dims.global_input`)."""
        state = global_input(x, self.wrench_log_scale, self.dims)
        lever = x["j_x"][..., 3:].flatten(1)  # (N, 9B)
        return torch.cat([contact_input(x["contacts"], x["j_q"]), state, lever], -1)

    def fit_normalisers(self, x: dict[str, Tensor]) -> None:
        """Take the normalisation constants from training inputs."""
        self.norm.fit(self.network_input(x), self.spread, sensing_columns(self.dims, self.dims.contact_input))

    def features(self, x: dict[str, Tensor]) -> Tensor:
        """The last hidden layer (N, width)."""
        hidden = torch.relu(self.hidden1(self.norm(self.network_input(x))))  # (N, width)
        return torch.relu(self.hidden2(hidden))

    def result(self, f: Tensor) -> Tensor:
        """Of the last hidden layer: (N, n_out)."""
        return self.out(f) * self.out_scale

    def forward(self, x: dict[str, Tensor]) -> Tensor:
        return self.result(self.features(x))


class Mlp(Cascade):
    """The cascade: stage 1 gives a logit, stage 2 a displacement."""

    kind = "mlp"

    def __init__(self, config: ModelConfig, hand: Hand) -> None:
        super().__init__()
        self.config, self.hand = config, hand
        dims = config.dims(hand)
        self.stage1 = MlpStage(config, dims, n_parameters(Stage1(config, hand)), 1)
        self.stage2 = MlpStage(config, dims, n_parameters(Stage2(config, hand)), N_WRENCH)
        self.sure = Sure(self.stage2.out.in_features, 1)

    def outputs(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        """p_stable (N), dx_ht (N, 6), p_slide (N), bound_95 (N).

        theta is without effect unless the model is told, sensors unless it has them.
        """
        feature, statics, dx = self.seen_by_sure(x)
        p_slide, bound = self.sure(feature, statics)
        p_stable = torch.sigmoid(self.stage1(x).squeeze(-1))
        return {"p_stable": p_stable, "dx_ht": dx, "p_slide": p_slide, "bound_95": bound}

    def seen_by_sure(self, x: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        f = self.stage2.features(x)
        dx = self.stage2.result(f)
        size = torch.linalg.vector_norm(scaled_pose(dx, self.hand.length_m), dim=-1, keepdim=True)
        return f, log_motion(size, self.config), dx
