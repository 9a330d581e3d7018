"""The programs that evaluate the ONNX model: ONNX Runtime, and what `aminn verify --onnx` offers in its place."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx.reference import ReferenceEvaluator

from aminn.prediction.onnx_session import check_onnx, in_chunks, run_onnx
from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_bytes

from ..samples.golden import single_thread_session

Arrays = dict[str, NDArray[np.float32]]
Run = Callable[[Arrays], Arrays]


def _import_openvino() -> ModuleType:
    try:
        return importlib.import_module("openvino")
    except ImportError as error:
        raise AminnError(f"OpenVINO cannot be imported ({error}); install it: pip install openvino") from error


def _load_openvino(model: Path) -> Run:
    openvino = _import_openvino()
    # Without the hint it computes in bfloat16 where the processor has instructions for that.
    settings = {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": 1}
    try:
        compiled = openvino.Core().compile_model(str(model), "CPU", settings)
    except RuntimeError as error:
        raise AminnError(f"{model}: OpenVINO cannot load it ({error})") from error

    def run(chunk: Arrays) -> Arrays:
        found = compiled(chunk)
        return {output.get_any_name(): found[output].copy() for output in compiled.outputs}

    return partial(in_chunks, run)


def _load_reference(model: Path) -> Run:
    evaluator = ReferenceEvaluator(onnx.load(model))
    names = evaluator.output_names

    def run(chunk: Arrays) -> Arrays:
        with np.errstate(all="ignore"):  # its Sigmoid overflows on the branch that it does not take
            return dict(zip(names, evaluator.run(names, chunk), strict=True))

    return partial(in_chunks, run)


def _load_onnxruntime(model: Path) -> Run:
    return partial(run_onnx, single_thread_session(model))


_LOAD: dict[str, Callable[[Path], Run]] = {
    "onnxruntime": _load_onnxruntime,
    "openvino": _load_openvino,
    "reference": _load_reference,
}
ENGINES = {"onnxruntime": "ONNX Runtime", "openvino": "OpenVINO", "reference": "onnx's reference evaluator"}
"""What messages call each."""


def load_engine(engine: str, model: AnyPath) -> Run:
    """A function from inputs to all outputs of a model file, by name: one of ENGINES on one thread, in float32.

    "reference" is the evaluator of the package onnx, which computes each operator in NumPy. Raises AminnError where the
    engine is not installed or does not take the model.
    """
    check_onnx(model, read_bytes(model))
    return _LOAD[engine](Path(model))
