"""Optional sensors: their form, what networks see of them, and that absent is not zero."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from synthetic import HANDS, draw_inputs, draw_wrench, hand
from torch import Tensor
from untrained import WIDE

from aminn.model.baseline import Mlp, n_parameters
from aminn.model.checkpoint import build_model
from aminn.model.config import ModelConfig
from aminn.model.network import Aminn, sensed_input, told_friction
from aminn_base.errors import AminnError
from aminn_hand import sensors
from aminn_hand.sensors import CLASS_EDGES, CLASS_NAMES, FRICTION_CLASSES, FRICTION_RANGE, NOMINAL_FRICTION
from aminn_sim.config import SimulationConfig

HAND = hand()
DIMS = HAND.dims
KINDS = ("aminn", "sliding", "mlp")


def test_sizes_follow_from_the_hand() -> None:
    assert DIMS.sensors == {"friction": (3,), "tool_weight": (4,), "tendon_tension": (1 + DIMS.tendons,)}
    assert DIMS.sensed == 2 + 4 + 1 + DIMS.tendons and DIMS.sensing == 0
    bare = HANDS["4x4 no tendons"].dims
    assert list(bare.sensors) == ["friction", "tool_weight"] and bare.sensed == 6
    sensing = replace(DIMS, sensing=DIMS.sensed)
    assert sensing.global_input == DIMS.global_input + DIMS.sensed and sensing.inputs == DIMS.inputs
    assert list(sensors.UNITS) == list(DIMS.sensors)


def test_classes_are_thirds_of_the_friction_that_is_simulated() -> None:
    assert FRICTION_RANGE == (SimulationConfig().friction_min, SimulationConfig().friction_max)
    mu = np.random.default_rng(0).uniform(*FRICTION_RANGE, 30_000)
    found = sensors.class_of(mu)
    for k, name in enumerate(CLASS_NAMES):
        known, middle, deviation = FRICTION_CLASSES[name]
        own = mu[found == k]
        assert known == 1 and len(own) / len(mu) == pytest.approx(1 / 3, abs=0.01)
        assert (middle, deviation) == pytest.approx((own.mean(), own.std()), rel=0.01)
    assert sensors.class_of(np.array([0.1, CLASS_EDGES[0], CLASS_EDGES[1], 5.0])).tolist() == [0, 1, 2, 2]


def test_trust_goes_from_exact_to_unknown() -> None:
    friction = np.array([[0, 0, 0], [0, 0.4, 0], [1, 0.4, 0], [1, 0.4, 0.12], [1, 0.4, 1e6]])
    np.testing.assert_allclose(sensors.trust(friction), [0, 0, 1, 0.5, 0], atol=1e-9)
    told = [NOMINAL_FRICTION, NOMINAL_FRICTION, 0.4, (0.4 * NOMINAL_FRICTION) ** 0.5, NOMINAL_FRICTION]
    np.testing.assert_allclose(sensors.told_friction(friction), told, rtol=1e-9)


def test_what_networks_see_of_sensors() -> None:
    weight, tension = np.array([[1, 0.5, -2, 3]]), np.array([[1, *range(DIMS.tendons)]])
    seen = sensors.sensed_numbers(DIMS, {"tool_weight": weight, "tendon_tension": tension}, 1)
    np.testing.assert_array_equal(seen, [[0, 0, 1, 0.5, -2, 3, 1, *range(DIMS.tendons)]])
    unknown = {"tool_weight": weight * [0, 1, 1, 1], "friction": np.array([[0, 0.4, 0.1]])}
    np.testing.assert_array_equal(sensors.sensed_numbers(DIMS, unknown, 1), np.zeros((1, DIMS.sensed)))
    exact = sensors.sensed_numbers(DIMS, {"friction": np.array([[1, 1.5, 0]])}, 1)
    np.testing.assert_allclose(exact[0, :2], [1, np.log(2)])


@pytest.mark.parametrize(
    ("name", "row", "message"),
    [
        ("friction", [1, np.nan, 0], "friction is not finite"),
        ("friction", [0.5, 0.7, 0], "friction: known is neither 0 nor 1"),
        ("friction", [1, 0, 0], "friction: the coefficient is not positive"),
        ("friction", [1, 0.7, -0.1], "friction: the standard deviation is negative"),
        ("tool_weight", [2, 0, 0, 0], "tool_weight: known is neither 0 nor 1"),
        ("tool_weight", [0, np.inf, 0, 0], "tool_weight is not finite"),
    ],
)
def test_what_no_sensor_says(name: str, row: list[float], message: str) -> None:
    good = np.zeros(len(row))
    found = {text: rows.tolist() for rows, text in sensors.faults(name, np.array([good, row])) if rows.any()}
    assert found == {message: [False, True]}


def inputs(n: int = 6, seed: int = 0) -> dict[str, Tensor]:
    """Load cases (n) of different grasps, float64."""
    rng = np.random.default_rng(seed)
    rows = [draw_inputs(rng, HAND) | {"w_e": draw_wrench(rng)} for _ in range(n)]
    return {k: torch.tensor(np.stack([row[k] for row in rows])) for k in DIMS.inputs}


def known(n: int = 6, seed: int = 0) -> dict[str, Tensor]:
    """Sensors (n) that all know their values."""
    rng = np.random.default_rng(seed)
    friction = np.stack([np.ones(n), rng.uniform(0.4, 1.1, n), rng.uniform(0, 0.2, n)], 1)
    weight = np.hstack([np.ones((n, 1)), rng.normal(0, 2, (n, 3))])
    tension = np.hstack([np.ones((n, 1)), rng.uniform(0, 20, (n, DIMS.tendons))])
    return {k: torch.tensor(v) for k, v in zip(DIMS.sensors, (friction, weight, tension), strict=True)}


def sensing_model(kind: str, sensors: bool = True, base: ModelConfig | None = None) -> Aminn | Mlp:
    """An untrained model of `KINDS` in float64, whose heads are far enough from zero to see what its networks see."""
    torch.manual_seed(0)
    friction: Literal["secant", "none"] = "secant" if kind == "sliding" else "none"
    config = replace(base or ModelConfig(), sensors=sensors, friction=friction)
    model = build_model("mlp" if kind == "mlp" else "aminn", config, HAND).double().eval()
    if isinstance(model, Aminn):
        for backbone in (model.stage1.backbone, model.stage2.backbone):
            torch.nn.init.normal_(backbone.head.weight, std=0.3)
    return model


def test_networks_see_in_pytorch_what_they_see_elsewhere() -> None:
    x, s = inputs(), known()
    some = {name: value * torch.tensor([0.0, 1, 0, 1, 1, 0])[:, None] for name, value in s.items()}
    for given in (s, some, {"tool_weight": s["tool_weight"]}, {}):
        numbers = sensors.sensed_numbers(DIMS, {k: v.numpy() for k, v in given.items()}, 6)
        np.testing.assert_allclose(sensed_input(x | given, DIMS), numbers, rtol=1e-12, atol=1e-15)
        told = sensors.told_friction(given.get("friction", torch.zeros(6, 3)).numpy())
        np.testing.assert_allclose(told_friction(x | given), told, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_absent_is_not_zero(kind: str) -> None:
    """Nothing given is known 0; a weight of zero newtons is something known."""
    x, model = inputs(), sensing_model(kind)
    nothing = model(**x)
    zeros = model(**x, **{name: torch.zeros(size) for name, size in DIMS.sensors.items()})
    assert all(torch.equal(nothing[key], zeros[key]) for key in nothing)
    for name, value in known().items():
        told = model(**x, **{name: value})
        unknown = model(**x, **{name: value * (torch.arange(value.shape[1]) > 0)})
        assert not torch.equal(told["p_stable"], nothing["p_stable"]), name
        assert all(torch.equal(unknown[key], nothing[key]) for key in nothing), name
    weightless = model(**x, tool_weight=torch.tensor([1.0, 0, 0, 0]))
    assert not torch.equal(weightless["dx_ht"], nothing["dx_ht"])


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_without_sensors_takes_them_without_effect(kind: str) -> None:
    x, model = inputs(), sensing_model(kind, sensors=False)
    plain, told = model(**x), model(**x, **known())
    assert all(torch.equal(plain[key], told[key]) for key in plain)
    sensing = sensing_model(kind)
    assert n_parameters(sensing) > n_parameters(model) - 100 and not any("sens" in k for k in sensing.state_dict())


def test_both_kinds_keep_one_budget_with_sensors() -> None:
    aminn, mlp = (sensing_model(kind, base=WIDE) for kind in ("aminn", "mlp"))
    for stage in ("stage1", "stage2"):
        assert abs(n_parameters(getattr(mlp, stage)) / n_parameters(getattr(aminn, stage)) - 1) < 0.02


def test_nothing_that_is_told_creates_energy() -> None:
    x, model = inputs(200), sensing_model("sliding")
    for seed in range(3):
        s = known(200, seed)
        out = model(**x, **s | {"friction": s["friction"] * 10.0 ** torch.tensor([0, -3 + 2 * seed, 0])})
        assert all(value.isfinite().all() for value in out.values())
        assert ((x["w_e"] * out["dx_ht"]).sum(1) >= 0).all()


def test_a_row_for_all_is_a_row_for_each_and_each_row_is_its_own() -> None:
    x, model, s = inputs(), sensing_model("aminn"), known()
    for name, value in s.items():
        alone, each = model(**x, **{name: value[0]}), model(**x, **{name: value[:1].expand(6, -1)})
        assert all(torch.equal(alone[key], each[key]) for key in alone), name
    together = model(**x, **s)["dx_ht"]
    apart = [model(**{k: v[i : i + 1] for k, v in (x | s).items()})["dx_ht"] for i in range(6)]
    torch.testing.assert_close(together, torch.cat(apart))


@pytest.mark.parametrize("kind", ["aminn", "mlp"])
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("friction", torch.ones(2), r"friction has shape \(2,\), expected \(3,\) or \(6, 3\): whether it is known"),
        ("tool_weight", torch.ones(5, 4), r"tool_weight has shape \(5, 4\), expected \(4,\) or \(6, 4\)"),
        ("tendon_tension", torch.ones(()), r"tendon_tension has shape \(\), expected \(7,\) or \(6, 7\)"),
        ("friction", torch.tensor([1.0, -1, 0]), r"the coefficient is not positive in row 0 \(6 such rows\)"),
        ("friction", torch.eye(6, 3) - 0.1, "known is neither 0 nor 1 in row 0"),
        ("tool_weight", torch.full((4,), np.nan), "tool_weight is not finite in row 0"),
    ],
)
def test_sensors_that_cannot_be_are_refused(kind: str, name: str, value: Tensor, message: str) -> None:
    for has in (True, False):
        with pytest.raises(AminnError, match=message):
            sensing_model(kind, has)(**inputs(), **{name: value})


def test_tensions_of_a_hand_without_tendons_are_refused() -> None:
    model = build_model("mlp", ModelConfig(sensors=True), HANDS["4x4 no tendons"])
    with pytest.raises(AminnError, match="tendon_tension is given, but hand four has no tendons"):
        model(*(torch.zeros(1, *s) for s in model.hand.dims.inputs.values()), tendon_tension=torch.zeros(1))


@pytest.mark.parametrize("kind", ["aminn", "mlp"])
def test_a_sensor_that_training_never_knew_has_no_effect(kind: str) -> None:
    """Its weights are as they were drawn, so that a value would be noise."""
    x, s, model = inputs(), known(), sensing_model(kind)
    some = s["friction"] * torch.tensor([0.0, 1, 1, 0, 1, 0])[:, None]
    for stage in (model.stage1, model.stage2):
        stage.fit_normalisers({k: v.float() for k, v in (x | {"friction": some}).items()})
    nothing = model(**x)
    for name, value in s.items():
        same = torch.equal(model(**x, **{name: value})["p_stable"], nothing["p_stable"])
        assert same == (name != "friction"), name
