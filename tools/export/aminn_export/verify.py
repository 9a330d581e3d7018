"""`aminn verify`: replays samples through ONNX Runtime and the compiled runtime, and fails on a difference.

What is compared is what ships: `aminn.onnx`, `aminn_model.bin` in the host's `aminn_replay`, `aminn_model.c` compiled
and linked with `libaminn_rt.a`, and on request the same model in a Cortex-M7 image under qemu. A float64 evaluation of
the model's own tables says how far each of them is from exact arithmetic.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from aminn.dataset import SPLITS, Dataset, load_dataset, split_of
from aminn.dims import INPUT_SHAPES, OUTPUT_SHAPES
from aminn.dims import LENGTH_SCALE_M as LENGTH_M
from aminn.evaluate import align_columns
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically

from . import serial_protocol, targets
from .bin_model import BinModel, read_bin_model
from .golden import GOLDEN_FILE, inputs_of, run_onnx, single_thread_session
from .onnx_model import DEBUG_FILE, ONNX_FILE, build_onnx
from .reference import Reference
from .vectors import Results, read_results, read_vectors, write_vectors

Array = NDArray[np.float64]
Report = dict[str, float | int | bool | str]

# What a displacement may differ by: a share of its own norm, which grows with the conditioning of K_x, and a floor.
RELATIVE_LIMIT, CONDITION_LIMIT, FLOOR_M = 1e-4, 1e-7, 1e-9
MEDIAN_LIMIT = 2e-6
P_STABLE_LIMIT = 1e-5
# Not what the model is for, but a wrong one must not pass: the gates, and K_x relative to its largest entry.
GATE_LIMIT, K_X_LIMIT = 1e-2, 1e-3
# Golden vectors against the model beside them, relative to an output's largest entry: rounding of another processor.
GOLDEN_LIMIT = 1e-5
TITLES = {
    "host_bin": "host, .bin",
    "host_c": "host, .c",
    "cortex_m4": "Cortex-M4F",
    "cortex_m7": "Cortex-M7",
    "cortex_m33": "Cortex-M33",
}


def title(target: str) -> str:
    """What tables and messages call a target."""
    return TITLES.get(target, target)


@dataclass(frozen=True)
class Samples:
    """What is replayed, and what messages call it."""

    inputs: dict[str, NDArray[np.float32]]
    names: Callable[[int], str]


@dataclass(frozen=True)
class Exact:
    """ONNX Runtime's outputs, the float64 outputs, and what follows from them."""

    onnx: dict[str, NDArray[np.float32]]
    float64: dict[str, Array]
    condition: Array
    """Of K_x with lengths divided by 0.1 m (n)."""
    tau: np.float32


# --- samples --------------------------------------------------------------------------------------------------------
def samples_of_dataset(dataset: Dataset, min_samples: int) -> Samples:
    """The test split first, then validation and training samples until there are `min_samples`."""
    split = split_of(dataset.samples["grasp_id"])
    parts = [np.flatnonzero(split == SPLITS.index(name)) for name in ("test", "validation", "train")]
    order = np.concatenate(parts)
    if len(order) < min_samples:
        asked = f"the data set has {len(order)} samples, {min_samples} are asked for"
        raise AminnError(f"verify: {asked}; simulate more, or ask for fewer with --samples")
    index = order[: max(min_samples, len(parts[0]))]
    grasp = dataset.samples["grasp_id"][index]
    return Samples(inputs_of(dataset.take(index)), lambda i: f"grasp {grasp[i]}, sample {index[i]} of the data set")


def load_samples(source: Path, min_samples: int) -> Samples:
    """Samples of a data set (a folder) or of a vector file."""
    if source.is_dir():
        return samples_of_dataset(load_dataset(source), min_samples)
    return Samples(read_vectors(source).inputs, lambda i: f"sample {i} of {source.name}")


