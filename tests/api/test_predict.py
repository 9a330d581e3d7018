"""`aminn.load(...).predict(...)` and `aminn predict`: any table in, the same columns out, by whatever engine."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from numpy.typing import NDArray
from untrained import untrained_run

import aminn
from aminn.data.dataset import Dataset, load_dataset
from aminn.prediction import predictor
from aminn.prediction.predictor import Predictions, Predictor
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_export.export import export
from aminn_hand.hand import STATE
from aminn_hand.theta import Theta
from aminn_rt import Model
from aminn_rt.model import model_file
from aminn_rt.status import Status, statuses
from aminn_table import FORMATS, write_table
from aminn_table.columns import RESULTS
from aminn_table.read import read_rough

ENGINES = ("torch", "onnx", "runtime")
Arrays = dict[str, NDArray]


def place_of(engine: str, run_dir: Path, export_dir: Path) -> Path:
    return run_dir if engine == "torch" else export_dir


@pytest.fixture(scope="module")
def models(run_dir: Path, export_dir: Path) -> dict[str, Predictor]:
    return {engine: aminn.load(place_of(engine, run_dir, export_dir), engine) for engine in ENGINES}


@pytest.fixture(scope="module")
def data(data_dir: Path) -> Dataset:
    return load_dataset(data_dir)


@pytest.fixture(scope="module")
def x(data: Dataset) -> Arrays:
    return {name: data.samples[name] for name in STATE}


def near(a: Predictions, b: Predictions) -> None:
    """Of one model, by two engines. Where contacts slide, the last digits of their forces count."""
    slides = np.asarray(b.friction_use).max(1) > 0.5
    np.testing.assert_allclose(a.p_stable, b.p_stable, atol=2e-5)
    for name, axes in (("dx_ht", 1), ("k_x", (1, 2))):
        ours, theirs = getattr(a, name), getattr(b, name)
        gap = np.abs(ours - theirs).max(axes) / np.abs(theirs).max(axes)
        assert np.nanmax(gap[~slides], initial=0.0) < 1e-4, name
        assert not slides.any() or (np.nanquantile(gap, 0.95) < 1e-4 and np.nanmax(gap) < 1e-2), name
    np.testing.assert_allclose(a.gate, b.gate, atol=1e-4)
    np.testing.assert_allclose(a.p_slide, b.p_slide, atol=1e-4)
    np.testing.assert_allclose(a.bound_95, b.bound_95, rtol=1e-3)
    np.testing.assert_allclose(a.friction_use, b.friction_use, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(a.status, b.status)
    assert list(a.columns) == list(b.columns)


def test_every_engine_predicts_the_same(
    models: dict[str, Predictor], x: Arrays, data_dir: Path, trust: dict[str, float | int | str | bool]
) -> None:
    for table in (x, data_dir):
        found = {engine: model.predict(table) for engine, model in models.items()}
        for engine in ENGINES:
            assert len(found[engine]) == len(x["q"]) and not found[engine].status.any()
            near(found[engine], found["runtime"])
        np.testing.assert_array_equal(found["onnx"].notes, found["runtime"].notes)
        size = np.abs(found["torch"].dx_ht).max(1, keepdims=True)
        for engine in ENGINES[1:]:
            gap = np.abs(found[engine].dx_ht - found["torch"].dx_ht) / size
            trust[f"predict_{engine}_to_torch_dx_relative_median"] = float(np.median(gap.max(1)))
    assert all(model.tau == pytest.approx(0.5173) for model in models.values())
    assert len({model.hand.sha256 for model in models.values()}) == 1


def test_names_of_theta_are_told_by_the_header_beside_the_model(models: dict[str, Predictor], export_dir: Path) -> None:
    names = Theta(models["torch"].hand).names
    assert models["onnx"].theta_names == Model.load(export_dir).theta_names == names
    header = (export_dir / "aminn_hand.h").read_text()
    assert f'X("{names[0]}")' in header
    named = Model(model_file(export_dir).read_bytes(), "the model", [f"own_{i}" for i in range(len(names))])
    assert named.theta_names[3] == "own_3"


def test_arrays_by_name_and_one_for_all(models: dict[str, Predictor], data: Dataset, x: Arrays) -> None:
    inputs = {name: data.samples[name] for name in ("j_x", "j_q")}
    for model in models.values():
        whole = model.predict(x)
        near(model.predict(**x, **inputs), whole)
        one = {name: values[4] for name, values in x.items()}
        loads = {"w_e": x["w_e"][4:7]}
        near(model.predict(**one | loads), model.predict({k: x[k][[4] * 3] for k in x} | loads))
        assert len(model.predict(**one)) == 1
        assert len(model.predict({name: values[:0] for name, values in x.items()})) == 0


def test_large_tables_go_in_chunks(models: dict[str, Predictor], x: Arrays, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, done = {name: model.predict(x) for name, model in models.items()}, []
    monkeypatch.setattr(predictor, "CHUNK", 150)
    for name, model in models.items():
        found = model.predict(x, progress=done.append)
        near(found, whole[name])
        np.testing.assert_array_equal(found.texts, whole[name].texts)
    assert done == [150, 300, 320] * 3


def test_the_engine_follows_from_what_is_given(run_dir: Path, export_dir: Path, tmp_path: Path) -> None:
    kinds = {run_dir: "Torch", export_dir: "Runtime", export_dir / "aminn.onnx": "Onnx"}
    kinds[model_file(export_dir)] = "Runtime"
    for path, kind in kinds.items():
        assert type(aminn.load(path).engine).__name__ == f"{kind}Engine"
    for path, engine, message in (
        (run_dir, "onnx", r"is a run, which PyTorch evaluates; for onnx: aminn export"),
        (export_dir, "torch", "no run of `aminn train`"),
        (export_dir, "tensorrt", "engine 'tensorrt' is unknown; there are torch, onnx, runtime"),
        (tmp_path / "nowhere", None, "is not there"),
        (tmp_path, "onnx", r"no aminn\.onnx"),
        (tmp_path, None, "one C model with its .bin expected"),
    ):
        with pytest.raises(AminnError, match=message):
            aminn.load(path, engine)


@pytest.mark.parametrize("end", FORMATS)
def test_tables_in_and_out(end: str, models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    table, model = tmp_path / f"states{end}", models["runtime"]
    ids = np.arange(len(x["q"]))
    write_table(table, model.hand, x | {"grasp_id": ids})
    found = model.predict(table)
    near(found, model.predict(x))
    found.write(tmp_path / f"predicted{end}")
    read = read_rough(tmp_path / f"predicted{end}", model.hand).arrays
    np.testing.assert_array_equal(read["grasp_id"], ids)
    np.testing.assert_array_equal(read["pred_dx_ht"].astype(np.float32), found.dx_ht)
    np.testing.assert_array_equal(read["holds"], found.holds)
    assert read["notes"].tolist() == found.texts.tolist()


def test_columns_of_a_mapping_and_of_a_data_frame(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    model = models["onnx"]
    write_table(tmp_path / "states.csv", model.hand, x)
    lines = (tmp_path / "states.csv").read_text().splitlines()[1:]
    numbers = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    columns = dict(zip(lines[0].split(","), numbers.T, strict=True))
    wanted = model.predict(tmp_path / "states.csv")
    near(model.predict(columns), wanted)

    names = tuple(columns)

    class Frame:
        """What a data frame has, wherever it is from."""

        columns = names
        index = range(7, 7 + len(numbers))

        def __getitem__(self, name: str) -> NDArray:
            return columns[name]

    found = model.predict(Frame())
    near(found, wanted)
    assert found.given.index == Frame.index
    with pytest.raises(AminnError, match=r"q_thumb_distal is missing; did you mean it with 'q_thumb_distol'\?"):
        model.predict({k.replace("distal", "distol") if "thumb" in k else k: v for k, v in columns.items()})


def test_a_data_frame_of_pandas(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    write_table(tmp_path / "states.csv", models["torch"].hand, x)
    frame = pandas.read_csv(tmp_path / "states.csv", comment="#").iloc[5:20]
    found = models["torch"].predict(frame).to_pandas()
    assert list(found.index) == list(frame.index)
    assert list(found.columns) == list(models["runtime"].predict(x).columns)


def test_bad_rows_stay_and_are_named(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    hand = models["torch"].hand
    bad = {name: values.copy() for name, values in x.items()}
    bad["contacts"][5, :, 0] = 0
    bad["contacts"][9, 1, 4:7] = 2.0
    bad["x_ht"][11, 3:] = 9.0
    wrong = {5: Status.NO_CONTACT, 9: Status.NORMAL, 11: Status.ROTATION}
    wrong |= {13: Status.NONFINITE, 17: Status.CONTACT_FLAG}
    bad["q"][13, 2] = np.nan
    bad["contacts"][17, 0, 0] = 1.5
    found = {engine: model.predict(bad) for engine, model in models.items()}
    whole = models["runtime"].predict(x)
    for engine, f in found.items():
        assert {i: int(s) for i, s in enumerate(f.status) if s} == {i: int(s) for i, s in wrong.items()}, engine
        near(f, found["runtime"])
        assert np.isnan(f.p_stable[list(wrong)]).all() and not f.holds[list(wrong)].any()
        assert f.texts[9] == "the contact normal of a branch in contact is not a unit vector"
        assert (np.delete(f.texts, list(wrong)) == np.delete(whole.texts, list(wrong))).all() or engine == "torch"
    for end in ("csv", "jsonl", "parquet"):
        write_table(tmp_path / f"bad.{end}", hand, bad | {"grasp_id": np.arange(len(bad["q"]))})
        read = models["runtime"].predict(tmp_path / f"bad.{end}")
        assert set(np.flatnonzero(read.status)) >= {5, 13, 17}
        assert any("q_finger1_distal is empty or NaN" in line for line in read.complaints())
        assert any("contact flag" in text for text in read.texts)
        assert len(read) == len(bad["q"])


def test_a_cell_that_is_no_number_spoils_its_row_alone(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    file = tmp_path / "states.csv"
    write_table(file, models["runtime"].hand, x)
    wanted = models["runtime"].predict(file)
    lines = file.read_text().splitlines()
    cells = lines[6].split(",")
    at = lines[1].split(",").index("contact_finger1_nx")
    for word in ("", "abc", "nan"):
        lines[6] = ",".join([*cells[:at], word, *cells[at + 1 :]])
        file.write_text("\n".join(lines))
        found = models["runtime"].predict(file)
        assert np.flatnonzero(found.status).tolist() == [4]
        assert any(line.startswith("line 7: contact_finger1_nx") for line in found.complaints()), found.complaints()
        found.write(tmp_path / "out.csv")
        assert (tmp_path / "out.csv").read_text().splitlines()[6].split(",")[:at] == cells[:at]
        rest = np.delete(np.arange(len(found)), 4)
        np.testing.assert_array_equal(found.dx_ht[rest], wanted.dx_ht[rest])


def test_missing_sensors_are_stood_in_for_and_said(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    plain = x | {"contacts": x["contacts"].copy()}
    plain["contacts"][..., 7] = np.nan
    write_table(tmp_path / "states.csv", models["torch"].hand, plain)
    found = models["runtime"].predict(tmp_path / "states.csv")
    assert not found.status.any() and "no contact forces" in " ".join(found.given.fallbacks)


def test_theta_by_calibration_or_with_the_rows(models: dict[str, Predictor], x: Arrays, tmp_path: Path) -> None:
    model = models["torch"]
    names = Theta(model.hand).names
    theta = np.zeros(len(names))
    theta[0], theta[Theta(model.hand).zeros] = 0.4, 0.02
    plain, found = model.predict(x), model.predict(x, calibration=theta)
    assert np.abs(found.dx_ht - plain.dx_ht).max() > 1e-6
    np.testing.assert_array_equal(model.predict(**x, theta=theta).dx_ht, found.dx_ht)
    near(model.predict(x, calibration=np.zeros(len(names))), plain)
    content = {"format_version": 1, "hand": model.hand.name, "hand_sha256": model.hand.sha256}
    (tmp_path / "c.json").write_text(json.dumps(content | {"theta": dict(zip(names, theta.tolist(), strict=True))}))
    np.testing.assert_array_equal(model.predict(x, calibration=tmp_path / "c.json").dx_ht, found.dx_ht)
    with pytest.raises(AminnError, match="tells theta already"):
        model.predict(**x, theta=theta, calibration=theta)
    with pytest.raises(AminnError, match=rf"shape \(3,\), expected \({len(names)},\)"):
        model.predict(x, calibration=np.zeros(3))
    with pytest.raises(AminnError, match="calibration is no array of numbers"):
        model.predict(x, calibration=["stiff"] * len(names))
    for each in models.values():
        with pytest.raises(AminnError, match="threads is -1"):
            each.predict(x, threads=-1)
    near(models["runtime"].predict(x, calibration=theta), found)
    with pytest.raises(AminnError, match="takes no theta; choose runtime"):
        models["onnx"].predict(x, calibration=theta)
    read = theta * (np.arange(len(theta)) >= Theta(model.hand).factors)  # how the state is to be read, and no more
    near(models["onnx"].predict(x, calibration=read), model.predict(x, calibration=read))
    theta[0] = 5.0
    for each in (models["runtime"], models["torch"]):
        assert set(each.predict(x, calibration=theta).status) == {Status.CALIBRATION}


def test_a_calibration_makes_states_of_a_data_set_right_as_those_of_a_table(
    models: dict[str, Predictor], x: Arrays, data_dir: Path
) -> None:
    for model in (models["torch"], models["runtime"]):
        theta = np.zeros(len(model.theta_names))
        theta[Theta(model.hand).zeros], theta[-1] = 0.02, 0.001
        near(model.predict(data_dir, calibration=theta), model.predict(x, calibration=theta))


def test_a_told_model_takes_theta_in_every_engine(x: Arrays, data_dir: Path, tmp_path: Path) -> None:
    untrained_run(tmp_path / "run", data_dir, told=True)
    export(tmp_path / "run", tmp_path / "export", data_dir=data_dir)
    models = {e: aminn.load(place_of(e, tmp_path / "run", tmp_path / "export"), e) for e in ENGINES}
    space = Theta(models["torch"].hand)
    size = np.repeat([0.4, 0.02, 0.001], [space.factors, len(space) - space.factors - 1, 1])
    theta = np.random.default_rng(2).uniform(-1, 1, (len(x["q"]), len(space))) * size
    found = {engine: model.predict(**x, theta=theta) for engine, model in models.items()}
    for each in found.values():
        near(each, found["runtime"])
    assert np.abs(found["torch"].dx_ht - models["torch"].predict(x).dx_ht).max() > 1e-4
    near(models["onnx"].predict(x), models["torch"].predict(x))  # none is nominal
    nowhere = x | {"q": np.full_like(x["q"], np.nan)}
    for model in models.values():
        assert set(model.predict(nowhere).status) == {Status.NONFINITE}
        assert len(model.predict({name: values[:0] for name, values in x.items()})) == 0


def test_the_mlp_has_the_same_columns(mlp_dir: Path, models: dict[str, Predictor], x: Arrays) -> None:
    found = aminn.load(mlp_dir).predict(x)
    assert list(found.columns) == list(models["runtime"].predict(x).columns)
    assert np.isfinite(found.dx_ht).all() and np.isnan(found.k_x).all()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "give a table, or the arrays q, x_ht, w_e, contacts"),
        ({"q": np.zeros((2, 8))}, "x_ht is missing"),
        (dict(q=np.zeros(3), x_ht=np.zeros(6), w_e=np.zeros(6), contacts=np.zeros((3, 8))), r"q has shape \(3,\)"),
        ({"q": np.zeros((2, 8)), "force": 1}, "force is no input"),
        (17, "int is no table"),
    ],
)
def test_what_is_no_table_is_said(models: dict[str, Predictor], table: object, message: str) -> None:
    with pytest.raises(AminnError, match=message):
        models["runtime"].predict(table)  # type: ignore[arg-type]


def test_statuses_in_numpy_are_those_of_the_runtime(states: Arrays) -> None:
    """Over what may be wrong, alone and together."""
    model = Model.load(Path(__file__).resolve().parents[1] / "golden")
    rng, n = np.random.default_rng(3), 4000
    bad = {name: np.resize(values, (n, *values.shape[1:])).astype(np.float64) for name, values in states.items()}
    some = [rng.uniform(size=n) < 0.15 for _ in range(6)]
    bad["q"][some[0], 3] = np.nan
    bad["w_e"][some[1], 0] = 1e39
    bad["contacts"][some[2], 1, 0] = rng.choice([-0.5, -0.0, 0.3, 1.0001, 2], some[2].sum())
    bad["contacts"][some[3], :, 0] = 0
    bad["contacts"][some[4], 2, 4:7] *= rng.choice([0.9985, 0.9995, 1.0005, 1.002], (some[4].sum(), 1))
    bad["x_ht"][some[5], 3:] = rng.choice([1.8, 1.81, 1.82], (some[5].sum(), 1))
    theta = np.zeros((n, len(model.theta_names)))
    theta[rng.uniform(size=n) < 0.1, 0], theta[rng.uniform(size=n) < 0.05, -2] = 3.1, -1.1
    theta[rng.uniform(size=n) < 0.05, 3], theta[rng.uniform(size=n) < 0.05, -1] = np.nan, 0.051
    found, wanted = statuses(bad | {"theta": theta}), model.predict(**bad, theta=theta).status
    assert {int(s) for s in wanted} == {int(s) for s in Status} - {Status.NUMERIC, Status.SENSORS, Status.LIMITS}
    np.testing.assert_array_equal(found, wanted)
    assert [model.status_name(s) for s in Status if s] == [f"AMINN_E_{s.name}" for s in Status if s]


# --- the command ----------------------------------------------------------------------------------------------------
def call(*args: object, stdin: str | bytes | None = None) -> Result:
    return CliRunner().invoke(main, ["predict", *(str(a) for a in args)], input=stdin)


def test_the_command_writes_the_same_from_every_engine(
    run_dir: Path, export_dir: Path, data_dir: Path, models: dict[str, Predictor], tmp_path: Path
) -> None:
    heads = set()
    for engine in ENGINES:
        place = ("--run", run_dir) if engine == "torch" else ("--export", export_dir, "--engine", engine)
        result = call(*place, data_dir, "--out", tmp_path / f"{engine}.csv")
        assert result.exit_code == 0, result.output
        assert "320 rows" in result.output and "0 without a prediction" in result.output
        heads.add((tmp_path / f"{engine}.csv").read_text().splitlines()[1])
    assert len(heads) == 1
    wanted = models["runtime"].predict(data_dir)
    found = read_rough(tmp_path / "runtime.csv", models["runtime"].hand).arrays
    np.testing.assert_array_equal(found["pred_dx_ht"].astype(np.float32), wanted.dx_ht)


def test_one_state_as_json_and_tables_from_standard_input(
    export_dir: Path, models: dict[str, Predictor], x: Arrays, tmp_path: Path
) -> None:
    state = json.dumps({name: values[2].tolist() for name, values in x.items()})
    wanted = models["runtime"].predict(**{name: values[2] for name, values in x.items()})
    for result in (call("--export", export_dir, state), call("--export", export_dir, "-", stdin=state)):
        assert result.exit_code == 0, result.output
        said = json.loads(result.stdout)
        assert list(said) == list(RESULTS)
        assert np.float32(said["p_stable"]) == wanted.p_stable[0] and said["holds"] is bool(wanted.holds[0])
    write_table(tmp_path / "states.csv", models["runtime"].hand, x)
    result = call("--export", export_dir, "-", stdin=(tmp_path / "states.csv").read_bytes())
    assert len(result.stdout.splitlines()) == len(x["q"])


def test_bad_rows_are_told_and_counted(
    export_dir: Path, models: dict[str, Predictor], x: Arrays, tmp_path: Path
) -> None:
    bad = x | {"contacts": x["contacts"].copy(), "q": x["q"].copy()}
    bad["contacts"][[3, 8], :, 0] = 0
    bad["q"][6, 0] = np.nan
    write_table(tmp_path / "states.csv", models["runtime"].hand, bad)
    result = call("--export", export_dir, tmp_path / "states.csv", "--out", tmp_path / "out.jsonl")
    assert result.exit_code == 0, result.output
    assert "line 9: q_finger1_roll is empty or NaN" in result.stderr
    assert "line 6: no prediction: no branch is in contact" in result.stderr and "(and 1 more lines)" in result.stderr
    rows = [json.loads(line) for line in (tmp_path / "out.jsonl").read_text().splitlines()]
    noted = sum(row["status"] == 0 and row["notes"] != "" for row in rows)
    assert f"3 without a prediction, {noted} with notes" in result.stdout and noted > 0
    assert rows[6]["p_stable"] is None and rows[6]["status"] == -4 and rows[6]["q"][0] is None
    assert len(rows) == len(x["q"])


def test_no_prediction_at_all_is_a_failure(
    export_dir: Path, models: dict[str, Predictor], x: Arrays, tmp_path: Path
) -> None:
    """What was predicted of no row is written all the same."""
    bad = {name: values[:3].copy() for name, values in x.items()}
    bad["contacts"][:, :, 0] = 0
    write_table(tmp_path / "states.csv", models["runtime"].hand, bad)
    for out in ([], ["--out", tmp_path / "out.jsonl"]):
        result = call("--export", export_dir, tmp_path / "states.csv", *out)
        assert result.exit_code == 1 and "Traceback" not in result.output
        assert "states.csv: none of 3 rows can be predicted from: no branch is in contact" in result.stderr
    lines = (tmp_path / "out.jsonl").read_text().splitlines()
    assert [json.loads(line)["status"] for line in lines] == [Status.NO_CONTACT] * 3
    state = json.dumps({name: values[0].tolist() for name, values in bad.items()})
    result = call("--export", export_dir, state)
    assert result.exit_code == 1 and "the table: none of 1 rows" in result.stderr


def test_what_the_command_refuses(run_dir: Path, export_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "old.csv").write_text("old")
    for args, message in (
        ((data_dir,), "give --run or --export"),
        (("--run", run_dir, "--export", export_dir, data_dir), "give --run or --export"),
        (("--run", run_dir, tmp_path / "none.csv"), "none.csv: cannot be read"),
        (("--run", run_dir, data_dir, "--out", tmp_path / "out.txt"), "tables are .csv, .parquet"),
        (("--run", run_dir, "--engine", "runtime", data_dir), "is a run, which PyTorch evaluates"),
        (("--run", run_dir, '{"q": [1]'), "TABLE: line 1: not valid JSON"),
        (("--run", run_dir, '{"q": [1]}'), "is missing"),
        (("--run", run_dir, tmp_path / "old.csv", "--out", tmp_path / "old.csv"), "which this command needs itself"),
    ):
        result = call(*args)
        assert result.exit_code in (1, 2) and message in " ".join(result.output.split()), result.output
        assert "Traceback" not in result.output
    assert (tmp_path / "old.csv").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["old.csv"]
