"""What a prediction costs, beside an earlier build of the same project and in turns with it.

python -m aminn_export.judge.cost --json build/reports/cost.json

The earlier commit is checked out in a work tree of its own and compiled with its own reference model. Beside it stand
today's reference model, and the same without what makes contacts slide and without sensors: the layer that the earlier
one has. Of each: instructions on a Cortex-M7 (qemu), flash, context and worst stack; time on this machine for each
instruction set. Figures of one kind have names `<subject>_<figure>`, ratios `<subject>_<figure>_ratio`.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from aminn_base.files import check_outputs, write_atomically, write_json
from aminn_base.program import Messages
from aminn_base.run import run_program

from ..files.bin_model import BinModel, bin_model_bytes, read_bin_model, write_bin_model
from ..files.c_model import write_c_model
from ..files.hand_header import header_beside, write_hand_header
from ..files.layout import WEIGHT_CODES, tensor_name, tensor_order, widths_of
from ..files.tables import dims_of
from ..replay.firmware import build_firmware, run_firmware
from ..replay.runtime_place import find_in
from ..samples.golden import GOLDEN_FILE
from ..samples.vectors import read_vectors, write_vectors
from .bench import AVX512, Report, this_cpu
from .verify import model_prefix
from .weights import ROUNDED

BASE = "d0beb27"
ROOT = Path(__file__).resolve().parents[4]
RUNTIME_FLAGS = {"avx512": None, "avx2": "-mavx2", "sse2": ""}
"""Compiler options for each instruction set; None: what the library chooses on a processor that has it."""
TURNS, ROUNDS = 9, 400
LIMITS = {
    "stuck_instructions_ratio": 0.55,
    "stuck_avx512_us_ratio": 0.6,
    "stuck_avx2_us_ratio": 0.55,
    "sliding_to_stuck_instructions": 1.3,
    "sliding_context_and_stack_bytes": 5000,
    "stuck_fitted_context_and_stack_bytes": 5000,
    **{
        f"{subject}_model_{weights}_bytes": size
        for subject in ("stuck", "sliding")
        for weights, size in (("float32", 40_000), ("float16", 22_000), ("int8", 14_000))
    },
    "labels_wall_to_system": 0.62,
    "step_ratio": 2.0,
    "runtime_to_compiler_ratio": 0.1,
}
"""At most."""
LEAST = {"batch_runtime_to_onnx_ratio": 10.0}
"""At least."""
OF_OTHERS = {
    "labels.json": {"labels_wall_to_system": "labels_wall_to_system"},
    "step.json": {"ratio": "step_ratio", "paper_layer_ratio": "step_paper_layer_ratio"},
    "bench.json": {name: name for name in ("batch_runtime_to_onnx_ratio", "runtime_to_floor_ratio")},
    "compilers.json": {"runtime_to_compiler_ratio": "runtime_to_compiler_ratio"},
}
"""Figures of other reports (`make labels step bench`) that belong here, and what they are called here."""


@dataclass(frozen=True)
class Subject:
    """A library and the model that it is timed with."""

    name: str
    tree: Path
    """A checkout of the project."""
    model_dir: Path
    """The model's C source, its binary form, its hand's header where it is not the built-in one."""
    vectors: Path

    @property
    def hand(self) -> Path:
        """`aminn_hand.h` to compile for."""
        return header_beside(self.model_dir) or self.tree / "runtime" / "include" / "aminn_hand.h"


@contextmanager
def work_tree(commit: str, folder: Path) -> Iterator[Path]:
    """A checkout of a commit, gone in the end."""
    git = ["git", "-C", str(ROOT), "worktree"]
    run_program([*git, "add", "--force", "--detach", folder, commit], f"checking out {commit}", packages="git")
    try:
        yield folder
    finally:
        run_program([*git, "remove", "--force", folder], "removing the work tree")


def stuck_model(model: BinModel) -> BinModel:
    """A model of the same widths without sliding contacts and sensors; its numbers mean nothing, its cost does."""
    plain = BinModel(model.meta | {"slides": False, "sensing": False, "known_state": None}, dict(model.tensors))
    plain.meta.pop("known_state")
    dims = dims_of(plain)
    for owner, field, shape in tensor_order(dims, widths_of(model.meta)):
        name = tensor_name(owner, field)
        if name in plain.tensors:
            cut = tuple(slice(0, n) for n in shape)
            plain.tensors[name] = np.ascontiguousarray(plain.tensors[name][cut])
    return plain


def subjects(base: Path, model_dir: Path, folder: Path) -> list[Subject]:
    """The earlier build, today's, and today's of contacts that do not slide, whose model is written to `folder`."""
    vectors, prefix = model_dir / GOLDEN_FILE, model_prefix(model_dir)
    found = read_vectors(vectors)
    plain, bare = stuck_model(read_bin_model(model_dir / f"{prefix}.bin")), folder / "bare.bin"
    dims = dims_of(plain)
    write_vectors(bare, {name: found.inputs[name] for name in dims.inputs}, found.reference)
    stuck = folder / "stuck_model"
    stuck.mkdir()
    write_c_model(plain, stuck)
    write_bin_model(plain, stuck / "aminn_model.bin")
    write_hand_header(plain, stuck)
    golden = base / "tests" / "golden"
    return [
        Subject("base", base, golden, golden / GOLDEN_FILE),
        Subject("sliding", ROOT, model_dir, vectors),
        Subject("stuck", ROOT, stuck, bare),
    ]


def on_cortex_m7(subject: Subject, work: Path) -> Report:
    """Instructions, flash and memory, as size_report.py of the subject's own tree has them."""
    build, report, out = work / f"{subject.name}_m7", work / f"{subject.name}_run.json", work / f"{subject.name}.json"
    image = build_firmware(subject.model_dir, build, source=subject.tree / "runtime" / "firmware")
    write_json(report, dict(run_firmware(image, subject.vectors, work / "results.bin")))
    source = subject.model_dir / f"{model_prefix(subject.model_dir)}.c"
    command: list[str | Path] = [
        sys.executable,
        subject.tree / "runtime/tools/size_report.py",
        "--out",
        out,
        "--model",
        source,
    ]
    run_program([*command, f"m7={build}:{report}"], "size_report")
    size = json.loads(out.read_text())
    names = {
        "instructions_per_prediction": "instructions",
        "library_text_bytes": "text_bytes",
        "context_bytes": "context_bytes",
        "stack_worst_bytes": "stack_bytes",
        "multiply_accumulates": "multiply_accumulates",
        "model_flash_bytes": "model_flash_bytes",
    }
    figures = {f"{subject.name}_{short}": size[f"m7_{name}"] for name, short in names.items()}
    memory = size["m7_context_bytes"] + size["m7_stack_worst_bytes"]
    return figures | {f"{subject.name}_context_and_stack_bytes": memory}


