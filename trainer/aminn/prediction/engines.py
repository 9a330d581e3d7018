"""What evaluates a model: PyTorch a checkpoint, ONNX Runtime or the compiled runtime an export.

All of them take the same arrays and give the same. The compiled runtime's own package, `aminn_rt`, stands below this
one, and ONNX Runtime needs the file alone, so that nothing here knows of the exporter.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import onnxruntime as ort
import torch
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_bytes
from aminn_hand import Hand
from aminn_hand.hand import STATE
from aminn_hand.sensors import FRICTION, UNITS
from aminn_hand.theta import Theta
from aminn_rt import Model, Note
from aminn_rt.model import cores, model_file, ranges_in
from aminn_rt.ranges import within_ranges
from aminn_rt.status import Status, statuses

from ..data.measured import mean_forces
from ..evaluation.predict import run_model, true_states
from ..model.baseline import Mlp
from ..model.checkpoint import META, Checkpoint, load_checkpoint
from ..model.network import Aminn
from .onnx_session import check_graph, onnx_session, run_onnx

ENGINES = ("torch", "onnx", "runtime")
ONNX_FILE = "aminn.onnx"
ILL_CONDITIONED = 1e8
"""Of `condition` (aminn_rt.h)."""

Arrays = dict[str, NDArray]


@dataclass(frozen=True)
class Outputs:
    """What a model makes of states, a row each; those that cannot be predicted from are NaN, and do not hold."""

    p_stable: NDArray[np.floating]
    """(N)"""
    holds: NDArray[np.bool_]
    """(N)"""
    dx_ht: NDArray[np.floating]
    """(N, 6) m, rad; of a grasp that is predicted not to hold: how far the tool would move if it did."""
    k_x: NDArray[np.floating]
    """(N, 6, 6) SI; NaN of a model that has none."""
    gate: NDArray[np.floating]
    """(N, B); NaN of a model that has none."""
    p_slide: NDArray[np.floating]
    """(N) that a contact slides, if the grasp holds; NaN of a model that does not say."""
    bound_95: NDArray[np.floating]
    """(N) what the pose error exceeds in 5 of 100; likewise."""
    friction_use: NDArray[np.floating]
    """(N, B) share of its friction that each contact uses; 0 where contacts cannot slide, NaN of a model without."""
    condition: NDArray[np.floating]
    """(N) of the stiffness; NaN of a model that has none."""
    notes: NDArray[np.uint32]
    """(N) `aminn_rt.Note` bits."""
    status: NDArray[np.int32]
    """(N) `aminn_rt.status.Status`."""


class Engine(ABC):
    """A model with what evaluates it."""

    source: Path
    name: str
    """What the model calls itself."""
    tau: float
    forces: list[float] | None = None
    """Mean normal force of each branch's contacts in training (B), N, where it is known."""

    @property
    @abstractmethod
    def hand(self) -> Hand:
        """That the model is for."""

    @property
    @abstractmethod
    def senses(self) -> bool:
        """Whether the model was trained to see optional sensors."""

    @abstractmethod
    def run(self, x: Arrays, threads: int) -> Outputs:
        """Predict from `Dims.inputs` or a state alone, theta (N, P) and sensors, in float64 with one row per state.

        Where j_x and j_q are not given the state is as it was measured: theta says how it is to be read, and the
        closure is computed.
        """


def _true(hand: Hand, x: Arrays) -> Arrays:
    """All inputs of a model, theta among them if it is given."""
    if "j_x" in x:
        return x
    sensors = {name: x[name] for name in hand.dims.sensors if name in x}
    return true_states(hand, x["q"], x["x_ht"], x["w_e"], x["contacts"], x.get("theta"), sensors)


def _numbers(engine: Engine, x: Arrays, found: Arrays, good: NDArray[np.bool_], status: NDArray[np.int32]) -> Outputs:
    """Outputs of all rows, from those of the good ones."""
    dims, n = engine.hand.dims, len(good)
    full = {name: np.full((n, *shape), np.nan) for name, shape in dims.outputs.items()}
    for name, values in found.items():
        full[name][good] = values
    broken = good & ~(np.isfinite(full["p_stable"]) & np.isfinite(full["dx_ht"]).all(1))
    for values in full.values():
        values[broken] = np.nan
    status[broken] = Status.NUMERIC
    condition = _condition(full["k_x"], engine.hand.length_m)
    notes = np.where(condition > ILL_CONDITIONED, Note.ILL_CONDITIONED, 0).astype(np.uint32)
    notes[status == Status.NO_CONTACT] = Note.NO_CONTACT
    return Outputs(
        **full,
        holds=full["p_stable"].astype(np.float32) >= np.float32(engine.tau),
        condition=condition,
        notes=notes,
        status=status,
    )


