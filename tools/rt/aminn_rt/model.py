"""A model as the controller has it, and predictions of many states at once."""

from __future__ import annotations

import os
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import cached_property
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_bytes, read_text
from aminn_hand.hand import OUTPUTS, STATE, Dims
from aminn_hand.sensors import in_full

from .blob import check_blob, dims_in, names_in, tau_in
from .compiled import ADMISSIBLE_WORDS, ALWAYS_STAGE2, THETA, LoadLimits, Refused, runtime_for
from .hand_header import HAND_HEADER, theta_names_in
from .status import Status

Floats = NDArray[np.float32]
OK = 0
DIRECTION = "direction"


class _Rows(NamedTuple):
    """Arrays in memory."""

    n: int
    places: dict[str, tuple[int, int]]
    """By name: address of the first number, and by how many numbers a row follows another."""
    arrays: dict[str, NDArray]
    """What lies there."""


class Note(IntFlag):
    """What speaks against a prediction (``AMINN_NOTE_...`` in aminn_rt.h)."""

    OUT_OF_RANGE = 1
    """A number of the state lies outside of what the model was trained on."""
    ILL_CONDITIONED = 2
    """`dx_ht` may have few correct digits."""
    NO_CONTACT = 4
    """No branch is in contact."""


@dataclass(frozen=True)
class Prediction:
    """What a batch of states became, a row each."""

    p_stable: Floats
    """(N) probability that the grasp holds."""
    holds: NDArray[np.bool_]
    """(N) whether it reaches the model's tau."""
    dx_ht: Floats
    """(N, 6) displacement of the tool in the hand: translation (m), rotation vector (rad), axes of H."""
    k_x: Floats
    """(N, 6, 6) stiffness of the grasped tool, SI."""
    gate: Floats
    """(N, B) engagement of each branch's tendon, 0 to 1."""
    p_slide: Floats
    """(N) probability that a contact slides, if the grasp holds."""
    bound_95: Floats
    """(N) what the error of dx_ht (translation over the hand's length, rotation in rad) exceeds in 5 of 100."""
    friction_use: Floats
    """(N, B) share of its friction that each contact uses; 0 out of contact, and where contacts cannot slide."""
    condition: Floats
    """(N) how far apart the stiffnesses of the grasped tool lie."""
    notes: NDArray[np.uint32]
    """(N) `Note` bits."""
    status: NDArray[np.int32]
    """(N) 0, or what is wrong with the row (`Model.status_text`); its numbers are NaN then, and `holds` is false."""

    def __len__(self) -> int:
        return len(self.status)


class LimitedBy(IntEnum):
    """What keeps a load from being larger (``AMINN_LIMITED_...`` in aminn_rt.h)."""

    NOT = 0
    """Nothing: `max_scale` is admissible."""
    HOLD = 1
    """`p_stable`."""
    TRANSLATION = 2
    """`max_translation`."""
    ROTATION = 3
    """`max_rotation`."""
    SLIDE = 4
    """`p_slide`."""
    RANGE = 5
    """Larger ones lie beyond what the model was trained on, or are ill-conditioned."""


@dataclass(frozen=True)
class Admissible:
    """The largest admissible loads, a row each."""

    scale: Floats
    """(N) of the direction: 0 to `max_scale`; 0 also where not even that is admissible."""
    admissible: NDArray[np.bool_]
    """(N) whether the load with `scale` is."""
    limited_by: NDArray[np.uint32]
    """(N) `LimitedBy`."""
    at: Prediction
    """What is predicted with `scale`; its `status` is that of the row."""

    def __len__(self) -> int:
        return len(self.scale)


