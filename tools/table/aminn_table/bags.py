"""ROS 2 bags (MCAP and sqlite3) as columns of a table: topics by a map, put together by their stamps.

Every message of the mapped topics is looked at; each fault is named by topic and number of the message.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand import Hand
from aminn_hand.sensors import CLASS_NAMES, FRICTION, TENDON_TENSION, TOOL_WEIGHT

from .checks import Fault, Rows, TableError
from .columns import FORCE, FRICTION_CLASS, KNOWN, NORMAL, ON, POINT, column_of, numbers, shapes_of, tendons_of
from .files import Raw
from .mapping import (
    UNIT_QUATERNION,
    UNITS,
    ContactTable,
    Frames,
    FrictionTable,
    JointsTable,
    LoadTable,
    Map,
    Pose,
    TensionTable,
    ToolTable,
    WeightTable,
    matrix,
    product,
    rotation_vector,
)

Array = NDArray[np.float64]
BAGS = (".mcap", ".db3")
JOINT_STATE, POSE, WRENCH = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/WrenchStamped",
)


class _Bad(Exception):
    """A message that cannot be right; the text goes into a fault."""


@dataclass
class _Stream:
    """What is taken of one topic: a row of numbers from each message, at its stamp."""

    name: str
    topic: str
    parse: Callable[[Any], Sequence[float]]
    kind: str | None = None
    """Type that its messages must have."""
    frame: str | None = None
    """frame_id that their headers must have."""
    numbers: array[int] = field(default_factory=lambda: array("q"))
    stamps: array[int] = field(default_factory=lambda: array("q"))
    numerals: array[float] = field(default_factory=lambda: array("d"))

    def take(self, number: int, stamp: int, row: Sequence[float]) -> None:
        """Keep the row of one message."""
        self.numbers.append(number)
        self.stamps.append(stamp)
        self.numerals.extend(row)

    def times(self) -> NDArray[np.int64]:
        """(n) ns."""
        return np.array(self.stamps, np.int64)

    def table(self) -> Array:
        """(n, numbers of a row)"""
        return np.array(self.numerals, float).reshape(len(self.stamps), -1)


def is_bag(path: AnyPath) -> bool:
    """Whether a path is a ROS 2 bag: a folder with metadata.yaml, or a file of one."""
    path = Path(path)
    return (path / "metadata.yaml").is_file() or path.suffix in BAGS


def read_bag(path: AnyPath, hand: Hand, by: Map) -> Raw:
    """Columns of the pushes in a bag. Raises TableError with every fault by topic and message number, AminnError where
    the bag or the map does not have what is needed."""
    path = Path(path)
    streams = _streams(path, hand, by)
    _read(path, streams, by)
    pushes = _pushes(path, streams, by)
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are faults themselves
        return _columns(path, hand, by, {s.name: s for s in streams}, pushes)


def _streams(path: Path, hand: Hand, by: Map) -> list[_Stream]:
    """What the map asks for. Raises AminnError where it lacks something."""
    for name, table in (("joints", by.joints), ("tool", by.tool), ("load", by.load)):
        if table is None:
            raise AminnError(f"{path}: a bag needs a map with [{name}] and its topic; give --map")
    assert by.joints and by.tool and by.load
    frames = Frames(hand, by.frames)
    frames.static(by.tool.frame, "[tool]")
    frames.check(by.load.frame, "[load]")
    branches = {b.name for b in hand.branches}
    if unknown := sorted(set(by.contacts) - branches):
        raise AminnError(
            f"{path}: the map has contacts.{unknown[0]}; hand {hand.name} has {', '.join(sorted(branches))}"
        )
    if unknown := sorted((set(by.joints.names) | set(by.joints.sign)) - set(hand.joints)):
        raise AminnError(f"{path}: the map has joint {unknown[0]}; hand {hand.name} has {', '.join(hand.joints)}")
    found = [
        _Stream("joints", by.joints.topic, _joints_of(hand, by.joints), JOINT_STATE),
        _Stream("tool", by.tool.topic, _pose_of(by.tool), POSE, by.tool.frame),
        _Stream("load", by.load.topic, _wrench_of(by.load), WRENCH, by.load.frame),
    ]
    for branch, contact in by.contacts.items():
        frames.check(contact.frame, f"[contacts.{branch}]")
        found.append(_Stream(f"contact {branch}", contact.topic, _contact_of(contact), None, contact.frame))
    found += _sensors_of(path, hand, by, frames)
    if by.pushes.topic is not None:
        found.append(_Stream("pushes", by.pushes.topic, _mark_of(by)))
    if by.grasp is not None:
        found.append(_Stream("grasp", by.grasp.topic, lambda m, f=by.grasp.field: [_whole(_follow(m, f), f)]))  # type: ignore[misc]
    elif by.pushes.topic is None or by.pushes.grasp is None:
        raise AminnError(f"{path}: the map says nowhere which grasp a push is of: tell [grasp] or pushes.grasp")
    return found


def _sensors_of(path: Path, hand: Hand, by: Map, frames: Frames) -> Iterator[_Stream]:
    """Those of optional sensors."""
    if by.friction and by.friction.topic is not None:
        yield _Stream(FRICTION, by.friction.topic, _friction_of(by.friction))
    if by.tool_weight:
        weight = by.tool_weight
        if weight.palm is not None:
            yield _Stream(TOOL_WEIGHT, weight.palm, _turn_of, POSE, weight.frame)
        else:
            frames.check(weight.frame, f"[{TOOL_WEIGHT}]")
        if weight.topic is not None:
            yield _Stream(TOOL_WEIGHT, weight.topic, _weight_of(weight), WRENCH, weight.frame)
    if by.tendon_tension:
        names = [t.name for t in tendons_of(hand)]
        if unknown := sorted({*by.tendon_tension.names, *by.tendon_tension.sign} - set(names)):
            there = ", ".join(names) or "none"
            raise AminnError(f"{path}: the map has tendon {unknown[0]}; hand {hand.name} has {there}")
        if not names:
            raise AminnError(f"{path}: the map has [{TENDON_TENSION}]; hand {hand.name} has no tendons")
        yield _Stream(TENDON_TENSION, by.tendon_tension.topic, _tensions_of(hand, by.tendon_tension), JOINT_STATE)


# --- messages ---------------------------------------------------------------------------------------------------------


def _follow(message: Any, path: str) -> Any:
    """What a path of fields leads to; None where it leads into an empty list. Raises _Bad where there is no such."""
    value = message
    for part in path.split("."):
        if part.isdecimal():
            if len(value) <= int(part):
                return None
            value = value[int(part)]
        elif hasattr(value, part):
            value = getattr(value, part)
        else:
            names = [name for name in getattr(value, "__dataclass_fields__", {}) if not name.startswith("__")]
            raise _Bad(f"has no field {part!r} on the way of {path!r}; there are {', '.join(names) or 'none'}")
    return value


def _finite(values: Sequence[float], what: str) -> list[float]:
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError):
        raise _Bad(f"{what} is no number") from None
    if not all(map(math.isfinite, numbers)):
        raise _Bad(f"{what} is NaN or infinite")
    return numbers


def _xyz(value: Any, what: str) -> list[float]:
    if not all(hasattr(value, axis) for axis in "xyz"):
        raise _Bad(f"{what} has no x, y, z")
    return _finite([value.x, value.y, value.z], what)


def _whole(value: Any, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise _Bad(f"{what} is {value!r}, expected a whole number") from None
    if number != round(number):
        raise _Bad(f"{what} is {value!r}, expected a whole number")
    return number


def _joints_of(hand: Hand, table: JointsTable) -> Callable[[Any], list[float]]:
    return _joint_values(hand.joints, table, "position", "joint")


def _tensions_of(hand: Hand, table: TensionTable) -> Callable[[Any], list[float]]:
    return _joint_values([t.name for t in tendons_of(hand)], table, "effort", "tendon")


def _joint_values(
    own: Sequence[str], table: JointsTable | TensionTable, field: str, what: str
) -> Callable[[Any], list[float]]:
    """One of a JointState's lists, in the order of the hand's own names."""
    names = [table.names.get(name, name) for name in own]
    factors = [UNITS[table.unit][1] * table.sign.get(name, 1) for name in own]

    def parse(message: Any) -> list[float]:
        place, listed = {name: i for i, name in enumerate(message.name)}, getattr(message, field)
        if absent := [name for name in names if name not in place]:
            near = get_close_matches(absent[0], list(place), 1, 0.5)
            raise _Bad(f"has no {what} {absent[0]!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
        if len(listed) != len(message.name):
            raise _Bad(f"has {len(listed)} {field}s of {len(message.name)} {what}s")
        values = [float(listed[place[name]]) for name in names]
        for name, value in zip(names, values, strict=True):
            _finite([value], f"{field} of {name}")
        return [v * f for v, f in zip(values, factors, strict=True)]

    return parse


def _friction_of(table: FrictionTable) -> Callable[[Any], list[float]]:
    """Coefficient, deviation and number of the class; NaN where they are not told."""

    def parse(message: Any) -> list[float]:
        told, deviation = _follow(message, table.field), math.nan
        if isinstance(table.deviation, str):
            deviation = _finite([_follow(message, table.deviation)], table.deviation)[0]
        elif table.deviation is not None:
            deviation = table.deviation
        if not isinstance(told, str):
            return [*_finite([told], table.field), deviation, math.nan]
        if told and told not in CLASS_NAMES:
            raise _Bad(f"{table.field} is {told!r}, expected a number, or {', '.join(CLASS_NAMES)}")
        return [math.nan, math.nan, CLASS_NAMES.index(told) if told else math.nan]

    return parse


def _weight_of(table: WeightTable) -> Callable[[Any], list[float]]:
    factor = table.sign * UNITS[table.force_unit][1]
    return lambda message: [factor * v for v in _xyz(message.wrench.force, "force")]


def _turn_of(message: Any) -> list[float]:
    return _unit(message.pose.orientation)


def _unit(turn: Any) -> list[float]:
    q = _finite([turn.x, turn.y, turn.z, turn.w], "orientation")
    if abs(math.hypot(*q) - 1) > UNIT_QUATERNION:
        raise _Bad(f"orientation has length {math.hypot(*q):.4g}, expected that of a unit quaternion")
    return q


def _pose_of(table: ToolTable) -> Callable[[Any], list[float]]:
    scale = UNITS[table.unit][1]

    def parse(message: Any) -> list[float]:
        turn = _unit(message.pose.orientation)
        return [scale * v for v in _xyz(message.pose.position, "position")] + turn

    return parse


def _wrench_of(table: LoadTable) -> Callable[[Any], list[float]]:
    force, moment = table.sign * UNITS[table.force_unit][1], table.sign * UNITS[table.moment_unit][1]

    def parse(message: Any) -> list[float]:
        w = message.wrench
        return [force * v for v in _xyz(w.force, "force")] + [moment * v for v in _xyz(w.torque, "torque")]

    return parse


def _contact_of(table: ContactTable) -> Callable[[Any], list[float]]:
    scale, force_scale = UNITS[table.unit][1], UNITS[table.force_unit][1]
    decides = table.on or table.point or table.force
    if decides is None:
        raise AminnError("[contacts] needs on, point or force, to tell whether a finger touches")

    def parse(message: Any) -> list[float]:
        out = [math.nan] * 8
        flag = _follow(message, decides)
        out[ON] = float(_touches(flag, table.above))
        if not out[ON]:
            return [0.0] + [0.0 if path else math.nan for path, n in _parts(table) for _ in range(n)]
        if table.point:
            out[POINT] = [scale * v for v in _xyz(_follow(message, table.point), table.point)]
        if table.normal:
            out[NORMAL] = [table.normal_sign * v for v in _xyz(_follow(message, table.normal), table.normal)]
        if table.force:
            value = _follow(message, table.force)
            if hasattr(value, "x"):
                f = _xyz(value, table.force)
                along = sum(a * b for a, b in zip(f, out[NORMAL], strict=True)) if table.normal else math.hypot(*f)
                out[FORCE] = force_scale * abs(along)
            else:
                out[FORCE] = force_scale * _finite([value], table.force)[0]
        return out

    return parse


def _parts(table: ContactTable) -> tuple[tuple[str | None, int], ...]:
    return (table.point, 3), (table.normal, 3), (table.force, 1)


def _touches(flag: Any, above: float) -> bool:
    if flag is None:
        return False
    if hasattr(flag, "x"):
        return True
    if hasattr(flag, "__len__"):
        return len(flag) > 0
    return bool(_finite([flag], "the flag of contact")[0] > above)


BEFORE, UNDER, LOST = range(3)


def _mark_of(by: Map) -> Callable[[Any], list[float]]:
    p = by.pushes
    phases = {p.before: BEFORE, p.under: UNDER, p.lost: LOST}

    def parse(message: Any) -> list[float]:
        value = str(_follow(message, p.phase))
        if value not in phases:
            raise _Bad(f"{p.phase} is {value!r}, expected {', '.join(map(repr, phases))}")
        grasp = _whole(_follow(message, p.grasp), p.grasp) if p.grasp else math.nan
        return [phases[value], grasp]

    return parse


# --- reading ----------------------------------------------------------------------------------------------------------


class _Faults:
    """Faults by topic and text of their kind, each with its first message and their number."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, str], tuple[int, str, int]] = {}

    def add(self, topic: str, number: int, kind: str, text: str) -> None:
        first, said, count = self.found.get((topic, kind), (number, text, 0))
        self.found[topic, kind] = first, said, count + 1

    def all(self) -> list[Fault]:
        return [
            Fault("", text, number, f"{topic} message", count)
            for (topic, _), (number, text, count) in self.found.items()
        ]


