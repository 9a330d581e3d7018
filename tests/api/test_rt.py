"""The module aminn_rt: the compiled runtime for Python programs that predict much."""

from __future__ import annotations

import pickle
import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hands import HANDS, random_model, random_states
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_export.export import write_model_files
from aminn_export.files.bin_model import read_bin_model
from aminn_export.samples.vectors import Vectors
from aminn_hand.theta import MAX_LOG_FACTOR, MAX_RADIUS_M, MAX_ZERO_RAD
from aminn_rt import LimitedBy, Model, Note, Prediction
from aminn_rt.compiled import runtime_for
from aminn_rt.model import model_file
from aminn_rt.status import Status

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
States = dict[str, NDArray[np.float32]]
FIELDS = ("p_stable", "holds", "dx_ht", "k_x", "gate", "condition", "notes", "status")


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(GOLDEN)


def same(a: Prediction, b: Prediction, rows: slice = slice(None)) -> None:
    for name in FIELDS:
        assert getattr(a, name).tobytes() == getattr(b, name)[rows].tobytes(), name


def rows_of(states: States, rows: slice | NDArray) -> States:
    return {name: values[rows] for name, values in states.items()}


def test_it_predicts_what_onnx_runtime_does(model: Model, vectors: Vectors) -> None:
    found = model.predict(**vectors.inputs, always=True)
    assert not found.status.any()
    wanted = vectors.reference
    np.testing.assert_allclose(found.p_stable, wanted["p_stable"], atol=1e-5)
    np.testing.assert_array_equal(found.holds, wanted["p_stable"] >= model.tau)
    size = np.abs(wanted["dx_ht"]).max(1, keepdims=True)
    assert (np.abs(found.dx_ht - wanted["dx_ht"]) < 1e-4 * size).all()
    np.testing.assert_allclose(found.gate, wanted["gate"], atol=1e-4)
    assert found.k_x.shape == (len(found), 6, 6) and (found.condition >= 1).all()


def test_the_bits_are_those_of_the_known_answers_runtime(model: Model, states: States) -> None:
    rows = np.concatenate([v.reshape(len(v), -1) for v in states.values()], 1)
    outputs, _, status = runtime_for(model.dims).run(model_file(GOLDEN).read_bytes(), rows)
    found = model.predict(**states, always=True)
    assert found.dx_ht.tobytes() == outputs[:, 1:7].tobytes()
    np.testing.assert_array_equal(found.status, status)


def test_what_is_masked_is_not_measured(model: Model, states: States) -> None:
    mask = np.zeros(states["q"].shape, bool)
    mask[4, 2] = True
    found = model.predict(**states | {"q": np.ma.masked_array(states["q"], mask)})
    assert np.flatnonzero(found.status).tolist() == [4] and model.status_name(found.status[4]) == "AMINN_E_NONFINITE"


def test_the_number_of_threads_changes_no_bit(model: Model, states: States) -> None:
    many = {name: np.resize(values, (1003, *values.shape[1:])) for name, values in states.items()}
    many["contacts"][::7, 0, 4:7] *= 2  # rows that are refused are somewhere in every thread's part
    one = model.predict(**many, threads=1)
    assert (one.status != 0).sum() == 144
    for threads in (0, 2, 3, 7, 64):
        same(model.predict(**many, threads=threads), one)


