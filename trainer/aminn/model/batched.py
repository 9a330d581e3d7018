"""Algebra of many small matrices: the batch stands last, (..., branch, N).

Products of small matrices are then a few products of long vectors, several times as fast as a batch of small products.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor


def batch_last(t: Tensor) -> Tensor:
    """(N, branch, ...) as (..., branch, N); nothing is copied where that is the order in memory already."""
    return t.movedim((0, 1), (-1, -2)).contiguous()


def reversed_axes(t: Tensor) -> Tensor:
    """(N, branch, i, j) as (j, i, branch, N): matrices of each branch, transposed."""
    return t.permute(*range(t.ndim - 1, -1, -1)).contiguous()


def batch_first(t: Tensor) -> Tensor:
    """The way back from `batch_last`, as a view."""
    return t.movedim((-1, -2), (0, 1))


def product(a: Tensor, b: Tensor) -> Tensor:
    """Products of matrices (i, k, ...) and (k, j, ...)."""
    return (a[:, :, None] * b[None]).sum(1)


def times(a: Tensor, v: Tensor) -> Tensor:
    """Matrices (i, k, ...) times vectors (k, ...)."""
    return (a * v).sum(1)


def transposed_times(a: Tensor, v: Tensor) -> Tensor:
    """Vectors (i, ...) times matrices (i, k, ...)."""
    return (a * v[:, None]).sum(0)


def outer(a: Tensor, b: Tensor) -> Tensor:
    """Sums over branches of products of matrices (i, k, B, N) and transposed (j, k, B, N): (i, j, N)."""
    return (a.flatten(1, 2)[:, None] * b.flatten(1, 2)).sum(2)


def add_to_diagonal(m: Tensor, v: Tensor | float) -> Tensor:
    """Matrices (i, i, ...) after v was added to their diagonals (i, ...), in place."""
    diagonal = m.diagonal(dim1=0, dim2=1)  # (..., i)
    diagonal.add_(v.movedim(0, -1) if isinstance(v, Tensor) else v)
    return m


@cache
def _cofactors(device: torch.device) -> Tensor:
    """Which numbers of a flat 3 x 3 matrix the adjugate takes: two factors of a product, two of what it is less."""
    i, j = np.indices((3, 3))
    at = [3 * ((j + a) % 3) + (i + b) % 3 for a, b in ((1, 1), (2, 2), (1, 2), (2, 1))]
    return torch.tensor(np.ravel(at), device=device)


def inverse_3x3(m: Tensor) -> Tensor:
    """Inverses of matrices (3, 3, ...) by cofactors."""
    a, b, c, d = m.flatten(0, 1).index_select(0, _cofactors(m.device)).unflatten(0, (4, 3, 3))
    adjugate = torch.addcmul(a * b, c, d, value=-1)
    return adjugate / (m[0] * adjugate[:, 0]).sum(0)


def inverse_stiff(m: Tensor) -> Tensor:
    """Inverses of positive definite matrices (n, n, ...) with eigenvalues of many sizes, whose cofactors would be lost.

    Row 0 is eliminated, so that what is left of the others is rounded beside its own size.
    """
    if m.shape[0] < 3:
        return inverse(m)
    row = m[0, 1:] / m[0, 0]  # (n - 1, ...)
    tail = inverse_stiff(m[1:, 1:] - m[1:, :1] * row)
    upper = -times(tail, row)
    corner = 1 / m[0, 0] - (row * upper).sum(0)
    first = torch.cat([corner[None], upper])
    return torch.cat([first[None], torch.cat([upper[:, None], tail], 1)])


def inverse(m: Tensor, symmetric: bool = True) -> Tensor:
    """Inverses of matrices (n, n, ...) that need no pivoting, as positive definite ones, by blocks of at most 3."""
    n = m.shape[0]
    if n == 3:
        return inverse_3x3(m)
    if n == 1:
        return 1 / m
    if n == 2:
        (a, b), (c, d) = m
        return torch.stack([d, -b, -c, a]).unflatten(0, (2, 2)) / (a * d - b * c)
    head = inverse(m[:3, :3], symmetric)
    right = product(head, m[:3, 3:])
    tail = inverse(m[3:, 3:] - product(m[3:, :3], right), symmetric)
    upper = product(right, tail)  # less its sign
    left = right.transpose(0, 1) if symmetric else product(m[3:, :3], head)
    lower = upper.transpose(0, 1) if symmetric else product(tail, left)
    corner = head + product(upper, left)
    return torch.cat([torch.cat([corner, -upper], 1), torch.cat([-lower, tail], 1)])


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
