"""`aminn import`: simulated pushes come back as they went, and every command takes what was imported."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result
from lab import as_measured, write_tables
from record import Message, messages, record, wrench
from test_bags import map_text

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.measured import CORRECTED, FALLBACKS, SHARD, mean_forces
from aminn.data.regimes import regimes
from aminn.evaluation.analysis import breakdown, gate_figures
from aminn.evaluation.evaluate import learned
from aminn.evaluation.predict import true_states
from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_hand.hand import STATE, rotation
from aminn_hand.theta import Theta
from aminn_sim.open_hand import default_hand_file
from aminn_table import read_map, read_table, write_table
from aminn_table.columns import LABELLED, Arrays
from aminn_table.fallbacks import NO_FORCES, NO_NORMALS, NO_POINTS, NO_SHAPE, PINCH_N, TRAINED_FORCES
from aminn_table.mapping import Pose


def aminn(*words: object, code: int = 0) -> Result:
    """Run the program; its exit code must be `code`."""
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert done.exit_code == code, f"{done.output}{done.stderr}"
    return done


@pytest.fixture(scope="session")
def tables(truth: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_tables(tmp_path_factory.mktemp("tables"), truth)


@pytest.fixture(scope="session")
def own(tables: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The imported data set."""
    folder = tmp_path_factory.mktemp("own") / "data"
    aminn("import", tables[".csv"], "--hand", default_hand_file(), "--out", folder)
    return folder


