"""MNN. Its program mnnconvert installs a package for sending logs by pip; the module below it converts without."""

import tempfile
from pathlib import Path

import _tools
import MNN.expr
import MNN.nn
import numpy as np
from common import Arrays, Run, main

INPUTS = ["q", "x_ht", "w_e", "contacts", "j_x", "j_q"]
OUTPUTS = ["p_stable", "dx_ht", "k_x", "gate"]


def load(model: str) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "model.mnn")
        _tools.mnnconvert(["mnnconvert", "-f", "ONNX", "--modelFile", model, "--MNNModel", file, "--bizCode", "none"])
        net = MNN.nn.load_module_from_file(file, INPUTS, OUTPUTS)

    def run(values: Arrays) -> Arrays:
        places = []
        for name in INPUTS:
            place = MNN.expr.placeholder(list(values[name].shape), MNN.expr.NCHW, MNN.expr.float)
            place.write(values[name].ravel().tolist())
            places.append(place)
        found = net.forward(places)
        if len(found) != len(OUTPUTS):
            raise RuntimeError(f"its converter succeeds, the model computes {len(found)} of {len(OUTPUTS)} outputs")
        return {name: np.array(value.read()).reshape(value.shape) for name, value in zip(OUTPUTS, found, strict=True)}

    return run


if __name__ == "__main__":
    main(load)
