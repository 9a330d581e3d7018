"""MJCF for the simulation's MuJoCo, written from what the current MuJoCo compiled of a newer MJCF or of a URDF.

Everything comes from the compiled arrays: classes, frames, replicas and attachments are resolved there, masses of
meshes are numbers, and an element that the older engine does not know cannot be stripped with something inside it.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

FREE, BALL, SLIDE, HINGE = range(4)
JOINT_KINDS = ("free", "ball", "slide", "hinge")
PLANE, HFIELD, MESH, SDF = 0, 1, 7, 8
GEOM_KINDS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}
GEOM_SIZES = {0: 3, 2: 1, 3: 2, 4: 3, 5: 2, 6: 3}
DYNAMICS = {"NONE": "none", "INTEGRATOR": "integrator", "FILTER": "filter", "FILTEREXACT": "filter", "MUSCLE": "muscle"}
GAINS = {"FIXED": "fixed", "AFFINE": "affine", "MUSCLE": "muscle"}
BIASES = {"NONE": "none", "AFFINE": "affine", "MUSCLE": "muscle"}
INTEGRATORS = {"INT_EULER": "Euler", "INT_RK4": "RK4", "INT_IMPLICIT": "implicit", "INT_IMPLICITFAST": "implicit"}
NAMING: tuple[str, ...] = (
    "name",
    "mesh",
    "geom",
    "geom1",
    "geom2",
    "body1",
    "body2",
    "joint",
    "joint1",
    "joint2",
    "site",
    "sidesite",
)
NAMING += ("tendon", "tendon1", "tendon2")
"""Attributes whose values are names."""
NO_NUMBER = re.compile(r"\b(nan|inf)\b")
FLAGS = ("EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "GRAVITY", "CLAMPCTRL", "FILTERPARENT", "ACTUATION", "REFSAFE")
"""Of mjDSBL_*: what both engines can switch off."""


@dataclass
class Written:
    """A model as an MJCF tree of the older dialect, and what did not go into it."""

    root: ET.Element
    geoms: list[int] = field(default_factory=list)
    """Of the compiled model, in the order in which the tree has them."""
    actuators: list[int] = field(default_factory=list)
    """Likewise: the older engine wants those with a state of their own last."""
    limits: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Force limits, N, that actuators have instead of the joints that they alone drive."""
    lost: list[str] = field(default_factory=list)
    """Parts that the mechanics needs and the older engine cannot have."""
    warnings: list[str] = field(default_factory=list)
    """What changes without harm to the mechanics."""

    def bad_numbers(self) -> Iterator[str]:
        """Attributes of the tree that hold NaN or infinity, with what they are of."""
        for element in self.root.iter():
            for key, value in element.items():
                if key not in NAMING and NO_NUMBER.search(value):
                    of = f" {element.get('name')}" if "name" in element.attrib else ""
                    yield f"{key} of <{element.tag}>{of}, {value},"


def numbers(values: object) -> str:
    """As MJCF writes them, without loss."""
    return " ".join(repr(float(x)) for x in np.ravel(values))  # type: ignore[call-overload]


def truth(value: object) -> str:
    return "true" if value else "false"