# --- replays --------------------------------------------------------------------------------------------------------
def run_program(command: Sequence[str | Path], what: str) -> str:
    """Output of a program. Raises AminnError with what it said if it failed."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise AminnError(f"{what} failed with exit code {done.returncode}: {(done.stderr or done.stdout).strip()}")
    return done.stdout


def find_in(build_dir: Path, name: str) -> Path:
    """The file of this name below a build folder."""
    found = sorted(build_dir.rglob(name))
    if not found:
        raise AminnError(f"{build_dir}: no {name} there; build the C runtime first (`make` targets do)")
    return found[0]


def cmake_cache(build_dir: Path) -> dict[str, str]:
    """The variables of a CMake build folder."""
    file = build_dir / "CMakeCache.txt"
    if not file.is_file():
        raise AminnError(f"{build_dir}: no CMakeCache.txt; this is not a build folder of the C runtime")
    return dict(re.findall(r"^(\w+):\w+=(.*)$", file.read_text(), re.MULTILINE))


def runtime_source(build_dir: Path) -> Path:
    """The runtime's source folder, from the build folder of the tree or of the runtime alone."""
    home = Path(cmake_cache(build_dir)["CMAKE_HOME_DIRECTORY"])
    for folder in (home / "runtime", home):
        if (folder / "include" / "aminn_rt.h").is_file():
            return folder
    raise AminnError(f"{build_dir}: its source folder {home} has no runtime/include/aminn_rt.h")


def model_prefix(export_dir: Path) -> str:
    """Symbol prefix of the C model in an export folder: of the header that has a binary model beside it."""
    names = [h.stem for h in sorted(export_dir.glob("*.h")) if h.with_suffix(".bin").is_file()]
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise AminnError(f"{export_dir}: one C model with its .bin expected (`aminn export` writes it); found: {found}")
    return names[0]


def onnx_session(model_dir: Path, prefix: str) -> ort.InferenceSession:
    """The exported ONNX model, or the same graph made from the binary model where only that is kept."""
    file = model_dir / ONNX_FILE
    if file.is_file():
        return single_thread_session(file)
    return single_thread_session(build_onnx(read_bin_model(model_dir / f"{prefix}.bin")).SerializeToString())


def compile_fixed_replay(export_dir: Path, build_dir: Path, program: Path) -> None:
    """Compile the exported C model and the replay program into one executable."""
    source, prefix = runtime_source(build_dir), model_prefix(export_dir)
    compiler = cmake_cache(build_dir).get("CMAKE_C_COMPILER", "cc")
    command = [compiler, "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror"]
    command += [f'-DAMINN_REPLAY_HEADER="{prefix}.h"', f"-DAMINN_REPLAY_MODEL={prefix}"]
    command += [f"-I{source / 'include'}", f"-I{export_dir}"]
    command += [str(source / "tools" / name) for name in ("aminn_replay.c", "host_file.c")]
    command += [str(export_dir / f"{prefix}.c"), str(find_in(build_dir, "libaminn_rt.a")), "-lm", "-o", str(program)]
    run_program(command, "compiling the C model")


def _replay_bin(export_dir: Path, build_dir: Path, vectors: Path, out: Path) -> Report:
    model = export_dir / f"{model_prefix(export_dir)}.bin"
    run_program([find_in(build_dir, "aminn_replay"), model, vectors, out], "aminn_replay")
    return {}


def _replay_c(export_dir: Path, build_dir: Path, vectors: Path, out: Path) -> Report:
    program = vectors.with_name("replay_c")
    compile_fixed_replay(export_dir, build_dir, program)
    run_program([program, vectors, out], "the compiled model")
    return {}


def _replay_target(name: str, export_dir: Path, vectors: Path, out: Path) -> Report:
    """Build for a target and run there; its own figures (stack, instructions) join the report."""
    results, figures = targets.replay(
        name, export_dir, model_prefix(export_dir), vectors, vectors.with_name(f"on-{name}")
    )
    write_atomically(out, results.read_bytes())
    return {key: value for key, value in figures.items() if key not in ("samples", "refused")}


