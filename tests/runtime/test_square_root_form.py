"""Why the runtime works on square roots: float32 error of both ways to solve the statics, against float64.

A twin of runtime/src/mechanics.hpp in NumPy, one pass: `square_root` follows the C code, `formed` forms M and K_x and
factorises them (LDL^T, the most accurate of the forming variants). The figures stand in docs/runtime.md.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from runtime_models import random_inputs

LENGTH_M, EPS_KX = 0.1, 1e-3
S = np.array([1, 1, 1, 1 / LENGTH_M, 1 / LENGTH_M, 1 / LENGTH_M])


def factorise(rows: NDArray, weight: NDArray, below: NDArray) -> tuple[NDArray, NDArray]:
    """D (..., n) and U^-1 (..., n, n) of rows^T diag(weight) rows + diag(below) = U^T D U, U with ones on its diagonal.

    Modified Gram-Schmidt on the rows (..., m, n) and an identity below them.
    """
    n = rows.shape[-1]
    v = np.concatenate([rows, np.broadcast_to(np.eye(n, dtype=rows.dtype), (*rows.shape[:-2], n, n))], -2)
    w = np.concatenate([weight, np.broadcast_to(below.astype(rows.dtype), (*weight.shape[:-1], n))], -1)
    d = np.zeros((*rows.shape[:-2], n), rows.dtype)
    for j in range(n):
        products = ((w * v[..., j])[..., None] * v).sum(-2)
        d[..., j] = products[..., j]
        u = products / d[..., j, None]
        v[..., j + 1 :] -= v[..., j, None] * u[..., None, j + 1 :]
    return d, v[..., -n:, :]


def forward(r: NDArray, x: NDArray) -> NDArray:
    """R^-T x, x (..., n, k)."""
    x = x.copy()
    for i in range(r.shape[-1]):
        x[..., i, :] -= (r[..., :i, i, None] * x[..., :i, :]).sum(-2)
        x[..., i, :] /= r[..., i, i, None]
    return x


def backward(r: NDArray, x: NDArray) -> NDArray:
    """R^-1 x."""
    x = x.copy()
    for i in reversed(range(r.shape[-1])):
        x[..., i, :] -= (r[..., i, i + 1 :, None] * x[..., i + 1 :, :]).sum(-2)
        x[..., i, :] /= r[..., i, i, None]
    return x


def ldl_root(k: NDArray) -> NDArray:
    """Upper triangular R with R^T R = k, by right-looking LDL^T."""
    a, n = k.copy(), k.shape[-1]
    r = np.zeros_like(k)
    for j in range(n):
        r[..., j, j:] = a[..., j, j:] / np.sqrt(a[..., j, j])[..., None]
        factor = a[..., j, j + 1 :] / a[..., j, j][..., None]
        a[..., j + 1 :, j + 1 :] -= factor[..., :, None] * a[..., j, None, j + 1 :]
    return r


def square_root(a_s: NDArray, b: NDArray, root_k: NDArray, w_s: NDArray, c: NDArray, eps_m: float) -> NDArray:
    """x_s (n, 6) by square roots, in the type of the inputs."""
    diagonal = np.diagonal(root_k, axis1=-2, axis2=-1)
    g = forward(root_k / diagonal[..., None], np.swapaxes(b, -1, -2))
    d, inverse = factorise(g, 1 / diagonal**2, np.full(3, eps_m))
    v = np.swapaxes(inverse, -1, -2) @ a_s
    d, inverse = factorise(v.reshape(-1, 9, 6), (c[..., None] / d).reshape(-1, 9), EPS_KX * S * S)
    y = (inverse * w_s[..., None]).sum(-2)
    return (inverse * (y / d)[:, None]).sum(-1)


def formed(a_s: NDArray, b: NDArray, root_k: NDArray, w_s: NDArray, c: NDArray, eps_m: float) -> NDArray:
    """x_s (n, 6) by forming M and K_x and factorising them."""
    dtype = a_s.dtype
    g = forward(root_k, np.swapaxes(b, -1, -2))
    y = forward(ldl_root(np.swapaxes(g, -1, -2) @ g + dtype.type(eps_m) * np.eye(3, dtype=dtype)), a_s)
    k = (np.swapaxes(y, -1, -2) @ y * c[..., None, None]).sum(1) + np.diag(EPS_KX * S * S).astype(dtype)
    r = ldl_root(k)
    return backward(r, forward(r, w_s[..., None]))[..., 0]


def states(n: int, contacts: int) -> list[NDArray]:
    """a_s, b, root of K, w_s, contact flags in float64, representable in float32; `contacts` branches in contact."""
    rng = np.random.default_rng(5)
    x = random_inputs(n, 2)
    keep = (x["contacts"][..., 0] == 1).all(1)
    x = {name: value[keep].astype(float) for name, value in x.items()}
    m = len(x["q"])
    root = np.zeros((m, 3, 3, 3))
    for i in range(3):
        root[..., i, i] = 1.3 * np.exp(rng.normal(0, 0.6, (m, 3)))
        root[..., i, i + 1 :] = 0.3 * rng.normal(size=(m, 3, 2 - i))
    c = np.broadcast_to(np.arange(3) < contacts, (m, 3)).astype(float)
    values = (x["j_x"] * S, -x["j_q"], root, x["w_e"] * S, c)
    return [v.astype(np.float32).astype(float) for v in values]


def errors(solve, values: list[NDArray], eps_m: float) -> NDArray:
    """Relative float32 errors of x_s."""
    exact = solve(*values, eps_m)
    got = solve(*(v.astype(np.float32) for v in values), eps_m)
    assert got.dtype == np.float32
    return np.linalg.norm(got - exact, axis=1) / np.linalg.norm(exact, axis=1)


@pytest.mark.parametrize("eps_m", [1e-4, 1e-5])
@pytest.mark.parametrize("contacts", [3, 2, 1])
def test_square_roots_are_far_more_accurate(contacts: int, eps_m: float) -> None:
    values = states(6000, contacts)
    np.testing.assert_allclose(square_root(*values, eps_m), formed(*values, eps_m), rtol=1e-6, atol=1e-12)
    root, form = errors(square_root, values, eps_m), errors(formed, values, eps_m)
    print(
        f"eps_m {eps_m:g}, {contacts} contacts: square roots median {np.median(root):.1e} max {root.max():.1e}, "
        f"formed median {np.median(form):.1e} max {form.max():.1e}"
    )
    assert np.median(root) < 1e-6
    assert root.max() < 5e-4
    assert np.median(form) > 5 * np.median(root)
