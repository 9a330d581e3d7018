"""A made-up data set, and checkpoints without training that say that they were trained on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from synthetic import write_dataset

from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import build_model, save_checkpoint
from aminn.model.config import ModelConfig, TrainConfig
from aminn.training.train import identity_of


@pytest.fixture(name="data_dir", scope="session")
def made_up_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made-up") / "data"
    write_dataset(folder, grasps=40, cases=8)
    return folder


WIDE = ModelConfig(width=(64, 64), contact_width=32, classifier_width=32)
"""Widths at which weights are most of a model's bytes, and random heads leave no grasp to eps_Kx alone."""


def untrained_run(folder: Path, data_dir: Path, kind: str = "aminn", **config: bool) -> Path:
    """A run of the data's hand in `folder`; `config` are settings of the model."""
    data = load_dataset(data_dir)
    identity = identity_of(TrainConfig(), data.sha256)
    meta = {"tau": 0.5173, "identity": identity, "data": {}, "data_config_sha256": data.manifest["config_sha256"]}
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = build_model(kind, replace(WIDE, **config), data.hand)
    save_checkpoint(folder, model, meta)
    return folder