def _replay_board(port: str, vectors: Path, out: Path) -> Report:
    """Replay on a real board over its serial protocol."""
    with serial_protocol.open_port(port) as stream:
        return serial_protocol.replay(stream, read_vectors(vectors).inputs, out)


# --- comparison -----------------------------------------------------------------------------------------------------
def scaled_norm(dx: NDArray) -> Array:
    """Size (n), m, of displacements with rotations times 0.1 m."""
    return np.linalg.norm(np.asarray(dx, np.float64) * ([1.0] * 3 + [LENGTH_M] * 3), axis=1)


def scaled_condition(k_x: Array) -> Array:
    """Condition number (n) of stiffness matrices with lengths divided by 0.1 m."""
    s = np.array([1.0] * 3 + [1 / LENGTH_M] * 3)
    return np.linalg.cond(k_x * s[:, None] * s)


def limits(dx: NDArray, condition: Array) -> Array:
    """How far (m) each displacement may be from dx (n, 6)."""
    return np.maximum(RELATIVE_LIMIT, CONDITION_LIMIT * condition) * scaled_norm(dx) + FLOOR_M


def _relative(values: NDArray, reference: NDArray) -> Array:
    """Largest difference over the reference's largest entry, sample by sample."""
    n = len(values)
    a, b = (np.asarray(v, np.float64).reshape(n, -1) for v in (values, reference))
    return np.abs(a - b).max(1) / np.abs(b).max(1)


def _largest(values: Array) -> float:
    return float(values.max(initial=0.0))


