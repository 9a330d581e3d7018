"""The known answer of a model: a state, and every bit of what the runtime makes of it.

It goes into the C model and the binary, and `aminn_self_test()` asks for it on the target. The bits are those of the
compiled runtime itself, which are the same on every machine, so the same model and data give the same bytes.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import SPLITS, Dataset, split_of
from aminn.evaluation.metrics import holds
from aminn_base.errors import AminnError
from aminn_hand.hand import N_WRENCH, STATE, Dims
from aminn_rt.blob import output_words
from aminn_rt.compiled import is_own, runtime, runtime_for

from .layout import Layout, layout_of
from .packing import KnownAnswer, pack
from .tables import Exported, dims_of

_LOAD = (0.3, -0.5, -0.8, 0.01, 0.02, -0.01)
# A grasp of the reference hand, for a model that is exported without its data: joint angles, tool pose, load, contacts.
REFERENCE_GRASP = (
    *(0.0, 0.15, 0.55, 0.0, 0.15, 0.55, 0.15, 0.55),
    *(0.0, 0.0, 0.09, 0.1, -0.05, 0.2),
    *_LOAD,
    *(1.0, 0.022, 0.012, 0.092, 0.0, -1.0, 0.0, 3.0),
    *(1.0, -0.022, 0.012, 0.088, 0.0, -1.0, 0.0, 3.0),
    *(1.0, 0.001, -0.012, 0.09, 0.0, 1.0, 0.0, 6.0),
)
CERTAIN = 0.9
"""A p_stable that hardly moves with what it comes from."""
_GATE_AT = 1 + N_WRENCH + N_WRENCH * N_WRENCH
_BENT_RAD, _REACH_M, _PRESS_N = 0.2, 0.03, 3.0


def built_in_state(exported: Exported) -> NDArray[np.float32]:
    """A state of the model's hand that can be predicted from, for a model that is exported without its data (S).

    Of the reference hand a grasp; of another one a tool between contacts near the last joint of each branch.
    """
    dims, axes, anchors = dims_of(exported), exported.tensors["geom_axis"], exported.tensors["geom_anchor"]
    if is_own(dims):
        return np.array(REFERENCE_GRASP, np.float32)
    last = np.asarray(anchors[:, -1], float)
    away = last - last.mean(0)
    across = np.cross(axes[:, -1], away)
    points = last + _REACH_M * across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-3)
    inward = points.mean(0) - points
    inward += np.where(np.linalg.norm(inward, axis=1, keepdims=True) < 1e-3, [0.0, 0.0, 1.0], 0.0)
    normals = inward / np.linalg.norm(inward, axis=1, keepdims=True)
    one = np.ones((dims.branches, 1))
    contacts = np.concatenate([one, points, normals, _PRESS_N * one], 1)
    pose = np.concatenate([points.mean(0), np.zeros(3)])
    state = np.concatenate([np.full(dims.joints, _BENT_RAD), pose, _LOAD, contacts.ravel()])
    return state.astype(np.float32)


def _unanswered(dims: Dims) -> KnownAnswer:
    return KnownAnswer(np.zeros(dims.state, np.float32), np.zeros(output_words(dims), np.uint32), 0)


def _run(layout: Layout, states: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
    """Words of the outputs (N, .), of both stages (N, .), status (N,) of states (N, S)."""
    blob = pack(layout, _unanswered(layout.dims))
    try:
        outputs, stages, status = runtime_for(layout.dims).run(blob, np.ascontiguousarray(states, np.float32))
    except ValueError as error:
        raise AminnError(f"export: the runtime refuses the {error}") from error
    return outputs, stages, status


def answered(exported: Exported) -> tuple[Layout, KnownAnswer]:
    """A checked model in the runtime's order, with the answer to its `known_state` (else to `built_in_state`).

    Raises AminnError if the model does not fit the runtime, or predicts no number from that state.
    """
    layout = layout_of(exported)
    known = exported.meta.get("known_state")
    state = built_in_state(exported) if known is None else np.asarray(known, np.float32)
    outputs, stages, status = _run(layout, state[None])
    if status[0]:
        raise AminnError(
            f"model: no prediction from the state of its known answer ({runtime().status_text(int(status[0]))}); "
            "its weights are not those of a trained model"
        )
    return layout, KnownAnswer(state, outputs[0], zlib.crc32(stages[0].astype("<u4").tobytes()))


def informative_state(exported: Exported, dataset: Dataset) -> list[float]:
    """The stable training sample whose bits say most: predicted to hold, p_stable and gates far from 0 and 1.

    Where there are some, of those whose p_stable is below CERTAIN.
    """
    samples = dataset.samples
    rows = np.flatnonzero((split_of(samples["grasp_id"]) == SPLITS.index("train")) & (samples["stable"] > 0))
    if not len(rows):
        return [float(v) for v in built_in_state(exported)]
    fields = [np.asarray(samples[name][rows], np.float32).reshape(len(rows), -1) for name in STATE]
    states = np.concatenate(fields, 1)
    layout = layout_of(exported)
    outputs, _, status = _run(layout, states)
    numbers = outputs.view(np.float32).astype(np.float64)
    score = holds(numbers[:, 0], exported.meta["tau"]).astype(np.float64)
    score += score * (numbers[:, 0] < CERTAIN)
    gates = numbers[:, _GATE_AT : _GATE_AT + layout.dims.branches].T if layout.dims.gates else ()
    score += np.prod([share * (1 - share) for share in (numbers[:, 0], *gates)], 0)
    score[status != 0] = -1
    return [float(v) for v in states[int(np.argmax(score))]]
