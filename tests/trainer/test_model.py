"""The cascade: an untrained model is the analytical one, shapes and names are as documented, budgets match."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import HANDS, hand

from aminn.data.dataset import Dataset
from aminn.hand.nominal import nominal_of
from aminn.model.baseline import Mlp, n_parameters
from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn.model.config import MechanicsConfig, ModelConfig
from aminn.model.export_tables import export_tables
from aminn.model.network import Aminn
from aminn_base.errors import AminnError
from aminn_hand.hand import N_WRENCH

HAND = hand()


@pytest.mark.parametrize("name", HANDS)
def test_nominal_hand_is_springs_and_taut_tendons(name: str) -> None:
    h = HANDS[name]
    nominal, width = nominal_of(h), h.dims.coordinates
    rows, cols = np.transpose(h.dims.cholesky_entries)
    for b, branch in enumerate(h.branches):
        factor = np.zeros((width, width))
        factor[rows, cols] = nominal.chol[b]
        d = nominal.tendon_dir[b]
        total = factor @ factor.T + nominal.tendon_gain[b] * np.outer(d, d)
        expected, own = np.eye(width), slice(width - len(branch.coordinates), None)
        expected[own, own] = branch.stiffness()
        np.testing.assert_allclose(total, expected, rtol=1e-12, atol=1e-12)


def test_springs_that_hold_nothing_are_named() -> None:
    first, *others = HAND.branches
    loose = tuple(replace(c, spring_Nm_rad=0.0, servo_Nm_rad=0.0) for c in first.coordinates)
    with pytest.raises(AminnError, match="the springs of branch finger1 do not hold it"):
        nominal_of(replace(HAND, branches=(replace(first, coordinates=loose), *others)))


def test_zero_head_is_the_analytical_model(dataset: Dataset) -> None:
    model = Aminn(ModelConfig(), HAND)
    backbone = model.stage2.backbone
    torch.nn.init.zeros_(backbone.head.weight)
    x = dataset.inputs()
    torch.testing.assert_close(model.stage2(x)[0], backbone.nominal_response(x).dx, rtol=1e-6, atol=1e-9)


def test_output_and_debug_shapes(dataset: Dataset) -> None:
    x = {k: v[:5] for k, v in dataset.inputs().items()}
    for dq0 in ("statics", "inverse"):
        mechanics = (MechanicsConfig(dq0=dq0),) * 2
        out = Aminn(ModelConfig(mechanics=mechanics), HAND).debug(**x)
        shapes = HAND.dims.outputs | {f"s{k}_{name}": shape for k in (1, 2) for name, shape in HAND.dims.debug.items()}
        assert {name: tuple(v.shape) for name, v in out.items()} == {n: (5, *s) for n, s in shapes.items()}
        assert all(torch.isfinite(v).all() for v in out.values())


def test_springs_are_spd_and_tendons_are_unit_for_any_head(dataset: Dataset) -> None:
    backbone = Aminn(ModelConfig(), HAND).stage1.backbone
    y = 5 * torch.randn(500, backbone.dims.head, generator=torch.Generator().manual_seed(0))
    s = backbone.springs_from_head(y)
    assert torch.linalg.eigvalsh(s.k_spring.double()).min() > 0
    assert torch.allclose(s.tendon_dir.norm(dim=-1), torch.ones(500, 3), atol=1e-3)
    assert (s.tendon_gain > 0).all()
    assert (s.tendon_dir[:, 2, 0] == 0).all() and (s.k_spring[:, 2, 0, 1:] == 0).all()


def test_learned_contact_compliance_starts_at_the_constant_and_is_exported(dataset: Dataset, tmp_path: Path) -> None:
    config = ModelConfig(mechanics=(MechanicsConfig(eps_m=3e-5, learn_eps_m=True),) * 2)
    constant = MechanicsConfig(eps_m=3e-5, learn_eps_m=False)
    model, fixed = Aminn(config, HAND), Aminn(ModelConfig(mechanics=(constant,) * 2), HAND)
    fixed.load_state_dict({k: v for k, v in model.state_dict().items() if not k.endswith("eps_m_change")})
    x = dataset.inputs()
    torch.testing.assert_close(model(**x)["dx_ht"], fixed(**x)["dx_ht"])
    with torch.no_grad():
        model.stage2.backbone.eps_m_change += math.log(2)
    save_checkpoint(tmp_path, model, {"tau": 0.5})
    assert export_tables(load_checkpoint(tmp_path)).meta["eps_m"] == pytest.approx([3e-5, 6e-5])


@pytest.mark.parametrize("options", [{"soft_finger": True}, {"heads_see_wrench": False}, {"heads": "free"}], ids=str)
def test_options_give_finite_predictions_without_energy(dataset: Dataset, options: dict, tmp_path: Path) -> None:
    x = dataset.inputs()
    model = Aminn(ModelConfig(**options), HAND)
    out = model(**x)
    assert all(torch.isfinite(v).all() for v in out.values())
    assert ((x["w_e"] * out["dx_ht"]).sum(1) > 0).all()
    save_checkpoint(tmp_path, model, {"tau": 0.5})
    if options in ({"heads": "free"}, {"soft_finger": True}):
        tables = export_tables(load_checkpoint(tmp_path)).tensors
        assert tables["chol_nom"].std() > 0 and ("twist_nom" in tables) == ("soft_finger" in options)
    else:
        with pytest.raises(AminnError, match="option of the trainer alone"):
            export_tables(load_checkpoint(tmp_path))


def test_heads_that_do_not_see_the_wrench_give_the_same_springs(dataset: Dataset) -> None:
    x = dataset.inputs()
    model = Aminn(ModelConfig(heads_see_wrench=False), HAND)
    again = x | {"w_e": 2 * x["w_e"]}
    assert torch.equal(model.stage2(x)[1].k_spring, model.stage2(again)[1].k_spring)
    assert not torch.equal(model.stage1(x)[0], model.stage1(again)[0])


def test_the_classifier_sees_little_of_a_motion_that_linear_statics_cannot_know(dataset: Dataset) -> None:
    """Beyond L the motion's direction and the logarithm of its size are left; K_x and gates fade with the size."""
    stage = Aminn(ModelConfig(), HAND).stage1
    r = stage.backbone({k: v[:8] for k, v in dataset.inputs().items()})[2]
    direction = r.x_scaled / r.x_scaled.norm(dim=-1, keepdim=True)
    seen = {size: stage._aux(r._replace(x_scaled=size * direction)) for size in (0.01, HAND.length_m, 1.0, 1e6)}
    torch.testing.assert_close(seen[0.01][:, N_WRENCH:], seen[HAND.length_m][:, N_WRENCH:])
    torch.testing.assert_close(seen[1.0][:, N_WRENCH:], HAND.length_m * seen[0.01][:, N_WRENCH:])
    for size, aux in seen.items():
        expected = direction * math.log(1 + size / 1e-3)
        torch.testing.assert_close(aux[:, :N_WRENCH], expected, rtol=1e-4, atol=1e-6)
    still = stage._aux(r._replace(x_scaled=torch.zeros_like(r.x_scaled)))
    assert torch.isfinite(still).all() and (still[:, :N_WRENCH] == 0).all()


