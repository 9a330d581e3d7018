"""Mechanics parameters: a model with theta is the model of the hand that theta describes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import HANDS, draw_inputs, draw_theta, draw_wrench, hand, write_dataset
from torch import Tensor
from untrained import WIDE

from aminn.data.dataset import Dataset, load_dataset
from aminn.evaluation.evaluate import evaluate
from aminn.evaluation.predict import predict, predict_states
from aminn.hand.closure import closure
from aminn.hand.nominal import nominal_of
from aminn.hand.symmetry import Reflection
from aminn.model.baseline import Mlp, n_parameters
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.model.config import MechanicsConfig, ModelConfig, TrainConfig
from aminn.model.export_tables import export_tables
from aminn.model.network import Aminn
from aminn.pages.explain import explain_sample
from aminn.training.train import model_config, train
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.theta import Theta

HAND = hand()
SIZE, FACTORS = len(Theta(HAND)), Theta(HAND).factors
NOMINAL = ("chol_nom", "tendon_dir_nom", "tendon_gain_nom")
Inputs = dict[str, Tensor]


@pytest.fixture(autouse=True)
def same_weights() -> None:
    torch.manual_seed(0)


def inputs(h: Hand, n: int = 6, seed: int = 0) -> Inputs:
    """Load cases (n) of different grasps, float64."""
    rng = np.random.default_rng(seed)
    rows = [draw_inputs(rng, h) | {"w_e": draw_wrench(rng)} for _ in range(n)]
    return {k: torch.tensor(np.stack([row[k] for row in rows])) for k in h.dims.inputs}


def lively(model: Aminn, seed: int = 0) -> Aminn:
    """The model in float64 with heads that are far from zero."""
    rng = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for backbone in (model.stage1.backbone, model.stage2.backbone):
            for head in (backbone.head, backbone.twist_head):
                if head is not None:
                    head.weight += 0.3 * torch.randn(head.weight.shape, generator=rng)
            if backbone.mechanics.learn_eps_m:
                backbone.eps_m_change += 0.4
    return model.double().eval()


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize(
    "options",
    [{}, {"soft_finger": True}, {"mechanics": MechanicsConfig(learn_eps_m=False)}],
    ids=["plain", "soft", "fixed eps_m"],
)
def test_theta_is_the_model_of_the_varied_hand(name: str, options: dict) -> None:
    """Every intermediate value, with heads at zero and far from it."""
    h, config = HANDS[name], ModelConfig(**options)
    x, theta = inputs(h), draw_theta(np.random.default_rng(1), h, 1, 0.8)[0]
    model, other = lively(Aminn(config, h)), Aminn(config, Theta(h).varied(theta)).double()
    learned = {k: v for k, v in model.state_dict().items() if k.split(".")[-1] not in NOMINAL}
    other.load_state_dict(learned, strict=False)
    told = torch.tensor(theta)
    out, expected = model.debug(**x, theta=told), other.debug(**x)
    for key, value in expected.items():
        torch.testing.assert_close(out[key], value, rtol=1e-4, atol=1e-6 * value.abs().max().item(), msg=key)
    for stage in ("stage1", "stage2"):
        r = getattr(model, stage).backbone.nominal_response(x | {"theta": told.expand(len(x["q"]), -1)})
        s = getattr(other, stage).backbone.nominal_response(x)
        torch.testing.assert_close(r.dx, s.dx, rtol=1e-5, atol=1e-6 * s.dx.abs().max().item())


@pytest.mark.parametrize("told", [False, True])
def test_no_theta_is_theta_of_zeros(told: bool) -> None:
    x = inputs(HAND)
    model = lively(Aminn(ModelConfig(told=told, soft_finger=True), HAND))
    none, zeros = model.debug(**x), model.debug(**x, theta=torch.zeros(SIZE))
    for key, value in none.items():
        torch.testing.assert_close(zeros[key], value, rtol=1e-4, atol=1e-6 * value.abs().max().item(), msg=key)


def test_a_row_for_all_is_a_row_for_each_and_zeros_and_radius_have_no_effect() -> None:
    x, rng = inputs(HAND), np.random.default_rng(2)
    model = lively(Aminn(ModelConfig(told=True), HAND))
    theta = torch.tensor(draw_theta(rng, HAND, 1)[0])
    alone, each = model(**x, theta=theta), model(**x, theta=theta.expand(6, -1))
    offset = torch.cat([torch.zeros(FACTORS), torch.ones(SIZE - FACTORS)])
    read = model(**x, theta=theta + offset)
    assert all(torch.equal(alone[key], each[key]) and torch.equal(alone[key], read[key]) for key in alone)


def test_theta_of_each_sample_is_its_own() -> None:
    x, theta = inputs(HAND), torch.tensor(draw_theta(np.random.default_rng(3), HAND, 6))
    model = lively(Aminn(ModelConfig(told=True, soft_finger=True), HAND))
    together = model(**x, theta=theta)["dx_ht"]
    alone = [model(**{k: v[i : i + 1] for k, v in x.items()}, theta=theta[i])["dx_ht"] for i in range(6)]
    torch.testing.assert_close(together, torch.cat(alone))


@pytest.mark.parametrize("name", ["reference", "5x5", "coupled", "one joint per branch"])
def test_gradients_by_theta(name: str) -> None:
    h = HANDS[name]
    x = inputs(h, 2)
    model = lively(Aminn(ModelConfig(told=True, soft_finger=True), h))
    theta = torch.tensor(draw_theta(np.random.default_rng(4), h, 2), requires_grad=True)
    size = model(**x, theta=theta)["dx_ht"].detach().abs()

    def seen(t: Tensor) -> tuple[Tensor, ...]:
        out = model(**x, theta=t)
        return out["dx_ht"] / size, out["p_stable"], torch.diagonal(out["k_x"], dim1=1, dim2=2).log()

    assert torch.autograd.gradcheck(seen, (theta,), eps=1e-6, atol=1e-5, rtol=1e-4)


def test_no_theta_and_no_head_create_energy() -> None:
    x, rng = inputs(HAND, 300), np.random.default_rng(5)
    for seed in range(3):
        model = lively(Aminn(ModelConfig(told=True), HAND), seed)
        out = model(**x, theta=torch.tensor(draw_theta(rng, HAND, 300, 3.0)))
        assert torch.isfinite(out["dx_ht"]).all() and torch.isfinite(out["p_stable"]).all()
        assert ((x["w_e"] * out["dx_ht"]).sum(1) > 0).all()


def test_free_heads_know_no_stiffness_that_theta_could_change() -> None:
    x, theta = inputs(HAND), torch.zeros(SIZE)
    theta[: Theta(HAND).stiff] = 0.7
    model = lively(Aminn(ModelConfig(heads="free"), HAND))
    torch.testing.assert_close(model(**x, theta=theta)["k_x"], model(**x)["k_x"], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kind", [Aminn, Mlp])
@pytest.mark.parametrize("shape", [(), (SIZE - 1,), (5, SIZE), (6, SIZE - 1), (1, 6, SIZE)])
def test_theta_of_another_shape_is_refused(kind: type, shape: tuple[int, ...]) -> None:
    model = kind(ModelConfig(), HAND).double()
    with pytest.raises(AminnError, match=rf"theta has shape .*, expected \({SIZE},\) or \(6, {SIZE}\)"):
        model(**inputs(HAND), theta=torch.zeros(shape))


def test_an_untold_model_has_the_tensors_of_one_without_theta() -> None:
    untold, told = (Aminn(ModelConfig(told=t), HAND).state_dict() for t in (False, True))
    assert untold.keys() == told.keys() and not any("theta" in key for key in untold)
    wider = {key for key in told if told[key].shape != untold[key].shape}
    names = ("global_norm.mean", "global_norm.inv_std", "trunk1.weight")
    assert wider == {f"stage{k}.backbone.{name}" for k in (1, 2) for name in names}
    for key in wider:
        assert told[key].shape[-1] - untold[key].shape[-1] == FACTORS


def test_the_baseline_sees_theta_if_told_and_keeps_its_budget() -> None:
    x, theta = inputs(HAND), torch.ones(SIZE)
    for told in (False, True):
        config = replace(WIDE, told=told)
        aminn, mlp = Aminn(config, HAND), Mlp(config, HAND).double()
        for stage in ("stage1", "stage2"):
            ratio = n_parameters(getattr(mlp, stage)) / n_parameters(getattr(aminn, stage))
            assert abs(ratio - 1) < 0.02
        same = torch.equal(mlp(**x)["dx_ht"], mlp(**x, theta=theta)["dx_ht"])
        assert same != told


@pytest.mark.parametrize("kind", [Aminn, Mlp])
def test_measured_states_are_corrected_first(kind: type) -> None:
    """What the hand reads wrongly, theta puts right: then it is the true state, its closure, and the model."""
    rng, theta = np.random.default_rng(6), Theta(HAND)
    true = {k: v.numpy() for k, v in inputs(HAND).items()}
    t = draw_theta(rng, HAND, 6)
    t[:, theta.zeros], t[:, -1] = rng.normal(0, 0.02, (6, HAND.dims.joints)), 1e-3
    q, contacts = true["q"] - t[:, theta.zeros], true["contacts"].copy()
    contacts[..., 1:4] -= 1e-3 * contacts[..., 4:7]
    model = kind(ModelConfig(told=True), HAND).double().eval()
    out = predict_states(model, q, true["x_ht"], true["w_e"], contacts, t)
    j_x, j_q = closure(HAND, true["q"], true["x_ht"], true["contacts"])
    x = {k: torch.tensor(v) for k, v in (true | {"j_x": j_x, "j_q": j_q, "theta": t}).items()}
    with torch.no_grad():
        for key, value in model(**x).items():
            np.testing.assert_allclose(out[key], value.numpy(), rtol=1e-8, atol=1e-12)
    nominal = predict_states(model.float(), true["q"], true["x_ht"], true["w_e"], true["contacts"])
    assert nominal["dx_ht"].dtype == np.float64 and not np.allclose(nominal["dx_ht"], out["dx_ht"])
    with pytest.raises(AminnError, match=r"contacts has shape \(6, 3, 7\), expected \(6, 3, 8\)"):
        predict_states(model, q, true["x_ht"], true["w_e"], contacts[..., :7], t)
    with pytest.raises(AminnError, match=r"theta has shape \(3,\)"):
        predict_states(model, q, true["x_ht"], true["w_e"], contacts, np.zeros(3))


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("varied") / "data"
    write_dataset(folder, grasps=120, cases=8, vary=0.5)
    return load_dataset(folder)


@pytest.fixture(scope="module")
def told(varied: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Checkpoint]:
    folder = tmp_path_factory.mktemp("told")
    return {kind: train(TrainConfig(kind=kind, epochs=3), varied, folder / kind) for kind in ("aminn", "mlp")}


def test_data_that_vary_theta_make_a_told_model(varied: Dataset, told: dict[str, Checkpoint]) -> None:
    for kind, run in told.items():
        assert run.model.config.told is True and run.meta["model"]["told"] is True, kind
        norm = run.model.stage2.backbone.global_norm if kind == "aminn" else run.model.stage2.norm
        assert not torch.equal(norm.mean, torch.zeros_like(norm.mean))
        out = predict(run.model, varied)
        unknown = predict(run.model, replace(varied, samples={k: v for k, v in varied.samples.items() if k != "theta"}))
        assert not np.allclose(out["p_stable"], unknown["p_stable"], atol=1e-3)
    tables = export_tables(told["aminn"])
    assert tables.meta["told"] is True and tables.meta["theta_names"] == list(Theta(HAND).names)
    assert len(tables.meta["theta_units"]) == SIZE and tables.meta["theta_units"][-1] == "m"
    assert tables.tensors["theta_terms"].shape == (1 + Theta(HAND).stiff, 3, 7)
    assert tables.tensors["s1.global_mean"].shape == (HAND.dims.global_input + FACTORS + HAND.dims.sensed,)


def test_the_formula_stands_beside_the_runs_with_theta_and_without(
    varied: Dataset, told: dict[str, Checkpoint], dataset: Dataset, runs: dict[str, Checkpoint]
) -> None:
    table = evaluate(list(told.values()), varied).table
    assert list(table) == ["aminn", "mlp", "analytical", "analytical_stick", "analytical_nominal", "no_motion"]
    known, unknown = (table[name]["relative_error_median_all"] for name in ("analytical", "analytical_nominal"))
    assert known < unknown
    assert "analytical_nominal" not in evaluate(list(runs.values()), dataset).table


def test_hands_that_the_training_saw_are_noted(varied: Dataset, told: dict[str, Checkpoint]) -> None:
    """Grasps that share a hand stand on both sides of a split by grasp."""
    runs = [told["aminn"]]
    assert evaluate(runs, varied).notes == ()
    hands = np.random.default_rng(8).uniform(-0.5, 0.5, (4, SIZE))
    shared = replace(varied, samples=varied.samples | {"theta": hands[varied.samples["grasp_id"] % 4]})
    assert evaluate(runs, shared).notes[0].startswith("4 of its 4 hands are hands of the training split too; ")
    assert evaluate(runs, shared, "train").notes == ()


def test_the_explanation_compares_with_the_hand_that_theta_describes(
    varied: Dataset, told: dict[str, Checkpoint]
) -> None:
    e = explain_sample(told["aminn"], varied, 3)
    own = nominal_of(Theta(HAND).varied(varied.samples["theta"][3]))
    factor = np.zeros((3, 3, 3))
    rows, cols = np.transpose(HAND.dims.cholesky_entries)
    factor[:, rows, cols] = own.chol
    np.testing.assert_allclose(e.nominal_stiffness, (factor**2).sum(2), rtol=1e-5)


def test_untold_training_is_the_same_whether_told_so_or_not(dataset: Dataset, tmp_path: Path) -> None:
    runs = [train(TrainConfig(epochs=1, model=ModelConfig(told=t)), dataset, tmp_path / str(t)) for t in (None, False)]
    weights = [(run.path / "model.safetensors").read_bytes() for run in runs]
    assert weights[0] == weights[1] and runs[0].model.config.told is False
    assert [load_checkpoint(run.path).model.config.told for run in runs] == [False, False]


def test_a_model_cannot_be_told_what_the_data_do_not_vary(dataset: Dataset, varied: Dataset) -> None:
    one = replace(varied, samples=varied.samples | {"theta": np.ones_like(varied.samples["theta"])})
    for data in (dataset, one):
        assert model_config(ModelConfig(), data).told is False
        with pytest.raises(AminnError, match=r"model\.told = true, but the mechanics parameters of all grasps"):
            model_config(ModelConfig(told=True), data)


def test_the_settings_say_where_told_comes_from(tmp_path: Path) -> None:
    from aminn.model.config import as_toml, load_config

    text = as_toml(load_config())
    assert 'told = "data"' in text
    (tmp_path / "mine.toml").write_text(text)
    assert load_config(tmp_path / "mine.toml") == load_config()
    assert load_config(None, ["model.told=true"]).model.told is True


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m | {"theta_names": ["a", "b"]}, "theta_names are not the parameters of its hand, spring_fin"),
        (lambda m: {k: v for k, v in m.items() if k != "theta_names"}, None),
    ],
    ids=["other names", "none"],
)
def test_theta_of_other_parameters_is_refused(
    tmp_path: Path, change: Callable[[dict], dict], message: str | None
) -> None:
    folder = tmp_path / "data"
    write_dataset(folder, grasps=10, vary=0.5)
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(change(manifest)))
    if message is None:
        assert not load_dataset(folder).has_theta
        return
    with pytest.raises(AminnError, match=message):
        load_dataset(folder)


@pytest.mark.parametrize("name", [name for name, h in HANDS.items() if h.mirror is not None])
def test_the_image_of_a_varied_hand_is_the_hand_with_the_image_of_theta(name: str) -> None:
    h = HANDS[name]
    mirror, theta = Reflection(h), Theta(h)
    x = inputs(h) | {"theta": torch.tensor(draw_theta(np.random.default_rng(7), h, 6))}
    x["theta"][:, theta.zeros] = x["q"] + 1  # so that they must go where q goes
    image = mirror.inputs(x)
    assert torch.equal(mirror.inputs(image)["theta"], x["theta"])
    torch.testing.assert_close(image["theta"][:, theta.zeros], image["q"] + 1)
    backbone = Aminn(ModelConfig(soft_finger=True), h).double().stage2.backbone
    response, reflected = backbone.nominal_response(x), backbone.nominal_response(image)
    torch.testing.assert_close(reflected.dx, mirror.motion(response.dx), rtol=1e-5, atol=1e-8)


def test_shared_parameters_stay_and_others_are_exchanged() -> None:
    shared, stiff = Reflection(HAND).parameters, Theta(HAND).stiff
    assert shared[:stiff] == list(range(stiff)) and shared[stiff:FACTORS] == [stiff + b for b in (1, 0, 2)]
    apart = replace(HAND, branches=tuple(replace(b, group=b.name) for b in HAND.branches))
    names = Theta(apart).names
    other = {"finger1": "finger2", "finger2": "finger1", "thumb": "thumb"}
    images = [re.sub("finger1|finger2|thumb", lambda found: other[found[0]], name) for name in names]
    assert [names[r] for r in Reflection(apart).parameters] == images != list(names)


def test_a_mirror_that_mixes_parameters_is_refused() -> None:
    """Fingers of one group share a spring, their images do not: no theta describes the image."""
    h = HANDS["coupled"]
    alone = replace(h.branches[0], group="first")
    h = replace(h, branches=(alone, *h.branches[1:]))
    with pytest.raises(AminnError, match=r"the parts of spring_f0_bend0 have no mirror images .* mirror=false"):
        Reflection(h).parameters  # noqa: B018
