"""tract, which names an output after the node that computes it."""

import numpy as np
import tract
from common import Arrays, Run, main


def load(model: str) -> Run:
    net = tract.onnx().load(model)
    inputs = [net.input_name(i) for i in range(net.input_count())]
    outputs = [net.output_name(i).removeprefix("node_") for i in range(net.output_count())]
    runnable = net.into_model().into_runnable()

    def run(values: Arrays) -> Arrays:
        found = runnable.run([np.ascontiguousarray(values[name]) for name in inputs])
        return {name: value.to_numpy() for name, value in zip(outputs, found, strict=True)}

    return run


if __name__ == "__main__":
    main(load)
