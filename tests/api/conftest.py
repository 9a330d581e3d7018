"""Vectors of the reference model; and a made-up data set with untrained models of its hand, as run and as export."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

TESTS = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(TESTS / "export"), str(TESTS / "runtime"), str(TESTS / "trainer")]

from untrained import made_up_data, untrained_run  # noqa: E402, F401

from aminn_export.export import export  # noqa: E402
from aminn_export.samples.vectors import Vectors, read_vectors  # noqa: E402
from aminn_hand.hand import STATE  # noqa: E402


@pytest.fixture(scope="session")
def vectors() -> Vectors:
    """Of the reference model: inputs, and what ONNX Runtime makes of them."""
    return read_vectors(TESTS / "golden" / "golden.bin")


@pytest.fixture(scope="session")
def states(vectors: Vectors) -> dict[str, NDArray[np.float32]]:
    """Their states (200)."""
    return {name: vectors.inputs[name] for name in STATE}


@pytest.fixture(scope="session")
def run_dir(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "aminn", data_dir)


@pytest.fixture(scope="session")
def mlp_dir(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "mlp", data_dir, "mlp")


@pytest.fixture(scope="session")
def export_dir(run_dir: Path, data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "export"
    export(run_dir, folder, data_dir=data_dir)
    return folder
