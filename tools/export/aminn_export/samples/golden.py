"""Golden vectors: samples of a data set with what ONNX Runtime and a float64 evaluation make of them."""

from __future__ import annotations

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from aminn.data.dataset import Dataset
from aminn.prediction.onnx_session import onnx_session, run_onnx
from aminn_base.read import AnyPath
from aminn_hand.hand import INPUTS, OUTPUTS

from ..files.bin_model import model_crc
from ..files.tables import Exported, dims_of
from .reference import Reference
from .vectors import THETA, write_vectors

GOLDEN_FILE = "golden.bin"
GOLDEN_SAMPLES = 200


def single_thread_session(model: AnyPath | bytes) -> ort.InferenceSession:
    """An ONNX Runtime session on one CPU thread. Raises AminnError if it is no model that ONNX Runtime can load."""
    return onnx_session(model, 1)


def inputs_of(dataset: Dataset, exported: Exported | None = None) -> dict[str, NDArray[np.float32]]:
    """Model inputs of a data set, in float32; also theta and sensors, if the model has them: zeros where not told."""
    samples = dataset.samples
    inputs = {name: np.ascontiguousarray(samples[name], np.float32) for name in INPUTS}
    if exported is None:
        return inputs
    dims = dims_of(exported)
    optional: dict[str, tuple[int, ...]] = {}
    if dims.factors:
        optional[THETA] = (dims.factors + dims.joints + 1,)
    if dims.sensing:
        optional |= dims.sensors
    for name, shape in optional.items():
        values = samples.get(name, np.zeros((len(inputs["q"]), *shape)))
        inputs[name] = np.ascontiguousarray(values, np.float32)
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
