"""`aminn verify` passes on what was exported, and fails on each kind of tampering with the sample's name."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from runtime_models import RandomModel, random_inputs

from aminn.dataset import load_dataset, split_of
from aminn_base.errors import AminnError
from aminn_export.bin_model import read_bin_model, write_bin_model
from aminn_export.c_model import write_c_model
from aminn_export.export import export
from aminn_export.golden import run_onnx, single_thread_session
from aminn_export.vectors import write_vectors
from aminn_export.verify import check_golden, samples_of_dataset, verify


@pytest.fixture(scope="module")
def vectors(export_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("vectors") / "vectors.bin"
    x = random_inputs(400, 12)
    write_vectors(file, x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    return file


@pytest.fixture
def copy(export_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(export_dir, tmp_path / "copy"))


def test_golden_vectors_and_debug_model_are_held_against_the_model(
    export_dir: Path, copy: Path, vectors: Path, build_dir: Path
) -> None:
    x = random_inputs(20, 3)
    write_vectors(copy / "golden.bin", x, run_onnx(single_thread_session(copy / "aminn.onnx"), x))
    model = read_bin_model(copy / "aminn_model.bin")
    assert check_golden(copy, model) == []
    other = random_inputs(20, 4)
    write_vectors(copy / "golden.bin", x, run_onnx(single_thread_session(copy / "aminn.onnx"), other))
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert not report["ok"] and "golden.bin is not what aminn.onnx gives" in report["failures"]
    assert "golden.bin is not what aminn_debug.onnx gives" in report["failures"]
    data = bytearray((copy / "golden.bin").read_bytes())
    data[-1] ^= 1
    (copy / "golden.bin").write_bytes(data)
    with pytest.raises(AminnError, match=r"golden.bin"):
        verify(copy, vectors, build_dir, echo=lambda _: None)


def _tampered(model: RandomModel, name: str, factor: float) -> RandomModel:
    return replace(model, tensors=model.tensors | {name: model.tensors[name] * np.float32(factor)})


def test_exported_model_passes(export_dir: Path, vectors: Path, build_dir: Path) -> None:
    lines: list[str] = []
    report = verify(export_dir, vectors, build_dir, echo=lines.append)
    print("\n".join(lines))
    assert report["ok"] is True
    assert report["failures"] == ""
    assert report["samples"] == 400
    for target in ("host_bin", "host_c"):
        assert 0 < report[f"{target}_dx_relative_median"] < 2e-6
        assert report[f"{target}_dx_share_of_limit_max"] < 1
        assert report[f"{target}_decisions_different"] == report[f"{target}_refused"] == 0


@pytest.mark.skipif(
    not all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm", "cmake"))), reason="no cross compiler or no qemu"
)
def test_cortex_m7_repeats_onnx(export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    x = random_inputs(60, 14)
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = verify(export_dir, tmp_path / "v.bin", build_dir, on_targets=("cortex_m7",), echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert 0 < report["cortex_m7_dx_relative_median"] < 2e-6
    assert report["cortex_m7_different_words"] == 0
    assert 2000 < report["cortex_m7_stack_predict_bytes"] <= 3000  # docs/runtime.md: the call graph's worst case


def test_data_set_is_replayed_test_split_first(
    checkpoint_dir: Path, data_dir: Path, build_dir: Path, tmp_path: Path
) -> None:
    export(checkpoint_dir, tmp_path / "out", "my_model", data_dir)
    report = verify(tmp_path / "out", data_dir, build_dir, min_samples=150, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert report["samples"] == 150
    dataset = load_dataset(data_dir)
    n_test = int((split_of(dataset.samples["grasp_id"]) == 2).sum())
    samples = samples_of_dataset(dataset, 1)
    assert len(samples.inputs["q"]) == n_test
    with pytest.raises(AminnError, match="simulate more"):
        samples_of_dataset(dataset, 10**6)


@pytest.mark.parametrize(
    ("tensor", "factor", "output"),
    [("s2.head_w", 1.01, "dx_ht"), ("s1.cls2_w", 1.001, "p_stable"), ("tendon_gain_nom", 1.001, "dx_ht")],
)
def test_tampered_binary_fails_alone(
    exported: RandomModel, copy: Path, vectors: Path, build_dir: Path, tensor: str, factor: float, output: str
) -> None:
    write_bin_model(_tampered(exported, tensor, factor), copy / "aminn_model.bin")
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert report["ok"] is False
    assert f"host, .bin: {output}" in report["failures"]
    assert "sample" in report["failures"]
    assert "aminn_model.c is not aminn_model.bin" in report["failures"]
    # the C model is right, but not the same
    assert report["host_c_dx_share_of_limit_max"] < 1 and report["host_c_different_words"] > 0


def test_tampered_c_model_fails_alone(exported: RandomModel, copy: Path, vectors: Path, build_dir: Path) -> None:
    write_c_model(_tampered(exported, "s2.trunk2_w", 1.01), copy)
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert report["ok"] is False
    assert "host, .c: dx_ht" in report["failures"]
    assert "files: aminn_model.c is not aminn_model.bin: aminn_model_s2_trunk2_w" in report["failures"]
    assert "host, .bin:" not in report["failures"]


def test_another_threshold_is_another_decision(
    exported: RandomModel, copy: Path, vectors: Path, build_dir: Path
) -> None:
    write_c_model(replace(exported, meta=exported.meta | {"tau": 0.9}), copy)
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert report["host_c_decisions_different"] > 0
    assert "host, .c: stable" in report["failures"]


def test_refused_sample_is_named(exported: RandomModel, export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    x = {k: v.copy() for k, v in random_inputs(30, 13).items()}
    x["contacts"][17, :, 4:7] *= 2  # normals of length 2
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = verify(export_dir, tmp_path / "v.bin", build_dir, echo=lambda _: None)
    assert report["ok"] is False
    assert report["host_bin_refused"] == 1
    assert "host, .bin: status of sample 17 of v.bin: got -6, want 0" in report["failures"]
    assert "dx_ht" not in report["failures"]  # the others are compared all the same
    assert all(np.isfinite(v) for v in report.values() if isinstance(v, float))


def test_missing_parts_are_named(export_dir: Path, vectors: Path, build_dir: Path, copy: Path, tmp_path: Path) -> None:
    with pytest.raises(AminnError, match="aminn_replay"):
        verify(export_dir, vectors, tmp_path, echo=lambda _: None)
    (copy / "aminn.onnx").write_bytes(b"not a model")
    with pytest.raises(AminnError, match="cannot load"):
        verify(copy, vectors, build_dir, echo=lambda _: None)
    (copy / "aminn.onnx").unlink()
    with pytest.raises(AminnError, match=r"aminn\.onnx"):
        verify(copy, vectors, build_dir, echo=lambda _: None)
    (copy / "aminn_model.bin").write_bytes((export_dir / "aminn_model.bin").read_bytes()[:-4])
    with pytest.raises(AminnError, match="truncated"):
        verify(copy, vectors, build_dir, echo=lambda _: None)
