"""A hand's description, read from its MJCF and hand file: what is derived, what is told, and what is refused by name.

The model is compiled with everything that the hand file tells already in it, so that the description and what is
simulated come from one text. Positions are those at q = 0 in the palm's frame H.
"""

from __future__ import annotations

import fnmatch
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand.hand import Branch, ContactModel, Coordinate, Coupling, Hand, Mirror, Synergy, Tendon
from aminn_hand.hand_file import ContactTable, HandFile, model_path, read_hand_file
from aminn_hand.symmetry import find_mirror, mirror_in

from . import _core, mjcf_tree
from .postures import find_synergy, find_tool_axis, pinch_frame
from .scene import CONTACT_IMPEDANCE, CONTACT_TIME_S, SceneParts, compose, own_prefix

Array = NDArray[np.float64]

# MuJoCo's numbers of kinds.
FREE, BALL, SLIDE, HINGE = range(4)
EQ_CONNECT, EQ_WELD, EQ_JOINT, EQ_TENDON, EQ_DISTANCE = range(5)
TRN_JOINT, TRN_TENDON = 0, 3
BIAS_AFFINE = 1
EFC_EQUALITY = 0
# Ranges that are narrower than this on every joint, or angles beyond two turns, are of the other unit; a longer link is
# in millimetres.
LEAST_RANGE_RAD, MOST_ANGLE_RAD, LONGEST_LINK_M = 0.1, 4 * np.pi, 1.0
WEAK_COUPLING = 10.0
"""A coupling below so many times the joints' own stiffness gives way."""
SPHERE, CAPSULE, MESH = 2, 3, 7
NOMINAL_TOOL_KG = 0.08


@dataclass(frozen=True)
class Understood:
    """What a hand file and its model say."""

    hand: Hand
    root: ET.Element
    """The model as one tree, with what the hand file tells; the palm stands still in the world."""
    source: Path
    """The model's main file."""
    files: dict[Path, bytes]
    """Every file that the model is made of, as it was read."""
    assets: dict[str, bytes]
    """Those that the engine needs beside the text, by the names that the tree gives them."""
    scene: str
    """MJCF of the hand on its base with a tool."""
    parts: SceneParts
    locked: tuple[str, ...]
    """Joints taken out."""
    postures: tuple[Array, Array]
    """Open and closed, q (J) in the order of `hand.joints`, rad."""
    notes: tuple[str, ...]
    """What a user should know and that does not stop anything."""

    @property
    def palm(self) -> str:
        """Body whose frame is H."""
        return self.parts.palm

    @property
    def tips(self) -> tuple[tuple[str, ...], ...]:
        """Geoms of each branch's tip; its pad point goes with the first."""
        return self.parts.tips


class _Model:
    """A compiled model's arrays, read once."""

    def __init__(self, root: ET.Element, assets: dict[str, bytes], path: Path, hand_file: Path) -> None:
        try:
            self.engine = _core.Engine(mjcf_tree.text_of(root), assets)
        except _core.MujocoError as error:
            message = " ".join(str(error).removeprefix("/dev/null/scene.xml: ").split())
            raise AminnError(
                f"{path}: MuJoCo {_core.MUJOCO_VERSION} does not take this model: {message}; written for a newer "
                f"MuJoCo? aminn hand convert {hand_file} --out FOLDER makes it one that it takes"
            ) from error
        self.bodies = self._names("body")
        self.joints = self._names("joint")
        self.tendons = self._names("tendon")
        self.actuators = self._names("actuator")
        self.geoms = self._names("geom")
        self.parent = self.array("body_parentid")
        self.jnt_body = self.array("jnt_bodyid")
        self.jnt_type = self.array("jnt_type")

    def _names(self, kind: str) -> list[str]:
        return [name or f"{kind}{i}" for i, name in enumerate(self.engine.names(kind))]

    def array(self, name: str) -> NDArray:
        return np.asarray(self.engine.model(name))

    @cached_property
    def free_tree(self) -> NDArray[np.bool_]:
        """Which bodies hang on a free joint: objects beside the hand, which hangs on one where nothing else moves."""
        free, tops = np.zeros(len(self.bodies), bool), np.arange(len(self.bodies))
        for body in range(1, len(self.bodies)):
            free[body] = free[self.parent[body]] or bool((self.jnt_type[self.jnt_body == body] == FREE).any())
            tops[body] = tops[self.parent[body]] if self.parent[body] else body
        jointed = np.unique(self.jnt_body[self.jnt_type != FREE])
        if free[jointed].all():
            free &= ~np.isin(tops, tops[jointed])
        return free

    def ancestors(self, body: int) -> list[int]:
        """The body and all above it, world last."""
        out = [body]
        while body:
            body = int(self.parent[body])
            out.append(body)
        return out

    def joints_of(self, body: int) -> list[int]:
        return np.flatnonzero(self.jnt_body == body).tolist()

    @cached_property
    def moving(self) -> list[int]:
        """Bodies of the hand that have a joint."""
        return [b for b in range(1, len(self.bodies)) if self.joints_of(b) and not self.free_tree[b]]

    def body(self, name: str, what: str) -> int:
        if name not in self.bodies:
            near = ", ".join(b for b in self.bodies[1:] if not self.free_tree[self.bodies.index(b)])
            raise AminnError(f"{what} names the body {name!r}, which the model lacks; it has {near}")
        return self.bodies.index(name)


