"""Training: it learns, it repeats itself to the byte, it resumes, and what it writes reads back."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import aminn.train as train_module
from aminn.checkpoint import META, WEIGHTS, Checkpoint, load_checkpoint, write_json
from aminn.dataset import Dataset
from aminn.errors import AminnError
from aminn.evaluate import evaluate, flat_report, format_table
from aminn.export_tables import export_tables
from aminn.train import TrainConfig, train

SHORT = TrainConfig(epochs=2)


def checkpoint_bytes(folder: Path) -> tuple[bytes, bytes]:
    return (folder / WEIGHTS).read_bytes(), (folder / META).read_bytes()


def test_aminn_beats_no_motion_and_the_analytical_model(
    runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path
) -> None:
    result = evaluate(list(runs.values()), dataset)
    table = result.table
    assert table["aminn"]["rmse_pose_all"] < 0.5 * table["no_motion"]["rmse_pose_all"]
    assert table["aminn"]["relative_error_median_all"] < table["analytical"]["relative_error_median_all"]
    assert table["aminn"]["f1"] > table["no_motion"]["f1"]
    assert table["aminn"]["passivity_violation_full"] == 0
    assert "aminn" in format_table(result)
    write_json(tmp_path / "report.json", flat_report(result))
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["aminn_f1"] == table["aminn"]["f1"] and report["aminn_rmse_pose_size0"] is None


def test_same_seed_same_bytes_whatever_the_threads(dataset: Dataset, tmp_path: Path) -> None:
    torch.set_num_threads(2)
    train(SHORT, dataset, tmp_path / "a")
    train(SHORT, dataset, tmp_path / "b")
    assert checkpoint_bytes(tmp_path / "a") == checkpoint_bytes(tmp_path / "b")
    train(replace(SHORT, seed=1), dataset, tmp_path / "c")
    assert checkpoint_bytes(tmp_path / "a") != checkpoint_bytes(tmp_path / "c")


@pytest.mark.parametrize("after", [1, 2, 3])
def test_interrupted_run_ends_in_the_same_bytes(dataset: Dataset, tmp_path: Path, monkeypatch, after: int) -> None:
    """Cut after an epoch of stage 1, between the stages, and in stage 2."""
    train(SHORT, dataset, tmp_path / "whole")
    save, calls = train_module._Run.save, []

    def cut(self, *args) -> None:
        save(self, *args)
        calls.append(1)
        if len(calls) == after:
            raise KeyboardInterrupt

    monkeypatch.setattr(train_module._Run, "save", cut)
    with pytest.raises(KeyboardInterrupt):
        train(SHORT, dataset, tmp_path / "cut")
    assert not (tmp_path / "cut" / META).exists()
    monkeypatch.undo()
    train(SHORT, dataset, tmp_path / "cut")
    assert checkpoint_bytes(tmp_path / "whole") == checkpoint_bytes(tmp_path / "cut")
    assert sorted(os.listdir(tmp_path / "cut")) == sorted([META, WEIGHTS])


def test_finished_run_is_not_repeated_nor_overwritten(dataset: Dataset, tmp_path: Path) -> None:
    train(SHORT, dataset, tmp_path)
    stamp = (tmp_path / WEIGHTS).stat().st_mtime_ns
    train(SHORT, dataset, tmp_path)
    assert (tmp_path / WEIGHTS).stat().st_mtime_ns == stamp
    with pytest.raises(AminnError, match="another configuration"):
        train(replace(SHORT, seed=5), dataset, tmp_path)


def test_one_outcome_only_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    held = dataset.take(dataset.samples["stable"] > 0)
    with pytest.raises(AminnError, match="needs both outcomes"):
        train(SHORT, held, tmp_path)


def test_checkpoint_reads_back(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    run = runs["aminn"]
    again = load_checkpoint(run.path)
    x = dataset.inputs()
    with torch.no_grad():
        a, b = run.model(**x), again.model(**x)
    assert all(torch.equal(a[k], b[k]) for k in a)
    assert again.sha256 == run.sha256


@pytest.mark.parametrize("name", [META, WEIGHTS])
def test_damaged_checkpoint_gives_a_clear_error(runs: dict[str, Checkpoint], tmp_path: Path, name: str) -> None:
    for file in (META, WEIGHTS):
        (tmp_path / file).write_bytes((runs["aminn"].path / file).read_bytes())
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-200])
    with pytest.raises(AminnError, match="not a usable checkpoint"):
        load_checkpoint(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(AminnError, match="missing"):
        load_checkpoint(tmp_path)


def test_evaluation_refuses_other_data(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    other = Dataset(dataset.manifest | {"config_sha256": "0" * 64}, dataset.samples, dataset.grasps)
    with pytest.raises(AminnError, match="another data set"):
        evaluate([runs["aminn"]], other)


def test_exported_tables(runs: dict[str, Checkpoint]) -> None:
    exported = export_tables(runs["aminn"])
    assert all(t.dtype == np.float32 and np.isfinite(t).all() for t in exported.tensors.values())
    assert exported.meta["checkpoint_sha256"] == runs["aminn"].sha256
    assert exported.tensors["s2.head_w"].shape == (39, exported.meta["width"])
    with pytest.raises(AminnError, match="no mechanics layer"):
        export_tables(runs["mlp"])


def test_damaged_unfinished_run_gives_a_clear_error(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / train_module.RESUME).write_bytes(b"")
    (tmp_path / train_module.RESUME_META).write_text("{")
    with pytest.raises(AminnError, match="damaged"):
        train(SHORT, dataset, tmp_path)


def test_two_runs_of_a_kind_have_rows_of_their_own(
    runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path
) -> None:
    other = train(replace(SHORT, seed=7), dataset, tmp_path / "other")
    assert list(evaluate([runs["aminn"], other, runs["mlp"]], dataset).table)[:3] == ["aminn", "other", "mlp"]
    with pytest.raises(AminnError, match="both called"):
        evaluate([other, other], dataset)


def test_checkpoint_is_as_readable_as_other_files(dataset: Dataset, tmp_path: Path) -> None:
    train(SHORT, dataset, tmp_path)
    (tmp_path / "plain").touch()
    assert (tmp_path / WEIGHTS).stat().st_mode == (tmp_path / "plain").stat().st_mode
