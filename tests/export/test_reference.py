"""The float64 oracle against the trainer's own model in float64: two implementations that share no code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from runtime_models import random_inputs
from synthetic import hand

from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn.model.config import MechanicsConfig
from aminn.model.export_tables import export_tables
from aminn.model.network import Aminn, ModelConfig
from aminn_export.samples.reference import Reference


@pytest.mark.parametrize("fade", [False, True])
@pytest.mark.parametrize("dq0", ["statics", "inverse"])
def test_oracle_equals_the_trainers_model(dq0: str, fade: bool, tmp_path: Path) -> None:
    torch.manual_seed(0)
    mechanics = (MechanicsConfig(dq0=dq0), MechanicsConfig(eps_m=3e-4, eps_kx=2e-3, dq0=dq0))
    config = replace(ModelConfig(), mechanics=mechanics)
    model = Aminn(config, hand())
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.15)
    x = random_inputs(64, 2, fade)
    model.stage1.fit_normalisers({k: torch.as_tensor(v) for k, v in x.items()})
    model.stage2.fit_normalisers({k: torch.as_tensor(v) for k, v in x.items()})
    save_checkpoint(tmp_path, model, {"tau": 0.5})
    checkpoint = load_checkpoint(tmp_path)
    ours = Reference(export_tables(checkpoint))(x)
    with torch.no_grad():
        theirs = checkpoint.model.double().debug(**{k: torch.as_tensor(v, dtype=torch.float64) for k, v in x.items()})
    assert set(ours) == set(theirs)
    for name, value in theirs.items():
        size = float(value.abs().max())
        difference = float(np.abs(ours[name] - value.numpy()).max()) / size
        print(f"{name}: {difference:.1e}")
        assert difference < 1e-8, name
