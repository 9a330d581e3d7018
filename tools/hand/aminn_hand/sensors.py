"""What a controller may know beside the state: friction, the tool's weight, tensions of tendons. Absent is not zero.

Each is an array of one form everywhere (`Dims.sensors` has the sizes): whether it is known (0 or 1), then its values.
All zeros are nothing known; what stands behind a 0 has no meaning.

    friction        known, coefficient between fingertips and tool, its standard deviation
    tool_weight     known, force of gravity on the tool x, y, z, N, in H
    tendon_tension  known, tension of each tendon before the load, N, in the order of the hand; none without tendons
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aminn_base.errors import AminnError

from .hand import Array, Dims

FRICTION, TOOL_WEIGHT, TENDON_TENSION = "friction", "tool_weight", "tendon_tension"
UNITS = {FRICTION: "1", TOOL_WEIGHT: "N", TENDON_TENSION: "N"}
"""Of the values."""
NOMINAL_FRICTION = 0.75
"""Greatest tangential over normal force of a contact of which nothing is known."""
FRICTION_RANGE = (0.4, 1.1)
"""Of the tools that are simulated; its thirds are the classes."""
FRICTION_SPREAD = 0.3
"""Relative deviation of a coefficient that says as much as the range alone."""
CLASS_NAMES = ("low", "mid", "high")
_WIDTH = (FRICTION_RANGE[1] - FRICTION_RANGE[0]) / len(CLASS_NAMES)
CLASS_EDGES = tuple(FRICTION_RANGE[0] + k * _WIDTH for k in range(1, len(CLASS_NAMES)))
"""Between the classes; a coefficient on an edge is of the upper one."""
FRICTION_CLASSES: dict[str, tuple[float, float, float]] = {
    name: (1.0, FRICTION_RANGE[0] + (k + 0.5) * _WIDTH, _WIDTH / 12**0.5) for k, name in enumerate(CLASS_NAMES)
}
"""`friction` of each class: the middle of its third, and the deviation of a coefficient anywhere in it."""


DEFAULT_DEVIATION = 0.1
"""Of a coefficient whose standard deviation nobody tells, as a share of it."""


def class_of(coefficient: Array) -> NDArray[np.int64]:
    """The class that each coefficient is of, as an index into `CLASS_NAMES`."""
    return np.searchsorted(CLASS_EDGES, coefficient, side="right")


def trust(friction: Array) -> Array:
    """How much is known of friction (..., 3): r, (...), 1 where it is exact, 0 where nothing is."""
    known, coefficient, deviation = np.moveaxis(np.asarray(friction, float), -1, 0)
    share = deviation / (FRICTION_SPREAD * np.where(known > 0, coefficient, 1.0))
    return known / (1.0 + np.where(known > 0, share, 0.0) ** 2)


def _told_log(friction: Array) -> Array:
    coefficient = np.where(friction[..., 0] > 0, friction[..., 1], NOMINAL_FRICTION)
    return trust(friction) * np.log(coefficient / NOMINAL_FRICTION)


def told_friction(friction: Array) -> Array:
    """The coefficient (...) that the mechanics layer starts from: the nominal one as far as nothing is known."""
    return NOMINAL_FRICTION * np.exp(_told_log(np.asarray(friction, float)))


def sensed_numbers(dims: Dims, x: Mapping[str, Array], rows: int) -> Array:
    """What networks see of the sensors (rows, `Dims.sensed`), before it is normalised. Those not in `x` are unknown."""
    given = {name: np.asarray(x.get(name, np.zeros((rows, *shape))), float) for name, shape in dims.sensors.items()}
    friction = given.pop(FRICTION)
    parts = [trust(friction)[:, None], _told_log(friction)[:, None]]
    for value in given.values():
        known = value[:, :1]
        parts += [known, np.where(known > 0, value[:, 1:], 0.0)]
    return np.concatenate(parts, 1)


def faults(name: str, values: Array) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """(rows, what is wrong with them) of a sensor's values (n, size)."""
    known = values[:, 0]
    finite = np.logical_and.reduce(np.isfinite(values), axis=1)
    yield ~finite, f"{name} is not finite"
    yield ~np.isin(known, (0, 1)), f"{name}: known is neither 0 nor 1"
    if name == FRICTION:
        yield (known > 0) & (values[:, 1] <= 0), f"{name}: the coefficient is not positive"
        yield (known > 0) & (values[:, 2] < 0), f"{name}: the standard deviation is negative"


def in_full(name: str, value: ArrayLike, size: int) -> ArrayLike:
    """A sensor's array (..., size) of what may be said for short; what is no such is given back.

    friction: a coefficient, whose deviation is then `DEFAULT_DEVIATION` of it, one with its deviation (..., 2), or the
    name of a class. Of other sensors the values alone (..., size - 1), which are not known where all are NaN.
    """
    if isinstance(value, str):
        if name != FRICTION or value not in FRICTION_CLASSES:
            raise AminnError(f"{name} is {value!r}, expected {_expected(name)}")
        return FRICTION_CLASSES[value]
    try:
        told = np.asarray(value, float)
    except (TypeError, ValueError):
        return value
    if name == FRICTION and told.ndim == 0:
        told = np.stack([told, DEFAULT_DEVIATION * np.abs(told)])
    if told.ndim == 0 or told.shape[-1] != size - 1:
        return value
    unknown = np.isnan(told).all(-1, keepdims=True)
    return np.concatenate([~unknown, np.where(unknown, 0.0, told)], -1)


def _expected(name: str) -> str:
    return f"numbers, or {', '.join(CLASS_NAMES)}" if name == FRICTION else "numbers"
