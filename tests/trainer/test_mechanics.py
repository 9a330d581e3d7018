"""The two-pass layer against the undivided algebra, finite differences, and its own limits."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from synthetic import HANDS, draw_inputs, draw_wrench, hand
from torch import Tensor

from aminn.hand.nominal import nominal_of
from aminn.model.batched import inverse, inverse_3x3
from aminn.model.mechanics import (
    Constants,
    Extras,
    MechanicsConfig,
    Response,
    Springs,
    dense_stiffness,
    two_pass,
)
from aminn_hand import Hand

N = 200
HAND = hand()
EPS_M = torch.tensor(1e-5, dtype=torch.float64)
SHARP = torch.tensor(1e-9, dtype=torch.float64)


def draw(h: Hand, n: int = N) -> dict[str, Tensor]:
    """Random grasps and loads."""
    rng = np.random.default_rng(3)
    rows = [draw_inputs(rng, h) | {"w_e": draw_wrench(rng)} for _ in range(n)]
    return {k: torch.tensor(np.stack([r[k] for r in rows])) for k in rows[0]}


def random_springs(h: Hand, n: int = N) -> Springs:
    """Random SPD springs, decoupled in coordinates that a branch lacks; no tendon where it has none."""
    g = torch.Generator().manual_seed(1)
    branches, c = h.dims.branches, h.dims.coordinates
    mask, has = torch.tensor(h.coordinate_mask), torch.tensor(gated(h), dtype=torch.float64)
    factor = 0.1 * torch.randn(n, branches, c, c, generator=g, dtype=torch.float64)
    k = factor @ factor.mT + 0.1 * torch.eye(c, dtype=torch.float64)
    k = k * mask[:, :, None] * mask[:, None, :] + torch.diag_embed(1 - mask)
    d = torch.nn.functional.normalize(torch.randn(n, branches, c, generator=g, dtype=torch.float64) * mask, dim=-1)
    gate = torch.tensor([20.0, 0.01, 0.5], dtype=torch.float64).expand(n, branches, 3)
    return Springs(k, d, 0.4 * has.expand(n, branches), gate)


def gated(h: Hand) -> tuple[bool, ...]:
    return tuple(branch.gated_tendon is not None for branch in h.branches)


def constants(h: Hand, config: MechanicsConfig, eps_m: Tensor = EPS_M) -> Constants:
    return Constants(config, torch.tensor(h.coordinate_mask), eps_m, gated(h), h.length_m)


@pytest.fixture(scope="module")
def x() -> dict[str, Tensor]:
    return draw(HAND)


@pytest.fixture(scope="module")
def springs() -> Springs:
    return random_springs(HAND)


def respond(
    springs: Springs,
    x: dict[str, Tensor],
    config: MechanicsConfig,
    contact: Tensor | None = None,
    eps_m: Tensor = EPS_M,
    extras: Extras | None = None,
    of: Hand = HAND,
) -> Response:
    contact = x["contacts"][..., 0] if contact is None else contact
    more = extras or Extras()
    return two_pass(springs, x["w_e"], contact, x["j_x"], x["j_q"], constants(of, config, eps_m), more)


@pytest.mark.parametrize("name", HANDS)
def test_each_hand_has_the_dense_form(name: str) -> None:
    """Any number of branches and coordinates, contacts of another compliance each, one branch out of contact."""
    h = HANDS[name]
    x, springs, config = draw(h, 40), random_springs(h, 40), MechanicsConfig()
    eps_m, contact = torch.tensor(nominal_of(h).eps_m), x["contacts"][..., 0].clone()
    contact[::3, 1] = 0.0
    r = respond(springs, x, config, contact, eps_m, of=h)
    dense = dense_stiffness(springs.k_spring + r.k_tendon, contact, x["j_x"], x["j_q"], eps_m, config)
    assert torch.allclose(r.k_x, dense, rtol=1e-7, atol=1e-7 * float(dense.abs().max()))
    residual = (dense @ r.dx.unsqueeze(-1)).squeeze(-1) - x["w_e"]
    assert residual.abs().max() < 1e-5 * x["w_e"].abs().max()
    assert torch.linalg.eigvalsh(r.k_scaled).min() > 0 and ((x["w_e"] * r.dx).sum(-1) > 0).all()


@pytest.mark.parametrize("name", HANDS)
def test_pass_two_adds_what_the_gates_engage(name: str) -> None:
    """Where a branch has no gated tendon its gate and tendon are 0; in a hand without any, pass 2 is pass 1."""
    h = HANDS[name]
    x, springs = draw(h, 20), random_springs(h, 20)
    r = respond(springs, x, MechanicsConfig(), of=h)
    for b, has in enumerate(gated(h)):
        assert bool((r.gate[:, b] > 0).all()) == has and bool((r.k_tendon[:, b] != 0).any()) == has
    assert torch.equal(r.dx, r.dx0) == (h.dims.gates == 0)


@pytest.mark.parametrize("name", ["gripper 2x2", "5x5", "asymmetric", "one joint per branch"])
def test_gradients_of_each_hand(name: str) -> None:
    h = HANDS[name]
    x, springs = draw(h, 1), random_springs(h, 1)
    factor = torch.linalg.cholesky(springs.k_spring)
    eps_m = torch.tensor(nominal_of(h).eps_m)
    leaves = [t.clone().requires_grad_() for t in (factor, eps_m)]

    def results(low: Tensor, eps: Tensor) -> tuple[Tensor, ...]:
        moved = springs._replace(k_spring=low @ low.mT)
        r = respond(moved, x, MechanicsConfig(eps_kx=10.0), eps_m=eps, of=h)  # a pinch of two is soft about its line
        return 1e3 * r.x_scaled, torch.diagonal(r.k_scaled, dim1=-2, dim2=-1).log(), 10 * r.gate, 100 * r.dq0

    assert torch.autograd.gradcheck(results, leaves, eps=1e-7, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_inverse(n: int) -> None:
    factor = torch.randn(50, n, n, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    m = factor @ factor.mT + 0.1 * torch.eye(n)
    assert torch.allclose(inverse(m.movedim(0, -1)).movedim(-1, 0) @ m, torch.eye(n, dtype=torch.float64), atol=1e-8)


def test_inverse_3x3() -> None:
    m = torch.randn(50, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    inverse = inverse_3x3(m.movedim(0, -1)).movedim(-1, 0)
    assert torch.allclose(inverse, torch.linalg.inv(m), rtol=1e-9, atol=1e-9)


def test_sum_over_branches_is_the_dense_form(x: dict[str, Tensor], springs: Springs) -> None:
    config, contact = MechanicsConfig(), x["contacts"][..., 0].clone()
    contact[::3, 1] = 0.0
    r = respond(springs, x, config, contact)
    dense = dense_stiffness(springs.k_spring + r.k_tendon, contact, x["j_x"], x["j_q"], EPS_M, config)
    assert torch.allclose(r.k_x, dense, rtol=1e-8, atol=1e-8)
    assert torch.allclose((dense @ r.dx.unsqueeze(-1)).squeeze(-1), x["w_e"], rtol=1e-6, atol=1e-7)


def test_stiffness_is_spd_and_work_is_positive(x: dict[str, Tensor], springs: Springs) -> None:
    r = respond(springs, x, MechanicsConfig())
    assert torch.linalg.eigvalsh(r.k_scaled).min() > 0
    assert ((x["w_e"] * r.dx).sum(-1) > 0).all()


def test_pass_one_joint_deflection_closes_the_loop(x: dict[str, Tensor], springs: Springs) -> None:
    """A dx = B dq + eps_M lambda: with a stiff contact the joints account for all of the tool's motion."""
    r = respond(springs, x, MechanicsConfig(eps_kx=1e-9), eps_m=SHARP)
    tip = (x["j_x"] @ r.dx0[:, None, :, None]).squeeze(-1)
    joint = -(x["j_q"] @ r.dq0.unsqueeze(-1)).squeeze(-1)
    assert (tip - joint).abs().max() < 1e-5 * tip.abs().max()


