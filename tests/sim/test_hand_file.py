"""The hand file: what it decides, and what a broken one is told."""

from __future__ import annotations

import hashlib
import io
import os
import re
import shutil
import struct
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from aminn_base.errors import AminnError
from aminn_sim import SimulationConfig, SimulationError, _core, simulate
from aminn_sim.open_hand import default_hand_file, open_hand
from aminn_sim.read import read_data


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
        ('name = "three_finger_hand"', "", "name: field required"),
        ('name = "three_finger_hand"', "name = 3", "name: expected a text"),
        ('name = "three_finger_hand"', 'name = "a"\ncolour = 1', "colour is not a field of a hand file"),
        ('name = "three_finger_hand"', "name = ", "not valid TOML"),
        ('model = "three_finger_hand.xml"', 'model = "nothing.xml"', "nothing.xml, which is no file"),
        ('model = "point"', 'model = "rubber"', "contact.model: input should be 'point' or 'soft_finger'"),
        ("torsional_friction_m = 0.003", "torsional_friction_m = -1", "contact.torsional_friction_m: input"),
        ("compliance_m_N = 1e-5", "compliance_m_N = { toe = 1e-5 }", "names the branch 'toe'; there are finger1, fing"),
        ("tool_axis = [1, 0, 0]", "tool_axis = [0, 0, 0]", "tool_axis has no length"),
        ('geoms = ["finger1_tip"]', 'geoms = ["finger2_tip"]', "geoms names 'finger2_tip', which is no colliding"),
        ("neutral_rad = [0.0, ", "neutral_rad = [", "synergy.neutral_rad has 7 numbers, the hand has 8 joints"),
        ("neutral_rad = [0.0, ", "neutral_rad = [nan, ", "synergy.neutral_rad.0: input should be a finite number"),
        ("delta = 2.0", "delta = 0", "synergy.axes.1.delta: input should be greater than 0"),
        ("delta = 2.0\nrange = [-1.0, 1.0]", "delta = 2.0\nrange = [1.0, -1.0]", "the lower end first"),
        ("column = [1.0, 0.0", "column = [1.0, 0.5", "not orthogonal"),
        ("column = [1.0, 0.0, ", "column = [1.0, ", "synergy.axes[spread].column has 7 numbers, the hand has 8"),
        ("[contact]", "[mirror]\nnormal = [0, 1, 0]\n\n[contact]", "mirror.normal: the hand is not its own image"),
    ],
)
def test_malformed_hand_file(hand: Path, old: str, new: str, message: str) -> None:
    change(hand, old, new)
    with pytest.raises(AminnError) as caught:
        open_hand(hand)
    assert str(hand) in str(caught.value) and message in str(caught.value), caught.value


def test_missing_hand_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(AminnError, match=r"none\.toml: cannot be read"):
        open_hand(tmp_path / "none.toml")


def test_renamed_parts_make_no_difference(hand: Path, tmp_path: Path) -> None:
    """Names are the user's: another joint's name leaves the data as they were."""
    small = SimulationConfig(grasps=1, cases=2)
    before = simulate(small, tmp_path / "before", hand=hand, progress=False)
    change(hand.parent / "three_finger_hand.xml", '"finger1_distal"', '"aminn_last"')
    change(hand, '"finger1_distal"', '"aminn_last"')
    after = simulate(small, tmp_path / "after", hand=hand, progress=False)
    assert after["hand"]["branches"][0]["coordinates"][2]["joint"] == "aminn_last" != before["hand"]["branches"][0]
    one, other = (read_data(tmp_path / name) for name in ("before", "after"))
    for name, values in one.samples.items():
        np.testing.assert_array_equal(values, other.samples[name], err_msg=name)


def test_damaged_model_names_the_file(hand: Path) -> None:
    (hand.parent / "three_finger_hand.xml").write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    with pytest.raises(AminnError, match=r"three_finger_hand\.xml: not XML"):
        open_hand(hand)


def test_unreachable_synergy_range(hand: Path) -> None:
    change(hand, "delta = 1.0458\nrange = [-1.0, 1.0]", "delta = 1.0458\nrange = [-1.0, 6.0]")
    with pytest.raises(AminnError, match=r"cannot be reached: at size -1, spread -1, curl 6 joint finger1_distal"):
        open_hand(hand)


