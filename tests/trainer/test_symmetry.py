"""Mirror images: closure and statics of an image are images, and a hand that is not symmetric is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import HANDS, hand, write_dataset
from torch import Tensor

from aminn.data.dataset import load_dataset
from aminn.hand.closure import closure
from aminn.hand.symmetry import Reflection
from aminn.model.config import ModelConfig, TrainConfig
from aminn.model.network import Aminn
from aminn.training.train import train
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import Mirror, rotation

HAND = hand()
SYMMETRIC = [name for name, h in HANDS.items() if h.mirror is not None]


def turned(h: Hand, turn: np.ndarray) -> Hand:
    """The same hand in a palm frame that is turned: its mirror plane lies along no axis."""
    branches = []
    for branch in h.branches:
        coordinates = [
            replace(c, axis=tuple(turn @ c.axis), anchor_m=tuple(turn @ c.anchor_m)) for c in branch.coordinates
        ]
        branches.append(replace(branch, coordinates=tuple(coordinates), tip_point_m=tuple(turn @ branch.tip_point_m)))
    mirror = Mirror(tuple(turn @ h.mirror.normal), h.mirror.branches)
    return replace(h, branches=tuple(branches), mirror=mirror)


CASES = {name: HANDS[name] for name in SYMMETRIC} | {"turned": turned(HAND, rotation(np.array([0.3, -0.5, 0.8])))}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Hand, dict[str, Tensor], Reflection]:
    """A symmetric hand, inputs of it, its reflection."""
    h = CASES[request.param]
    write_dataset(tmp_path / "data", grasps=10, cases=4, of=h)
    return h, load_dataset(tmp_path / "data").inputs(torch.float64), Reflection(h)


def test_the_image_of_an_image_is_the_original(case: tuple[Hand, dict[str, Tensor], Reflection]) -> None:
    h, x, mirror = case
    for name, value in mirror.inputs(mirror.inputs(x)).items():
        torch.testing.assert_close(value, x[name], rtol=0, atol=1e-12)
    y = torch.randn(5, 6 + h.dims.branches)
    torch.testing.assert_close(mirror.targets(mirror.targets(y)), y, rtol=0, atol=1e-6)
    assert torch.equal(mirror.targets(y[:, 0]), y[:, 0])


def test_the_closure_of_an_image_is_the_image_of_the_closure(case: tuple[Hand, dict[str, Tensor], Reflection]) -> None:
    h, x, mirror = case
    image = {k: v.numpy() for k, v in mirror.inputs(x).items()}
    j_x, j_q = closure(h, image["q"], image["x_ht"], image["contacts"])
    np.testing.assert_allclose(j_x, image["j_x"], atol=1e-12)
    np.testing.assert_allclose(j_q, image["j_q"], atol=1e-12)


def test_the_analytical_model_mirrors(case: tuple[Hand, dict[str, Tensor], Reflection]) -> None:
    """Nothing learned: the response to an image is the image of the response."""
    h, x, mirror = case
    backbone = Aminn(ModelConfig(), h).double().stage2.backbone
    response, image = backbone.nominal_response(x), backbone.nominal_response(mirror.inputs(x))
    torch.testing.assert_close(image.dx, mirror.motion(response.dx), rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(image.gate, response.gate[:, mirror.branches], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("axis", lambda c: replace(c, axis=(0.0, 0.6, 0.8))),
        ("anchor", lambda c: replace(c, anchor_m=(0.05, 0.0, 0.0))),
        ("springs", lambda c: replace(c, spring_Nm_rad=0.9)),
    ],
)
def test_a_mirror_that_is_none_is_told(what: str, change) -> None:
    Reflection(HAND)
    first, *others = HAND.branches
    broken = replace(first, coordinates=(change(first.coordinates[0]), *first.coordinates[1:]))
    with pytest.raises(AminnError, match=f"{what}: finger1 is not the mirror image of finger2; train with --set mir"):
        Reflection(replace(HAND, branches=(broken, *others)))
    with pytest.raises(AminnError, match="no plane with an image for each branch"):
        Reflection(replace(HAND, mirror=Mirror((1.0, 0.0, 0.0), (1, 1, 2))))


def test_images_change_what_is_learned_where_the_hand_is_symmetric(tmp_path: Path) -> None:
    """By default they are shown where there are any; a hand that has none refuses them, by name."""
    config = TrainConfig(epochs=1)

    def weights(name: str, of: Hand, mirror: bool | None) -> list[Tensor]:
        folder = tmp_path / of.name
        if not folder.exists():
            write_dataset(folder, grasps=100, of=of)
        run = train(replace(config, mirror=mirror), load_dataset(folder), tmp_path / name)
        return list(run.model.parameters())

    default, shown, hidden = (weights(f"run {m}", HAND, m) for m in (None, True, False))
    assert all(map(torch.equal, default, shown)) and not any(map(torch.equal, default, hidden))
    asymmetric = HANDS["asymmetric"]
    assert all(map(torch.equal, weights("none", asymmetric, None), weights("off", asymmetric, False)))
    with pytest.raises(AminnError, match="hand asymmetric has no mirror symmetry"):
        weights("on", asymmetric, True)