def test_both_forms_of_dq0_agree_where_the_finger_is_not_straight(x: dict[str, Tensor], springs: Springs) -> None:
    sharp = dict(eps_kx=1e-9, eps_jq=1e-9)
    bent = torch.linalg.cond(x["j_q"][:, :2]) < 50
    assert bent.sum() > N
    statics = respond(springs, x, MechanicsConfig(**sharp), eps_m=SHARP).dq0[:, :2][bent]
    inverse = respond(springs, x, MechanicsConfig(**sharp, dq0="inverse"), eps_m=SHARP).dq0[:, :2][bent]
    assert ((statics - inverse).norm(dim=-1) / statics.norm(dim=-1)).max() < 1e-4


def test_branch_out_of_contact_leaves_exactly_and_smoothly(x: dict[str, Tensor], springs: Springs) -> None:
    config, contact = MechanicsConfig(), x["contacts"][..., 0].clone()
    contact[:, 2] = 0.0
    r = respond(springs, x, config, contact)
    other = x | {"j_x": x["j_x"].clone(), "j_q": x["j_q"].clone()}
    other["j_x"][:, 2], other["j_q"][:, 2] = 7.0, -3.0
    assert torch.equal(r.k_x, respond(springs, other, config, contact).k_x)
    contact[:, 2] = 1e-13
    assert torch.allclose(r.k_x, respond(springs, x, config, contact).k_x, rtol=1e-6, atol=1e-6)


