"""Constants that bring inputs of a network to a common scale."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Normaliser(nn.Module):
    """(v - mean) / std with constants that live in the model."""

    mean: Tensor
    inv_std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("inv_std", torch.ones(size))

    def fit(self, v: Tensor, least_spread: tuple[float, ...], optional: slice = slice(0, 0)) -> None:
        """Take the constants from data (n, size); no column is scaled by less than its `least_spread`.

        Of the `optional` columns those that never vary in the data are left out: nothing was learned of them.
        """
        self.mean.copy_(v.mean(0))
        spread = v.std(0)
        self.inv_std.copy_(1 / torch.maximum(spread, spread.new_tensor(least_spread)))
        self.inv_std[optional][(v[:, optional] == v[:1, optional]).all(0)] = 0

    def forward(self, v: Tensor) -> Tensor:
        return (v - self.mean) * self.inv_std
