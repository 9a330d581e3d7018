"""Optional sensors of a data set: what they could tell, what an evaluation tells of it, what a training step draws.

All are arrays of `Dataset.samples` in the form of `aminn_hand.sensors`. Simulated data have none of them until one of
these functions says what is told; measured data have what was measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aminn_base.errors import AminnError
from aminn_hand.sensors import (
    CLASS_EDGES,
    CLASS_NAMES,
    FRICTION,
    FRICTION_CLASSES,
    TENDON_TENSION,
    TOOL_WEIGHT,
    class_of,
    faults,
)

from ..model.config import SensorDraws
from .dataset import ANEW, Dataset

Array = NDArray[np.float64]
Sensors = dict[str, Array]
_CLASSES = np.array([FRICTION_CLASSES[name] for name in CLASS_NAMES])
SEED = 0
"""Of what is drawn once and for all: for normalisation and validation."""


@dataclass(frozen=True)
class Told:
    """What is told of each load case, and how well. Noise is drawn once a data set."""

    friction: Literal["value", "class"] | None = None
    """The coefficient, or low, mid or high."""
    friction_noise: float = 0.0
    """Standard deviation of the coefficient as a share of it; the model is told it too."""
    weight: bool = False
    """The tool's."""
    weight_noise_N: float = 0.0
    """Standard deviation of each component."""
    tension: bool = False
    """Of the tendons."""
    tension_noise: float = 0.0
    """Standard deviation as a share."""

    @staticmethod
    def parse(text: str) -> Told:
        """What words joined by + say, as in "class+weight": friction or class, weight, tension; or nothing, or all."""
        words = text.split("+")
        if text in PRESETS:
            return PRESETS[text]
        unknown = [word for word in words if word not in _WORDS]
        if unknown or len(set(words)) < len(words) or {"friction", "class"} <= set(words):
            raise AminnError(
                f"sensors {text!r}: expected nothing, all, or some of {', '.join(_WORDS)} joined by +, "
                "of friction and class one"
            )
        return Told(**{key: value for word in words for key, value in _WORDS[word].items()})  # type: ignore[arg-type]

    def __str__(self) -> str:
        parts = {"friction": self.friction == "value", "class": self.friction == "class"}
        parts |= {"weight": self.weight, "tension": self.tension}
        return "+".join(word for word, said in parts.items() if said) or "nothing"


_WORDS: dict[str, dict[str, object]] = {
    "friction": {"friction": "value"},
    "class": {"friction": "class"},
    "weight": {"weight": True},
    "tension": {"tension": True},
}
PRESETS = {
    "nothing": Told(),
    "class+weight": Told("class", weight=True),
    "friction+weight": Told("value", weight=True),
    "all": Told("value", weight=True, tension=True),
}


def truth(data: Dataset) -> Sensors:
    """All that could be told of each sample (n, .): of measured data what was measured, of simulated ones everything.

    Sensors that the data say nothing of are missing.
    """
    if data.measured:
        return {name: data.samples[name] for name in data.hand.dims.sensors if name in data.samples}
    grasps, rows, found = data.grasps, data.grasp_rows(), {}
    if "friction" in grasps:
        found[FRICTION] = np.stack([grasps["friction"], np.zeros(len(grasps["friction"]))], 1)
    if {"tool_mass_kg", "gravity_m_s2"} <= grasps.keys():
        found[TOOL_WEIGHT] = grasps["tool_mass_kg"][:, None] * grasps["gravity_m_s2"]
    if data.hand.dims.tendons and "tendon_tension_N" in grasps:
        found[TENDON_TENSION] = grasps["tendon_tension_N"]
    whole = {name: np.insert(np.asarray(values, float), 0, 1.0, axis=1) for name, values in found.items()}
    for name, values in whole.items():
        for wrong, fault in faults(name, values):
            if wrong.any():
                raise AminnError(f"{fault} in grasp {grasps['grasp_id'][np.argmax(wrong)]}; {ANEW}")
    return {name: values[rows] for name, values in whole.items()}


def tells_all(data: Dataset) -> bool:
    """Whether the data can tell every sensor of every sample."""
    found = truth(data)
    return all(name in found and (found[name][:, 0] > 0).all() for name in data.hand.dims.sensors)


def with_sensors(data: Dataset, told: Sensors) -> Dataset:
    """The data with these sensors and no others."""
    others = {name: values for name, values in data.samples.items() if name not in data.hand.dims.sensors}
    return replace(data, samples=others | told)


