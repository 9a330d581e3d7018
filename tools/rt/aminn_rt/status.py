"""Status codes of a row (aminn_rt.h), and the runtime's rules for a state that can be predicted from, in NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from aminn_hand.sensors import UNITS, faults
from aminn_hand.theta import theta_bounds

NORMAL_TOLERANCE = 1e-3
"""By how much the length of a contact's normal may differ from 1."""
MAX_ROTATION_RAD = np.pi * (1 + 1e-3)


class Status(IntEnum):
    """Why a row cannot be predicted from."""

    OK = 0
    NONFINITE = -4
    CONTACT_FLAG = -5
    NORMAL = -6
    ROTATION = -7
    NO_CONTACT = -8
    NUMERIC = -9
    CALIBRATION = -24
    SENSORS = -25
    LIMITS = -26


def statuses(inputs: Mapping[str, NDArray]) -> NDArray[np.int32]:
    """What the runtime says to inputs, theta and sensors by name, one row per state (N): all but NUMERIC.

    What is wrong with theta goes before all else.
    """
    with np.errstate(over="ignore"):
        x = {name: np.asarray(values, np.float32) for name, values in inputs.items()}
    theta, contacts = x.pop("theta", np.zeros((len(x["q"]), 0), np.float32)), x["contacts"].astype(np.float64)
    sensors = [wrong for name in UNITS if name in x for wrong, _ in faults(name, x.pop(name).astype(np.float64))]
    flag = contacts[..., 0]
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(contacts[..., 4:7], axis=-1)
        rules = (
            (Status.SENSORS, np.any([np.zeros(len(contacts), bool), *sensors], 0)),
            (Status.NO_CONTACT, ~(flag > 0).any(1)),
            (Status.ROTATION, np.linalg.norm(x["x_ht"][:, 3:].astype(np.float64), axis=1) > MAX_ROTATION_RAD),
            (Status.NORMAL, ((flag > 0) & ~(np.abs(length - 1) <= NORMAL_TOLERANCE)).any(1)),
            (Status.CONTACT_FLAG, ((flag < 0) | (flag > 1)).any(1)),
            (Status.NONFINITE, ~np.all([np.isfinite(v).all(tuple(range(1, v.ndim))) for v in x.values()], 0)),
            (Status.CALIBRATION, (np.abs(theta) > theta_bounds(theta.shape[1], x["q"].shape[1])).any(1)),
            (Status.NONFINITE, ~np.isfinite(theta).all(1)),
        )
    found = np.zeros(len(x["q"]), np.int32)
    for status, bad in rules:  # the last one goes before all others
        found[bad] = status
    return found
