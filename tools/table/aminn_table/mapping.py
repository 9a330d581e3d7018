"""The map: a TOML file that says where recordings hold the columns of a table, in which frames, units and signs.

One map serves tables with other names (`columns`, `ignore`) and ROS 2 bags (everything else).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, ValidationError

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, complaint, read_toml
from aminn_hand import Hand
from aminn_hand.hand import rotation
from aminn_hand.sensors import TOOL_WEIGHT

from .columns import NORMAL, PALM, POINT, Arrays

Array = NDArray[np.float64]
Vector3 = Annotated[tuple[float, float, float], Field()]
Quaternion = Annotated[tuple[float, float, float, float], Field()]
Sign = Literal[1, -1]
STANDARD_GRAVITY_M_S2 = 9.80665
UNITS = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9),
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3),
    "rad": ("rad", 1.0), "deg": ("rad", math.pi / 180),
    "N": ("N", 1.0), "mN": ("N", 1e-3), "kN": ("N", 1e3), "gf": ("N", 1e-3 * STANDARD_GRAVITY_M_S2),
    "kgf": ("N", STANDARD_GRAVITY_M_S2),
    "N.m": ("N.m", 1.0), "N.mm": ("N.m", 1e-3), "mN.m": ("N.m", 1e-3),
    "%": ("1", 1e-2),
}  # fmt: skip
"""Unit that may be told -> unit of the table, and what to multiply by."""
PALM_NAMES = (PALM, "palm")
TOOL = "tool"
UNIT_QUATERNION = 1e-3
"""By how much the length of a quaternion may differ from 1; it is scaled to 1 then."""

LengthUnit = Literal["m", "cm", "mm"]
AngleUnit = Literal["rad", "deg"]
ForceUnit = Literal["N", "mN", "kN", "gf", "kgf"]
MomentUnit = Literal["N.m", "N.mm", "mN.m"]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class ColumnTable(_Table):
    """A column under another name, in another unit or with the other sign."""

    column: str
    unit: str | None = None
    """Its unit where it is not that of the table."""
    sign: Sign = 1


class FrameTable(_Table):
    """Where a frame stands."""

    parent: str = "palm"
    """`palm`; `tool`: it moves with the tool, and is told in the tool's frame; a branch: it moves with its fingertip,
    and is told in the palm's frame with all joints at 0."""
    position_m: Vector3 = (0.0, 0.0, 0.0)
    """Its origin in the parent's frame."""
    quaternion_xyzw: Quaternion | None = None
    """The turn from the parent's axes to its own, as ROS writes it."""
    rotation_rad: Vector3 | None = None
    """The same as a rotation vector; default: its axes are the parent's."""


class JointsTable(_Table):
    """Joint angles: sensor_msgs/msg/JointState."""

    topic: str
    names: dict[str, str] = {}
    """Joint of the hand -> name in the message; default: the same."""
    unit: AngleUnit = "rad"
    sign: dict[str, Sign] = {}
    """Of joints of the hand that the message counts the other way."""


class ToolTable(_Table):
    """Pose of the tool: geometry_msgs/msg/PoseStamped."""

    topic: str
    frame: str = "palm"
    """The message's frame_id; another than the palm's stands in [frames]."""
    unit: LengthUnit = "m"


class LoadTable(_Table):
    """Load on the tool: geometry_msgs/msg/WrenchStamped, as its frame has it."""

    topic: str
    frame: str = "palm"
    about: Literal["frame", "tool"] = "frame"
    """The point that its moment is about: the origin of its frame, or of the tool's."""
    sign: Sign = 1
    """-1: the sensor tells what the tool answers."""
    force_unit: ForceUnit = "N"
    moment_unit: MomentUnit = "N.m"
    tare: bool = False
    """Take off what was read before the push."""


