#!/usr/bin/env bash
# ONNX Runtime's quantize_dynamic (1.31.1): the activations of a whole batch share one scale, so that what a row gives depends
# on the rows beside it: a small row beside a large one loses its digits. Exits with 1 if that changes.
#
# Output seen:
#   onnxruntime 1.31.1: the same row is off by 1.1% alone, by 45% beside one 100 times as large
source "$(dirname "$0")/lib.bash"
in_environment onnxruntime==1.31.1 onnx==1.23.2 numpy==2.4.6 sympy==1.14.0 <<'PY'
import sys

import numpy as np
import onnx
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import QuantType, quantize_dynamic

rng = np.random.default_rng(0)
weight = numpy_helper.from_array(rng.normal(size=(26, 64)).astype(np.float32), "w")
ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in (("x", ["N", 26]), ("y", ["N", 64]))]
graph = helper.make_graph([helper.make_node("MatMul", ["x", "w"], ["y"])], "layer", ends[:1], ends[1:], [weight])
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8), "plain.onnx")
quantize_dynamic("plain.onnx", "quantized.onnx", weight_type=QuantType.QInt8)
plain, quantized = (
    ort.InferenceSession(file, providers=["CPUExecutionProvider"]) for file in ("plain.onnx", "quantized.onnx")
)
small = rng.normal(size=(1, 26)).astype(np.float32)
batch = np.concatenate([small, 100 * rng.normal(size=(1, 26)).astype(np.float32)])
exact = plain.run(None, {"x": small})[0][0]
alone, beside = (quantized.run(None, {"x": x})[0][0] for x in (small, batch))
errors = [np.linalg.norm(y - exact) / np.linalg.norm(exact) for y in (alone, beside)]
print(f"onnxruntime {ort.__version__}: the same row is off by {errors[0]:.1%} alone, by {errors[1]:.0%} beside one 100 times as large")
sys.exit(not (errors[0] < 0.05 and errors[1] > 0.2))
PY