def _name_parts(root: ET.Element) -> None:
    """Give every body, joint and geom a name that can be referred to."""
    bodies = [e for body in root.iter("worldbody") for e in body.iter("body")]
    for i, body in enumerate(b for b in bodies if not b.get("name")):
        body.set("name", f"unnamed_body_{i}")
    for tag, tags in (("joint", ("joint", "freejoint")), ("geom", ("geom",))):
        for i, part in enumerate(e for body in bodies for e in body if e.tag in tags and not e.get("name")):
            part.set("name", f"unnamed_{tag}_{i}")


def _palm_of(model: _Model, file: HandFile, path: Path, locked: set[int]) -> int:
    """The palm body: told, or the deepest that all moving branches share."""
    moving = [b for b in model.moving if any(j not in locked for j in model.joints_of(b))]
    if not moving:
        raise AminnError(f"{path}: the model has no moving joints")
    if file.palm is not None:
        return model.body(file.palm, f"{path}: palm")
    above = {a for b in moving for a in model.ancestors(b)[1:]}
    tips = [b for b in moving if b not in above]
    shared = [set(model.ancestors(b)[1:]) for b in tips] if len(tips) > 1 else [set(model.ancestors(tips[0])[1:])]
    common = set.intersection(*shared)
    palm = max(common, key=lambda b: len(model.ancestors(b)))
    if len(tips) < 2:
        raise AminnError(
            f"{path}: the moving joints form one chain, to {model.bodies[tips[0]]}; a hand needs at least two branches"
        )
    return palm


def _chains(model: _Model, palm: int, path: Path, locked: set[int]) -> list[list[int]]:
    """Of each branch its moving bodies from the palm outwards. Raises AminnError where a chain splits."""
    moving = [
        b for b in model.moving if palm in model.ancestors(b)[1:] and any(j not in locked for j in model.joints_of(b))
    ]
    above = {a for b in moving for a in model.ancestors(b)[1:]}
    chains = [[b for b in reversed(model.ancestors(tip)) if b in moving] for tip in moving if tip not in above]
    for i, first in enumerate(chains):
        for second in chains[i + 1 :]:
            shared = [b for b in first if b in second]
            if shared:
                joints = ", ".join(model.joints[j] for b in shared for j in model.joints_of(b) if j not in locked)
                ends = f"{model.bodies[first[-1]]} and {model.bodies[second[-1]]}"
                raise AminnError(
                    f"{path}: joint {joints} is shared by the branches that end in {ends}; lock it (locked = [...]), "
                    "or lock the joints of one of the two branches: branches that share a joint have no stiffness of "
                    "their own"
                )
    return chains


def _part_neighbours(root: ET.Element, model: _Model) -> None:
    """Keep the first links from touching the palm, as the engine does with neighbours unless one stands still."""
    welded, with_geoms = model.array("body_weldid"), set(model.array("geom_bodyid").tolist())
    firsts = {b for b in model.moving if not welded[model.parent[b]]}
    pairs = [(s, b) for s in np.flatnonzero(welded == 0).tolist() for b in range(len(welded)) if welded[b] in firsts]
    contact = mjcf_tree.section(root, "contact")
    told = {frozenset((e.get("body1"), e.get("body2"))) for e in contact if e.tag == "exclude"}
    for still, first in pairs:
        names = (model.bodies[still], model.bodies[first])
        if {still, first} <= with_geoms and frozenset(names) not in told:
            ET.SubElement(contact, "exclude", body1=names[0], body2=names[1])


def _common_prefix(names: Sequence[str]) -> str:
    prefix = names[0]
    for name in names[1:]:
        while not name.startswith(prefix):
            prefix = prefix[:-1]
    return prefix.rstrip("_-./ ")


def _branch_names(model: _Model, chains: list[list[int]], joints: list[list[int]]) -> list[str]:
    """From what the joints' names of a branch share, else the body that it begins with."""
    found = [_common_prefix([model.joints[j] for j in js]) if len(js) > 1 else "" for js in joints]
    names = [name or model.bodies[chain[0]] for name, chain in zip(found, chains, strict=True)]
    return names if len(set(names)) == len(names) else [model.bodies[chain[0]] for chain in chains]


def _fixed_to(model: _Model, body: int) -> list[int]:
    """The body and everything that is fixed to it."""
    out = [body]
    for b in range(body + 1, len(model.bodies)):
        if int(model.parent[b]) in out and not model.joints_of(b):
            out.append(b)
    return out


def _servo_gains(model: _Model, actuator: int) -> float:
    """Position stiffness about what the actuator drives, per unit of length squared; 0 for a motor."""
    if int(model.array("actuator_biastype")[actuator]) != BIAS_AFFINE:
        return 0.0
    gear = float(model.array("actuator_gear")[actuator][0])
    return max(0.0, -float(model.array("actuator_biasprm")[actuator][1])) * gear * gear


def _force_range(model: _Model, actuator: int) -> tuple[float, float]:
    """Limits of an actuator's force, N; infinite where it has none."""
    if not model.array("actuator_forcelimited")[actuator]:
        return -np.inf, np.inf
    low, high = model.array("actuator_forcerange")[actuator]
    return float(low), float(high)


