"""AMINN trainer: the analytical-model-informed network, its baseline, training and evaluation.

Rooms, each above those before it: `hand` (what a model needs of a hand), `model` (mechanics layer and networks),
`data`, `evaluation`, `training`, `calibration` (theta of a hand from pushes), `prediction`, `pages`. Data comes in
through `data.dataset`; a trained model goes out through `model.checkpoint`, and is used through `load`:

    import aminn

    model = aminn.load("build/runs/aminn")
    result = model.predict("pushes.csv")
    result.holds, result.dx_ht
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .prediction.predictor import Predictor

__version__ = "0.1.0"


def load(path: str | os.PathLike[str], engine: str | None = None) -> Predictor:
    """A trained model that predicts from tables and arrays.

    path: a run of `aminn train`, a folder of `aminn export`, or an `aminn.onnx` or `aminn_model.bin` in one.
    engine: "torch" (of a run), "onnx" (ONNX Runtime) or "runtime" (the compiled runtime, whose numbers are those of the
    controller); None: torch of a run, runtime of an export.

    Raises AminnError (`aminn_base.errors`) that says what is wrong.
    """
    from .prediction.predictor import Predictor  # the version alone needs no PyTorch

    return Predictor(path, engine)
