"""Data and models that belong together, and what is said and done where they do not."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synthetic import write_dataset

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.origin import states_of, training_part, training_set
from aminn.data.regimes import SELECTION, known
from aminn.evaluation.evaluate import evaluate, flat_report, format_table
from aminn.model.checkpoint import Checkpoint
from aminn.model.config import TrainConfig
from aminn.pages.explain import as_text, explain_sample
from aminn.training.train import train
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_export.export import export
from aminn_export.files.bin_model import read_bin_model
from aminn_export.files.ranges import state_ranges
from aminn_export.judge.verify import load_samples


@pytest.fixture(scope="module")
def other_seed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("other") / "data"
    write_dataset(folder, grasps=120, cases=12, seed=1)
    return folder


@pytest.fixture
def other_hand(data_dir: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "other-hand"
    shutil.copytree(data_dir, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["hand"]["branches"][0]["coordinates"][2]["anchor_m"][2] = 0.06
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def test_export_takes_the_data_of_the_training_alone(
    runs: dict[str, Checkpoint], data_dir: Path, other_seed: Path, other_hand: Path, tmp_path: Path
) -> None:
    run = runs["aminn"].path
    export(run, tmp_path / "right", data_dir=data_dir)
    for data, message in (
        (other_seed, r"not trained on these data: .*another configuration or seed .*seed 1.*give the data set"),
        (other_hand, r"another hand .*differ in anchors of joints\)"),
    ):
        with pytest.raises(AminnError, match=message):
            export(run, tmp_path / "wrong", data_dir=data)
    assert not (tmp_path / "wrong").exists()


def test_verify_refuses_data_of_another_hand(
    runs: dict[str, Checkpoint], data_dir: Path, other_hand: Path, tmp_path: Path
) -> None:
    export(runs["aminn"].path, tmp_path / "out")
    model = read_bin_model(tmp_path / "out" / "aminn_model.bin")
    assert load_samples(data_dir, model=model)
    with pytest.raises(AminnError, match="of another hand than the model"):
        load_samples(other_hand, model=model)


def test_export_names_grasps_that_came_later(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    shards = [*dataset.manifest["shards"], dataset.manifest["shards"][0]]
    grown = replace(dataset, manifest=dataset.manifest | {"shards": shards})
    train_part = dataset.split("train")
    found = f"{len(train_part)} load cases of {len(np.unique(train_part.samples['grasp_id']))} grasps"
    with pytest.raises(AminnError, match=rf"same configuration, but its training split has {found}"):
        training_set(runs["aminn"], grown)


def test_ranges_are_those_of_what_was_learned_from(dataset: Dataset, data_dir: Path, tmp_path: Path) -> None:
    """Of a share of the grasps, and of the part that the studies train on."""
    few = train(TrainConfig(epochs=1, train_fraction=0.3), dataset, tmp_path / "few")
    part = train(TrainConfig(epochs=1), known(dataset), tmp_path / "part")
    assert training_set(part, dataset).selection == SELECTION
    assert len(training_part(few, dataset)) < 0.6 * len(dataset.split("train"))
    for checkpoint, of in ((few, dataset.split("train", 0.3)), (part, known(dataset).split("train"))):
        export(checkpoint.path, tmp_path / "out", data_dir=data_dir)
        found, wanted = read_bin_model(tmp_path / "out" / "aminn_model.bin").tensors, state_ranges(of.samples)
        for name in ("range_min", "range_max"):
            np.testing.assert_array_equal(found[name], wanted[name])
            assert (found[name] != state_ranges(dataset.split("train").samples)[name]).any()


def test_evaluation_on_another_seed_says_so(runs: dict[str, Checkpoint], other_seed: Path, dataset: Dataset) -> None:
    result = evaluate([runs["aminn"]], load_dataset(other_seed))
    for text in (format_table(result), str(flat_report(result)["notes"])):
        assert "trained on data of another configuration or seed" in text and "--trained-on" in text
    assert "another" not in format_table(evaluate([runs["aminn"]], dataset))
    other = explain_sample(runs["aminn"], load_dataset(other_seed), 3)
    assert "another configuration or seed" in as_text(other)
    assert "another configuration" not in as_text(explain_sample(runs["aminn"], dataset, 3))


def test_training_grasps_among_other_data_are_left_out(
    runs: dict[str, Checkpoint], dataset: Dataset, data_dir: Path, other_seed: Path, tmp_path: Path
) -> None:
    """The other set's test split begins with a grasp that was trained on, under the number of a test grasp."""
    other = load_dataset(other_seed)
    samples = {name: values.copy() for name, values in other.samples.items()}
    stolen = int(dataset.split("train").samples["grasp_id"][0])
    of, to = (
        dataset.samples["grasp_id"] == stolen,
        other.samples["grasp_id"] == other.split("test").samples["grasp_id"][0],
    )
    for name in ("q", "x_ht"):
        samples[name][to] = dataset.samples[name][of]
    mixed = replace(other, samples=samples)
    result = evaluate([runs["aminn"]], mixed, trained_on=dataset)
    assert not np.isin(states_of(result.data), states_of(dataset.split("train"))).any()
    assert len(result.data) == len(mixed.split("test")) - to.sum()
    assert f"{to.sum()} load cases of training grasps are left out" in format_table(result)
    with pytest.raises(AminnError, match="not trained on these data"):
        evaluate([runs["aminn"]], dataset, trained_on=other)
    words = ["evaluate", "--data", other_seed, "--run", runs["aminn"].path, "--trained-on", data_dir]
    assert "0 load cases of training grasps are left out" in CliRunner().invoke(main, list(map(str, words))).output


def test_another_hand_is_refused_everywhere(runs: dict[str, Checkpoint], other_hand: Path, tmp_path: Path) -> None:
    for command in ("evaluate", "report", "explain", "export"):
        rest = {"explain": ["--sample", "1"], "export": ["--out", tmp_path / "out"]}.get(command, [])
        words = [command, "--data", other_hand, "--run", runs["aminn"].path, *rest]
        result = CliRunner().invoke(main, list(map(str, words)))
        assert result.exit_code == 1 and "another hand" in result.output, result.output
