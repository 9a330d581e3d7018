"""Making again what an earlier version left, and the studies' tables."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.regimes import FRICTION_MAX, NEW_FAMILY, regimes, told
from aminn.model.config import TrainConfig
from aminn.training.train import train
from aminn_app import study
from aminn_app.paper_table import filled, write_tables
from aminn_app.pipeline import anew_if_outdated
from aminn_app.records import Row, Study, over_seeds
from aminn_base.errors import AminnError, InUseError, WriteError


def test_outdated_folder_is_made_again(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = tmp_path / "run"
    train(TrainConfig(epochs=1, seed=1), dataset, folder)
    made = anew_if_outdated(folder, lambda: train(TrainConfig(epochs=1, seed=2), dataset, folder))
    assert made.meta["seed"] == 2
    assert "made again" in capsys.readouterr().out


def test_an_error_that_is_not_the_folder_s_fault_is_raised(tmp_path: Path) -> None:
    def fail() -> None:
        (tmp_path / "run").mkdir(exist_ok=True)
        raise AminnError("no data")

    with pytest.raises(AminnError, match="no data"):
        anew_if_outdated(tmp_path / "run", fail)
    with pytest.raises(AminnError, match="no data"):
        anew_if_outdated(tmp_path / "run", fail)


@pytest.mark.parametrize("error", [WriteError(Path("x"), "No space left on device"), InUseError("x: in use")])
def test_a_full_disk_or_another_program_costs_no_folder(tmp_path: Path, error: AminnError) -> None:
    (tmp_path / "kept").touch()

    def fail() -> None:
        raise error

    with pytest.raises(type(error)):
        anew_if_outdated(tmp_path, fail)
    assert (tmp_path / "kept").exists()


def test_variants_of_a_study_differ_and_share_the_rest() -> None:
    assert len(set(study.ABLATIONS.values())) == len(study.ABLATIONS)
    jobs = list(study.paper_jobs(2))
    assert len({job.name for job in jobs}) == len(jobs) == 2 * 2 * len(study.FRACTIONS)
    assert jobs[0].config == replace(study.BASE, seed=0)
    assert jobs[1].config == replace(jobs[0].config, kind="mlp", weight_decay=study.BASELINE.weight_decay)


def test_regimes_differ_from_the_training_data_in_one_respect(dataset: Dataset) -> None:
    masks = regimes(dataset)
    assert sum(m.astype(int) for m in masks.values()).max() == 1
    family = np.asarray(dataset.manifest["tool_families"])[dataset.grasps["tool_family"][dataset.grasp_rows()]]
    assert set(family[masks["new_family"]]) == {NEW_FAMILY} and NEW_FAMILY not in family[masks["iid"]]
    friction = dataset.grasps["friction"][dataset.grasp_rows()]
    assert friction[masks["new_friction"]].min() > FRICTION_MAX >= friction[masks["iid"]].max()


def test_study_gathers_mean_and_spread_over_runs() -> None:
    runs = [(0, {"": {"f1": 1.0, "gone": None}}), (1, {"": {"f1": 3.0, "gone": 2.0}})]
    (row,) = over_seeds("iid", "aminn", 100.0, runs)
    assert row.mean == {"f1": 2.0, "gone": 2.0} and row.seeds == 2
    assert row.sd == {"f1": pytest.approx(np.std([1, 3], ddof=1)), "gone": 0.0}


def test_a_study_writes_its_table_and_goes_on(data_dir: Path, tmp_path: Path, monkeypatch) -> None:
    """Two runs of each model on a share of the data: the report has every test set, and nothing is trained twice."""
    jobs = [study.Job(k, TrainConfig(kind=k, epochs=1, train_fraction=f)) for f in (1.0, 0.3) for k in ("aminn", "mlp")]
    data = load_dataset(data_dir)
    done = {job: study._run("paper", job, tmp_path, data_dir, 0) for job in jobs}
    found = study.summarise("paper", done, study._facts(data), study._still(data))
    np.testing.assert_equal(Study.from_json(json.loads(json.dumps(found.as_json()))).flat(), found.flat())
    report = found.flat()
    for name in study.REGIMES:
        assert 0 <= report[f"{name}_aminn_f1_mean"] <= 1 and report[f"{name}_label_n_samples"] > 0
    assert report["iid_aminn_passivity_violation_full_mean"] == 0
    assert "learning_30pc_mlp_rmse_pose_mean" in report and "learning_100pc_aminn_f1_mean" in report
    monkeypatch.setattr(study, "train", None)
    assert {job: study._run("paper", job, tmp_path, data_dir, 0) for job in jobs} == done
    text = write_tables("paper", found, tmp_path)
    for row in ("new tool family", "larger loads", "full-work violations exactly 0", "| 30 % | AMINN |", "force x"):
        assert row in text


def test_what_is_told_stands_among_the_inputs_and_changes_the_identity(dataset: Dataset) -> None:
    with_friction = told(dataset, "friction")
    np.testing.assert_array_equal(with_friction.samples["x_ht"][:, 3], dataset.grasps["friction"][dataset.grasp_rows()])
    np.testing.assert_array_equal(with_friction.samples["x_ht"][:, :3], dataset.samples["x_ht"][:, :3])
    assert with_friction.sha256 != dataset.sha256 and told(dataset, "") is dataset
    assert told(dataset, "pretension").samples["x_ht"][0, 3] == dataset.grasps["tendon_tension_N"][0, 0] / 20


def test_marked_tables_are_written_anew() -> None:
    text = "a\n<!-- table: ablation -->\nold\n<!-- end of table -->\nb\n<!-- table: other -->\nc\n<!-- end of table -->"
    new = filled(text, "ablation", Study({}, [Row("iid", "shipped", {"f1": 0.5}, {"f1": 0.0}, 1)]))
    assert "old" not in new and "| **shipped** | 0.500 |" in new and "\nc\n" in new
    assert filled(new, "ablation", Study({}, [])) != new and filled(text, "paper", Study({}, [])) == text


def test_ablation_is_judged_on_validation_grasps_alone(dataset: Dataset) -> None:
    (name, part), *others = study._tests(dataset, "ablation", 1.0).items()
    assert name == "iid" and not others
    assert set(part.samples["grasp_id"]) <= set(dataset.split("validation").samples["grasp_id"])


def test_a_data_set_without_the_held_out_family_is_refused(dataset: Dataset) -> None:
    other = replace(dataset, manifest=dataset.manifest | {"tool_families": ["capsule", "cylinder", "cup", "box"]})
    with pytest.raises(AminnError, match="no ellipsoid among its tools"):
        regimes(other)
