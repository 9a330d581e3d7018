"""Weights in half the flash, float16, or in a quarter, int8, with what that costs in accuracy.

Only the weight matrices are stored so, and the runtime computes in float32 with what they stand for. The ONNX model
gets the same rounded values, so all files of an export still agree with each other.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from aminn.evaluation.metrics import holds
from aminn_base.errors import AminnError

from ..files.bin_model import BinModel
from ..files.layout import in_steps, of_steps
from ..files.tables import Exported
from ..samples.reference import Reference
from .verify import dx_figures

LARGEST = float(np.finfo(np.float16).max)


def float16_model(exported: Exported) -> BinModel:
    """The model with its weights rounded to float16. Raises AminnError where one is too large for it."""
    tensors = {}
    for name, value in exported.tensors.items():
        if name.endswith("_w"):
            if np.abs(value).max(initial=0.0) > LARGEST:
                raise AminnError(f"export: {name} holds a weight beyond {LARGEST:g}, the largest float16; keep float32")
            value = value.astype(np.float16).astype(np.float32)
        tensors[name] = value
    return BinModel(dict(exported.meta) | {"weights": "float16"}, tensors)


def int8_model(exported: Exported) -> BinModel:
    """The model with its weights rounded to 127 steps to either side, of a size of each output's own."""
    tensors = {
        name: of_steps(*in_steps(value)) if name.endswith("_w") else value for name, value in exported.tensors.items()
    }
    return BinModel(dict(exported.meta) | {"weights": "int8"}, tensors)


ROUNDED: dict[str, Callable[[Exported], BinModel]] = {"float16": float16_model, "int8": int8_model}


def rounding_error(exact: Exported, rounded: Exported, inputs: dict[str, NDArray[np.float32]]) -> dict[str, float]:
    """What the rounding of the weights changes in the float64 outputs, on the given samples."""
    a, b = Reference(exact)(inputs), Reference(rounded)(inputs)
    figures = dx_figures(b["dx_ht"], a["dx_ht"], float(exact.meta["length_scale"]))
    decided = [holds(out["p_stable"], exact.meta["tau"]) for out in (a, b)]
    return {
        "dx_relative_median": float(figures["dx_relative_median"]),
        "dx_relative_p99": float(figures["dx_relative_p99"]),
        "dx_relative_max": float(figures["dx_relative_max"]),
        "p_stable_median": float(np.median(np.abs(a["p_stable"] - b["p_stable"]))),
        "p_stable_max": float(np.abs(a["p_stable"] - b["p_stable"]).max()),
        "decisions_different": float((decided[0] != decided[1]).sum()),
    }
