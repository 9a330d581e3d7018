"""Times the compiled runtime beside the floor of its own matrix-vector products and beside ONNX Runtime.

python -m aminn_export.judge.bench --model tests/golden --build build/host --json build/reports/bench.json

One thread, one sample per call, the same samples, in turns, in one program (runtime/tools/aminn_bench.cpp): Eigen and
OpenBLAS doing the products alone, the runtime, ONNX Runtime through its C interface on `aminn.onnx`, and ONNX Runtime
on a plain MLP with as many parameters. Where the processor has AVX-512, the products and the runtime are timed once
more as they are with AVX2 alone. Then a batch as a planner asks for it, through aminn_rt and through ONNX Runtime, on
as many threads each, in turns as well: ONNX Runtime on all rows at once, in chunks, with one session per thread, and
one sample per call.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

import aminn_rt
from aminn.prediction.onnx_session import CHUNK, onnx_session, run_onnx
from aminn_base.errors import AminnError
from aminn_base.files import check_outputs, write_json
from aminn_base.program import Messages

from ..files.bin_model import BinModel, read_bin_model
from ..files.hand_header import header_beside
from ..files.layout import widths_of
from ..files.onnx_model import IR_VERSION, ONNX_FILE, OPSET, build_onnx
from ..files.tables import dims_of
from ..replay.runtime_place import RuntimePlace, find_in, find_runtime, source_of
from ..replay.targets import run
from ..samples.golden import GOLDEN_FILE
from ..samples.vectors import read_vectors
from .verify import model_prefix

ROUNDS = 1000
BATCH_ROWS, BATCH_THREADS, BATCH_ROUNDS = 10_000, 2, 9
BATCH_SINGLE = 500  # rows of them one sample per call, which takes long
MLP_OUTPUTS = 7  # p_stable and dx_ht
RATIO_LIMITS = {
    "runtime_to_floor_ratio": ("<=", 1.5),
    "onnx_to_runtime_ratio": (">=", 10.0),
    "mlp_to_runtime_ratio": (">=", 1.0),
    "batch_runtime_to_onnx_ratio": (">=", 10.0),
}
AVX512 = "AVX-512"
AVX2_MARCH = "haswell"  # AVX2 and fused multiply-add, to the compiler and to OpenBLAS
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror"]
Report = dict[str, float | int | str | bool]


def parameters(model: BinModel) -> int:
    """Trained numbers of a model: weights and biases."""
    return sum(v.size for name, v in model.tensors.items() if name.endswith(("_w", "_b")))


def plain_mlp(n_parameters: int, n_in: int) -> onnx.ModelProto:
    """An ONNX model of two hidden layers, `n_in` inputs and 7 outputs, with at most so many parameters."""
    b = n_in + 1 + 1 + MLP_OUTPUTS  # h^2 + b h + 7 parameters
    h = int((-b + np.sqrt(b * b + 4 * (n_parameters - MLP_OUTPUTS))) / 2)
    rng = np.random.default_rng(0)
    sizes = (n_in, h, h, MLP_OUTPUTS)
    nodes, tensors, value = [], [], "x"
    for i, (rows, columns) in enumerate(pairwise(sizes)):
        for name, shape in ((f"w{i}", (rows, columns)), (f"b{i}", (columns,))):
            array = (rng.normal(size=shape) / np.sqrt(rows)).astype(np.float32)
            tensors.append(numpy_helper.from_array(array, name))
        last = i == len(sizes) - 2
        nodes.append(helper.make_node("Gemm", [value, f"w{i}", f"b{i}"], ["y" if last else f"z{i}"]))
        if not last:
            nodes.append(helper.make_node("Relu", [f"z{i}"], [f"h{i}"]))
        value = f"h{i}"
    ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, k]) for n, k in (("x", n_in), ("y", MLP_OUTPUTS))]
    graph = helper.make_graph(nodes, "mlp", ends[:1], ends[1:], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)


def onnxruntime_library() -> Path:
    """The shared library inside the installed package."""
    found = sorted((Path(ort.__file__).parent / "capi").glob("libonnxruntime.so.*"))
    if not found:
        raise AminnError(f"{Path(ort.__file__).parent}: no libonnxruntime.so there; this build of it cannot be timed")
    return found[0]


def compile_bench(model: BinModel, place: RuntimePlace, library: Path, program: Path, march: str) -> None:
    """Compile the timing program for the model's widths and hand, against a built library, its products for `march`."""
    sizes = dict(zip(("HC", "H1", "H2", "HD"), widths_of(model.meta), strict=True))
    sizes["TRUNK"] = model.tensors["s1.trunk1_w"].shape[1]  # contact summary, global input, what networks are told
    include = [*place.flags, f"-I{place.sources}", "-isystem", "/usr/include/eigen3"]
    run(
        ["gcc", "-std=c99", "-O2", *include, "-c", str(place.sources / "host_file.c"), "-o", f"{program}.o"],
        "compiling",
    )
    command = ["g++", "-std=c++17", "-O3", f"-march={march}", *WARNINGS, *include]
    command += [f"-D{name}={size}" for name, size in sizes.items()]
    command += [str(place.sources / "aminn_bench.cpp"), f"{program}.o", str(library)]
    run([*command, "-lopenblas", "-ldl", "-lm", "-o", str(program)], "compiling aminn_bench")


