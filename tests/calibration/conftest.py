"""Made-up pushes of a made-up hand, by a model that is exact: the analytical statics with theta."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

# The made-up hand and its grasps are those of the trainer's tests.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "trainer"))

from made_up import Draw
from synthetic import draw_inputs, draw_theta, draw_wrench, hand

from aminn.calibration.pushes import Array, Predict, Pushes, predictor
from aminn.model.config import ModelConfig
from aminn.model.network import Aminn
from aminn_hand import Hand
from aminn_hand.theta import Theta

ERROR = 0.02
"""Of the made-up motions, over their size."""
MOTION = (0.008, 0.28)
"""What a load may move the tool, m and rad: a model cuts motions at the bounds of a grasp that holds."""


@pytest.fixture(scope="session")
def lab_hand() -> Hand:
    return hand()


@pytest.fixture(scope="session")
def model(lab_hand: Hand) -> Aminn:
    """Untrained: the nominal hand, and theta as the mechanics have it."""
    torch.manual_seed(0)
    return Aminn(ModelConfig(told=True), lab_hand).eval()


@pytest.fixture(scope="session")
def predict(model: Aminn) -> Predict:
    torch.set_num_threads(1)
    return predictor(model)


@pytest.fixture(scope="session")
def draw(lab_hand: Hand, predict: Predict) -> Draw:
    """`draw(seed, pushes, grasps, error, off)`: pushes of a hand with a theta of its own, and theta.

    off: beyond the factors, by how much joint zeros and radius are off (P).
    """

    def drawn(
        seed: int, pushes: int = 10, grasps: int = 2, error: float = ERROR, off: Array | None = None, vary: float = 0.5
    ) -> tuple[Pushes, Array]:
        rng, radius = np.random.default_rng(seed), np.array([b.tip_radius_m for b in lab_hand.branches])
        theta = draw_theta(rng, lab_hand, 1, vary)[0]
        states = [draw_inputs(rng, lab_hand) for _ in range(grasps)]
        for x in states:  # contacts on the round tips
            x["contacts"][:, 1:4] = lab_hand.tips(x["q"]) + radius[:, None] * x["contacts"][:, 4:7]
        rows = [{k: states[i % grasps][k] for k in ("q", "x_ht", "contacts")} for i in range(pushes)]
        fields = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        w_e = np.stack([draw_wrench(rng) for _ in range(pushes)])
        right = Pushes(lab_hand, **fields, w_e=w_e, dx_ht=0 * w_e, grasp_id=np.arange(pushes) % grasps)
        dx = predict(right, np.tile(theta, (pushes, 1)))
        bounds = np.array(MOTION)
        while (far := (np.linalg.norm(dx.reshape(-1, 2, 3), axis=2) > bounds).any(1)).any():
            right = right.told(w_e=np.where(far[:, None], [draw_wrench(rng) for _ in far], right.w_e))
            dx = predict(right, np.tile(theta, (pushes, 1)))
        length = np.repeat([lab_hand.length_m, 1.0], 3)
        size = np.linalg.norm(dx / length, axis=1, keepdims=True)
        right = right.told(dx_ht=dx + error * size * length * rng.normal(size=dx.shape) / 6**0.5)
        if off is None:
            return right, theta
        contacts = right.contacts.copy()
        contacts[..., 1:4] -= off[-1] * contacts[..., 4:7]
        return right.told(q=right.q - off[Theta(lab_hand).zeros], contacts=contacts), theta + off

    return drawn
