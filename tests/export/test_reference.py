"""The float64 oracle against the trainer's own model in float64: two implementations that share no code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from runtime_models import random_inputs, random_sensors
from synthetic import HANDS, draw_inputs, draw_wrench, hand
from untrained import WIDE

from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn.model.config import MechanicsConfig
from aminn.model.export_tables import export_tables
from aminn.model.network import Aminn, ModelConfig
from aminn_export.samples.reference import Reference
from aminn_hand import Hand
from aminn_hand.hand import ContactModel

SOFT = ContactModel("soft_finger", 0.003)
MADE_UP = HANDS | {f"soft {name}": replace(HANDS[name], contact=SOFT) for name in ("gripper 2x2", "4x3+4")}


def _largest_difference(of: Hand, config: ModelConfig, x: dict[str, np.ndarray], folder: Path) -> float:
    """Of all outputs of a random model of a hand, over the size of the output."""
    x = {k: v.astype(np.float64) for k, v in x.items()}
    normal = x["contacts"][..., 4:7]  # of length one in float64: one takes the tangent once, the other twice
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True) + 1e-300
    torch.manual_seed(0)
    model = Aminn(config, of)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.15)
    model.stage1.fit_normalisers({k: torch.as_tensor(v, dtype=torch.float32) for k, v in x.items()})
    model.stage2.fit_normalisers({k: torch.as_tensor(v, dtype=torch.float32) for k, v in x.items()})
    save_checkpoint(folder, model, {"tau": 0.5})
    checkpoint = load_checkpoint(folder)
    ours = Reference(export_tables(checkpoint))(x)
    with torch.no_grad():
        theirs = checkpoint.model.double().debug(**{k: torch.as_tensor(v, dtype=torch.float64) for k, v in x.items()})
    assert set(ours) >= set(theirs)
    worst = 0.0
    for name, value in theirs.items():
        size = max(float(value.abs().max()), np.finfo(float).tiny)  # of a hand without tendons some are 0
        difference = float(np.abs(ours[name] - value.numpy()).max()) / size
        print(f"{name}: {difference:.1e}")
        worst = max(worst, difference)
    return worst


@pytest.mark.parametrize("fade", [False, True])
@pytest.mark.parametrize("dq0", ["statics", "inverse"])
def test_oracle_equals_the_trainers_model(dq0: str, fade: bool, tmp_path: Path) -> None:
    mechanics = (MechanicsConfig(dq0=dq0), MechanicsConfig(eps_m=3e-4, eps_kx=2e-3, dq0=dq0))
    config = replace(WIDE, mechanics=mechanics)
    assert _largest_difference(hand(), config, random_inputs(64, 2, fade), tmp_path) < 1e-8


@pytest.mark.parametrize(("friction", "most"), [("none", 1e-6), ("secant", 1e-5)])
@pytest.mark.parametrize("name", MADE_UP)
def test_oracle_equals_the_trainers_model_of_any_hand(name: str, friction: str, most: float, tmp_path: Path) -> None:
    """With a contact compliance a branch, and a twist stiffness where fingertips are soft; one branch lets go.

    Both solve K_x in float64; a pinch of two points, or springs of nominal size against random heads, cost it decades.
    """
    rng = np.random.default_rng(3)
    rows = [draw_inputs(rng, MADE_UP[name]) | {"w_e": draw_wrench(rng)} for _ in range(30)]
    x = {k: np.stack([r[k] for r in rows]).astype(np.float32) for k in rows[0]}
    x["contacts"][::4, 0, 0] = 0
    config = replace(WIDE, friction=friction)
    assert _largest_difference(MADE_UP[name], config, x, tmp_path) < most


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("name", ["reference", "soft gripper 2x2", "4x4 no tendons", "one joint per branch"])
def test_oracle_equals_the_trainers_model_where_contacts_slide(name: str, told: bool, tmp_path: Path) -> None:
    """And sensors say something of most states; one branch lets go, another fades.

    A slide that has just begun doubles what rounding changes, and three steps do so three times.
    """
    rng, of = np.random.default_rng(3), MADE_UP[name]
    rows = [draw_inputs(rng, of) | {"w_e": draw_wrench(rng)} for _ in range(30)]
    x = {k: np.stack([r[k] for r in rows]).astype(np.float32) for k in rows[0]}
    x["contacts"][::4, 0, 0], x["contacts"][1::4, -1, 0] = 0, 0.3
    config = replace(WIDE, friction="secant", sensors=told)
    if told:
        x |= random_sensors(of.dims, 30, 4)
    assert _largest_difference(of, config, x, tmp_path) < 5e-5