def _condition(k_x: NDArray, length_m: float) -> NDArray[np.float64]:
    """trace(K) trace(K^-1) of stiffnesses with lengths divided by `length_m`, (N); NaN where there is none."""
    out = np.full(len(k_x), np.nan)
    known = np.isfinite(k_x).all((1, 2))
    scale = np.repeat([1.0, 1.0 / length_m], 3)
    values = np.linalg.eigvalsh(k_x[known] * np.outer(scale, scale)) if known.any() else np.ones((0, 6))
    out[known] = values.sum(1) * (1 / np.maximum(values, 1e-300)).sum(1)
    return out


class TorchEngine(Engine):
    """A checkpoint of `aminn train`."""

    def __init__(self, source: Path) -> None:
        self.source = source
        self.checkpoint: Checkpoint = load_checkpoint(source)
        self._model: Aminn | Mlp = self.checkpoint.model
        self.name, self.forces = source.name, mean_forces(self._model)
        self.tau = float(self.checkpoint.meta["tau"])

    @property
    def hand(self) -> Hand:
        return self._model.hand

    @property
    def senses(self) -> bool:
        return bool(self._model.config.sensors)

    def run(self, x: Arrays, threads: int) -> Outputs:
        status = statuses(x)
        good = status == Status.OK
        true = _true(self.hand, {k: v[good] for k, v in x.items()})
        before = torch.get_num_threads()
        torch.set_num_threads(cores(threads))
        try:
            found = run_model(self._model, {k: torch.as_tensor(v, dtype=torch.float32) for k, v in true.items()})
        finally:
            torch.set_num_threads(before)
        return _numbers(self, x, found, good, status)


class OnnxEngine(Engine):
    """`aminn.onnx` in ONNX Runtime."""

    def __init__(self, source: Path, binary: Path | None) -> None:
        """`binary` is the same model's other form, which tells what it was trained on; None where it is not there."""
        self.source, self._binary = source, binary
        self._sessions: dict[int, ort.InferenceSession] = {}
        self._content = read_bytes(source)
        meta = self._session(1).get_modelmeta().custom_metadata_map
        self._hand, self.name = hand_in(source, meta), source.stem
        self.tau = tau_in(source, meta)
        check_graph(self._session(1), self._hand.dims, source)

    @property
    def hand(self) -> Hand:
        return self._hand

    @property
    def senses(self) -> bool:
        return FRICTION in _taken(self._session(1))

    @cached_property
    def _ranges(self) -> dict[str, NDArray[np.float32]] | None:
        """None where they cannot be had: another hand's runtime, which reads them, may need a compiler."""
        try:
            return None if self._binary is None else ranges_in(read_bytes(self._binary), self._binary)
        except AminnError:
            return None

    def _session(self, threads: int) -> ort.InferenceSession:
        if threads not in self._sessions:
            self._sessions[threads] = onnx_session(self._content, threads, self.source)
        return self._sessions[threads]

    def run(self, x: Arrays, threads: int) -> Outputs:
        status = statuses(x)
        good = status == Status.OK
        true = _true(self.hand, {k: v[good] for k, v in x.items()})
        session = self._session(cores(threads))
        taken = _taken(session)
        if "theta" not in taken and "theta" in x and x["theta"][:, : Theta(self.hand).factors].any():
            raise AminnError(
                f"{self.source}: the graph of a model that is not told mechanics takes no theta; choose runtime"
            )
        inputs = {k: np.ascontiguousarray(v, np.float32) for k, v in true.items() if k in taken}
        found = run_onnx(session, inputs)
        outputs = _numbers(self, x, {k: found[k] for k in self.hand.dims.outputs}, good, status)
        if self._ranges is not None:
            outputs.notes[np.flatnonzero(good)[~within_ranges(true, self._ranges)]] |= np.uint32(Note.OUT_OF_RANGE)
        return outputs


