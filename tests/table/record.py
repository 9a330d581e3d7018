"""Pushes as a ROS 2 bag, as a lab would record them, written with the library that reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from aminn_hand import Hand
from aminn_table.columns import Arrays
from aminn_table.mapping import Pose, matrix, product, quaternion_of

TOUCH = """std_msgs/Header header
bool touching
geometry_msgs/Point point
geometry_msgs/Vector3 normal
float64 force
"""
CONTACTS = {
    "ros_gz_interfaces/msg/Entity": "uint64 id\nstring name\nuint8 type\n",
    "ros_gz_interfaces/msg/JointWrench": "std_msgs/Header header\n"
    "std_msgs/String body_1_name\nstd_msgs/UInt32 body_1_id\nstd_msgs/String body_2_name\nstd_msgs/UInt32 body_2_id\n"
    "geometry_msgs/Wrench body_1_wrench\ngeometry_msgs/Wrench body_2_wrench\n",
    "ros_gz_interfaces/msg/Contact": "ros_gz_interfaces/Entity collision1\nros_gz_interfaces/Entity collision2\n"
    "geometry_msgs/Vector3[] positions\ngeometry_msgs/Vector3[] normals\nfloat64[] depths\n"
    "ros_gz_interfaces/JointWrench[] wrenches\n",
    "ros_gz_interfaces/msg/Contacts": "std_msgs/Header header\nros_gz_interfaces/Contact[] contacts\n",
}
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(get_types_from_msg(TOUCH, "lab_msgs/msg/Touch"))
for _name, _text in CONTACTS.items():
    STORE.register(get_types_from_msg(_text, _name))
TYPES = STORE.types
LATE_NS = 3_000_000
"""Sensors are so late after the mark, or early."""
PUSH_S = 2.0


@dataclass
class Message:
    """One message of a bag."""

    topic: str
    stamp: int
    kind: str
    value: Any
    recorded: int


def _stamp(ns: int) -> Any:
    return TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns: int, frame: str) -> Any:
    return TYPES["std_msgs/msg/Header"](stamp=_stamp(ns), frame_id=frame)


def vector(v: np.ndarray, kind: str = "Vector3") -> Any:
    return TYPES[f"geometry_msgs/msg/{kind}"](*(float(x) for x in v))


def joints(hand: Hand, ns: int, q: np.ndarray) -> Message:
    names = [*reversed(hand.joints), "wrist"]
    position = np.array([*q[::-1], 0.3])
    none = np.zeros(0)
    value = TYPES["sensor_msgs/msg/JointState"](header(ns, ""), names, position, none, none)
    return Message("/joint_states", ns, "sensor_msgs/msg/JointState", value, ns)


def tool(ns: int, position: np.ndarray, quaternion: np.ndarray, frame: str = "palm") -> Message:
    turn = TYPES["geometry_msgs/msg/Quaternion"](*map(float, quaternion))
    pose = TYPES["geometry_msgs/msg/Pose"](vector(position, "Point"), turn)
    value = TYPES["geometry_msgs/msg/PoseStamped"](header(ns, frame), pose)
    return Message("/tool", ns, "geometry_msgs/msg/PoseStamped", value, ns)


def wrench(ns: int, w: np.ndarray, frame: str = "palm") -> Message:
    value = TYPES["geometry_msgs/msg/Wrench"](vector(w[:3]), vector(w[3:]))
    stamped = TYPES["geometry_msgs/msg/WrenchStamped"](header(ns, frame), value)
    return Message("/wrench", ns, "geometry_msgs/msg/WrenchStamped", stamped, ns)


def touch(ns: int, branch: str, contact: np.ndarray, frame: str = "palm") -> Message:
    on, p, n, f = bool(contact[0]), contact[1:4], contact[4:7], float(contact[7])
    value = TYPES["lab_msgs/msg/Touch"](header(ns, frame), on, vector(p, "Point"), vector(n), f)
    return Message(f"/touch/{branch}", ns, "lab_msgs/msg/Touch", value, ns)


def gz_contacts(ns: int, branch: str, contact: np.ndarray, frame: str) -> Message:
    """Of a simulator: an empty list without contact, else a contact whose normal points out of the tool."""
    entity = TYPES["ros_gz_interfaces/msg/Entity"]
    text, number = TYPES["std_msgs/msg/String"], TYPES["std_msgs/msg/UInt32"]
    force = TYPES["geometry_msgs/msg/Wrench"](vector(-contact[7] * contact[4:7]), vector(np.zeros(3)))
    pair = TYPES["ros_gz_interfaces/msg/JointWrench"](
        header(ns, ""), text("a"), number(1), text("b"), number(2), force, force
    )
    one = TYPES["ros_gz_interfaces/msg/Contact"](
        entity(1, branch, 2), entity(2, "tool", 2), [vector(contact[1:4])], [vector(-contact[4:7])], np.zeros(1), [pair]
    )
    value = TYPES["ros_gz_interfaces/msg/Contacts"](header(ns, frame), [one] if contact[0] else [])
    return Message(f"/contacts/{branch}", ns, "ros_gz_interfaces/msg/Contacts", value, ns)


def mark(ns: int, text: str) -> Message:
    return Message("/push", ns, "std_msgs/msg/String", TYPES["std_msgs/msg/String"](text), ns)


def grasp(ns: int, number: int) -> Message:
    return Message("/grasp", ns, "std_msgs/msg/Int32", TYPES["std_msgs/msg/Int32"](number), ns)


def messages(hand: Hand, arrays: Arrays) -> Iterator[Message]:
    """Everything in the palm's frame, moments about the tool's origin. Between the marks the tool is somewhere else."""
    for k, time in enumerate(arrays["time_s"]):
        t = round(time * 1e9)
        before, x, dx, w = t + LATE_NS, arrays["x_ht"][k], arrays["dx_ht"][k], arrays["w_e"][k]
        turn = quaternion_of(x[3:])
        if k == 0 or arrays["grasp_id"][k] != arrays["grasp_id"][k - 1]:
            yield grasp(t - 10**9, int(arrays["grasp_id"][k]))
        yield joints(hand, before, arrays["q"][k])
        yield tool(before, x[:3], turn)
        yield wrench(before, np.zeros(6))
        for b, branch in enumerate(hand.branches):
            yield touch(before, branch.name, arrays["contacts"][k, b])
        yield mark(t, "before")
        yield tool(t + 10**9, x[:3] + 0.5 * dx[:3], turn)
        yield wrench(t + 10**9, 0.5 * w)
        under = t + round(PUSH_S * 1e9)
        yield tool(under - LATE_NS, x[:3] + dx[:3], product(quaternion_of(dx[3:]), turn))
        yield wrench(under - LATE_NS, w)
        yield mark(under, "under" if arrays["stable"][k] else "lost")


def record(
    path: Path,
    storage: str,
    content: Iterator[Message] | list[Message],
    change: Callable[[list[Message]], object] = list,
) -> Path:
    """Write messages, changed before, in the order of their arrival."""
    every = list(content)
    change(every)
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        places = {}
        for m in sorted(every, key=lambda m: m.recorded):
            if m.topic not in places:
                places[m.topic] = writer.add_connection(m.topic, m.kind, typestore=STORE)
            writer.write(places[m.topic], m.recorded, STORE.serialize_cdr(m.value, m.kind))
    return path


def in_frame(pose: Pose, contact: np.ndarray) -> np.ndarray:
    """A contact as a frame sees it that stands as `pose` in the palm's."""
    out = contact.copy()
    out[1:4], out[4:7] = pose.turn.T @ (contact[1:4] - pose.origin), pose.turn.T @ contact[4:7]
    return out


__all__ = ["Message", "Pose", "gz_contacts", "in_frame", "matrix", "messages", "record", "tool", "touch", "wrench"]
