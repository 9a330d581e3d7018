"""The timing program: figures of all subjects on the same samples, and the MLP that it is compared with."""

from __future__ import annotations

import platform
import shutil
from pathlib import Path

import onnx
import pytest
from runtime_models import RandomModel

from aminn_export.judge.bench import ROWS, bench, describe_cpu, format_bench, parameters, plain_mlp
from aminn_export.samples.golden import GOLDEN_FILE

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


def test_the_mlp_has_as_many_parameters(exported: RandomModel) -> None:
    wanted = parameters(exported)
    found = sum(onnx.numpy_helper.to_array(t).size for t in plain_mlp(wanted, 125).graph.initializer)
    assert 0.98 * wanted < found <= wanted


CPUINFO = "processor\t: {}\ncpu family\t: 25\nmodel\t\t: 17\nmodel name\t: AMD EPYC\nflags\t\t: fpu sse2 {}\n\n"


@pytest.mark.parametrize(
    ("flags", "widest"),
    [("avx2 avx512f avx512vl", "AVX-512"), ("avx2 avx512f", "AVX2"), ("avx2", "AVX2"), ("avx", "SSE2")],
)
def test_the_report_tells_processors_of_one_name_apart(flags: str, widest: str) -> None:
    two = CPUINFO.format(0, flags) + CPUINFO.format(1, flags)
    assert describe_cpu(two) == ("AMD EPYC, family 25, model 17", widest)


def test_a_processor_without_these_fields_is_named_by_its_architecture() -> None:
    assert describe_cpu("processor\t: 0\nBogoMIPS\t: 50.00\n") == (platform.machine(), "")


@pytest.mark.skipif(
    not Path("/usr/include/eigen3").is_dir()
    or not list(Path("/usr/lib").glob("*/libopenblas.so"))
    or not shutil.which("g++"),
    reason="no OpenBLAS or Eigen here: make bench installs them",
)
def test_bench_reports_all_subjects(build_dir: Path) -> None:
    """Of the reference model, whose vectors have sensors."""
    report = bench(GOLDEN, GOLDEN / GOLDEN_FILE, build_dir, rounds=5)
    print(format_bench(report))
    assert report["samples"] == 200
    for _, name in ROWS:
        assert 0 < report[f"{name}_us_min"] <= report[f"{name}_us"]
    assert report["floor"] in {name for _, name in ROWS[:4]}
    assert report["onnx_nodes"] > 0
    assert report["batch_rows"] == 10_000 and report["batch_threads"] == 2
    ways = [f"onnx_{name}" for name in ("at_once", "in_chunks", "a_session_a_thread", "single_samples")]
    for name in ("runtime", "runtime_and_closure", "runtime_one_thread", *ways):
        assert report[f"batch_{name}_per_s"] > 0
    assert report["batch_onnx_per_s"] == max(report[f"batch_{name}_per_s"] for name in ways)
    assert report["batch_runtime_to_onnx_ratio"] > 0
    with_avx512 = report["vector_registers"] == "AVX-512"
    assert with_avx512 == ("avx2_floor_us" in report)
    if with_avx512:
        ratio = float(report["avx2_runtime_both_stages_us"]) / float(report["avx2_floor_us"])
        assert report["avx2_runtime_to_floor_ratio"] == pytest.approx(ratio, rel=0.5)
        assert "with AVX2 alone" in format_bench(report)
