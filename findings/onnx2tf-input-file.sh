#!/usr/bin/env bash
# onnx2tf 1.29.24 writes over the ONNX file that it is given to convert. Exits with 1 if that changes.
#
# Output seen:
#   onnx2tf 1.29.24, exit status 0: its input had 2 nodes and has 2, other bytes than before
source "$(dirname "$0")/lib.bash"
in_environment onnx2tf==1.29.24 <<'PY'
import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

weight = numpy_helper.from_array(np.eye(8, dtype=np.float32), "w")
ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, ["N", 8]) for n in ("x", "y")]
nodes = [helper.make_node("MatMul", ["x", "w"], ["h"]), helper.make_node("Identity", ["h"], ["y"])]
graph = helper.make_graph(nodes, "layer", ends[:1], ends[1:], [weight])
file = Path("model.onnx")
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8), file)
before = [hashlib.sha256(file.read_bytes()).hexdigest(), len(nodes)]
program = Path(sys.executable).parent / "onnx2tf"
done = subprocess.run([program, "-i", file, "-o", "converted"], capture_output=True, text=True)
after = [hashlib.sha256(file.read_bytes()).hexdigest(), len(onnx.load(file).graph.node)]
print(f"onnx2tf 1.29.24, exit status {done.returncode}: its input had {before[1]} nodes and has {after[1]},", end=" ")
print("other bytes than before" if after != before else "the same bytes as before")
sys.exit(after == before)
PY