@pytest.fixture(scope="session")
def own_run(own: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model trained on the imported data set."""
    folder = tmp_path_factory.mktemp("own_run") / "run"
    aminn("train", "--data", own, "--epochs", 3, "--no-tensorboard", "--out", folder)
    return folder


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize("words", [["evaluate", "--run"], ["explain", "--sample", 0, "--run"], ["train", "--finetune"]])
def test_a_table_where_a_data_set_is_due(
    words: list[object], tables: dict[str, Path], own_run: Path, tmp_path: Path
) -> None:
    out = ["--out", tmp_path / "out"]
    done = aminn(*words, own_run, "--data", tables[".csv"], *(out if words[0] == "train" else []), code=2)
    assert f"`aminn import {tables['.csv']} --like RUN --out FOLDER`" in done.stderr and "Traceback" not in done.stderr


def test_imported_pushes_are_the_simulated_ones(truth: Dataset, own: Path) -> None:
    data = load_dataset(own)
    assert data.measured and not truth.measured and data.hand == truth.hand
    for name, values in as_measured(truth).items():
        np.testing.assert_array_equal(data.samples[name], values, err_msg=name)
    for name in ("j_x", "j_q"):
        np.testing.assert_allclose(data.samples[name], truth.samples[name], atol=1e-9, err_msg=name)


def test_every_format_gives_the_same_bytes(tables: dict[str, Path], own: Path, tmp_path: Path) -> None:
    for end, table in tables.items():
        aminn("import", table, "--like", own, "--out", tmp_path / end)
        assert bytes_of(tmp_path / end) == bytes_of(own)


def test_a_bag_and_tables_of_its_pushes_give_the_same_bytes(truth: Dataset, simulated: Path, tmp_path: Path) -> None:
    """A bag has quaternions and poses under load, so that its numbers are the simulated ones but for rounding."""
    (tmp_path / "map.toml").write_text(map_text(truth.hand))
    outs = []
    for storage in ("MCAP", "SQLITE3"):
        bag, out = (
            record(tmp_path / storage, storage, messages(truth.hand, as_measured(truth))),
            tmp_path / f"{storage}_data",
        )
        table = tmp_path / f"{storage}.csv"
        options = ["--like", simulated, "--map", tmp_path / "map.toml", "--table", table]
        aminn("import", bag, *options, "--out", out)
        aminn("import", table, "--like", simulated, "--out", tmp_path / f"{storage}_csv")
        outs += [out, tmp_path / f"{storage}_csv"]
    write_table(tmp_path / "t.parquet", truth.hand, read_table(table, truth.hand, LABELLED))
    aminn("import", tmp_path / "t.parquet", "--like", simulated, "--out", tmp_path / "parquet")
    assert all(bytes_of(out) == bytes_of(tmp_path / "parquet") for out in outs)
    data = load_dataset(outs[0])
    for name, values in as_measured(truth).items():
        held = data.samples["stable"] > 0 if name == "dx_ht" else slice(None)
        np.testing.assert_allclose(data.samples[name][held], values[held], atol=1e-12, rtol=1e-15, err_msg=name)


def test_importing_again_changes_nothing_and_other_data_are_refused(
    tables: dict[str, Path], truth: Dataset, simulated: Path, tmp_path: Path
) -> None:
    out = tmp_path / "data"
    aminn("import", tables[".csv"], "--like", simulated, "--out", out)
    before = bytes_of(out)
    aminn("import", tables[".h5"], "--like", simulated, "--out", out)
    other = {name: values[:60] for name, values in as_measured(truth).items()}
    write_table(tmp_path / "other.csv", truth.hand, other)
    done = aminn("import", tmp_path / "other.csv", "--like", simulated, "--out", out, code=1)
    assert "holds another data set" in done.stderr
    done = aminn("import", tables[".csv"], "--like", simulated, "--out", tmp_path / "new", "--table", "t.xls", code=1)
    assert "t.xls: tables are .csv" in done.stderr and not (tmp_path / "new").exists()
    done = aminn("import", tables[".csv"], "--like", simulated, "--out", simulated, code=1)
    assert "holds another data set" in done.stderr
    assert bytes_of(out) == before


def test_an_import_that_was_cut_off_goes_on(
    own: Path, tables: dict[str, Path], tmp_path: Path, simulated: Path
) -> None:
    """Its shard is there, and no manifest yet; another data set's half is not taken for it."""
    half = tmp_path / "own"
    half.mkdir()
    (half / SHARD).write_bytes((own / SHARD).read_bytes()[:-1])
    words = ["import", str(tables[".csv"]), "--like", str(simulated), "--out", str(half)]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 1 and "holds another data set" in result.output
    (half / SHARD).write_bytes((own / SHARD).read_bytes())
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    assert (half / "manifest.json").read_bytes() == (own / "manifest.json").read_bytes()


def test_whose_hand_it_is_must_be_said_once(tables: dict[str, Path], simulated: Path, tmp_path: Path) -> None:
    for options in ([], ["--hand", default_hand_file(), "--like", simulated]):
        done = aminn("import", tables[".csv"], *options, "--out", tmp_path / "data", code=1)
        assert "whose hand" in done.stderr


def test_all_faults_are_shown_and_nothing_is_written(truth: Dataset, simulated: Path, tmp_path: Path) -> None:
    bad = as_measured(truth)
    bad["q"] = np.rad2deg(bad["q"])
    write_table(tmp_path / "bad.csv", truth.hand, bad)
    done = aminn("import", tmp_path / "bad.csv", "--like", simulated, "--out", tmp_path / "data", code=1)
    assert done.stderr.startswith("Error: ") and done.stderr.count("\n") == 1 and "degrees" in done.stderr
    assert all(line.startswith(str(tmp_path / "bad.csv: line ")) for line in done.stdout.splitlines())
    assert len(done.stdout.splitlines()) >= 4
    assert not (tmp_path / "data").exists()


def test_files_are_put_together_where_their_grasps_differ(
    truth: Dataset, simulated: Path, own: Path, tmp_path: Path
) -> None:
    arrays = as_measured(truth)
    first = arrays["grasp_id"] < 17
    parts = [{name: values[mask] for name, values in arrays.items()} for mask in (first, ~first)]
    files = [tmp_path / "monday.parquet", tmp_path / "tuesday.csv"]
    for file, part in zip(files, parts, strict=True):
        write_table(file, truth.hand, part)
    aminn("import", *files, "--like", simulated, "--out", tmp_path / "data")
    assert bytes_of(tmp_path / "data") == bytes_of(own)
    done = aminn("import", files[0], files[0], "--like", simulated, "--out", tmp_path / "twice", code=1)
    assert "grasp_id 0 is in" in done.stderr
    write_table(files[1], truth.hand, {name: values for name, values in parts[1].items() if name != "stable"})
    done = aminn("import", *files, "--like", simulated, "--out", tmp_path / "odd", code=1)
    assert "tells stable" in done.stderr


def imported(
    truth: Dataset, like: Path, folder: Path, change: Arrays, drop: tuple[str, ...] = ()
) -> tuple[Dataset, str]:
    """The data set of changed measurements, and what the import said."""
    arrays = {k: v for k, v in (as_measured(truth) | change).items() if k not in drop}
    write_table(folder / "t.parquet", truth.hand, arrays)
    said = aminn("import", folder / "t.parquet", "--like", like, "--out", folder / "data").stdout
    return load_dataset(folder / "data"), said


def test_pushes_without_a_label_count_as_held(truth: Dataset, simulated: Path, tmp_path: Path) -> None:
    held = truth.take(truth.samples["stable"] > 0)
    data, _ = imported(held, simulated, tmp_path, {}, drop=("stable",))
    assert data.samples["stable"].all()


def test_pushes_that_all_held_teach_the_second_stage_alone(
    truth: Dataset, own_run: Path, simulated: Path, tmp_path: Path
) -> None:
    held = truth.take(truth.samples["stable"] > 0)
    imported(held, simulated, tmp_path, {}, drop=("stable",))
    options = ["--data", tmp_path / "data", "--epochs", 3, "--no-tensorboard", "--out", tmp_path / "run"]
    assert "give --finetune a run that knows them" in aminn("train", *options, code=1).stderr
    before = load_checkpoint(own_run)
    with torch.no_grad():
        before.model.stage2.backbone.head.bias += 0.5  # worse than it is, so that the training betters it
    save_checkpoint(tmp_path / "start", before.model, before.meta)
    aminn("train", *options, "--finetune", tmp_path / "start")
    after = load_checkpoint(tmp_path / "run")
    changed = {
        name.split(".")[0]
        for name, weights in after.model.state_dict().items()
        if not weights.equal(before.model.state_dict()[name])
    }
    assert changed == {"stage2", "sure"}  # how sure it is follows what the second stage says
    assert (after.meta["tau"], list(after.meta["history"])) == (before.meta["tau"], ["stage2"])
    said = aminn("evaluate", "--data", simulated, "--run", tmp_path / "run").stdout
    assert "went on from another run, whose training grasps may be among these" in said
    aminn("report", "--data", tmp_path / "data", "--run", tmp_path / "run", "--out", tmp_path / "r.html")


def test_theta_is_kept_for_each_grasp(truth: Dataset, simulated: Path, tmp_path: Path) -> None:
    space, grasp = Theta(truth.hand), truth.samples["grasp_id"]
    theta = np.where(grasp[:, None] % 3 == 1, 0.1, 0.0) * (np.arange(len(space)) < space.factors)
    data, said = imported(truth, simulated, tmp_path, {"theta": theta})
    assert data.manifest["theta_names"] == list(space.names) and CORRECTED not in said
    np.testing.assert_array_equal(data.grasps["theta"][data.grasp_rows()], theta)
    np.testing.assert_array_equal(data.grasps["hand_id"][data.grasp_rows()], grasp % 3 == 1)
    theta[1, 0] = 0.5
    write_table(tmp_path / "mixed.csv", truth.hand, as_measured(truth) | {"theta": theta})
    done = aminn("import", tmp_path / "mixed.csv", "--like", simulated, "--out", tmp_path / "mixed", code=1)
    assert "theta changes within grasp" in done.stderr


def test_states_are_made_right_by_zeros_and_radius_that_theta_tells(
    truth: Dataset, simulated: Path, tmp_path: Path
) -> None:
    space, measured = Theta(truth.hand), as_measured(truth)
    theta = np.tile(np.where(np.arange(len(space)) < space.factors, 0.1, 0.001), (len(truth), 1))
    data, said = imported(truth, simulated, tmp_path, {"theta": theta})
    assert CORRECTED in said and data.manifest[FALLBACKS] == [CORRECTED]
    right = true_states(truth.hand, *(measured[name] for name in STATE), theta)
    for name in ("q", "contacts", "j_x", "j_q"):
        np.testing.assert_allclose(data.samples[name], right[name], atol=1e-12)
    np.testing.assert_array_equal(data.samples["theta"][:, : space.factors], 0.1)
    np.testing.assert_array_equal(data.samples["theta"][:, space.factors :], 0.0)


SENSORS: dict[str, tuple[list[int], tuple[str, ...]]] = {
    "no_normals": ([4, 5, 6], (NO_NORMALS,)),
    "no_forces": ([7], (NO_FORCES.format(PINCH_N),)),
    "no_points": ([1, 2, 3], (NO_POINTS,)),
    "flags_alone": ([1, 2, 3, 4, 5, 6, 7], (NO_SHAPE, NO_POINTS, NO_FORCES.format(PINCH_N))),
}
"""Features of contacts that a lab lacks, and what is said of it."""


@pytest.mark.parametrize("name", SENSORS)
def test_missing_sensors_are_said_and_kept(name: str, truth: Dataset, tables: dict[str, Path], tmp_path: Path) -> None:
    features, notes = SENSORS[name]
    contacts = truth.samples["contacts"].copy()
    contacts[..., features] = np.nan
    write_table(tmp_path / "t.csv", truth.hand, as_measured(truth) | {"contacts": contacts})
    said = aminn("import", tmp_path / "t.csv", "--hand", default_hand_file(), "--out", tmp_path / "data").stdout
    data = load_dataset(tmp_path / "data")
    assert data.manifest["fallbacks"] == list(notes) and all(note in said for note in notes)
    distance = np.linalg.norm((data.samples["contacts"] - truth.samples["contacts"])[..., 1:4], axis=-1)
    assert np.median(distance) < 2e-3


def test_a_runs_mean_forces_stand_in(truth: Dataset, own_run: Path, tmp_path: Path) -> None:
    contacts = truth.samples["contacts"].copy()
    contacts[..., 7] = np.nan
    data, said = imported(truth, own_run, tmp_path, {"contacts": contacts})
    assert TRAINED_FORCES in said
    expected = truth.split("train").samples["contacts"][..., 7].mean(0)
    np.testing.assert_allclose(mean_forces(load_checkpoint(own_run).model), expected, rtol=1e-4)
    np.testing.assert_allclose(data.samples["contacts"][0, :, 7], expected, rtol=1e-4)


def test_training_needs_no_tensions(own_run: Path) -> None:
    """The loss of engagement is left out, and the card says where the data are from."""
    meta = json.loads((own_run / "model.json").read_text())
    assert meta["data"]["simulator"] == "measured"
    assert "| simulator | measured |" in (own_run / "card.md").read_text()


def test_evaluation_says_where_a_split_might_leak(own: Path, own_run: Path, simulated: Path, tmp_path: Path) -> None:
    said = aminn("evaluate", "--data", own, "--run", own_run).stdout
    assert re.search(r"ground truth +-", said) and "leave them out" not in said
    said = aminn("evaluate", "--data", own, "--run", own_run, "--split", "all").stdout
    assert "was trained on a part of these load cases" in said and "data set; give --trained-on" in said
    said = aminn("evaluate", "--data", own, "--run", own_run, "--split", "all", "--trained-on", own).stdout
    assert "load cases of training grasps are left out" in said
    said = aminn("evaluate", "--data", simulated, "--run", own_run).stdout
    assert "trained on measured data, so that no simulated load case is known" in said
    run = tmp_path / "run"
    aminn("train", "--data", simulated, "--epochs", 1, "--no-tensorboard", "--out", run)
    said = aminn("evaluate", "--data", own, "--run", run, "--split", "all").stdout
    assert "trained on simulated data, so that no measured push is known" in said and "leave them out" not in said


def test_other_measured_data_may_share_grasps(truth: Dataset, own: Path, own_run: Path, tmp_path: Path) -> None:
    """A larger table of the same lab: the grasps of the training are found by their states and left out."""
    more = as_measured(truth)
    more = {name: np.concatenate([v, v]) for name, v in more.items()}
    half = len(truth)
    more["grasp_id"][half:] += 1000
    more["time_s"][half:] += 1e6
    more["q"][half:] += 1e-3
    write_table(tmp_path / "more.csv", truth.hand, more)
    aminn("import", tmp_path / "more.csv", "--like", own, "--out", tmp_path / "more")
    said = aminn("evaluate", "--data", tmp_path / "more", "--run", own_run).stdout
    assert "trained on other measured data, of which grasps may be among these" in said and "--trained-on" in said
    said = aminn(
        "evaluate", "--data", tmp_path / "more", "--run", own_run, "--split", "all", "--trained-on", own
    ).stdout
    seen = len(truth.split("train")) + len(truth.split("validation"))
    assert f"{seen} load cases of training grasps are left out" in said


def test_report_and_explanation_do_without_the_tools_shape(own: Path, own_run: Path, tmp_path: Path) -> None:
    said = aminn("explain", "--data", own, "--run", own_run, "--sample", 7, "--out", tmp_path / "why.png").stdout
    assert "measured" in said and "simulated" not in said
    assert (tmp_path / "why.png").stat().st_size > 10_000
    aminn("report", "--data", own, "--run", own_run, "--reports", tmp_path, "--out", tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "a ball at the origin of its frame" in page and "measured" in page


def test_export_takes_measured_data(own: Path, own_run: Path, tmp_path: Path) -> None:
    aminn("export", "--run", own_run, "--data", own, "--out", tmp_path / "export")
    assert (tmp_path / "export" / "golden.bin").is_file()


def test_what_only_a_simulator_knows_is_refused_by_name(own: Path, own_run: Path) -> None:
    data = load_dataset(own)
    assert data.taut() is None
    done = aminn("card", "--data", own, code=1)
    assert "it was measured, and this is for simulated data" in done.stderr
    with pytest.raises(AminnError, match="tool_family is known of simulated data alone"):
        regimes(data)
    prediction = learned(load_checkpoint(own_run), data, "aminn")
    assert gate_figures(prediction, data) == {}
    assert "load0" in breakdown(prediction, data)


def test_the_pages_map_reads_a_bag(truth: Dataset, simulated: Path, tmp_path: Path) -> None:
    """A force sensor beside the hand that tells what the tool answers, and the weight of what hangs on it."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "own-data.md").read_text()
    block = page.split("Save as `build/own/map.toml`:\n\n")[1].split("\n\nThen ")[0]
    (tmp_path / "map.toml").write_text("\n".join(line[4:] for line in block.split("\n")))
    told = read_map(tmp_path / "map.toml").frames["ft_sensor"]
    sensor = Pose(rotation(np.array(told.rotation_rad)), np.array(told.position_m))
    arrays = as_measured(truth)

    def change(every: list[Message]) -> None:
        places = [i for i, m in enumerate(every) if m.topic == "/wrench"]
        for n, i in enumerate(places):
            w = every[i].value.wrench
            force, moment = (np.array([v.x, v.y, v.z]) for v in (w.force, w.torque))
            moment = moment + np.cross(arrays["x_ht"][n // 3, :3] - sensor.origin, force)
            answer = -np.concatenate([sensor.turn.T @ force, sensor.turn.T @ moment])
            every[i] = wrench(every[i].stamp, answer + np.array([0.3, 0, -2.0, 0, 0.01, 0]), "ft_sensor")

    bag = record(tmp_path / "bag", "MCAP", messages(truth.hand, arrays), change)
    aminn("import", bag, "--like", simulated, "--map", tmp_path / "map.toml", "--out", tmp_path / "data")
    data = load_dataset(tmp_path / "data")
    for name in ("q", "x_ht", "w_e", "contacts", "grasp_id", "stable"):
        np.testing.assert_allclose(data.samples[name], arrays[name], atol=1e-12, err_msg=name)
