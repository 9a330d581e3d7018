"""ONNX Runtime on the exported model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_bytes
from aminn_base.seal import check_bytes
from aminn_hand.hand import Dims

# Samples a call. ONNX Runtime's bits depend on it, and on the optimisation level.
CHUNK = 1024
OPTIMISATION_LEVEL = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
# Below it, Sqrt is up to 3.6 units in the last place off and half of the outputs have other bits.
ONNXRUNTIME_AT_LEAST = (1, 21)
FILE_HASH = "file_sha256"
"""Key of a model's metadata: the SHA-256 of its file with zeros in this place."""
HASH_MARK = FILE_HASH.encode() + b'\x12B"'
"""What stands before it in the file: a text of 66 bytes, in quotation marks."""
FLOAT32 = "tensor(float)"
"""What ONNX Runtime calls the type of every input and output."""


def check_onnxruntime() -> None:
    """Raises AminnError where the ONNX Runtime that is installed rounds square roots wrongly."""
    if tuple(int(part) for part in ort.__version__.split(".")[:2]) < ONNXRUNTIME_AT_LEAST:
        wanted = ".".join(map(str, ONNXRUNTIME_AT_LEAST))
        raise AminnError(
            f"ONNX Runtime {ort.__version__} is installed, whose square roots are wrong in the last places; "
            f"{wanted} or later is needed: pip install 'onnxruntime>={wanted}'"
        )


def check_onnx(name: AnyPath, content: bytes) -> None:
    """Raise OutdatedError where the file `name` of a model is not what the checksum in it says."""
    check_bytes(name, content, HASH_MARK, "export the model again")


def onnx_session(model: AnyPath | bytes, threads: int, name: AnyPath = "ONNX model") -> ort.InferenceSession:
    """An ONNX Runtime session on so many threads; `name` is what messages call a model that is given as bytes.

    Raises AminnError if it is no model that ONNX Runtime can load, or is damaged.
    """
    check_onnxruntime()
    options = ort.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.graph_optimization_level = OPTIMISATION_LEVEL
    options.log_severity_level = 3  # not of a default that may be overridden
    source = model if isinstance(model, bytes) else read_bytes(model)
    name = name if isinstance(model, bytes) else model
    check_onnx(name, source)
    try:
        session = ort.InferenceSession(source, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common base of their own
        raise AminnError(f"{name}: ONNX Runtime cannot load it ({error})") from error
    try:  # ONNX Runtime passes on any bytes as texts
        given = (*session.get_inputs(), *session.get_overridable_initializers(), *session.get_outputs())
        _ = [value.name for value in given], session.get_modelmeta().custom_metadata_map
    except UnicodeDecodeError as error:
        raise AminnError(
            f"{name}: its names or metadata are not UTF-8 text ({error}); export the model again"
        ) from error
    return session


def check_graph(session: ort.InferenceSession, dims: Dims, name: AnyPath) -> None:
    """Raise AminnError where the graph of the model `name` takes or gives anything but what AMINN writes for a hand.

    Further outputs, as those of `aminn_debug.onnx`, are let pass.
    """
    more, taken = "export the model again", {value.name for value in session.get_inputs()}
    for kind, values, shapes in (
        ("input", session.get_inputs(), dims.inputs),
        ("output", session.get_outputs(), dims.outputs),
    ):
        found = {value.name: value for value in values}
        for own, shape in shapes.items():
            if own not in found:
                raise AminnError(f"{name}: its graph has no {kind} {own}; {more}")
            if found[own].type != FLOAT32:
                raise AminnError(f"{name}: its {kind} {own} is {found[own].type}, not {FLOAT32}; {more}")
            is_now = found[own].shape
            # the first is a name, or unknown, where rows may be any number
            if is_now[1:] != [*shape] or not is_now or isinstance(is_now[0], int):
                texts = (f"({', '.join(map(str, s))})" for s in (is_now, ("N", *shape)))
                raise AminnError(f"{name}: its {kind} {own} has the shape {', not '.join(texts)}; {more}")
    if unknown := sorted(taken - set(dims.inputs)):
        raise AminnError(f"{name}: its graph needs an input {unknown[0]}, which no model has; {more}")


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
    n = len(inputs["q"])
    if n == 0:  # one row of a default, as theta's, does not go with none
        inputs = {name: np.zeros((1, *rows.shape[1:]), rows.dtype) for name, rows in inputs.items()}
    out = in_chunks(lambda chunk: dict(zip(names, session.run(names, chunk), strict=True)), inputs)
    return {name: rows[:n] for name, rows in out.items()}
