"""`aminn verify` for hands of other shapes: the runtime is built for each, and another hand's files are refused."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hands import HANDS, made_up, random_model, random_states
from runtime_models import random_inputs

from aminn.hand.nominal import nominal_of
from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn.model.config import ModelConfig
from aminn.model.export_tables import export_tables
from aminn.model.network import Aminn
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_export.export import export, write_model_files
from aminn_export.files.bin_model import read_bin_model
from aminn_export.files.onnx_model import ONNX_FILE, read_metadata
from aminn_export.files.tables import by_branch
from aminn_export.judge.compare import compare_files
from aminn_export.judge.verdict import compare_bits
from aminn_export.judge.verify import verify
from aminn_export.replay.runtime_place import find_runtime
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import Results, write_results, write_vectors
from aminn_hand.hand import Hand
from aminn_rt.sources import runtime_source

N = 60
EVERY = os.environ.get("AMINN_EVERY_HAND") == "1"
"""Compiling takes half a minute for each hand: by default one with tendons and soft fingertips stands for all."""
NEEDED = ("arm-none-eabi-gcc", "qemu-system-arm", "cmake")


def exported(hand: Hand, folder: Path) -> tuple[Path, Path]:
    """(folder of all model files, vector file of random states)."""
    files, vectors = folder / "export", folder / "vectors.bin"
    files.mkdir()
    write_model_files(random_model(hand), files, "aminn_model")
    x = random_states(hand, N, 4)
    write_vectors(vectors, x, run_onnx(single_thread_session(files / "aminn.onnx"), x))
    return files, vectors


@pytest.mark.parametrize("name", HANDS if EVERY else ["gripper"])
def test_the_runtime_repeats_onnx(name: str, build_dir: Path, tmp_path: Path, trust: dict) -> None:
    """On the host from both forms of the model, and on the emulated Cortex-M7: within limits, the same bits."""
    files, vectors = exported(HANDS[name](), tmp_path)
    targets = ("cortex_m7",) if all(map(shutil.which, NEEDED)) else ()
    report = verify(files, vectors, build_dir, on_targets=targets, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert 0 < report["host_bin_dx_relative_median"] < 2e-6 and report["host_bin_refused"] == 0
    assert [report[f"{target}_different_words"] for target in ("host_c", *targets)] == [0] * (1 + len(targets))
    trust[f"hands_{name}_dx_share_of_limit_max"] = report["host_bin_dx_share_of_limit_max"]
    own = find_runtime(build_dir)  # is still what it was
    assert own.hand == runtime_source() / "include" / "aminn_hand.h" and build_dir in own.replay.parents


def test_a_checkpoint_becomes_the_files_of_its_hand(tmp_path: Path) -> None:
    """Untrained: nominal springs, tendons and contacts of the hand are in all of them."""
    hand = HANDS["gripper"]()
    save_checkpoint(tmp_path / "run", Aminn(ModelConfig(), hand), {"tau": 0.5, "data": {"hand": hand.name}})
    export(tmp_path / "run", tmp_path / "export")
    model = read_bin_model(tmp_path / "export" / "aminn_model.bin")
    metadata = read_metadata(tmp_path / "export" / ONNX_FILE)
    assert Hand.from_dict(metadata["hand"]) == hand
    assert "gripper" in (tmp_path / "export" / "aminn_hand.h").read_text()
    assert model.meta["hand"].startswith("gripper ")
    np.testing.assert_array_equal(model.tensors["twist_nom"], nominal_of(hand).twist.astype(np.float32))
    np.testing.assert_allclose(by_branch(metadata["eps_m"], 2), [[b.eps_m for b in hand.branches]] * 2)
    found, wanted = Reference(model), Reference(export_tables(load_checkpoint(tmp_path / "run")))
    x = random_states(hand, 20)
    np.testing.assert_allclose(found(x)["dx_ht"], wanted(x)["dx_ht"], rtol=1e-5, atol=1e-9)


def test_vectors_and_results_of_another_hand_are_refused(export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    """Both are told: what the file is of, and what the model is of."""
    hand = made_up((2, 2, 2, 1), (0,) * 4, "four")
    x = random_states(hand, 5)
    zeros = {name: np.zeros((5, *shape), np.float32) for name, shape in hand.dims.outputs.items()}
    other, results = tmp_path / "other.bin", tmp_path / "results.bin"
    write_vectors(other, x, zeros)
    write_results(results, np.zeros((5, hand.dims.output + 1), np.float32), np.zeros(5, np.int32))
    said = r"other\.bin: of another hand \(4 branches, 7 joints, at most 2 a branch\) than the model \(3 branches"
    with pytest.raises(AminnError, match=said):
        verify(export_dir, other, build_dir, echo=lambda _: None)
    model = export_dir / "aminn_model.bin"
    with pytest.raises(AminnError, match=said):
        compare_files([model, other, results])
    own = tmp_path / "own.bin"
    states = random_inputs(5, 1)
    write_vectors(own, states, run_onnx(single_thread_session(export_dir / "aminn.onnx"), states))
    with pytest.raises(AminnError, match="results of a hand of 4 branches, and a reference of one of 3"):
        compare_files([model, own, results])
    done = CliRunner().invoke(main, ["compare", str(model), str(own), str(results)])
    assert done.exit_code == 3 and "4 branches" in done.output


def test_results_of_two_hands_are_not_compared() -> None:
    first, second = (
        Results({"gate": np.zeros((2, b), np.float32)}, np.zeros(2, np.float32), np.zeros(2, np.int32)) for b in (2, 3)
    )
    with pytest.raises(AminnError, match="results of a hand of 2 branches, and a reference of one of 3"):
        compare_bits(first, second)


def test_golden_vectors_of_another_hand_are_refused(export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(export_dir, tmp_path / "copy"))
    hand = made_up((3, 3), (0, 0), "two")
    zeros = {name: np.zeros((3, *shape), np.float32) for name, shape in hand.dims.outputs.items()}
    write_vectors(copy / "golden.bin", random_states(hand, 3), zeros)
    states = random_inputs(3, 1)
    write_vectors(tmp_path / "v.bin", states, run_onnx(single_thread_session(copy / "aminn.onnx"), states))
    with pytest.raises(AminnError, match=r"golden\.bin: of another hand \(2 branches"):
        verify(copy, tmp_path / "v.bin", build_dir, echo=lambda _: None)
    assert read_bin_model(copy / "aminn_model.bin").tensors["coord_mask"].shape == (3, 3)
