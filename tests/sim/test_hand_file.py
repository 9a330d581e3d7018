"""The hand file: what it decides, and what a broken one is told."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from aminn_sim import SimulationConfig, SimulationError, _core, simulate
from aminn_sim.hand_file import default_hand_file, read_hand_file


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    """A copy of the hand, to be broken."""
    folder = tmp_path / "hand"
    shutil.copytree(default_hand_file().parent, folder)
    return folder / "hand.toml"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "three_finger_hand"', "", "name is missing; expected a text"),
        ('name = "three_finger_hand"', "name = 3", "name is 3, expected a text"),
        ('name = "three_finger_hand"', 'name = "a"\ncolour = 1', "colour is not a field of a hand file"),
        ('name = "three_finger_hand"', "name = ", "not valid TOML"),
        ('scene = "scene.xml"', 'scene = "nothing.xml"', "nothing.xml, which is not there"),
        ('model = "point"', 'model = "rubber"', "contact.model is 'rubber', expected one of point, soft_finger"),
        ("torsional_friction_m = 0.003", "torsional_friction_m = -1", "contact.torsional_friction_m is -1"),
        ("neutral_rad = [0.0, ", "neutral_rad = [", "synergy.neutral_rad is"),
        ("neutral_rad = [0.0, ", "neutral_rad = [nan, ", "expected 8 finite numbers"),
        ('name = "spread"', 'name = "sprout"', "synergy.axes[spread].name is 'sprout'"),
        ("delta = 2.0", "delta = 0", "synergy.axes[spread].delta is 0, expected more than 0"),
        ("delta = 2.0\nrange = [-1.0, 1.0]", "delta = 2.0\nrange = [1.0, -1.0]", "the lower end first"),
        ("column = [1.0, 0.0", "column = [1.0, 0.5", "not orthogonal"),
    ],
)
def test_malformed_hand_file(hand: Path, old: str, new: str, message: str) -> None:
    change(hand, old, new)
    with pytest.raises(SimulationError) as caught:
        read_hand_file(hand)
    assert str(hand) in str(caught.value) and message in str(caught.value)


def test_missing_hand_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"none\.toml: cannot be read"):
        read_hand_file(tmp_path / "none.toml")


def test_joint_that_the_model_lacks(hand: Path, tmp_path: Path) -> None:
    change(hand.parent / "three_finger_hand.xml", '"finger1_distal"', '"finger1_last"')
    with pytest.raises(SimulationError, match="no joint named finger1_distal"):
        simulate(SimulationConfig(grasps=1), tmp_path / "data", hand=hand, progress=False)
    assert not (tmp_path / "data").exists()


def test_damaged_model_names_the_file(hand: Path) -> None:
    (hand.parent / "three_finger_hand.xml").write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    with pytest.raises(SimulationError, match=r"hand\.toml: the model that `scene` names cannot be used"):
        read_hand_file(hand).simulator()


def test_unreachable_synergy_range(hand: Path) -> None:
    change(hand, "delta = 1.0458\nrange = [-1.0, 1.0]", "delta = 1.0458\nrange = [-1.0, 6.0]")
    with pytest.raises(SimulationError, match=r"cannot be reached: at size -1, spread -1, curl 6 joint finger1_distal"):
        read_hand_file(hand).simulator()


def test_tool_larger_than_the_span(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"radius_max_m 0\.06 makes tools larger than the hand's span"):
        simulate(SimulationConfig(grasps=1, radius_max_m=0.06), tmp_path / "data", progress=False)
    assert not (tmp_path / "data").exists()


def test_soft_fingers_resist_a_twist(hand: Path) -> None:
    """About the pinch axis point contacts give way sooner than soft fingers do."""
    point = read_hand_file(hand).simulator()
    change(hand, 'model = "point"', 'model = "soft_finger"')
    change(hand, "torsional_friction_m = 0.003", "torsional_friction_m = 0.010")
    soft = read_hand_file(hand).simulator()
    turned = []
    for simulator in (point, soft):
        session = _core.Session(simulator, SimulationConfig().options(), 1, 0, 0, 0, [0])
        normal = session.grasp()["contacts"][0][2, 4:7]
        case = session.load(np.concatenate([np.zeros(3), 0.01 * normal]))
        turned.append(abs(float(case["dx_ht"][0, 3:] @ normal)))
    assert turned[1] < 0.9 * turned[0]


def test_another_hand_is_another_data_set(hand: Path, tmp_path: Path) -> None:
    small = SimulationConfig(grasps=1, cases=1)
    simulate(small, tmp_path / "data", progress=False)
    change(hand, 'model = "point"', 'model = "soft_finger"')
    with pytest.raises(SimulationError, match="another configuration"):
        simulate(small, tmp_path / "data", progress=False, hand=hand)


def test_routing_matches_the_coefficients() -> None:
    """A tendon's moment arm about a joint is the radius of the pulley there, for the joints before its anchor."""
    import xml.etree.ElementTree as ET

    root = ET.parse(default_hand_file().parent / "three_finger_hand.xml").getroot()
    radius = {
        c.get("class"): float(c.find("geom").get("size").split()[0])
        for c in root.iter("default")
        if c.get("class") in ("proximal_pulley", "distal_pulley")
    }
    parents = {child: parent for parent in root.iter() for child in parent}
    for tendon in root.iter("fixed"):
        anchor = next(s for s in root.iter("site") if s.get("name") == tendon.get("name"))
        arms, body = {}, parents[anchor]
        while body.tag == "body":
            for geom in body.findall("geom"):
                if geom.get("class") in radius:
                    arms[body.find("joint").get("name")] = radius[geom.get("class")]
            body = parents[body]
        assert arms == {j.get("joint"): -float(j.get("coef")) for j in tendon}, tendon.get("name")