def _read(path: Path, streams: list[_Stream], by: Map) -> None:
    """Fill the streams. Raises TableError with all faults of their messages."""
    faults, wanted = _Faults(), {s.topic for s in streams}
    counts: dict[str, int] = dict.fromkeys(wanted, 0)
    last: dict[str, tuple[int, int]] = {}
    for topic, recorded, message in _messages(path, streams, wanted):
        number = counts[topic]
        counts[topic] += 1
        stamp = _stamp(message, recorded, by)
        if stamp is None:
            text = 'header has no stamp; tell clock.stamp = "recording" to go by the times of arrival'
            faults.add(topic, number, "stamp", text)
            continue
        _check_clock(faults, topic, number, stamp, recorded, last.get(topic), by)
        last[topic] = (stamp, recorded)
        for stream in (s for s in streams if s.topic == topic):
            try:
                _check_frame(stream, message)
                stream.take(number, stamp, stream.parse(message))
            except _Bad as bad:
                faults.add(topic, number, str(bad).split(" is ")[0].split(" has ")[0], str(bad))
    if found := faults.all():
        raise TableError(str(path), found)
    for stream in streams:
        if not stream.stamps:
            raise AminnError(f"{path}: topic {stream.topic} ({stream.name}) has no messages")


def _messages(path: Path, streams: list[_Stream], wanted: set[str]) -> Iterator[tuple[str, int, Any]]:
    """(topic, time of arrival, message) of the topics. Whatever the library raises of a damaged bag is AminnError."""
    with ExitStack() as stack:
        with _of_library(path):
            reader = stack.enter_context(AnyReader([path], default_typestore=get_typestore(Stores.LATEST)))
        _check_topics(path, streams, {c.topic: c for c in reader.connections})
        every = reader.messages([c for c in reader.connections if c.topic in wanted])
        while True:
            with _of_library(path):
                entry = next(every, None)
                message = reader.deserialize(entry[2], entry[0].msgtype) if entry else None
            if entry is None:
                return
            yield entry[0].topic, entry[1], message


