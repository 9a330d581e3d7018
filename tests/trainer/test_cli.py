"""The program `aminn` as a user calls it: what it prints, where it writes, how it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from aminn.model.checkpoint import Checkpoint
from aminn_app.cli import main


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in args])


def test_help_names_every_command() -> None:
    result = call("--help")
    assert result.exit_code == 0
    for command in ("simulate", "train", "evaluate", "export", "verify", "report"):
        assert command in result.output
        assert call(command, "--help").exit_code == 0


def test_train_evaluate_and_report(data_dir: Path, tmp_path: Path) -> None:
    for kind in ("aminn", "mlp"):
        result = call("train", "--data", data_dir, "--out", tmp_path / kind, "--model", kind, "--epochs", 2)
        assert result.exit_code == 0, result.output
        assert "parameters" in result.output
    runs = ("--run", tmp_path / "aminn", "--run", tmp_path / "mlp")
    result = call("evaluate", "--data", data_dir, *runs, "--json", tmp_path / "reports" / "figures.json")
    assert result.exit_code == 0, result.output
    figures = json.loads((tmp_path / "reports" / "figures.json").read_text())
    assert 0 <= figures["aminn_f1"] <= 1 and figures["aminn_passivity_violation_full"] == 0
    assert f"{figures['mlp_f1']:.3f}" in result.output


def test_fine_tune(data_dir: Path, runs: dict[str, Checkpoint], tmp_path: Path) -> None:
    words = ("train", "--data", data_dir, "--out", tmp_path / "run", "--epochs", 1, "--set", "learning_rate=1e-3")
    result = call(*words, "--model", "mlp", "--finetune", runs["aminn"].path)
    assert result.exit_code == 1 and "give --model aminn" in result.output
    result = call(*words, "--finetune", runs["aminn"].path)
    assert result.exit_code == 0, result.output
    assert runs["aminn"].sha256 in (tmp_path / "run" / "card.md").read_text()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("train", "--data", "{empty}", "--out", "{out}"), "no manifest.json"),
        (("train", "--data", "{empty}/nowhere", "--out", "{out}"), "does not exist"),
        (("train", "--data", "{data}", "--out", "{out}", "--model", "forest"), "'forest' is not one of"),
        (("evaluate", "--data", "{data}", "--run", "{empty}"), "model.safetensors is missing"),
        (("export", "--run", "{mlp}", "--data", "{data}", "--out", "{out}"), "no mechanics layer"),
        (("verify", "--export", "{empty}", "--data", "{data}", "--build", "{empty}"), "aminn export"),
        (("simulate", "--out", "{data}", "--grasps", 2, "--cases", 2), "not a readable shard"),
        (("simulate", "--out", "{out}", "--family", "banana"), "banana"),
        (("simulate", "--out", "{out}", "--set", "mass_min"), "--set mass_min: expected NAME=VALUE"),
        (("simulate", "--out", "{out}", "--set", "seed=3"), "--set seed=3: seed has an option of its own; give --seed"),
        (("simulate", "--out", "{out}", "--set", "ramps_s=1"), "did you mean ramp_s?"),
        (("simulate", "--out", "{out}", "--set", "ramp_s=1", "--set", "ramp_s=2"), "ramp_s is given twice"),
        (("simulate", "--out", "{out}", "--set", "drift_window_s=0.0004"), "drift_window_s is 0.0004, expected 0.001"),
        (("simulate", "--out", "{out}", "--seed", 2**64), "seed is 18446744073709551616, expected 0 to 2^64 - 1"),
        (("simulate", "--out", "{out}", "--cases", 10**12), "cases is 1000000000000, expected 1 to 1 000 000"),
        (("simulate", "--out", "{out}", "--set", "ramp_s=soon"), "--set ramp_s=soon: 'soon' is not a number"),
        (("simulate", "--out", "{out}", "--hand", "nothing.toml"), "nothing.toml: cannot be read"),
    ],
)
def test_errors_are_one_line_for_the_user(
    args: tuple, message: str, data_dir: Path, runs: dict[str, Checkpoint], tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"empty": tmp_path / "empty", "out": tmp_path / "out", "data": data_dir, "mlp": runs["mlp"].path}
    result = call(*(str(a).format(**places) for a in args))
    assert result.exit_code != 0
    assert message in result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "out" / "manifest.json").exists()
