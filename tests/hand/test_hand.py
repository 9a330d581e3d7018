"""The typed hand: dimensions, JSON, closure against the engine."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_sim import mjcf_tree
from aminn_sim._core import Engine
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import Understood, understand

MODELS = default_hand_file().parent
FILES = [MODELS / "hand.toml", *sorted((MODELS / "hands").glob("*.toml"))]


@pytest.fixture(scope="module", params=FILES, ids=lambda p: p.stem)
def understood(request: pytest.FixtureRequest) -> Understood:
    return understand(request.param)


def test_jacobian_is_the_engines(understood: Understood) -> None:
    """Each column z x (point - anchor) against the engine's own, at random angles, point held by the tip."""
    hand, engine = understood.hand, Engine(mjcf_tree.text_of(understood.root))
    names = engine.names("joint")
    numbers = [names.index(j) for j in hand.joints]
    address, dof = engine.model("jnt_qposadr")[numbers], engine.model("jnt_dofadr")[numbers]
    palm, rng = engine.names("body").index(understood.palm), np.random.default_rng(0)
    worst = 0.0
    for _ in range(5):
        q = rng.uniform(-0.8, 0.8, len(hand.joints))
        qpos = np.zeros(len(engine.model("qpos0")))
        qpos[address] = q
        engine.reset()
        engine.set("qpos", qpos)
        engine.forward()
        R, p = engine.data("xmat")[palm].reshape(3, 3), engine.data("xpos")[palm]
        for branch, at in zip(hand.branches, hand.branch_joints, strict=True):
            point = rng.normal(size=3) * 0.1
            theirs = R.T @ engine.jacobian(engine.names("body").index(branch.tip), p + R @ point)[:, dof[at]]
            worst = max(worst, float(np.abs(branch.jacobian(q[at], point) - theirs).max()))
    assert worst < 1e-12, worst


def test_json_keeps_everything(understood: Understood) -> None:
    hand = understood.hand
    again = Hand.from_dict(json.loads(json.dumps(hand.as_dict())))
    assert again == hand and again.sha256 == hand.sha256


def test_dimensions_follow_from_the_branches() -> None:
    dims = understand(MODELS / "hand.toml").hand.dims
    assert (dims.branches, dims.coordinates, dims.joints, dims.tendons) == (3, 3, 8, 6)
    assert dims.inputs == {
        "q": (8,), "x_ht": (6,), "w_e": (6,), "contacts": (3, 8), "j_x": (3, 3, 6), "j_q": (3, 3, 3)
    }  # fmt: skip


def test_a_damaged_description_is_named() -> None:
    value = understand(MODELS / "hand.toml").hand.as_dict()
    del value["branches"][1]["tip"]
    with pytest.raises(AminnError, match="tip"):
        Hand.from_dict(value)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("branches.1.coordinates.0.axis", [0, 0, 2.0], r"branches\.1\.coordinates\.0\.axis: has length 2, expected 1"),
        ("branches.1.coordinates.0.axis", [0, 1.0], "axis: has 2 numbers, expected 3"),
        ("branches.0.coordinates.2.anchor_m", [0, 0, float("nan")], "anchor_m: is not finite"),
        ("branches.0.coordinates.2.spring_Nm_rad", -1.0, "spring_Nm_rad: is -1.0, expected a number of 0 or more"),
        ("branches.0.coordinates.2.high_rad", -9.0, "high_rad: is -9.0, less than low_rad"),
        ("branches.2.tendons.1.arm_m", [0.01], "arm_m: has 1 numbers, expected 2"),
        ("branches.2.eps_m", 0.0, "eps_m: is 0.0, expected a positive number"),
        ("branches.2.eps_m", "soft", "eps_m: .*valid number"),
        ("branches.1.name", "thumb", "branches: two are called thumb"),
        ("length_m", 0.0, "length_m: is 0.0, expected a positive number"),
        ("mirror.branches", [1, 1, 2], "mirror.branches: is .1, 1, 2., expected each of 3 branches once"),
        ("branches", [], "0 branches; 2 to 5 are supported"),
    ],
)
def test_numbers_that_no_hand_has_are_named(path: str, value: object, message: str) -> None:
    whole = json.loads(json.dumps(understand(MODELS / "hand.toml").hand.as_dict()))
    *steps, last = path.split(".")
    at = whole
    for step in steps:
        at = at[int(step) if step.isdigit() else step]
    at[last] = value
    with pytest.raises(AminnError, match=message):
        Hand.from_dict(whole)


def test_the_built_in_hand() -> None:
    """Numbers of the model, where they belong."""
    hand = understand(MODELS / "hand.toml").hand
    assert [b.name for b in hand.branches] == ["finger1", "finger2", "thumb"] and hand.sides == ((0, 1), (2,))
    assert [len(b.coordinates) for b in hand.branches] == [3, 3, 2]
    finger, other, thumb = hand.branches
    assert [c.stiffness_Nm_rad for c in finger.coordinates] == [4.2, 0.4, 0.2]
    assert [c.stiffness_Nm_rad for c in thumb.coordinates] == [0.8, 0.4]
    assert [t.arm_m for t in thumb.tendons] == [(0.010, 0.0), (0.010, 0.007)]
    assert [t.stiffness_N_m for t in finger.tendons] == [20000] * 2 and thumb.tendons[0].max_tension_N == 500
    assert {b.tip_radius_m for b in hand.branches} == {0.010} and {b.eps_m for b in hand.branches} == {1e-5}
    assert finger.gated_tendon == other.gated_tendon == thumb.gated_tendon == 0
    assert hand.mirror is not None and hand.mirror.branches == (1, 0, 2) and hand.mirror.normal == (1.0, 0.0, 0.0)


def test_head_and_cholesky_factor_have_one_order() -> None:
    dims = understand(MODELS / "hand.toml").hand.dims
    assert dims.cholesky_entries == ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
    assert list(dims.head_parts) == ["diagonal", "below", "direction", "gain", "alpha", "beta", "rho"]
    assert [(p.start, p.stop) for p in dims.head_parts.values()] == list(pairwise([0, 3, 6, 9, 10, 11, 12, 13]))
    bare = replace(dims, coordinates=4, gates=0)
    assert bare.branch_head == 10 and bare.cholesky_entries[4:] == ((1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2))
    assert list(bare.head_parts) == ["diagonal", "below"]
    one = replace(dims, coordinates=1)
    assert one.branch_head == 6 and one.head_parts["below"] == slice(1, 1)
