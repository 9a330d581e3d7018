"""The evaluator of the package onnx, which computes each operator in NumPy."""

import numpy as np
import onnx
from common import Arrays, Run, main
from onnx.reference import ReferenceEvaluator


def load(model: str) -> Run:
    evaluator = ReferenceEvaluator(onnx.load(model))
    names = evaluator.output_names

    def run(values: Arrays) -> Arrays:
        with np.errstate(all="ignore"):  # its Sigmoid overflows on the branch that it does not take
            return dict(zip(names, evaluator.run(names, values), strict=True))

    return run


if __name__ == "__main__":
    main(load)
