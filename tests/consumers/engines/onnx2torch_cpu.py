"""onnx2torch, without torchvision, of which the model needs nothing."""

import sys
from unittest.mock import MagicMock

import onnx
import torch
from common import Arrays, Run, main

sys.modules |= {name: MagicMock() for name in ("torchvision", "torchvision.ops")}


def load(model: str) -> Run:
    import onnx2torch

    graph, module = onnx.load(model).graph, onnx2torch.convert(model)

    def run(values: Arrays) -> Arrays:
        with torch.no_grad():
            found = module(*(torch.from_numpy(values[i.name]) for i in graph.input))
        return {o.name: value.numpy() for o, value in zip(graph.output, found, strict=True)}

    return run


if __name__ == "__main__":
    main(load)