@contextmanager
def _of_library(path: Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # its own, apsw's, and those of numbers that lead nowhere
        text = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise AminnError(f"{path}: not a readable ROS 2 bag ({text}); record it again, or convert it") from error


def _check_topics(path: Path, streams: list[_Stream], topics: dict[str, Connection]) -> None:
    for stream in streams:
        found = topics.get(stream.topic)
        if found is None:
            near = get_close_matches(stream.topic, list(topics), 1, 0.6)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(topics)) or 'none'}"
            raise AminnError(f"{path}: topic {stream.topic} ({stream.name}) is not in the bag; {hint}")
        if stream.kind is not None and found.msgtype != stream.kind:
            raise AminnError(
                f"{path}: topic {stream.topic} ({stream.name}) has {found.msgtype}, expected {stream.kind}"
            )


def _stamp(message: Any, recorded: int, by: Map) -> int | None:
    """Time of a message, ns; None where its header tells none."""
    if by.clock.stamp == "recording" or not hasattr(message, "header"):
        return recorded
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec) or None


def _check_clock(
    faults: _Faults, topic: str, number: int, stamp: int, recorded: int, last: tuple[int, int] | None, by: Map
) -> None:
    if last is None:
        return
    if stamp < last[0]:
        text = f"stamp is {1e-9 * (last[0] - stamp):.6g} s before that of the message above: the clock was set back"
        faults.add(topic, number, "back", text)
    elif abs(stamp - last[0] - recorded + last[1]) > 1e9 * by.clock.jump_s:
        jump = 1e-9 * (stamp - last[0] - recorded + last[1])
        faults.add(
            topic, number, "jump", f"stamp jumps by {jump:.6g} s against the times of arrival: the clock was set"
        )