def timed_program(subject: Subject, isa: str, work: Path) -> Path:
    """aminn_time with the subject's model, and its library for an instruction set."""
    build, flags = work / f"{subject.name}_{isa}", RUNTIME_FLAGS[isa]
    configure: list[str | Path] = ["cmake", "-S", subject.tree / "runtime", "-B", build, "-DCMAKE_BUILD_TYPE=Release"]
    configure += ["-DAMINN_RT_TOOLS=OFF", f"-DAMINN_HAND={subject.hand}"]
    if flags is not None:
        configure += ["-DAMINN_RT_DISPATCH=OFF", f"-DCMAKE_CXX_FLAGS={flags}"]
    run_program(configure, "cmake")
    run_program(["cmake", "--build", build, "--parallel"], f"building the library for {isa}")
    prefix, program = model_prefix(subject.model_dir), build / "aminn_time"
    command = ["gcc", "-std=gnu99", "-O2", f'-DMODEL_HEADER="{prefix}.h"', f"-DMODEL_SYMBOL={prefix}"]
    command += [f"-I{subject.tree / 'runtime' / 'include'}", f"-I{subject.model_dir}"]
    command += [f'-DAMINN_HAND_HEADER="{subject.hand}"', str(ROOT / "runtime/tools/aminn_time.c")]
    command += [str(subject.model_dir / f"{prefix}.c"), str(find_in(build, "libaminn_rt.a")), "-lm", "-o", str(program)]
    run_program(command, "compiling aminn_time")
    return program


def write_states(subject: Subject, file: Path) -> None:
    """The states of the subject's vectors as `aminn_time` reads them."""
    inputs = read_vectors(subject.vectors).inputs
    numbers = [inputs[name].reshape(len(inputs["q"]), -1) for name in dims_of(_model(subject)).inputs]
    write_atomically(file, np.concatenate(numbers, axis=1).astype("<f4").tobytes())


def time_of(program: Path, states: Path) -> float:
    """Median time of a prediction, microseconds."""
    return float(run_program([program, states, str(ROUNDS)], "aminn_time"))


def on_this_machine(found: list[Subject], isa: str, work: Path, turns: int) -> Report:
    """Median time of a prediction, microseconds, of each subject; the programs run in turns."""
    states = work / "states.bin"
    write_states(found[1], states)
    programs = {subject.name: timed_program(subject, isa, work) for subject in found}
    times: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(turns):
        for name, program in programs.items():
            times[name].append(time_of(program, states))
    return {f"{name}_{isa}_us": statistics.median(values) for name, values in times.items()}


def _model(subject: Subject) -> BinModel:
    return read_bin_model(subject.model_dir / f"{model_prefix(subject.model_dir)}.bin")


