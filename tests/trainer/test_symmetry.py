"""Mirror images: closure and statics of an image are images, and a hand that is not symmetric is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import hand

from aminn.data.dataset import Dataset
from aminn.hand.closure import closure
from aminn.hand.nominal import nominal_from_hand
from aminn.hand.symmetry import BRANCHES, MOTION, check_symmetric, mirror_inputs, mirror_targets
from aminn.model.config import ModelConfig, TrainConfig
from aminn.model.network import Aminn
from aminn.training.train import train
from aminn_base.errors import AminnError

NOMINAL = nominal_from_hand(hand())


def test_the_image_of_an_image_is_the_original(dataset: Dataset) -> None:
    x = dataset.inputs()
    for name, value in mirror_inputs(mirror_inputs(x)).items():
        torch.testing.assert_close(value, x[name], rtol=0, atol=0)
    y = torch.randn(5, 9)
    torch.testing.assert_close(mirror_targets(mirror_targets(y)), y, rtol=0, atol=0)
    assert torch.equal(mirror_targets(y[:, 0]), y[:, 0])


def test_the_closure_of_an_image_is_the_image_of_the_closure(dataset: Dataset) -> None:
    image = {k: v.double().numpy() for k, v in mirror_inputs(dataset.inputs()).items()}
    j_x, j_q = closure(NOMINAL, image["q"], image["x_ht"], image["contacts"])
    np.testing.assert_allclose(j_x, image["j_x"], atol=1e-7)
    np.testing.assert_allclose(j_q, image["j_q"], atol=1e-7)


def test_the_analytical_model_mirrors(dataset: Dataset) -> None:
    """Nothing learned: the response to an image is the image of the response."""
    backbone, x = Aminn(ModelConfig(), NOMINAL).stage2.backbone, dataset.inputs()
    response, image = backbone.nominal_response(x), backbone.nominal_response(mirror_inputs(x))
    torch.testing.assert_close(image.dx, response.dx * torch.tensor(MOTION), rtol=1e-4, atol=1e-9)
    torch.testing.assert_close(image.gate, response.gate[:, list(BRANCHES)], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("field", ["base", "axis", "link_a", "chol", "tendon_dir", "tendon_gain"])
def test_another_hand_is_told(field: str) -> None:
    check_symmetric(NOMINAL)
    value = getattr(NOMINAL, field).copy()
    value[0, ...] += 0.1
    with pytest.raises(AminnError, match="not the mirror image of finger 2; train with --set mirror=false"):
        check_symmetric(replace(NOMINAL, **{field: value}))


def test_images_change_what_is_learned(dataset: Dataset, tmp_path) -> None:
    config = TrainConfig(epochs=1)
    with_images = train(config, dataset, tmp_path / "with")
    without = train(replace(config, mirror=False), dataset, tmp_path / "without")
    same = [torch.equal(a, b) for a, b in zip(*(c.model.parameters() for c in (with_images, without)), strict=True)]
    assert not any(same)
