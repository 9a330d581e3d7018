"""ROS 2 bags of pushes: both storages give the pushes, and every fault is named by topic and message."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record import (
    LATE_NS,
    PUSH_S,
    Message,
    gz_contacts,
    in_frame,
    joints,
    messages,
    record,
    tool,
    touch,
    vector,
    wrench,
)

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import rotation
from aminn_table import Map, TableError, read_map, read_table
from aminn_table.columns import LABELLED, Arrays
from aminn_table.mapping import Pose, product, quaternion_of, rotation_vector

Change = Callable[[list[Message]], object]

SENSOR = Pose(rotation(np.array([0.3, -0.2, 1.1])), np.array([0.02, -0.01, 0.15]))
"""A force sensor that stands in the palm's frame; a camera as well."""
SENSOR_TOML = "position_m = [0.02, -0.01, 0.15]\nrotation_rad = [0.3, -0.2, 1.1]\n"


def map_text(hand: Hand, contacts: bool = True, load: str = 'about = "tool"') -> str:
    """The map of `messages`."""
    topics = {"joints": "/joint_states", "tool": "/tool", "pushes": "/push", "grasp": "/grasp"}
    text = "".join(f'[{name}]\ntopic = "{topic}"\n' for name, topic in topics.items())
    text += f'[load]\ntopic = "/wrench"\n{load}\n'
    for branch in hand.branches if contacts else ():
        text += f'[contacts.{branch.name}]\ntopic = "/touch/{branch.name}"\non = "touching"\n'
        text += 'point = "point"\nnormal = "normal"\nforce = "force"\n'
    return text


def as_map(folder: Path, text: str) -> Map:
    (folder / "map.toml").write_text(text)
    return read_map(folder / "map.toml")


def assert_same(read: Arrays, pushes: Arrays) -> None:
    assert set(read) == set(pushes)
    for name, values in pushes.items():
        np.testing.assert_allclose(read[name], values, atol=1e-12, rtol=0 if name != "time_s" else 1e-15, err_msg=name)


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_both_storages_give_the_pushes(storage: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    bag = record(tmp_path / "bag", storage, messages(lab_hand, pushes))
    by = as_map(tmp_path, map_text(lab_hand))
    read = read_table(bag, lab_hand, LABELLED, by)
    assert_same(read, pushes)
    (alone,) = [file for file in bag.iterdir() if file.suffix in (".mcap", ".db3")]
    again = read_table(alone, lab_hand, LABELLED, by)
    assert all(np.array_equal(again[name], read[name]) for name in read)


def test_sensors_in_other_frames_units_and_signs(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """A camera, a force sensor that tells the reaction in kN and N.mm about its own origin, degrees, millimetres."""

    def change(every: list[Message]) -> None:
        where = {}
        own = quaternion_of(rotation_vector(quaternion_of(np.array([0.3, -0.2, 1.1]))) * [-1, -1, -1])
        for i, m in enumerate(every):
            if m.topic == "/joint_states":
                m.value.position = np.rad2deg(m.value.position)
                m.value.position[m.value.name.index("thumb_proximal")] *= -1
                m.value.name = [f"hand_{name}" for name in m.value.name]
            elif m.topic == "/tool":
                p, q = m.value.pose.position, m.value.pose.orientation
                at, turn = np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])
                where.setdefault(len(where) if m.stamp % 10**9 == LATE_NS else "other", at)
                every[i] = tool(m.stamp, 1e3 * (SENSOR.turn.T @ (at - SENSOR.origin)), -product(own, turn), "sensor")
        last = None
        for i, m in enumerate(every):
            if m.topic == "/tool" and m.stamp % (10 * 10**9) == LATE_NS:
                p = m.value.pose.position
                last = SENSOR.point(1e-3 * np.array([p.x, p.y, p.z]))
            if m.topic == "/wrench":
                f, t = m.value.wrench.force, m.value.wrench.torque
                force, moment = np.array([f.x, f.y, f.z]), np.array([t.x, t.y, t.z])
                moment = moment + np.cross(last - SENSOR.origin, force)
                turned = np.concatenate([1e-3 * SENSOR.turn.T @ force, 1e3 * SENSOR.turn.T @ moment])
                weight = np.array([1e-4, 0, 0, 0, 3.0, 0])
                every[i] = wrench(m.stamp, weight - turned, "sensor")

    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes), change)
    text = map_text(lab_hand, load='frame = "sensor"\nsign = -1\nforce_unit = "kN"\nmoment_unit = "N.mm"\ntare = true')
    names = ", ".join(f'{joint} = "hand_{joint}"' for joint in lab_hand.joints)
    own = f'unit = "deg"\nnames = {{ {names} }}\nsign = {{ thumb_proximal = -1 }}\n'
    text = text.replace('"/joint_states"\n', f'"/joint_states"\n{own}')
    text = text.replace('"/tool"\n[', '"/tool"\nframe = "sensor"\nunit = "mm"\n[')
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, f"{text}[frames.sensor]\n{SENSOR_TOML}"))
    assert_same(read, pushes)