def _tell(file: HandFile, root: ET.Element, path: Path) -> None:
    """Write what the hand file tells into the model."""
    names = {e.get("name") for e in root.iter("joint") if e.get("name")}
    told = [
        ("locked", list(file.locked)),
        ("stiffness.servo_Nm_rad", [j for j in file.stiffness.servo_Nm_rad if j != "default"]),
    ]
    told += [("coupling.joint", [c.joint for c in file.coupling]), ("coupling.of", [c.of for c in file.coupling])]
    if file.closing is not None:
        told += [("closing.open", list(file.closing.open)), ("closing.closed", list(file.closing.closed))]
    for what, joints in told:
        for joint in joints:
            if joint not in names:
                raise AminnError(f"{path}: {what} names the joint {joint!r}, which the model lacks")
    mjcf_tree.remove_joints(root, set(file.locked))
    if file.stiffness.friction == "drop":
        for element in root.iter():
            element.attrib.pop("frictionloss", None)
    equality = mjcf_tree.section(root, "equality") if file.coupling else None
    for c in file.coupling:
        ET.SubElement(equality, "joint", joint1=c.joint, joint2=c.of, polycoef=f"0 {c.ratio!r} 0 0 0")  # type: ignore[arg-type]


def _held(model: _Model) -> set[int]:
    """Joints that a servo of the model holds."""
    kinds, ids = model.array("actuator_trntype"), model.array("actuator_trnid")
    servos = (a for a in range(len(model.actuators)) if kinds[a] == TRN_JOINT and _servo_gains(model, a) > 0)
    return {int(ids[a][0]) for a in servos}


def _add_servos(file: HandFile, root: ET.Element, model: _Model, joints: Sequence[int]) -> bool:
    """Write servos for joints that nothing holds and the hand file gives a stiffness; whether there were any."""
    held = _held(model)
    told = file.stiffness.servo_Nm_rad
    wanted = {j: told.get(model.joints[j], told.get("default")) for j in joints if j not in held}
    new = {model.joints[j]: k for j, k in wanted.items() if k is not None}
    if not new:
        return False
    actuators = mjcf_tree.section(root, "actuator")
    for section in root.iter("actuator"):
        mjcf_tree.remove(section, [a for a in section if a.get("joint") in new])
    for joint, stiffness in new.items():
        ET.SubElement(actuators, "position", joint=joint, kp=repr(float(stiffness)))
    return True


def understand(path: AnyPath, content: bytes | None = None) -> Understood:
    """Read a hand file (or its `content`) and its model.

    Raises AminnError that says what is wrong, where, and what to do.
    """
    return _Reader(Path(path), content).read()


