"""A made-up data set and small trained models, made once a test run."""

from __future__ import annotations

from pathlib import Path

import pytest
from synthetic import write_dataset

from aminn.data.dataset import Dataset, load_dataset
from aminn.model.checkpoint import Checkpoint
from aminn.model.config import TrainConfig
from aminn.training.train import train


@pytest.fixture(scope="session")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synthetic") / "data"
    write_dataset(folder, grasps=120, cases=12)
    return folder


@pytest.fixture(scope="session")
def dataset(data_dir: Path) -> Dataset:
    return load_dataset(data_dir)


@pytest.fixture(scope="session")
def runs(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Checkpoint]:
    """One trained model a kind."""
    folder = tmp_path_factory.mktemp("runs")
    return {kind: train(TrainConfig(kind=kind, epochs=15), dataset, folder / kind) for kind in ("aminn", "mlp")}
