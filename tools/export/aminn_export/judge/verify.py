"""`aminn verify`: replays samples through ONNX Runtime and the compiled runtime, and fails on a difference.

What is compared is what ships: `aminn.onnx`, `aminn_model.bin` in the host's `aminn_replay`, `aminn_model.c` compiled
and linked with `libaminn_rt.a`, and on request the same model in a Cortex-M7 image under qemu. The results are held
against ONNX Runtime's within `tolerances`, and against one another bit by bit, which is what the runtime promises. That
the files of the export are of one model is seen in the files themselves. A float64 evaluation of the model's own tables
says how far each of them is from exact arithmetic.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from aminn.data.dataset import SPLITS, Dataset, load_dataset, split_of
from aminn.evaluation.evaluate import align_columns
from aminn.evaluation.metrics import holds
from aminn.prediction.onnx_session import check_graph, run_onnx
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath
from aminn_base.run import run_program
from aminn_hand.hand import LENGTH_M, OUTPUTS
from aminn_rt.model import model_file

from ..files.bin_model import BinModel, read_bin_model
from ..files.hand_header import header_beside
from ..files.onnx_model import DEBUG_FILE, ONNX_FILE, build_onnx
from ..files.tables import dims_of
from ..replay import serial_protocol, targets
from ..replay.engines import ENGINES, load_engine
from ..replay.runtime_place import REPLAY_SOURCES, RuntimePlace, find_runtime
from ..samples.golden import GOLDEN_FILE, inputs_of, single_thread_session
from ..samples.reference import Reference
from ..samples.vectors import SENSORS, THETA, Results, read_results, read_vectors, write_vectors
from .identity import check_model_hand, misfits
from .verdict import Bins, Failure, Verdict, compare_bits, compare_within, worst_first
from .verdict_report import Case, shown

Array = NDArray[np.float64]
Report = dict[str, float | int | bool | str]

SAMPLES = 1000
"""Of a data set, unless more or fewer are asked for: the test split, and others until there are so many."""
FEW_SAMPLES = 100
SHOWN = 3
"""Numbers of a check that are told."""
BITS_OF = "host_bin"
"""Whose bits the other replays must have."""
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
    """Of K_x with lengths divided by `length` (n)."""
    tau: np.float32
    length: float
    """length_scale, m."""
    bins: Bins


# --- samples --------------------------------------------------------------------------------------------------------
def samples_of_dataset(dataset: Dataset, min_samples: int | None = None, model: BinModel | None = None) -> Samples:
    """The test split first, then validation and training samples until there are `min_samples` (SAMPLES, or all)."""
    split = split_of(dataset.samples["grasp_id"])
    parts = [np.flatnonzero(split == SPLITS.index(name)) for name in ("test", "validation", "train")]
    order = np.concatenate(parts)
    if min_samples is not None and len(order) < min_samples:
        asked = f"the data set has {len(order)} samples, {min_samples} are asked for"
        raise AminnError(f"verify: {asked}; simulate more, or ask for fewer with --samples")
    index = order[: max(min_samples or SAMPLES, len(parts[0]))]
    grasp = dataset.samples["grasp_id"][index]
    return Samples(
        inputs_of(dataset.take(index), model), lambda i: f"grasp {grasp[i]}, sample {index[i]} of the data set"
    )


def load_samples(source: AnyPath, min_samples: int | None = None, model: BinModel | None = None) -> Samples:
    """Samples of a data set (a folder) or of a vector file.

    Raises AminnError where there is none, and where they are of another hand than `model`.
    """
    source = Path(source)
    if source.is_dir():
        dataset = load_dataset(source)
        if model is not None:
            check_model_hand(model, dataset, source)
        samples = samples_of_dataset(dataset, min_samples, model)
    else:
        hand = None if model is None else dims_of(model)
        samples = Samples(read_vectors(source, hand).inputs, lambda i: f"sample {i} of {source.name}")
        if hand is not None and THETA in samples.inputs and not hand.factors:
            raise AminnError(
                f"{source}: has a theta for each sample, which the model is not told; give vectors without"
            )
        if hand is not None and not hand.sensing and any(name in samples.inputs for name in SENSORS):
            raise AminnError(f"{source}: has sensors for each sample, which the model does not see; give others")
    if not len(samples.inputs["q"]):
        raise AminnError(f"{source}: holds no sample: there is nothing to verify")
    return samples


# --- replays --------------------------------------------------------------------------------------------------------
def model_prefix(export_dir: Path) -> str:
    """Symbol prefix of the C model in an export folder: of the header that has a binary model beside it."""
    return model_file(export_dir).stem


def onnx_session(model_dir: Path, prefix: str) -> ort.InferenceSession:
    """The exported ONNX model, or the same graph made from the binary model where only that is kept."""
    file = model_dir / ONNX_FILE
    if file.is_file():
        return single_thread_session(file)
    return single_thread_session(build_onnx(read_bin_model(model_dir / f"{prefix}.bin")).SerializeToString())


def compile_fixed_replay(export_dir: Path, place: RuntimePlace, program: Path) -> None:
    """Compile the exported C model and the replay program into one executable."""
    prefix = model_prefix(export_dir)
    command = [place.compiler, "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror"]
    command += [f'-DAMINN_REPLAY_HEADER="{prefix}.h"', f"-DAMINN_REPLAY_MODEL={prefix}"]
    command += [*place.flags, f"-I{export_dir}", *(str(place.sources / name) for name in REPLAY_SOURCES)]
    command += [str(export_dir / f"{prefix}.c"), str(place.library), "-lm", "-o", str(program)]
    run_program(command, "compiling the C model")


def _replay_bin(export_dir: Path, place: RuntimePlace, vectors: Path, out: Path) -> Report:
    model = export_dir / f"{model_prefix(export_dir)}.bin"
    run_program([place.replay, model, vectors, out], "aminn_replay")
    return {}


def _replay_c(export_dir: Path, place: RuntimePlace, vectors: Path, out: Path) -> Report:
    program = vectors.with_name("replay_c")
    compile_fixed_replay(export_dir, place, program)
    run_program([program, vectors, out], "the compiled model")
    return {}


def _replay_target(name: str, export_dir: Path, vectors: Path, out: Path) -> Report:
    """Build for a target and run there; its own figures (stack, instructions) join the report."""
    results, figures = targets.replay(
        name, export_dir, model_prefix(export_dir), vectors, vectors.with_name(f"on-{name}")
    )
    write_atomically(out, results.read_bytes())
    own: Report = {key: value for key, value in figures.items() if key not in ("samples", "refused")}
    return own


def _replay_board(port: str, model: BinModel, vectors: Path, out: Path) -> Report:
    """Replay on a real board over its serial protocol, if it runs this model."""
    with serial_protocol.open_port(port) as line:
        return dict(serial_protocol.replay(line, model, read_vectors(vectors).inputs, out))


# --- comparison -----------------------------------------------------------------------------------------------------
def scaled_norm(dx: NDArray, length: float = LENGTH_M) -> Array:
    """Size (n), m, of displacements with rotations times `length`, m."""
    return np.linalg.norm(np.asarray(dx, np.float64) * ([1.0] * 3 + [length] * 3), axis=1)


def scaled_condition(k_x: Array, length: float = LENGTH_M) -> Array:
    """Condition number (n) of stiffness matrices with lengths divided by `length`, m."""
    s = np.array([1.0] * 3 + [1 / length] * 3)
    return np.linalg.cond(k_x * s[:, None] * s)


def _largest(values: Array) -> float:
    return float(values.max(initial=0.0))


def _quantile(values: Array, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else 0.0


def dx_figures(dx: NDArray, reference: NDArray, length: float) -> Report:
    """How far displacements (n, 6) are from the reference's: relative to its size, and in m (rotations by `length`)."""
    difference = scaled_norm(np.asarray(dx, np.float64) - np.asarray(reference, np.float64), length)
    relative = difference / np.maximum(scaled_norm(reference, length), 1e-30)
    return {
        "dx_relative_max": _largest(relative),
        "dx_relative_p99": _quantile(relative, 0.99),
        "dx_relative_median": _quantile(relative, 0.5),
        "dx_abs_max_m": _largest(difference),
    }