class Model:
    """A model in its binary form, and the runtime compiled for its hand. It does not change: threads may share it.

    The runtime of the reference hand comes with the package. That of another hand is compiled when its first model is
    loaded, and kept in the user's cache folder.
    """

    def __init__(self, blob: bytes, source: AnyPath = "the model", theta_names: Sequence[str] = ()) -> None:
        """Take a model from the bytes of an `aminn_model.bin`; `source` is what messages call it.

        theta_names: of the hand's parameters, which the bytes do not tell.
        Raises AminnError where it is damaged, of another version, or no runtime of its hand can be had.
        """
        check_blob(blob, source)
        self._blob, self._source, self._theta_names = bytes(blob), str(source), tuple(theta_names)
        self._library = runtime_for(dims_in(blob, source), quickly=False)
        self._opened = {flags: self._open(flags) for flags in (0, ALWAYS_STAGE2)}

    @staticmethod
    def load(path: AnyPath) -> Model:
        """The model in a file, or the one in a folder that `aminn export` wrote."""
        file = model_file(path)
        header = file.with_name(HAND_HEADER)
        return Model(read_bytes(file), file, theta_names_in(read_text(header)) if header.is_file() else ())

    def _open(self, flags: int) -> int:
        try:
            opened = self._library.open(self._blob, flags)
        except Refused as error:
            raise AminnError(f"{self._source}: the runtime refuses the {error}") from error
        weakref.finalize(self, self._library.close, opened)
        return opened

    def __reduce__(self) -> tuple:
        return Model, (self._blob, self._source, self._theta_names)

    def __repr__(self) -> str:
        return f"<aminn_rt.Model {self.name!r} of hand {self.hand!r}>"

    @property
    def dims(self) -> Dims:
        """Counts of the hand, and shapes of what it takes and gives."""
        return self._library.dims

    @property
    def senses(self) -> bool:
        """Whether the model was trained to see friction, the tool's weight and tendon tensions."""
        return dims_in(self._blob, self._source).sensing > 0

    @property
    def name(self) -> str:
        """What the model calls itself."""
        return names_in(self._blob)[0]

    @property
    def hand(self) -> str:
        """Name of the hand, and 8 digits of its constants' SHA-256."""
        return names_in(self._blob)[1]

    @property
    def made_by(self) -> str:
        """Program and version that exported it."""
        return names_in(self._blob)[2]

    @property
    def tau(self) -> float:
        """The grasp holds if `p_stable` reaches it."""
        return tau_in(self._blob)

    @property
    def theta_names(self) -> tuple[str, ...]:
        """(P) mechanics parameters in their order; numbered where no `aminn_hand.h` beside the model names them."""
        own = self._library.theta_names
        return self._theta_names if len(self._theta_names) == len(own) else own

    @cached_property
    def ranges(self) -> dict[str, tuple[Floats, Floats]]:
        """Smallest and largest value in training, widened, of each array of a state; those of a row's shape."""
        low, high = self._library.ranges(self._opened[0])
        found, at = {}, 0
        for name in STATE:
            shape = self.dims.inputs[name]
            part = slice(at, at + prod(shape))
            found[name], at = (low[part].reshape(shape), high[part].reshape(shape)), part.stop
        return found

    def status_name(self, status: int) -> str:
        """Name of a status, for instance `AMINN_E_NORMAL`."""
        return self._library.status_name(int(status))

    def status_text(self, status: int) -> str:
        """Meaning of a status in one sentence part."""
        return self._library.status_text(int(status))

    def self_test(self) -> None:
        """Raise AminnError unless this library, on this processor, computes the bits that it must."""
        if status := self._library.self_test(self._blob):
            raise AminnError(f"{self._source}: the self-test fails: {self.status_text(status)}")

    def predict(
        self,
        q: ArrayLike,
        x_ht: ArrayLike,
        w_e: ArrayLike,
        contacts: ArrayLike,
        j_x: ArrayLike | None = None,
        j_q: ArrayLike | None = None,
        theta: ArrayLike | None = None,
        *,
        friction: ArrayLike | None = None,
        tool_weight: ArrayLike | None = None,
        tendon_tension: ArrayLike | None = None,
        threads: int = 0,
        always: bool = False,
        strict: bool = False,
    ) -> Prediction:
        """Predict N states.

        Each array has one row per state: q (N, J) rad, x_ht (N, 6) m and rad, w_e (N, 6) N and N.m, contacts (N, B, 8).
        The closure Jacobians j_x (N, B, 3, 6) and j_q (N, B, 3, C) are computed where they are not given. An array
        without the leading dimension, or with one row, is the same for all states. `aminn_rt.h` draws frames and signs.

        theta (N, P) or (P): by how much this hand differs from its description, in the order of `theta_names`; None is
        nominal. Angles and contacts are corrected by it, but where j_x and j_q are given: these are of a state that is.
        friction, tool_weight, tendon_tension: what a model that senses may be told beside the state; None is not known,
        as is a row of NaN. friction is "low", "mid" or "high", a coefficient, or (N, 2) coefficient and standard
        deviation; tool_weight (N, 3) the force of gravity on the tool, N, H; tendon_tension (N, T), N. (N, 3), (N, 4)
        and (N, 1 + T) say by a 1 or 0 before the numbers whether they are known.
        threads: how many cores to use; 0: all. The numbers are the same bits however many.
        always: the displacement of grasps that are predicted not to hold as well: how far would the tool move if they
        did? Else it is NaN there, and costs no time.
        strict: raise AminnError for a row that cannot be predicted from, instead of giving its status.

        Raises AminnError for arrays of another shape, and for sensors that the model does not see.
        """
        given: dict[str, ArrayLike] = {"q": q, "x_ht": x_ht, "w_e": w_e, "contacts": contacts}
        if (j_x is None) != (j_q is None):
            raise AminnError("predict: give both j_x and j_q, or neither")
        if j_x is not None and j_q is not None:
            given |= {"j_x": j_x, "j_q": j_q}
        told = {"friction": friction, "tool_weight": tool_weight, "tendon_tension": tendon_tension}
        rows = self._rows(given, theta, told)
        opened = self._opened[ALWAYS_STAGE2 if always else 0]
        outputs, _, status = self._library.predict(opened, rows.places, rows.n, cores(threads))
        return self._strictly(strict, self._prediction(outputs, status))

    def admissible_load(
        self,
        q: ArrayLike,
        x_ht: ArrayLike,
        w_e: ArrayLike,
        contacts: ArrayLike,
        direction: ArrayLike,
        theta: ArrayLike | None = None,
        *,
        friction: ArrayLike | None = None,
        tool_weight: ArrayLike | None = None,
        tendon_tension: ArrayLike | None = None,
        max_translation: float,
        max_rotation: float,
        margin: float = 1.0,
        p_stable: float = 0.0,
        p_slide: float = 1.0,
        max_scale: float = 1.0,
        threads: int = 0,
        strict: bool = False,
    ) -> Admissible:
        """The largest load along a direction that each of N grasps is predicted to bear.

        States, theta, sensors, threads and strict are as for `predict`. w_e (N, 6) is the part of the load that is
        there anyway, direction (N, 6) that which is scaled: N, N.m, axes of H.

        max_translation (m) and max_rotation (rad) bound the predicted motion, to which margin times `bound_95` is added
        (as a length times the hand's `length_m`). p_stable is the least probability that the grasp holds; below the
        model's tau, that. p_slide is the largest probability that a contact slides. max_scale: how much of the
        direction is of interest. `aminn_rt.h` says how the load is found.

        Raises AminnError for arrays of another shape, and for limits that are none.
        """
        given = {"q": q, "x_ht": x_ht, "w_e": w_e, "contacts": contacts, DIRECTION: direction}
        told = {"friction": friction, "tool_weight": tool_weight, "tendon_tension": tendon_tension}
        rows = self._rows(given, theta, told, {DIRECTION: self.dims.inputs["w_e"]})
        limits = _limits(
            {
                "max_translation": max_translation,
                "max_rotation": max_rotation,
                "margin": margin,
                "p_stable": p_stable,
                "p_slide": p_slide,
                "max_scale": max_scale,
            }
        )
        along = rows.places.pop(DIRECTION, (0, 0))
        words, status = self._library.admissible(self._opened[0], rows.places, along, limits, rows.n, cores(threads))
        if (status == Status.LIMITS).any():
            values = ", ".join(f"{name} {getattr(limits, name):g}" for name, *_ in limits._fields_)
            raise AminnError(f"admissible_load: {self.status_text(Status.LIMITS)}: {values}")
        scale, admissible, limited_by = (words[:, i].copy() for i in range(ADMISSIBLE_WORDS))
        at = self._strictly(strict, self._prediction(words[:, ADMISSIBLE_WORDS:].copy(), status))
        return Admissible(scale.view(np.float32), admissible.astype(bool), limited_by, at)

    def _rows(
        self,
        given: dict[str, ArrayLike],
        theta: ArrayLike | None,
        told: Mapping[str, ArrayLike | None],
        others: Mapping[str, tuple[int, ...]] = MappingProxyType({}),
    ) -> _Rows:
        """Arrays of states and sensors, and others of these shapes, as the library takes them."""
        sensors = self.dims.sensors
        shapes = self.dims.inputs | sensors | dict(others)
        for name, value in told.items():
            if value is None:
                continue
            if not self.senses or name not in sensors:
                why = "was trained without sensors" if name in sensors else "is of a hand without tendons"
                raise AminnError(f"predict: {name} is given, and the model {why}; leave it out")
            given[name] = in_full(name, value, sensors[name][0])
        if theta is not None:
            given, shapes = given | {THETA: theta}, shapes | {THETA: (len(self.theta_names),)}
        n, arrays = rows_of(shapes, given)
        places = {k: (v.ctypes.data, v[0].size if len(v) == n and n != 1 else 0) for k, v in arrays.items() if n}
        return _Rows(n, places, arrays)

    def _strictly(self, strict: bool, found: Prediction) -> Prediction:
        """What was found; where it is to be whole, raises AminnError for a row that is not."""
        if strict and found.status.any():
            raise AminnError(f"predict: {self._complaint(found.status)}")
        return found

    def _prediction(self, words: NDArray[np.uint32], status: NDArray[np.int32]) -> Prediction:
        n, numbers = len(words), words.view(np.float32)
        parts, at = {}, 0
        for name in OUTPUTS:
            shape = self.dims.outputs[name]
            parts[name] = numbers[:, at : at + prod(shape)].reshape(n, *shape).copy()
            at += prod(shape)
        condition, stable, notes = (words[:, at + i].copy() for i in range(3))
        parts["p_stable"][status != OK] = np.nan
        return Prediction(
            **parts, holds=stable.astype(bool), condition=condition.view(np.float32), notes=notes, status=status
        )

    def _complaint(self, status: NDArray[np.int32]) -> str:
        bad = np.flatnonzero(status)
        more = f" ({len(bad)} of {len(status)} rows cannot be predicted from)" if len(bad) > 1 else ""
        return f"row {bad[0]}: {self.status_text(status[bad[0]])}{more}"