class ContactTable(_Table):
    """Contact of one branch, from any message: paths of fields, with numbers as indices (`contacts.0.positions.0`).

    A path into an empty list says that there is no contact.
    """

    topic: str
    frame: str = "palm"
    on: str | None = None
    """A flag, a number that is compared with `above`, or a list that is empty without contact; default: the point."""
    above: float = 0.0
    point: str | None = None
    """A point or vector with x, y, z."""
    normal: str | None = None
    normal_sign: Sign = 1
    """-1: it points out of the tool."""
    force: str | None = None
    """A number, or a vector whose part along the normal counts (its length without a normal)."""
    unit: LengthUnit = "m"
    force_unit: ForceUnit = "N"


class FrictionTable(_Table):
    """Friction between fingertips and tool: one for the whole bag, or from a topic whose last message holds."""

    value: PositiveFloat | str | None = None
    """The coefficient, or a class."""
    topic: str | None = None
    field: str = "data"
    """Field with the coefficient, or with a class; an empty text says that nothing is known."""
    deviation: NonNegativeFloat | str | None = None
    """Standard deviation of the coefficient, or the message's field that tells it; default: a share of it."""


class WeightTable(_Table):
    """Force of gravity on the tool: geometry_msgs/msg/WrenchStamped, or a mass in a field of gravity that is known."""

    topic: str | None = None
    force_unit: ForceUnit = "N"
    sign: Sign = 1
    """-1: the sensor tells what holds the tool up."""
    frame: str = "palm"
    """The message's frame_id; or the frame in which gravity is stated."""
    mass_kg: PositiveFloat | None = None
    gravity_m_s2: Vector3 = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)
    palm: str | None = None
    """Topic of the palm's own pose in the frame in which gravity is stated: geometry_msgs/msg/PoseStamped, whose
    frame_id is `frame`. Without it that frame is the palm's, or one of [frames]."""


class TensionTable(_Table):
    """Tensions of tendons: efforts of sensor_msgs/msg/JointState."""

    topic: str
    names: dict[str, str] = {}
    """Tendon of the hand -> name in the message; default: the same."""
    unit: ForceUnit = "N"
    sign: dict[str, Sign] = {}
    """Of tendons whose pull the message counts as negative."""


class GraspTable(_Table):
    """Which grasp it is, from a topic whose last message holds."""

    topic: str
    field: str = "data"


class PushesTable(_Table):
    """When a push begins and when it is at rest: by messages that say so, or by the load itself."""

    topic: str | None = None
    """Messages that mark times; without it, times follow from the size of the load's force."""
    phase: str = "data"
    """Field whose value is one of the three following."""
    before: str = "before"
    under: str = "under"
    lost: str = "lost"
    """The grasp gave way; there is no displacement then."""
    grasp: str | None = None
    """Field that tells the grasp's number; default: [grasp]."""
    above_N: PositiveFloat = 0.5
    """A force of more begins a push."""
    below_N: PositiveFloat = 0.2
    """A force of less ends it."""
    settle_s: NonNegativeFloat = 0.1
    """The state before is taken so long before the force rises, that under load so long before it falls."""


class ClockTable(_Table):
    """How messages are put together."""

    stamp: Literal["header", "recording"] = "header"
    """Time of a message: its header's, or that of its arrival; messages without header have the latter."""
    tolerance_s: PositiveFloat = 0.02
    """How far a message may be from the time that it stands for."""
    window_s: NonNegativeFloat = 0.0
    """States are means over so long before their time; 0: the nearest message."""
    jump_s: PositiveFloat = 1.0
    """Stamps may drift from the times of arrival by less from one message to the next."""


class Map(_Table):
    """A checked map."""

    columns: dict[str, str | ColumnTable] = {}
    """Column of the table -> column of the file."""
    ignore: tuple[str, ...] = ()
    """Columns to leave out; * stands for any text."""
    frames: dict[str, FrameTable] = {}
    joints: JointsTable | None = None
    tool: ToolTable | None = None
    load: LoadTable | None = None
    contacts: dict[str, ContactTable] = {}
    """By branch."""
    friction: FrictionTable | None = None
    tool_weight: WeightTable | None = None
    tendon_tension: TensionTable | None = None
    grasp: GraspTable | None = None
    pushes: PushesTable = PushesTable()
    clock: ClockTable = ClockTable()


