"""The Python API: a trained model, tables or arrays in, predictions out."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand import Hand
from aminn_hand.hand import STATE
from aminn_hand.sensors import in_full
from aminn_hand.theta import Theta
from aminn_rt import Note
from aminn_rt.compiled import runtime
from aminn_rt.model import numbers_of, rows_of
from aminn_rt.status import Status
from aminn_table import Fault, Map, complete, write_table
from aminn_table.checks import Rows
from aminn_table.columns import RESULTS, column_of, numbers, shapes_of
from aminn_table.files import Raw, from_columns
from aminn_table.read import read_rough

from ..calibration.store import read_calibration
from ..data.dataset import load_dataset
from .engines import Arrays, Engine, Outputs, open_engine

if TYPE_CHECKING:
    import pandas

CHUNK = 16384
"""Rows between two reports of progress."""
NOTES = {Note.OUT_OF_RANGE: "outside of what the model was trained on", Note.ILL_CONDITIONED: "ill-conditioned"}


class Frame(Protocol):
    """What pandas, polars and others call a data frame."""

    @property
    def columns(self) -> Any:
        """Names."""

    def __getitem__(self, name: str) -> Any:
        """A column."""


Table = AnyPath | Mapping[str, ArrayLike] | Frame | Raw


@dataclass(frozen=True)
class Given:
    """States to predict from."""

    x: Arrays
    """What an engine takes (N), by the names of inputs, and theta."""
    told: Arrays
    """What the table tells of each row (N), by the names of a table's arrays."""
    rows: Rows
    """How they are numbered where they come from."""
    faults: tuple[Fault, ...] = ()
    """What is wrong with rows of the table, or hard to believe."""
    fallbacks: tuple[str, ...] = ()
    """What stands in for sensors that the table lacks, and what of it the model does not look at."""
    index: Any = None
    """Of the data frame that it was."""


@dataclass(frozen=True)
class Predictions(Outputs):
    """A prediction for each row of a table; the same columns whatever evaluates the model."""

    hand: Hand = field(kw_only=True)
    given: Given = field(kw_only=True, repr=False)

    def __len__(self) -> int:
        return len(self.status)

    @cached_property
    def texts(self) -> NDArray[np.object_]:
        """(N) why not to trust a prediction, or why there is none; empty where nothing speaks against it."""
        said = [[text for note, text in NOTES.items() if bits & note] for bits in self.notes.tolist()]
        meaning = {code: runtime().status_text(code) for code in np.unique(self.status).tolist() if code != Status.OK}
        rows = zip(said, self.status.tolist(), strict=True)
        return np.array(["; ".join(s) if code == Status.OK else meaning[code] for s, code in rows], object)

    @property
    def arrays(self) -> Arrays:
        """What a table of predictions has, by the names of its arrays."""
        return {
            "p_stable": self.p_stable,
            "holds": self.holds.astype(np.uint8),
            "pred_dx_ht": self.dx_ht,
            "p_slide": self.p_slide,
            "bound_95": self.bound_95,
            "friction_use": self.friction_use,
            "notes": self.texts,
            "status": self.status,
        }

    @property
    def columns(self) -> dict[str, NDArray]:
        """(N) each, by name."""
        arrays, shapes = self.arrays, shapes_of(self.hand)
        places = [(name, at) for name in RESULTS for at in np.ndindex(shapes[name])]
        return {column_of(self.hand, name, at).name: numbers(arrays[name], at) for name, at in places}

    def complaints(self) -> list[str]:
        """What is wrong with rows: each kind with the first of its rows, and how many there are."""
        found = [str(fault) for fault in self.given.faults]
        named = {fault.row for fault in self.given.faults}
        rows = self.given.rows
        for code in np.unique(self.status).tolist():
            of = np.flatnonzero(self.status == code)
            if code != Status.OK and not {int(rows.numbers[i]) for i in of} <= named:
                found += map(str, rows.fault("no prediction:", self.status == code, self.texts[of[0]]))
        return found

    def to_pandas(self) -> pandas.DataFrame:
        """The columns as a data frame of pandas, which must be installed; with the index of the one that was given."""
        import pandas

        return pandas.DataFrame(self.columns, index=self.given.index)

    def write(self, path: AnyPath) -> None:
        """Write what the table told and the predictions as CSV, Parquet, HDF5 or lines of JSON, by the name's end."""
        told = {name: values for name, values in self.given.told.items() if name not in RESULTS}
        write_table(path, self.hand, told | self.arrays)