def test_other_threads_of_python_run_meanwhile(model: Model, states: States, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the lock is not handed over by time, another thread comes in only if the call lets it go."""
    many = {name: np.resize(values, (30_000, *values.shape[1:])) for name, values in states.items()}
    library = runtime_for(model.dims)._c
    call, interval = library.aminn_predict_batch, sys.getswitchinterval()
    started, finished = threading.Event(), threading.Event()

    def watched(*arguments: object) -> int:
        started.set()
        status = int(call(*arguments))
        finished.set()
        return status

    def came_in_between() -> bool:
        started.clear()
        finished.clear()
        thread = threading.Thread(target=model.predict, kwargs=many)
        thread.start()
        started.wait()
        meanwhile = not finished.is_set()
        thread.join()
        return meanwhile

    monkeypatch.setattr(library, "aminn_predict_batch", watched)
    sys.setswitchinterval(1e6)
    try:
        assert any(came_in_between() for _ in range(5))  # a busy machine may let this thread wait for long
    finally:
        sys.setswitchinterval(interval)


def test_batches_of_any_size_are_parts_of_the_whole(model: Model, states: States) -> None:
    whole = model.predict(**states)
    for first, last in ((0, 0), (0, 1), (3, 4), (5, 132)):
        same(model.predict(**rows_of(states, slice(first, last))), whole, slice(first, last))
    single = model.predict(**{name: values[7] for name, values in states.items()})
    assert len(single) == 1
    same(single, whole, slice(7, 8))


def test_one_grasp_and_many_loads(model: Model, states: States) -> None:
    """An array with one row, or without the leading dimension, is the same for all."""
    n, one = len(states["q"]), rows_of(states, slice(3, 4))
    repeated = {name: np.repeat(values, n, 0) for name, values in one.items()} | {"w_e": states["w_e"]}
    wanted = model.predict(**repeated)
    same(model.predict(**one | {"w_e": states["w_e"]}), wanted)
    same(model.predict(**{k: v[0] for k, v in one.items()} | {"w_e": states["w_e"]}), wanted)
    assert len(model.predict(**one | {"w_e": np.zeros((0, 6))})) == 0


def test_given_jacobians_are_taken(model: Model, vectors: Vectors, states: States) -> None:
    j_x, j_q = vectors.inputs["j_x"], vectors.inputs["j_q"]
    computed, given = model.predict(**states, always=True), model.predict(**vectors.inputs, always=True)
    np.testing.assert_allclose(given.p_stable, computed.p_stable, atol=1e-4)
    other = model.predict(**states, j_x=j_x, j_q=0.5 * j_q, always=True)
    assert np.abs(other.p_stable - given.p_stable).max() > 0.01
    with pytest.raises(AminnError, match="both j_x and j_q"):
        model.predict(**states, j_x=j_x)


def test_a_bad_row_does_not_spoil_the_others(model: Model, states: States) -> None:
    good, bad = model.predict(**states), {name: values.copy() for name, values in states.items()}
    bad["q"][3, 1] = np.nan
    bad["contacts"][5, 0, 4:7] = 1.0
    bad["contacts"][8, :, 0] = 0
    bad["x_ht"][9, 3:] = 9.0
    wrong = {3: "NONFINITE", 5: "NORMAL", 8: "NO_CONTACT", 9: "ROTATION"}
    found = model.predict(**bad)
    for row, name in wrong.items():
        assert model.status_name(found.status[row]) == f"AMINN_E_{name}"
        numbers = (found.p_stable, found.dx_ht, found.k_x, found.gate, found.condition)
        assert all(np.isnan(values[row]).all() for values in numbers) and not found.holds[row]
    assert found.notes[8] == Note.NO_CONTACT
    others = np.setdiff1d(np.arange(len(good)), list(wrong))
    for field in FIELDS:
        assert getattr(found, field)[others].tobytes() == getattr(good, field)[others].tobytes()
    with pytest.raises(AminnError, match=r"^predict: row 3: an input is NaN or infinite \(4 of 200 rows"):
        model.predict(**bad, strict=True)
    assert len(model.predict(**rows_of(bad, slice(0, 3)), strict=True)) == 3
    assert model.status_name(model.predict(**states | {"w_e": np.full(6, 1e300)}).status[0]) == "AMINN_E_NONFINITE"


def test_notes_and_displacements_of_what_does_not_hold(model: Model, states: States) -> None:
    heavy = states | {"w_e": states["w_e"] * 50}
    lazy, always = model.predict(**heavy), model.predict(**heavy, always=True)
    assert (~lazy.holds).any()
    np.testing.assert_array_equal(np.isnan(lazy.dx_ht).all(1), ~lazy.holds)
    assert np.isfinite(always.dx_ht).all()
    assert (always.notes & Note.OUT_OF_RANGE).any()
    low, high = model.ranges["w_e"]
    outside = ((heavy["w_e"] < low) | (heavy["w_e"] > high)).any(1)
    assert ((always.notes & Note.OUT_OF_RANGE) > 0)[outside].all()


def test_theta_for_all_or_for_each(model: Model, states: States) -> None:
    """Of every row as of that row alone, whatever stands before it and however many threads there are."""
    rng, n = np.random.default_rng(1), len(states["q"])
    names, plain = model.theta_names, model.predict(**states)
    same(model.predict(**states, theta=np.zeros(len(names))), plain)
    kinds = np.concatenate([np.full(model.dims.stiff + 3, 0.3), np.full(8, 0.02), [1e-3]])
    theta = rng.uniform(-1, 1, (4, len(names)))[rng.integers(0, 4, n)] * kinds
    theta[7, 0] = 9.0
    found = model.predict(**states, theta=theta, always=True)
    assert model.status_name(found.status[7]) == "AMINN_E_CALIBRATION" and np.isnan(found.dx_ht[7]).all()
    assert np.count_nonzero(found.status) == 1
    many = {name: np.resize(values, (1000, *values.shape[1:])) for name, values in states.items()}
    for threads in (1, 3):
        whole = model.predict(**many, theta=np.resize(theta, (1000, len(names))), always=True, threads=threads)
        same(found, whole, slice(200, 400))
    for row in (0, 7, 8, 150):
        one = model.predict(**rows_of(states, slice(row, row + 1)), theta=theta[row], always=True)
        same(one, found, slice(row, row + 1))
    assert names[0].startswith("spring_") and names[-1] == "radius_tips"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((4, 7))}, r"predict: q has shape \(4, 7\), expected \(N, 8\) or \(8,\)"),
        ({"contacts": "three"}, "predict: contacts is no array of numbers"),
        ({"q": np.zeros((200, 8)) + 0j}, r"q is no array of numbers \(they are complex\)"),
        ({"threads": 1.5}, "threads is 1.5, expected 0"),
        ({"w_e": np.zeros((4, 6))}, "different numbers of rows: q 200, x_ht 200, w_e 4, contacts 200"),
        ({"threads": -1}, "threads is -1"),
    ],
)
def test_what_cannot_be_arrays_of_states_is_named(model: Model, states: States, change: dict, message: str) -> None:
    with pytest.raises(AminnError, match=message):
        model.predict(**states | change)


def test_a_model_says_what_it_is(model: Model) -> None:
    read = read_bin_model(GOLDEN / "aminn_model.bin")
    assert (model.name, model.hand, model.made_by) == tuple(read.meta[k] for k in ("name", "hand", "made_by"))
    assert model.tau == read.meta["tau"]
    low = np.concatenate([low.ravel() for low, _ in model.ranges.values()])
    np.testing.assert_array_equal(low, read.tensors["range_min"])
    assert {k: v.shape for k, (v, _) in model.ranges.items()} == {k: model.dims.inputs[k] for k in model.ranges}
    model.self_test()
    header = (ROOT / "runtime" / "include" / "aminn_rt.h").read_text()
    defined = dict(re.findall(r"#define AMINN_NOTE_(\w+) (\d)u", header))
    assert {note.name: str(note.value) for note in Note} == defined


def test_a_model_goes_to_another_process_and_to_several_threads(model: Model, states: States) -> None:
    wanted = model.predict(**states)
    same(pickle.loads(pickle.dumps(model)).predict(**states), wanted)
    found: list[Prediction] = []
    threads = [threading.Thread(target=lambda: found.append(model.predict(**states, threads=2))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    for one in found:
        same(one, wanted)


def test_what_is_no_model_is_refused(tmp_path: Path) -> None:
    blob = (GOLDEN / "aminn_model.bin").read_bytes()
    with pytest.raises(AminnError, match="truncated"):
        Model(blob[:100])
    with pytest.raises(AminnError, match="damaged"):
        Model(blob[:-1] + b"\1")
    with pytest.raises(AminnError, match=r"one C model with its .bin expected"):
        Model.load(tmp_path)
    with pytest.raises(AminnError, match=r"none.bin: cannot be read"):
        Model.load(tmp_path / "none.bin")


def test_models_of_several_hands_are_in_one_process(model: Model, states: States, tmp_path: Path) -> None:
    before, hand = model.predict(**states), HANDS["gripper"]()
    write_model_files(random_model(hand), tmp_path, "aminn_model")
    other, x = Model.load(tmp_path), random_states(hand, 50)
    found = other.predict(**x, always=True)
    assert not found.status.any() and found.dx_ht.shape == (50, 6) and other.dims.branches == 2
    outputs = (
        runtime_for(other.dims)
        .run((tmp_path / "aminn_model.bin").read_bytes(), np.concatenate([v.reshape(50, -1) for v in x.values()], 1))
        .outputs
    )
    assert found.dx_ht.tobytes() == outputs[:, 1:7].tobytes()  # whether compiled quickly or for speed
    same(model.predict(**states), before)


def test_numbers_that_stand_in_the_header_too() -> None:
    header = (ROOT / "runtime" / "include" / "aminn_rt.h").read_text()
    defined = {name: float(value) for name, value in re.findall(r"#define AMINN_(MAX_\w+) ([\d.]+)F", header)}
    assert defined == {"MAX_LOG_FACTOR": MAX_LOG_FACTOR, "MAX_ZERO": MAX_ZERO_RAD, "MAX_RADIUS": MAX_RADIUS_M}
    listed = dict(re.findall(r"X\(AMINN_(?:E_)?(\w+), (-?\d+),", header))
    assert {s.name: str(s.value) for s in Status}.items() <= listed.items()


BOUNDS = {"max_translation": 2e-3, "max_rotation": 0.1}


def test_admissible_loads_are_those_that_predictions_allow(model: Model, states: States) -> None:
    """At the scale that is found all is within limits; a little above it, it is not."""
    still = states | {"w_e": np.zeros((200, 6))}
    size = np.maximum(
        np.linalg.norm(states["w_e"][:, :3], axis=1), np.linalg.norm(states["w_e"][:, 3:] / 0.025, axis=1)
    )
    direction = 10 * states["w_e"] / size[:, None]
    margin = 5e-3 / float(np.median(model.predict(**still).bound_95))
    found = model.admissible_load(**still, direction=direction, **BOUNDS, margin=margin, p_stable=0.9)
    assert len(found) == 200 and not found.at.status.any() and found.admissible.mean() > 0.9
    same(found.at, model.predict(**still | {"w_e": found.scale[:, None] * direction.astype(np.float32)}))
    assert set(found.limited_by[~found.admissible]) <= {LimitedBy.HOLD, LimitedBy.RANGE}
    assert (found.scale[~found.admissible] == 0).all()

    def allowed(scale: NDArray) -> NDArray[np.bool_]:
        p = model.predict(**still | {"w_e": scale[:, None] * direction})
        doubt = margin * p.bound_95
        moved = np.linalg.norm(p.dx_ht[:, :3], axis=1) + 0.1 * doubt <= 2e-3
        turned = np.linalg.norm(p.dx_ht[:, 3:], axis=1) + doubt <= 0.1
        return p.holds & (p.p_stable >= 0.9) & (p.notes == 0) & moved & turned

    good = found.admissible
    assert allowed(found.scale * (1 - 1e-6))[good].all()
    ended = good & (found.limited_by != LimitedBy.NOT) & (found.limited_by != LimitedBy.RANGE)
    assert ended.mean() > 0.8 and not allowed(found.scale * 1.25 + 0.002)[ended].any()
    one = model.admissible_load(**rows_of(still, 7), direction=direction[7], **BOUNDS, margin=margin, p_stable=0.9)
    assert one.scale[0] == found.scale[7] and one.at.dx_ht.tobytes() == found.at.dx_ht[7:8].tobytes()


def test_margins_and_thresholds_leave_less_load(model: Model, states: States) -> None:
    still = {name: values[3] for name, values in states.items()} | {"w_e": np.zeros(6)}
    directions = np.random.default_rng(0).normal(size=(300, 6)) * [10, 10, 10, 0.1, 0.1, 0.1]

    def loads(threads: int = 1, **limits: float) -> NDArray[np.float32]:
        return model.admissible_load(**still, direction=directions, **BOUNDS | limits, threads=threads).scale

    plain = loads(margin=0)
    assert np.array_equal(loads(threads=3, margin=0), plain)
    margin = 5e-3 / float(model.predict(**still).bound_95[0])
    for limits in ({"margin": margin}, {"margin": 0, "p_stable": 0.99}, {"margin": 0, "max_translation": 2e-4}):
        less = loads(**limits)
        assert (less <= plain).all() and less.mean() < 0.97 * plain.mean(), limits
    stiff = model.admissible_load(
        **still, direction=directions, **BOUNDS, margin=0, theta=np.zeros(len(model.theta_names))
    )
    assert np.array_equal(stiff.scale, plain)


def test_what_bears_no_load_or_is_no_limit_is_told(model: Model, states: States) -> None:
    bad = {name: values.copy() for name, values in states.items()} | {"w_e": np.zeros((200, 6))}
    bad["q"][3, 1] = np.nan
    found = model.admissible_load(**bad, direction=states["w_e"], **BOUNDS)
    assert np.flatnonzero(found.at.status).tolist() == [3] and found.scale[3] == 0 and not found.admissible[3]
    assert np.isnan(found.at.p_stable[3])
    with pytest.raises(AminnError, match=r"row 3: an input is NaN or infinite"):
        model.admissible_load(**bad, direction=states["w_e"], **BOUNDS, strict=True)
    with pytest.raises(AminnError, match=r"direction has shape \(5,\), expected \(N, 6\) or \(6,\)"):
        model.admissible_load(**bad, direction=np.ones(5), **BOUNDS)
    with pytest.raises(
        AminnError, match=r"a limit of the load is .*: max_translation 0.002, max_rotation -1, margin 1"
    ):
        model.admissible_load(**states, direction=np.ones(6), max_translation=2e-3, max_rotation=-1)
    with pytest.raises(AminnError, match=r"expected numbers"):
        model.admissible_load(**states, direction=np.ones(6), max_translation="wide", max_rotation=1)  # type: ignore[arg-type]
