#!/usr/bin/env bash
# OpenVINO 2026.4.1 on a processor with AVX512_BF16 or AMX computes a float32 model in bfloat16, unless the hint
# INFERENCE_PRECISION_HINT is f32. On another processor this has nothing to show and says so. Exits with 1 if that changes.
#
# Output seen:
#   openvino 2026.4.1, default: computes in <Type: 'bfloat16'>, off by 4.0e-03
#   openvino 2026.4.1, {'INFERENCE_PRECISION_HINT': 'f32'}: computes in <Type: 'float32'>, off by 2.5e-07
source "$(dirname "$0")/lib.bash"
if ! grep -qwE 'avx512_bf16|amx_bf16' /proc/cpuinfo; then
  echo "Skipped: this processor has no bfloat16 instructions"
  exit 0
fi
in_environment openvino==2026.4.1 onnx==1.23.2 numpy==2.4.6 <<'PY'
import sys

import numpy as np
import onnx
import openvino
from onnx import TensorProto, helper, numpy_helper

rng = np.random.default_rng(0)
weights = [rng.normal(size=(64, 64)).astype(np.float32) / 8 for _ in range(2)]
tensors = [numpy_helper.from_array(value, f"w{i}") for i, value in enumerate(weights)]
ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, ["N", 64]) for n in ("x", "y")]
nodes = [helper.make_node("MatMul", ["x", "w0"], ["h"]), helper.make_node("MatMul", ["h", "w1"], ["y"])]
graph = helper.make_graph(nodes, "layers", ends[:1], ends[1:], tensors)
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8), "model.onnx")
x = rng.normal(size=(16, 64)).astype(np.float32)
exact = x.astype(np.float64) @ weights[0] @ weights[1]
errors = []
for settings in ({}, {"INFERENCE_PRECISION_HINT": "f32"}):
    compiled = openvino.Core().compile_model("model.onnx", "CPU", settings)
    kind = compiled.get_property("INFERENCE_PRECISION_HINT")
    errors.append(np.abs(compiled({"x": x})["y"] - exact).max() / np.abs(exact).max())
    print(f"openvino {openvino.__version__.split('-')[0]}, {settings or 'default'}: computes in {kind}, off by {errors[-1]:.1e}")
sys.exit(not (errors[0] > 1e-3 and errors[1] < 1e-5))
PY