class Predictor:
    """A trained model with what evaluates it."""

    def __init__(self, path: AnyPath, engine: str | None = None) -> None:
        """As `aminn.load`."""
        self.engine: Engine = open_engine(path, engine)

    @property
    def name(self) -> str:
        """What the model calls itself."""
        return self.engine.name

    @property
    def tau(self) -> float:
        """The grasp holds if `p_stable` reaches it."""
        return self.engine.tau

    @property
    def hand(self) -> Hand:
        """The hand that the model is for."""
        return self.engine.hand

    @property
    def theta_names(self) -> tuple[str, ...]:
        """(P) mechanics parameters, in their order."""
        return Theta(self.hand).names

    def predict(
        self,
        table: Table | None = None,
        /,
        *,
        calibration: AnyPath | ArrayLike | None = None,
        by: Map | None = None,
        threads: int = 0,
        progress: Callable[[int], object] | None = None,
        **arrays: ArrayLike,
    ) -> Predictions:
        """Predict for each row of a table, or from arrays.

        table: a CSV, Parquet, HDF5 or JSON-lines file, a ROS 2 bag, a data set folder; a mapping or data frame of the
        same columns; or a mapping of arrays, which may be given by name as well: q (N, J), x_ht (N, 6), w_e (N, 6),
        contacts (N, B, 8), and if they are known j_x (N, B, 3, 6), j_q (N, B, 3, C), theta (N, P). An array without
        the leading dimension, or with one row, is the same for all. What a model that senses may be told as well:
        friction (N, 3) known or not (1 or 0), coefficient, standard deviation; or for all a coefficient, whose
        deviation is then 10 %, or "low", "mid", "high"; tool_weight (N, 3) force of gravity on the tool, N, H;
        tendon_tension (N, T) N. A row of NaN is not known; (N, 4) and (N, 1 + T) tell it by a 1 or 0 before.
        calibration: the file that `aminn calibrate` wrote, or theta (P) itself. It says how measured angles and
        contacts are read; where arrays of j_x and j_q are given they are taken to be read already.
        by: what a table calls otherwise, in a table's file or bag.
        threads: how many cores; 0: all.
        progress: told how many rows are done.

        A row that cannot be predicted from has NaN, and `status` and `texts` say why. Raises AminnError for a table
        that lacks columns, or arrays of another shape.
        """
        given = self.given(arrays if table is None else table, by)
        if table is not None and arrays:
            raise AminnError(f"predict: give a table or arrays, not both ({', '.join(arrays)})")
        x = dict(given.x)
        if calibration is not None:
            if "theta" in x:
                raise AminnError("predict: the table tells theta already; leave out its columns, or the calibration")
            x["theta"] = np.tile(self.theta_of(calibration), (len(x["q"]), 1))
            if not isinstance(table, Mapping) and not arrays:
                x.pop("j_x", None), x.pop("j_q", None)  # of states as they were measured
        n, parts = len(x["q"]), []
        for at in range(0, max(n, 1), CHUNK):
            parts.append(self.engine.run({k: v[at : at + CHUNK] for k, v in x.items()}, threads))
            if progress is not None:
                progress(min(at + CHUNK, n))
        joined = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Outputs)}
        return Predictions(**joined, hand=self.hand, given=given)

    def theta_of(self, calibration: AnyPath | ArrayLike) -> NDArray[np.float64]:
        """theta (P) of a calibration. Raises AminnError where it is of another hand."""
        if isinstance(calibration, str | os.PathLike):
            return read_calibration(calibration, self.hand)
        theta, size = numbers_of("calibration", calibration, np.float64), len(self.theta_names)
        if theta.shape != (size,):
            raise AminnError(f"calibration: theta has shape {theta.shape}, expected ({size},)")
        return theta

    def given(self, table: Table, by: Map | None = None) -> Given:
        """The states of a table, as `predict` takes them; without sensors that the model does not see."""
        given = self._given(table, by)
        unseen = [] if self.engine.senses else [name for name in self.hand.dims.sensors if name in given.x]
        if not unseen:
            return given
        ignored = f"{', '.join(unseen)}: not looked at, since the model was trained without sensors"
        x = {name: values for name, values in given.x.items() if name not in unseen}
        return replace(given, x=x, fallbacks=(*given.fallbacks, ignored))

    def _given(self, table: Table, by: Map | None) -> Given:
        if isinstance(table, str | os.PathLike):
            path = Path(table)
            return self._dataset(path) if (path / "manifest.json").is_file() else self._rough(path, by)
        if isinstance(table, Raw):
            return self._rough(table, by)
        if isinstance(table, Mapping):
            if table.keys() & {*self.hand.dims.inputs, "theta"}:
                return self._arrays(table)
            if not table:
                raise AminnError(f"predict: give a table, or the arrays {', '.join(STATE)}")
            return self._rough(from_columns("the table", table), by)
        if hasattr(table, "columns"):
            columns = {str(name): np.asarray(table[name]) for name in table.columns}
            given = self._rough(from_columns("the data frame", columns), by)
            return replace(given, index=getattr(table, "index", None))
        raise AminnError(f"predict: {type(table).__name__} is no table; give a path, a data frame or arrays")

    def _arrays(self, arrays: Mapping[str, ArrayLike]) -> Given:
        names = (*self.hand.dims.inputs, "theta", *self.hand.dims.sensors)
        if unknown := sorted(set(arrays) - set(names)):
            raise AminnError(f"predict: {unknown[0]} is no input; there are {', '.join(names)}")
        if missing := [name for name in STATE if name not in arrays]:
            raise AminnError(f"predict: {missing[0]} is missing; give {', '.join(STATE)}")
        if ("j_x" in arrays) != ("j_q" in arrays):
            raise AminnError("predict: give both j_x and j_q, or neither")
        sensors = self.hand.dims.sensors
        if not self.engine.senses and (unseen := [name for name in sensors if name in arrays]):
            raise AminnError(f"predict: the model was trained without sensors; leave out {', '.join(unseen)}")
        shapes = self.hand.dims.inputs | {"theta": (len(self.theta_names),)} | sensors
        whole = {k: in_full(k, v, sensors[k][0]) if k in sensors else v for k, v in arrays.items()}
        n, found = rows_of(shapes, whole, np.float64)
        x = {name: np.broadcast_to(values, (n, *values.shape[1:])) for name, values in found.items()}
        return Given(x, {name: values for name, values in x.items() if name not in ("j_x", "j_q")}, Rows.counted(n))

    def _rough(self, table: Path | Raw, by: Map | None) -> Given:
        rough = read_rough(table, self.hand, by)
        contacts, bad = rough.arrays["contacts"], rough.bad[:, None, None]
        # nothing stands in for what is missing in single rows
        told, notes = complete(self.hand, rough.arrays | {"contacts": np.where(bad, 0.0, contacts)}, self.engine.forces)
        x = {name: told[name] for name in (*STATE, "theta", *self.hand.dims.sensors) if name in told}
        x["contacts"] = np.where(bad, np.nan, told["contacts"])
        told["contacts"] = np.where(bad, contacts, told["contacts"])
        return Given(x, told, rough.rows, rough.faults, notes)

    def _dataset(self, path: Path) -> Given:
        data = load_dataset(path)
        if data.hand.sha256 != self.hand.sha256:
            raise AminnError(f"{path}: is of hand {data.hand.name}, the model of another ({self.hand.name})")
        more = [name for name in ("theta", *self.hand.dims.sensors) if name in data.samples]
        names = [*self.hand.dims.inputs, *more]
        shapes = shapes_of(self.hand)
        told = {name: values for name, values in data.samples.items() if name in shapes}
        x = {name: np.asarray(data.samples[name], np.float64) for name in names}
        return Given(x, told, Rows.counted(len(data)))