def test_tool_larger_than_the_span(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"radius_max_m 0\.06 makes tools larger than the hand's span"):
        simulate(SimulationConfig(grasps=1, radius_max_m=0.06), tmp_path / "data", progress=False)
    assert not (tmp_path / "data").exists()


def test_soft_fingers_resist_a_twist(hand: Path) -> None:
    """About the pinch axis point contacts give way sooner than soft fingers do."""
    point = open_hand(hand).simulator()
    change(hand, 'model = "point"', 'model = "soft_finger"')
    change(hand, "torsional_friction_m = 0.003", "torsional_friction_m = 0.010")
    soft = open_hand(hand).simulator()
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
    with pytest.raises(SimulationError, match=r"another configuration \(hand three_finger_hand as it was\)"):
        simulate(small, tmp_path / "data", progress=False, hand=hand)


def test_a_hand_file_may_be_called_otherwise_or_moved(hand: Path, tmp_path: Path) -> None:
    small = SimulationConfig(grasps=1, cases=1)
    first = simulate(small, tmp_path / "data", progress=False, hand=hand)
    moved = shutil.copytree(hand.parent, tmp_path / "elsewhere") / "mine.toml"
    (moved.parent / hand.name).rename(moved)
    assert simulate(small, tmp_path / "data", progress=False, hand=moved) == first
    change(moved, "# MJCF of the hand", "# Model of the hand")
    with pytest.raises(SimulationError, match=r"another configuration \(the files of the hand\)"):
        simulate(small, tmp_path / "data", progress=False, hand=moved)


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


# --- what the engine reads decides the identity ---------------------------------------------------------------------
CUBE = struct.pack("<80sI", b"", 4) + b"".join(
    struct.pack("<12fH", *(0, 0, 0), *(c for p in face for c in p), 0)
    for face in (
        ((0, 0, 0), (0, 0.01, 0), (0.01, 0, 0)),
        ((0, 0, 0), (0.01, 0, 0), (0, 0, 0.01)),
        ((0, 0, 0), (0, 0, 0.01), (0, 0.01, 0)),
        ((0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)),
    )
)
GEOM = '<body><geom type="mesh" mesh="part" contype="0" conaffinity="0" mass="0.001"/></body>'
MESH = '<asset><mesh name="part" file="{}"/></asset><worldbody>' + GEOM + "</worldbody>"
HEIGHT = struct.pack("<ii4f", 2, 2, 0, 0, 0, 0)
FIELD = '<asset><hfield name="ground" file="{}" size="1 1 1 1"/></asset>'
TEXTURE = '<asset><texture name="t" type="{}" {}/></asset>'


def png(shade: int) -> bytes:
    image = io.BytesIO()
    matplotlib.image.imsave(image, np.full((4, 4, 3), shade, np.uint8), format="png")
    return image.getvalue()


# How a scene may refer to a file: what is put into the scene, and the file's place.
REFERENCES = {
    "include": ('<include file="more.xml"/>', "more.xml"),
    "include, other quotes": ("<include file='more.xml'/>", "more.xml"),
    "include, spaces and lines": ('<include\n   file = "more.xml" ></include>', "more.xml"),
    "include, upper case": ('<INCLUDE file="more.xml"/>', "more.xml"),
    "include in a folder": ('<include file="sub/more.xml"/>', "sub/more.xml"),
    "include outside": ('<include file="../more.xml"/>', "../more.xml"),
    "include with an entity": ('<include file="m&#111;re.xml"/>', "more.xml"),
    "include, its name's end": ('<include file="more.mjcf"/>', "more.mjcf"),
    "include within": ("<worldbody><include file='more.xml'/></worldbody>", "more.xml"),
    "mesh": (MESH.format("part.stl"), "part.stl"),
    "mesh, upper case": (MESH.format("PART.STL"), "PART.STL"),
    "mesh, meshdir": ('<compiler meshdir="meshes"/>' + MESH.format("part.stl"), "meshes/part.stl"),
    "mesh, meshdir below": ('<compiler meshdir="a/b/"/>' + MESH.format("c/part.stl"), "a/b/c/part.stl"),
    "mesh, meshdir absolute": ('<compiler meshdir="{folder}/meshes"/>' + MESH.format("part.stl"), "meshes/part.stl"),
    "mesh, absolute": (MESH.format("{folder}/elsewhere/part.stl"), "elsewhere/part.stl"),
    "mesh, stripped path": ('<compiler strippath="true" meshdir="m"/>' + MESH.format("C:/his/part.stl"), "m/part.stl"),
    "height field": (FIELD.format("ground.hf"), "ground.hf"),
    "height field, meshdir": ("<compiler meshdir='m'/>" + FIELD.format("ground.hf"), "m/ground.hf"),
    "texture": (TEXTURE.format("2d", 'file="t.png"'), "t.png"),
    "texture, texturedir": ("<compiler texturedir='t'/>" + TEXTURE.format("2d", 'file="t.png"'), "t/t.png"),
    "texture of a side": (TEXTURE.format("cube", 'fileright="side.png"'), "side.png"),
}