@dataclass
class _Reader:
    """One hand file on its way to a `Hand`."""

    path: Path
    content: bytes | None
    notes: list[str] = field(default_factory=list)

    def read(self) -> Understood:
        file = read_hand_file(self.path, self.content)
        source = model_path(file, self.path)
        read = mjcf_tree.read_mjcf(source, self.path)
        root, assets = read.root, read.assets
        _name_parts(root)
        _tell(file, root, self.path)
        model = _Model(root, assets, source, self.path)
        palm = _palm_of(model, file, self.path, set())
        above = [model.joints[j] for b in model.ancestors(palm) for j in model.joints_of(b)]
        mjcf_tree.remove_joints(root, set(above))
        self._remove_others(root, model, palm)
        name = model.bodies[palm]
        model = _Model(root, assets, source, self.path)
        _part_neighbours(root, model)
        palm = model.body(name, "palm")  # bodies before it may be gone
        chains = _chains(model, palm, self.path, set())
        joints = [[j for b in chain for j in model.joints_of(b)] for chain in chains]
        for name in sorted({model.joints[j] for j in _held(model)} & set(file.stiffness.servo_Nm_rad)):
            self.notes.append(f"stiffness.servo_Nm_rad.{name} is not used: the model has a servo there")
        if _add_servos(file, root, model, [j for js in joints for j in js]):
            model = _Model(root, assets, source, self.path)
        self._refuse_outside(model, palm, joints)
        hand, tips, reach = self._hand(file, model, palm, chains, joints)
        postures = self._postures(file, hand)
        self._refuse_straighteners(hand, postures[1] - postures[0])
        hand = self._pinch(file, replace(hand, contact=self._contact(file, hand)), postures, reach)
        prefix = own_prefix(root)
        scene = compose(root, name, prefix)
        half = hand.coupled(0.5 * (postures[0] + postures[1]))
        forward = pinch_frame(hand, half, np.array(hand.tool_axis))[1][:, 1]
        return Understood(
            self._with_compliance(file, hand, scene, assets, source),
            root,
            source,
            read.files,
            assets,
            scene,
            SceneParts(prefix, name, tips, tuple(forward.tolist())),
            (*file.locked, *above),
            postures,
            tuple(dict.fromkeys(self.notes)),
        )

    def _remove_others(self, root: ET.Element, model: _Model, palm: int) -> None:
        """Take objects beside the hand (a tool, a table, the floor) out of the model."""
        free = {model.bodies[b] for b in range(1, len(model.bodies)) if model.free_tree[b]}
        name = model.bodies[palm]
        in_world = [e for world in root.findall("worldbody") for e in world if e.tag in ("body", "geom")]
        tops = [e for e in in_world if e.get("name") in free and e.tag == "body"]
        if palm > 0:  # what does not carry the palm does not move with it
            tops = [e for e in in_world if all(b.get("name") != name for b in e.iter("body"))]
        mjcf_tree.remove(root, tops)
        for key in list(root.findall("keyframe")):
            root.remove(key)

    def fail(self, text: str) -> AminnError:
        return AminnError(f"{self.path}: {text}")

    def _refuse_outside(self, model: _Model, palm: int, joints: list[list[int]]) -> None:
        """Joints that belong to no branch, that are no hinges, or that have no limits."""
        mine = {j for js in joints for j in js}
        left_out = [model.joints[j] for j in range(len(model.joints)) if j not in mine and model.jnt_type[j] != FREE]
        if left_out:
            raise self.fail(
                f"{len(left_out)} joints belong to no branch below {model.bodies[palm]}: {', '.join(left_out)}; lock "
                "them (locked = [...]) or name another palm"
            )
        limited, ranges = model.array("jnt_limited"), model.array("jnt_range")
        for j in sorted(mine):
            if model.jnt_type[j] != HINGE:
                kind = {SLIDE: "slides", BALL: "is a ball"}.get(int(model.jnt_type[j]), "is free")
                raise self.fail(f"joint {model.joints[j]} {kind}; coordinates are hinges: lock it (locked = [...])")
            if not limited[j]:
                stated = (
                    f" (range {ranges[j][0]:g} to {ranges[j][1]:g} is stated and not enforced)"
                    if ranges[j].any()
                    else ""
                )
                raise self.fail(
                    f'joint {model.joints[j]} has no limits{stated}; set range and limited="true" in the model'
                )
        widest = max(float(ranges[j][1] - ranges[j][0]) for j in mine)
        wild = [j for j in mine if np.abs(ranges[j]).max() > MOST_ANGLE_RAD]
        if wild:
            low, high = ranges[wild[0]]
            raise self.fail(
                f"joint {model.joints[wild[0]]} turns from {low:g} to {high:g} rad; degrees? a model in degrees needs "
                '<compiler angle="degree"/>, or none'
            )
        if widest < LEAST_RANGE_RAD:
            raise self.fail(
                f"no joint turns by more than {widest:.3g} rad; degrees? a model in radians needs "
                '<compiler angle="radian"/>'
            )

    def _friction(self, file: HandFile, model: _Model, joints: list[list[int]]) -> None:
        dof = model.array("jnt_dofadr")
        loss = model.array("dof_frictionloss")
        rubbing = [f"joint {model.joints[j]} {loss[dof[j]]:g} N.m" for js in joints for j in js if loss[dof[j]] > 0]
        loss = model.array("tendon_frictionloss")
        rubbing += [f"tendon {name} {loss[t]:g} N" for t, name in enumerate(model.tendons) if loss[t] > 0]
        if not rubbing:
            return
        text = f"{len(rubbing)} parts have dry friction ({rubbing[0]}{', ...' if len(rubbing) > 1 else ''})"
        if file.stiffness.friction is None:
            raise self.fail(
                f'{text}, which a stiffness does not know: set stiffness.friction to "drop" (leave it out of the '
                'simulation; right for a hand that is calibrated later) or to "keep" (simulate it; small motions then '
                "stick)"
            )
        self.notes.append(f"{text}: kept, small motions stick")

    def _hand(
        self, file: HandFile, model: _Model, palm: int, chains: list[list[int]], joints: list[list[int]]
    ) -> tuple[Hand, tuple[tuple[str, ...], ...], Array]:
        self._friction(file, model, joints)
        engine = model.engine
        engine.reset()
        engine.set("qpos", np.zeros(len(model.joints)))
        engine.forward()
        rotation = engine.data("xmat")[palm].reshape(3, 3)
        origin = engine.data("xpos")[palm]
        axes = engine.data("xaxis") @ rotation
        anchors = (engine.data("xanchor") - origin) @ rotation
        names = _branch_names(model, chains, joints)
        tip_bodies, points, tip_sets, tip_geoms = [], [], [], []
        for b, chain in enumerate(chains):
            fixed = _fixed_to(model, chain[-1])
            told = [t for t in file.branch if t.tip in {model.bodies[x] for x in fixed}]
            if len(told) > 1:
                both = " and ".join(t.name for t in told)
                raise self.fail(f"branches {both} both name a tip on {model.bodies[chain[-1]]}: one branch ends there")
            if told:
                names[b] = told[0].name
            tip = model.body(told[0].tip, f"{self.path}: branch.{names[b]}.tip") if told else chain[-1]
            geoms = self._colliders(model, fixed)
            if not geoms:
                raise self.fail(
                    f"branch {names[b]} has no colliding geom on its last body {model.bodies[chain[-1]]}: nothing can "
                    "touch the tool"
                )
            if told and told[0].geoms:
                geoms = self._told_geoms(model, names[b], told[0].geoms, geoms)
            outermost = self._outermost(engine, geoms, anchors, rotation, origin, joints[b])
            if told and told[0].point is not None:
                world = engine.data("xpos")[tip] + engine.data("xmat")[tip].reshape(3, 3) @ np.array(told[0].point)
            else:
                world = engine.data("geom_xpos")[outermost]
            tip_bodies.append(tip)
            tip_geoms.append([outermost, *(g for g in geoms if g != outermost)])
            points.append((world - origin) @ rotation)
            tip_sets.append(tuple(model.bodies[x] for x in fixed))
        for table in file.branch:
            if table.tip not in {name for tips in tip_sets for name in tips}:
                raise self.fail(f"branch {table.name}: tip {table.tip!r} is on none of the branches' last bodies")
        if file.branch and len(file.branch) != len(chains):
            untold = [
                n for n, tips in zip(names, tip_sets, strict=True) if not {t.tip for t in file.branch} & set(tips)
            ]
            raise self.fail(
                f"{len(file.branch)} branches are named, the model has {len(chains)}; also name {', '.join(untold)}, "
                "or lock their joints (locked = [...])"
            )
        self._refuse_scale(anchors, points, joints)
        couplings = self._couplings(model, joints, names)
        tendons = self._tendons(file, model, joints, names)
        springs = model.array("jnt_stiffness")
        servos = self._servos(model)
        ranges = model.array("jnt_range")
        groups = self._groups(file, points, tip_sets)
        addresses, relaxed = model.array("jnt_qposadr"), model.array("qpos_spring")
        kinds, sizes = model.array("geom_type"), model.array("geom_size")
        reach = np.zeros(len(joints))
        branches = []
        for b, js in enumerate(joints):
            coordinates = tuple(
                Coordinate(
                    model.joints[j],
                    tuple(axes[j].tolist()),
                    tuple(anchors[j].tolist()),
                    float(ranges[j][0]),
                    float(ranges[j][1]),
                    float(springs[j]),
                    servos.get(j, 0.0),
                    float(relaxed[addresses[j]]),
                )
                for j in js
            )
            first = tip_geoms[b][0]
            padded = any(t.point is not None and t.tip in tip_sets[b] for t in file.branch)
            reach[b] = 0.0 if padded or kinds[first] == MESH else sizes[first][sizes[first] > 0].min()
            branch = Branch(
                names[b],
                groups[b],
                coordinates,
                tendons[b],
                couplings[b],
                model.bodies[tip_bodies[b]],
                tuple(points[b].tolist()),
                0.0,
                float(sizes[first][0]) if kinds[first] in (SPHERE, CAPSULE) else 0.0,
            )
            self._refuse_limp(branch)
            branches.append(branch)
        normal = np.array(file.palm_normal) if file.palm_normal is not None else np.mean(points, axis=0)
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise self.fail("palm_normal has no length")
        self._refuse_unknown_compliance(file, names)
        tips = tuple(tuple(model.geoms[g] for g in geoms) for geoms in tip_geoms)
        hand = Hand(file.name, tuple(branches), tuple((normal / length).tolist()), length_m=file.length_m)
        return hand, tips, reach

    def _told_geoms(self, model: _Model, branch: str, told: Sequence[str], colliding: list[int]) -> list[int]:
        """Numbers of the geoms that a hand file calls a fingertip."""
        names = {model.geoms[g]: g for g in colliding}
        for name in told:
            if name not in names:
                raise self.fail(
                    f"branch {branch}: geoms names {name!r}, which is no colliding geom of its last body; there are "
                    + ", ".join(names)
                )
        return [names[name] for name in told]

    def _with_compliance(self, file: HandFile, hand: Hand, scene: str, assets: dict[str, bytes], source: Path) -> Hand:
        """eps of each branch, m/N: told, or what the engine's contact of its tip with a nominal tool gives way by.

        A contact is a spring of stiffness K I / R, and R = (1 - I) / I times the inverse masses behind it.
        """
        told = file.contact.compliance_m_N
        by_branch = told if isinstance(told, dict) else dict.fromkeys((b.name for b in hand.branches), told)
        model = _Model(ET.fromstring(scene), assets, source, self.path)
        opening, deep, _ = CONTACT_IMPEDANCE
        stiffness = 1 / (deep * CONTACT_TIME_S) ** 2
        inverse = {b.name: float(model.array("body_invweight0")[model.bodies.index(b.tip)][0]) for b in hand.branches}
        own = {
            name: (1 - opening) / opening * (mass + 1 / NOMINAL_TOOL_KG) / (stiffness * opening)
            for name, mass in inverse.items()
        }
        return replace(
            hand, branches=tuple(replace(b, eps_m=float(by_branch.get(b.name) or own[b.name])) for b in hand.branches)
        )

    def _refuse_unknown_compliance(self, file: HandFile, names: list[str]) -> None:
        told = file.contact.compliance_m_N
        for name in told if isinstance(told, dict) else ():
            if name not in names:
                raise self.fail(f"contact.compliance_m_N names the branch {name!r}; there are {', '.join(names)}")

    def _contact(self, file: HandFile, hand: Hand) -> ContactModel:
        """What a fingertip passes on to the tool."""
        soft = file.contact.model == "soft_finger"
        if len(hand.branches) == 2 and not soft:
            self.notes.append(
                "two point contacts leave a tool free to spin about the line through both: no grasp comes to rest; "
                'set contact.model = "soft_finger"'
            )
        if not soft and file.contact.torsional_friction_m != ContactTable().torsional_friction_m:
            self.notes.append('contact.torsional_friction_m counts for contact.model = "soft_finger" alone')
        return ContactModel(file.contact.model, file.contact.torsional_friction_m if soft else 0.0)

    def _pinch(self, file: HandFile, hand: Hand, postures: tuple[Array, Array], reach_m: Array) -> Hand:
        """Tool axis, synergy space and mirror: told and checked, or derived."""
        try:
            if file.tool_axis is not None:
                axis = np.array(file.tool_axis)
                if not np.linalg.norm(axis):
                    raise self.fail("tool_axis has no length")
                axis = axis / np.linalg.norm(axis)
            else:
                axis = find_tool_axis(hand, hand.coupled(0.5 * (postures[0] + postures[1])))
            hand = replace(hand, tool_axis=tuple(axis.tolist()))
            synergy = self._told_synergy(file, hand) or find_synergy(hand, postures, reach_m)
        except AminnError as error:
            if file.synergy is not None or file.tool_axis is not None:
                raise
            self.notes.append(f"no synergy space could be derived: {error}")
            synergy = None
        return replace(hand, synergy=synergy, mirror=self._mirror(file, hand))

    def _told_synergy(self, file: HandFile, hand: Hand) -> Synergy | None:
        """The hand file's synergy space, checked against the joints and their limits."""
        if file.synergy is None:
            return None
        n, axes = len(hand.joints), file.synergy.axes
        for what, numbers in (
            ("neutral_rad", file.synergy.neutral_rad),
            *((f"axes[{a.name}].column", a.column) for a in axes),
        ):
            if len(numbers) != n:
                raise self.fail(
                    f"synergy.{what} has {len(numbers)} numbers, the hand has {n} joints: {', '.join(hand.joints)}"
                )
        for axis in axes:
            if axis.range[0] >= axis.range[1]:
                raise self.fail(f"synergy.axes[{axis.name}].range is {list(axis.range)}, expected the lower end first")
        columns = np.array([a.column for a in axes])
        gram = columns @ columns.T
        if np.abs(gram - np.diag(np.diag(gram))).max() > 1e-9 * gram.max() or np.diag(gram).min() <= 0:
            raise self.fail("synergy.axes have columns that are not orthogonal to each other (or zero)")
        synergy = Synergy(
            tuple(a.name for a in axes),
            file.synergy.neutral_rad,
            tuple(a.column for a in axes),
            tuple(a.delta for a in axes),
            tuple(a.range for a in axes),
        )
        coordinates = [c for b in hand.branches for c in b.coordinates]
        for corner in product(*synergy.ranges):
            q = synergy.posture(np.array(corner))
            for c, angle in zip(coordinates, q, strict=True):
                if not c.low_rad <= angle <= c.high_rad:
                    at = ", ".join(f"{name} {value:g}" for name, value in zip(synergy.axes, corner, strict=True))
                    raise self.fail(
                        f"synergy.axes.range cannot be reached: at {at} joint {c.joint} is at {angle:.3f} rad, its "
                        f"limits in the model are {c.low_rad:g} to {c.high_rad:g}; narrow the ranges"
                    )
        return synergy

    def _mirror(self, file: HandFile, hand: Hand) -> Mirror | None:
        if file.mirror is None:
            return find_mirror(hand)
        mirror = mirror_in(hand, np.array(file.mirror.normal))
        if mirror is None:
            raise self.fail(
                "mirror.normal: the hand is not its own image in this plane through the palm frame's origin; leave "
                "[mirror] out"
            )
        return mirror

    def _colliders(self, model: _Model, bodies: Sequence[int]) -> list[int]:
        contype, affinity, body = (model.array(f"geom_{n}") for n in ("contype", "conaffinity", "bodyid"))
        return [g for g in range(len(body)) if body[g] in bodies and (contype[g] or affinity[g])]

    def _outermost(
        self, engine: _core.Engine, geoms: list[int], anchors: Array, rotation: Array, origin: Array, joints: list[int]
    ) -> int:
        """The colliding geom farthest from the last joint: the tip of the tip."""
        last = rotation @ anchors[joints[-1]] + origin
        return max(geoms, key=lambda g: float(np.linalg.norm(engine.data("geom_xpos")[g] - last)))

    def _refuse_scale(self, anchors: Array, points: list[Array], joints: list[list[int]]) -> None:
        for b, js in enumerate(joints):
            stations = [*(anchors[j] for j in js), points[b]]
            longest = max(float(np.linalg.norm(y - x)) for x, y in pairwise(stations))
            if longest > LONGEST_LINK_M:
                raise self.fail(
                    f"a link is {longest:.3g} m long; millimetres? MJCF is in metres (scale meshes and positions)"
                )

    def _servos(self, model: _Model) -> dict[int, float]:
        """Position stiffness of the joints that servos hold."""
        out: dict[int, float] = {}
        kinds, targets = model.array("actuator_trntype"), model.array("actuator_trnid")
        for a, name in enumerate(model.actuators):
            if kinds[a] == TRN_JOINT:
                j = int(targets[a][0])
                out[j] = out.get(j, 0.0) + _servo_gains(model, a)
            elif kinds[a] != TRN_TENDON:
                raise self.fail(f"actuator {name} drives neither a joint nor a tendon; take it out of the model")
        return out

    def _block(
        self, row: Array, joints: list[list[int]], names: list[str], what: str, dof: NDArray
    ) -> tuple[int, Array]:
        """The branch that a row over all degrees of freedom belongs to, and its entries there."""
        mine = [b for b, js in enumerate(joints) if any(row[dof[j]] for j in js)]
        if len(mine) > 1:
            both = " and ".join(names[b] for b in mine)
            raise self.fail(
                f"{what} couples the branches {both}; a stiffness by branches cannot hold that: take it out or lock one"
            )
        if not mine:
            return -1, np.zeros(0)
        return mine[0], np.array([row[dof[j]] for j in joints[mine[0]]])

    def _tendons(
        self, file: HandFile, model: _Model, joints: list[list[int]], names: list[str]
    ) -> list[tuple[Tendon, ...]]:
        out: list[list[Tendon]] = [[] for _ in joints]
        unknown = [p for p in file.stiffness.pull_only if not fnmatch.filter(model.tendons, p)]
        if unknown:
            raise self.fail(
                f"stiffness.pull_only: no tendon is called {unknown[0]!r}; there are "
                + (", ".join(model.tendons) or "none")
            )
        arms, dof = self._tendon_arms(file, model, joints), model.array("jnt_dofadr")
        kinds, targets, passive = (model.array(n) for n in ("actuator_trntype", "actuator_trnid", "tendon_stiffness"))
        for t, name in enumerate(model.tendons):
            drivers = [a for a in range(len(model.actuators)) if kinds[a] == TRN_TENDON and targets[a][0] == t]
            stiffness = float(passive[t]) + sum(_servo_gains(model, a) for a in drivers)
            if stiffness == 0:
                if drivers:
                    self.notes.append(
                        f"tendon {name} is driven by a motor without a position gain: it adds no stiffness"
                    )
                continue
            b, row = self._block(arms[t], joints, names, f"tendon {name}", dof)
            if b < 0:
                continue
            limits = [_force_range(model, a) for a in drivers]
            cable = any(fnmatch.fnmatch(name, p) for p in file.stiffness.pull_only)
            pulls = bool(limits) and all(high <= 0 for _, high in limits) and float(passive[t]) == 0
            if cable and not pulls:
                raise self.fail(
                    f"stiffness.pull_only: tendon {name} can push in the model: its actuator needs forcelimited and a "
                    "forcerange from -F to 0, and it needs no stiffness of its own"
                )
            most = -limits[0][0] if pulls and np.isfinite(limits[0][0]) else 0.0
            if pulls and most <= 0:
                raise self.fail(
                    f"tendon {name}: its actuator's forcerange lets it pull with {most:g} N; give it a range -F to 0"
                )
            if not pulls:
                self.notes.append(
                    f"tendon {name} pulls and pushes: a two-way spring (no force limit at 0 in the model)"
                )
            out[b].append(Tendon(name, tuple((-row).tolist()), stiffness, pulls, most))
        return [tuple(t) for t in out]

    def _tendon_arms(self, file: HandFile, model: _Model, joints: list[list[int]]) -> Array:
        """Change of each tendon's length by each degree of freedom (T, nv), half way of the closing motion."""
        engine, ranges, address = model.engine, model.array("jnt_range"), model.array("jnt_qposadr")
        q = np.zeros(len(model.joints))
        for j in (j for js in joints for j in js):
            q[address[j]] = ranges[j].mean()
            if file.closing is not None:
                q[address[j]] = np.mean([p.get(model.joints[j], 0.0) for p in (file.closing.open, file.closing.closed)])
        engine.reset()
        engine.set("qpos", q)
        engine.forward()
        return np.asarray(engine.tendon_jacobian())

    def _couplings(self, model: _Model, joints: list[list[int]], names: list[str]) -> list[tuple[Coupling, ...]]:
        """Equality constraints as springs of the engine's own stiffness, k = K I / R of their regulariser."""
        out: list[list[Coupling]] = [[] for _ in joints]
        kinds, active, data = (model.array(f"eq_{n}") for n in ("type", "active", "data"))
        first, second = model.array("eq_obj1id"), model.array("eq_obj2id")
        labels = model.engine.names("equality")
        dof = model.array("jnt_dofadr")
        engine = model.engine
        engine.reset()
        engine.set("qpos", np.zeros(len(model.joints)))
        engine.forward()
        rows_type, rows_id, regulariser, kbip = (engine.data(f"efc_{n}") for n in ("type", "id", "R", "KBIP"))
        arms = np.asarray(engine.tendon_jacobian())
        for e in np.flatnonzero(active):
            what = f"equality {labels[e] or e}"
            if kinds[e] in (EQ_CONNECT, EQ_WELD, EQ_DISTANCE):
                raise self.fail(
                    f"{what} closes a loop; the statics are of serial chains: describe the branch without it"
                )
            row = np.zeros(len(dof))
            objects = [(int(first[e]), 1.0)] + ([(int(second[e]), -float(data[e][1]))] if second[e] >= 0 else [])
            for number, factor in objects:
                row = row + factor * (np.eye(len(dof))[dof[number]] if kinds[e] == EQ_JOINT else arms[number])
            b, ratio = self._block(row, joints, names, what, dof)
            at = np.flatnonzero((rows_type == EFC_EQUALITY) & (rows_id == e))
            if b < 0 or not len(at):
                continue
            stiffness = float(kbip[at[0]][0] * kbip[at[0]][2] / regulariser[at[0]])
            out[b].append(Coupling(labels[e] or f"equality{e}", tuple(ratio.tolist()), stiffness))
        return [tuple(c) for c in out]

    def _refuse_limp(self, branch: Branch) -> None:
        """K_b must be positive definite: every way that the joints can turn is held by something."""
        values, vectors = np.linalg.eigh(branch.stiffness())
        if values[0] > 1e-9 * max(values[-1], 1e-30):
            own = np.array([c.stiffness_Nm_rad for c in branch.coordinates])
            for c in branch.couplings:
                held = max((k for k, r in zip(own, c.ratio, strict=True) if r), default=0.0)
                if c.stiffness_Nm_rad < WEAK_COUPLING * held:
                    self.notes.append(
                        f"coupling {c.name} of {branch.name} is a spring of {c.stiffness_Nm_rad:.3g} N.m/rad: it gives "
                        "way"
                    )
            return
        loose = [c.joint for c, v in zip(branch.coordinates, vectors[:, 0], strict=True) if abs(v) > 0.1]
        raise self.fail(
            f"branch {branch.name}: nothing holds {', '.join(loose)} (its stiffness is not positive definite); a joint "
            "needs a spring, a position servo or a tendon: for torque motors state stiffness.servo_Nm_rad"
        )

    def _refuse_straighteners(self, hand: Hand, closing: Array) -> None:
        """A branch that cables alone move needs one that bends it as the hand closes."""
        for branch, at in zip(hand.branches, hand.branch_joints, strict=True):
            cables = [t for t in branch.tendons if t.pull_only]
            way = closing[at]
            held = any(c.servo_Nm_rad > 0 and w != 0 for c, w in zip(branch.coordinates, way, strict=True))
            if cables and way.any() and not held and all(np.dot(t.arm_m, way) <= 0 for t in cables):
                names = ", ".join(t.name for t in cables)
                raise self.fail(
                    f"branch {branch.name}: pulling {names} straightens it, and nothing bends it from the open to the "
                    "closed posture; a tendon that bends has negative coefficients on joints that turn positively"
                )

    def _groups(self, file: HandFile, points: list[Array], tips: list[tuple[str, ...]]) -> list[str]:
        """Told, or: the tip farthest from the others faces them (two tips face each other)."""
        told = {t.tip: t.group for t in file.branch}
        if any(told.values()):
            out = [next((told[x] for x in names if told.get(x)), None) for names in tips]
            if None in out or len(set(out)) < 2:
                raise self.fail("branch.group: give every branch a group, of at least two that face each other")
            return [str(g) for g in out]
        distance = [min((float(np.linalg.norm(p - x)) for x in points if x is not p), default=0.0) for p in points]
        alone = int(np.argmax(distance))
        return ["thumb" if b == alone else "fingers" for b in range(len(points))]

    def _refuse_opening(self, hand: Hand, postures: list[Array]) -> None:
        """Closed, the fingertips that face each other have to be nearer to each other than open."""
        opened, closed = (1e3 * hand.gap(q) for q in postures)
        if closed > opened:
            raise self.fail(
                f"closing: fingertips that face each other are {opened:.0f} mm apart in the open posture and "
                f"{closed:.0f} mm in the closed one; are the two exchanged?"
            )

    def _postures(self, file: HandFile, hand: Hand) -> tuple[Array, Array]:
        """Told, or the least bent posture of the joints' ranges and 0.7 of the way to the most bent one."""
        coordinates = [c for b in hand.branches for c in b.coordinates]
        if file.closing is not None:
            out = [
                np.array([p.get(c.joint, 0.0) for c in coordinates]) for p in (file.closing.open, file.closing.closed)
            ]
            for name, q in zip(("open", "closed"), out, strict=True):
                for c, angle in zip(coordinates, q, strict=True):
                    if not c.low_rad - 1e-9 <= angle <= c.high_rad + 1e-9:
                        raise self.fail(
                            f"closing.{name}: joint {c.joint} at {angle:g} rad is beyond its limits {c.low_rad:g} to "
                            f"{c.high_rad:g}"
                        )
            self._refuse_opening(hand, out)
            return out[0], out[1]
        if file.synergy is not None:
            neutral = file.synergy.neutral_rad
            if len(neutral) != len(coordinates):
                raise self.fail(
                    f"synergy.neutral_rad has {len(neutral)} numbers, the hand has {len(coordinates)} joints: "
                    + ", ".join(hand.joints)
                )
            return np.array(neutral, float), np.array(neutral, float)
        low, high = (np.array([getattr(c, n) for c in coordinates]) for n in ("low_rad", "high_rad"))
        self.notes.append("no open and closed posture are told ([closing]): taken from the joints' ranges")
        start = np.clip(np.zeros(len(coordinates)), low, high)
        return start, start + 0.7 * (np.where(high + low >= 0, high, low) - start)