def test_contacts_of_a_simulator_in_the_fingertips_frames(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """Lists that are empty without contact; positions in a frame that moves with the fingertip; normals outwards."""
    pushes["contacts"][5, 1] = 0.0

    def change(every: list[Message]) -> None:
        k = -1
        for i, m in enumerate(every):
            if m.topic == "/joint_states":
                k += 1
            for b, branch in enumerate(lab_hand.branches):
                if m.topic == f"/touch/{branch.name}":
                    _, _, turn, origin = branch.pose(pushes["q"][k, lab_hand.branch_joints[b]])
                    tip = Pose(turn, origin).times(Pose(np.eye(3), np.array(branch.tip_point_m)))
                    every[i] = gz_contacts(
                        m.stamp, branch.name, in_frame(tip, pushes["contacts"][k, b]), f"{branch.name}_tip"
                    )

    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes), change)
    text = map_text(lab_hand, contacts=False)
    for branch in lab_hand.branches:
        text += f'[contacts.{branch.name}]\ntopic = "/contacts/{branch.name}"\nframe = "{branch.name}_tip"\n'
        text += 'on = "contacts"\npoint = "contacts.0.positions.0"\nnormal = "contacts.0.normals.0"\nnormal_sign = -1\n'
        text += 'force = "contacts.0.wrenches.0.body_1_wrench.force"\n'
        text += f'[frames.{branch.name}_tip]\nparent = "{branch.name}"\nposition_m = {list(branch.tip_point_m)}\n'
    assert_same(read_table(bag, lab_hand, LABELLED, as_map(tmp_path, text)), pushes)


def test_a_sensor_on_the_tool_turns_with_it(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    def change(every: list[Message]) -> None:
        for k in range(len(pushes["q"])):
            x, dx = pushes["x_ht"][k], pushes["dx_ht"][k]
            under = round((pushes["time_s"][k] + PUSH_S) * 1e9) - LATE_NS
            turn = rotation(rotation_vector(product(quaternion_of(dx[3:]), quaternion_of(x[3:]))))
            f, t = pushes["w_e"][k, :3], pushes["w_e"][k, 3:]
            moment = t + np.cross(x[:3] - (x[:3] + dx[:3]), f)  # about where the sensor is now
            own = np.concatenate([turn.T @ f, turn.T @ moment])
            every[:] = [wrench(m.stamp, own, "tool") if (m.topic, m.stamp) == ("/wrench", under) else m for m in every]
        every[:] = [
            wrench(m.stamp, np.zeros(6), "tool") if m.topic == "/wrench" and m.value.header.frame_id == "palm" else m
            for m in every
        ]

    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes), change)
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand, load='frame = "tool"')))
    assert_same(read, pushes)


def test_pushes_are_found_by_the_load_itself(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """Without marks: before the force rises, and before it falls; states are means over a window."""
    pushes["w_e"][:, :3] *= np.maximum(1, 1.0 / np.linalg.norm(pushes["w_e"][:, :3], axis=1))[:, None]

    def stream() -> list[Message]:
        every = [m for m in messages(lab_hand, pushes) if m.topic == "/grasp"]
        for k, time in enumerate(pushes["time_s"]):
            for i in range(-20, 60):
                t = round(time * 1e9) + i * 50_000_000
                loaded, x, dx = 0 < i < 40, pushes["x_ht"][k], pushes["dx_ht"][k]
                shaken = 1e-5 * (-1) ** i
                every.append(joints(lab_hand, t, pushes["q"][k] + shaken))
                every.append(wrench(t, pushes["w_e"][k] * loaded))
                turn = product(quaternion_of(dx[3:]), quaternion_of(x[3:])) if loaded else quaternion_of(x[3:])
                every.append(tool(t, x[:3] + dx[:3] * loaded + shaken, turn * (-1) ** i))
                every += [touch(t, b.name, pushes["contacts"][k, j]) for j, b in enumerate(lab_hand.branches)]
        return every

    bag = record(tmp_path / "bag", "SQLITE3", stream())
    text = map_text(lab_hand).replace('topic = "/push"', "settle_s = 0.2") + "[clock]\nwindow_s = 0.36\n"
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, text))
    assert len(read["q"]) == len(pushes["q"])
    for name in ("q", "x_ht", "w_e", "contacts", "dx_ht", "grasp_id"):
        np.testing.assert_allclose(read[name], pushes[name], atol=1e-9, err_msg=name)


