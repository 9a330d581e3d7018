"""Three evaluations of one model on states that nobody chose: the C runtime, ONNX Runtime, and float64.

differential.py --replay build/host/runtime/aminn_replay --corpus build/fuzz/corpus/predict --states 4000
                --work build/differential --report build/reports/reliability/differential.json

Classes of input: golden samples; random states in the training range and beyond it, whose numbers belong to no grasp;
states made to be hard; and what the fuzzer kept. Of golden samples every number lies within the judge's limits
(aminn_export.judge.tolerances); of the others it says how many do not. In each class 99 of 100 errors of the runtime
are no larger than those of ONNX Runtime.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn.prediction.onnx_session import run_onnx
from aminn_base.files import write_json
from aminn_export.files.bin_model import BinModel, read_bin_model
from aminn_export.files.tables import dims_of
from aminn_export.judge.fidelity import SquareRootReference, in_chunks
from aminn_export.judge.verdict import Bins, compare_within
from aminn_export.judge.verify import model_prefix, onnx_session, scaled_norm
from aminn_export.samples.adversarial import adversarial_states, closure
from aminn_export.samples.vectors import Results, read_results, read_vectors, write_vectors
from aminn_hand.hand import INPUTS, OUTPUTS

Inputs = dict[str, NDArray[np.float32]]
Figures = dict[str, float | int | str]
JUDGED = "golden"
"""The class in which every number must lie within the judge's limits."""
ROOM = 1.1
UNIT = 2.0**-24
COMPARED = ("dx_relative", "p_stable")


def split(rows: NDArray, model: BinModel) -> Inputs:
    """Fields of states (n, STATE), whose contacts are made ones, and their closure."""
    dims = dims_of(model)
    at = np.cumsum([dims.joints, 6, 6])
    q, x_ht, w_e, contacts = np.split(rows.astype(np.float64), at, 1)
    contacts = contacts.reshape(len(rows), dims.branches, -1).copy()
    contacts[..., 0] = np.clip(contacts[..., 0], 0.0, 1.0)
    contacts[..., 4:7] /= np.linalg.norm(contacts[..., 4:7], axis=-1, keepdims=True)
    turned = np.linalg.norm(x_ht[:, 3:], axis=1, keepdims=True)
    x_ht[:, 3:] *= np.minimum(1.0, np.pi / np.maximum(turned, 1e-9))
    single = {"q": q, "x_ht": x_ht, "w_e": w_e, "contacts": contacts}
    rounded = {k: v.astype(np.float32) for k, v in single.items()}
    exact = (rounded[k].astype(np.float64) for k in ("q", "x_ht", "contacts"))
    j_x, j_q = closure(*exact, model)
    return rounded | {"j_x": j_x.astype(np.float32), "j_q": j_q.astype(np.float32)}


def random_states(model: BinModel, n: int, width: float, seed: int) -> Inputs:
    """Each number evenly from its training range, `width` times as wide."""
    low, high = (np.asarray(model.tensors[f"range_{end}"], np.float64).ravel() for end in ("min", "max"))
    u = np.random.default_rng(seed).uniform(-width, width, (n, len(low)))
    return split((low + high) / 2 + (high - low) / 2 * u, model)


def kept_by_fuzzer(corpus: Path, golden: Inputs, most: int) -> Inputs:
    """Inputs in the files of fuzz_predict: a byte, then the numbers; missing ones are those of a golden sample."""
    whole = np.concatenate([golden[k][0].ravel() for k in INPUTS]).astype("<f4").tobytes()
    rows = []
    for file in sorted(corpus.iterdir())[:most]:
        data = file.read_bytes()[1 : 1 + len(whole)]
        rows.append(np.frombuffer(data + whole[len(data) :], "<f4"))
    parts = np.split(np.stack(rows), np.cumsum([golden[k][0].size for k in INPUTS])[:-1], 1)
    return {k: part.reshape(-1, *golden[k].shape[1:]) for k, part in zip(INPUTS, parts, strict=True)}


def replay(program: Path, model_dir: Path, prefix: str, inputs: Inputs, work: Path) -> Results:
    """What the runtime predicts."""
    n, shapes = len(inputs["q"]), {"p_stable": (), "dx_ht": (6,), "k_x": (6, 6)}
    branches = inputs["contacts"].shape[1]
    shapes |= {"gate": (branches,), "p_slide": (), "bound_95": (), "friction_use": (branches,)}
    vectors, out = work / "states.bin", work / "results.bin"
    write_vectors(vectors, inputs, {k: np.zeros((n, *shapes[k]), np.float32) for k in OUTPUTS})
    command = [program.resolve(), model_dir / f"{prefix}.bin", vectors, out]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return read_results(out)


