"""Sensors of data sets: what is known of load cases, what is told, what training draws, and what it learns of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result
from synthetic import HANDS, hand, write_dataset
from torch import Tensor

import aminn
from aminn.data.dataset import Dataset, load_dataset
from aminn.data.measured import write_measured
from aminn.data.sensors import PRESETS, Told, draw, drawn, sensed, tells_all, truth
from aminn.evaluation.analysis import SensorNoise, with_noise
from aminn.evaluation.metrics import auroc
from aminn.evaluation.predict import predict, predict_states
from aminn.hand.symmetry import Reflection
from aminn.model.checkpoint import Checkpoint
from aminn.model.config import ModelConfig, SensorDraws, TrainConfig
from aminn.model.network import Aminn
from aminn.training.train import model_config, train
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_hand.hand import STATE
from aminn_hand.sensors import CLASS_NAMES, FRICTION_CLASSES, class_of

HAND = hand()
SENSORS = tuple(HAND.dims.sensors)
SENSING = ModelConfig(sensors=True)
BLIND = TrainConfig(epochs=1, model=ModelConfig(sensors=False))


def rowwise(data: Dataset, name: str) -> np.ndarray:
    return data.grasps[name][data.grasp_rows()]


def measured_data(folder: Path, data: Dataset, told: dict[str, np.ndarray]) -> Dataset:
    """The load cases as a lab would have measured them, with these sensors."""
    s = data.samples
    arrays = {name: s[name] for name in ("q", "x_ht", "w_e", "contacts", "dx_ht", "grasp_id", "stable")}
    write_measured(folder, data.hand, arrays | told)
    return load_dataset(folder)


def test_simulated_data_can_tell_everything(dataset: Dataset) -> None:
    found = truth(dataset)
    assert tuple(found) == SENSORS and tells_all(dataset)
    assert all((values[:, 0] == 1).all() for values in found.values())
    np.testing.assert_array_equal(found["friction"][:, 1], rowwise(dataset, "friction"))
    assert not found["friction"][:, 2].any()
    weight = rowwise(dataset, "tool_mass_kg")[:, None] * rowwise(dataset, "gravity_m_s2")
    np.testing.assert_allclose(found["tool_weight"][:, 1:], weight)
    np.testing.assert_array_equal(found["tendon_tension"][:, 1:], rowwise(dataset, "tendon_tension_N"))
    assert not set(SENSORS) & dataset.inputs().keys()  # nothing is told of it


def test_what_is_told_of_load_cases(dataset: Dataset) -> None:
    true = truth(dataset)
    assert sensed(dataset, PRESETS["nothing"]).inputs().keys() == dataset.inputs().keys()
    everything = sensed(dataset, PRESETS["all"])
    for name, values in true.items():
        np.testing.assert_array_equal(everything.samples[name], values)
    two = sensed(everything, PRESETS["class+weight"])  # tells anew, whatever was told before
    assert set(two.inputs()) - set(dataset.inputs()) == {"friction", "tool_weight"}
    classes = class_of(true["friction"][:, 1])
    np.testing.assert_array_equal(two.samples["friction"], [FRICTION_CLASSES[CLASS_NAMES[c]] for c in classes])


def test_noise_of_sensors_is_what_it_says(dataset: Dataset) -> None:
    told = Told("value", friction_noise=0.2, weight=True, weight_noise_N=0.05, tension=True, tension_noise=0.02)
    true, found = truth(dataset), sensed(dataset, told).samples
    ratio = np.log(found["friction"][:, 1] / true["friction"][:, 1])
    assert ratio.std() == pytest.approx(0.2, rel=0.1)
    np.testing.assert_allclose(found["friction"][:, 2], 0.2 * found["friction"][:, 1])
    assert (found["tool_weight"] - true["tool_weight"])[:, 1:].std() == pytest.approx(0.05, rel=0.1)
    share = found["tendon_tension"][:, 1:] / true["tendon_tension"][:, 1:] - 1
    assert share.std() == pytest.approx(0.02, rel=0.1)
    again, other = sensed(dataset, told).samples, sensed(dataset, told, seed=1).samples
    for name in SENSORS:
        assert np.array_equal(again[name], found[name]) and not np.array_equal(other[name], found[name])


@pytest.mark.parametrize("text", [*PRESETS, "friction", "class", "weight+tension", "class+weight+tension"])
def test_words_for_what_is_told(text: str) -> None:
    told = Told.parse(text)
    assert str(told) == text.replace("all", "friction+weight+tension") and Told.parse(str(told)) == told


@pytest.mark.parametrize("text", ["", "grip", "friction+class", "weight+weight", "nothing+weight", "class,weight"])
def test_words_that_say_nothing_are_refused(text: str) -> None:
    with pytest.raises(AminnError, match="expected nothing, all, or some of friction, class, weight, tension joined"):
        Told.parse(text)


def test_what_data_do_not_tell_is_refused(tmp_path: Path, dataset: Dataset) -> None:
    write_dataset(tmp_path / "data", grasps=4, of=HANDS["4x4 no tendons"])
    data = load_dataset(tmp_path / "data")
    assert tells_all(data) and tuple(sensed(data, Told.parse("friction+weight")).inputs())[-1] == "tool_weight"
    with pytest.raises(AminnError, match="hand four has no tendons; leave tension out"):
        sensed(data, PRESETS["all"])
    light = replace(dataset, grasps={k: v for k, v in dataset.grasps.items() if k != "tool_mass_kg"})
    assert not tells_all(light)
    with pytest.raises(AminnError, match="the data say nothing of tool_weight; leave it out"):
        sensed(light, PRESETS["class+weight"])
    smooth = replace(dataset, grasps=dataset.grasps | {"friction": dataset.grasps["friction"] * 0})
    with pytest.raises(AminnError, match="friction: the coefficient is not positive in grasp 0; simulate"):
        truth(smooth)


def drawn_samples(n: int = 40_000, seed: int = 0) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """(what is known, what a step is shown) of made-up samples."""
    rng = np.random.default_rng(1)
    x = {
        "q": torch.zeros(n, 8),
        "friction": torch.tensor(np.stack([np.ones(n), rng.uniform(0.4, 1.1, n), np.zeros(n)], 1)).float(),
        "tool_weight": torch.tensor([1.0, 0.5, -1, 2]).expand(n, 4),
        "tendon_tension": torch.tensor([1.0, 10, 20, 30]).expand(n, 4),
    }
    return x, draw(x, SensorDraws(), torch.Generator().manual_seed(seed))


def test_a_training_step_knows_as_much_as_the_settings_say() -> None:
    x, shown = drawn_samples()
    for name, share in (("friction", 0.6), ("tool_weight", 0.5), ("tendon_tension", 0.3)):
        known = shown[name][:, 0]
        assert known.mean().item() == pytest.approx(share, abs=0.01)
        assert set(known.tolist()) == {0.0, 1.0} and not shown[name][known == 0].any()
    both = (shown["friction"][:, 0] * shown["tool_weight"][:, 0]).mean().item()
    assert both == pytest.approx(0.3, abs=0.01)  # one is known whatever is known of the other
    known, value, deviation = shown["friction"][shown["friction"][:, 0] > 0].unbind(-1)
    true = x["friction"][shown["friction"][:, 0] > 0][:, 1]
    middles = torch.tensor([FRICTION_CLASSES[name][1] for name in CLASS_NAMES])
    is_class = (value[:, None] == middles).any(1)
    assert is_class.float().mean().item() == pytest.approx(0.5, abs=0.01)
    assert torch.equal(value[is_class], middles[torch.as_tensor(class_of(true[is_class].numpy()))])
    share = deviation / value
    error = torch.log(value / true) / share.clamp_min(1e-9)
    assert error[~is_class & (share > 1e-3)].std().item() == pytest.approx(1, rel=0.03)
    assert share[~is_class].max() <= 0.3 and share[~is_class].median().item() == pytest.approx(0.075, rel=0.05)
    weight = shown["tool_weight"][shown["tool_weight"][:, 0] > 0][:, 1:] - torch.tensor([0.5, -1, 2])
    assert weight.std().item() == pytest.approx(0.05 / 3**0.5, rel=0.03)
    tension = shown["tendon_tension"][shown["tendon_tension"][:, 0] > 0][:, 1:] / torch.tensor([10.0, 20, 30])
    assert tension.std().item() == pytest.approx(0.02, rel=0.03)


def test_draws_follow_from_the_generator_alone() -> None:
    first, second, other = (drawn_samples(100, seed)[1] for seed in (0, 0, 1))
    for name in SENSORS:
        assert torch.equal(first[name], second[name]) and not torch.equal(first[name], other[name])


def test_what_a_lab_did_not_know_no_step_knows_and_what_it_was_unsure_of_stays_so() -> None:
    x, _ = drawn_samples(2000)
    odd = torch.arange(2000) % 2
    x["friction"] = x["friction"] * odd[:, None] + torch.tensor([0, 0, 0.1])
    x["tool_weight"] = x["tool_weight"] * odd[:, None]
    shown = draw(x, SensorDraws(friction=1, friction_class=1), torch.Generator().manual_seed(0))
    torch.testing.assert_close(shown["friction"], x["friction"] * odd[:, None])
    assert not shown["tool_weight"][odd == 0].any() and shown["tool_weight"][odd == 1].any()


def test_the_validation_draw_is_one_and_the_same(dataset: Dataset) -> None:
    part = dataset.split("validation")
    first, second = drawn(part, SensorDraws()).samples, drawn(sensed(part, PRESETS["all"]), SensorDraws()).samples
    for name in SENSORS:
        assert np.array_equal(first[name], second[name]) and 0 < first[name][:, 0].mean() < 1
    none = drawn(part, SensorDraws(friction=0, weight=0, tension=0)).samples
    assert not any(none[name].any() for name in SENSORS)


def slippery(data: Dataset) -> Dataset:
    """The same load cases, of which friction and the size of the load decide whether they hold."""
    ratio = np.linalg.norm(data.samples["w_e"][:, :3], axis=1) / rowwise(data, "friction") ** 3
    return replace(data, samples=data.samples | {"stable": (ratio < np.quantile(ratio, 0.6)).astype(np.uint8)})


@pytest.fixture(scope="module")
def sensing(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Checkpoint]:
    folder = tmp_path_factory.mktemp("sensing")
    config = TrainConfig(epochs=12, batch=64, model=SENSING)
    return {kind: train(replace(config, kind=kind), slippery(dataset), folder / kind) for kind in ("aminn", "mlp")}


@pytest.fixture(scope="module")
def blind(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Checkpoint:
    """A run without sensors."""
    return train(BLIND, dataset, tmp_path_factory.mktemp("blind") / "run")


def test_one_model_is_better_the_more_it_is_told(dataset: Dataset, sensing: dict[str, Checkpoint]) -> None:
    data = slippery(dataset)
    test = data.split("test")
    for kind, run in sensing.items():
        assert run.model.config.sensors is True and run.meta["model"]["sensors"] is True
        found = {}
        for text in ("nothing", "class", "friction"):
            out = predict(run.model, sensed(test, Told.parse(text)))
            found[text] = auroc(out["p_stable"], test.samples["stable"] > 0)
        assert found["nothing"] + 0.01 < found["friction"] and found["nothing"] < found["class"], (kind, found)


def test_the_same_seed_gives_the_same_weights_and_draws_matter(dataset: Dataset, tmp_path: Path) -> None:
    config = TrainConfig(epochs=1, model=SENSING)

    def weights(name: str, draws: SensorDraws) -> bytes:
        return (train(replace(config, sensing=draws), dataset, tmp_path / name).path / "model.safetensors").read_bytes()

    first = weights("first", SensorDraws())
    assert weights("second", SensorDraws()) == first
    assert weights("third", SensorDraws(weight=0.9)) != first


def test_training_without_sensors_is_as_it_was(dataset: Dataset, tmp_path: Path) -> None:
    """Told data and other draws change nothing in a model that has no sensors."""
    told = sensed(dataset, PRESETS["all"])
    plain = train(BLIND, dataset, tmp_path / "plain").path / "model.safetensors"
    other = train(replace(BLIND, sensing=SensorDraws(friction=1)), told, tmp_path / "other").path
    assert (other / "model.safetensors").read_bytes() == plain.read_bytes()


def test_where_sensors_come_from(dataset: Dataset, tmp_path: Path) -> None:
    unsaid = ModelConfig(sensors=None)
    assert model_config(unsaid, dataset).sensors is True and model_config(BLIND.model, dataset).sensors is False
    none = measured_data(tmp_path / "none", dataset, {})
    assert model_config(unsaid, none).sensors is False
    with pytest.raises(AminnError, match=r"model\.sensors = true, but the training data tell none of friction, tool_w"):
        model_config(SENSING, none)
    some = measured_data(tmp_path / "some", dataset, {"friction": truth(dataset)["friction"]})
    assert model_config(unsaid, some).sensors is False and model_config(SENSING, some).sensors is True


@pytest.mark.parametrize(("layer", "heard"), [("none", {"friction"}), ("secant", {"friction", "tool_weight"})])
def test_measured_data_with_some_sensors(dataset: Dataset, tmp_path: Path, layer: str, heard: set[str]) -> None:
    """Networks learn of what there is, in the rows in which it is; of the rest a value does nothing to them.

    What contacts that may slide carry of a weight is mechanics, which nobody has to learn.
    """
    friction = truth(dataset)["friction"] * (np.arange(len(dataset)) % 3 > 0)[:, None]
    data = measured_data(tmp_path / "data", dataset, {"friction": friction})
    np.testing.assert_array_equal(data.samples["friction"], friction)
    run = train(TrainConfig(epochs=2, model=replace(SENSING, friction=layer)), data, tmp_path / "run")
    everything = truth(dataset)
    with torch.no_grad():
        x = {k: v for k, v in data.inputs().items() if k != "friction"}
        nothing = run.model(**x)["p_stable"]
        for name, values in everything.items():
            same = torch.equal(run.model(**x, **{name: torch.tensor(values).float()})["p_stable"], nothing)
            assert same == (name not in heard), name


@pytest.mark.parametrize("told", [(), ("friction",)])
def test_a_sensing_run_goes_on_with_measured_data(
    told: tuple[str, ...], dataset: Dataset, sensing: dict[str, Checkpoint], tmp_path: Path
) -> None:
    true = truth(dataset)
    data = measured_data(tmp_path / "data", dataset, {name: true[name] for name in told})
    config = TrainConfig(epochs=1, learning_rate=1e-3)
    run = train(config, data, tmp_path / "run", finetune=sensing["aminn"])
    assert run.model.config.sensors is True
    norm, start = (c.model.stage2.backbone.global_norm for c in (run, sensing["aminn"]))
    assert torch.equal(norm.inv_std, start.inv_std)


def test_predictions_from_states_and_tables_take_sensors(dataset: Dataset, sensing: dict[str, Checkpoint]) -> None:
    told = sensed(slippery(dataset), PRESETS["all"]).take(np.arange(20))
    state = {name: told.samples[name] for name in STATE}
    sensors = {name: told.samples[name] for name in SENSORS}
    for run in sensing.values():
        expected, nothing = predict(run.model, told), predict_states(run.model, **state)
        found = predict_states(run.model, **state, sensors=sensors)
        np.testing.assert_allclose(found["p_stable"], expected["p_stable"], rtol=1e-4)
        assert not np.allclose(nothing["p_stable"], expected["p_stable"], rtol=1e-2)
        table = aminn.load(run.path).predict(**state, **sensors)
        np.testing.assert_allclose(table.p_stable, expected["p_stable"], rtol=1e-4)
        with pytest.raises(AminnError, match=r"friction has shape \(20, 2\), expected \(3,\) or \(20, 3\)"):
            predict_states(run.model, **state, sensors={"friction": sensors["friction"][:, :2]})
        with pytest.raises(AminnError, match="grip is no sensor of hand synthetic; there are friction, tool_w"):
            predict_states(run.model, **state, sensors={"grip": sensors["friction"]})


def test_a_measured_data_set_tells_the_predictor_what_it_knows(
    dataset: Dataset, sensing: dict[str, Checkpoint], tmp_path: Path
) -> None:
    friction = truth(dataset)["friction"]
    data = measured_data(tmp_path / "data", dataset, {"friction": friction})
    predictor = aminn.load(sensing["aminn"].path)
    expected = predict(sensing["aminn"].model, sensed(dataset, Told("value")))
    np.testing.assert_allclose(predictor.predict(tmp_path / "data").p_stable, expected["p_stable"], rtol=1e-4)
    np.testing.assert_array_equal(sensed(data, Told("value")).samples["friction"], friction)
    assert not set(SENSORS) & sensed(data, Told()).inputs().keys()


def test_noise_of_a_hands_sensors_reaches_weight_and_tensions(dataset: Dataset) -> None:
    """Friction stays: how well it is known is told with it."""
    told = sensed(dataset, PRESETS["all"])
    known = told.samples["tool_weight"] * (np.arange(len(told)) % 2)[:, None]
    told = replace(told, samples=told.samples | {"tool_weight": known})
    noise = SensorNoise()
    plain, noisy = with_noise(dataset, noise).samples, with_noise(told, noise).samples
    odd = known[:, 0] > 0
    change = noisy["tool_weight"] - known
    assert change[odd, 1:].std() == pytest.approx(noise.weight_N, rel=0.1) and not change[~odd].any()
    share = noisy["tendon_tension"][:, 1:] / told.samples["tendon_tension"][:, 1:] - 1
    assert share.std() == pytest.approx(noise.force, rel=0.1)
    np.testing.assert_array_equal(noisy["friction"], told.samples["friction"])
    for name in ("q", "w_e", "contacts", "j_x", "j_q"):
        np.testing.assert_array_equal(noisy[name], plain[name])


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in args])


def test_the_command_says_what_models_are_told(
    data_dir: Path, sensing: dict[str, Checkpoint], blind: Checkpoint, tmp_path: Path
) -> None:
    words = ("evaluate", "--data", data_dir, "--run", sensing["aminn"].path, "--split", "all")
    figures = {}
    for told in ("nothing", "class+weight"):
        result = call(*words, "--sensors", told, "--json", tmp_path / "figures.json")
        assert result.exit_code == 0, result.output
        figures[told] = json.loads((tmp_path / "figures.json").read_text())
    assert figures["nothing"]["aminn_auroc"] != figures["class+weight"]["aminn_auroc"]
    assert "told of the load cases: friction of 100%, tool_weight of 100%" in figures["class+weight"]["notes"]
    assert "told of" not in figures["nothing"]["notes"]
    result = call(*words, "--run", blind.path, "--sensors", "friction")
    assert f"{blind.path} was trained without sensors, and sees none" in " ".join(result.output.split())
    result = call(*words, "--sensors", "mood")
    assert result.exit_code == 1 and "sensors 'mood': expected nothing, all, or some of" in result.output
    explained = [
        call("explain", "--run", sensing["aminn"].path, "--data", data_dir, "--sample", 3, "--sensors", told).output
        for told in ("nothing", "all")
    ]
    assert "p_stable" in explained[0] and explained[0] != explained[1]


def test_the_card_names_the_sensors(sensing: dict[str, Checkpoint], blind: Checkpoint) -> None:
    card, plain = ((run.path / "card.md").read_text() for run in (sensing["mlp"], blind))
    assert "| optional sensors | friction (known of 60%), tool_weight (known of 50%), tendon_tension" in card
    assert "| optional sensors | none |" in plain and "Friction is not an input" in plain
    assert "Where friction is not told" in card


SHARD = "shard-00000.h5"


def changed(folder: Path, change: Callable[[h5py.File], None]) -> None:
    """A data set whose shard was changed, and the manifest with it."""
    with h5py.File(folder / SHARD, "r+") as file:
        change(file)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["shards"][0]["sha256"] = hashlib.sha256((folder / SHARD).read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))


def put(name: str, values: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = values

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("samples/friction", np.ones((32, 2))), r"/samples/friction has rows of shape \(2,\), expected \(3,\)"),
        (put("samples/friction", np.ones((31, 3))), "rows, the manifest says 32"),
        (put("samples/friction", np.tile([1.0, -1, 0], (32, 1))), r"coefficient is not positive in sample 0 \(32 such"),
        (put("samples/tool_weight", np.full((32, 4), 0.5)), "tool_weight: known is neither 0 nor 1 in sample 0"),
        (put("samples/tendon_tension", np.full((32, 7), np.nan)), "tendon_tension is not finite in sample 0"),
        (put("grasps/gravity_m_s2", np.ones(4)), r"/grasps/gravity_m_s2 has rows of shape \(\), expected \(3,\)"),
    ],
)
def test_sensors_of_shards_are_checked(tmp_path: Path, change: Callable, message: str) -> None:
    write_dataset(tmp_path / "data", grasps=4)
    changed(tmp_path / "data", change)
    with pytest.raises(AminnError, match=message):
        load_dataset(tmp_path / "data")


def test_data_sets_without_the_tools_weight_are_read(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", grasps=4)
    changed(tmp_path / "data", lambda file: file.__delitem__("grasps/tool_mass_kg"))
    assert tuple(truth(load_dataset(tmp_path / "data"))) == ("friction", "tendon_tension")


@pytest.mark.parametrize("name", [name for name, h in HANDS.items() if h.mirror is not None])
def test_mirror_images_of_sensors(name: str, tmp_path: Path) -> None:
    h = HANDS[name]
    write_dataset(tmp_path / "data", grasps=6, of=h)
    mirror, data = Reflection(h), load_dataset(tmp_path / "data")
    told = replace(data, samples=data.samples | truth(data))
    x = told.inputs(torch.float64)
    image = mirror.inputs(x)
    again = mirror.inputs(image)
    for sensor in h.dims.sensors:
        torch.testing.assert_close(again[sensor], x[sensor])
        assert torch.equal(image[sensor][:, 0], x[sensor][:, 0])
    assert torch.equal(image["friction"], x["friction"])
    force = mirror.motion(torch.cat([x["tool_weight"][:, 1:], torch.zeros(len(data), 3)], 1))[:, :3]
    torch.testing.assert_close(image["tool_weight"][:, 1:], force)
    names = [(b, t.arm_m) for b, branch in enumerate(h.branches) for t in branch.tendons]
    for t, (branch, arm) in enumerate(names):
        source = mirror.tendons[t]
        assert names[source] == (h.mirror.branches[branch], arm)
        assert torch.equal(image["tendon_tension"][:, 1 + t], x["tendon_tension"][:, 1 + source])


@pytest.mark.parametrize("name", [name for name, h in HANDS.items() if h.mirror is not None])
def test_contacts_that_slide_do_so_in_the_mirror_too(name: str, tmp_path: Path) -> None:
    """Friction and the preload that follows from the tool's weight: the response to an image is the image of it."""
    h = HANDS[name]
    write_dataset(tmp_path / "data", grasps=6, of=h)
    mirror, data = Reflection(h), load_dataset(tmp_path / "data")
    x = replace(data, samples=data.samples | truth(data)).inputs(torch.float64)
    x["tool_weight"] = x["tool_weight"] * torch.tensor([1.0, 5, 5, 5])
    backbone = Aminn(ModelConfig(sensors=True, friction="secant"), h).double().stage2.backbone
    response, image = backbone.nominal_response(x), backbone.nominal_response(mirror.inputs(x))
    torch.testing.assert_close(image.dx, mirror.motion(response.dx), rtol=1e-4, atol=1e-7)
    weightless = backbone.nominal_response({k: v for k, v in x.items() if k != "tool_weight"})
    assert not torch.allclose(weightless.friction_use, response.friction_use, rtol=1e-2)


def test_a_tendon_without_an_image_is_named() -> None:
    first, *others = HAND.branches
    shorter = replace(first, tendons=first.tendons[:1])
    broken = Reflection(HAND)
    broken.hand = replace(HAND, branches=(others[0], shorter, *others[1:]))
    with pytest.raises(AminnError, match=r"tendon finger2_tendon1 has no mirror image .* mirror=false"):
        broken.tendons  # noqa: B018
