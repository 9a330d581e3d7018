"""What a model may be told beside the state: the same by every engine, as arrays and as columns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_predict import ENGINES, call, near, place_of
from untrained import untrained_run

import aminn
from aminn.data.dataset import load_dataset
from aminn.data.measured import write_measured
from aminn.prediction.predictor import Predictor
from aminn_base.errors import AminnError
from aminn_export.export import export
from aminn_hand.hand import STATE
from aminn_hand.sensors import FRICTION_CLASSES
from aminn_rt.status import Status
from aminn_table import write_table

Arrays = dict[str, NDArray]


@pytest.fixture(scope="module")
def folder(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a model that senses, and its export."""
    place = tmp_path_factory.mktemp("sensing")
    untrained_run(place / "run", data_dir, sensors=True)
    export(place / "run", place / "export", data_dir=data_dir)
    return place


@pytest.fixture(scope="module")
def models(folder: Path) -> dict[str, Predictor]:
    return {engine: aminn.load(place_of(engine, folder / "run", folder / "export"), engine) for engine in ENGINES}


@pytest.fixture(scope="module")
def x(data_dir: Path) -> Arrays:
    samples = load_dataset(data_dir).samples
    return {name: samples[name] for name in STATE}


@pytest.fixture(scope="module")
def told(models: dict[str, Predictor], x: Arrays) -> Arrays:
    """Sensors of which every third row knows nothing."""
    rng, n = np.random.default_rng(4), len(x["q"])
    tendons = models["torch"].hand.dims.tendons
    found = {
        "friction": np.stack([np.ones(n), rng.uniform(0.4, 1.1, n), rng.uniform(0, 0.2, n)], 1),
        "tool_weight": np.concatenate([np.ones((n, 1)), rng.uniform(-0.5, 0.5, (n, 3))], 1),
        "tendon_tension": np.concatenate([np.ones((n, 1)), rng.uniform(0, 20, (n, tendons))], 1),
    }
    for k, values in enumerate(found.values()):
        values[k::3] = 0.0
    return found


def test_every_engine_is_told_the_same(models: dict[str, Predictor], x: Arrays, told: Arrays) -> None:
    plain = models["torch"].predict(x)
    for one in ({name: values} for name, values in told.items()):
        found = {engine: model.predict(**x, **one) for engine, model in models.items()}
        for each in found.values():
            near(each, found["torch"])
        (values,) = one.values()
        known = values[:, 0] > 0
        changed = np.abs(found["torch"].p_stable - plain.p_stable) > 1e-6
        assert changed[known].mean() > 0.9 and not changed[~known].any()


def test_what_is_not_known_is_not_zero(models: dict[str, Predictor], x: Arrays) -> None:
    for model in models.values():
        none = np.zeros(4)
        near(model.predict(**x, tool_weight=none), model.predict(x))
        zero = model.predict(**x, tool_weight=[1, 0, 0, 0])
        assert np.abs(zero.p_stable - model.predict(x).p_stable).max() > 1e-6


def test_what_may_be_said_for_short(models: dict[str, Predictor], x: Arrays, told: Arrays) -> None:
    model = models["torch"]
    for short, whole in (
        ({"friction": "mid"}, {"friction": FRICTION_CLASSES["mid"]}),
        ({"friction": 0.6}, {"friction": [1, 0.6, 0.06]}),
        ({"friction": [0.6, 0.02]}, {"friction": [1, 0.6, 0.02]}),
        ({"tool_weight": [0.1, 0, -0.8]}, {"tool_weight": [1, 0.1, 0, -0.8]}),
    ):
        found, wanted = model.predict(**x, **short), model.predict(**x, **whole)
        np.testing.assert_array_equal(found.p_stable, wanted.p_stable)
    weight, wanted = told["tool_weight"][:, 1:].copy(), model.predict(**x, tool_weight=told["tool_weight"])
    weight[told["tool_weight"][:, 0] == 0] = np.nan
    np.testing.assert_array_equal(model.predict(**x, tool_weight=weight).p_stable, wanted.p_stable)
    for wrong, message in (
        ({"friction": "wet"}, "friction is 'wet', expected numbers, or low, mid, high"),
        ({"tool_weight": "mid"}, "tool_weight is 'mid', expected numbers"),
        ({"friction": [0.6] * len(x["q"])}, r"friction has shape \(320,\), expected \(N, 3\) or \(3,\)"),
        ({"tension": 0}, "tension is no input; there are"),
    ):
        with pytest.raises(AminnError, match=message):
            model.predict(**x, **wrong)


