"""Algebra of many small matrices: the batch stands last, (..., branch, N).

Products of small matrices are then a few products of long vectors, several times as fast as a batch of small products.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


def batch_last(t: Tensor) -> Tensor:
    """(N, branch, ...) as (..., branch, N); nothing is copied where that is the order in memory already."""
    return t.movedim((0, 1), (-1, -2)).contiguous()


def as_last(dtype: torch.dtype, *tensors: Tensor | None) -> list[Tensor]:
    """Those that are there, in that order and type."""
    return [batch_last(t).to(dtype) for t in tensors if t is not None]


def batch_first(t: Tensor) -> Tensor:
    """The way back, as a view."""
    return t.movedim((-1, -2), (0, 1))


def product(a: Tensor, b: Tensor) -> Tensor:
    """Products of matrices (i, k, ...) and (k, j, ...)."""
    return (a[:, :, None] * b[None]).sum(1)


def times(a: Tensor, v: Tensor) -> Tensor:
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


class _Inverse(torch.autograd.Function):
    """`inverse` and its adjoint."""

    @staticmethod
    def forward(ctx: Any, m: Tensor) -> Tensor:  # type: ignore[override]
        found = inverse(m)
        ctx.save_for_backward(found)
        return found

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:  # type: ignore[override]
        (found,) = ctx.saved_tensors
        turned = found.transpose(0, 1)
        return -product(product(turned, gradients[0]), turned)


def differentiable_inverse(m: Tensor) -> Tensor:
    """`inverse` whose gradient is two products."""
    return _Inverse.apply(m)
