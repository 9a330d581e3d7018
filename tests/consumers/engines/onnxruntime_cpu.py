"""ONNX Runtime, one thread."""

import onnxruntime as ort
from common import Run, main


def load(model: str) -> Run:
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    return lambda inputs: dict(zip(names, session.run(names, inputs), strict=True))


if __name__ == "__main__":
    main(load)
