"""jaxonnxruntime."""

import numpy as np
import onnx
from common import Arrays, Run, main
from jaxonnxruntime import backend


def load(model: str) -> Run:
    proto = onnx.load(model)
    prepared = backend.Backend.prepare(proto)

    def run(values: Arrays) -> Arrays:
        found = prepared.run([values[i.name] for i in proto.graph.input])
        return {o.name: np.asarray(value) for o, value in zip(proto.graph.output, found, strict=True)}

    return run


if __name__ == "__main__":
    main(load)
