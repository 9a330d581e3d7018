"""XLA by way of JAX: the graph node by node, compiled as a whole. Knows the operators of our graphs, and no others."""

from functools import reduce

import jax
import numpy as np
import onnx
from common import Arrays, Inside, Run, least_time, main
from jax import lax
from jax import numpy as jnp
from onnx import numpy_helper


def _axes(axes):
    return None if axes is None else tuple(int(a) for a in np.asarray(axes))


def _reduce(of):
    return lambda xp, a, x, axes=None: of(xp, x, {"axis": _axes(axes), "keepdims": bool(a.get("keepdims", 1))})


def _split(xp, a, x, sizes):
    return xp.split(x, np.cumsum(np.asarray(sizes))[:-1].tolist(), a.get("axis", 0))


def _pad(xp, a, x, pads, value=0.0, axes=None):
    pads = np.asarray(pads).reshape(2, -1).T
    width = [(0, 0)] * x.ndim
    for axis, pair in zip(range(x.ndim) if axes is None else _axes(axes), pads, strict=True):
        width[axis] = (int(pair[0]), int(pair[1]))
    return xp.pad(x, width, constant_values=value)


def _cast(xp, a, x):
    return xp.asarray(x).astype(onnx.helper.tensor_dtype_to_np_dtype(a["to"]))


def _shape(xp, a, x):
    return np.array(x.shape[a.get("start", 0) : a.get("end")], np.int64)


def _to_shape(x, shape):
    return [x.shape[i] if n == 0 else int(n) for i, n in enumerate(np.asarray(shape))]


OPERATORS = {
    "Abs": lambda xp, a, x: xp.abs(x),
    "Add": lambda xp, a, x, y: x + y,
    "Cast": _cast,
    "Concat": lambda xp, a, *x: xp.concatenate(x, a["axis"]),
    "Div": lambda xp, a, x, y: x / y,
    "Exp": lambda xp, a, x: xp.exp(x),
    "Expand": lambda xp, a, x, shape: xp.broadcast_to(x, np.broadcast_shapes(x.shape, tuple(np.asarray(shape)))),
    "Gather": lambda xp, a, x, i: xp.take(x, np.asarray(i), a.get("axis", 0)),
    "Greater": lambda xp, a, x, y: x > y,
    "GreaterOrEqual": lambda xp, a, x, y: x >= y,
    "Less": lambda xp, a, x, y: x < y,
    "Log": lambda xp, a, x: xp.log(x),
    "MatMul": lambda xp, a, x, y: xp.matmul(x, y),
    "Max": lambda xp, a, *x: reduce(xp.maximum, x),
    "Min": lambda xp, a, *x: reduce(xp.minimum, x),
    "Mul": lambda xp, a, x, y: x * y,
    "Neg": lambda xp, a, x: -x,
    "Pad": _pad,
    "ReduceL2": _reduce(lambda xp, x, how: xp.sqrt(xp.sum(x * x, **how))),
    "ReduceMax": _reduce(lambda xp, x, how: xp.max(x, **how)),
    "ReduceSum": _reduce(lambda xp, x, how: xp.sum(x, **how)),
    "ReduceSumSquare": _reduce(lambda xp, x, how: xp.sum(x * x, **how)),
    "Relu": lambda xp, a, x: xp.maximum(x, 0),
    "Reshape": lambda xp, a, x, shape: xp.reshape(x, np.asarray(shape) if a.get("allowzero") else _to_shape(x, shape)),
    "Shape": _shape,
    "Sigmoid": lambda xp, a, x: 1 / (1 + xp.exp(-x)),
    "Sign": lambda xp, a, x: xp.sign(x),
    "Split": _split,
    "Sqrt": lambda xp, a, x: xp.sqrt(x),
    "Squeeze": lambda xp, a, x, axes=None: xp.squeeze(x, _axes(axes)),
    "Sub": lambda xp, a, x, y: x - y,
    "Tanh": lambda xp, a, x: xp.tanh(x),
    "Transpose": lambda xp, a, x: xp.transpose(x, a["perm"]),
    "Unsqueeze": lambda xp, a, x, axes: xp.expand_dims(x, _axes(axes)),
    "Where": lambda xp, a, c, x, y: xp.where(c, x, y),
}
"""By name: (module, attributes, inputs) to output or outputs. The module is NumPy for what no input changes."""


def evaluate(graph, constants: Arrays, inputs: Arrays) -> Arrays:
    """All outputs of the graph."""
    values = {"": None, **constants, **inputs}
    for node in graph.node:
        given = [values[name] for name in node.input]
        attributes = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
        known = all(v is None or isinstance(v, (np.ndarray, np.generic)) for v in given)
        found = OPERATORS[node.op_type](np if known else jnp, attributes, *given)
        several = found if isinstance(found, (list, tuple)) else [found]
        values |= zip(node.output, several, strict=True)
    return {o.name: jnp.asarray(values[o.name]) for o in graph.output}


def load(model: str) -> tuple[Run, Inside]:
    graph = onnx.load(model).graph
    constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    names = [i.name for i in graph.input if i.name not in constants]  # sensors say nothing by default
    compiled = jax.jit(lambda values: evaluate(graph, constants, values))

    def run(values: Arrays) -> Arrays:
        return {name: np.asarray(v) for name, v in compiled({name: values[name] for name in names}).items()}

    def inside(samples: list[Arrays]) -> float:
        rows = {name: jnp.asarray(np.stack([sample[name] for sample in samples])) for name in names}
        one_by_one = jax.jit(lambda rows: lax.map(lambda values: evaluate(graph, constants, values), rows))
        return least_time(lambda _: jax.block_until_ready(one_by_one(rows)), samples) / len(samples)

    return run, inside


if __name__ == "__main__":
    main(load)