def _check_frame(stream: _Stream, message: Any) -> None:
    if stream.frame is not None and hasattr(message, "header"):
        found = str(message.header.frame_id)
        if found != stream.frame:
            raise _Bad(f"frame_id is {found!r}, the map expects {stream.frame!r}")


# --- pushes -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pushes:
    """Times of the pushes, ns, with where they come from."""

    topic: str
    numbers: NDArray[np.int64]  # (n) of the message that begins each
    before: NDArray[np.int64]  # (n)
    under: NDArray[np.int64]  # (n)
    held: NDArray[np.bool_]  # (n)
    grasp: Array  # (n), NaN where [grasp] tells it


def _pushes(path: Path, streams: list[_Stream], by: Map) -> _Pushes:
    marks = next((s for s in streams if s.name == "pushes"), None)
    found = _marked(path, marks) if marks else _loaded(next(s for s in streams if s.name == "load"), by)
    if not len(found.numbers):
        raise AminnError(f"{path}: topic {found.topic} marks no push; look at [pushes] of the map")
    return found


def _marked(path: Path, marks: _Stream) -> _Pushes:
    """Pairs of marks: before, then under or lost. Raises TableError for others."""
    faults, pairs = _Faults(), list[tuple[int, int, float, int, bool]]()
    begun: tuple[int, int, float] | None = None
    for number, stamp, (phase, grasp) in zip(marks.numbers, marks.stamps, marks.table().tolist(), strict=True):
        if phase == BEFORE:
            if begun is not None:
                faults.add(
                    marks.topic, number, "before", f"begins a push, but that of message {begun[0]} has not ended"
                )
            begun = (number, stamp, grasp)
        elif begun is None:
            faults.add(marks.topic, number, "end", "ends a push that has not begun")
        else:
            pairs.append((*begun, stamp, phase == UNDER))
            begun = None
    if begun is not None:
        faults.add(marks.topic, begun[0], "open", "begins a push that does not end")
    if found := faults.all():
        raise TableError(str(path), found)
    return _Pushes(
        marks.topic,
        np.array([p[0] for p in pairs], np.int64),
        np.array([p[1] for p in pairs], np.int64),
        np.array([p[3] for p in pairs], np.int64),
        np.array([p[4] for p in pairs], bool),
        np.array([p[2] for p in pairs], float),
    )