def _sections(source: Path, subject: Subject, work: Path, *options: str) -> tuple[int, int, int]:
    """Bytes of text, data and zeros of a C source compiled for a Cortex-M7."""
    command: list[str | Path] = ["arm-none-eabi-gcc", "-std=c99", "-Os", "-mcpu=cortex-m7", "-mthumb", *options]
    command += [f"-I{work}", f"-I{subject.tree / 'runtime' / 'include'}", f'-DAMINN_HAND_HEADER="{subject.hand}"']
    run_program([*command, "-c", source, "-o", source.with_suffix(".o")], "compiling for a Cortex-M7")
    text, data, zeros = run_program(["arm-none-eabi-size", source.with_suffix(".o")], "arm-none-eabi-size").split()[
        -6:-3
    ]
    return int(text), int(data), int(zeros)


def fitted_context(subject: Subject, stack_bytes: int, work: Path) -> Report:
    """Bytes of the context with the subject's widest layer for AMINN_MAX_WIDTH, and with the worst stack."""
    source = work / f"{subject.name}_context.c"
    write_atomically(source, b'#include "aminn_rt.h"\naminn_t ctx = {0};\n')
    widest = max(widths_of(_model(subject).meta))
    context = _sections(source, subject, work, f"-DAMINN_MAX_WIDTH={widest}")[2]
    sizes = {"fitted_context_bytes": context, "fitted_context_and_stack_bytes": context + stack_bytes}
    return {f"{subject.name}_{name}": size for name, size in sizes.items()}


def flash(subject: Subject, work: Path) -> Report:
    """Bytes of the subject's model in each way that weights are stored: linked as C on a Cortex-M7, and as a binary."""
    model = _model(subject)
    sizes: Report = {}
    for weights in WEIGHT_CODES:
        stored, name = ROUNDED[weights](model) if weights in ROUNDED else model, f"{subject.name}_model_{weights}"
        source, _ = write_c_model(stored, work, name)
        sizes[f"{name}_bytes"] = sum(_sections(source, subject, work))
        sizes[f"{name}_blob_bytes"] = len(bin_model_bytes(stored))
    return sizes


def judged(report: Report) -> Report:
    """With the ratios to the earlier build, and what misses its limit."""
    ratios = {
        f"{name}_ratio": float(value) / float(report[f"base_{name.partition('_')[2]}"])
        for name, value in report.items()
        if not name.startswith("base_") and f"base_{name.partition('_')[2]}" in report
    }
    both = float(report["sliding_instructions"]) / float(report["stuck_instructions"])
    report = report | ratios | {"sliding_to_stuck_instructions": both}
    missed = [name for name, limit in LIMITS.items() if name in report and not float(report[name]) <= limit]
    missed += [name for name, limit in LEAST.items() if name in report and not float(report[name]) >= limit]
    return report | {"aims_missed": ", ".join(missed)}


def gathered(reports: Path) -> Report:
    """What other targets measured of cost and left in a folder; `not_measured` names what is not there."""
    found: Report = {}
    for file, names in OF_OTHERS.items():
        report = json.loads((reports / file).read_text()) if (reports / file).is_file() else {}
        found |= {mine: report[name] for name, mine in names.items() if name in report}
    wanted = [mine for names in OF_OTHERS.values() for mine in names.values()]
    return found | {"not_measured": ", ".join(name for name in wanted if name not in found)}


def cost(model_dir: Path, reports: Path, commit: str = BASE, turns: int = TURNS) -> Report:
    """All figures, with those of other reports in a folder.

    Raises AminnError where the commit is not there or a program fails.
    """
    name, registers = this_cpu()
    isas = [isa for isa in RUNTIME_FLAGS if isa != "avx512" or registers == AVX512]
    with tempfile.TemporaryDirectory(prefix="aminn-cost-") as folder:
        work = Path(folder)
        with work_tree(commit, work / "base") as base:
            found = subjects(base, model_dir.resolve(), work)
            report: Report = {"base_commit": commit, "cpu": name, **gathered(reports)}
            for subject in found:
                report |= on_cortex_m7(subject, work)
            for isa in isas:
                report |= on_this_machine(found, isa, work, turns)
            for subject in found[1:]:
                report |= flash(subject, work)
                report |= fitted_context(subject, int(report[f"{subject.name}_stack_bytes"]), work)
    return judged(report)


@click.command(cls=Messages)
@click.option("--model", "model_dir", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--base", "commit", default=BASE, show_default=True, help="Commit that is compared with.")
@click.option("--turns", default=TURNS, show_default=True, help="Of each program.")
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(model_dir: Path | None, commit: str, turns: int, json_file: Path) -> None:
    """Measure what a prediction costs, in turns with an earlier commit."""
    model_dir = model_dir or ROOT / "tests" / "golden"
    check_outputs([json_file], [model_dir])
    report = cost(model_dir, json_file.parent, commit, turns)
    before = json.loads(json_file.read_text()) if json_file.is_file() else {}
    write_json(json_file, before | report)  # what others measured stays
    for key, value in report.items():
        click.echo(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}")
    click.echo(f"figures: {json_file}")


if __name__ == "__main__":
    main()
