"""Made-up pushes of a hand, as a lab would measure them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

# The made-up hand and its grasps are those of the trainer's tests.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "trainer"))

from lab import simulate_pushes
from synthetic import draw_inputs, draw_wrench, hand, true_stiffness

from aminn.data.dataset import Dataset, load_dataset
from aminn_hand import Hand
from aminn_table.columns import Arrays

GRASPS, PUSHES = 6, 4


@pytest.fixture(scope="session")
def lab_hand() -> Hand:
    return hand()


@pytest.fixture
def pushes(lab_hand: Hand) -> Arrays:
    """Four pushes of each of six grasps, ten seconds apart; contacts on the round tips."""
    rng, rows = np.random.default_rng(5), []
    for grasp in range(GRASPS):
        x = draw_inputs(rng, lab_hand)
        radius = np.array([b.tip_radius_m for b in lab_hand.branches])
        x["contacts"][:, 1:4] = lab_hand.tips(x["q"]) + radius[:, None] * x["contacts"][:, 4:7]
        stiffness = true_stiffness(lab_hand, x)
        for push in range(PUSHES):
            w = 0.05 * draw_wrench(rng)
            state = {name: x[name] for name in ("q", "x_ht", "contacts")}
            time = 1e3 + 70.0 * grasp + 10.0 * push
            rows.append(state | {"w_e": w, "dx_ht": np.linalg.solve(stiffness, w), "grasp_id": grasp, "time_s": time})
    arrays = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return arrays | {"stable": np.ones(len(rows), np.uint8)}


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_pushes(tmp_path_factory.mktemp("lab") / "simulated")


@pytest.fixture(scope="session")
def truth(simulated: Path) -> Dataset:
    return load_dataset(simulated)
