"""Runs side by side: rows by what differs, spread over seeds, the page, and a grid of settings."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from page_checks import faults

from aminn.data.dataset import load_dataset
from aminn.evaluation.metrics import spread
from aminn.model.checkpoint import Checkpoint, load_checkpoint
from aminn.model.config import TrainConfig
from aminn.training.runs import conclusion, grouped
from aminn.training.train import train
from aminn_app.cli import main
from aminn_app.sweep import read_grid
from aminn_base.errors import AminnError

GRID = """
epochs = 1
[grid]
seed = [0, 1]
kind = ["mlp", "aminn"]
"""


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in args])


@pytest.fixture(scope="module")
def swept(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A finished sweep, and what it said."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "grid.toml").write_text(GRID)
    return folder / "out", call("sweep", folder / "grid.toml", "--data", data_dir, "--out", folder / "out", "--jobs", 2)


def test_rows_are_called_by_what_differs(runs: dict[str, Checkpoint]) -> None:
    def like(run: Checkpoint, **changes: object) -> Checkpoint:
        identity = run.meta["identity"]
        config = identity["config"] | changes
        meta = run.meta | {"identity": identity | {"config": config}}
        meta |= {"validation": run.meta["validation"] | {"rmse_pose_all": 0.01 * (1 + config["seed"])}}
        return replace(run, meta=meta, path=run.path.with_name(f"{run.path.name}{len(names)}{config}"))

    names: list[str] = []
    mlp, aminn = runs["mlp"], runs["aminn"]
    several = [like(aminn), like(aminn, seed=1), like(aminn, seed=2, epochs=7), like(mlp, batch=64)]
    groups = grouped(several)
    assert [g.name for g in groups] == [
        "AMINN, batch 256, epochs 15", "AMINN, batch 256, epochs 7", "MLP, batch 64, epochs 15"
    ]  # fmt: skip
    assert [len(g.runs) for g in groups] == [2, 1, 1]
    assert groups[0].over_seeds("rmse_pose_all") == pytest.approx((0.015, spread([0.01, 0.02])))
    assert groups[0].over_seeds("no such figure") is None
    assert conclusion(groups).startswith("MLP, batch 64, epochs 15 has the least RMSE_pose, 0.0100; next is AMINN")
    with pytest.raises(AminnError, match="given twice"):
        grouped([mlp, mlp])


def test_compare_of_runs(data_dir: Path, runs: dict[str, Checkpoint], tmp_path: Path) -> None:
    page, flat = tmp_path / "runs.html", tmp_path / "runs.json"
    done = call("compare", runs["aminn"].path, runs["mlp"].path, "--page", page, "--json", flat)
    assert done.exit_code == 0, done.output
    figures = json.loads(flat.read_text())
    assert figures["aminn_runs"] == 1 and figures["aminn_f1_mean"] == runs["aminn"].meta["validation"]["f1"]
    assert f"{figures['mlp_rmse_pose_all_mean']:.4f}" in done.output and "validation grasps" in done.output
    text = page.read_text()
    assert faults(page) == []
    assert conclusion(grouped([runs["aminn"], runs["mlp"]])) in text and text.count("<img") == 2
    assert str(runs["mlp"].path) in text and runs["mlp"].meta["identity"]["data_sha256"][:16] in text
    judged = call("compare", runs["aminn"].path, "--data", data_dir)
    assert judged.exit_code == 0 and "figures on test grasps" in judged.output


def test_compare_takes_one_kind_of_thing(runs: dict[str, Checkpoint], tmp_path: Path) -> None:
    run, golden = runs["mlp"].path, Path(__file__).parents[1] / "golden" / "golden.bin"
    for words in ((run, golden), (golden, golden, "--page", tmp_path / "x.html"), (run, "--junit", tmp_path / "x.xml")):
        assert call("compare", *words).exit_code == 2
    assert call("compare", tmp_path).exit_code == 3
    assert not list(tmp_path.iterdir())


def test_sweep_trains_the_grid_and_compares(swept: tuple[Path, Result], data_dir: Path) -> None:
    out, said = swept
    assert said.exit_code == 0, said.output
    names = ["seed-0_kind-aminn", "seed-0_kind-mlp", "seed-1_kind-aminn", "seed-1_kind-mlp"]
    assert sorted(p.name for p in out.iterdir() if p.is_dir()) == names
    assert " ± " in said.output and (out / "sweep.html").is_file()
    assert json.loads((out / "sweep.json").read_text())["mlp_runs"] == 2
    alone = train(TrainConfig(kind="mlp", seed=1, epochs=1), load_dataset(data_dir), out / "alone")
    assert alone.sha256 == load_checkpoint(out / "seed-1_kind-mlp").sha256


def test_sweep_goes_on_and_names_what_failed(swept: tuple[Path, Result], data_dir: Path, tmp_path: Path) -> None:
    out, _ = swept
    written = (out / "seed-0_kind-mlp" / "model.json").stat().st_mtime_ns
    (tmp_path / "grid.toml").write_text(GRID.replace("epochs = 1", "epochs = 2").replace("[0, 1]", "[0, 7]"))
    done = call("sweep", tmp_path / "grid.toml", "--data", data_dir, "--out", out, "--jobs", 1, "--no-tensorboard")
    assert done.exit_code == 1 and "2 of 4 runs failed" in done.output
    assert "seed-0_kind-mlp: " in done.output and "config.epochs" in done.output
    assert (out / "seed-0_kind-mlp" / "model.json").stat().st_mtime_ns == written
    assert (out / "seed-7_kind-aminn" / "model.json").is_file()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("epochs = 3\n", r"expected a table \[grid\]"),
        ("[grid]\nseed = 3\n", r"grid\.seed is 3, expected a list"),
        ("[grid]\nseed = []\n", r"grid\.seed is \[\], expected a list"),
        ("[grid.model]\nwidths = [3]\n", r"model\.widths is no setting; did you mean model\.width"),
        ("[grid]\nseed = [1, 1]\n", "give each value once"),
        ('[grid]\nepochs = [1]\n"epochs.x" = [1]\n', "epochs is a single value"),
        (f"[grid]\nseed = {list(range(101))}\nbatch = {list(range(1, 102))}\n", "10201 runs, at most 10000"),
    ],
)
def test_a_wrong_grid_is_named(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "grid.toml").write_text(text)
    with pytest.raises(AminnError, match=message):
        read_grid(tmp_path / "grid.toml")


def test_a_grid_holds_tables_and_pairs(tmp_path: Path) -> None:
    text = "batch = 8\n[grid]\nmodel.mechanics.eps_kx = [0.01, [0.01, 0.001]]\n[grid.loss]\nrelative = [0.1]\n"
    (tmp_path / "grid.toml").write_text(text)
    found = read_grid(tmp_path / "grid.toml")
    assert list(found) == [
        "model.mechanics.eps_kx-0.01_loss.relative-0.1", "model.mechanics.eps_kx-0.01-0.001_loss.relative-0.1"
    ]  # fmt: skip
    both = [[stage.eps_kx for stage in config.model.mechanics] for config in found.values()]
    assert both == [[0.01, 0.01], [0.01, 0.001]]
    assert all(config.batch == 8 and config.loss.relative == 0.1 for config in found.values())


def test_ctrl_c_ends_a_sweep_at_once(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "grid.toml").write_text("epochs = 10000\n[grid]\nseed = [0, 1, 2, 3]\n")
    words = ["sweep", tmp_path / "grid.toml", "--data", data_dir, "--out", tmp_path / "out", "--jobs", "1"]
    command = [sys.executable, "-m", "aminn_app.cli", *map(str, words)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, process_group=0)
    try:
        while not list(tmp_path.glob("out/*/unfinished.safetensors")):
            assert process.poll() is None
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130 and "the same command continues where it stopped" in said
    assert "Traceback" not in said
    assert len(list((tmp_path / "out").iterdir())) == 1  # no further run was begun