def _quantile(values: Array, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else 0.0


def dx_figures(dx: NDArray, reference: NDArray) -> Report:
    """How far displacements (n, 6) are from the reference's: relative to its size, and in m."""
    difference = scaled_norm(np.asarray(dx, np.float64) - np.asarray(reference, np.float64))
    relative = difference / np.maximum(scaled_norm(reference), 1e-30)
    return {
        "dx_relative_max": _largest(relative),
        "dx_relative_p99": _quantile(relative, 0.99),
        "dx_relative_median": _quantile(relative, 0.5),
        "dx_abs_max_m": _largest(difference),
    }


def differences(results: Results, exact: Exact) -> dict[str, Array]:
    """Difference of each output from ONNX Runtime's, sample by sample (n); NaN where the runtime refused."""
    out, onnx = results.outputs, exact.onnx
    dx = np.asarray(out["dx_ht"], np.float64) - onnx["dx_ht"]
    return {
        "dx_ht": scaled_norm(dx),
        "p_stable": np.abs(out["p_stable"].astype(np.float64) - onnx["p_stable"]),
        "stable": (results.stable != (onnx["p_stable"] >= exact.tau)).astype(float),
        "k_x": _relative(out["k_x"], onnx["k_x"]),
        "gate": np.abs(out["gate"].astype(np.float64) - onnx["gate"]).max(1),
    }


def compare(results: Results, exact: Exact) -> tuple[Report, dict[str, Array]]:
    """Figures over the samples that a replay accepted, and each output's share of its limit (n): above 1 fails."""
    accepted = results.status == 0
    d = differences(results, exact)
    limit: dict[str, Array | float] = {
        "dx_ht": limits(exact.onnx["dx_ht"], exact.condition),
        "p_stable": P_STABLE_LIMIT,
        "stable": 0.5,
        "k_x": K_X_LIMIT,
        "gate": GATE_LIMIT,
    }
    shares = {name: np.where(accepted, value / limit[name], 0.0) for name, value in d.items()}
    shares["refused"] = np.where(accepted, 0.0, 2.0)
    dx = results.outputs["dx_ht"][accepted]
    float64 = dx_figures(dx, exact.float64["dx_ht"][accepted])
    figures = dx_figures(dx, exact.onnx["dx_ht"][accepted]) | {
        "dx_share_of_limit_max": _largest(shares["dx_ht"]),
        "p_stable_abs_max": _largest(d["p_stable"][accepted]),
        "decisions_different": int(d["stable"][accepted].sum()),
        "k_x_relative_max": _largest(d["k_x"][accepted]),
        "gate_abs_max": _largest(d["gate"][accepted]),
        "float64_dx_relative_median": float64["dx_relative_median"],
        "float64_dx_relative_max": float64["dx_relative_max"],
        "refused": int((~accepted).sum()),
    }
    return figures, shares


def failures(target: str, figures: Report, shares: dict[str, Array], samples: Samples) -> list[str]:
    """A line for each criterion that is not met, with the worst sample."""
    lines = []
    for output, share in shares.items():
        bad = ~(share <= 1)  # NaN fails too
        if bad.any():
            worst = int(np.argmax(np.where(np.isnan(share), np.inf, share)))
            what = {"refused": "refused by the runtime", "stable": "another decision"}.get(
                output, f"{share[worst]:.3g} times its limit"
            )
            lines.append(f"{target}: {output}: {int(bad.sum())} samples differ; worst: {samples.names(worst)}: {what}")
    median = float(figures["dx_relative_median"])
    if not median < MEDIAN_LIMIT:
        lines.append(f"{target}: dx_ht: median relative difference {median:.3g}, the limit is {MEDIAN_LIMIT:g}")
    return lines


def evaluate_exact(export_dir: Path, model: BinModel, inputs: dict[str, NDArray]) -> Exact:
    """ONNX Runtime's and the float64 outputs."""
    file = export_dir / ONNX_FILE
    if not file.is_file():
        raise AminnError(f"{export_dir}: no {ONNX_FILE}; is this a folder that `aminn export` wrote?")
    onnx = run_onnx(single_thread_session(file), inputs)
    for name, value in onnx.items():
        if not np.isfinite(value).all():
            raise AminnError(f"{file}: {name} is not finite for some samples; the model or the samples are damaged")
    float64 = Reference(model)(inputs)
    exact = {name: float64[name] for name in OUTPUT_SHAPES}
    return Exact(onnx, exact, scaled_condition(exact["k_x"]), np.float32(model.meta["tau"]))


def _onnx_figures(exact: Exact) -> Report:
    figures = dx_figures(exact.onnx["dx_ht"], exact.float64["dx_ht"])
    return {
        "onnx_float64_dx_relative_median": figures["dx_relative_median"],
        "onnx_float64_dx_relative_max": figures["dx_relative_max"],
        "onnx_float64_p_stable_abs_max": _largest(np.abs(exact.onnx["p_stable"] - exact.float64["p_stable"])),
        "k_x_condition_median": float(np.median(exact.condition)),
        "k_x_condition_max": _largest(exact.condition),
        "predicted_stable_share": float((exact.onnx["p_stable"] >= exact.tau).mean()),
    }


def check_files(export_dir: Path) -> list[str]:
    """What is wrong with the golden vectors and the debug model beside the model, if they are there."""
    golden, debug = export_dir / GOLDEN_FILE, export_dir / DEBUG_FILE
    if not golden.is_file():
        return []
    vectors = read_vectors(golden)  # refuses a file whose CRC-32 is wrong
    inputs = {name: vectors.inputs[name] for name in INPUT_SHAPES}
    wrong = []
    for file in (export_dir / ONNX_FILE, debug):
        out = run_onnx(single_thread_session(file), inputs) if file.is_file() else vectors.reference
        for name, reference in vectors.reference.items():
            if not np.abs(out[name] - reference).max() <= GOLDEN_LIMIT * np.abs(reference).max():
                wrong.append(f"{file.name}: {name} is not what {golden.name} holds")
    return wrong


# --- the command ----------------------------------------------------------------------------------------------------
ROWS = (
    ("dx_relative_max", "dx_ht, relative, largest", "{:.2e}"),
    ("dx_relative_median", "dx_ht, relative, median", "{:.2e}"),
    ("dx_share_of_limit_max", "dx_ht, share of its limit", "{:.3f}"),
    ("dx_abs_max_m", "dx_ht, m", "{:.2e}"),
    ("p_stable_abs_max", "p_stable", "{:.2e}"),
    ("k_x_relative_max", "k_x, relative", "{:.2e}"),
    ("gate_abs_max", "gate", "{:.2e}"),
    ("decisions_different", "other decisions", "{:d}"),
    ("refused", "refused", "{:d}"),
    ("instructions_worst", "instructions, worst", "{:d}"),
    ("stack_high_water_bytes", "stack, bytes", "{:d}"),
    ("float64_dx_relative_median", "dx_ht against float64, median", "{:.2e}"),
    ("float64_dx_relative_max", "dx_ht against float64, largest", "{:.2e}"),
)


def format_report(report: Report) -> str:
    """The table that the command prints."""
    found = [
        k.removesuffix("_dx_relative_max") for k in report if k.endswith("_dx_relative_max") and "float64" not in k
    ]
    targets = [*found, "onnx"]
    rows = [["largest differences from ONNX Runtime", *(title(t) for t in found), "ONNX itself"]]
    for key, text, form in ROWS:
        values = [report.get(f"{t}_{key}") for t in targets]
        if any(v is not None for v in values):
            rows.append([text, *("-" if v is None else form.format(v) for v in values)])
    return "\n".join(align_columns(rows))


def verify(
    export_dir: Path,
    source: Path,
    build_dir: Path,
    min_samples: int = 1000,
    on_targets: tuple[str, ...] = (),
    port: str | None = None,
    echo: Callable[[str], object] = click.echo,
) -> Report:
    """Replay `source` (data set folder or vector file) through the models of `export_dir`; returns flat figures.

    `build_dir` holds the compiled runtime; `on_targets` are names of `targets.TARGETS` to replay on as well, `port` is
    the serial port (or socket or pipe) of a board that runs the firmware's serial protocol. "ok" tells whether every
    sample met every criterion; "failures" says which did not. Raises AminnError where something cannot be run at all.
    """
    model = read_bin_model(export_dir / f"{model_prefix(export_dir)}.bin")
    samples = load_samples(source, min_samples)
    exact = evaluate_exact(export_dir, model, samples.inputs)
    report: Report = {"samples": len(samples.inputs["q"])} | _onnx_figures(exact)
    replays: dict[str, Callable[[Path, Path], Report]] = {
        "host_bin": lambda vectors, out: _replay_bin(export_dir, build_dir, vectors, out),
        "host_c": lambda vectors, out: _replay_c(export_dir, build_dir, vectors, out),
    }
    replays |= {name: partial(_replay_target, name, export_dir) for name in dict.fromkeys(on_targets)}
    if port is not None:
        replays["board"] = partial(_replay_board, port)
    wrong = check_files(export_dir)
    with tempfile.TemporaryDirectory(prefix="aminn-verify-") as folder:
        vectors = Path(folder) / "vectors.bin"
        write_vectors(vectors, {name: samples.inputs[name] for name in INPUT_SHAPES}, exact.onnx)
        for target, replay in replays.items():
            out = Path(folder) / f"{target}.bin"
            own_figures = replay(vectors, out)
            figures, shares = compare(read_results(out), exact)
            figures |= own_figures
            report |= {f"{target}_{key}": value for key, value in figures.items()}
            wrong += failures(title(target), figures, shares, samples)
    report |= {"ok": not wrong, "failures": "; ".join(wrong)}
    echo(f"{report['samples']} samples, {report['predicted_stable_share']:.1%} predicted stable")
    echo(format_report(report))
    for line in wrong:
        echo(line)
    return report