def read_map(path: AnyPath) -> Map:
    """Read and check a map. Raises AminnError with file and field."""
    path = Path(path)
    try:
        found = Map.model_validate(read_toml(path))
    except ValidationError as error:
        raise AminnError(f"{path}: {complaint(error.errors()[0], Map.model_fields, 'a map')}") from error
    for name, frame in found.frames.items():
        if frame.quaternion_xyzw is not None and frame.rotation_rad is not None:
            raise AminnError(f"{path}: frames.{name}: tell quaternion_xyzw or rotation_rad, not both")
        if frame.quaternion_xyzw and abs(math.hypot(*frame.quaternion_xyzw) - 1) > UNIT_QUATERNION:
            length = math.hypot(*frame.quaternion_xyzw)
            raise AminnError(f"{path}: frames.{name}.quaternion_xyzw has length {length:.4g}, expected 1")
    for name, sensor, other in (("friction", found.friction, "value"), ("tool_weight", found.tool_weight, "mass_kg")):
        if sensor is not None and (sensor.topic is None) == (getattr(sensor, other) is None):
            raise AminnError(f"{path}: {name}: tell topic or {other}, one of them")
    if found.friction and found.friction.topic is None and isinstance(found.friction.deviation, str):
        raise AminnError(f"{path}: friction.deviation names a field, and there is no topic; tell a number")
    for column, source in found.columns.items():
        if isinstance(source, ColumnTable) and source.unit is not None and source.unit not in UNITS:
            raise AminnError(f"{path}: columns.{column}.unit is {source.unit!r}; there are {', '.join(UNITS)}")
    return found


@dataclass(frozen=True)
class Pose:
    """A frame in another one: a point x of it is at `turn` x + `origin` there; of one, or of n."""

    turn: Array  # (..., 3, 3)
    origin: Array  # (..., 3) m

    def point(self, x: Array) -> Array:
        """Points (..., 3) in the other frame."""
        return self.vector(x) + self.origin

    def vector(self, x: Array) -> Array:
        """Directions (..., 3) in the other frame."""
        return np.einsum("...ij,...j->...i", self.turn, x)

    def times(self, inner: Pose) -> Pose:
        """A frame that is told in this one, in the other one."""
        return Pose(self.turn @ inner.turn, self.point(inner.origin))


@dataclass(frozen=True)
class Frames:
    """The frames of a map, for one hand."""

    hand: Hand
    told: dict[str, FrameTable]

    def check(self, name: str, what: str) -> None:
        """Raises AminnError unless it is known where the frame stands."""
        if name in PALM_NAMES or name == TOOL:
            return
        if name not in self.told:
            raise AminnError(
                f"{what} is in frame {name!r}, which is not the palm's: tell in [frames.{name}] how it stands in it"
            )
        parent = self.told[name].parent
        branches = [b.name for b in self.hand.branches]
        if parent not in (*PALM_NAMES, TOOL, *branches):
            raise AminnError(f"frames.{name}.parent is {parent!r}; there are palm, tool, {', '.join(branches)}")

    def static(self, name: str, what: str) -> tuple[Array, Array]:
        """Origin (3) and quaternion (4) in the palm's frame of one that does not move in it.

        Raises AminnError where it moves.
        """
        if name in PALM_NAMES:
            return np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
        self.check(name, what)
        if name == TOOL or self.told[name].parent not in PALM_NAMES:
            raise AminnError(
                f"{what} is in frame {name!r}, which moves in the palm's; tell the tool's pose in one that does not"
            )
        return np.array(self.told[name].position_m), _quaternion(self.told[name])

    def pose(self, name: str, tool: Pose, q: Array) -> Pose:
        """Where a frame stands in the palm's, the tool standing as `tool` (n) and the joints at q (n, J)."""
        if name in PALM_NAMES:
            return Pose(np.eye(3), np.zeros(3))
        if name == TOOL:
            return tool
        told = self.told[name]
        own = Pose(_turn(told), np.array(told.position_m))
        if told.parent in PALM_NAMES:
            return own
        if told.parent == TOOL:
            return tool.times(own)
        b = [branch.name for branch in self.hand.branches].index(told.parent)
        _, _, turn, origin = self.hand.branches[b].pose(q[:, self.hand.branch_joints[b]])
        return Pose(turn, origin).times(own)