def compare(target: str, results: Results, exact: Exact, names: Callable[[int], str]) -> Verdict:
    """A replay's results against ONNX Runtime's, with figures on how far they are from float64."""
    verdict = compare_within(results, exact.onnx, float(exact.tau), exact.length, target, names, bins=exact.bins)
    if "dx_relative_max" not in verdict.figures:  # not even of as many samples
        return verdict
    accepted = results.status == 0
    dx = dx_figures(results.outputs["dx_ht"][accepted], exact.onnx["dx_ht"][accepted], exact.length)
    float64 = dx_figures(results.outputs["dx_ht"][accepted], exact.float64["dx_ht"][accepted], exact.length)
    own = {f"float64_{key}": float64[key] for key in ("dx_relative_median", "dx_relative_max")}
    figures = dx | {k: v for k, v in verdict.figures.items() if k != "samples"} | own
    return Verdict(figures, verdict.failures, verdict.judged)


def evaluate_exact(export_dir: Path, model: BinModel, inputs: dict[str, NDArray], engine: str = "onnxruntime") -> Exact:
    """The outputs of the ONNX model in one of `engines.ENGINES`, and the float64 outputs."""
    file = export_dir / ONNX_FILE
    if not file.is_file():
        raise AminnError(f"{export_dir}: no {ONNX_FILE}; is this a folder that `aminn export` wrote?")
    check_graph(single_thread_session(file), dims_of(model), file)
    onnx = load_engine(engine, file)(inputs)
    for name, value in onnx.items():
        if not np.isfinite(value).all():
            raise AminnError(f"{file}: {name} is not finite for some samples; the model or the samples are damaged")
    float64 = Reference(model)(inputs)
    exact = {name: float64[name] for name in OUTPUTS}
    meta, length = model.meta, float(model.meta["length_scale"])
    return Exact(onnx, exact, scaled_condition(exact["k_x"], length), np.float32(meta["tau"]), length, Bins.of(meta))


