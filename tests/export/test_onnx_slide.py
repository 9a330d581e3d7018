"""Contacts that slide, and sensors, in the ONNX graph: against the float64 oracle, for hands of all kinds."""

from __future__ import annotations

import numpy as np
import onnxruntime as ort
import pytest
from hands import HANDS, random_model, random_states
from numpy.typing import NDArray
from runtime_models import random_sensors

from aminn.prediction.onnx_session import run_onnx
from aminn_export.files.onnx_model import build_onnx
from aminn_export.files.tables import Exported
from aminn_export.judge.fidelity import SquareRootReference
from aminn_export.judge.verdict import known_condition
from aminn_export.samples.golden import single_thread_session
from aminn_hand.hand import OUTPUTS, Hand

Inputs = dict[str, NDArray[np.float32]]


def states(hand: Hand, n: int, seed: int) -> Inputs:
    """Some branches out of contact, some fading, and loads that many contacts cannot bear."""
    x = random_states(hand, n, seed)
    x["contacts"][::5, 0, 0] *= np.float32(0.4)
    return x


def sliding(name: str, seed: int = 0, sensing: bool = False, told: bool = False) -> tuple[Exported, Hand]:
    hand = HANDS[name]()
    return random_model(hand, seed, told=told, slides=True, sensing=sensing), hand


def session(model: Exported) -> ort.InferenceSession:
    return single_thread_session(build_onnx(model, debug=True).SerializeToString())


def worst(got: NDArray, want: NDArray) -> float:
    """Largest error of a state, over the size of what is right there and a thousandth of the largest."""
    want = np.asarray(want, float).reshape(len(want), -1)
    size = np.abs(want).max(1)
    return float((np.abs(got.reshape(want.shape) - want).max(1) / np.maximum(size, 1e-3 * size.max() + 1e-30)).max())


@pytest.mark.parametrize("sensing", [False, True])
@pytest.mark.parametrize("name", ["gripper", "allegro_like", "barrett_like", "aero_like", "one_cable", "soft_three"])
def test_the_graph_is_the_definition(name: str, sensing: bool) -> None:
    model, hand = sliding(name, sensing=sensing)
    x = states(hand, 60, 5)
    if sensing:
        x |= random_sensors(hand.dims, 60, 6)
    found, exact = run_onnx(session(model), x), SquareRootReference(model)(x)
    slid = exact["s2_slide"].max(1)
    assert (slid > 1e-5).mean() > 0.1 and (slid == 0).mean() > 0.05
    assert set(found) == set(exact)
    print({key: f"{worst(found[key], exact[key]):.0e}" for key in exact})
    for key, limit in {"s1_friction": 3e-6, "s1_preload": 1e-4, "s2_slide": 5e-2, "k_x": 3e-3, "dx_ht": 1e-3}.items():
        assert worst(found[key], exact[key]) < limit, key
    condition = known_condition(exact["k_x"], hand.length_m)
    for key in ("p_stable", "p_slide"):
        assert (np.abs(found[key] - exact[key]) / (1 + 2e-4 * condition)).max() < 1e-4, key
    assert np.abs(found["friction_use"] - exact["friction_use"]).max() < 3e-3 * max(1, exact["friction_use"].max())


def test_a_contact_that_is_none_has_no_influence() -> None:
    model, hand = sliding("barrett_like", sensing=True)
    x = states(hand, 40, 5) | random_sensors(hand.dims, 40, 6)
    for name in ("contacts", "j_x", "j_q"):
        x[name][:, 0] = 0
    other = {name: value.copy() for name, value in x.items()}
    other["contacts"][:, 0, 1:] = [0.01, 0.02, 0.09, 0.6, 0.0, 0.8, 5.0]
    graph = session(model)
    for predict in (lambda inputs: run_onnx(graph, inputs), SquareRootReference(model)):
        found, again = predict(x), predict(other)
        for name in OUTPUTS:
            np.testing.assert_array_equal(found[name], again[name], err_msg=name)