def test_contact_less_rows_are_finite(dataset: Dataset) -> None:
    x = {k: v[:4].clone() for k, v in dataset.inputs().items()}
    for name in ("contacts", "j_x", "j_q"):
        x[name][:, 1:] = 0
    out = Aminn(ModelConfig(), HAND)(**x)
    assert all(torch.isfinite(v).all() for v in out.values())


def test_baseline_has_the_same_budget() -> None:
    for config in (ModelConfig(), ModelConfig(width=96, contact_width=48)):
        aminn, mlp = Aminn(config, HAND), Mlp(config, HAND)
        for stage in ("stage1", "stage2"):
            a, m = n_parameters(getattr(aminn, stage)), n_parameters(getattr(mlp, stage))
            assert abs(m / a - 1) < 0.02, (stage, a, m)


@pytest.mark.parametrize("seen", [{}, {"told": True}, {"sensors": True}])
def test_no_other_width_of_the_baseline_is_nearer_to_the_budget(seen: dict[str, bool]) -> None:
    """One unit more or less is 5 % of a narrow stage."""
    config = ModelConfig(**seen)
    aminn, mlp = Aminn(config, HAND), Mlp(config, HAND)
    for stage in ("stage1", "stage2"):
        part, budget = getattr(mlp, stage), n_parameters(getattr(aminn, stage))
        n_in, width, n_out = part.hidden1.in_features, part.hidden1.out_features, part.out.out_features
        off = [abs((n_in + w + 2) * w + (w + 1) * n_out - budget) for w in (width - 1, width, width + 1)]
        assert off[1] == min(off) == abs(n_parameters(part) - budget)
