"""tinygrad on the processor: it compiles C by $CC, which has to be clang, and takes a quarter of a second per call."""

from common import Arrays, Run, main
from tinygrad import Tensor
from tinygrad.nn.onnx import OnnxRunner


def load(model: str) -> Run:
    runners: dict[int, OnnxRunner] = {}  # by batch size: a runner keeps that of its first call

    def run(values: Arrays) -> Arrays:
        n = len(values["q"])
        if n not in runners:
            runners[n] = OnnxRunner(model)
        found = runners[n]({name: Tensor(value, device="CPU") for name, value in values.items()})
        return {name: value.numpy() for name, value in found.items()}

    return run


if __name__ == "__main__":
    main(load, alone=8)