class Writer:
    """One compiled model on its way to a tree."""

    def __init__(self, mujoco: Any, model: Any, told: Collection[str] = ()) -> None:
        """told: joints whose stiffness a hand file tells; `default` stands for all."""
        self.mujoco, self.m, self.told = mujoco, model, told
        self.out = Written(ET.Element("mujoco"))

    def name(self, kind: str, i: int) -> str | None:
        """What the model calls it; None where it has no name."""
        found = self.mujoco.mj_id2name(self.m, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), int(i))
        return found or None

    def called(self, kind: str, i: int) -> str:
        return self.name(kind, i) or f"{kind} {i}"

    def reference(self, kind: str, i: int) -> str:
        """A name that the tree can refer to, made up where the model has none."""
        return self.name(kind, i) or f"unnamed_{kind}_{int(i)}"

    def write(self) -> Written:
        m, root = self.m, self.out.root
        ET.SubElement(
            root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="true", strippath="false"
        )
        self._options()
        assets = ET.SubElement(root, "asset")
        self.paired = {int(g) for side in ("pair_geom1", "pair_geom2") for g in getattr(m, side)}
        world = ET.SubElement(root, "worldbody")
        elements = {0: world}
        for b in range(1, m.nbody):
            body = elements[b] = ET.SubElement(
                elements[int(m.body_parentid[b])], "body", name=self.reference("body", b)
            )
            body.attrib |= {"pos": numbers(m.body_pos[b]), "quat": numbers(m.body_quat[b])}
            if m.body_mocapid[b] >= 0:
                body.set("mocap", "true")
            if m.body_mass[b] > 0:
                ET.SubElement(
                    body,
                    "inertial",
                    pos=numbers(m.body_ipos[b]),
                    quat=numbers(m.body_iquat[b]),
                    mass=numbers(m.body_mass[b]),
                    diaginertia=numbers(m.body_inertia[b]),
                )
            for j in range(int(m.body_jntadr[b]), int(m.body_jntadr[b] + m.body_jntnum[b])):
                body.append(self._joint(j))
        self._geoms(elements, assets)
        for s in range(m.nsite):
            kind = GEOM_KINDS.get(int(m.site_type[s]), "sphere")
            ET.SubElement(
                elements[int(m.site_bodyid[s])],
                "site",
                {"name": self.reference("site", s), "pos": numbers(m.site_pos[s]), "quat": numbers(m.site_quat[s])}
                | {"type": kind, "size": numbers(np.maximum(m.site_size[s], 1e-6))},
            )
        self._contacts()
        self._tendons()
        self._equalities()
        self._actuators()
        self._rest()
        for empty in [e for e in root if len(e) == 0 and e.tag not in ("compiler", "option", "worldbody")]:
            root.remove(empty)
        return self.out

    def _label(self, kind: str, i: int) -> dict[str, str]:
        name = self.name(kind, i)
        return {"name": name} if name else {}

    def _options(self) -> None:
        opt, mujoco = self.m.opt, self.mujoco
        integrator = mujoco.mjtIntegrator(opt.integrator).name.removeprefix("mj")
        if integrator not in ("INT_EULER", "INT_RK4", "INT_IMPLICIT"):
            self.out.warnings.append(f"the integrator {integrator.removeprefix('INT_').lower()} becomes implicit")
        option = ET.SubElement(
            self.out.root,
            "option",
            timestep=numbers(opt.timestep),
            gravity=numbers(opt.gravity),
            integrator=INTEGRATORS.get(integrator, "implicit"),
            cone=("pyramidal", "elliptic")[int(opt.cone)],
            solver=("PGS", "CG", "Newton")[int(opt.solver)],
            iterations=str(int(opt.iterations)),
            tolerance=numbers(opt.tolerance),
            noslip_iterations=str(int(opt.noslip_iterations)),
            impratio=numbers(opt.impratio),
        )
        flags = ET.SubElement(option, "flag")
        for flag in FLAGS:
            if opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")):
                flags.set(flag.lower(), "disable")
        springs, dampers = (
            bool(opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{f}"))) for f in ("SPRING", "DAMPER")
        )
        if springs and dampers:
            flags.set("passive", "disable")
        elif springs or dampers:
            self.out.lost.append("springs or dampers alone are switched off (<flag>)")
        if not opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_MULTICCD):
            self.out.warnings.append("convex shapes touch at one point a pair (multiccd is off)")

    def _joint(self, j: int) -> ET.Element:
        m, kind = self.m, int(self.m.jnt_type[j])
        joint = ET.Element("joint", name=self.reference("joint", j), type=JOINT_KINDS[kind])
        q, dof = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
        width = {FREE: 6, BALL: 3}.get(kind, 1)
        for what in ("damping", "frictionloss", "armature"):
            values = getattr(m, f"dof_{what}")[dof : dof + width]
            joint.set(what, numbers(values[0]))
            if np.ptp(values) > 0:
                self.out.warnings.append(
                    f"{what} of joint {self.called('joint', j)} differs by axis; the first is taken"
                )
        if kind == FREE:
            return joint
        joint.attrib |= {
            "pos": numbers(m.jnt_pos[j]),
            "stiffness": numbers(m.jnt_stiffness[j]),
            "limited": truth(m.jnt_limited[j]),
            "range": numbers(m.jnt_range[j]),
            "margin": numbers(m.jnt_margin[j]),
            "solreflimit": numbers(m.jnt_solref[j]),
            "solimplimit": numbers(m.jnt_solimp[j]),
            "solreffriction": numbers(m.dof_solref[dof]),
            "solimpfriction": numbers(m.dof_solimp[dof]),
        }
        if kind != BALL:
            joint.attrib |= {"axis": numbers(m.jnt_axis[j]), "ref": numbers(m.qpos0[q])}
            joint.set("springref", numbers(m.qpos_spring[q]))
        name = self.called("joint", j)
        if self._any("jnt_stiffnesspoly", j) or self._any("jnt_springyield", j):
            self.out.lost.append(f"joint {name}: a spring that is not linear")
        if self._any("dof_dampingpoly", dof):
            self.out.warnings.append(f"joint {name}: damping that is not linear is left out")
        return joint

    def _any(self, field_name: str, i: int) -> bool:
        return bool(np.any(getattr(self.m, field_name, np.zeros(i + 1))[i]))

    def _geoms(self, elements: dict[int, ET.Element], assets: ET.Element) -> None:
        m = self.m
        wraps = {int(m.wrap_objid[w]) for w in range(m.nwrap) if self._wrap(w) in ("SPHERE", "CYLINDER")}
        meshes: set[int] = set()
        left: list[str] = []
        for g in range(m.ngeom):
            kind = int(m.geom_type[g])
            touches = bool(m.geom_contype[g] or m.geom_conaffinity[g]) or g in self.paired
            if not touches and g not in wraps:
                left.append(self.called("geom", g))
                continue
            body = int(m.geom_bodyid[g])
            name = f"{self.called('geom', g)} of {self.called('body', body)}"
            if kind not in GEOM_KINDS or m.geom_plugin[g] >= 0:
                if body == 0:
                    self.out.warnings.append(f"{name}, a height field or a signed distance, is left out of the world")
                else:
                    self.out.lost.append(f"{name}: a collider that is a height field or a signed distance")
                continue
            label = {"name": self.reference("geom", g)} if g in self.paired | wraps else self._label("geom", g)
            geom = ET.SubElement(elements[body], "geom", label)
            self.out.geoms.append(g)
            geom.attrib |= {"type": GEOM_KINDS[kind], "pos": numbers(m.geom_pos[g]), "quat": numbers(m.geom_quat[g])}
            if kind == MESH:
                mesh = int(m.geom_dataid[g])
                geom.set("mesh", f"mesh_{mesh}")
                if mesh not in meshes:
                    meshes.add(mesh)
                    vertices = " ".join(f"{x:.9g}" for x in self.hull(mesh).ravel())
                    ET.SubElement(assets, "mesh", name=f"mesh_{mesh}", vertex=vertices)
            else:
                geom.set("size", numbers(m.geom_size[g][: GEOM_SIZES[kind]]))
            for what in ("contype", "conaffinity", "condim", "priority"):
                geom.set(what, str(int(getattr(m, f"geom_{what}")[g])))
            for what in ("friction", "solmix", "solref", "solimp", "margin", "gap"):
                geom.set(what, numbers(getattr(m, f"geom_{what}")[g]))
            if self._any("geom_adhesion", g) or self._any("geom_surfacevel", g):
                self.out.lost.append(f"{name}: a collider that sticks or moves its surface")
        if left:
            self.out.warnings.append(f"{len(left)} shapes that touch nothing (visuals) are left out")

    def hull(self, mesh: int) -> np.ndarray:
        """Vertices (n, 3) of a mesh's convex hull, what touches; in the mesh's own frame."""
        m, at = self.m, int(self.m.mesh_vertadr[mesh])
        vertices = m.mesh_vert[at : at + int(m.mesh_vertnum[mesh])]
        graph = int(m.mesh_graphadr[mesh])
        if graph < 0:
            return vertices
        n = int(m.mesh_graph[graph])
        return vertices[m.mesh_graph[graph + 2 + n : graph + 2 + 2 * n]]

    def _contacts(self) -> None:
        m, contact = self.m, ET.SubElement(self.out.root, "contact")
        for p in range(m.npair):
            pair = ET.SubElement(contact, "pair", condim=str(int(m.pair_dim[p])))
            for side in (1, 2):
                pair.set(f"geom{side}", self.reference("geom", getattr(m, f"pair_geom{side}")[p]))
            for what in ("friction", "solref", "solimp", "margin", "gap"):
                pair.set(what, numbers(getattr(m, f"pair_{what}")[p]))
        for e in range(m.nexclude):
            bodies = divmod(int(m.exclude_signature[e]), 1 << 16)
            ET.SubElement(contact, "exclude", {f"body{k}": self.reference("body", b) for k, b in enumerate(bodies, 1)})

    def _wrap(self, w: int) -> str:
        return self.mujoco.mjtWrap(int(self.m.wrap_type[w])).name.removeprefix("mjWRAP_")

    def _tendons(self) -> None:
        m, tendons = self.m, ET.SubElement(self.out.root, "tendon")
        for t in range(m.ntendon):
            name, first = self.called("tendon", t), int(m.tendon_adr[t])
            wraps = range(first, first + int(m.tendon_num[t]))
            fixed = self._wrap(first) == "JOINT"
            tendon = ET.SubElement(tendons, "fixed" if fixed else "spatial", name=self.reference("tendon", t))
            tendon.attrib |= {"limited": truth(m.tendon_limited[t]), "range": numbers(m.tendon_range[t])}
            for what in ("margin", "stiffness", "damping", "frictionloss"):
                tendon.set(what, numbers(getattr(m, f"tendon_{what}")[t]))
            for mine, theirs in (("limit", "lim"), ("friction", "fri")):
                for what in ("solref", "solimp"):
                    tendon.set(f"{what}{mine}", numbers(getattr(m, f"tendon_{what}_{theirs}")[t]))
            rest = m.tendon_lengthspring[t]
            tendon.set("springlength", numbers(rest[0]))
            if m.tendon_stiffness[t] and np.ptp(rest) > 0:
                self.out.lost.append(f"tendon {name}: a spring with a dead band (two springlength)")
            if self._any("tendon_stiffnesspoly", t) or self._any("tendon_springyield", t):
                self.out.lost.append(f"tendon {name}: a spring that is not linear")
            if m.tendon_actfrclimited[t]:
                self.out.lost.append(f"tendon {name}: a force limit on the tendon (actuatorfrcrange)")
            if m.tendon_armature[t]:
                self.out.warnings.append(f"tendon {name}: its armature is left out")
            for w in wraps:
                self._wrapped(tendon, w, name)

    def _wrapped(self, tendon: ET.Element, w: int, name: str) -> None:
        kind, target, parameter = self._wrap(w), int(self.m.wrap_objid[w]), float(self.m.wrap_prm[w])
        if kind == "JOINT":
            ET.SubElement(tendon, "joint", joint=self.reference("joint", target), coef=numbers(parameter))
        elif kind == "SITE":
            ET.SubElement(tendon, "site", site=self.reference("site", target))
        elif kind == "PULLEY":
            ET.SubElement(tendon, "pulley", divisor=numbers(parameter))
        elif kind in ("SPHERE", "CYLINDER"):
            geom = ET.SubElement(tendon, "geom", geom=self.reference("geom", target))
            if parameter >= 0:
                geom.set("sidesite", self.reference("site", int(parameter)))
        else:
            self.out.lost.append(f"tendon {name}: it wraps round a {kind.lower()}")

    def _equalities(self) -> None:
        m, equality = self.m, ET.SubElement(self.out.root, "equality")
        for e in range(m.neq):
            kind = self.mujoco.mjtEq(int(m.eq_type[e])).name.removeprefix("mjEQ_").lower()
            name, data, objects = self.called("equality", e), m.eq_data[e], (int(m.eq_obj1id[e]), int(m.eq_obj2id[e]))
            sites = int(m.eq_objtype[e]) == int(self.mujoco.mjtObj.mjOBJ_SITE)
            if kind not in ("connect", "weld", "joint", "tendon") or sites:
                self.out.lost.append(f"equality {name}: a {kind}" + " between sites" * sites)
                continue
            element = ET.SubElement(equality, kind, self._label("equality", e))
            element.attrib |= {"active": truth(m.eq_active0[e]), "solref": numbers(m.eq_solref[e])}
            element.set("solimp", numbers(m.eq_solimp[e]))
            if kind in ("joint", "tendon"):
                element.set("polycoef", numbers(data[:5]))
                for side, target in enumerate(objects, 1):
                    if target >= 0:
                        element.set(f"{kind}{side}", self.reference(kind, target))
                continue
            for side, target in enumerate(objects, 1):
                if target > 0 or side == 1:
                    element.set(f"body{side}", self.reference("body", target))
            if kind == "connect":
                element.set("anchor", numbers(data[:3]))
            else:
                element.attrib |= {"anchor": numbers(data[:3]), "relpose": numbers(data[3:10])}
                element.set("torquescale", numbers(data[10]))

    def _actuators(self) -> None:
        m, section = self.m, ET.SubElement(self.out.root, "actuator")
        limits = self._joint_limits()
        kept = []
        for a in range(len(m.actuator_trntype)):  # nu counts commands, of which some kinds have several
            strange = self._strange(a)
            if not strange:
                kept.append(a)
            elif self._is_told(a):
                joint = self.called("joint", m.actuator_trnid[a][0])
                self.out.warnings.append(
                    f"{self._actuator_called(a)}, {strange}, is left out: the hand file tells the stiffness of {joint}"
                )
            else:
                self.out.lost.append(f"{self._actuator_called(a)}: {strange}")
        self.out.actuators = sorted(kept, key=lambda a: self._kinds(a)[1] != "NONE")
        for a in self.out.actuators:
            section.append(self._actuator(a, limits))

    def _actuator_called(self, a: int) -> str:
        name = self.name("actuator", a)
        return f"actuator {name}" if name else f"actuator {a} (unnamed)"

    def _kinds(self, a: int) -> tuple[str, str, str, str]:
        """Transmission, dynamics, gain and bias, as the engine calls them."""
        kinds = (("Trn", "trn"), ("Dyn", "dyn"), ("Gain", "gain"), ("Bias", "bias"))
        transmission, dynamics, gain, bias = (
            getattr(self.mujoco, f"mjt{enum}")(int(getattr(self.m, f"actuator_{what}type")[a])).name.split("_", 1)[1]
            for enum, what in kinds
        )
        return transmission, dynamics, gain, bias

    def _is_told(self, a: int) -> bool:
        """Whether the actuator drives a joint whose stiffness the hand file tells."""
        if self._kinds(a)[0] != "JOINT":
            return False
        return "default" in self.told or self.called("joint", self.m.actuator_trnid[a][0]) in self.told

    def _strange(self, a: int) -> str:
        """What the older engine has no actuator for, and what to do about it, or ""."""
        transmission, dynamics, gain, bias = self._kinds(a)
        if transmission not in ("JOINT", "TENDON"):
            return f"it drives a {transmission.lower()}, neither a joint nor a tendon"
        unknown = [k for k, known in ((dynamics, DYNAMICS), (gain, GAINS), (bias, BIASES)) if k not in known]
        if self.m.actuator_plugin[a] >= 0:
            what = "a plugin"
        elif unknown:
            what = f"of the kind {unknown[0].lower()}"
        else:
            return ""
        if transmission == "TENDON":
            return f"{what}; write it as <position> with its gain"
        joint = self.called("joint", self.m.actuator_trnid[a][0])
        return f"{what}; tell a hand file the stiffness of {joint} (stiffness.servo_Nm_rad), or write it as <position>"

    def _actuator(self, a: int, limits: dict[int, tuple[float, float]]) -> ET.Element:
        m, (transmission, dynamics, gain, bias) = self.m, self._kinds(a)
        what = self._actuator_called(a)
        if dynamics == "FILTEREXACT":
            self.out.warnings.append(f"{what}: filterexact becomes filter")
        for extra in ("armature", "damping", "delay"):
            if self._any(f"actuator_{extra}", a):
                self.out.warnings.append(f"{what}: its {extra} is left out")
        target = transmission.lower()
        low, high = limits.get(a, (-np.inf, np.inf))
        if m.actuator_forcelimited[a]:
            low, high = max(low, m.actuator_forcerange[a][0]), min(high, m.actuator_forcerange[a][1])
        limited = bool(np.isfinite(low))
        command = int(m.actuator_ctrladr[a])
        if a in limits:
            self.out.limits[a] = (float(low), float(high))
        return ET.Element(
            "general",
            self._label("actuator", a)
            | {target: self.reference(target, m.actuator_trnid[a][0])}
            | {"gear": numbers(m.actuator_gear[a])}
            | {
                "ctrllimited": truth(m.actuator_ctrllimited[command]),
                "ctrlrange": numbers(m.actuator_ctrlrange[command]),
            }
            | {"forcelimited": truth(limited), "forcerange": numbers((low, high) if limited else (0, 0))}
            | {"dyntype": DYNAMICS[dynamics], "gaintype": GAINS[gain], "biastype": BIASES[bias]}
            | {f"{t}prm": numbers(getattr(m, f"actuator_{t}prm")[a]) for t in ("dyn", "gain", "bias")},
        )

    def _joint_limits(self) -> dict[int, tuple[float, float]]:
        """Force limits of joints (actuatorfrcrange) as those of the one actuator that drives each."""
        m, out, undriven = self.m, {}, []
        joint_driven = m.actuator_trntype == int(self.mujoco.mjtTrn.mjTRN_JOINT)
        for j in np.flatnonzero(m.jnt_actfrclimited).tolist():
            name = self.called("joint", j)
            mine = np.flatnonzero(joint_driven & (m.actuator_trnid[:, 0] == j)) if m.nu else np.zeros(0, int)
            by_tendon = self._through_tendon(j)
            if len(mine) == 1 and m.actuator_gear[mine[0]][0] and not by_tendon:
                ends = m.jnt_actfrcrange[j] / m.actuator_gear[mine[0]][0]
                out[int(mine[0])] = (float(ends.min()), float(ends.max()))
            elif len(mine) > 1:
                self.out.lost.append(
                    f"joint {name}: a force limit on the joint (actuatorfrcrange) with several actuators"
                )
            elif by_tendon:
                self.out.lost.append(f"joint {name}: a force limit on a joint (actuatorfrcrange) that a tendon drives")
            else:
                undriven.append(name)
        if undriven:
            self.out.warnings.append(
                f"force limits of {len(undriven)} joints that no actuator drives are left out ({', '.join(undriven)})"
            )
        return out

    def _through_tendon(self, joint: int) -> bool:
        """Whether an actuator on a tendon, fixed or spatial, moves the joint."""
        m, data = self.m, self.mujoco.MjData(self.m)
        self.mujoco.mj_forward(m, data)
        dof = int(m.jnt_dofadr[joint])
        return any(
            dof in data.moment_colind[data.moment_rowadr[a] :][: data.moment_rownnz[a]]
            for a in range(len(m.actuator_trntype))
            if int(m.actuator_trntype[a]) == int(self.mujoco.mjtTrn.mjTRN_TENDON)
        )

    def _rest(self) -> None:
        m, warn = self.m, self.out.warnings
        if np.any(m.body_gravcomp):
            warn.append(f"gravity compensation of {_named(self, np.flatnonzero(m.body_gravcomp).tolist())} is left out")
        if m.nflex:
            self.out.lost.append(f"{m.nflex} soft bodies (flex)")
        for what, n in (("sensors", m.nsensor), ("keyframes", m.nkey), ("cameras", m.ncam), ("lights", m.nlight)):
            if n:
                warn.append(f"{n} {what} are left out")


def _named(writer: Writer, bodies: Iterable[int]) -> str:
    return ", ".join(writer.called("body", b) for b in bodies)
