"""aminn_rt.Model told friction, weight and tensions: of each row its own, in batches of any size on any threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hands import random_model, random_states
from numpy.typing import NDArray
from synthetic import hand
from test_rt import same

from aminn_base.errors import AminnError
from aminn_export.files.bin_model import write_bin_model
from aminn_hand.hand import STATE
from aminn_hand.sensors import FRICTION_CLASSES, UNITS
from aminn_rt import Model
from aminn_rt.status import Status, statuses

Arrays = dict[str, NDArray]
N = 300


def made_model(folder: Path, sensing: bool) -> Model:
    write_bin_model(random_model(hand(), sensing=sensing), folder / "model.bin")
    return Model.load(folder / "model.bin")


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return made_model(tmp_path_factory.mktemp("sensing"), sensing=True)


@pytest.fixture(scope="module")
def x() -> Arrays:
    return random_states(hand(), N)


@pytest.fixture(scope="module")
def told() -> Arrays:
    """Each row knows another part of them."""
    rng, dims = np.random.default_rng(3), hand().dims
    sizes = {"friction": (0.4, 1.1), "tool_weight": (-2, 2), "tendon_tension": (0, 20)}
    found = {
        name: np.insert(rng.uniform(*sizes[name], (N, size - 1)), 0, rng.integers(0, 2, N), axis=1)
        for name, (size,) in dims.sensors.items()
    }
    return {name: (values * (values[:, :1] > 0)).astype(np.float32) for name, values in found.items()}


def test_each_sensor_counts_where_it_is_known(model: Model, x: Arrays, told: Arrays) -> None:
    assert model.senses
    plain = model.predict(**x, always=True)
    same(model.predict(**x, always=True, **{name: np.zeros_like(v) for name, v in told.items()}), plain)
    for name, values in told.items():
        found = model.predict(**x, always=True, **{name: values})
        changed, known = (found.dx_ht != plain.dx_ht).any(1), values[:, 0] > 0
        assert changed[known].all() and not changed[~known].any(), name
    zero = model.predict(**x, always=True, tool_weight=[1, 0, 0, 0])
    assert (zero.dx_ht != plain.dx_ht).any(1).all()  # known to be 0 is not unknown


def test_rows_and_threads_and_batches_change_no_bit(model: Model, x: Arrays, told: Arrays) -> None:
    whole = model.predict(**x, **told, always=True, threads=1)
    for threads in (2, 5):
        same(model.predict(**x, **told, always=True, threads=threads), whole)
    for row in (0, 7, 250):
        one = {name: values[row] for name, values in (x | told).items()}
        same(model.predict(**one, always=True), whole, slice(row, row + 1))
    some = {name: values[200:] for name, values in (x | told).items()}
    same(model.predict(**some, always=True), whole, slice(200, N))
    repeated = {name: np.tile(values[3], (N, 1)) for name, values in told.items()}
    all_alike = model.predict(**x, **{name: values[3] for name, values in told.items()}, always=True)
    same(model.predict(**x, **repeated, always=True), all_alike)


def test_with_theta_and_given_jacobians(model: Model, x: Arrays, told: Arrays) -> None:
    """What was told to rows before does not stay."""
    theta = np.zeros((N, len(model.theta_names)))
    theta[::2, 0], theta[5, 0] = 0.3, 9.0
    found = model.predict(**x, **told, theta=theta, always=True)
    assert np.flatnonzero(found.status).tolist() == [5] and found.status[5] == Status.CALIBRATION
    for row in (4, 6, 7):
        one = {name: values[row] for name, values in (x | told).items()}
        same(model.predict(**one, theta=theta[row], always=True), found, slice(row, row + 1))


def test_of_admissible_loads(model: Model, x: Arrays, told: Arrays) -> None:
    limits = {"max_translation": 1e-3, "max_rotation": 0.1, "max_scale": 5.0, "direction": [0, 0, -1, 0, 0, 0]}
    state = {name: x[name] for name in STATE}
    found = model.admissible_load(**state, **told, **limits)
    assert (found.scale != model.admissible_load(**state, **limits).scale).any()
    there = state | {"w_e": x["w_e"] + found.scale[:, None] * np.array(limits["direction"], np.float32)}
    good = found.admissible & (found.at.status == 0)
    assert good.any()
    np.testing.assert_array_equal(found.at.p_stable[good], model.predict(**there, **told).p_stable[good])


def test_what_may_be_said_for_short(model: Model, x: Arrays, told: Arrays) -> None:
    same(model.predict(**x, friction="low"), model.predict(**x, friction=FRICTION_CLASSES["low"]))
    same(model.predict(**x, friction=0.6), model.predict(**x, friction=[1, 0.6, 0.06]))
    weight = np.where(told["tool_weight"][:, :1] > 0, told["tool_weight"], np.nan)[:, 1:]
    same(model.predict(**x, tool_weight=weight), model.predict(**x, tool_weight=told["tool_weight"]))


def test_what_no_sensor_can_say_is_the_rows_status(model: Model, x: Arrays, told: Arrays) -> None:
    """As NumPy says it; a bad state comes first."""
    bad = {name: values.astype(np.float64) for name, values in (x | told).items()}
    rng = np.random.default_rng(5)
    for name in UNITS:
        rows = rng.uniform(size=N) < 0.1
        bad[name][rows, 0] = rng.choice([0.5, -1, 2, np.nan], rows.sum())
        bad[name][rng.uniform(size=N) < 0.05, 1] = np.inf
    bad["friction"][rng.uniform(size=N) < 0.1, 1] = -0.1
    bad["friction"][rng.uniform(size=N) < 0.1, 2] = -0.1
    bad["q"][rng.uniform(size=N) < 0.2, 1] = np.nan
    bad["contacts"][rng.uniform(size=N) < 0.2, :, 0] = 0
    found, plain = model.predict(**bad, always=True), model.predict(**x, **told, always=True)
    assert set(found.status) == {Status.OK, Status.SENSORS, Status.NONFINITE, Status.NO_CONTACT}
    np.testing.assert_array_equal(found.status, statuses(bad))
    assert model.status_name(Status.SENSORS) == "AMINN_E_SENSORS"
    good = found.status == Status.OK
    assert found.dx_ht[good].tobytes() == plain.dx_ht[good].tobytes()
    assert np.isnan(found.p_stable[found.status == Status.SENSORS]).all()


def test_what_a_model_does_not_see_is_refused(model: Model, x: Arrays, tmp_path: Path) -> None:
    blind = made_model(tmp_path, sensing=False)
    assert not blind.senses
    with pytest.raises(AminnError, match="friction is given, and the model was trained without sensors; leave it out"):
        blind.predict(**x, friction=0.6)
    with pytest.raises(AminnError, match=r"tool_weight has shape \(2,\), expected \(N, 4\) or \(4,\)"):
        model.predict(**x, tool_weight=[1, 2])
    with pytest.raises(AminnError, match="friction is 'wet', expected numbers, or low, mid, high"):
        model.predict(**x, friction="wet")
