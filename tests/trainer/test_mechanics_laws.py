"""Laws of statics that the two-pass layer obeys for any springs, loads and contacts: searched by hypothesis."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from test_mechanics import EPS_M, HAND, draw, random_springs, respond
from torch import Tensor

from aminn.model.mechanics import MechanicsConfig, Springs

N = 20
X = draw(HAND, N)
CONTACT = X["contacts"][..., 0]
MASK = torch.tensor(HAND.coordinate_mask)
CONFIG = MechanicsConfig()
few = settings(max_examples=25, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)
exponents = st.floats(-2, 2)


def springs_of(seed: int, exponent: float) -> Springs:
    """Springs from soft to stiff, each branch otherwise."""
    base = random_springs(HAND, N)
    spread = torch.rand(N, HAND.dims.branches, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    factor = 10.0 ** (exponent + spread)
    return base._replace(k_spring=base.k_spring * factor[..., None, None], tendon_gain=base.tendon_gain * factor)


def work(dx: Tensor) -> Tensor:
    return (X["w_e"] * dx).sum(-1)


@few
@given(seeds, exponents, exponents)
def test_stiffer_springs_and_tendons_never_move_more_along_the_load(seed: int, soft: float, more: float) -> None:
    springs = springs_of(seed, soft)
    g = torch.Generator().manual_seed(seed)
    factor = torch.randn(N, *springs.k_spring.shape[1:], generator=g, dtype=torch.float64) * MASK[:, :, None]
    stiffer = springs._replace(k_spring=springs.k_spring + 10.0**more * factor @ factor.mT)
    before = respond(springs, X, CONFIG)
    assert (work(respond(stiffer, X, CONFIG).dx0) <= work(before.dx0) * (1 + 1e-9)).all()
    tighter = springs._replace(tendon_gain=springs.tendon_gain * (1 + 10.0**more))
    after = respond(tighter, X, CONFIG)
    assert torch.equal(after.gate, before.gate)
    assert (work(after.dx) <= work(before.dx) * (1 + 1e-9)).all() and (
        work(before.dx) <= work(before.dx0) * (1 + 1e-9)
    ).all()


@few
@given(seeds, exponents, st.integers(0, 2), st.floats(0, 1), st.floats(0, 1))
def test_a_contact_fades_without_a_step(seed: int, soft: float, branch: int, a: float, b: float) -> None:
    """Stiffness changes no faster than the contact, and the less of it, the more the tool moves."""
    springs = springs_of(seed, soft)
    springs = springs._replace(tendon_gain=0 * springs.tendon_gain)
    low, high = sorted((a, b))

    def at(share: float) -> tuple[Tensor, Tensor]:
        contact = CONTACT.clone()
        contact[:, branch] = share
        r = respond(springs, X, CONFIG, contact)
        return r.k_x, work(r.dx)

    (none, _), (less, moved), (more, held), (full, _) = at(0.0), at(low), at(high), at(1.0)
    change = (full - none).norm(dim=(-2, -1))
    assert ((more - less).norm(dim=(-2, -1)) <= (high - low) * change + 1e-9 * full.norm(dim=(-2, -1))).all()
    assert (held <= moved * (1 + 1e-9)).all()


@few
@given(seeds, exponents, exponents)
def test_scaling_loads_and_stiffness(seed: int, soft: float, exponent: float) -> None:
    """Springs alone are linear in the load; a hand stiffer throughout moves less by that factor, its gates alike."""
    springs, s = springs_of(seed, soft), 10.0**exponent
    before = respond(springs, X, CONFIG)
    loaded = respond(springs, X | {"w_e": s * X["w_e"]}, CONFIG)
    torch.testing.assert_close(loaded.dx0, s * before.dx0, rtol=1e-9, atol=0)
    gate = springs.gate_params * torch.tensor([s, 1 / s, 1.0], dtype=torch.float64)
    stiff = Springs(s * springs.k_spring, springs.tendon_dir, s * springs.tendon_gain, gate)
    after = respond(stiff, X, MechanicsConfig(eps_kx=s * CONFIG.eps_kx), eps_m=EPS_M / s)
    torch.testing.assert_close(after.gate, before.gate, rtol=1e-7, atol=1e-12)
    assert ((s * after.dx - before.dx).norm(dim=-1) <= 1e-6 * before.dx.norm(dim=-1)).all()


@few
@given(seeds, exponents)
def test_the_order_of_like_branches_does_not_matter(seed: int, soft: float) -> None:
    springs, order = springs_of(seed, soft), [1, 0, 2]
    before = respond(springs, X, CONFIG)
    swapped = Springs(*(t[:, order] for t in springs))
    x = X | {name: X[name][:, order] for name in ("j_x", "j_q")}
    after = respond(swapped, x, CONFIG, CONTACT[:, order])
    torch.testing.assert_close(after.gate, before.gate[:, order], rtol=1e-7, atol=1e-12)
    assert ((after.dx - before.dx).norm(dim=-1) <= 1e-6 * before.dx.norm(dim=-1)).all()