def nth(topic: str, number: int, change: Callable[[Message], object]) -> Change:
    """A change of one message of a topic."""
    return lambda every: change([m for m in sorted(every, key=lambda m: m.recorded) if m.topic == topic][number])


def later(m: Message, seconds: float) -> None:
    """The clock of a message's sender, that much ahead."""
    m.value.header.stamp.sec += round(seconds)


def without(topic: str) -> Change:
    return lambda every: every.__setitem__(slice(None), [m for m in every if m.topic != topic])


def put(path: str, value: object) -> Callable[[Message], object]:
    """A change that sets a field of a message."""

    def change(m: Message) -> None:
        *way, last = path.split(".")
        target = m.value
        for name in way:
            target = getattr(target, name)
        setattr(target, last, value)

    return change


def from_then_on(topic: str, number: int, seconds: float) -> Change:
    def change(every: list[Message]) -> None:
        for m in sorted((m for m in every if m.topic == topic), key=lambda m: m.recorded)[number:]:
            later(m, seconds)

    return change


FAULTS: dict[str, tuple[Change, str]] = {
    "missing topic": (without("/wrench"), "topic /wrench (load) is not in the bag; there are /grasp, /joint_states"),
    "clock set back": (nth("/tool", 7, lambda m: later(m, -60)), "/tool message 7: stamp is 5"),
    "clock jump": (from_then_on("/wrench", 5, 3600), "/wrench message 5: stamp jumps by 3600 s against"),
    "no stamp": (nth("/tool", 2, lambda m: put("header.stamp", type(m.value.header.stamp)(0, 0))(m)),
                 "/tool message 2: header has no stamp"),
    "wrong frame": (nth("/tool", 4, put("header.frame_id", "world")),
                    "/tool message 4: frame_id is 'world', the map expects 'palm'"),
    "wrench in another frame": (nth("/wrench", 3, put("header.frame_id", "ft_link")),
                                "/wrench message 3: frame_id is 'ft_link'"),
    "quaternion": (nth("/tool", 1, put("pose.orientation.w", 1.5)), "/tool message 1: orientation has length 1."),
    "NaN": (nth("/wrench", 9, put("wrench.force.y", float("nan"))), "/wrench message 9: force is NaN or infinite"),
    "NaN joint": (nth("/joint_states", 3, lambda m: m.value.position.__setitem__(2, np.inf)),
                  "/joint_states message 3: position of finger2_distal is NaN"),
    "joint missing": (nth("/joint_states", 2, lambda m: m.value.name.__setitem__(0, "thumb_distl")),
                      "/joint_states message 2: has no joint 'thumb_distal'; did you mean 'thumb_distl'?"),
    "no message in time": (lambda every: every.remove([m for m in every if m.topic == "/joint_states"][6]),
                           "/push message 12: has no message of /joint_states within 0.02 s; the nearest is"),
    "unknown phase": (nth("/push", 3, put("data", "bfore")), "/push message 3: data is 'bfore', expected 'before'"),
    "push without end": (lambda every: every.remove([m for m in every if m.topic == "/push"][3]),
                         "/push message 3: begins a push, but that of message 2 has not ended"),
    "end without beginning": (lambda every: every.remove(next(m for m in every if m.topic == "/push")),
                              "/push message 0: ends a push that has not begun"),
    "no grasp yet": (lambda every: every.remove(next(m for m in every if m.topic == "/grasp")),
                     "/push message 0: stands before the first message of /grasp"),
    "normal": (nth("/touch/thumb", 0, put("normal", vector(np.array([0.0, 2.0, 0.0])))),
               "/push message 0: contact_thumb_nx, ny, nz has length 2"),
    "degrees": (lambda every: [m.value.position.__imul__(57.3) for m in every if m.topic == "/joint_states"],
                "are these degrees"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_by_topic_and_message(name: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    change, text = FAULTS[name]
    bag = record(tmp_path / "bag", "SQLITE3" if len(name) % 2 else "MCAP", messages(lab_hand, pushes), change)
    with pytest.raises(AminnError) as error:
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))
    said = [str(fault) for fault in error.value.faults] if isinstance(error.value, TableError) else [str(error.value)]
    assert any(text in line for line in said), said


def test_faults_of_a_kind_are_counted(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    change: Change = lambda every: [put("header.frame_id", "world")(m) for m in every if m.topic == "/tool"]  # noqa: E731
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes), change)
    with pytest.raises(TableError, match=r"/tool message 0: frame_id is 'world'.*\(and 71 more /tool messages\)$"):
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))