def _limits(values: dict[str, float]) -> LoadLimits:
    try:
        return LoadLimits(**{name: float(value) for name, value in values.items()})
    except (TypeError, ValueError, OverflowError) as error:
        raise AminnError(f"admissible_load: limits are {values}, expected numbers ({error})") from error


def cores(wanted: int) -> int:
    """How many threads to use; 0 are all cores. Raises AminnError for what is no such number."""
    if not isinstance(wanted, int | np.integer) or wanted < 0:
        raise AminnError(f"predict: threads is {wanted!r}, expected 0 (all cores) or more")
    return int(wanted) or len(os.sched_getaffinity(0))


def numbers_of(name: str, values: ArrayLike, dtype: type[np.floating]) -> NDArray:
    """`values` as a contiguous array, NaN where a masked one has none. Raises AminnError where they are no numbers."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    try:
        if np.iscomplexobj(values):
            raise TypeError("they are complex")
        with np.errstate(over="ignore"):  # what is too large for it becomes infinite, and is refused
            return np.ascontiguousarray(values, dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise AminnError(f"predict: {name} is no array of numbers ({error})") from error


def rows_of(
    shapes: Mapping[str, Sequence[int]], given: Mapping[str, ArrayLike], dtype: type[np.floating] = np.float32
) -> tuple[int, dict[str, NDArray]]:
    """How many rows arrays have together, and each with all of them or one (all alike).

    Raises AminnError that names an array that is no numbers, of another shape or of another number of rows.
    """
    arrays: dict[str, NDArray] = {}
    for name, values in given.items():
        array = numbers_of(name, values, dtype)
        shape = tuple(shapes[name])
        if array.shape == shape:
            array = array[None]
        if array.shape[1:] != shape:
            wanted = ", ".join(map(str, ("N", *shape)))
            raise AminnError(f"predict: {name} has shape {np.shape(values)}, expected ({wanted}) or {shape}")
        arrays[name] = array
    counts = {name: len(array) for name, array in arrays.items() if len(array) != 1}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise AminnError(f"predict: arrays have different numbers of rows: {told}")
    return next(iter(counts.values()), 1), arrays


def ranges_in(blob: bytes, source: AnyPath) -> dict[str, Floats]:
    """`range_min` and `range_max` (S) of a model. Raises AminnError as `Model` does."""
    check_blob(blob, source)
    low, high = runtime_for(dims_in(blob, source)).ranges_of(blob)
    return {"range_min": low, "range_max": high}


def model_file(path: AnyPath) -> Path:
    """The binary model that `path` is, or that lies in the folder `path` beside the header of its C form."""
    path = Path(path)
    if not path.is_dir():
        return path
    found = [header.with_suffix(".bin") for header in sorted(path.glob("*.h"))]
    found = [file for file in found if file.is_file()]
    if len(found) != 1:
        names = ", ".join(file.name for file in found) or "none"
        raise AminnError(f"{path}: one C model with its .bin expected (`aminn export` writes it); found: {names}")
    return found[0]
