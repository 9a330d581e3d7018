"""Models that the simulation's MuJoCo refuses: each converted with the same numbers, or refused by name."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_hand.hand_file import HandFile, model_path
from aminn_sim import _core
from aminn_sim.convert import convert, convert_to
from aminn_sim.mjcf_tree import read_mjcf, text_of
from aminn_sim.understand import understand

mujoco = pytest.importorskip("mujoco", reason="the current MuJoCo is not installed: pip install 'aminn[mujoco]'")

FINGER = """
<body name="{n}_1" pos="0 {y} 0.02">
  <joint name="{n}_1" axis="{a} 0 0" range="-0.2 1.5" {joint}/>
  <geom type="capsule" size="0.006" fromto="0 0 0.008 0 0 0.035" contype="0" conaffinity="0"/>
  <frame pos="0 0 0.03"><frame pos="0 0 0.01" euler="0 0 0">
    <body name="{n}_2">
      <joint name="{n}_2" axis="{a} 0 0" range="-0.2 1.5"/>
      <frame pos="0 0 0.03">{tip}</frame>
    </body>
  </frame></frame>
</body>"""
TIP = '<geom name="{n}_tip" size="0.008" mass="0.01"/>'
SERVOS = "".join(
    f'<position name="{n}" joint="{n}" kp="2" kv="0.05"/>' for n in ("left_1", "left_2", "right_1", "right_2")
)


def hand(
    *, option: str = "", joint: str = "", tip: str = TIP, actuator: str = SERVOS, rest: str = "", tops: str = ""
) -> str:
    """A hand of two fingers in the dialect of the current MuJoCo."""
    fingers = "".join(
        FINGER.format(n=n, y=y, a=a, joint=joint, tip=tip.format(n=n))
        for n, y, a in (("left", 0.03, 1), ("right", -0.03, -1))
    )
    return (
        f'<mujoco model="new"><compiler angle="radian"/>{option}{tops}<worldbody><body name="palm">'
        f'<geom name="palm" type="box" size="0.02 0.04 0.01"/>{fingers}</body></worldbody>'
        f"<actuator>{actuator}</actuator>{rest}</mujoco>"
    )


def write_hand(folder: Path, model: str, name: str = "hand.xml", sheet: str = "") -> Path:
    (folder / name).write_text(model)
    file = folder / "hand.toml"
    file.write_text(f'name = "new"  # mine\nmodel = "{name}"\n{sheet}')
    return file


MESH_VERTICES = " ".join(f"{x} {y} {z}" for x in (-0.006, 0.006) for y in (-0.006, 0.008) for z in (-0.006, 0.01))
TENDON = (
    '<tendon><fixed name="pull"><joint joint="left_1" coef="0.01"/><joint joint="left_2" coef="0.01"/></fixed></tendon>'
)
ACCEPTED = {
    "servos with kv, limits by range alone, nested frames": hand(),
    "options of newer engines": hand(
        option='<option integrator="implicitfast" ls_iterations="20"><flag nativeccd="enable"/></option>'
    ),
    "inertia drawn as ellipsoids": hand(tops='<visual><global ellipsoidinertia="true"/></visual>'),
    "a force limit on a joint": hand(joint='actuatorfrcrange="-0.5 0.5"'),
    "mesh fingertips": hand(
        tops=f'<asset><mesh name="pad" vertex="{MESH_VERTICES}" inertia="convex"/></asset>',
        tip='<geom name="{n}_tip" type="mesh" mesh="pad"/>',
    ),
    "replicated colliders": hand(
        tip='<replicate count="3" offset="0 0.002 0"><geom name="{n}_tip" size="0.006"/></replicate>'
    ),
    "a filtered servo": hand(actuator=SERVOS.replace('kv="0.05"', 'kv="0.05" timeconst="0.01"')),
    "a filtered servo before others": hand(actuator=SERVOS.replace('kv="0.05"', 'kv="0.05" timeconst="0.01"', 1)),
    "gravity compensation": hand(rest="").replace('<body name="left_1"', '<body name="left_1" gravcomp="1"'),
    "a hand on a free joint": hand().replace('<body name="palm">', '<body name="palm"><freejoint/>'),
    "a coupling and a tendon": hand(
        actuator=SERVOS + '<position name="pull" tendon="pull" kp="100" kv="1" forcerange="-5 0"/>',
        rest=TENDON + '<equality><joint joint1="right_2" joint2="right_1" polycoef="0 0.7 0 0 0"/></equality>',
    ),
}
REFUSED = {
    "a plugin actuator": (
        hand(
            option='<extension><plugin plugin="mujoco.pid"/></extension>',
            actuator='<plugin name="knuckle" joint="left_1" plugin="mujoco.pid"><config key="kp" value="2"/></plugin>',
        ),
        ("knuckle", "plugin", "left_1", "servo_Nm_rad", "<position>"),
    ),
    "an actuator of two commands": (
        hand(actuator='<pid name="knuckle" joint="left_1"/>' + SERVOS),
        ("knuckle", "pid", "left_1", "servo_Nm_rad"),
    ),
    "a force limit on a joint that a cable moves too": (
        hand(
            joint='actuatorfrcrange="-0.5 0.5"',
            tip=TIP + '<site name="{n}_site"/>',
            actuator=SERVOS + '<motor name="more" tendon="cable"/>',
            rest='<tendon><spatial name="cable"><site site="left_site"/><site site="right_site"/></spatial></tendon>',
        ),
        ("joint left_1", "actuatorfrcrange", "a tendon drives"),
    ),
    "a tendon spring with a dead band": (
        hand(rest=TENDON.replace('name="pull"', 'name="pull" stiffness="9" springlength="0 0.01"')),
        ("tendon pull", "dead band"),
    ),
    "a force limit on a joint of two actuators": (
        hand(joint='actuatorfrcrange="-0.5 0.5"', actuator=SERVOS + '<motor name="more" joint="left_1"/>'),
        ("joint left_1", "actuatorfrcrange"),
    ),
    "a force limit on a tendon": (
        hand(rest=TENDON.replace('name="pull"', 'name="pull" actuatorfrcrange="-1 1"')),
        ("tendon pull", "actuatorfrcrange"),
    ),
    "sites tied to each other": (
        hand(
            tip=TIP + '<site name="{n}_site"/>',
            rest='<equality><connect name="knot" site1="left_site" site2="right_site"/></equality>',
        ),
        ("equality knot", "connect between sites"),
    ),
    "what no engine takes": (hand(rest="<nonsense/>"), ("MuJoCo 4", "nonsense")),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_newer_model_comes_through_with_the_same_numbers(name: str, tmp_path: Path) -> None:
    file = write_hand(tmp_path, ACCEPTED[name])
    with pytest.raises(AminnError, match=f"aminn hand convert {file} --out FOLDER"):
        understand(file)
    result = CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "new" / "report.json").read_text())
    assert all(row["same"] for row in report["rows"].values())
    assert (tmp_path / "new" / "report.txt").read_text().splitlines()[0] in result.output
    assert report["rows"]["joints"]["converted"] == ("5" if "freejoint" in ACCEPTED[name] else "4")
    found = understand(tmp_path / "new" / "hand.toml").hand
    assert [len(b.coordinates) for b in found.branches] == [2, 2]
    assert found.branches[0].coordinates[1].anchor_m == pytest.approx((0, 0.03, 0.06))
    assert [c.servo_Nm_rad for b in found.branches for c in b.coordinates] == [2.0] * 4
    assert file.read_text().startswith('name = "new"')  # the original stays


@pytest.mark.parametrize("name", REFUSED)
def test_loss_is_refused_by_name(name: str, tmp_path: Path) -> None:
    model, words = REFUSED[name]
    file = write_hand(tmp_path, model)
    result = CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")])
    assert result.exit_code == 1
    assert all(word in result.output for word in words), result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "new").exists()


def test_limits_of_joints_become_limits_of_their_actuators(tmp_path: Path) -> None:
    file = write_hand(tmp_path, ACCEPTED["a force limit on a joint"])
    engine = _core.Engine(text_of(convert(tmp_path / "hand.xml").root))
    assert engine.model("actuator_forcelimited").tolist() == [1, 0, 1, 0]
    assert engine.model("actuator_forcerange")[0].tolist() == [-0.5, 0.5]
    assert file.exists()


@pytest.mark.parametrize("told", ["{ left_1 = 1.5 }", "{ default = 1.5 }"])
@pytest.mark.parametrize("kind", ["plugin", "pid"])
def test_lost_actuator_is_not_missed_where_the_hand_file_tells_the_stiffness(
    kind: str, told: str, tmp_path: Path
) -> None:
    lost = '<plugin name="knuckle" joint="left_1" plugin="mujoco.pid"/>' if kind == "plugin" else (
        '<pid name="knuckle" joint="left_1"/>'
    )  # fmt: skip
    model = hand(
        option='<extension><plugin plugin="mujoco.pid"/></extension>', actuator=lost + SERVOS[SERVOS.index("/>") + 2 :]
    )
    file = write_hand(tmp_path, model, sheet=f"[stiffness]\nservo_Nm_rad = {told}\n")
    result = CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    assert "actuator knuckle" in result.output and "is left out" in result.output
    found = understand(tmp_path / "new" / "hand.toml").hand
    assert [c.servo_Nm_rad for b in found.branches for c in b.coordinates] == [1.5, 2.0, 2.0, 2.0]


SHEETS = {
    'name = "new"\n  model = "hand.xml" # mine\n[contact]\nmodel = "soft_finger"\n': True,
    "model = 'hand.xml'\nname = \"new\"": True,
    'name = "new"\n"model" = "hand.xml"\n[contact]\nmodel = "soft_finger"\n': False,
}


@pytest.mark.parametrize(("sheet", "taken"), SHEETS.items())
def test_only_the_model_of_a_hand_file_changes(sheet: str, taken: bool, tmp_path: Path) -> None:
    """Of a table's field of the same name nothing is taken; what cannot be told apart is refused."""
    (tmp_path / "models").mkdir()
    write_hand(tmp_path / "models", hand())
    file = tmp_path / "sheet.toml"
    file.write_text(sheet.replace("hand.xml", "models/hand.xml"))
    if not taken:
        with pytest.raises(AminnError, match="on a line of its own"):
            convert_to(file, tmp_path / "new")
        assert not (tmp_path / "new").exists()
        return
    new = convert_to(file, tmp_path / "new")
    before, after = tomllib.loads(file.read_text()), tomllib.loads(new.read_text())
    assert after.pop("model") == "hand.xml"
    assert after == {key: value for key, value in before.items() if key != "model"}


