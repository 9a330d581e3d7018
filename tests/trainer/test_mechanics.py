"""The two-pass layer against the undivided algebra, finite differences, and its own limits."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from synthetic import draw_inputs, draw_wrench, hand
from torch import Tensor

from aminn.hand.dims import LENGTH_SCALE_M
from aminn.hand.nominal import nominal_from_hand
from aminn.model.mechanics import Extras, MechanicsConfig, Springs, dense_stiffness, inverse_3x3, two_pass

N = 200
MASK = torch.tensor(nominal_from_hand(hand()).coord_mask)


@pytest.fixture(scope="module")
def x() -> dict[str, Tensor]:
    rng = np.random.default_rng(3)
    rows = [draw_inputs(rng, hand()) | {"w_e": draw_wrench(rng)} for _ in range(N)]
    return {k: torch.tensor(np.stack([r[k] for r in rows])) for k in rows[0]}


@pytest.fixture(scope="module")
def springs() -> Springs:
    """Random SPD springs, decoupled in the thumb's absent roll coordinate."""
    g = torch.Generator().manual_seed(1)
    factor = 0.1 * torch.randn(N, 3, 3, 3, generator=g, dtype=torch.float64)
    k = factor @ factor.mT + 0.1 * torch.eye(3, dtype=torch.float64)
    coupled = MASK[:, :, None] * MASK[:, None, :]
    k = k * coupled + torch.diag_embed(1 - MASK)
    d = torch.nn.functional.normalize(torch.randn(N, 3, 3, generator=g, dtype=torch.float64) * MASK, dim=-1)
    gate = torch.tensor([20.0, 0.01, 0.5], dtype=torch.float64).expand(N, 3, 3)
    return Springs(k, d, torch.full((N, 3), 0.4, dtype=torch.float64), gate)


def respond(springs: Springs, x: dict[str, Tensor], config: MechanicsConfig, contact: Tensor | None = None):
    contact = x["contacts"][..., 0] if contact is None else contact
    return two_pass(springs, x["w_e"], contact, x["j_x"], x["j_q"], MASK, config)


