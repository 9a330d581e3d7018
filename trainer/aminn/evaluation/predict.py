"""Run a model over a data set."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from ..data.dataset import Dataset

CHUNK = 4096


def predict(model: nn.Module, dataset: Dataset, dtype: torch.dtype = torch.float32) -> dict[str, NDArray[np.float64]]:
    """The model's outputs over all samples, as float64. `dtype` is that of the inputs; the model must match it."""
    x = dataset.inputs(dtype)
    with torch.no_grad():
        parts = [model(**{k: v[i : i + CHUNK] for k, v in x.items()}) for i in range(0, len(dataset), CHUNK)]
    return {name: torch.cat([p[name] for p in parts]).double().numpy() for name in parts[0]}