def build_avx2_library(source: Path, hand: Path, folder: Path) -> Path:
    """The library without a choice at run time, compiled for AVX2 and a hand's header; returns the archive."""
    options = [
        "-DCMAKE_BUILD_TYPE=Release",
        "-DAMINN_RT_DISPATCH=OFF",
        "-DAMINN_RT_TOOLS=OFF",
        "-DCMAKE_CXX_FLAGS=-mavx2",
        f"-DAMINN_HAND={hand}",
    ]
    run(["cmake", "-S", str(source), "-B", str(folder), *options], "cmake")
    run(["cmake", "--build", str(folder), "--parallel"], "building the library for AVX2")
    return find_in(folder, "libaminn_rt.a")


def describe_cpu(cpuinfo: str) -> tuple[str, str]:
    """Name, family and model; and the widest vector registers that the runtime uses there, from /proc/cpuinfo's text.

    Processors of one name differ in all that the ratios depend on. Elsewhere than on x86-64 Linux: architecture, "".
    """
    first = cpuinfo.strip().split("\n\n")[0]
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in first.splitlines())}
    if not {"model name", "cpu family", "model", "flags"} <= fields.keys():
        return platform.machine(), ""
    flags = set(fields["flags"].split())
    widest = AVX512 if {"avx512f", "avx512vl"} <= flags else "AVX2" if "avx2" in flags else "SSE2"
    return f"{fields['model name']}, family {fields['cpu family']}, model {fields['model']}", widest


def this_cpu() -> tuple[str, str]:
    cpuinfo = Path("/proc/cpuinfo")
    return describe_cpu(cpuinfo.read_text() if cpuinfo.is_file() else "")


