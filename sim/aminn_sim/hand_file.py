"""The hand file: which MJCF model the simulation uses, how its fingertips touch, and its synergy space."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_toml

from . import _core
from .errors import SimulationError
from .mjcf import NOWHERE, ModelFiles, read_model

N_JOINT = _core.DIMENSIONS[2]
AXES = ("size", "spread", "curl")
CONTACT_MODELS = ("point", "soft_finger")
OF_THE_DESCRIPTION = ("branch", "palm_normal", "tool_axis", "length_m", "mirror")
Array = NDArray[np.float64]


def default_hand_file() -> Path:
    """`hand.toml` inside the installed package, or in the source tree of an editable installation."""
    here = Path(__file__)
    candidates = [here.parent / "models", here.parents[1] / "models", Path(_core.__file__).parent / "models"]
    for folder in candidates:
        if (folder / "hand.toml").is_file():
            return folder / "hand.toml"
    raise SimulationError(f"hand.toml is in none of {', '.join(map(str, candidates))}; install the package again")


@dataclass(frozen=True)
class HandFile:
    """A checked hand file. Arrays are float64."""

    path: Path
    name: str
    scene: Path
    """MJCF of the hand and one tool."""
    contact_model: str
    """`point`: a contact passes on a force. `soft_finger`: and a moment about its normal."""
    torsional_friction_m: float
    """Of soft fingers: greatest moment over normal force."""
    neutral_rad: Array
    """(8) o of psi = ((q - o) A) * delta."""
    columns: Array
    """(3, 8) columns of A, one row a synergy axis: size, spread, curl."""
    delta: Array
    """(3) 1/rad."""
    ranges: Array
    """(3, 2) sampled range of psi."""
    text: bytes
    """The hand file's own content."""
    model: ModelFiles
    """Content of every file that the scene is made of, as it was when the hand file was read."""

    def simulator(self) -> _core.Simulator:
        """The compiled hand. Raises SimulationError if the model or the synergy range cannot be used."""
        torsional = self.torsional_friction_m if self.contact_model == "soft_finger" else 0.0
        low, high = np.ascontiguousarray(self.ranges.T)
        try:
            simulator = _core.Simulator(
                self.model.by_name(),
                self.scene.name,
                torsional,
                self.neutral_rad,
                list(self.columns),
                self.delta,
                low,
                high,
            )
        except _core.MujocoError as error:
            why = str(error).replace(NOWHERE, f"{self.scene.parent}/")
            raise SimulationError(f"{self.path}: the model that `scene` names cannot be used: {why}") from error
        if self.model.lost:
            raise SimulationError(
                f"{self.path}: the model that `scene` names cannot be used: {self.model.lost[0]} cannot be followed, "
                "so what the engine reads would not be known; name files in plain XML, relative to the scene"
            )
        self._check_reach(simulator)
        return simulator

    def _check_reach(self, simulator: _core.Simulator) -> None:
        """Every corner of the sampled range must be a posture within the joints' limits."""
        hand = simulator.hand()
        order = [(b, c) for b, joints in enumerate(hand["branch_joints"]) for c, j in enumerate(joints) if j >= 0]
        low, high = (np.array([hand[key][b][c] for b, c in order]) for key in ("joint_low_rad", "joint_high_rad"))
        for psi in itertools.product(*self.ranges):
            q = simulator.posture_of(np.array(psi))
            beyond = np.flatnonzero((q < low) | (q > high))
            if len(beyond):
                j = int(beyond[0])
                at = ", ".join(f"{axis} {value:g}" for axis, value in zip(AXES, psi, strict=True))
                raise SimulationError(
                    f"{self.path}: synergy.axes.range cannot be reached: at {at} joint {hand['joints'][j]} is at "
                    f"{q[j]:.3f} rad, its limits in the model are {low[j]:g} to {high[j]:g}; narrow the ranges"
                )

    def largest_gap_m(self, simulator: _core.Simulator) -> float:
        """Widest distance between the fingertips across the pinch within the sampled range."""
        return max(simulator.gap(np.array(psi)) for psi in itertools.product(*self.ranges))

    def model_hashes(self) -> dict[str, str]:
        """SHA-256 of the hand file and of every file that its scene is made of, by name."""
        content = self.model.by_name() | {self.path.name: self.text}
        return {name: hashlib.sha256(content[name]).hexdigest() for name in content}

    def files(self) -> list[Path]:
        """The hand file and every file that its scene is made of."""
        return [self.path, *self.model.content]

    def as_dict(self) -> dict:
        """What a manifest keeps of it."""
        return {
            "name": self.name,
            "contact_model": self.contact_model,
            "torsional_friction_m": self.torsional_friction_m if self.contact_model == "soft_finger" else 0.0,
            "synergy": {
                "axes": list(AXES),
                "neutral_rad": self.neutral_rad.tolist(),
                "columns": self.columns.tolist(),
                "delta": self.delta.tolist(),
                "range": self.ranges.tolist(),
            },
        }