def _loaded(load: _Stream, by: Map) -> _Pushes:
    """Stretches of the load's force above a bound, until it is below another one."""
    force = np.linalg.norm(load.table()[:, :3], axis=1)
    stamps, settle = load.times(), round(1e9 * by.pushes.settle_s)
    spans, start = [], None
    low = -1
    for i, f in enumerate(force):
        if start is None:
            if f > by.pushes.above_N and low >= 0:
                start = i
            elif f < by.pushes.below_N:
                low = i
        elif f < by.pushes.below_N:
            spans.append((low, start, i - 1))
            start, low = None, i
    lows, starts, ends = (np.array([span[k] for span in spans], np.int64) for k in range(3))
    return _Pushes(
        load.topic,
        np.array(load.numbers, np.int64)[starts],
        stamps[lows] - settle,
        stamps[ends] - settle,
        np.ones(len(spans), bool),
        np.full(len(spans), math.nan),
    )


# --- states -----------------------------------------------------------------------------------------------------------


def _spans(stream: _Stream, times: NDArray[np.int64], by: Map) -> tuple[list[slice], list[int]]:
    """Messages of a stream that stand for each time, and where there are none (index of the time)."""
    stamps = stream.times()
    order = np.argsort(stamps, kind="stable")
    assert (order == np.arange(len(order))).all()  # held up by the clock's check
    window, tolerance = round(1e9 * by.clock.window_s), round(1e9 * by.clock.tolerance_s)
    found, absent = [], []
    for k, t in enumerate(times.tolist()):
        first, last = np.searchsorted(stamps, t - window, "left"), np.searchsorted(stamps, t, "right")
        if not window or first >= last:
            near = min((i for i in (last - 1, last) if 0 <= i < len(stamps)), key=lambda i: abs(int(stamps[i]) - t))
            first, last = near, near + 1
            if abs(int(stamps[near]) - t) > tolerance:
                absent.append(k)
        found.append(slice(int(first), int(last)))
    return found, absent