def _onnx_figures(exact: Exact) -> Report:
    figures = dx_figures(exact.onnx["dx_ht"], exact.float64["dx_ht"], exact.length)
    return {
        "onnx_float64_dx_relative_median": figures["dx_relative_median"],
        "onnx_float64_dx_relative_max": figures["dx_relative_max"],
        "onnx_float64_p_stable_abs_max": _largest(np.abs(exact.onnx["p_stable"] - exact.float64["p_stable"])),
        "k_x_condition_median": float(np.median(exact.condition)),
        "k_x_condition_max": _largest(exact.condition),
        "predicted_stable_share": float(holds(exact.onnx["p_stable"], exact.tau).mean()),
    }


def _as_results(outputs: dict[str, NDArray], tau: float) -> Results:
    """Outputs of anything but the runtime, in the form of its results."""
    single = {name: np.asarray(outputs[name], np.float32) for name in OUTPUTS}
    decision = holds(single["p_stable"], tau).astype(np.float32)
    return Results(single, decision, np.zeros(len(decision), np.int32))


def check_golden(export_dir: Path, model: BinModel) -> list[str]:
    """What is wrong with the golden vectors beside the model, if they are there.

    Their reference is compared with both ONNX models, whose last digits differ on another processor, and their float64
    with a float64 evaluation.
    """
    golden, tau, length = export_dir / GOLDEN_FILE, model.meta["tau"], model.meta["length_scale"]
    if not golden.is_file():
        return []
    vectors = read_vectors(golden, dims_of(model))  # refuses a file whose CRC-32 is wrong
    inputs = vectors.inputs
    sources = {file: run_onnx(single_thread_session(export_dir / file), inputs) for file in (ONNX_FILE, DEBUG_FILE)
               if (export_dir / file).is_file()}  # fmt: skip
    pairs = [(file, _as_results(out, tau), vectors.reference) for file, out in sources.items()]
    if vectors.reference_f64 is not None:
        exact = {name: np.asarray(value, np.float32) for name, value in Reference(model)(inputs).items()}
        pairs.append(("a float64 evaluation", _as_results(vectors.reference_f64, tau), exact))
    lines = []
    for name, results, reference in pairs:
        bins = Bins.of(model.meta)
        failures = compare_within(results, reference, tau, length, symmetric=False, bins=bins).failures
        if failures:
            lines.append(f"{golden.name} is not what {name} gives: {len(failures)} numbers differ; {failures[0]}")
    return lines