def _taken(session: ort.InferenceSession) -> set[str]:
    """Names of everything that may be given."""
    return {i.name for i in (*session.get_inputs(), *session.get_overridable_initializers())}


class RuntimeEngine(Engine):
    """The binary model in the compiled runtime, whose numbers are those of the controller."""

    def __init__(self, source: Path, graph: Path) -> None:
        """`graph` is the ONNX form of the same model, which describes the hand."""
        self.source, self._graph = source, graph
        self.model = Model.load(source)
        self.name, self.tau = self.model.name, self.model.tau

    @cached_property
    def _hand(self) -> Hand:
        if not self._graph.is_file():
            raise AminnError(f"{self.source}: {self._graph.name} beside it describes its hand, and is not there")
        session = onnx_session(self._graph, 1)
        return hand_in(self._graph, session.get_modelmeta().custom_metadata_map)

    @property
    def hand(self) -> Hand:
        return self._hand

    @property
    def senses(self) -> bool:
        return self.model.senses

    def run(self, x: Arrays, threads: int) -> Outputs:
        state = {name: x[name] for name in STATE}
        more = {name: x[name] for name in ("j_x", "j_q", "theta", *UNITS) if name in x}
        found = self.model.predict(**state, **more, threads=threads, always=True)  # type: ignore[arg-type]
        return Outputs(**{name: getattr(found, name) for name in Outputs.__dataclass_fields__})


def hand_in(source: AnyPath, meta: dict[str, str]) -> Hand:
    """The hand in an ONNX model's metadata. Raises AminnError where it tells none."""
    try:
        return Hand.from_dict(json.loads(meta["hand"]))
    except (KeyError, ValueError, RecursionError, AminnError) as error:
        raise AminnError(f"{source}: its metadata describe no hand; export the model again") from error


def tau_in(source: AnyPath, meta: dict[str, str]) -> float:
    """The threshold on p_stable in an ONNX model's metadata. Raises AminnError where it tells none."""
    try:
        tau = json.loads(meta["tau"])
    except (KeyError, ValueError, RecursionError):
        tau = None
    if not isinstance(tau, int | float) or not 0 <= tau <= 1:
        raise AminnError(f"{source}: its metadata have no tau from 0 to 1; export the model again")
    return float(tau)


def _binary_beside(folder: Path) -> Path | None:
    try:
        return model_file(folder)
    except AminnError:
        return None


def open_engine(path: AnyPath, engine: str | None = None) -> Engine:
    """The model in a run, an export folder, an `aminn.onnx` or an `aminn_model.bin`, with what evaluates it.

    engine: one of `ENGINES`; None: PyTorch of a run, the compiled runtime of an export, what a file is for.
    Raises AminnError where there is no such model, or not in the form that the engine takes.
    """
    path = Path(path)
    if engine is not None and engine not in ENGINES:
        raise AminnError(f"engine {engine!r} is unknown; there are {', '.join(ENGINES)}")
    is_run = (path / META).is_file()
    natural = "torch" if is_run else "onnx" if path.suffix == ".onnx" else "runtime"
    engine = engine or natural
    if not path.exists():
        raise AminnError(f"{path}: is not there; give a run of `aminn train` or a folder that `aminn export` wrote")
    if is_run != (engine == "torch"):
        raise AminnError(
            f"{path}: is a run, which PyTorch evaluates; for {engine}: aminn export --run {path} --data DATA --out DIR"
            if is_run
            else f"{path}: is no run of `aminn train`, which alone PyTorch evaluates; choose {' or '.join(ENGINES[1:])}"
        )
    if engine == "torch":
        return TorchEngine(path)
    folder = path if path.is_dir() else path.parent
    if engine == "onnx":
        graph = path if path.suffix == ".onnx" else folder / ONNX_FILE
        if not graph.is_file():
            raise AminnError(f"{folder}: no {ONNX_FILE}; is this a folder that `aminn export` wrote?")
        return OnnxEngine(graph, _binary_beside(folder))
    return RuntimeEngine(model_file(folder if path.suffix == ".onnx" else path), folder / ONNX_FILE)