def _onnx_ways(graph: Path, rows: dict[str, NDArray[np.float32]]) -> dict[str, Callable[[], object]]:
    """Each way that ONNX Runtime has to predict all rows on BATCH_THREADS cores; by the last BATCH_SINGLE of them."""
    shared = onnx_session(graph, BATCH_THREADS)
    own = [onnx_session(graph, 1) for _ in range(BATCH_THREADS)]
    names = [o.name for o in shared.get_outputs()]
    pool = ThreadPoolExecutor(BATCH_THREADS)

    def share(i: int, n: int, size: int) -> None:
        begin, end = (k * n // BATCH_THREADS for k in (i, i + 1))
        for first in range(begin, end, size):
            part = slice(first, min(first + size, end))
            own[i].run(names, {name: values[part] for name, values in rows.items()})

    def sessions(n: int, size: int) -> list[None]:
        return list(pool.map(lambda i: share(i, n, size), range(BATCH_THREADS)))

    return {
        "at_once": lambda: shared.run(names, rows),
        "in_chunks": lambda: run_onnx(shared, rows),
        "a_session_a_thread": lambda: sessions(BATCH_ROWS, CHUNK),
        "single_samples": lambda: sessions(BATCH_SINGLE, 1),
    }


def batch(blob: Path, graph: Path, inputs: dict[str, NDArray[np.float32]], rounds: int) -> Report:
    """Predictions a second of many states at once, both stages of all; ONNX Runtime by the fastest of its ways."""
    rows: dict[str, Any] = {name: np.resize(values, (BATCH_ROWS, *values.shape[1:])) for name, values in inputs.items()}
    runtime = aminn_rt.Model.load(blob)
    measured = {name: values for name, values in rows.items() if name not in ("j_x", "j_q")}
    subjects: dict[str, Callable[[], object]] = {
        "runtime": lambda: runtime.predict(**rows, threads=BATCH_THREADS, always=True),
        "runtime_and_closure": lambda: runtime.predict(**measured, threads=BATCH_THREADS, always=True),
        "runtime_one_thread": lambda: runtime.predict(**rows, threads=1, always=True),
    }
    ways = {f"onnx_{name}": way for name, way in _onnx_ways(graph, rows).items()}
    times: dict[str, list[float]] = {name: [] for name in subjects | ways}
    for _ in range(rounds):
        for name, predict in (subjects | ways).items():
            n = BATCH_SINGLE if name == "onnx_single_samples" else BATCH_ROWS
            start = time.perf_counter()
            predict()
            times[name].append((time.perf_counter() - start) / n)
    per_s = {name: 1 / float(np.median(values)) for name, values in times.items()}
    best = max(ways, key=lambda name: per_s[name])
    report: Report = {f"batch_{name}_per_s": value for name, value in per_s.items()}
    report |= {"batch_onnx_per_s": per_s[best], "batch_onnx_best": best.removeprefix("onnx_")}
    # of each round, since other work on the machine comes and goes
    report["batch_runtime_to_onnx_ratio"] = float(np.median(np.divide(times[best], times["runtime"])))
    return report | {"batch_rows": BATCH_ROWS, "batch_threads": BATCH_THREADS}


def bench(model_dir: Path, vectors: Path, build_dir: Path, rounds: int = ROUNDS) -> Report:
    """Times in microseconds a call, and their ratios. Raises AminnError where something is missing."""
    blob = model_dir / f"{model_prefix(model_dir)}.bin"
    model = read_bin_model(blob)
    source, place = source_of(build_dir), find_runtime(build_dir, header_beside(model_dir))
    cpu, registers = this_cpu()
    with tempfile.TemporaryDirectory(prefix="aminn-bench-") as folder:
        program, graph, mlp = (Path(folder) / name for name in ("aminn_bench", "aminn.onnx", "mlp.onnx"))
        file = model_dir / ONNX_FILE
        graph.write_bytes(file.read_bytes() if file.is_file() else build_onnx(model).SerializeToString())
        mlp.write_bytes(plain_mlp(parameters(model), dims_of(model).input).SerializeToString())
        command = [str(program), str(blob), str(vectors), str(rounds), str(onnxruntime_library()), str(graph), str(mlp)]
        compile_bench(model, place, place.library, program, "native")
        report: Report = json.loads(run(command, "aminn_bench"))
        if registers == AVX512:
            library = build_avx2_library(source, place.hand, Path(folder) / "avx2")
            compile_bench(model, place, library, program, AVX2_MARCH)
            avx2 = json.loads(run(["env", f"OPENBLAS_CORETYPE={AVX2_MARCH}", *command], "aminn_bench with AVX2"))
            report["avx2_floor_us"] = avx2[f"{avx2['floor']}_us"]
            report |= {f"avx2_{name}": avx2[name] for name in ("runtime_both_stages_us", "runtime_to_floor_ratio")}
        report["onnx_nodes"] = len(onnx.load(graph).graph.node)
        report |= batch(blob, graph, read_vectors(vectors).inputs, min(rounds, BATCH_ROUNDS))
    missed = [
        name
        for name, (sign, limit) in RATIO_LIMITS.items()
        if not (float(report[name]) <= limit if sign == "<=" else float(report[name]) >= limit)
    ]
    return report | {
        "parameters": parameters(model),
        "runtime_model_bytes": blob.stat().st_size,
        "cpu": cpu,
        "vector_registers": registers,
        "cpu_cores": os.cpu_count() or 0,
        "aims_missed": ", ".join(missed),
    }


ROWS = (
    ("products alone, Eigen, sizes known", "floor_eigen_fixed"),
    ("products alone, Eigen", "floor_eigen_dynamic"),
    ("products alone, OpenBLAS", "floor_openblas"),
    ("products alone, OpenBLAS, transposed", "floor_openblas_transposed"),
    ("runtime, both stages", "runtime_both_stages"),
    ("runtime, as a controller calls it", "runtime_as_called"),
    ("runtime, both stages and closure", "runtime_both_stages_and_closure"),
    ("ONNX Runtime, aminn.onnx", "onnx"),
    ("ONNX Runtime, plain MLP", "onnx_mlp"),
)


def format_bench(report: Report) -> str:
    """The table that the program prints."""
    lines = [f"{'microseconds a call':<40}{'median':>9}{'least':>9}"]
    lines += [f"{text:<40}{report[f'{key}_us']:>9.2f}{report[f'{key}_us_min']:>9.2f}" for text, key in ROWS]
    for name, (sign, limit) in RATIO_LIMITS.items():
        verdict = "missed" if name in str(report["aims_missed"]) else "met"
        lines.append(f"{name} {report[name]:.2f}, aim {sign} {limit:g}: {verdict}")
    if "avx2_runtime_to_floor_ratio" in report:
        lines.append(
            f"with AVX2 alone {report['avx2_runtime_to_floor_ratio']:.2f}: "
            f"runtime {report['avx2_runtime_both_stages_us']:.2f}, products {report['avx2_floor_us']:.2f}"
        )
    lines.append(
        f"a batch of {report['batch_rows']} on {report['batch_threads']} threads: {report['batch_runtime_per_s']:.0f} "
        f"predictions a second, ONNX Runtime {report['batch_onnx_per_s']:.0f} ({report['batch_onnx_best']})"
    )
    return "\n".join([*lines, f"{report['cpu']}, {report['vector_registers']}"])


FOLDER = click.Path(path_type=Path, file_okay=False, exists=True)


@click.command(cls=Messages)
@click.option(
    "--model", "model_dir", type=FOLDER, default=Path("tests/golden"), show_default=True, help="Exported model."
)
@click.option(
    "--vectors", type=click.Path(path_type=Path, dir_okay=False, exists=True), help="[default: its golden.bin]"
)
@click.option("--build", "build_dir", type=FOLDER, default=Path("build/host"), show_default=True, help="Built runtime.")
@click.option("--rounds", default=ROUNDS, show_default=True, help="Rounds, in which all subjects take their turn.")
@click.option(
    "--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=Path("build/reports/bench.json")
)
def main(model_dir: Path, vectors: Path | None, build_dir: Path, rounds: int, json_file: Path) -> None:
    """Time the compiled runtime beside its floor and beside ONNX Runtime."""
    check_outputs([json_file], [model_dir, vectors])
    report = bench(model_dir, vectors or model_dir / GOLDEN_FILE, build_dir, rounds)
    write_json(json_file, report)
    click.echo(format_bench(report))
    click.echo(f"figures: {json_file}")


if __name__ == "__main__":
    main()
