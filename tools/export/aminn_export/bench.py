"""Times the compiled runtime beside ONNX Runtime: one thread, one sample a call, the same samples, in turns.

python -m aminn_export.bench --model tests/golden --build build/host --json build/reports/bench.json
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from aminn.checkpoint import write_json
from aminn.dims import INPUT_SHAPES, OUTPUT_SHAPES
from aminn.errors import AminnError

from .bin_model import read_bin_model
from .export import GOLDEN_FILE, ONNX_FILE
from .golden import single_thread_session
from .onnx_model import build_onnx
from .vectors import read_vectors
from .verify import cmake_cache, find_in, model_prefix, run_program, runtime_source

ROUNDS = 5
# Calls of each runtime in a round; the rounds take turns, so that a change of clock rate meets both.
RUNTIME_CALLS, ONNX_CALLS = 20000, 2000


def compile_bench(build_dir: Path, program: Path) -> None:
    """Compile the timing program against the built library."""
    source = runtime_source(build_dir)
    command = [cmake_cache(build_dir).get("CMAKE_C_COMPILER", "cc"), "-std=c99", "-O2", f"-I{source / 'include'}"]
    command += [str(source / "tools" / name) for name in ("aminn_bench.c", "host_file.c")]
    command += [str(find_in(build_dir, "libaminn_rt.a")), "-lm"]
    run_program([*command, "-o", str(program)], "compiling aminn_bench")


class OnnxTimer:
    """Times single samples through ONNX Runtime, inputs and outputs bound beforehand: the least that it can take."""

    def __init__(self, session: ort.InferenceSession, inputs: dict[str, NDArray]) -> None:
        self.session, self.inputs, self.n = session, inputs, len(inputs["q"])
        self.bound = {
            k: ort.OrtValue.ortvalue_from_numpy(np.zeros((1, *s), np.float32)) for k, s in INPUT_SHAPES.items()
        }
        self.binding = session.io_binding()
        for name, value in self.bound.items():
            self.binding.bind_ortvalue_input(name, value)
        for name, shape in OUTPUT_SHAPES.items():
            value = ort.OrtValue.ortvalue_from_numpy(np.zeros((1, *shape), np.float32))
            self.binding.bind_ortvalue_output(name, value)

    def times_us(self, calls: int) -> list[float]:
        """Durations of so many calls."""
        times = []
        for i in range(calls):
            k = i % self.n
            for name, value in self.bound.items():
                value.update_inplace(self.inputs[name][k : k + 1])
            start = time.perf_counter_ns()
            self.session.run_with_iobinding(self.binding)
            times.append(1e-3 * (time.perf_counter_ns() - start))
        return times


def _cpu() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _session(model_dir: Path, blob: Path) -> tuple[ort.InferenceSession, int]:
    """The exported ONNX model, or the same graph made from the binary model where only that is kept."""
    file = model_dir / ONNX_FILE
    model = file.read_bytes() if file.is_file() else build_onnx(read_bin_model(blob)).SerializeToString()
    return single_thread_session(model), len(model)


def bench(model_dir: Path, vectors: Path, build_dir: Path) -> dict[str, float | int | str]:
    """Times of both runtimes in microseconds a call, and their ratio. Raises AminnError where something is missing."""
    blob = model_dir / f"{model_prefix(model_dir)}.bin"
    inputs = read_vectors(vectors).inputs
    session, onnx_bytes = _session(model_dir, blob)
    onnx = OnnxTimer(session, inputs)
    onnx.times_us(200)
    onnx_times: list[float] = []
    runtime_rounds: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory(prefix="aminn-bench-") as folder:
        program = Path(folder) / "aminn_bench"
        compile_bench(build_dir, program)
        rounds = str(max(1, RUNTIME_CALLS // onnx.n))
        for _ in range(ROUNDS):
            runtime_rounds.append(json.loads(run_program([program, blob, vectors, rounds], "aminn_bench")))
            onnx_times += onnx.times_us(ONNX_CALLS)
    report: dict[str, float | int | str] = {
        f"runtime_{key}": float((max if key.endswith("max") else np.median)([r[key] for r in runtime_rounds]))
        for key in runtime_rounds[0]
    }
    quantiles = {"median": 0.5, "p99": 0.99, "max": 1.0}
    report |= {f"onnx_us_{key}": float(np.quantile(onnx_times, q)) for key, q in quantiles.items()}
    report["onnx_us_mean"] = float(np.mean(onnx_times))
    median = float(report["onnx_us_median"])
    return report | {
        "onnx_to_runtime_ratio": median / float(report["runtime_predict_us_median"]),
        "onnx_to_runtime_both_stages_ratio": median / float(report["runtime_both_stages_us_median"]),
        "samples": onnx.n,
        "onnx_bytes": onnx_bytes,
        "runtime_model_bytes": blob.stat().st_size,
        "onnxruntime_version": ort.__version__,
        "cpu": _cpu(),
        "cpu_cores": os.cpu_count() or 0,
    }


def format_bench(report: dict[str, float | int | str]) -> str:
    """The table that the program prints."""
    rows: list[tuple[str, ...]] = [("microseconds a call", "mean", "median", "p99", "largest")]
    for text, key in (
        ("C runtime, as a controller calls it", "runtime_predict_us"),
        ("C runtime, both stages", "runtime_both_stages_us"),
        ("C runtime, both stages and closure", "runtime_both_stages_and_closure_us"),
        ("ONNX Runtime, one thread", "onnx_us"),
    ):
        rows.append((text, *(f"{report[f'{key}_{q}']:.1f}" for q in ("mean", "median", "p99", "max"))))
    lines = [f"{r[0]:<36}{r[1]:>9}{r[2]:>9}{r[3]:>9}{r[4]:>9}" for r in rows]
    ratio = f"the C runtime is {report['onnx_to_runtime_both_stages_ratio']:.0f} times as fast for the same outputs"
    return "\n".join([*lines, f"{ratio} ({report['cpu']})"])


FOLDER = click.Path(path_type=Path, file_okay=False, exists=True)


@click.command()
@click.option(
    "--model", "model_dir", type=FOLDER, default=Path("tests/golden"), show_default=True, help="Exported model."
)
@click.option(
    "--vectors", type=click.Path(path_type=Path, dir_okay=False, exists=True), help="[default: its golden.bin]"
)
@click.option("--build", "build_dir", type=FOLDER, default=Path("build/host"), show_default=True, help="Built runtime.")
@click.option(
    "--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=Path("build/reports/bench.json")
)
def main(model_dir: Path, vectors: Path | None, build_dir: Path, json_file: Path) -> None:
    """Time the compiled runtime beside ONNX Runtime."""
    try:
        report = bench(model_dir, vectors or model_dir / GOLDEN_FILE, build_dir)
    except (AminnError, OSError) as error:
        raise click.ClickException(str(error)) from error
    json_file.parent.mkdir(parents=True, exist_ok=True)
    write_json(json_file, report)
    click.echo(format_bench(report))
    click.echo(f"figures: {json_file}")


if __name__ == "__main__":
    main()