# --- the command ----------------------------------------------------------------------------------------------------
ROWS = (
    ("dx_relative_max", "dx_ht, relative, largest", "{:.2e}"),
    ("dx_relative_median", "dx_ht, relative, median", "{:.2e}"),
    ("dx_share_of_limit_max", "dx_ht, share of its limit", "{:.3f}"),
    ("p_stable_share_of_limit_max", "p_stable, share of its limit", "{:.3f}"),
    ("k_x_share_of_limit_max", "k_x, share of its limit", "{:.3f}"),
    ("gate_share_of_limit_max", "gate, share of its limit", "{:.3f}"),
    ("p_slide_share_of_limit_max", "p_slide, share of its limit", "{:.3f}"),
    ("bound_95_share_of_limit_max", "bound_95, share of its limit", "{:.3f}"),
    ("friction_use_share_of_limit_max", "friction_use, share of its limit", "{:.3f}"),
    ("dx_abs_max_m", "dx_ht, m", "{:.2e}"),
    ("p_stable_abs_max", "p_stable", "{:.2e}"),
    ("k_x_relative_max", "k_x, relative", "{:.2e}"),
    ("gate_abs_max", "gate", "{:.2e}"),
    ("decisions_different", "other decisions", "{:d}"),
    ("refused", "refused", "{:d}"),
    ("instructions_worst", "instructions, worst", "{:d}"),
    ("different_words", "words that differ from host, .bin", "{:d}"),
    ("stack_predict_bytes", "stack of a prediction, bytes", "{:d}"),
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


@dataclass(frozen=True)
class Verification:
    """What was found."""

    report: Report
    """Flat figures; "ok" tells whether everything held, "failures" says in short what did not."""
    failures: list[Failure]
    """Every number that differs, worst first."""
    cases: list[Case]
    """What was checked, with what is wrong."""


def _cases(target: str, verdict: Verdict, what: str) -> list[Case]:
    """A test case an output."""
    return [
        Case(title(target), f"{kind}, {what}", [f for f in verdict.failures if f.kind == kind])
        for kind in dict.fromkeys((*verdict.judged, *(f.kind for f in verdict.failures)))
    ]


def run_verification(
    export_dir: AnyPath,
    source: AnyPath,
    build_dir: AnyPath | None = None,
    min_samples: int | None = None,
    on_targets: tuple[str, ...] = (),
    port: str | None = None,
    engine: str = "onnxruntime",
) -> Verification:
    """Replay `source` (data set folder or vector file) through the models of `export_dir`.

    `build_dir` is a build folder of the runtime, or the prefix that it is installed with; None: `own_build()` of
    runtime_place. `on_targets` are names of
    `targets.TARGETS` to replay on as well, `port` is the serial port (or socket) of a board that runs the
    firmware's serial protocol; `engine` of engines.ENGINES evaluates the ONNX model.
    Raises AminnError where something cannot be run at all.
    """
    export_dir, source = Path(export_dir), Path(source)
    prefix = model_prefix(export_dir)
    model = read_bin_model(export_dir / f"{prefix}.bin")
    place = find_runtime(Path(build_dir) if build_dir else None, header_beside(export_dir))
    samples = load_samples(source, min_samples, model)
    exact = evaluate_exact(export_dir, model, samples.inputs, engine)
    report: Report = {"samples": len(samples.inputs["q"])} | _onnx_figures(exact)
    replays: dict[str, Callable[[Path, Path], Report]] = {
        "host_bin": lambda vectors, out: _replay_bin(export_dir, place, vectors, out),
        "host_c": lambda vectors, out: _replay_c(export_dir, place, vectors, out),
    }
    replays |= {name: partial(_replay_target, name, export_dir) for name in dict.fromkeys(on_targets)}
    if port is not None:
        replays["board"] = partial(_replay_board, port, model)
    cases = [
        Case("files", "one model in all files", misfits(export_dir, prefix, model)),
        Case("files", "golden vectors", check_golden(export_dir, model)),
    ]
    failures: list[Failure] = []
    results: dict[str, Results] = {}
    with tempfile.TemporaryDirectory(prefix="aminn-verify-") as folder:
        vectors = Path(folder) / "vectors.bin"
        write_vectors(vectors, samples.inputs, exact.onnx)
        for target, replay in replays.items():
            out = Path(folder) / f"{target}.bin"
            own_figures = replay(vectors, out)
            results[target] = read_results(out)
            verdict = compare(target, results[target], exact, samples.names)
            cases += _cases(target, verdict, f"against {ENGINES[engine]}")
            failures += verdict.failures
            figures = verdict.figures | own_figures
            if target != BITS_OF:
                bits = compare_bits(results[target], results[BITS_OF], target, samples.names)
                cases += _cases(target, bits, f"bits of {title(BITS_OF)}")
                failures += bits.failures
                figures["different_words"] = bits.figures.get("different_words", -1)
            report |= {f"{target}_{key}": value for key, value in figures.items()}
    wrong = [f"{case.group}: {line}" for case in cases for line in shown(case.failures, SHOWN)]
    report |= {"ok": not wrong, "failures": "; ".join(wrong), "numbers_different": len(failures)}
    return Verification(report, worst_first(failures), cases)


def tell(done: Verification, echo: Callable[[str], object] = click.echo, show: int = SHOWN) -> None:
    """The table, and of each check that fails the `show` worst numbers."""
    n = int(done.report["samples"])
    if n < FEW_SAMPLES:
        echo(f"warning: {n} samples alone; a fault that few states show may stay unseen")
    echo(f"{n} samples, {done.report['predicted_stable_share']:.1%} predicted stable")
    echo(format_report(done.report))
    for case in done.cases:
        for line in shown(case.failures, show):
            echo(f"{case.group}: {line}")


def verify(
    export_dir: AnyPath,
    source: AnyPath,
    build_dir: AnyPath | None = None,
    min_samples: int | None = None,
    on_targets: tuple[str, ...] = (),
    port: str | None = None,
    echo: Callable[[str], object] = click.echo,
) -> Report:
    """`run_verification`, told with `echo`; returns the flat figures alone."""
    done = run_verification(export_dir, source, build_dir, min_samples, on_targets, port)
    tell(done, echo)
    return done.report
