"""How close to exact arithmetic the runtime and ONNX Runtime are, and whether all targets give the same bits.

python -m aminn_export.judge.fidelity --model tests/golden --data build/fidelity/data --json build/reports/fidelity.json

Simulated and adversarial states go through ONNX Runtime and through the runtime on every target. The truth is float64
with the statics in square-root form (its own error grows with the square root of the condition number); the plain form
of `reference.py` is compared with it where K_x is well conditioned.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import load_dataset
from aminn.prediction.onnx_session import run_onnx
from aminn_base.files import check_outputs, write_json
from aminn_base.program import Messages
from aminn_hand.hand import INPUTS, OUTPUTS
from aminn_rt.ranges import within_ranges
from aminn_rt.sources import runtime_source

from ..files.bin_model import BinModel, read_bin_model
from ..files.tables import dims_of, pair_of
from ..replay.targets import SLOW, TARGETS, replay_all, run
from ..samples.adversarial import KINDS, adversarial_states
from ..samples.reference import Array, Reference, Statics
from ..samples.vectors import Results, read_results, write_vectors
from .verify import model_prefix, onnx_session, samples_of_dataset, scaled_condition, scaled_norm

UNIT = 2.0**-24
"""Unit roundoff of float32."""
P_STABLE_LIMIT = 2e-6
"""Where contacts can slide, what ONNX Runtime is off by, if that is more: p_stable is steep where one begins to."""
SPINNING_M = 1.0
"""No grasp moves its tool further (rotations times 0.1 m); the linear model does where nothing hinders a rotation."""
WELL_CONDITIONED = 1e6
PERTURBATIONS = 16
CHUNK = 2000
SLOW_EVERY = 20
"""Targets without an FPU replay each 20th state: a prediction takes them seventy times as many instructions."""
Figures = dict[str, float | int | str | bool]


class SquareRootReference(Reference):
    """The float64 model with the statics by QR factorisations: no stiffness is formed before it is solved with."""

    def _pass(self, stage: int, k_q: Array, twist: Array, x: dict[str, Array], slide: Array | None = None) -> Statics:
        root_m, eps_kx = np.sqrt(self.eps_m[stage] * x["softer"])[..., None, None], pair_of(self.meta["eps_kx"])[stage]
        n, s, n_b, n_c = len(k_q), self.s, self.b, self.c
        contact = np.sqrt(x["contacts"][..., 0])[..., None, None]  # (N, B, 1, 1)
        lower = np.linalg.cholesky(k_q)  # (N, B, C, C)
        g = np.linalg.solve(lower, -np.swapaxes(x["j_q"], -1, -2))
        eye = np.broadcast_to(root_m * np.eye(3), (n, n_b, 3, 3))
        normal = x["contacts"][..., 4:7]
        across = np.eye(3) - normal[..., :, None] * normal[..., None, :]
        given = [] if slide is None else [contact * np.sqrt(slide)[..., None, None] * across]
        q_m, r_m = np.linalg.qr(np.concatenate([g, eye, *given], -2))  # (N, B, C + 3 or C + 6, 3), (N, B, 3, 3)
        y = contact * np.linalg.solve(np.swapaxes(r_m, -1, -2), x["j_x"] * s)  # (N, B, 3, 6)
        tail = np.broadcast_to(np.sqrt(eps_kx) * np.diag(s), (n, 6, 6))
        turning = np.concatenate([np.zeros((n, n_b, 3)), normal], 2) * s
        held = contact[..., 0] * np.sqrt(twist)[..., None] * turning  # (N, B, 6)
        v = np.concatenate([y.reshape(n, 3 * n_b, 6), held, tail], 1)  # (N, 4 B + 6, 6)
        q_x, r_x = np.linalg.qr(v)
        t = np.linalg.solve(np.swapaxes(r_x, -1, -2), (x["w_e"] * s)[..., None])  # (N, 6, 1)
        dx = np.linalg.solve(r_x, t)[..., 0] * s
        strain = (q_x @ t)[:, : 3 * n_b].reshape(n, n_b, 3, 1)
        dq = np.linalg.solve(np.swapaxes(lower, -1, -2), q_m[..., :n_c, :] @ (contact * strain))
        k_x = np.swapaxes(v, -1, -2) @ v / s[:, None] / s
        force = np.linalg.solve(r_m, contact * strain)[..., 0]
        give = ((r_m @ across) ** 2).sum((2, 3)) / 2
        return Statics(k_x, dx, dq[..., 0], force, give)


def in_chunks(reference: Reference, inputs: dict[str, NDArray]) -> dict[str, Array]:
    """Its outputs for many states."""
    n = len(inputs["q"])
    parts = [reference({k: v[i : i + CHUNK] for k, v in inputs.items()}) for i in range(0, n, CHUNK)]
    return {name: np.concatenate([p[name] for p in parts]) for name in OUTPUTS}


def _quantiles(name: str, values: Array) -> Figures:
    quantiles = {"median": 0.5, "p99": 0.99, "p9999": 0.9999, "max": 1.0}
    return {f"{name}_{key}": float(np.quantile(values, q)) for key, q in quantiles.items()}


def error_figures(outputs: dict[str, NDArray], truth: dict[str, Array], condition: Array) -> Figures:
    """Errors of one runtime: of dx_ht relative to its size, the same over condition and unit roundoff, of p_stable.

    Of bound_95 relative, of friction_use over one plus it, of K_x over its largest entry.
    """
    relative = scaled_norm(outputs["dx_ht"] - truth["dx_ht"]) / scaled_norm(truth["dx_ht"])
    p_stable = np.abs(outputs["p_stable"] - truth["p_stable"])
    figures = _quantiles("dx_relative", relative) | _quantiles("dx_over_condition", relative / (condition * UNIT))
    figures |= _quantiles("p_stable", p_stable) | _quantiles("gate", np.abs(outputs["gate"] - truth["gate"]).max(1))
    figures |= _quantiles("p_slide", np.abs(outputs["p_slide"] - truth["p_slide"]))
    bound = truth["bound_95"]
    figures |= _quantiles(
        "bound_95", np.abs(outputs["bound_95"] - bound) / np.maximum(bound, np.finfo(np.float32).tiny)
    )
    use, k_x = truth["friction_use"], truth["k_x"]
    figures |= _quantiles("friction_use", (np.abs(outputs["friction_use"] - use) / (1 + use)).max(1))
    return figures | _quantiles("k_x", np.abs(outputs["k_x"] - k_x).max((1, 2)) / np.abs(k_x).max((1, 2)))


def compare_set(
    name: str, onnx: dict[str, NDArray], results: Results, truth: dict[str, Array], rows: NDArray[np.int64]
) -> Figures:
    """Figures of one set of states (rows): both runtimes, and who is closer."""
    rows = rows[results.status[rows] == 0]
    exact = {k: v[rows] for k, v in truth.items()}
    condition = scaled_condition(exact["k_x"])
    slid = float((exact["friction_use"] > 1).any(1).mean()) if len(rows) else 0.0
    figures: Figures = {f"{name}_states": len(rows), f"{name}_slid_share": slid}
    figures |= _quantiles(f"{name}_condition", condition)
    for runtime, outputs in (("runtime", results.outputs), ("onnx", onnx)):
        errors = error_figures({k: outputs[k][rows] for k in OUTPUTS}, exact, condition)
        figures |= {f"{name}_{runtime}_{key}": value for key, value in errors.items()}
    return figures


def p_stable_sensitivity(
    model: BinModel, inputs: dict[str, NDArray], results: Results, truth: dict[str, Array], rows: NDArray[np.int64]
) -> Figures:
    """Of states (rows) whose p_stable is off by more than the limit: how many, how many of them spin (SPINNING_M), and
    what rounding their inputs changes.

    The latter is the largest change of the float64 p_stable when each input changes by up to half a unit of its last
    place, and the number of states that it takes beyond the limit.
    """
    error = np.abs(results.outputs["p_stable"] - truth["p_stable"])
    off = rows[error[rows] > P_STABLE_LIMIT]
    if not len(off):
        return {"adversarial_p_stable_beyond_limit": 0}
    rng, reference = np.random.default_rng(0), SquareRootReference(model)
    x = {k: inputs[k][off].astype(np.float64) for k in INPUTS}
    change = np.zeros(len(off))
    for _ in range(PERTURBATIONS):
        moved = {k: v * (1 + UNIT * rng.uniform(-1, 1, v.shape)) for k, v in x.items()}
        change = np.maximum(change, np.abs(reference(moved)["p_stable"] - truth["p_stable"][off]))
    return {
        "adversarial_p_stable_beyond_limit": len(off),
        "adversarial_p_stable_beyond_limit_spinning": int((scaled_norm(truth["dx_ht"][off]) > SPINNING_M).sum()),
        "adversarial_p_stable_moved_as_far_by_rounded_input": int((change > P_STABLE_LIMIT).sum()),
        "adversarial_p_stable_change_by_rounded_input_max": float(change.max()),
    }


def p_stable_of_plausible(
    model: BinModel, inputs: dict[str, NDArray], results: Results, truth: dict[str, Array], rows: NDArray[np.int64]
) -> Figures:
    """p_stable of states (rows) within the training range, and of tools that do not spin: how many, largest error."""
    rows = rows[results.status[rows] == 0]
    error = np.abs(results.outputs["p_stable"][rows] - truth["p_stable"][rows])
    sets = {
        "in_range": within_ranges({k: v[rows] for k, v in inputs.items()}, model.tensors),
        "not_spinning": scaled_norm(truth["dx_ht"][rows]) <= SPINNING_M,
    }
    figures: Figures = {f"adversarial_{name}_states": int(chosen.sum()) for name, chosen in sets.items()}
    return figures | {
        f"adversarial_{name}_p_stable_max": float(error[chosen].max(initial=0.0)) for name, chosen in sets.items()
    }


def truth_is_sound(model: BinModel, inputs: dict[str, NDArray], truth: dict[str, Array]) -> float:
    """Largest relative difference of the plain float64 form where K_x is well conditioned."""
    plain = in_chunks(Reference(model), inputs)
    good = scaled_condition(truth["k_x"]) < WELL_CONDITIONED
    difference = scaled_norm(plain["dx_ht"] - truth["dx_ht"]) / scaled_norm(truth["dx_ht"])
    return float(difference[good].max(initial=0.0))


def ulp_figures(work: Path, stride: int) -> Figures:
    """Largest errors of the elementary functions; raises AminnError where one exceeds its bound."""
    program, runtime = work / "aminn_ulp", runtime_source()
    source = runtime / "tools" / "aminn_ulp.cpp"
    command = ["g++", "-std=c++17", "-O2", "-ffp-contract=off", "-fno-math-errno", f"-I{runtime / 'include'}"]
    run([*command, f"-I{runtime / 'src'}", str(source), "-o", str(program)], "compiling aminn_ulp")
    return {"elementary_stride": stride} | json.loads(run([str(program), str(stride)], "aminn_ulp"))


COUNTS = ("targets", "different_hashes", "different_calibrations", "different_admissible_loads")
Replays = dict[str, tuple[Path, dict[str, int]]]


def bit_figures(replays: Replays) -> Figures:
    """Of targets: how many, how many different results, calibrations and admissible loads; the hash of each result."""
    hashes = {name: hashlib.sha256(out.read_bytes()).hexdigest() for name, (out, _) in replays.items()}
    told = [figures for _, figures in replays.values()]
    learned, loads = ({figures[key] for figures in told} for key in ("calibration_crc", "loads_crc"))
    counts = (len(hashes), len(set(hashes.values())), len(learned), len(loads))
    figures: Figures = dict(zip(COUNTS, counts, strict=True))
    figures["calibration_pushes"] = told[0]["pushes"]
    return figures | {f"sha256_{name}": digest for name, digest in hashes.items()}


def fidelity(
    model_dir: Path, data: Path, work: Path, n: int, targets: tuple[str, ...], stride: int, jobs: int
) -> Figures:
    """All figures; "ok" and "failures" say whether the claims hold, "aims_missed" where ONNX Runtime is closer.

    Raises AminnError where something cannot run.
    """
    prefix = model_prefix(model_dir)
    model = read_bin_model(model_dir / f"{prefix}.bin")
    work.mkdir(parents=True, exist_ok=True)
    simulated = samples_of_dataset(load_dataset(data), n).inputs
    simulated = {k: simulated[k][:n] for k in INPUTS}
    hard, kind = adversarial_states(simulated, model, n)
    inputs = {k: np.concatenate([simulated[k], hard[k]]) for k in INPUTS}
    onnx = run_onnx(onnx_session(model_dir, prefix), inputs)
    truth = in_chunks(SquareRootReference(model), inputs)
    vectors = work / "states.bin"
    write_vectors(vectors, inputs, onnx)
    quick = tuple(t for t in targets if t not in SLOW) or targets[:1]
    replays = replay_all(quick, model_dir, prefix, vectors, work, jobs)
    results = read_results(replays[quick[0]][0])
    figures = bit_figures(replays) | {"contacts_slide": dims_of(model).slides}
    slow = tuple(t for t in targets if t in SLOW)
    if slow:
        few = work / "few.bin"
        some_inputs, some_onnx = ({k: v[::SLOW_EVERY] for k, v in x.items()} for x in (inputs, onnx))
        write_vectors(few, some_inputs, some_onnx)
        again = bit_figures(replay_all((quick[0], *slow), model_dir, prefix, few, work / "few", jobs))
        figures |= {key: int(figures[key]) + int(again[key]) - 1 for key in COUNTS}  # quick[0] is in both
        figures |= {f"sha256_{name}": again[f"sha256_{name}"] for name in slow}
        figures |= {"targets_without_fpu": len(slow), "states_without_fpu": len(inputs["q"][::SLOW_EVERY])}
    figures["refused_simulated"] = int((results.status[:n] != 0).sum())
    figures["refused_adversarial"] = int((results.status[n:] != 0).sum())
    figures["plain_float64_difference_max"] = truth_is_sound(model, inputs, truth)
    figures |= compare_set("simulated", onnx, results, truth, np.arange(n))
    figures |= compare_set("adversarial", onnx, results, truth, np.arange(n, 2 * n))
    figures |= p_stable_sensitivity(model, inputs, results, truth, np.arange(n, 2 * n))
    figures |= p_stable_of_plausible(model, inputs, results, truth, np.arange(n, 2 * n))
    for k, name in enumerate(KINDS):
        figures |= compare_set(name, onnx, results, truth, n + np.flatnonzero(kind == k))
    figures |= ulp_figures(work, stride)
    wrong = failures(figures)
    return figures | {"ok": not wrong, "failures": "; ".join(wrong), "aims_missed": "; ".join(missed(figures))}


def failures(f: Figures) -> list[str]:
    """The claims that do not hold."""
    wrong = []
    if f["different_hashes"] != 1:
        wrong.append("the targets' bit patterns differ")
    if f["different_calibrations"] != 1:
        wrong.append("the targets learn other bits of theta")
    if f["different_admissible_loads"] != 1:
        wrong.append("the targets find other admissible loads")
    if f["refused_simulated"]:
        wrong.append(f"{f['refused_simulated']} simulated states are refused")
    for what, key in (
        ("simulated", "simulated_runtime_p_stable_max"),
        ("adversarial", "adversarial_runtime_p_stable_max"),
        ("adversarial, within the training range", "adversarial_in_range_p_stable_max"),
    ):
        onnx = float(f[f"{what.partition(',')[0]}_onnx_p_stable_max"])
        if not float(f[key]) <= (max(P_STABLE_LIMIT, onnx) if f["contacts_slide"] else P_STABLE_LIMIT):
            wrong.append(f"{what}: p_stable off by {f[key]:.3g}")
    return wrong


def missed(f: Figures) -> list[str]:
    """Where the runtime is not at least as close to the truth as ONNX Runtime: a largest value hangs on one state."""
    out = []
    for name in ("simulated", "adversarial"):
        for q in ("median", "max"):
            own, onnx = (float(f[f"{name}_{who}_dx_over_condition_{q}"]) for who in ("runtime", "onnx"))
            if not own <= onnx:
                out.append(f"{name}: dx_over_condition_{q} of the runtime {own:.3g}, of ONNX Runtime {onnx:.3g}")
        for key in ("k_x", "p_slide", "bound_95", "friction_use"):
            own, onnx = (float(f[f"{name}_{who}_{key}_p99"]) for who in ("runtime", "onnx"))
            if not own <= max(onnx, UNIT):
                out.append(f"{name}: {key}, 99 of 100, of the runtime {own:.3g}, of ONNX Runtime {onnx:.3g}")
    own, onnx = (float(f[f"adversarial_{who}_p_stable_max"]) for who in ("runtime", "onnx"))
    if not own <= onnx:
        out.append(f"adversarial: p_stable of the runtime is off by {own:.3g}, of ONNX Runtime by {onnx:.3g}")
    return out


def format_figures(f: Figures) -> str:
    """The table that the program prints."""
    rows = [f"{'errors to float64':<44}{'median':>11}{'p99':>11}{'largest':>11}"]
    for name in ("simulated", "adversarial"):
        for who, text in (("runtime", "runtime"), ("onnx", "ONNX Runtime")):
            for key in ("dx_relative", "dx_over_condition", "p_stable", "k_x", "p_slide", "bound_95", "friction_use"):
                values = "".join(f"{f[f'{name}_{who}_{key}_{q}']:>11.2e}" for q in ("median", "p99", "max"))
                rows.append(f"{f'{name}, {text}, {key}':<44}{values}")
    bits = f"{f['targets']} targets, {f['different_hashes']} bit pattern(s); of theta after {f['calibration_pushes']} "
    bits += f"pushes {f['different_calibrations']}, of admissible loads {f['different_admissible_loads']}"
    return "\n".join([*rows, bits])


FOLDER = click.Path(path_type=Path, file_okay=False, exists=True)


@click.command(cls=Messages)
@click.option(
    "--model", "model_dir", type=FOLDER, default=Path("tests/golden"), show_default=True, help="Exported model."
)
@click.option("--data", type=FOLDER, required=True, help="Data set that the simulated states are taken from.")
@click.option(
    "--work", type=click.Path(path_type=Path, file_okay=False), default=Path("build/fidelity"), show_default=True
)
@click.option("--states", default=20000, show_default=True, help="Number of simulated and of adversarial states.")
@click.option("--targets", default=",".join(TARGETS), show_default=True, help="Where to replay, separated by commas.")
@click.option(
    "--stride", default=7, show_default=True, help="Bit patterns between two arguments of an elementary function."
)
@click.option("--jobs", default=os.cpu_count() or 1, show_default=True, help="Targets at a time.")
@click.option(
    "--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=Path("build/reports/fidelity.json")
)
def main(
    model_dir: Path, data: Path, work: Path, states: int, targets: str, stride: int, jobs: int, json_file: Path
) -> None:
    """Measure the numerical fidelity of the runtime on all targets."""
    check_outputs([json_file], [model_dir, data])
    figures = fidelity(model_dir, data, work, states, tuple(targets.split(",")), stride, jobs)
    write_json(json_file, figures)
    click.echo(format_figures(figures))
    if figures["aims_missed"]:
        click.echo(f"aims missed: {figures['aims_missed']}")
    if not figures["ok"]:
        raise click.ClickException(f"{figures['failures']} (figures: {json_file})")


if __name__ == "__main__":
    main()
