"""A small builder for ONNX graphs: named constants stored once, one call a node, deterministic names."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import TensorProto, helper, numpy_helper


class GraphBuilder:
    """Collects nodes and constants in the order of the calls, so that the same calls give the same bytes."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []
        self._constants: dict[tuple[str, tuple[int, ...], bytes], str] = {}
        self._names: Counter[str] = Counter()

    def _unique(self, name: str) -> str:
        """`name` the first time, then `name_1`, `name_2`..."""
        count = self._names[name]
        self._names[name] += 1
        return name if count == 0 else f"{name}_{count}"

    def constant(self, name: str, value: ArrayLike, dtype: type = np.float32) -> str:
        """Name of an initializer with this value; equal values share the first one's name."""
        array: NDArray = np.array(value, dtype=dtype, order="C")
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            self._constants[key] = self._unique(name)
            self.initializers.append(numpy_helper.from_array(array, self._constants[key]))
        return self._constants[key]

    def index(self, name: str, value: ArrayLike) -> str:
        """An int64 constant: axes, shapes, indices."""
        return self.constant(name, value, np.int64)

    def default(self, name: str, value: ArrayLike) -> None:
        """What an input is where nothing is given for it, which any caller may override."""
        self.initializers.append(numpy_helper.from_array(np.asarray(value, np.float32), name))

    def op(self, kind: str, *inputs: str, name: str, **attributes: Any) -> str:
        """Append a node with one output and return that output's name (`name`, made unique)."""
        output = self._unique(name)
        self.nodes.append(helper.make_node(kind, list(inputs), [output], name=f"node_{output}", **attributes))
        return output

    def split(self, value: str, sizes: list[int], axis: int, names: list[str]) -> list[str]:
        """Split along `axis` into pieces of these sizes."""
        outputs = [self._unique(name) for name in names]
        inputs = [value, self.index("split_sizes", sizes)]
        self.nodes.append(helper.make_node("Split", inputs, outputs, name=f"node_{outputs[0]}", axis=axis))
        return outputs

    def reshape(self, value: str, shape: list[int], name: str) -> str:
        """Reshape; a 0 keeps the dimension at its place, so that an empty batch passes."""
        return self.op("Reshape", value, self.index("shape", shape), name=name)

    def gather(self, value: str, indices: ArrayLike, axis: int, name: str) -> str:
        """Pick fixed positions along `axis`; a scalar index drops the axis."""
        return self.op("Gather", value, self.index("pick", indices), name=name, axis=axis)

    def reduce_sum(self, value: str, axis: int, name: str, keepdims: int = 1) -> str:
        """Sum over one axis."""
        return self.op("ReduceSum", value, self.index("axes", [axis]), name=name, keepdims=keepdims)

    def unsqueeze(self, value: str, axes: list[int], name: str) -> str:
        """Insert axes of length 1."""
        return self.op("Unsqueeze", value, self.index("axes", axes), name=name)

    def model(
        self,
        name: str,
        inputs: dict[str, tuple[int, ...]],
        outputs: dict[str, tuple[int, ...]],
        opset: int,
        ir_version: int,
        metadata: dict[str, str],
    ) -> onnx.ModelProto:
        """The finished float32 model; every input and output gets a leading dynamic dimension N."""

        def infos(shapes: dict[str, tuple[int, ...]]) -> list[onnx.ValueInfoProto]:
            return [helper.make_tensor_value_info(k, TensorProto.FLOAT, ["N", *s]) for k, s in shapes.items()]

        graph = helper.make_graph(self.nodes, name, infos(inputs), infos(outputs), self.initializers)
        opsets = [helper.make_opsetid("", opset)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=ir_version, producer_name="aminn")
        helper.set_model_props(model, metadata)
        return model
