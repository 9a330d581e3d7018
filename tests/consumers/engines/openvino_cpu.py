"""OpenVINO, one thread, in float32; with --default-precision, in what it chooses for this processor."""

import sys

import openvino
from common import Arrays, Run, main


def load(model: str) -> Run:
    settings = {"INFERENCE_NUM_THREADS": 1}
    if "--default-precision" not in sys.argv:
        settings["INFERENCE_PRECISION_HINT"] = "f32"
    compiled = openvino.Core().compile_model(model, "CPU", settings)

    def run(inputs: Arrays) -> Arrays:
        found = compiled(inputs)
        return {output.get_any_name(): found[output].copy() for output in compiled.outputs}

    return run


if __name__ == "__main__":
    main(load)