def exact(reference: SquareRootReference, inputs: Inputs) -> dict[str, NDArray[np.float64]]:
    """float64 outputs; NaN of states that it cannot solve for."""
    try:
        return in_chunks(reference, inputs)
    except np.linalg.LinAlgError:
        n = len(inputs["q"])
        if n == 1:
            shapes = {"dx_ht": (6,), "k_x": (6, 6)} | dict.fromkeys(
                ("gate", "friction_use"), inputs["contacts"].shape[1:2]
            )
            return {k: np.full((1, *shapes.get(k, ())), np.nan) for k in OUTPUTS}
        halves = [
            exact(reference, {k: v[part] for k, v in inputs.items()}) for part in (slice(n // 2), slice(n // 2, n))
        ]
        return {k: np.concatenate([half[k] for half in halves]) for k in OUTPUTS}


def quantiles(name: str, values: NDArray) -> Figures:
    picks = {"median": 0.5, "p99": 0.99, "max": 1.0}
    return {f"{name}_{key}": float(np.quantile(values, q)) if len(values) else 0.0 for key, q in picks.items()}


def compare(name: str, model: BinModel, session: object, results: Results, inputs: Inputs) -> Figures:
    """Figures of one class: all three compared where each of them has numbers."""
    with np.errstate(all="ignore"):
        onnx = run_onnx(session, inputs)
        float64 = exact(SquareRootReference(model), inputs)
    finite = np.ones(len(inputs["q"]), bool)
    for outputs in (onnx, float64):
        for k in OUTPUTS:
            finite &= np.isfinite(outputs[k]).reshape(len(finite), -1).all(1)
    accepted = results.status == 0
    rows = np.flatnonzero(finite & accepted)
    figures: Figures = {"states": len(finite), "refused": int((~accepted).sum()), "compared": len(rows)}
    figures["onnx_not_finite_where_runtime_predicts"] = int((accepted & ~finite).sum())
    meta = model.meta
    some = Results({k: v[rows] for k, v in results.outputs.items()}, results.decision[rows], results.status[rows])
    verdict = compare_within(
        some, {k: onnx[k][rows] for k in OUTPUTS}, float(np.float32(meta["tau"])), float(meta["length_scale"]),
        name, str, bins=Bins.of(meta),
    )  # fmt: skip
    figures["numbers_beyond_limits"] = len(verdict.failures)
    size = np.maximum(scaled_norm(float64["dx_ht"][rows]), 1e-12)
    for who, outputs in (("runtime", results.outputs), ("onnx", onnx)):
        dx = scaled_norm(outputs["dx_ht"][rows] - float64["dx_ht"][rows]) / size
        figures |= quantiles(f"{who}_dx_relative", dx)
        figures |= quantiles(f"{who}_p_stable", np.abs(outputs["p_stable"][rows] - float64["p_stable"][rows]))
    work = (results.outputs["dx_ht"][rows].astype(np.float64) * inputs["w_e"][rows]).sum(1)
    figures["runtime_takes_energy"] = int((work < -1e-6 * np.abs(work).max(initial=1e-30)).sum())
    return {f"differential_{name}_{key}": value for key, value in figures.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, default=Path(__file__).resolve().parents[1] / "golden")
    parser.add_argument("--replay", type=Path, required=True)
    parser.add_argument("--corpus", type=Path)
    parser.add_argument("--states", type=int, default=4000)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--report", type=Path, required=True)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    prefix = model_prefix(args.model)
    model, session = read_bin_model(args.model / f"{prefix}.bin"), onnx_session(args.model, prefix)
    golden = {
        k: np.asarray(v, np.float32) for k, v in read_vectors(args.model / "golden.bin").inputs.items() if k in INPUTS
    }
    classes = {
        "golden": golden,
        "in_range": random_states(model, args.states, 1.0, 1),
        "beyond_range": random_states(model, args.states, 3.0, 2),
        "hard": adversarial_states(golden, model, args.states)[0],
    }
    if args.corpus is not None and args.corpus.is_dir() and any(args.corpus.iterdir()):
        classes["fuzzed"] = kept_by_fuzzer(args.corpus, golden, args.states)
    figures: Figures = {}
    for name, inputs in classes.items():
        results = replay(args.replay, args.model, prefix, inputs, args.work)
        figures |= compare(name, model, session, results, inputs)
    wrong = [JUDGED] if figures[f"differential_{JUDGED}_numbers_beyond_limits"] else []
    for name in classes:
        for key in COMPARED:
            own, onnx = (float(figures[f"differential_{name}_{who}_{key}_p99"]) for who in ("runtime", "onnx"))
            wrong += [f"{name}: {key}"] if own > max(ROOM * onnx, 2 * UNIT) else []
    figures["differential_failures"] = ", ".join(wrong)
    write_json(args.report, figures)
    print("\n".join(f"{name} {value}" for name, value in figures.items()))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
