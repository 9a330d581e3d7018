"""Run the reference model in other programs that read ONNX, and hold their outputs against ONNX Runtime and float64.

run.py --model tests/golden --work build/consumers --report build/reports/consumers.json [--only NAME ...]

consumers.toml has the programs; each gets a virtual environment in WORK. Compilers also say how long a sample takes
within what they made of the graph; the runtime takes its turn after each of them. Exits with 1 where one does not do
what is expected of it there: a program at full precision further off than the limits, or one that no longer refuses
the model.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import venv
from functools import cached_property
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from aminn.evaluation.metrics import holds
from aminn_base.files import write_json
from aminn_export.files.bin_model import read_bin_model
from aminn_export.judge.cost import ROOT, Subject, time_of, timed_program, write_states
from aminn_export.judge.verify import scaled_norm
from aminn_export.samples.vectors import Vectors, read_vectors
from aminn_hand.hand import INPUTS, OUTPUTS

HERE = Path(__file__).resolve().parent
BASELINE = "onnxruntime"
# Of dx_ht relative to its size (rotations times 0.1 m), of k_x to its largest entry, of the others absolute; a gate is
# the sigmoid of a steep function, so ONNX Runtime itself is 2e-6 from float64.
LIMITS = {"dx_ht": 2e-6, "p_stable": 2e-6, "k_x": 2e-6, "gate": 1e-5}
# Where a contact is near the end of its friction or slides, each of three steps of dx_ht and k_x doubles what rounding
# changes. dx_ht of a grasp that holds is as close all the same; this limit is of those that give way.
STICKS, LOST_LIMITS = 0.9, {"lost_dx_ht": 4e-5}
TIMEOUT_S = 900
WAYS = ("alone", "batch")
LARGEST_RATIO = 0.1
"""Aim: the runtime's time over that of the same graph by the fastest compiler."""
Outputs = dict[str, NDArray[np.float64]]
Figures = dict[str, float | int | bool | str]


def python_of(work: Path, name: str, wanted: dict, pip_arguments: tuple[str, ...]) -> Path:
    """The interpreter of a program's environment, made if its packages have changed."""
    folder = work / name
    python, stamp = folder / "bin" / "python", folder / "packages.txt"
    packages = [*wanted["packages"], *wanted.get("packages_alone", [])]
    if not stamp.is_file() or stamp.read_text().split() != packages:
        venv.create(folder, clear=True, with_pip=True, symlinks=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *pip_arguments]
        subprocess.run([*pip, *wanted["packages"]], check=True)
        if alone := wanted.get("packages_alone"):
            subprocess.run([*pip, "--no-deps", *alone], check=True)
        stamp.write_text("\n".join(packages))
    return python


def differences(out: Outputs, reference: Outputs, tau: float) -> dict[str, float]:
    """Largest difference of each output, in the units of LIMITS; infinite where it is not finite.

    dx_ht is of states whose contacts stick, or whose grasp holds; `lost_dx_ht` of the others; k_x where contacts stick.
    """
    n = len(out["dx_ht"])
    found = {}
    sticks = reference["friction_use"][:n].max(1) < STICKS
    kept = sticks | holds(reference["p_stable"][:n], tau)
    for name in LIMITS:
        b = np.asarray(reference[name][:n], np.float64)
        a = np.asarray(out[name][:n], np.float64).reshape(b.shape)
        if name == "dx_ht":
            size = scaled_norm(a - b) / scaled_norm(b)
        else:
            size = np.abs(a - b).reshape(n, -1).max(1)
            if name == "k_x":
                size /= np.abs(b).reshape(n, -1).max(1)
        size = np.where(np.isfinite(size), size, np.inf)
        found[name] = float(size[{"dx_ht": kept, "k_x": sticks}.get(name, slice(None))].max())
        if name == "dx_ht":
            found["lost_dx_ht"] = float(size[~kept].max(initial=0.0))
    return found


def run_program(python: Path, wanted: dict, files: list[Path], log: Path) -> str:
    """Run an engine's script; returns why it stopped, empty if it did not."""
    environment = os.environ | {"PATH": f"{python.parent}:{os.environ['PATH']}"}  # what it starts is its own
    command = [python, HERE / "engines" / wanted["script"], *files, *wanted.get("arguments", [])]
    files[-1].unlink(missing_ok=True)
    try:
        said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"no end after {TIMEOUT_S} s"
    log.write_text(said.stdout + said.stderr)
    if said.returncode == 0:
        return ""
    lines = [line for line in said.stderr.splitlines() if line.strip()] or [f"exit status {said.returncode}"]
    return lines[-1].strip()