def versions(name: str) -> tuple[bytes, bytes]:
    """Two contents for a file."""
    if name.lower().endswith("stl"):
        return CUBE, CUBE.replace(struct.pack("<f", 0.01), struct.pack("<f", 0.02))
    if name.endswith("hf"):
        return HEIGHT, HEIGHT[:-4] + struct.pack("<f", 1)
    if name.endswith("png"):
        return png(10), png(200)
    return b"<mujoco><custom><numeric name='a' data='1'/></custom></mujoco>", b"<mujoco/>"


@pytest.mark.parametrize("how", REFERENCES)
def test_every_file_that_the_engine_reads_is_hashed(hand: Path, how: str, trust: dict) -> None:
    text, place = REFERENCES[how]
    text = text.replace("{folder}", str(hand.parent))
    file = hand.parent / place
    file.parent.mkdir(parents=True, exist_ok=True)
    change(hand.parent / "three_finger_hand.xml", "</mujoco>", text + "</mujoco>")
    hashes = []
    contents = versions(place)
    if "within" in how:
        contents = (b"<mujoco><site name='a'/></mujoco>", b"<mujoco><site name='b'/></mujoco>")
    for content in contents:
        file.write_bytes(content)
        found = open_hand(hand)
        found.simulator()
        hashes.append(found.model_hashes())
    name = os.path.relpath(file, hand.parent)
    assert hashes[0][name] != hashes[1][name] and len(hashes[0]) == 3
    file.unlink()
    with pytest.raises(AminnError, match=re.escape(file.name)):
        open_hand(hand)
    trust["files_references_to_model_files"] = int(trust.get("files_references_to_model_files", 0)) + 1


def test_what_was_read_is_what_is_simulated(hand: Path) -> None:
    """A file that changes after the hand file was read changes neither the hash nor the model."""
    found, gap = open_hand(hand), open_hand(hand).simulator().gap(np.zeros(3))
    before = found.model_hashes()
    (hand.parent / "three_finger_hand.xml").write_text("<mujoco/>")
    assert found.model_hashes() == before and found.simulator().gap(np.zeros(3)) == gap


def test_the_default_hand_is_what_it_was() -> None:
    folder = default_hand_file().parent
    files = {"the hand file": "hand.toml", "three_finger_hand.xml": "three_finger_hand.xml"}
    expected = {name: hashlib.sha256((folder / file).read_bytes()).hexdigest() for name, file in files.items()}
    assert open_hand().model_hashes() == expected


def test_files_of_one_name_are_told_apart(hand: Path) -> None:
    """The engine knows files by their names alone, without folders."""
    for folder, size in (("a", 0.01), ("b", 0.02)):
        (hand.parent / folder).mkdir()
        (hand.parent / folder / "part.stl").write_bytes(CUBE.replace(struct.pack("<f", 0.01), struct.pack("<f", size)))
    assets = '<asset><mesh name="one" file="a/part.stl"/><mesh name="other" file="b/part.stl"/></asset>'
    change(hand.parent / "three_finger_hand.xml", "</mujoco>", assets + "</mujoco>")
    found = open_hand(hand)
    assert {"a/part.stl", "b/part.stl"} <= set(found.model_hashes()) and len(set(found.understood.assets.values())) == 2
    found.simulator()


def test_entities_are_read_as_xml_has_them(hand: Path) -> None:
    """What a document type renames is followed, so what the engine gets is what is hashed."""
    model = hand.parent / "three_finger_hand.xml"
    (hand.parent / "more.xml").write_text("<mujoco/>")
    text = model.read_text().replace("</mujoco>", '<include file="&other;.xml"/></mujoco>')
    model.write_text('<!DOCTYPE mujoco [<!ENTITY other "more">]>\n' + text)
    assert "more.xml" in open_hand(hand).model_hashes()