def _columns(path: Path, hand: Hand, by: Map, streams: dict[str, _Stream], pushes: _Pushes) -> Raw:
    """The state of every push as columns. Raises TableError where a stream has no message at its time."""
    faults = _Faults()

    def rows(name: str, times: NDArray[np.int64], mean: Callable[[Array], Array]) -> Array:
        stream = streams[name]
        spans, absent = _spans(stream, times, by)
        for k in absent:
            gap = 1e-9 * np.abs(stream.times() - times[k]).min()
            faults.add(
                pushes.topic,
                int(pushes.numbers[k]),
                name,
                f"has no message of {stream.topic} within {by.clock.tolerance_s:g} s; the nearest is {gap:.3g} s away",
            )
        values = stream.table()
        return np.stack([mean(values[span]) for span in spans])

    q = rows("joints", pushes.before, _mean)
    before, under = (rows("tool", t, _mean_pose) for t in (pushes.before, pushes.under))
    rest, load = (rows("load", t, _mean) for t in (pushes.before, pushes.under))
    raw_contacts = {name: rows(f"contact {name}", pushes.before, _mean_contact) for name in by.contacts}
    grasp = pushes.grasp
    if by.grasp is not None:
        grasp = _held_values(streams["grasp"], pushes, faults)[:, 0]
    read = {name: rows(name, pushes.before, mean) for name, mean in SENSOR_MEANS.items() if name in streams}
    if FRICTION in streams:
        read[FRICTION] = _held_values(streams[FRICTION], pushes, faults)
    if found := faults.all():
        raise TableError(str(path), found)
    assert by.tool and by.load
    frames = Frames(hand, by.frames)
    camera = frames.static(by.tool.frame, "[tool]")
    states = [_placed(*camera, pose) for pose in (before, under)]
    tools = [Pose(matrix(turn), origin) for origin, turn in states]
    about = tools[0].origin if by.load.about == "frame" else None
    w_e = _about_tool(frames.pose(by.load.frame, tools[1], q), load, about)
    if by.load.tare:
        w_e = w_e - _about_tool(frames.pose(by.load.frame, tools[0], q), rest, about)
    moved = np.concatenate(
        [states[1][0] - states[0][0], rotation_vector(product(states[1][1], states[0][1] * [-1, -1, -1, 1]))], 1
    )
    arrays = {
        "time_s": pushes.before / 1e9,
        "grasp_id": grasp.astype(np.int64),
        "q": q,
        "x_ht": np.concatenate([states[0][0], rotation_vector(states[0][1])], 1),
        "w_e": w_e,
        "contacts": _contacts(by, hand, frames, raw_contacts, tools[0], q),
        "dx_ht": np.where(pushes.held[:, None], moved, math.nan),
        "stable": pushes.held.astype(float),
    }
    columns = {
        column_of(hand, name, at).name: numbers(values, at)
        for name, values in arrays.items()
        for at in np.ndindex(shapes_of(hand)[name])
    }
    columns |= _sensor_columns(by, hand, frames, read, tools[0], q)
    unknown = [name for name, values in columns.items() if values.dtype.kind == "f" and np.isnan(values).all()]
    told = {name: values for name, values in columns.items() if name not in unknown or name.startswith("dx_ht")}
    return Raw(str(path), told, Rows(f"{pushes.topic} message", pushes.numbers))


def _held_values(stream: _Stream, pushes: _Pushes, faults: _Faults) -> Array:
    """The last value of a stream at the beginning of each push."""
    at = np.searchsorted(stream.times(), pushes.before, "right") - 1
    for k in np.flatnonzero(at < 0).tolist():
        faults.add(
            pushes.topic, int(pushes.numbers[k]), stream.name, f"stands before the first message of {stream.topic}"
        )
    return np.asarray(stream.table()[np.maximum(at, 0)])