def judge(outputs_file: Path, baseline: Path, vectors: Vectors, tau: float) -> Figures:
    """Differences of one program, alone and in a batch, from ONNX Runtime's outputs and from the float64 ones."""
    figures: Figures = {}
    assert vectors.reference_f64 is not None
    with np.load(outputs_file) as file, np.load(baseline) as base:
        figures["seconds"] = float(file["seconds"])
        figures["time_to_onnxruntime_ratio"] = float(file["seconds"] / base["seconds"])
        if "seconds_inside" in file:
            figures["us_inside"] = 1e6 * float(file["seconds_inside"])
        for how in WAYS:
            out = {name: file[f"{how}/{name}"] for name in OUTPUTS}
            onnxruntime = {name: base[f"{how}/{name}"] for name in OUTPUTS}
            for reference, values in ((BASELINE, onnxruntime), ("float64", vectors.reference_f64)):
                for name, size in differences(out, values, tau).items():
                    figures[f"{how}_{reference}_{name}_max"] = size
        n = len(file["alone/dx_ht"])
        rows = (file["alone/dx_ht"] != file["batch/dx_ht"].reshape(-1, 6)[:n]).any(1)
        figures["rows_with_other_bits_in_a_batch"] = int(rows.sum())
        figures["rows_alone"] = n
    within = all(
        float(figures[f"{how}_{reference}_{name}_max"]) <= limit
        for name, limit in (LIMITS | LOST_LIMITS).items()
        for how in WAYS
        for reference in (BASELINE, "float64")
    )
    return figures | {"outcome": "runs" if within else "differs"}


class Runtime:
    """The compiled runtime with the same model, for its turn beside compilers."""

    def __init__(self, model: Path, work: Path) -> None:
        self.subject, self.work = Subject("runtime", ROOT, model.resolve(), model / "golden.bin"), work.resolve()

    @cached_property
    def program(self) -> Path:
        return timed_program(self.subject, "avx512", self.work)

    def us(self) -> float:
        """Median time of a prediction, microseconds."""
        states = self.work / "states.bin"
        write_states(self.subject, states)
        return time_of(self.program, states)


def as_expected(outcome: str, expects: str) -> bool:
    """Whether an outcome (runs, differs, refuses) is the one of consumers.toml."""
    return expects == "either" or (outcome == "runs") == (expects == "runs")


@click.command()
@click.option("--model", type=click.Path(path_type=Path, exists=True), required=True, help="exported model")
@click.option("--work", type=click.Path(path_type=Path), required=True, help="folder for environments and outputs")
@click.option("--report", type=click.Path(path_type=Path), required=True, help="figures, JSON")
@click.option("--only", multiple=True, help="run these programs alone (and ONNX Runtime)")
@click.argument("pip_arguments", nargs=-1, type=click.UNPROCESSED)
def main(model: Path, work: Path, report: Path, only: tuple[str, ...], pip_arguments: tuple[str, ...]) -> None:
    """Run each program and write the report; PIP_ARGUMENTS go to pip."""
    programs = tomllib.loads((HERE / "consumers.toml").read_text())
    if unknown := set(only) - set(programs):
        raise click.UsageError(f"no program {', '.join(sorted(unknown))}; there are {', '.join(programs)}")
    vectors, tau = read_vectors(model / "golden.bin"), read_bin_model(model / "aminn_model.bin").meta["tau"]
    work.mkdir(parents=True, exist_ok=True)
    inputs = work / "inputs.npz"
    np.savez(inputs, **{name: vectors.inputs[name] for name in INPUTS})  # sensors of them tell nothing
    figures: Figures = {}
    runtime, ratios = Runtime(model, work), {}
    wrong = []
    for name, wanted in programs.items():
        if only and name not in (BASELINE, *only):
            continue
        python = python_of(work, name, wanted, pip_arguments)
        out, copy = work / f"{name}.npz", work / f"{name}.onnx"  # onnx2tf writes into the file that it reads
        copy.write_bytes((model / "aminn.onnx").read_bytes())
        reason = run_program(python, wanted, [copy, inputs, out], work / f"{name}.log")
        found: Figures = {"outcome": "refuses", "reason": reason}
        if not reason:
            found = judge(out, work / f"{BASELINE}.npz", vectors, tau)
        found["packages"] = " ".join([*wanted["packages"], *wanted.get("packages_alone", [])])
        if "us_inside" in found:
            found["runtime_us"] = runtime.us()
            ratios[name] = found["runtime_ratio"] = float(found["runtime_us"]) / float(found["us_inside"])
        figures |= {f"{name}_{key}": value for key, value in found.items()}
        said = reason or (
            f"dx {max(found[f'{how}_{r}_dx_ht_max'] for how in WAYS for r in (BASELINE, 'float64')):.1e}, "
            f"{found['time_to_onnxruntime_ratio']:.2f} of ONNX Runtime's time, "
            f"{found['rows_with_other_bits_in_a_batch']} of {found['rows_alone']} rows with other bits in a batch"
        )
        click.echo(f"{name:28} {found['outcome']:8} {said}")
        if not as_expected(str(found["outcome"]), wanted["expects"]):
            wrong.append(f"{name} {found['outcome']}, expected: {wanted['expects']}; its output: {work / name}.log")
    if ratios:
        best = max(ratios, key=ratios.__getitem__)
        met = "met" if ratios[best] <= LARGEST_RATIO else "missed"
        figures |= {"compiler": best, "runtime_to_compiler_ratio": ratios[best]}
        click.echo(f"runtime to {best} {ratios[best]:.3f}, aim <= {LARGEST_RATIO}: {met}")
    figures["ok"] = not wrong
    write_json(report, figures)
    for line in wrong:
        click.echo(line, err=True)
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
