"""Making again what an earlier version left, and the studies' tables."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.regimes import FRICTION_MAX, NEW_FAMILY, regimes
from aminn.evaluation.evaluate import analytical
from aminn.evaluation.metrics import pose_size
from aminn.model.config import ModelConfig, TrainConfig
from aminn.training.train import train
from aminn_app import study
from aminn_app.paper_table import TABLES, aims_report, filled, further_aims, main_aims, write_tables
from aminn_app.paper_table import main as tables
from aminn_app.pipeline import anew_if_outdated
from aminn_app.records import Row, Study, over_seeds
from aminn_base.errors import AminnError, InUseError, WriteError
from aminn_base.files import finite


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
    assert len(set(study.VARIANTS.values())) == len(study.VARIANTS)
    jobs = list(study.paper_jobs(3, 2))
    learning = 2 * len(study.LEARNING) * len(study.FRACTIONS)
    assert len({job.name for job in jobs}) == len(jobs) == 3 * len(study.VARIANTS) + learning
    first = {job.variant: job.config for job in jobs[: len(study.VARIANTS)]}
    assert first["aminn"] == replace(study.BASE, seed=0) and first["aminn"].model.friction == "secant"
    assert replace(first["mlp"], model=first["aminn"].model) == replace(first["aminn"], kind="mlp", weight_decay=0.0)
    assert first["mlp"].model.width > first["aminn"].model.width
    assert first["paper_layer"].model == replace(first["aminn"].model, friction="none")
    assert {model for pair in study.PAIRS for model in pair} == set(study.VARIANTS)


def test_a_study_makes_a_whole_table_of_one_seed_first() -> None:
    jobs = list(study.paper_jobs(2, 1))
    assert {job.variant for job in jobs[: len(study.VARIANTS)]} == set(study.VARIANTS)
    assert {job.config.seed for job in jobs[: len(study.VARIANTS)]} == {0}
    shares = [job.config.train_fraction for job in jobs]
    assert min(shares[: 2 * len(study.VARIANTS)]) == 1 and max(shares[2 * len(study.VARIANTS) :]) < 1


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
    """Two seeds of two models, and a share of the data: all tables are there, and nothing is trained twice."""
    short = TrainConfig(epochs=1, model=ModelConfig(sensors=None))
    jobs = [study.Job(k, replace(short, kind=k, seed=s)) for s in (0, 1) for k in ("aminn", "mlp")]
    jobs += [study.Job(k, replace(short, kind=k, train_fraction=0.3)) for k in ("aminn", "mlp")]
    data = load_dataset(data_dir)
    done = {job: study._run("paper", job, tmp_path, data_dir, 0) for job in jobs}
    found = study.summarise("paper", done, study._facts(data), study._still(data))
    assert Study.from_json(json.loads(json.dumps(finite(found.as_json())))).flat() == finite(found.flat())
    report = found.flat()
    for name in study.REGIMES:
        assert 0 <= report[f"{name}_aminn_f1_mean"] <= 1 and report[f"{name}_label_n_samples"] > 0
    assert report["iid_aminn_passivity_violation_full_mean"] == 0
    assert "learning_30pc_mlp_rmse_pose_mean" in report and "learning_100pc_aminn_f1_mean" in report
    assert "learning_30pc_aminn_to_mlp_rmse_pose_all_mean" not in report and report["iid_aminn_seeds"] == 2
    for figure in ("rmse_pose_all", "rmse_pose_slid", "relative_error_p90_all"):
        a, b = (
            [report[f"iid_aminn_to_mlp_{part}{figure}{end}"] for end in ("_low", "_high")] for part in ("", "seed1_")
        )
        assert a[0] < report[f"iid_aminn_to_mlp_{figure}_mean"] < a[1] and b[0] < b[1]
    ratio = [report[f"iid_aminn_to_mlp_seed{k}_rmse_pose_all"] for k in (0, 1)]
    assert report["iid_aminn_to_mlp_rmse_pose_all_mean"] == pytest.approx(np.mean(ratio))
    errors = [done[job].figures["iid"][""][""]["rmse_pose_all"] for job in jobs[:2]]
    assert ratio[0] == pytest.approx(errors[0] / errors[1], rel=1e-6)
    assert report["iid_aminn_friction_weight_auroc_mean"] != report["iid_aminn_auroc_mean"]
    for key in ("class_weight_noise1_f1_mean", "noise2_f1_mean", "friction_weight_gate_auroc_mean"):
        assert 0 <= report[f"iid_aminn_{key}"] <= 1
    assert report["new_family_aminn_to_mlp_friction_weight_rmse_pose_all_low"] > 0
    monkeypatch.setattr(study, "train", None)
    again = {job: study._run("paper", job, tmp_path, data_dir, 0) for job in jobs}
    assert all(again[job].figures == done[job].figures for job in jobs)
    assert study.summarise("paper", again, {}, []).flat() == study.summarise("paper", done, {}, []).flat()
    text = write_tables("paper", found, tmp_path)
    for row in ("new tool family", "larger loads", "full-work violations 0", "| 30 % | AMINN |", "force x", "exactly"):
        assert row in text


def test_figures_without_their_draws_are_taken_again(data_dir: Path, tmp_path: Path) -> None:
    """A run that was cut between its two files is judged again, not half read."""
    job = study.Job("mlp", TrainConfig(kind="mlp", epochs=1))
    first = study._run("paper", job, tmp_path, data_dir, 0)
    (tmp_path / "figures" / f"{job.name}.npz").unlink()
    assert study._run("paper", job, tmp_path, data_dir, 0).draws.keys() == first.draws.keys()


def test_a_model_without_sensors_is_told_nothing(data_dir: Path, tmp_path: Path) -> None:
    blind = TrainConfig(kind="mlp", epochs=1, model=ModelConfig(sensors=False))
    found = study._run("paper", study.Job("mlp", blind), tmp_path, data_dir, 0)
    assert {test: list(by) for test, by in found.figures.items()} == {test: [""] for test in study.REGIMES}


def study_of(**figures: float) -> Study:
    return Study({}, [Row("iid", "aminn", figures, {k: 0.0 for k in figures}, 1)])


def test_an_aim_is_met_in_the_digits_that_it_is_given_in() -> None:
    for value, met in ((0.957, True), (0.95651, True), (0.9564, False)):
        assert main_aims(study_of(f1=value), "iid", "")["F1"].met is met
    for value, met in ((0.023, True), (0.02349, True), (0.0236, False)):
        assert main_aims(study_of(relative_error_median_all=value), "iid", "")["median"].met is met
    for value, met in ((0.95, True), (0.9389, False), (0.9611, False)):
        (aim,) = [a for a in further_aims(study_of(bound_coverage=value)) if a.value is not None]
        assert aim.met is met
    for value, met in ((0.0, True), (1e-4, False)):
        (aim,) = [a for a in further_aims(study_of(passivity_violation_full=value)) if a.value is not None]
        assert aim.met is met


def test_what_was_not_measured_counts_as_missed() -> None:
    nothing, some = aims_report(Study({}, [])), aims_report(study_of(f1=0.99, passivity_violation_full=0.0))
    assert nothing["aims_missed"] == nothing["aims"] == some["aims"] == some["aims_missed"] + 2
    assert "F1, new grasps, class and weight told: -" in some["aims_missed_which"]
    assert some["bound_f1"] == 0.96 and some["bound_rmse_pose_all"] == 0.0091


def test_a_table_says_which_aim_is_missed_and_how_sure_a_ratio_is() -> None:
    rows = [
        Row("iid", "aminn", {"f1": 0.95}, {"f1": 0.0}, 1),
        Row("iid", "aminn_to_mlp", {"rmse_pose_all": 0.7}, interval={"rmse_pose_all": (0.65, 0.76)}),
    ]
    text = TABLES["paper"]["aims"](Study({}, rows))
    assert "| **new grasps** | nothing | 0.950 ≥ 0.957 **no** | 0.70 [0.65, 0.76] ≤ 0.72 |" in text


def test_marked_tables_are_written_anew() -> None:
    marked = "<!-- table: {} -->\n{}\n<!-- end of table -->"
    text = f"a\n{marked.format('ablation', 'past')}\nb\n{marked.format('other', 'c')}"
    new = filled(text, "ablation", Study({}, [Row("iid", "shipped", {"f1": 0.5}, {"f1": 0.0}, 1)]))
    assert "past" not in new and "| **shipped** | 0.500 |" in new and "\nc\n" in new
    assert filled(new, "ablation", Study({}, [])) != new and filled(text, "paper", Study({}, [])) == text


def test_the_table_of_widths_begins_with_the_widest() -> None:
    rows = [
        Row("iid", name, {"f1": f1, "n_parameters": n}, {"f1": 0.001}, 5)
        for name, f1, n in (("16-16-16", 0.95, 9000), ("64-32-32", 0.96, 30000))
    ]
    _, _, first, second = TABLES["frontier"]["frontier"](Study({}, rows)).splitlines()
    assert first.startswith("| 64 / 32 / 32 | 30000 | 5 | 0.960 ± 0.001 |")
    assert second.startswith("| 16 / 16 / 16 | 9000 | 5 |")


@pytest.mark.parametrize("kind", ["ablation", "frontier"])
def test_choices_are_judged_on_validation_grasps_alone(dataset: Dataset, kind: str) -> None:
    (name, part), *others = study._tests(dataset, kind, 1.0).items()
    assert name == "iid" and not others
    assert set(part.samples["grasp_id"]) <= set(dataset.split("validation").samples["grasp_id"])


def test_a_data_set_without_the_held_out_family_is_refused(dataset: Dataset) -> None:
    other = replace(dataset, manifest=dataset.manifest | {"tool_families": ["capsule", "cylinder", "cup", "box"]})
    with pytest.raises(AminnError, match="no ellipsoid among its tools"):
        regimes(other)


def test_the_analytical_model_slides_and_stands_beside_one_that_does_not(dataset: Dataset) -> None:
    """The made-up loads use up the friction of many contacts: those give way, and no other."""
    test, validation = dataset.split("test"), dataset.split("validation")
    slides, sticks = (analytical(test, validation, name) for name in ("analytical", "analytical_stick"))
    further = pose_size(slides.dx, test.hand.length_m) / pose_size(sticks.dx, test.hand.length_m)
    assert further.max() > 1.5
    assert 0 < np.isclose(further, 1, rtol=1e-6).mean() < 1
    work = (test.samples["w_e"] * slides.dx).sum(1)
    assert (work > 0).all() and np.linalg.norm(slides.dx[:, :3], axis=1).max() <= 0.01 * (1 + 1e-6)


def test_the_command_leaves_a_report_with_its_aims(data_dir: Path, tmp_path: Path, monkeypatch) -> None:
    def jobs(seeds: int, curve_seeds: int) -> list[study.Job]:
        assert (seeds, curve_seeds) == (1, 0)
        return [study.Job(kind, TrainConfig(kind=kind, epochs=1)) for kind in ("aminn", "mlp")]

    monkeypatch.setitem(study.JOBS, "paper", jobs)
    words = ["paper", "--data", data_dir, "--build", tmp_path, "--seeds", 1, "--curve-seeds", 0, "--jobs", 1]
    result = CliRunner().invoke(study.main, list(map(str, words)))
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "reports" / "paper.json").read_text())
    assert report["runs"] == report["runs_planned"] == 2
    assert (
        0 < report["aims_missed"] <= report["aims"]
        and report["aims_missed_which"].count(";") == report["aims_missed"] - 1
    )
    assert "new grasps" in (tmp_path / "reports" / "paper.md").read_text() and "| 2 of 2 |" in result.output
    document = tmp_path / "page.md"
    document.write_text("<!-- table: bounds -->\n<!-- end of table -->\n")
    result = CliRunner().invoke(tables, [str(document), "--studies", str(tmp_path / "studies")])
    assert result.exit_code == 0 and "| no | 0.960 |" in document.read_text()
