"""The known answer of a model: a state, and every bit of what the runtime makes of it.

It goes into the C model and the binary, and `aminn_self_test()` asks for it on the target. The bits are those of the
compiled runtime itself, which are the same on every machine, so the same model and data give the same bytes.
"""

from __future__ import annotations

import importlib
import zlib
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import SPLITS, Dataset, split_of
from aminn.hand.dims import N_BRANCH, N_WRENCH
from aminn_base.errors import AminnError

from .layout import N_STATE, Layout, layout_of
from .packing import N_OUTPUT_WORDS, KnownAnswer, pack
from .ranges import STATE_FIELDS
from .tables import Exported

# A grasp of the reference hand, for a model that is exported without its data: joint angles, tool pose, load, contacts.
BUILT_IN_STATE = (
    *(0.0, 0.15, 0.55, 0.0, 0.15, 0.55, 0.15, 0.55),
    *(0.0, 0.0, 0.09, 0.1, -0.05, 0.2),
    *(0.3, -0.5, -0.8, 0.01, 0.02, -0.01),
    *(1.0, 0.022, 0.012, 0.092, 0.0, -1.0, 0.0, 3.0),
    *(1.0, -0.022, 0.012, 0.088, 0.0, -1.0, 0.0, 3.0),
    *(1.0, 0.001, -0.012, 0.09, 0.0, 1.0, 0.0, 6.0),
)
_GATE = slice(1 + N_WRENCH + N_WRENCH * N_WRENCH, 1 + N_WRENCH + N_WRENCH * N_WRENCH + N_BRANCH)


def runtime() -> ModuleType:
    """The compiled runtime. Raises AminnError if this installation lacks it."""
    try:
        return importlib.import_module("aminn_export._runtime")
    except ImportError as error:
        raise AminnError(f"export: the compiled runtime is missing ({error}); install the package again") from error


def _unanswered(state: NDArray[np.float32]) -> KnownAnswer:
    return KnownAnswer(state, np.zeros(N_OUTPUT_WORDS, np.uint32), 0)


def _run(layout: Layout, states: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
    """Words of the outputs (N, 49), of the stages (N, 216), status (N,) of states (N, 44)."""
    blob = pack(layout, _unanswered(np.zeros(N_STATE, np.float32)))
    try:
        outputs, stages, status = runtime().run(blob, np.ascontiguousarray(states, np.float32))
    except ValueError as error:
        raise AminnError(f"export: the runtime refuses the {error}") from error
    return outputs, stages, status[:, 0]


def answered(exported: Exported) -> tuple[Layout, KnownAnswer]:
    """A checked model in the runtime's order, with the answer to its `known_state` (else to `BUILT_IN_STATE`).

    Raises AminnError if the model does not fit the runtime, or predicts no number from that state.
    """
    layout = layout_of(exported)
    state = np.asarray(exported.meta.get("known_state", BUILT_IN_STATE), np.float32)
    outputs, stages, status = _run(layout, state[None])
    if status[0]:
        raise AminnError(
            f"model: no prediction from the state of its known answer ({runtime().status_text(int(status[0]))}); "
            "its weights are not those of a trained model"
        )
    return layout, KnownAnswer(state, outputs[0], zlib.crc32(stages[0].astype("<u4").tobytes()))


def informative_state(exported: Exported, dataset: Dataset) -> list[float]:
    """The stable training sample whose bits say most: predicted to hold, p_stable and gates far from 0 and 1."""
    samples = dataset.samples
    rows = np.flatnonzero((split_of(samples["grasp_id"]) == SPLITS.index("train")) & (samples["stable"] > 0))
    if not len(rows):
        return list(BUILT_IN_STATE)
    fields = [np.asarray(samples[name][rows], np.float32).reshape(len(rows), -1) for name in STATE_FIELDS]
    states = np.concatenate(fields, 1)
    outputs, _, status = _run(layout_of(exported), states)
    numbers = outputs.view(np.float32).astype(np.float64)
    score = (numbers[:, 0] >= float(exported.meta["tau"])).astype(np.float64)
    shares = [share * (1 - share) for share in (numbers[:, 0], *numbers[:, _GATE].T)]
    score += shares[0] * shares[1] * shares[2] * shares[3]
    score[status != 0] = -1
    return [float(v) for v in states[int(np.argmax(score))]]
