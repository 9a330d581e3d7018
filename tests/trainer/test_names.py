"""Runs keep their own figures, whatever their folders are called."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aminn.data.dataset import Dataset
from aminn.evaluation.evaluate import BASELINES, KIND_NAMES, evaluate, flat_report, names_of
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.pages.report import label_of
from aminn_app.cli import main

FOLDERS = ("mlp", "analytical", "no_motion", "no motion", "ground truth", "a/x", "b/x")


def copies(run: Checkpoint, root: Path, folders: tuple[str, ...]) -> list[Checkpoint]:
    for folder in folders:
        shutil.copytree(run.path, root / folder)
    return [load_checkpoint(root / folder) for folder in folders]


def test_no_run_has_the_name_of_a_baseline_or_of_another_run(
    runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path
) -> None:
    checkpoints = [*copies(runs["aminn"], tmp_path, FOLDERS), runs["mlp"]]
    names = names_of(checkpoints)
    assert names[:4] == ["run mlp", "run analytical", "run no_motion", "run no motion_"] and names[-1] == "mlp"
    assert names[5:7] == ["a/x", "b/x"]
    shown = {label_of(name).lower() for name in (*names, *BASELINES)}
    assert len(shown) == len(names) + len(BASELINES)
    result, alone = evaluate(checkpoints, dataset), evaluate([runs["aminn"], runs["mlp"]], dataset)
    assert len(result.table) == len(checkpoints) + 3
    for name, checkpoint in zip(names, checkpoints, strict=True):
        np.testing.assert_equal(result.table[name], alone.table[checkpoint.model.kind])
    report = flat_report(result)
    assert [report[f"{b}_f1"] for b in ("analytical", "no_motion")] == [
        alone.table[b]["f1"] for b in ("analytical", "no_motion")
    ]
    assert sum(key.endswith("_rmse_pose_all") and not key.startswith("label") for key in report) == len(checkpoints) + 3
    assert report["run_mlp_f1"] == report["run_analytical_f1"] == alone.table["aminn"]["f1"] != report["mlp_f1"]


def test_a_run_of_a_kind_is_called_by_it_wherever_it_lies(runs: dict[str, Checkpoint], tmp_path: Path) -> None:
    (moved,) = copies(runs["aminn"], tmp_path, ("mlp",))
    assert names_of([moved, runs["mlp"]]) == ["aminn", "mlp"] == list(KIND_NAMES)


def test_page_and_table_of_runs_called_like_baselines(
    runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path
) -> None:
    copies(runs["aminn"], tmp_path, ("mlp", "analytical"))
    words = ["--data", data_dir, "--run", tmp_path / "mlp", "--run", tmp_path / "analytical"]
    result = CliRunner().invoke(main, list(map(str, ["evaluate", *words, "--json", tmp_path / "e.json"])))
    assert [line.split("  ")[0] for line in result.output.splitlines()[3:8]] == [
        "run mlp",
        "run analytical",
        "analytical",
        "analytical_stick",
        "no_motion",
    ]
    assert "run_mlp_f1" in json.loads((tmp_path / "e.json").read_text())
    out = ["--out", tmp_path / "p.html", "--reports", tmp_path / "none"]
    result = CliRunner().invoke(main, list(map(str, ["report", *words, *out])))
    page = (tmp_path / "p.html").read_text()
    results, others = page[page.index("<table") :].split("</table>", 1)
    assert result.exit_code == 0 and results.count(">run mlp<") == 1 and page.count(">analytical<") == 1
    assert others.count(">run mlp<") == 1  # of how sure it is


def test_the_same_run_twice_is_refused(runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(runs["aminn"].path)
    words = ["evaluate", "--data", data_dir, "--run", runs["aminn"].path, "--run", tmp_path / "link"]
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exit_code == 1 and "given twice" in result.output


def test_keys_that_would_be_the_same_are_refused(runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path) -> None:
    from aminn_base.errors import AminnError

    checkpoints = copies(runs["aminn"], tmp_path, ("x", "x_rmse_pose"))
    result = evaluate(checkpoints, dataset)
    table = {"x": {"rmse_pose_all": 1.0}, "x_rmse_pose": {"all": 2.0}}
    with pytest.raises(AminnError, match="two figures are both called x_rmse_pose_all"):
        flat_report(type(result)(result.split, table, {}, {}, result.data))