def test_inverse_3x3() -> None:
    m = torch.randn(50, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    inverse = inverse_3x3(m.movedim(0, -1)).movedim(-1, 0)
    assert torch.allclose(inverse, torch.linalg.inv(m), rtol=1e-9, atol=1e-9)


def test_sum_over_branches_is_the_dense_form(x: dict[str, Tensor], springs: Springs) -> None:
    config, contact = MechanicsConfig(), x["contacts"][..., 0].clone()
    contact[::3, 1] = 0.0
    r = respond(springs, x, config, contact)
    dense = dense_stiffness(springs.k_spring + r.k_tendon, contact, x["j_x"], x["j_q"], config)
    assert torch.allclose(r.k_x, dense, rtol=1e-8, atol=1e-8)
    assert torch.allclose((dense @ r.dx.unsqueeze(-1)).squeeze(-1), x["w_e"], rtol=1e-6, atol=1e-7)


def test_stiffness_is_spd_and_work_is_positive(x: dict[str, Tensor], springs: Springs) -> None:
    r = respond(springs, x, MechanicsConfig())
    assert torch.linalg.eigvalsh(r.k_scaled).min() > 0
    assert ((x["w_e"] * r.dx).sum(-1) > 0).all()


def test_pass_one_joint_deflection_closes_the_loop(x: dict[str, Tensor], springs: Springs) -> None:
    """A dx = B dq + eps_M lambda: with a stiff contact the joints account for all of the tool's motion."""
    r = respond(springs, x, MechanicsConfig(eps_m=1e-9, eps_kx=1e-9))
    tip = (x["j_x"] @ r.dx0[:, None, :, None]).squeeze(-1)
    joint = -(x["j_q"] @ r.dq0.unsqueeze(-1)).squeeze(-1)
    assert (tip - joint).abs().max() < 1e-5 * tip.abs().max()


def test_both_forms_of_dq0_agree_where_the_finger_is_not_straight(x: dict[str, Tensor], springs: Springs) -> None:
    sharp = dict(eps_m=1e-9, eps_kx=1e-9, eps_jq=1e-9)
    bent = torch.linalg.cond(x["j_q"][:, :2]) < 50
    assert bent.sum() > N
    statics = respond(springs, x, MechanicsConfig(**sharp)).dq0[:, :2][bent]
    inverse = respond(springs, x, MechanicsConfig(**sharp, dq0="inverse")).dq0[:, :2][bent]
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
    scale = torch.tensor([1.0] * 3 + [LENGTH_SCALE_M] * 3, dtype=torch.float64)

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
    slip = torch.tensor([[[0.02, 2e-3]] * 3] * 2, dtype=torch.float64)
    leaves = [t.requires_grad_() for t in (factor, torch.tensor(1e-4, dtype=torch.float64), twist, slip)]
    rest = [t[:2] for t in springs[1:]]

    def results(low: Tensor, eps: Tensor, twist: Tensor, slip: Tensor) -> tuple[Tensor, ...]:
        normal, pinch = few["contacts"][..., 4:7], few["contacts"][..., 7]
        extras = Extras(eps, twist, slip, normal, pinch)
        args = (few["w_e"], contact, few["j_x"], few["j_q"], MASK, MechanicsConfig(), extras)
        r = two_pass(Springs(low @ low.mT, *rest), *args)
        return 1e3 * r.x_scaled, torch.diagonal(r.k_scaled, dim1=-2, dim2=-1).log(), 10 * r.gate, 100 * r.dq0

    assert torch.autograd.gradcheck(results, leaves, eps=1e-7, atol=1e-4, rtol=1e-3)


def test_twist_stiffness_resists_rotation_about_the_normal_alone(x: dict[str, Tensor], springs: Springs) -> None:
    normal = x["contacts"][..., 4:7]
    args = (x["w_e"], x["contacts"][..., 0], x["j_x"], x["j_q"], MASK, MechanicsConfig())
    loose = springs._replace(tendon_gain=torch.zeros_like(springs.tendon_gain))  # gates would follow the other dx0
    plain = two_pass(loose, *args).k_x
    stiff = two_pass(loose, *args, Extras(twist=torch.ones(N, 3, dtype=torch.float64), normal=normal)).k_x
    expected = (normal[..., :, None] * normal[..., None, :]).sum(1)
    assert torch.allclose((stiff - plain)[:, 3:, 3:], expected, atol=1e-6)
    assert (stiff - plain)[:, :3].abs().max() < 1e-6 * plain.abs().max()


def test_slip_softens_contacts_and_creates_no_energy(x: dict[str, Tensor], springs: Springs) -> None:
    args = (x["w_e"], x["contacts"][..., 0], x["j_x"], x["j_q"], MASK, MechanicsConfig())
    slip = torch.tensor([0.05, 1e-2], dtype=torch.float64).expand(N, 3, 2)
    slipping = Extras(slip=slip, normal=x["contacts"][..., 4:7], normal_force=x["contacts"][..., 7])
    plain, soft = two_pass(springs, *args), two_pass(springs, *args, slipping)
    work = [(x["w_e"] * r.dx).sum(-1) for r in (plain, soft)]
    assert (work[1] >= work[0] * (1 - 1e-9)).all() and (work[1] > 1.05 * work[0]).any()


def test_single_precision_is_good_enough_for_a_gradient(x: dict[str, Tensor], springs: Springs) -> None:
    args = (x["w_e"], x["contacts"][..., 0], x["j_x"], x["j_q"], MASK, MechanicsConfig())
    single, double = (two_pass(springs, *args, dtype=t).x_scaled for t in (torch.float32, torch.float64))
    error = (single - double).norm(dim=1) / double.norm(dim=1)
    print(f"float32: {error.max():.1e}")
    assert error.max() < 1e-3