def edited(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


def more(text: str) -> Callable[[str], str]:
    return lambda whole: whole + text


MAPS: dict[str, tuple[Callable[[str], str], str]] = {
    "unknown field": (edited("[load]", "[load]\nsing = -1"), "load.sing is not a field of a map"),
    "unit": (edited("[load]", '[load]\nforce_unit = "lbf"'), "load.force_unit: input should be 'N'"),
    "no joints": (edited("[joints]", "[grasp2]"), "grasp2 is not a field of a map; did you mean grasp?"),
    "no tool": (edited('[tool]\ntopic = "/tool"\n', ""), "a bag needs a map with [tool]"),
    "no grasp": (edited('[grasp]\ntopic = "/grasp"\n', ""), "says nowhere which grasp a push is of"),
    "topic": (edited('"/wrench"', '"/wrenc"'), "topic /wrenc (load) is not in the bag; did you mean /wrench?"),
    "type": (edited('"/wrench"', '"/tool"'), "has geometry_msgs/msg/PoseStamped, expected geometry_msgs/msg/Wrench"),
    "branch": (edited("[contacts.thumb]", "[contacts.thum]"), "the map has contacts.thum; hand synthetic has"),
    "joint": (edited("[tool]", 'names = { elbow = "e" }\n[tool]'), "the map has joint elbow; hand synthetic has"),
    "path": (edited('"touching"', '"touch"'), "/touch/finger1 message 0: has no field 'touch'"),
    "frame": (edited("[load]", '[load]\nframe = "ft"'), "[load] is in frame 'ft', which is not"),
    "parent": (edited("[load]", '[frames.f]\nparent = "arm"\n[load]\nframe = "f"'), "frames.f.parent is 'arm'"),
    "moving camera": (edited("[tool]", '[frames.c]\nparent = "tool"\n[tool]\nframe = "c"'), "which moves in the palm"),
    "two turns": (more("[frames.a]\nrotation_rad = [0, 0, 1]\nquaternion_xyzw = [0, 0, 0, 1]\n"), "not both"),
    "long turn": (more("[frames.a]\nquaternion_xyzw = [0, 0, 1, 1]\n"), "quaternion_xyzw has length 1.414"),
}  # fmt: skip


@pytest.mark.parametrize("name", MAPS)
def test_maps_that_do_not_fit_are_refused_by_name(name: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    edit, text = MAPS[name]
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes))
    with pytest.raises(AminnError) as error:
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, edit(map_text(lab_hand))))
    assert text in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["cut.mcap", "cut.db3", "empty.mcap", "text.db3"])
def test_damaged_bags_are_refused(name: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    storage = "MCAP" if name.endswith("mcap") else "SQLITE3"
    bag = record(tmp_path / "bag", storage, messages(lab_hand, pushes))
    (whole,) = [file for file in bag.iterdir() if file.suffix in (".mcap", ".db3")]
    content = {"cut": whole.read_bytes()[: whole.stat().st_size // 2], "empty": b"", "text": b"no bag " * 100}
    (tmp_path / name).write_bytes(content[name.split(".")[0]])
    with pytest.raises(AminnError, match=name):
        read_table(tmp_path / name, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))
    (bag / "metadata.yaml").rename(tmp_path / "lost.yaml")
    with pytest.raises(AminnError, match=r"bag: a folder without metadata\.yaml is no ROS 2 bag"):
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}\n")
    with pytest.raises(AminnError, match="not a readable ROS 2 bag"):
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))


def test_a_push_under_which_the_grasp_gave_way(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    pushes["stable"][[2, 9]] = 0
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes))
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))
    pushes["dx_ht"][[2, 9]] = 0.0
    assert_same(read, pushes)


def test_contacts_that_no_topic_tells_are_left_to_the_fallbacks(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes))
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand, contacts=False)))
    assert (read["contacts"][..., 0] == 1).all() and np.isnan(read["contacts"][..., 1:]).all()


@pytest.mark.parametrize("error", [OverflowError("too large"), MemoryError(), IndexError("out of range")])
def test_whatever_the_library_raises_is_one_line(
    error: Exception, lab_hand: Hand, pushes: Arrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, pushes))

    def damaged(*_: object) -> object:
        raise error

    monkeypatch.setattr("aminn_table.bags.AnyReader.deserialize", damaged)
    with pytest.raises(AminnError, match="bag: not a readable ROS 2 bag"):
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand)))