def test_what_does_not_matter_is_said(tmp_path: Path) -> None:
    write_hand(tmp_path, ACCEPTED["gravity compensation"])
    said = " ".join(convert(tmp_path / "hand.xml").warnings)
    assert "gravity compensation of left_1" in said
    assert "2 shapes that touch nothing" in said
    assert "one point a pair" in said


def settled(text: str | None, model: object | None) -> np.ndarray:
    """Angles (4) that both engines come to rest at under torques on the joints."""
    push = np.array([0.04, -0.02, 0.03, 0.05])
    if text is not None:
        engine = _core.Engine(text)
        engine.reset()
        engine.set("qfrc_applied", push)
        assert engine.step(4000)
        return np.asarray(engine.data("qpos"))
    data = mujoco.MjData(model)
    data.qfrc_applied[:] = push
    mujoco.mj_step(model, data, 4000)
    return np.array(data.qpos)


@pytest.mark.parametrize(
    "name", ["servos with kv, limits by range alone, nested frames", "mesh fingertips", "a coupling and a tendon"]
)
def test_both_engines_come_to_rest_alike(name: str, tmp_path: Path) -> None:
    implicit = '<option integrator="implicit" timestep="0.001"/><worldbody>'  # servos damp light fingers
    write_hand(tmp_path, ACCEPTED[name].replace("<worldbody>", implicit))
    original = settled(None, mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml")))
    converted = settled(text_of(convert(tmp_path / "hand.xml").root), None)
    assert np.abs(original).max() > 0.01
    assert converted == pytest.approx(original, rel=1e-4, abs=1e-6)


URDF_LINK = """<link name="{name}"><inertial><mass value="0.05"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>
</inertial><visual><geometry><mesh filename="package://nowhere/{name}.dae"/></geometry></visual>{collision}</link>"""
URDF_JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>
<origin xyz="0 {y} 0.03"/><axis xyz="{axis} 0 0"/><limit lower="-0.2" upper="1.5" effort="1" velocity="1"/>
{mimic}</joint>"""
COLLISION = "<collision><geometry>{shape}</geometry></collision>"
SPHERE = COLLISION.format(shape='<sphere radius="0.008"/>')


def urdf(tip: str = SPHERE, mimic: str = "") -> str:
    parts = [URDF_LINK.format(name="palm", collision="")]
    for n, y, axis in (("left", 0.03, 1), ("right", -0.03, -1)):
        for name, parent, collision, kind, y_ in (
            (f"{n}_1", "palm", "", "revolute", y),
            (f"{n}_2", f"{n}_1_link", "", "revolute", 0),
            (f"{n}_tip", f"{n}_2_link", tip, "fixed", 0),
        ):
            parts.append(URDF_LINK.format(name=f"{name}_link", collision=collision))
            follows = mimic.format(n=n) if name.endswith("_2") else ""
            parts.append(URDF_JOINT.format(name=name, kind=kind, parent=parent, y=y_, axis=axis, mimic=follows))
    return f'<robot name="bare">{"".join(parts)}</robot>'


def test_urdf_keeps_names_of_palm_and_tips(tmp_path: Path) -> None:
    file = write_hand(tmp_path, urdf(), "hand.urdf", "[stiffness]\nservo_Nm_rad = { default = 1.5 }\n")
    with pytest.raises(AminnError, match=f"a URDF; aminn hand convert {file}"):
        understand(file)
    result = CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    assert "servo_Nm_rad" in result.output and "[[coupling]]" in result.output
    found = understand(tmp_path / "new" / "hand.toml")
    assert found.palm == "palm"
    assert [len(b.coordinates) for b in found.hand.branches] == [2, 2]
    assert {c.servo_Nm_rad for b in found.hand.branches for c in b.coordinates} == {1.5}


def test_urdf_that_mimics_is_coupled(tmp_path: Path) -> None:
    mimic = '<mimic joint="{n}_1" multiplier="0.6" offset="0"/>'
    file = write_hand(
        tmp_path, urdf(mimic=mimic), "hand.urdf", "[stiffness]\nservo_Nm_rad = { left_1 = 1.0, right_1 = 1.0 }\n"
    )
    CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")], catch_exceptions=False)
    found = understand(tmp_path / "new" / "hand.toml").hand
    for branch in found.branches:
        (coupling,) = branch.couplings
        assert coupling.ratio == pytest.approx((-0.6, 1.0))


def test_first_links_do_not_touch_the_palm_that_they_overlap(tmp_path: Path) -> None:
    big = COLLISION.format(shape='<box size="0.1 0.1 0.09"/>')
    text = urdf()
    for name in ("palm", "left_1_link", "right_1_link"):
        text = text.replace(f"{name}.dae", f"{name}.dae.")
        at = text.index("</visual>", text.index(f"{name}.dae.")) + len("</visual>")
        text = text[:at] + big + text[at:]
    file = write_hand(tmp_path, text, "hand.urdf", "[stiffness]\nservo_Nm_rad = { default = 1.5 }\n")
    CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")], catch_exceptions=False)
    engine = _core.Engine(text_of(understand(tmp_path / "new" / "hand.toml").root))
    engine.forward()
    bodies = engine.names("body")
    touching = [{bodies[engine.model("geom_bodyid")[g]] for g in c["geoms"]} for c in engine.contacts()]
    assert not [pair for pair in touching if "palm" in pair and pair & {"left_1_link", "right_1_link"}]
    assert touching  # the two big boxes of the fingers do


def test_urdf_whose_fingertips_touch_nothing_is_refused(tmp_path: Path) -> None:
    write_hand(tmp_path, urdf(tip=""), "hand.urdf")
    with pytest.raises(
        AminnError, match=r"<collision> in the link at the end of 2 of 2 chains.*left_2_link, right_2_link"
    ):
        convert(tmp_path / "hand.urdf")


def test_meshes_of_a_package_are_found_above_the_urdf(tmp_path: Path) -> None:
    mesh = COLLISION.format(shape='<mesh filename="package://my_hand/meshes/tip.obj"/>')
    folder = tmp_path / "my_hand" / "urdf"
    folder.mkdir(parents=True)
    write_hand(folder, urdf(tip=mesh), "hand.urdf")
    with pytest.raises(AminnError, match=r"package://my_hand/meshes/tip\.obj is not there"):
        convert(folder / "hand.urdf")
    (tmp_path / "my_hand" / "meshes").mkdir()
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in ((0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)))
    (tmp_path / "my_hand" / "meshes" / "tip.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    assert {r.what: r.converted for r in convert(folder / "hand.urdf").rows}["colliders"] == "2"


def test_a_package_that_a_file_names_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of "a.b" the search would import a."""
    package = tmp_path / "path" / "aminn_test_stranger"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise SystemExit('it ran')")
    monkeypatch.syspath_prepend(str(package.parent))
    mesh = COLLISION.format(shape='<mesh filename="package://aminn_test_stranger.inner/tip.obj"/>')
    write_hand(tmp_path, urdf(tip=mesh), "hand.urdf")
    with pytest.raises(AminnError, match=r"tip\.obj is not there"):
        convert(tmp_path / "hand.urdf")
    with pytest.raises(AminnError, match="no installed Python package"):
        model_path(HandFile(name="x", model="package:aminn_test_stranger.inner/hand.xml"), tmp_path / "hand.toml")


def test_impossible_inertia_of_a_urdf_is_said(tmp_path: Path) -> None:
    model = urdf().replace('ixx="', 'ixx="1', 1)
    assert model != urdf()
    write_hand(tmp_path, model, "hand.urdf")
    assert any("an inertia that no body has is replaced" in said for said in convert(tmp_path / "hand.urdf").warnings)
    write_hand(tmp_path, urdf(), "hand.urdf")
    assert not any("inertia" in said for said in convert(tmp_path / "hand.urdf").warnings)


STRANGE = {
    "numbers that are none": (hand(joint='damping="nan"'), r"damping of <joint> left_1, nan, is not finite"),
    "an option that is none": (hand(option='<option tolerance="inf"/>'), r"tolerance of <option>, inf, is not finite"),
    "an encoding that is none": ('<?xml version="1.0" encoding="klingon"?>' + hand(), r"not XML \(unknown encoding"),
    "an encoding that Python's parser has not": (
        '<?xml version="1.0" encoding="utf-7"?>' + hand(),
        r"not XML \(multi-byte encodings are not supported",
    ),
    "elements without end": (hand(tip="<frame>" * 300 + TIP + "</frame>" * 300), r"elements .* 200 deep .* in <frame>"),
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_strange_model_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    """Found by `make fuzz-files`: tracebacks, and models of NaN that passed as the same."""
    text, message = STRANGE[name]
    (tmp_path / "hand.xml").write_text(text)
    with pytest.raises(AminnError, match=rf"^{re.escape(str(tmp_path / 'hand.xml'))}: {message}"):
        convert_to(tmp_path / "hand.xml", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_chain_that_is_too_long_is_refused(tmp_path: Path) -> None:
    """Of a URDF, whose links stand side by side."""
    parts, above = [], "palm"
    for k in range(250):
        parts.append(URDF_LINK.format(name=f"more_{k}_link", collision=SPHERE))
        parts.append(URDF_JOINT.format(name=f"more_{k}", kind="fixed", parent=above, y=0, axis=1, mimic=""))
        above = f"more_{k}_link"
    (tmp_path / "hand.urdf").write_text(urdf().replace("</robot>", f"{''.join(parts)}</robot>"))
    with pytest.raises(AminnError, match=r"hand\.urdf: elements lie more than 200 deep in each other, in <"):
        convert(tmp_path / "hand.urdf")


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    """Found by `make fuzz-files`: the file system refuses to look."""
    long = "9" * 400
    sheet = tmp_path / "hand.toml"
    sheet.write_text(f'name = "new"\nmodel = "{long}.xml"\n')
    with pytest.raises(AminnError, match=r"hand\.toml: model names .*, which is no file"):
        convert_to(sheet, tmp_path / "new")
    (tmp_path / "hand.xml").write_text(hand(tops=f'<asset><mesh name="pad" file="{long}.stl"/></asset>'))
    with pytest.raises(AminnError, match=r"<mesh> names the file 9+\.stl, which is not there"):
        read_mjcf(tmp_path / "hand.xml")
    for place in (f"{long}.stl", f"package://{long}/x.stl"):
        (tmp_path / "hand.urdf").write_text(urdf(tip=COLLISION.format(shape=f'<mesh filename="{place}"/>')))
        with pytest.raises(AminnError, match="is not there"):
            convert(tmp_path / "hand.urdf")


def test_the_engine_writes_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Left alone it writes warnings into a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.xml").write_text(hand(joint='damping="nan"'))
    with pytest.raises(AminnError, match="not finite"):
        convert("hand.xml")
    assert [file.name for file in tmp_path.iterdir()] == ["hand.xml"]


CORNERS = "v 0 0 0\nv 0.01 0 0\nv 0 0.01 0\nv 0 0 0.01\n"
FACES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def msh(last: int, size: int = 4) -> bytes:
    points, faces = [0, 0, 0, 0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01], [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, last]
    return struct.pack("<4i12f12i", size, 0, 0, 4, *points, *faces)


MESHES: dict[str, tuple[str, bytes, str]] = {
    "two vertices": ("obj", b"v 0 0 0\nv 0 0 1\n", "it has 2 vertices, a mesh has 4 or more"),
    "faces alone": ("obj", FACES.encode(), "it has 0 vertices"),
    "an end in the middle": ("obj", f"v 0 0 0\n\0{CORNERS}{FACES}".encode(), "it has 1 vertices"),
    "a vertex that is not there": ("obj", f"{CORNERS}{FACES}f 1 2 5\n".encode(), "line 9: a face names vertex '5'"),
    "one far away": ("obj", f"{CORNERS}f 1 2 2000000000\n".encode(), "line 5: a face names vertex '2000000000'"),
    "one too far back": ("obj", f"v 0 0 0\r\nf -1 -2 -1\r\n{CORNERS}".encode(), "line 2: a face names vertex '-2'"),
    "a number that is none": ("obj", f"{CORNERS}f 1 2 x\n".encode(), "line 5: a face names vertex 'x'"),
    "a coordinate that is not there": (
        "obj",
        f"{CORNERS}vt 0 0\n{FACES}f 1/1 2/2 3/1\n".encode(),
        "line 10: a face names texture coordinate '2'",
    ),
    "a normal that is not there": ("obj", f"{CORNERS}{FACES}f 1//1 2 3\n".encode(), "line 9: a face names normal '1'"),
    "a binary vertex that is not there": ("msh", msh(4), "a face names vertex 4, there are 0 to 3"),
    "one before the first": ("msh", msh(-1), "a face names vertex -1"),
    "another size": ("msh", msh(3, size=5), "its size is not what its first numbers say"),
    "no size": ("msh", b"\0\0", "it is cut short"),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_names_what_is_there(name: str, tmp_path: Path) -> None:
    """Found by `make fuzz-files`: MuJoCo 2.2.2 reads beyond its memory and ends the process."""
    end, content, message = MESHES[name]
    (tmp_path / f"pad.{end}").write_bytes(content)
    (tmp_path / "hand.xml").write_text(hand(tops=f'<asset><mesh name="pad" file="pad.{end}"/></asset>'))
    with pytest.raises(AminnError, match=rf"pad\.{end}: not a mesh that the engine can read: {re.escape(message)}"):
        read_mjcf(tmp_path / "hand.xml")


GOOD = {
    "OBJ": ("pad.obj", f"# by hand\r\no pad\n{CORNERS}vt 0 0\nvn 0 0 1\nf 1/1/1 3 2//1\n{FACES[8:]}".encode()),
    "OBJ from the end": ("pad.OBJ", f"{CORNERS}f -4 -2 -3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n".encode()),
    "MSH": ("pad.msh", msh(3)),
}


@pytest.mark.parametrize("name", GOOD)
def test_good_meshes_are_taken(name: str, tmp_path: Path) -> None:
    file, content = GOOD[name]
    (tmp_path / file).write_bytes(content)
    body = '<worldbody><body><joint/><geom type="mesh" mesh="pad"/><geom size="0.1"/></body></worldbody>'
    (tmp_path / "x.xml").write_text(f'<mujoco><asset><mesh file="{file}"/></asset>{body}</mujoco>')
    model = read_mjcf(tmp_path / "x.xml")
    assert len(_core.Engine(text_of(model.root), model.assets).model("mesh_vert"))


@pytest.mark.parametrize("face", ["0 1 9", "0 1 2000000000", "0 1 -1", "0 1 99999999999999999999", "0 1 x"])
def test_a_mesh_in_the_model_names_what_is_there(face: str, tmp_path: Path) -> None:
    mesh = f'<mesh name="pad" vertex="{MESH_VERTICES}" face="{face}"/>'
    (tmp_path / "hand.xml").write_text(hand(tops=f"<asset>{mesh}</asset>"))
    with pytest.raises(AminnError, match=r"hand\.xml: <mesh> 'pad': (a face names vertex|its faces are no whole)"):
        read_mjcf(tmp_path / "hand.xml")


def test_needs_no_opengl(tmp_path: Path) -> None:
    """Where no OSMesa is installed, only pictures are missing."""
    write_hand(tmp_path, hand())
    hide = (
        "import ctypes.util\n"
        "find = ctypes.util.find_library\n"
        "ctypes.util.find_library = lambda name: None if 'OSMesa' in name else find(name)\n"
        "from aminn_sim.convert import convert\n"
        f"print(len(convert({str(tmp_path / 'hand.xml')!r}).rows) > 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", hide], capture_output=True, text=True, timeout=120)
    assert done.stdout == "True\n", done.stderr[-500:]


def test_package_is_asked_for_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_hand(tmp_path, hand())
    monkeypatch.setitem(sys.modules, "mujoco", None)
    result = CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path / "new")])
    assert result.exit_code == 1
    assert "pip install 'aminn[mujoco]'" in result.output and len(result.output.splitlines()) == 1


def test_inputs_are_never_overwritten(tmp_path: Path) -> None:
    file = write_hand(tmp_path, hand())
    before = [(tmp_path / name).read_text() for name in ("hand.xml", "hand.toml")]
    result = CliRunner().invoke(main, ["hand", "convert", str(file), "--out", str(tmp_path)])
    assert result.exit_code == 1 and "hand.xml" in result.output
    assert before == [(tmp_path / name).read_text() for name in ("hand.xml", "hand.toml")]


def test_a_model_alone_is_converted(tmp_path: Path) -> None:
    write_hand(tmp_path, hand())
    result = CliRunner().invoke(main, ["hand", "convert", str(tmp_path / "hand.xml"), "--out", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    assert ET.parse(tmp_path / "new" / "hand.xml").getroot().tag == "mujoco"
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["hand.xml", "report.json", "report.txt"]


def test_program_as_a_module_has_the_command() -> None:
    run = [sys.executable, "-m", "aminn_app.cli", "hand", "convert", "--help"]
    assert "--out" in subprocess.run(run, capture_output=True, text=True, check=True).stdout