def sensed(data: Dataset, told: Told, seed: int = 0) -> Dataset:
    """The data with what is told of them; of measured ones where it was measured.

    Raises AminnError where the data say nothing of what is to be told.
    """
    true, rng, n = truth(data), np.random.default_rng(seed), len(data)
    wanted = {FRICTION: told.friction is not None, TOOL_WEIGHT: told.weight, TENDON_TENSION: told.tension}
    found = {name: true[name].copy() for name in data.hand.dims.sensors if wanted[name] and name in true}
    if missing := [name for name, is_wanted in wanted.items() if is_wanted and name not in found]:
        if missing == [TENDON_TENSION] and not data.hand.dims.tendons:
            raise AminnError(f"sensors {told}: hand {data.hand.name} has no tendons; leave tension out")
        raise AminnError(f"sensors {told}: the data say nothing of {', '.join(missing)}; leave it out")
    noise = {name: rng.normal(size=(n, size - 1)) for name, (size,) in data.hand.dims.sensors.items()}
    if told.friction == "class":
        known = found[FRICTION][:, :1]
        found[FRICTION] = known * _CLASSES[class_of(found[FRICTION][:, 1])]
    elif told.friction == "value":
        found[FRICTION][:, 1:] = _less_sure(found[FRICTION][:, 1:], told.friction_noise, noise[FRICTION][:, 0])
    if told.weight:
        found[TOOL_WEIGHT][:, 1:] += told.weight_noise_N * noise[TOOL_WEIGHT]
    if told.tension:
        found[TENDON_TENSION][:, 1:] *= 1 + told.tension_noise * noise[TENDON_TENSION]
    return with_sensors(data, found)


def _less_sure(friction: Array, share: float, noise: Array) -> Array:
    """Coefficients with their deviations (n, 2) after an error of `share` of the coefficient."""
    value = friction[:, 0] * np.exp(share * noise)
    return np.stack([value, np.hypot(friction[:, 1], share * value)], 1)


def draw(x: dict[str, Tensor], draws: SensorDraws, rng: torch.Generator) -> dict[str, Tensor]:
    """Inputs (n) with as much of their sensors as one training step knows, and as well.

    What is exact becomes a class or gets an error, what has a deviation already does not; what is not known stays so.
    """
    n, device, found = len(x["q"]), x["q"].device, {}

    def uniform() -> Tensor:
        return torch.rand(n, generator=rng).to(device)  # the generator's, whatever the device

    def normal(like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=rng).to(device)

    if FRICTION in x:
        known, value, deviation = x[FRICTION].unbind(-1)
        told, as_class = uniform() < draws.friction, uniform() < draws.friction_class
        share = draws.friction_deviation * uniform() ** 2
        noisy = value * torch.exp(share * normal(value))
        measured = torch.stack([known, noisy, share * noisy], -1)
        measured = torch.where((deviation > 0)[:, None], x[FRICTION], measured)
        edges = torch.tensor(CLASS_EDGES, dtype=value.dtype, device=device)
        classes = torch.as_tensor(_CLASSES, dtype=value.dtype, device=device)[
            torch.bucketize(value.contiguous(), edges, right=True)
        ]
        seen = torch.where((as_class & (deviation == 0))[:, None], classes, measured)
        found[FRICTION] = seen * (known * told)[:, None]
    if TOOL_WEIGHT in x:
        known, weight = x[TOOL_WEIGHT][:, :1], x[TOOL_WEIGHT][:, 1:]
        told, share = uniform() < draws.weight, uniform()
        weight = weight + draws.weight_noise_N * share[:, None] * normal(weight)
        found[TOOL_WEIGHT] = torch.cat([known, weight * known], -1) * told[:, None]
    if TENDON_TENSION in x:
        known, tension = x[TENDON_TENSION][:, :1], x[TENDON_TENSION][:, 1:]
        told = uniform() < draws.tension
        tension = tension * (1 + draws.tension_noise * normal(tension))
        found[TENDON_TENSION] = torch.cat([known, tension * known], -1) * told[:, None]
    return x | found


def drawn(data: Dataset, draws: SensorDraws) -> Dataset:
    """The data with sensors as a training step knows them, drawn once: the same for the same data."""
    sensors = {name: torch.as_tensor(values) for name, values in truth(data).items()}
    rng = torch.Generator().manual_seed(SEED)
    found = draw(sensors | {"q": torch.as_tensor(data.samples["q"])}, draws, rng)
    return with_sensors(data, {name: found[name].double().numpy() for name in sensors})