def table(understood: Understood) -> list[list[str]]:
    """Rows of what was understood, one for each joint and tendon, under a header."""
    rows = [["branch", "joint", "axis", "anchor, mm", "range, rad", "stiffness, N.m/rad", "tendons: arm, mm"]]
    for branch in understood.hand.branches:
        for c, coordinate in enumerate(branch.coordinates):
            arms = [f"{t.name} {1e3 * t.arm_m[c]:.3g}" for t in branch.tendons if t.arm_m[c]]
            spring, servo = coordinate.spring_Nm_rad, coordinate.servo_Nm_rad
            parts = [f"spring {spring:.3g}"] * (spring > 0) + [f"servo {servo:.3g}"] * (servo > 0)
            parts += [f"coupling {s.stiffness_Nm_rad:.3g}" for s in branch.couplings if s.ratio[c]]
            rows.append(
                [
                    f"{branch.name} ({branch.group})" if c == 0 else "",
                    coordinate.joint,
                    " ".join(f"{x:+.2f}" for x in coordinate.axis),
                    " ".join(f"{1e3 * x:.1f}" for x in coordinate.anchor_m),
                    f"{coordinate.low_rad:.2f} to {coordinate.high_rad:.2f}",
                    ", ".join(parts) or "-",
                    ", ".join(arms) or "-",
                ]
            )
        tip = " ".join(f"{1e3 * x:.1f}" for x in branch.tip_point_m)
        rows.append(["", f"tip {branch.tip}", "", tip, "", f"contact {1e6 * branch.eps_m:.3g} um/N", ""])
    return rows


def safe_name(name: str) -> str:
    """A file name from a hand's."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name)
