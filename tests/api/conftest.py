"""Helpers of the other folders: vectors of the reference model, random models and states of other hands."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

TESTS = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(TESTS / "export"), str(TESTS / "runtime"), str(TESTS / "trainer")]
GOLDEN = TESTS / "golden"

from aminn_export.samples.vectors import Vectors, read_vectors  # noqa: E402
from aminn_hand.hand import STATE  # noqa: E402


@pytest.fixture(scope="session")
def vectors() -> Vectors:
    """Of the reference model: inputs, and what ONNX Runtime makes of them."""
    return read_vectors(GOLDEN / "golden.bin")


@pytest.fixture(scope="session")
def states(vectors: Vectors) -> dict[str, NDArray[np.float32]]:
    """Their states (200)."""
    return {name: vectors.inputs[name] for name in STATE}