def _turn(frame: FrameTable) -> Array:
    return matrix(_quaternion(frame))


def _quaternion(frame: FrameTable) -> Array:
    if frame.quaternion_xyzw is not None:
        return np.array(frame.quaternion_xyzw) / math.hypot(*frame.quaternion_xyzw)
    return quaternion_of(np.array(frame.rotation_rad or (0.0, 0.0, 0.0)))


def in_palm(frames: Frames, arrays: Arrays, told: dict[str, str]) -> Arrays:
    """Arrays of a table in the palm's frame; `told` has the frame of each that is in another one, "" that of all.

    Moments stay about the origin of the tool's frame.
    """
    out = dict(arrays)
    names = ("x_ht", "w_e", "contacts", "dx_ht", TOOL_WEIGHT)
    for name in (name for name in names if name in arrays and (name in told or "" in told)):
        frame = told.get(name, told.get("", ""))
        frames.check(frame, name)
        values = np.array(out[name], float)
        if name == "x_ht":
            origin, turn = frames.static(frame, name)
            pose = Pose(matrix(turn), origin)
            whole = product(np.broadcast_to(turn, (len(values), 4)), quaternion_of(values[:, 3:]))
            values = np.concatenate([pose.point(values[:, :3]), rotation_vector(whole)], 1)
        else:
            tool = Pose(rotation(out["x_ht"][:, 3:]), out["x_ht"][:, :3])
            pose = frames.pose(frame, tool, out["q"])
            if name == "contacts":
                for b in range(values.shape[1]):
                    values[:, b, POINT], values[:, b, NORMAL] = (
                        pose.point(values[:, b, POINT]),
                        pose.vector(values[:, b, NORMAL]),
                    )
            elif name == TOOL_WEIGHT:
                values = np.concatenate([values[:, :1], pose.vector(values[:, 1:])], 1)
            else:
                values = np.concatenate([pose.vector(values[:, :3]), pose.vector(values[:, 3:])], 1)
        out[name] = values
    return out


def matrix(quaternion: Array) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), x y z w."""
    return rotation(rotation_vector(quaternion))


def rotation_vector(quaternion: Array) -> Array:
    """Rotation vectors (..., 3) of quaternions (..., 4), x y z w, with angles of at most half a turn."""
    q = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    q = np.where(q[..., 3:] < 0, -q, q)
    size = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, q[..., 3:])
    return q[..., :3] * np.where(size > 0, angle / np.where(size > 0, size, 1.0), 2.0)


def quaternion_of(turn: Array) -> Array:
    """Quaternions (..., 4), x y z w, of rotation vectors (..., 3)."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([0.5 * turn * np.sinc(angle / (2 * np.pi)), np.cos(angle / 2)], -1)


def product(a: Array, b: Array) -> Array:
    """Quaternions (..., 4), x y z w: first b, then a."""
    va, vb, wa, wb = a[..., :3], b[..., :3], a[..., 3:], b[..., 3:]
    return np.concatenate([wa * vb + wb * va + np.cross(va, vb), wa * wb - (va * vb).sum(-1, keepdims=True)], -1)
