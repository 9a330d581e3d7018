"""Made-up pushes of a hand, as a lab would measure them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

# The made-up hand and its grasps are those of the trainer's tests.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "trainer"))

from lab import made_up, simulate_pushes
from synthetic import hand

from aminn.data.dataset import Dataset, load_dataset
from aminn_hand import Hand
from aminn_table.columns import Arrays


@pytest.fixture(scope="session")
def lab_hand() -> Hand:
    return hand()


@pytest.fixture
def pushes(lab_hand: Hand) -> Arrays:
    return made_up(lab_hand)


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_pushes(tmp_path_factory.mktemp("lab") / "simulated")


@pytest.fixture(scope="session")
def truth(simulated: Path) -> Dataset:
    return load_dataset(simulated)
