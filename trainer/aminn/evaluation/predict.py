"""Run a model over a data set."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.theta import Theta

from ..data.dataset import Dataset
from ..hand.closure import closure
from ..model.baseline import Mlp
from ..model.network import Aminn

Array = NDArray[np.float64]
CHUNK = 4096


def predict(model: nn.Module, dataset: Dataset, dtype: torch.dtype = torch.float32) -> dict[str, Array]:
    """The model's outputs over all samples, as float64. `dtype` is that of the inputs; the model must match it.

    The model gets theta and sensors where the samples have them.
    """
    return run_model(model, dataset.inputs(dtype))


def run_model(model: nn.Module, x: dict[str, torch.Tensor]) -> dict[str, Array]:
    """The model's outputs, as float64, for inputs in the precision of its weights."""
    n = len(x["q"])
    with torch.no_grad():
        parts = [model(**{k: v[i : i + CHUNK] for k, v in x.items()}) for i in range(0, max(n, 1), CHUNK)]
    return {name: torch.cat([p[name] for p in parts]).double().numpy() for name in parts[0]}


def true_states(
    hand: Hand,
    q: Array,
    x_ht: Array,
    w_e: Array,
    contacts: Array,
    theta: Array | None = None,
    sensors: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Inputs of a model, by `Dims.inputs`, from measured states, as `predict_states` takes them.

    theta comes as (n, P), and is left out where it is None; sensors come as (n, ...), those that are given. Raises
    AminnError for an array of another shape.
    """
    x = {"q": q, "x_ht": x_ht, "w_e": w_e, "contacts": contacts}
    x = {name: np.asarray(value, np.float64) for name, value in x.items()}
    n = len(x["q"]) if x["q"].ndim else 0
    for name, value in x.items():
        if value.shape != (n, *hand.dims.inputs[name]):
            raise AminnError(f"{name} has shape {value.shape}, expected {(n, *hand.dims.inputs[name])}")
    for name, values in (sensors or {}).items():
        if name not in hand.dims.sensors:
            known = ", ".join(hand.dims.sensors)
            raise AminnError(f"{name} is no sensor of hand {hand.name}; there are {known}")
        x[name] = _of_each(name, values, n, hand.dims.sensors[name][0])
    if theta is not None:
        x["theta"] = _of_each("theta", theta, n, len(Theta(hand)))
        x["q"], x["contacts"] = Theta(hand).corrected(x["theta"], x["q"], x["contacts"])
    x["j_x"], x["j_q"] = closure(hand, x["q"], x["x_ht"], x["contacts"])
    return x


def _of_each(name: str, values: Array, n: int, size: int) -> Array:
    """What is told of all states (size) or of each (n, size) as (n, size)."""
    told = np.asarray(values, np.float64)
    if told.shape not in ((size,), (n, size)):
        raise AminnError(f"{name} has shape {told.shape}, expected {(size,)} or {(n, size)}")
    return np.broadcast_to(told, (n, size)).copy()


def predict_states(
    model: Aminn | Mlp,
    q: Array,
    x_ht: Array,
    w_e: Array,
    contacts: Array,
    theta: Array | None = None,
    sensors: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """The model's outputs for measured states, as float64: q (n, J), x_ht (n, 6), w_e (n, 6), contacts (n, B, 8).

    theta (P) or (n, P): joint angles and contacts are corrected by it, the closure is computed from them in float64,
    then the model is run, in the precision of its weights. None is nominal. sensors: those that are there, by name, in
    the form of `aminn_hand.sensors`, a row or one for each state.
    """
    x = true_states(model.hand, q, x_ht, w_e, contacts, theta, sensors)
    dtype = next(model.parameters()).dtype
    return run_model(model, {name: torch.as_tensor(value).to(dtype) for name, value in x.items()})
