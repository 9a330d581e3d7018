"""Golden vectors: samples of a data set with what ONNX Runtime and a float64 evaluation make of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from aminn.data.dataset import Dataset
from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand.hand import INPUTS, OUTPUTS

from ..files.bin_model import model_crc
from ..files.tables import Exported, dims_of
from .reference import Reference
from .vectors import THETA, write_vectors

GOLDEN_FILE = "golden.bin"
GOLDEN_SAMPLES = 200
# Samples a call. ONNX Runtime's bits depend on it, and on the optimisation level.
CHUNK = 1024
OPTIMISATION_LEVEL = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
# Below it, Sqrt is up to 3.6 units in the last place off and half of the outputs have other bits.
ONNXRUNTIME_AT_LEAST = (1, 21)


def check_onnxruntime() -> None:
    """Raises AminnError where the ONNX Runtime that is installed rounds square roots wrongly."""
    if tuple(int(part) for part in ort.__version__.split(".")[:2]) < ONNXRUNTIME_AT_LEAST:
        wanted = ".".join(map(str, ONNXRUNTIME_AT_LEAST))
        raise AminnError(
            f"ONNX Runtime {ort.__version__} is installed, whose square roots are wrong in the last places; "
            f"{wanted} or later is needed: pip install 'onnxruntime>={wanted}'"
        )


def single_thread_session(model: AnyPath | bytes) -> ort.InferenceSession:
    """An ONNX Runtime session on one CPU thread. Raises AminnError if it is no model that ONNX Runtime can load."""
    check_onnxruntime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.graph_optimization_level = OPTIMISATION_LEVEL
    options.log_severity_level = 3  # not of a default that may be overridden
    source = model if isinstance(model, bytes) else Path(model).read_bytes()
    try:
        return ort.InferenceSession(source, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common base of their own
        name = "ONNX model" if isinstance(model, bytes) else model
        raise AminnError(f"{name}: ONNX Runtime cannot load it ({error})") from error


def in_chunks(
    run: Callable[[dict[str, NDArray]], dict[str, NDArray[np.float32]]], inputs: dict[str, NDArray]
) -> dict[str, NDArray[np.float32]]:
    """What `run` gives by name, called with at most CHUNK samples at a time."""
    n = len(inputs["q"])
    parts = [run({k: v[i : i + CHUNK] for k, v in inputs.items()}) for i in range(0, max(n, 1), CHUNK)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def run_onnx(session: ort.InferenceSession, inputs: dict[str, NDArray]) -> dict[str, NDArray[np.float32]]:
    """All outputs by name."""
    names = [o.name for o in session.get_outputs()]
    return in_chunks(lambda chunk: dict(zip(names, session.run(names, chunk), strict=True)), inputs)


def inputs_of(dataset: Dataset, exported: Exported | None = None) -> dict[str, NDArray[np.float32]]:
    """Model inputs of a data set, float32 as every runtime gets them; of a told model theta, zeros if none is told."""
    samples = dataset.samples
    inputs = {name: np.ascontiguousarray(samples[name], np.float32) for name in INPUTS}
    if exported is not None and (dims := dims_of(exported.tensors)).factors:
        shape = (len(inputs["q"]), dims.factors + dims.joints + 1)
        inputs[THETA] = np.ascontiguousarray(samples.get(THETA, np.zeros(shape)), np.float32)
    return inputs


def spread(stable: NDArray, n: int) -> NDArray[np.int64]:
    """Indices of n samples, evenly spaced over the data set, half of them stable where there are enough of both."""
    groups = [np.flatnonzero(stable > 0), np.flatnonzero(stable == 0)]
    smaller = min(n // 2, *(len(g) for g in groups))
    wanted = [smaller if len(g) == smaller else min(n - smaller, len(g)) for g in groups]
    if sum(wanted) > n:
        wanted = [n - n // 2, n // 2]
    picks = [
        g[np.linspace(0, len(g) - 1, k).round().astype(np.int64)] for g, k in zip(groups, wanted, strict=True) if k
    ]
    return np.sort(np.concatenate(picks)) if picks else np.zeros(0, np.int64)


def write_golden(
    exported: Exported, onnx_file: AnyPath, dataset: Dataset, path: AnyPath, n: int = GOLDEN_SAMPLES
) -> int:
    """Write golden vectors of `dataset` to `path`; returns their number."""
    inputs = inputs_of(dataset.take(spread(dataset.samples["stable"], n)), exported)
    outputs = run_onnx(single_thread_session(onnx_file), inputs)
    exact = Reference(exported)(inputs)
    write_vectors(path, inputs, outputs, {name: exact[name] for name in OUTPUTS}, model_crc(exported))
    return len(inputs["q"])