class _Reader:
    """Fields of a TOML table, with messages that name file and field."""

    def __init__(self, path: Path, table: dict, where: str = "") -> None:
        self.path, self.where = path, where
        if not isinstance(table, dict):
            raise SimulationError(f"{path}: {where} is {table!r}, expected a table")
        self.rest = dict(table)

    def fail(self, key: str, problem: str) -> SimulationError:
        return SimulationError(f"{self.path}: {self.where + '.' if self.where else ''}{key} {problem}")

    def take(self, key: str, kind: type | tuple[type, ...], what: str) -> object:
        if key not in self.rest:
            raise self.fail(key, f"is missing; expected {what}")
        value = self.rest.pop(key)
        if isinstance(value, bool) or not isinstance(value, kind):
            raise self.fail(key, f"is {value!r}, expected {what}")
        return value

    def text(self, key: str) -> str:
        return str(self.take(key, str, "a text"))

    def number(self, key: str) -> float:
        value = float(self.take(key, (int, float), "a number"))  # type: ignore[arg-type]
        if not (np.isfinite(value) and value > 0):
            raise self.fail(key, f"is {value:g}, expected more than 0")
        return value

    def numbers(self, key: str, n: int) -> Array:
        what = f"{n} finite numbers"
        value = self.take(key, list, what)
        if len(value) != n or any(isinstance(x, bool) or not isinstance(x, (int, float)) for x in value):  # type: ignore
            raise self.fail(key, f"is {value!r}, expected {what}")
        array = np.array(value, float)
        if not np.isfinite(array).all():
            raise self.fail(key, f"is {value!r}, expected {what}")
        return array

    def table(self, key: str) -> _Reader:
        return _Reader(self.path, self.take(key, dict, "a table"), f"{self.where + '.' if self.where else ''}{key}")  # type: ignore

    def finish(self) -> None:
        for key in self.rest:
            raise self.fail(key, "is not a field of a hand file")


def read_hand_file(path: AnyPath | None = None) -> HandFile:
    """Read and check a hand file; without a path, the one of the package. Raises SimulationError: file and field."""
    path = Path(path) if path is not None else default_hand_file()
    try:
        content = read_toml(path)
    except AminnError as error:
        raise SimulationError(f"{error}: a hand file is a TOML file beside its model") from error
    top = _Reader(path, {k: v for k, v in content.items() if k not in OF_THE_DESCRIPTION})
    name, scene = top.text("name"), path.parent / top.text("scene")
    if not scene.is_file():
        raise top.fail("scene", f"names {scene}, which is not there; it is relative to the hand file")
    contact = top.table("contact")
    contact.rest.pop("compliance_m_N", None)
    model, torsional = contact.text("model"), contact.number("torsional_friction_m")
    if model not in CONTACT_MODELS:
        raise contact.fail("model", f"is {model!r}, expected one of {', '.join(CONTACT_MODELS)}")
    synergy = top.table("synergy")
    neutral = synergy.numbers("neutral_rad", N_JOINT)
    axes = _read_axes(synergy)
    for reader in (contact, synergy, top):
        reader.finish()
    columns, delta, ranges = (np.array(x) for x in zip(*axes, strict=True))
    gram = columns @ columns.T
    if np.abs(gram - np.diag(np.diag(gram))).max() > 1e-9 * gram.max() or np.diag(gram).min() <= 0:
        raise synergy.fail("axes", "have columns that are not orthogonal to each other (or zero)")
    files = read_model(scene)
    return HandFile(path, name, scene, model, torsional, neutral, columns, delta, ranges, path.read_bytes(), files)


def _read_axes(synergy: _Reader) -> list[tuple[Array, float, Array]]:
    tables = synergy.take("axes", list, f"one table for each of {', '.join(AXES)}")
    if not isinstance(tables, list) or len(tables) != len(AXES):
        raise synergy.fail("axes", f"must be one table for each of {', '.join(AXES)}")
    out = []
    for expected, table in zip(AXES, tables, strict=True):
        axis = _Reader(synergy.path, table, f"synergy.axes[{expected}]")
        if (name := axis.text("name")) != expected:
            raise axis.fail("name", f"is {name!r}; the axes are {', '.join(AXES)}, in this order")
        column, delta, limits = axis.numbers("column", N_JOINT), axis.number("delta"), axis.numbers("range", 2)
        if limits[0] >= limits[1]:
            raise axis.fail("range", f"is {limits.tolist()}, expected the lower end first")
        axis.finish()
        out.append((column, delta, limits))
    return out
