#!/usr/bin/env bash
# ONNX Runtime 1.31.1: the same row gives other bits alone than in a batch, by a batched MatMul and by Log, Sin and Cos, whose
# result depends on the place in the tensor. A 2-D MatMul by constants, Exp, Tanh and Sqrt do not. Exits with 1 if that changes.
#
# Output seen:
#   onnxruntime 1.31.1: rows of 64 with other bits alone than in a batch
#     MatMul, 2-D      0
#     MatMul, batched  64
#     Log              10
#     Sin              7
#     Cos              7
#     Exp              0
#     Tanh             0
#     Sqrt             0
source "$(dirname "$0")/lib.bash"
in_environment onnxruntime==1.31.1 onnx==1.23.2 numpy==2.4.6 <<'PY'
import sys

import numpy as np
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper

rng = np.random.default_rng(0)
N = 64


def rows_that_differ(kind, shape, tensors=()):
    """Of N rows, how many have other bits alone than in the batch."""
    x = np.exp(rng.uniform(-3, 3, (N, *shape))).astype(np.float32)
    weights = [numpy_helper.from_array(value, f"w{i}") for i, value in enumerate(tensors)]
    node = helper.make_node(kind, ["x", *(w.name for w in weights)], ["y"])
    ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in (("x", ["N", *shape]), ("y", None))]
    graph = helper.make_graph([node], "g", ends[:1], ends[1:], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    batch = session.run(None, {"x": x})[0].reshape(N, -1)
    alone = np.concatenate([session.run(None, {"x": x[i : i + 1]})[0].reshape(1, -1) for i in range(N)])
    return int((batch != alone).any(1).sum())


found = {
    "MatMul, 2-D": rows_that_differ("MatMul", (26,), [rng.normal(size=(26, 64)).astype(np.float32)]),
    "MatMul, batched": rows_that_differ("MatMul", (1, 26), [rng.normal(size=(2, 1, 26, 64)).astype(np.float32)]),
} | {kind: rows_that_differ(kind, (5,)) for kind in ("Log", "Sin", "Cos", "Exp", "Tanh", "Sqrt")}
print(f"onnxruntime {ort.__version__}: rows of {N} with other bits alone than in a batch")
for kind, rows in found.items():
    print(f"  {kind:16} {rows}")
place = ("MatMul, batched", "Log", "Sin", "Cos")
sys.exit(not (all(found[kind] for kind in place) and not any(rows for kind, rows in found.items() if kind not in place)))
PY