@pytest.mark.parametrize("end", [".csv", ".h5", ".jsonl"])
def test_columns_of_a_table(end: str, models: dict[str, Predictor], x: Arrays, told: Arrays, tmp_path: Path) -> None:
    table = tmp_path / f"states{end}"
    write_table(table, models["torch"].hand, x | told)
    for model in models.values():
        found, wanted = model.predict(table), model.predict(**x, **told)
        np.testing.assert_array_equal(found.p_stable, wanted.p_stable)
        assert found.given.fallbacks == ()
        found.write(tmp_path / f"out{end}")
        again = model.predict(tmp_path / f"out{end}")  # what the table told is written too
        np.testing.assert_array_equal(again.p_stable, wanted.p_stable)


def test_a_measured_data_set_tells_its_sensors(
    models: dict[str, Predictor], data_dir: Path, x: Arrays, told: Arrays, tmp_path: Path
) -> None:
    data = load_dataset(data_dir)
    rows = {name: data.samples[name] for name in ("dx_ht", "grasp_id", "stable")}
    write_measured(tmp_path / "data", data.hand, x | told | rows)
    for model in models.values():
        found, wanted = model.predict(tmp_path / "data"), model.predict(**x, **told)
        near(found, wanted)


def test_rows_whose_sensors_cannot_be_are_bad(models: dict[str, Predictor], x: Arrays, told: Arrays) -> None:
    wrong = {name: values.copy() for name, values in told.items()}
    wrong["friction"][1, 1] = -0.3
    wrong["friction"][2, 2] = -0.1
    wrong["friction"][4, 0] = 0.5
    wrong["tool_weight"][5, 2] = np.nan
    wrong["tendon_tension"][6, 0] = 2.0
    for model in models.values():
        found, plain = model.predict(**x, **wrong), model.predict(**x, **told)
        assert np.flatnonzero(found.status).tolist() == [1, 2, 4, 5, 6]
        assert set(found.status[found.status != 0]) == {Status.SENSORS}
        assert "sensor" in found.texts[1] and np.isnan(found.p_stable[1])
        good = found.status == 0
        np.testing.assert_allclose(found.p_stable[good], plain.p_stable[good], atol=1e-6)  # ONNX Runtime's go by N


def test_rows_of_a_table_whose_sensors_cannot_be(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    table, n = tmp_path / "states.csv", 6
    write_table(table, models["torch"].hand, {name: values[:n] for name, values in x.items()})
    lines = table.read_text().splitlines()
    cells = [("friction", "friction_class"), ("0.6", ""), ("60", ""), ("-1", ""), ("0.6", "mid"), ("", "wet"), ("", "")]
    lines[1:] = [",".join([line, *more]) for line, more in zip(lines[1:], cells, strict=True)]
    table.write_text("\n".join(lines))
    for model in models.values():
        found = model.predict(table)
        assert np.flatnonzero(found.status).tolist() == [2, 3, 4]
        said = found.complaints()
        for text in (
            "line 4: friction is 60: more than 5; is this percent?",
            "line 5: friction is -1, expected more than 0",
            "line 6: friction_class is 'mid' beside a number of friction",
            "line 7: friction_class is 'wet', expected low, mid or high",
        ):
            assert any(line.startswith(text) for line in said), said
        assert not any("no prediction" in line for line in said)


def test_a_model_without_sensors_says_so(run_dir: Path, x: Arrays, told: Arrays, tmp_path: Path) -> None:
    """A table may well tell more than a model looks at; who gives an array wants it to count."""
    model = aminn.load(run_dir)
    write_table(tmp_path / "states.csv", model.hand, x | told)
    found = model.predict(tmp_path / "states.csv")
    line = "friction, tool_weight, tendon_tension: not looked at, since the model was trained without sensors"
    assert found.given.fallbacks == (line,)
    np.testing.assert_array_equal(found.p_stable, model.predict(x).p_stable)
    result = call("--run", run_dir, tmp_path / "states.csv", "--out", tmp_path / "out.csv")
    assert result.exit_code == 0 and result.stderr.count("not looked at") == 1
    with pytest.raises(AminnError, match="the model was trained without sensors; leave out friction, tool_weight"):
        model.predict(**x, friction=0.6, tool_weight=[0, 0, -1])


def test_one_state_as_json(folder: Path, models: dict[str, Predictor], x: Arrays) -> None:
    state = {name: values[2] for name, values in x.items()}
    sensors = {"friction_class": "high", "tool_weight": [0.0, 0.1, -0.7]}
    given = {name: values.tolist() for name, values in state.items()} | sensors
    result = call("--run", folder / "run", json.dumps(given))
    assert result.exit_code == 0, result.output
    wanted = models["torch"].predict(**state, friction="high", tool_weight=sensors["tool_weight"])
    assert np.float32(json.loads(result.stdout)["p_stable"]) == np.float32(wanted.p_stable[0])
