"""The timing program: figures of both runtimes on the same samples."""

from __future__ import annotations

from pathlib import Path

import pytest
from runtime_models import random_inputs

from aminn_export import bench as module
from aminn_export.bench import bench, format_bench
from aminn_export.golden import run_onnx, single_thread_session
from aminn_export.vectors import write_vectors


def test_bench_reports_both(export_dir: Path, build_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RUNTIME_CALLS", 200)
    monkeypatch.setattr(module, "ONNX_CALLS", 20)
    x = random_inputs(16, 1)
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = bench(export_dir, tmp_path / "v.bin", build_dir)
    print(format_bench(report))
    assert report["samples"] == 16
    for name in ("onnx_us", "runtime_predict_us", "runtime_both_stages_us", "runtime_both_stages_and_closure_us"):
        assert 0 < report[f"{name}_median"] <= report[f"{name}_p99"] <= report[f"{name}_max"]
    assert report["onnx_to_runtime_ratio"] > 1