def _sensor_columns(
    by: Map, hand: Hand, frames: Frames, read: dict[str, Array], tool: Pose, q: Array
) -> dict[str, NDArray]:
    """Columns of the optional sensors that the map tells."""
    n, found = len(q), dict[str, NDArray]()
    if by.friction:
        value = by.friction.value
        if by.friction.topic is not None:
            number, deviation, place = read[FRICTION].T
            texts = ["" if math.isnan(k) else CLASS_NAMES[int(k)] for k in place.tolist()]
        else:
            constant, own = (math.nan, str(value)) if isinstance(value, str) else (value, "")
            sure = by.friction.deviation if by.friction.deviation is not None and not own else math.nan
            number, deviation, texts = np.full(n, constant), np.full(n, sure), [own] * n
        found |= {"friction": number, "friction_sd": deviation, FRICTION_CLASS: np.array(texts, object)}
    values: dict[str, Array] = {}
    if by.tool_weight:
        weight, told = by.tool_weight, read.get(TOOL_WEIGHT)
        pull = np.tile(np.array(weight.gravity_m_s2) * (weight.mass_kg or 0.0), (n, 1))
        if weight.palm is not None and told is not None:
            values[TOOL_WEIGHT] = Pose(np.swapaxes(matrix(told), -1, -2), np.zeros(3)).vector(pull)
        else:
            values[TOOL_WEIGHT] = frames.pose(weight.frame, tool, q).vector(pull if told is None else told)
    if by.tendon_tension:
        values[TENDON_TENSION] = read[TENDON_TENSION]
    for name, numbers_of in values.items():
        found |= {column_of(hand, name, (KNOWN + 1 + i,)).name: v for i, v in enumerate(numbers_of.T)}
    return found


def _mean(values: Array) -> Array:
    return values[0] if len(values) == 1 else values.mean(0)


def _mean_pose(values: Array) -> Array:
    """Of positions, and of quaternions, which count the same with either sign."""
    return np.concatenate([_mean(values[:, :3]), _mean_turn(values[:, 3:])])


def _mean_turn(turns: Array) -> Array:
    return _mean(turns * np.where(turns @ turns[-1] < 0, -1.0, 1.0)[:, None]) if len(turns) > 1 else turns[0]


def _mean_of_weight(values: Array) -> Array:
    """Of forces (n, 3), or of the turns (n, 4) that lead to them."""
    return _mean(values) if values.shape[1] == 3 else _mean_turn(values)


def _mean_contact(values: Array) -> Array:
    """Of the messages that say the same of the contact as most of them do."""
    on = values[:, ON].mean() >= 0.5
    mean = _mean(values[(values[:, ON] > 0) == on]).copy()
    length = np.linalg.norm(mean[NORMAL])
    if on and len(values) > 1 and length > 0:
        mean[NORMAL] /= length
    return mean


SENSOR_MEANS = {TOOL_WEIGHT: _mean_of_weight, TENDON_TENSION: _mean}


def _placed(origin: Array, turn: Array, pose: Array) -> tuple[Array, Array]:
    """Origins (n, 3) and unit quaternions (n, 4) in the palm's frame of poses (n, 7) of one that stands there."""
    own = pose[:, 3:] / np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    if not origin.any() and not turn[:3].any():
        return pose[:, :3], own
    return Pose(matrix(turn), origin).point(pose[:, :3]), product(np.broadcast_to(turn, own.shape), own)


def _about_tool(frame: Pose, wrench: Array, tool: Array | None) -> Array:
    """Wrenches (n, 6) of a frame in the palm's axes; about points (n, 3), where these are given, not its origin."""
    force, moment = frame.vector(wrench[:, :3]), frame.vector(wrench[:, 3:])
    if tool is not None:
        moment = moment + np.cross(frame.origin - tool, force)
    return np.concatenate([force, moment], 1)


def _contacts(by: Map, hand: Hand, frames: Frames, read: dict[str, Array], tool: Pose, q: Array) -> Array:
    """Contacts (n, B, 8) in the palm's frame; a branch that the map leaves out touches, and nothing more is known."""
    out = np.full((len(q), hand.dims.branches, 8), math.nan)
    out[..., ON] = 1.0
    for b, branch in enumerate(hand.branches):
        if branch.name in read:
            pose = frames.pose(by.contacts[branch.name].frame, tool, q)
            out[:, b] = read[branch.name]
            out[:, b, POINT] = pose.point(out[:, b, POINT])
            out[:, b, NORMAL] = pose.vector(out[:, b, NORMAL])
    return out