def test_thumb_coordinate_that_does_not_exist_has_no_effect(x: dict[str, Tensor], springs: Springs) -> None:
    k = springs.k_spring.clone()
    k[:, 2, 0, 0] = 55.0
    a, b = respond(springs, x, MechanicsConfig()), respond(springs._replace(k_spring=k), x, MechanicsConfig())
    assert torch.allclose(a.dx, b.dx, rtol=1e-12)
    assert (a.dq0[:, 2, 0] == 0).all()


def test_gates_engage_the_tendon_that_is_stretched(x: dict[str, Tensor], springs: Springs) -> None:
    """Tendons along the joint deflection of pass 1 open the gates; against it they shut, and the tool moves more."""
    config = MechanicsConfig()
    dq0 = respond(springs, x, config).dq0
    along = torch.nn.functional.normalize(dq0, dim=-1)
    steep = torch.tensor([1e6, 0.0, 0.0], dtype=torch.float64).expand(N, 3, 3)
    taut = respond(springs._replace(tendon_dir=along, gate_params=steep), x, config)
    slack = respond(springs._replace(tendon_dir=-along, gate_params=steep), x, config)
    assert taut.gate.min() > 0.5 > slack.gate.max()
    work = [(x["w_e"] * r.dx).sum(-1) for r in (taut, slack)]
    assert (work[0] < work[1]).all()


def test_gradients(x: dict[str, Tensor], springs: Springs) -> None:
    few = {k: v[:2] for k, v in x.items()}
    factor = torch.linalg.cholesky(springs.k_spring)
    leaves = [t[:2].clone().requires_grad_() for t in (factor, *springs[1:])]
    scale = torch.tensor([1.0] * 3 + [HAND.length_m] * 3, dtype=torch.float64)

    def dx(low: Tensor, *others: Tensor) -> Tensor:
        return 1e3 * respond(Springs(low @ low.mT, *others), few, MechanicsConfig()).dx * scale

    assert torch.autograd.gradcheck(dx, leaves, eps=1e-7, atol=1e-4, rtol=1e-3)


def test_gradients_of_every_input_and_result(x: dict[str, Tensor], springs: Springs) -> None:
    """The hand-written adjoint of a pass: stiffness K_x, gates and motion, by springs, contact and twist compliance."""
    few = {k: v[:2] for k, v in x.items()}
    contact = few["contacts"][..., 0].clone()
    contact[0, 1] = 0.0
    factor = torch.linalg.cholesky(springs.k_spring)[:2].clone()
    twist = torch.tensor([[0.1, 0.2, 0.3]] * 2, dtype=torch.float64)
    leaves = [t.requires_grad_() for t in (factor, torch.tensor(1e-4, dtype=torch.float64), twist)]
    rest = [t[:2] for t in springs[1:]]

    def results(low: Tensor, eps: Tensor, twist: Tensor) -> tuple[Tensor, ...]:
        extras = Extras(eps, twist, normal=few["contacts"][..., 4:7])
        r = respond(Springs(low @ low.mT, *rest), few, MechanicsConfig(), contact, extras=extras)
        return 1e3 * r.x_scaled, torch.diagonal(r.k_scaled, dim1=-2, dim2=-1).log(), 10 * r.gate, 100 * r.dq0

    assert torch.autograd.gradcheck(results, leaves, eps=1e-7, atol=1e-4, rtol=1e-3)


def test_twist_stiffness_resists_rotation_about_the_normal_alone(x: dict[str, Tensor], springs: Springs) -> None:
    normal = x["contacts"][..., 4:7]
    loose = springs._replace(tendon_gain=torch.zeros_like(springs.tendon_gain))  # gates would follow the other dx0
    plain = respond(loose, x, MechanicsConfig()).k_x
    twisting = Extras(twist=torch.ones(N, 3, dtype=torch.float64), normal=normal)
    stiff = respond(loose, x, MechanicsConfig(), extras=twisting).k_x
    expected = (normal[..., :, None] * normal[..., None, :]).sum(1)
    assert torch.allclose((stiff - plain)[:, 3:, 3:], expected, atol=1e-6)
    assert (stiff - plain)[:, :3].abs().max() < 1e-6 * plain.abs().max()


def test_single_precision_is_good_enough_for_a_gradient(x: dict[str, Tensor], springs: Springs) -> None:
    args = (x["w_e"], x["contacts"][..., 0], x["j_x"], x["j_q"], constants(HAND, MechanicsConfig()))
    single, double = (two_pass(springs, *args, dtype=t).x_scaled for t in (torch.float32, torch.float64))
    error = (single - double).norm(dim=1) / double.norm(dim=1)
    print(f"float32: {error.max():.1e}")
    assert error.max() < 5e-3 and error.median() < 1e-4
