"""Contacts that slide, against the definition: K_x is solved anew with each contact's compliance, in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from synthetic import HANDS, hand
from test_mechanics import EPS_M, draw, random_springs, respond
from torch import Tensor

from aminn.model.batched import batch_last
from aminn.model.mechanics import Constants, Extras, MechanicsConfig, Response, two_pass
from aminn.model.sliding import (
    FORCE_N,
    LEAST_PRESSURE_N,
    LEAST_RESERVE,
    MOMENT_NM,
    MOST_COMPLIANCE,
    PRELOAD_N,
    SLIDE_STEPS,
    Grip,
    preload_of_weight,
    slide,
)
from aminn_hand import Hand

Array = NDArray[np.float64]
HAND = hand()
CONFIG = MechanicsConfig()


def grip(x: dict[str, Tensor], friction: float = 0.5, pressing: float = 1.0) -> Extras:
    """Contacts with some preload along their tangent planes, pressed with `pressing` N."""
    n, branches = x["contacts"].shape[:2]
    g = torch.Generator().manual_seed(4)
    preload = 0.2 * torch.randn(n, branches, 3, generator=g, dtype=torch.float64)
    mu, force = (torch.full((n, branches), v, dtype=torch.float64) for v in (friction, pressing))
    return Extras(friction=mu, preload=preload, normal=x["contacts"][..., 4:7], normal_force=force)


def scaled_to(x: dict[str, Tensor], newtons: float) -> dict[str, Tensor]:
    return x | {"w_e": x["w_e"] * (newtons / x["w_e"][:, :3].norm(dim=1, keepdim=True))}


def by_definition(
    r: Response, springs: Array, x: dict[str, Tensor], extras: Extras, length_m: float
) -> tuple[Array, Array, Array]:
    """(s (N, B), motion (N, 6), K_x (N, 6, 6)) in NumPy, one solve per step."""
    k_q = springs + r.k_tendon.numpy()
    b, a = -x["j_q"].numpy(), x["j_x"].numpy()
    normal, c = x["contacts"][..., 4:7].numpy(), x["contacts"][..., 0].numpy()
    scale = np.array([1.0] * 3 + [1 / length_m] * 3)
    across = np.eye(3) - normal[..., :, None] * normal[..., None, :]
    softness = b @ np.linalg.solve(k_q, np.swapaxes(b, -1, -2)) + float(EPS_M) * np.eye(3)

    def solve(s: Array) -> tuple[Array, Array, Array]:
        tip = c[..., None, None] * np.linalg.inv(softness + (c * s)[..., None, None] * across)
        k = (np.swapaxes(a, -1, -2) @ tip @ a).sum(1) + CONFIG.eps_kx * np.eye(6)
        dx = np.linalg.solve(k * scale[:, None] * scale, (x["w_e"].numpy() * scale)[..., None])[..., 0] * scale
        return dx, (tip @ a @ dx[:, None, :, None])[..., 0], k

    assert extras.friction is not None and extras.preload is not None and extras.normal_force is not None
    mu, force = extras.friction.numpy(), extras.normal_force.numpy()
    preload = c[..., None] * (across @ extras.preload.numpy()[..., None])[..., 0]
    s = np.zeros_like(mu)
    dx, f, k = solve(s)
    alone = b @ np.linalg.solve(springs, np.swapaxes(b, -1, -2)) + float(EPS_M) * np.eye(3)
    give = np.trace(across @ alone @ across, axis1=-2, axis2=-1) / 2
    for _ in range(SLIDE_STEPS):
        along = (f * normal).sum(-1)
        t, limit = f - along[..., None] * normal, mu * np.maximum(force - along, LEAST_PRESSURE_N)
        size = (preload**2).sum(-1)
        reserve = np.maximum(limit**2 - size, (LEAST_RESERVE * limit) ** 2)
        aligned = (preload * t).sum(-1)
        over = (np.sqrt(aligned**2 + (t * t).sum(-1) * reserve) - aligned) / reserve
        s = np.clip((give + s) * over - give, 0, MOST_COMPLIANCE)
        dx, f, k = solve(s)
    return s, dx, k


@pytest.mark.parametrize("h", HANDS.values(), ids=HANDS)
def test_slides_are_those_of_the_definition(h: Hand) -> None:
    x = scaled_to(draw(h), 3.0)
    faded = torch.tensor([1.0, 0.6, 1.0, 0.0])[: x["contacts"].shape[1]].double()
    x["contacts"][:50, : len(faded), 0] = faded
    springs, extras = random_springs(h), grip(x)
    r = respond(springs, x, CONFIG, extras=extras, of=h)
    s, dx, k = by_definition(r, springs.k_spring.numpy(), x, extras, h.length_m)
    share = (s > 1e-9).any(1).mean()
    assert 0.2 < share, "few contacts slide"
    np.testing.assert_allclose(r.slide, s, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(r.dx, dx, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(r.k_x, k, rtol=1e-6, atol=1e-6)
    stuck = respond(springs, x, CONFIG, of=h)
    free = (s == 0).all(1)
    torch.testing.assert_close(r.dx[free], stuck.dx[free])
    work, least = ((x["w_e"] * v.dx).sum(1) for v in (r, stuck))
    assert (work >= least * (1 - 1e-9)).all()  # a softer grasp takes up more


def test_friction_use_tells_which_contacts_slide() -> None:
    """Where one contact alone is beyond its friction, it alone gives, and after the steps it carries what it can."""
    x, springs = scaled_to(draw(HAND), 1.0), random_springs(HAND)
    extras = grip(x)._replace(preload=torch.zeros(len(x["q"]), 3, 3, dtype=torch.float64))
    r = respond(springs, x, CONFIG, extras=extras)
    alone = (r.friction_use > 1).sum(1) == 1
    assert alone.sum() > 10
    first = (r.friction_use > 1) & alone[:, None]
    assert (r.slide[first] > 0).double().mean() > 0.95  # a slide may press the contact harder
    assert ((r.slide > 0) & alone[:, None] & ~first).sum() <= 0.3 * first.sum()


def test_slides_never_feed_energy() -> None:
    """w.dx >= 0 and K_x positive definite whatever friction and preload are, cut or not."""
    x, springs = scaled_to(draw(HAND), 20.0), random_springs(HAND)
    g = torch.Generator().manual_seed(7)
    extras = grip(x)._replace(
        friction=torch.exp(3 * torch.randn(len(x["q"]), 3, generator=g, dtype=torch.float64)),
        preload=10 * torch.randn(len(x["q"]), 3, 3, generator=g, dtype=torch.float64),
        normal_force=torch.randn(len(x["q"]), 3, generator=g, dtype=torch.float64),
    )
    limits = (0.010, 0.35)
    constants = Constants(CONFIG, torch.tensor(HAND.coordinate_mask), EPS_M, (True,) * 3, HAND.length_m, limits)
    r = two_pass(springs, x["w_e"], x["contacts"][..., 0], x["j_x"], x["j_q"], constants, extras)
    assert (r.slide > 0).any() and torch.linalg.eigvalsh(r.k_x).min() > 0
    assert ((x["w_e"] * r.dx).sum(1) > 0).all()
    assert (r.dx[:, :3].norm(dim=1) <= limits[0] * (1 + 1e-9)).all()
    assert (r.dx[:, 3:].norm(dim=1) <= limits[1] * (1 + 1e-9)).all()
    reached = (r.dx[:, :3].norm(dim=1) / limits[0]).maximum(r.dx[:, 3:].norm(dim=1) / limits[1])
    assert (reached > 0.999).any(), "nothing was cut"
    uncut = two_pass(
        springs, x["w_e"], x["contacts"][..., 0], x["j_x"], x["j_q"], constants._replace(limits=None), extras
    )
    torch.testing.assert_close(torch.nn.functional.normalize(r.dx), torch.nn.functional.normalize(uncut.dx))


def test_a_contact_that_fades_out_slides_no_more() -> None:
    x, springs = scaled_to(draw(HAND), 3.0), random_springs(HAND)
    without = respond(springs, x, CONFIG, contact=torch.tensor([1.0, 1.0, 0.0]).expand(len(x["q"]), 3), extras=grip(x))
    nearly = respond(springs, x, CONFIG, contact=torch.tensor([1.0, 1.0, 1e-13]).expand(len(x["q"]), 3), extras=grip(x))
    assert (without.slide[:, 2] == 0).all() and (without.friction_use[:, 2] == 0).all()
    torch.testing.assert_close(without.dx, nearly.dx, rtol=1e-4, atol=1e-7)


def test_gradients_of_a_slide() -> None:
    x, springs = scaled_to(draw(HAND), 3.0), random_springs(HAND)
    r = respond(springs, x, CONFIG, extras=grip(x))
    some = torch.nonzero(((r.slide > 1e-6) & (r.slide < 4e-3)).any(1))[:4, 0]
    assert len(some) == 4
    few, own, extras = {k: v[some] for k, v in x.items()}, [v[some] for v in springs], grip(x)
    assert extras.friction is not None and extras.preload is not None

    def run(k_spring: Tensor, gain: Tensor, mu: Tensor, preload: Tensor, log_eps: Tensor) -> tuple[Tensor, ...]:
        k = (k_spring + k_spring.mT) / 2
        more = Extras(
            log_eps.exp(), friction=mu, preload=preload, normal=few["contacts"][..., 4:7], normal_force=mu * 0 + 1
        )
        changed = springs._replace(k_spring=k, tendon_dir=own[1], tendon_gain=gain, gate_params=own[3])
        r = respond(changed, few, CONFIG, extras=more)
        return r.dx, r.k_x / 1e3, r.friction_use, 1e3 * r.slide, r.slide_share, r.pressed

    args = (own[0], own[2], extras.friction[some], extras.preload[some], EPS_M.log().expand(4, 3))
    args = tuple(v.detach().clone().requires_grad_() for v in args)
    assert torch.autograd.gradcheck(run, args, atol=1e-2, rtol=1e-2)


def test_preload_carries_the_weight() -> None:
    """In a grasp that the normal forces leave unbalanced the preload balances it, as far as it may."""
    x = draw(HAND)
    contacts, a = batch_last(x["contacts"]), batch_last(x["j_x"])
    length = HAND.length_m
    a = a * torch.tensor([1.0] * 3 + [1 / length] * 3)[:, None, None]
    weight = torch.tensor([0.0, 0.0, -0.5], dtype=torch.float64)[:, None].expand(3, len(x["q"]))
    found = preload_of_weight(weight, contacts[0], a, contacts[4:7], contacts[7], length)
    normal, force, flag = (v.numpy() for v in (x["contacts"][..., 4:7], x["contacts"][..., 7], x["contacts"][..., 0]))
    sigma = np.array([FORCE_N] * 3 + [MOMENT_NM] * 3)
    for i in range(20):  # least squares with the prior as rows of their own
        across = [np.eye(3) - np.outer(n, n) for n in normal[i]]
        rows = np.hstack([x["j_x"][i, b].numpy().T @ across[b] * flag[i, b] for b in range(3)]) / sigma[:, None]
        pressing = sum(x["j_x"][i, b].numpy().T @ normal[i, b] * (flag[i, b] * force[i, b]) for b in range(3))
        right = -(pressing + np.concatenate([weight[:, i].numpy(), np.zeros(3)])) / sigma
        prior = np.eye(9) / PRELOAD_N
        t = np.linalg.lstsq(np.vstack([rows, prior]), np.concatenate([right, np.zeros(9)]), rcond=None)[0]
        expected = np.stack([across[b] @ t[3 * b : 3 * b + 3] * flag[i, b] for b in range(3)])
        np.testing.assert_allclose(found[..., i].T, expected, rtol=1e-6, atol=1e-9)


def test_no_tangential_force_is_no_slide() -> None:
    """Forces along the normals alone, and none at all: no division by what is zero."""
    n = 4
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None].expand(3, 3, n)
    tip = 1000 * torch.eye(3, dtype=torch.float64)[..., None, None].expand(3, 3, 3, n)
    a = torch.randn(3, 6, 3, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    k = torch.einsum("iabn,icbn->acn", a, 1000 * a) + torch.eye(6, dtype=torch.float64)[..., None]
    mu = torch.full((3, n), 0.5, dtype=torch.float64, requires_grad=True)
    ones = torch.ones(3, n, dtype=torch.float64)
    found = slide(Grip(mu, 0 * normal, normal, ones), 0.5 * normal, tip, tip, a, ones, k)
    sum(v.sum() for v in found).backward()
    assert (found.compliance == 0).all() and torch.isfinite(mu.grad).all()
