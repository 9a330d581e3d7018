"""The scene that is simulated: a hand on a base that is placed in six directions, and a tool.

The hand's model is taken as `understand` gives it. Solver options and contact softness are the simulation's own,
whatever the model says; the tool's contact parameters count for every contact of the tool.
"""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from . import mjcf_tree

Vector = tuple[float, ...]
TIMESTEP_S = 1e-3
CONTACT_TIME_S, CONTACT_IMPEDANCE = 0.004, (0.95, 0.99, 0.001)
"""Of every contact of the tool: time constant (critically damped); impedance when it opens, and from a depth (m) on."""
LEAST_CONTACT_LOG = 2 * math.log(2 * TIMESTEP_S / CONTACT_TIME_S)
"""Least logarithm of a factor on a contact's compliance, which goes with the square of its time constant: the engine
takes none below two time steps."""
TOOL_GEOMS = 3
"""Primitives that a tool may be made of."""
TOUCHES_ALL = str(2**31 - 1)
TOOL_PRIORITY = "1000"
BASE = {"slide": ("x", "y", "z"), "hinge": ("rx", "ry", "rz")}
BASE_STIFFNESS = {"slide": "200000", "hinge": "2000"}
"""N/m and N.m/rad: the palm stands still."""
BASE_DAMPING = {"slide": "900", "hinge": "12"}
CONTACTS_A_JOINT, ROWS_A_CONTACT = 5, 5
"""Room that the engine keeps, and clears with every load case: a hand of many joints touches at more places."""


@dataclass(frozen=True)
class SceneParts:
    """What of the scene is not told by the hand."""

    prefix: str
    """Names of the base's, the tool's and other parts that the scene adds begin with it; none of the hand's does."""
    palm: str
    """Body whose frame is H."""
    tips: tuple[tuple[str, ...], ...]
    """Geoms of each branch's tip; its pad point goes with the first."""
    forward: Vector
    """(3) H: from the second side's fingertips to the first side's while the hand is half closed."""


def own_prefix(root: ET.Element) -> str:
    """A prefix that no name of the model begins with."""
    prefix = "aminn_"
    while any(value.startswith(prefix) for e in root.iter() for value in e.attrib.values()):
        prefix += "_"
    return prefix


def set_options(root: ET.Element, gravity: str = "0 0 -9.81", contacts_a_joint: int = CONTACTS_A_JOINT) -> None:
    """Solver options of the simulation instead of the model's own, and room for so many contacts."""
    for tag in ("option", "size", "visual", "statistic", "sensor", "keyframe"):
        for element in root.findall(tag):
            root.remove(element)
    option = ET.SubElement(root, "option", timestep=str(TIMESTEP_S), integrator="implicit", cone="elliptic")
    for key, value in (
        ("impratio", "100"),
        ("solver", "Newton"),
        ("iterations", "50"),
        ("tolerance", "1e-10"),
        ("noslip_iterations", "30"),
        ("noslip_tolerance", "1e-10"),
        ("gravity", gravity),
    ):
        option.set(key, value)
    joints = sum(e.tag == "joint" for body in root.iter("body") for e in body)
    contacts = contacts_a_joint * joints
    ET.SubElement(root, "size", nconmax=str(contacts), njmax=str(ROWS_A_CONTACT * contacts))


def tool_geom(body: ET.Element, name: str, radius: str, friction: str, mass: str) -> ET.Element:
    """A sphere whose contact parameters count, whatever it touches and whatever the model's defaults are."""
    opening, deep, depth = CONTACT_IMPEDANCE
    contact = {"solref": f"{CONTACT_TIME_S} 1", "solimp": f"{opening} {deep} {depth} 0.5 2", "solmix": "1"}
    touch = {"contype": TOUCHES_ALL, "conaffinity": TOUCHES_ALL, "condim": "3", "friction": f"{friction} 0 0"}
    look = {"group": "0", "rgba": "0.85 0.55 0.20 1"}
    return ET.SubElement(
        body, "geom", {"name": name, "type": "sphere", "size": radius, "mass": mass, "pos": "0 0 0"}
        | contact | touch | look | {"priority": TOOL_PRIORITY, "margin": "0", "gap": "0"},
    )  # fmt: skip


def compose(root: ET.Element, palm: str, prefix: str) -> str:
    """MJCF text of the scene. The root is a model whose only moving parts are a hand's branches."""
    root = copy.deepcopy(root)
    set_options(root)
    ET.SubElement(root, "statistic", center="0 0 0.06", extent="0.25")
    ET.SubElement(ET.SubElement(root, "visual"), "headlight", ambient="0.4 0.4 0.4", diffuse="0.6 0.6 0.6")
    world = mjcf_tree.section(root, "worldbody")
    _add_base(root, _top(root, palm, prefix), prefix)
    ET.SubElement(world, "light", pos="0 0 1", dir="0 0 -1", directional="true")
    body = ET.SubElement(world, "body", name=f"{prefix}tool", pos="0 0 0.095")
    ET.SubElement(body, "freejoint", name=f"{prefix}tool")
    ET.SubElement(body, "inertial", pos="0 0 0", mass="0.08", diaginertia="9e-6 4e-5 4e-5")
    for k in range(TOOL_GEOMS):
        tool_geom(body, f"{prefix}tool_{k}", "0.001", "0.8", "0.02")
    return mjcf_tree.text_of(root)


def _top(root: ET.Element, palm: str, prefix: str) -> ET.Element:
    """The body that carries the palm, directly in the world; a new one where the palm is the world itself."""
    worlds = root.findall("worldbody")
    for world in worlds:
        for body in world.findall("body"):
            if any(b.get("name") == palm for b in body.iter("body")):
                return body
    carried = [e for world in worlds for e in world if e.tag in ("body", "geom", "site")]
    mjcf_tree.remove(root, carried)
    top = ET.SubElement(worlds[0], "body", name=f"{prefix}palm")
    top.extend(carried)
    return top


def _add_base(root: ET.Element, top: ET.Element, prefix: str) -> None:
    """Six stiff position servos between the world and the hand."""
    actuators = mjcf_tree.section(root, "actuator")
    place = 0
    for kind, names in BASE.items():
        for k, name in enumerate(names):
            joint = {
                "name": f"{prefix}base_{name}",
                "type": kind,
                "axis": " ".join("1" if i == k else "0" for i in range(3)),
            }
            own = {"pos": "0 0 0", "limited": "false", "armature": "0.02", "damping": BASE_DAMPING[kind], "group": "0"}
            none = dict.fromkeys(("stiffness", "frictionloss", "ref", "springref", "margin"), "0")
            top.insert(place, ET.Element("joint", joint | own | none | {"springdamper": "0 0"}))
            gain = BASE_STIFFNESS[kind]
            servo = ET.Element(
                "general",
                {"name": joint["name"], "joint": joint["name"], "gaintype": "fixed", "biastype": "affine"}
                | {"dyntype": "none", "gainprm": gain, "biasprm": f"0 -{gain} 0", "gear": "1", "group": "0"}
                | {"ctrllimited": "false", "forcelimited": "false"},
            )  # fmt: skip
            actuators.insert(place, servo)  # before the hand's: the engine wants those with a state last
            place += 1
