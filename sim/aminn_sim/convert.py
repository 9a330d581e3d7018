"""`aminn hand convert`: a model that the simulation's MuJoCo refuses, through the current one to one that it takes.

The result is compared with the original as the current engine compiled it, number by number, and refused where
something is gone that the mechanics needs.
"""

from __future__ import annotations

import importlib.util
import re
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import refuse_inputs, write_atomically, write_json
from aminn_base.read import AnyPath, is_file, read_bytes, read_text
from aminn_hand.hand_file import HandFile, model_path, read_hand_file

from . import _core, mjcf_tree
from .current_mujoco import import_mujoco
from .current_source import MESH, Writer, Written
from .hand_check import columns

Array = NDArray[np.float64]
ALMOST = 1e-6
"""Largest difference, of the largest number of its kind, that counts as the same; the engines round differently."""
MESH_ALMOST_M = 1e-6
FULL = 10.0
"""Command of an actuator whose commands have no limit, where the engines' torques are compared."""
BALANCE = "balanceinertia"
REPORT = "report.txt"
URDF_LACKS = (
    "a URDF has no actuators and no stiffness: tell [stiffness] servo_Nm_rad in the hand file",
    "what firmware or a linkage couples is there only as <mimic>: tell the rest by [[coupling]] in the hand file",
)


@dataclass(frozen=True)
class Row:
    """One quantity of both models."""

    what: str
    original: str
    converted: str
    same: bool
    needed: bool
    """The mechanics needs it: a difference is an error and not a warning."""

    def cells(self) -> list[str]:
        return [self.what, self.original, self.converted, "" if self.same else "differs"]


@dataclass(frozen=True)
class Conversion:
    """A model in the dialect of the simulation's MuJoCo, and how it compares with the original."""

    source: Path
    root: ET.Element
    rows: tuple[Row, ...]
    warnings: tuple[str, ...]
    version: str
    """Of the current MuJoCo."""

    @property
    def text(self) -> str:
        """MJCF, in one file: colliding meshes are in it as their convex hulls."""
        ET.indent(self.root)
        return mjcf_tree.text_of(self.root) + "\n"

    def report(self) -> list[str]:
        """Lines: what the models have, what differs, what is left out."""
        head = ["what", f"original ({self.version})", f"converted ({_core.MUJOCO_VERSION})", ""]
        return [*columns([head, *(row.cells() for row in self.rows)]), *(f"note: {w}" for w in self.warnings)]

    def flat(self) -> dict:
        """The report as JSON: rows by name, and notes."""
        return {
            "engine": self.version,
            "warnings": list(self.warnings),
            "rows": {r.what: {"original": r.original, "converted": r.converted, "same": r.same} for r in self.rows},
        }


def convert(source: AnyPath, sheet: HandFile | None = None) -> Conversion:
    """Take a model (MJCF or URDF) through the current MuJoCo. Raises AminnError with what would be lost, by name.

    sheet: the hand file that names it. Where that tells a joint's stiffness, an actuator that is lost is not missed.
    """
    source = Path(source)
    mujoco = import_mujoco()
    is_urdf = _is_urdf(source)
    balanced: list[str] = []
    try:
        if is_urdf:
            model, balanced = _compiled_urdf(mujoco, source)
        else:
            mjcf_tree.refuse_large_file(source)
            model = mujoco.MjModel.from_xml_path(str(source))
    except (ValueError, RuntimeError) as error:  # the latter where memory does not suffice
        raise AminnError(f"{source}: MuJoCo {mujoco.__version__} does not take this model: {_line(error)}") from error
    if is_urdf:
        _refuse_bare(mujoco, model, source)
    written = Writer(mujoco, model, () if sheet is None else tuple(sheet.stiffness.servo_Nm_rad)).write()
    if written.lost:
        raise AminnError(
            f"{source}: MuJoCo {_core.MUJOCO_VERSION} cannot have what the mechanics needs: " + "; ".join(written.lost)
        )
    mjcf_tree.refuse_deep(source, written.root)
    if bad := next(written.bad_numbers(), None):
        raise AminnError(f"{source}: {bad} is not finite")
    try:
        engine = _core.Engine(mjcf_tree.text_of(written.root))
    except _core.MujocoError as error:
        raise AminnError(
            f"{source}: MuJoCo {_core.MUJOCO_VERSION} does not take what MuJoCo {mujoco.__version__} compiled: "
            f"{_line(error)}"
        ) from error
    rows = tuple(_compare(mujoco, model, engine, written))
    broken = [r for r in rows if r.needed and not r.same]
    if broken:
        parts = "; ".join(f"{r.what} {r.original} became {r.converted}" for r in broken)
        raise AminnError(f"{source}: the converted model is another one: {parts}")
    warnings = (*(URDF_LACKS if is_urdf else ()), *balanced, *dict.fromkeys(written.warnings))
    return Conversion(source, written.root, rows, warnings, f"MuJoCo {mujoco.__version__}")


def convert_to(file: AnyPath, out: AnyPath, echo: Callable[[str], None] = lambda line: None) -> Path:
    """Convert a model, or that of a hand file (.toml), into the folder `out`; the file to continue with.

    Writes the MJCF, report.txt and report.json, and for a hand file a copy that names the new model.
    """
    file, out = Path(file), Path(out)
    is_hand_file = file.suffix.lower() == ".toml"
    sheet = read_hand_file(file) if is_hand_file else None
    source = model_path(sheet, file) if sheet is not None else file
    model = out / f"{source.stem}.xml"
    outputs = [model, out / REPORT, out / "report.json", *([out / file.name] if is_hand_file else [])]
    for output in outputs:
        refuse_inputs(output, {file, source})
    done = convert(source, sheet)
    beside = _with_model(file, model.name) if is_hand_file else ""
    for line in done.report():
        echo(line)
    write_atomically(model, done.text.encode())
    write_atomically(out / REPORT, ("\n".join(done.report()) + "\n").encode())
    write_json(out / "report.json", done.flat())
    if is_hand_file:
        write_atomically(out / file.name, beside.encode())
    return out / file.name if is_hand_file else model


def _with_model(file: Path, name: str) -> str:
    """The hand file's text, with another model."""
    text = read_text(file)
    table = re.search(r"(?m)^\s*\[", text)  # a table may have a field of the same name
    end = table.start() if table else len(text)
    line = r"(?m)^([ \t]*)model[ \t]*=[ \t]*(?:\"[^\"\n]*\"|'[^'\n]*')"
    new = re.sub(line, lambda match: f"{match[1]}model = {_toml_text(name)}", text[:end], count=1) + text[end:]
    before, after = tomllib.loads(text), tomllib.loads(new)
    if after != before | {"model": name}:
        raise AminnError(f'{file}: write model = "..." on a line of its own, above the tables')
    return new


def _toml_text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _line(error: Exception) -> str:
    return re.sub(r"\s*\n\s*", ", ", str(error).strip().removeprefix("scene.xml: ")).removeprefix("Error: ")


def _is_urdf(source: Path) -> bool:
    return mjcf_tree.parse(source, read_bytes(source)).tag == "robot"


def _compiled_urdf(mujoco: Any, source: Path) -> tuple[Any, list[str]]:
    """The model, and what is said where inertias are impossible and the engine has to change them."""
    text = _urdf_text(source)
    try:
        return mujoco.MjModel.from_xml_string(text), []
    except ValueError as error:
        if BALANCE not in str(error):
            raise
        model = mujoco.MjModel.from_xml_string(text.replace(f'{BALANCE}="false"', f'{BALANCE}="true"'))
        return model, [f"an inertia that no body has is replaced by the nearest that is possible ({_line(error)})"]


def _urdf_text(source: Path) -> str:
    """The URDF without visuals, its mesh files as absolute paths, its first link fixed to the world by name.

    Left alone, the engine melts the first link and every fixed one into its parent, and palm and tips lose their names.
    """
    root = mjcf_tree.parse(source, read_bytes(source))
    children = {e.get("link") for joint in root.iter("joint") for e in joint.iter("child")}
    tops = [link.get("name", "") for link in root.findall("link") if link.get("name") not in children]
    for link in root.iter("link"):
        mjcf_tree.remove(link, link.findall("visual"))
        for mesh in link.iter("mesh"):
            mesh.set("filename", str(_urdf_mesh(mesh.get("filename", ""), source)))
    if tops and "world" not in {link.get("name") for link in root.iter("link")}:
        ET.SubElement(root, "link", name="world")
        joint = ET.SubElement(root, "joint", name="world_fixed", type="fixed")
        ET.SubElement(joint, "parent", link="world")
        ET.SubElement(joint, "child", link=tops[0])
    for extension in root.findall("mujoco"):
        root.remove(extension)
    extension = ET.SubElement(root, "mujoco")
    compiler = ET.SubElement(extension, "compiler", fusestatic="false", discardvisual="false", strippath="false")
    compiler.set(BALANCE, "false")
    return mjcf_tree.text_of(root)


def _urdf_mesh(name: str, source: Path) -> Path:
    """Where a mesh is: `package://` names a folder above the URDF, or an installed Python package."""
    if name.startswith("package://"):
        package, _, inside = name.removeprefix("package://").partition("/")
        folders = [folder for above in source.resolve().parents for folder in (above, above / package)
                   if folder.name == package]  # fmt: skip
        try:
            spec = importlib.util.find_spec(package) if package.isidentifier() else None  # "a.b" would import a
        except (ImportError, ValueError):
            spec = None
        folders += [Path(p) for p in (spec.submodule_search_locations or ())] if spec else []
        found = next((folder / inside for folder in folders if is_file(folder / inside)), None)
        if found is None:
            raise AminnError(
                f"{source}: {name} is not there: no folder {package!r} above the URDF and no installed Python package "
                f"of this name has {inside}"
            )
        return found.resolve()
    path = Path(name.removeprefix("file://"))
    path = path if path.is_absolute() else source.parent / path
    if not is_file(path):
        raise AminnError(f"{source}: the mesh {path} is not there")
    if path.suffix.lower() not in (".stl", ".obj", ".msh"):
        raise AminnError(f"{source}: {name}: the engine reads meshes as STL, OBJ or MSH; convert it")
    return path.resolve()


def _refuse_bare(mujoco: Any, model: Any, source: Path) -> None:
    """A URDF whose chains end in links without a collider touches nothing."""
    writer = Writer(mujoco, model)
    moving = [b for b in range(1, model.nbody) if model.body_jntnum[b] > 0]
    if not moving:
        raise AminnError(f"{source}: the URDF has no moving joints")
    carrier = [0] * model.nbody  # the nearest body above, or itself, that has a joint
    for b in range(1, model.nbody):
        carrier[b] = b if model.body_jntnum[b] > 0 else carrier[int(model.body_parentid[b])]
    last = set(moving) - {carrier[int(model.body_parentid[b])] for b in moving}
    touching = {carrier[int(b)] for b in model.geom_bodyid}
    bare = [writer.called("body", b) for b in sorted(last - touching)]
    if bare:
        raise AminnError(
            f"{source}: no <collision> in the link at the end of {len(bare)} of {len(last)} chains, which touches "
            f"nothing: {', '.join(bare)}; add <collision> with a sphere, a box or a mesh there"
        )


def _compare(mujoco: Any, m: Any, e: _core.Engine, written: Written) -> Iterator[Row]:
    """Rows of every quantity that the mechanics needs, and of mass."""

    def named(kind: str, n: int) -> list[str | None]:
        enum = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        return [mujoco.mj_id2name(m, enum, i) or None for i in range(n)]

    def row(what: str, old: Array, new: Array, unit: str = "", needed: bool = True, almost: float = ALMOST) -> Row:
        old, new = np.asarray(old, float), np.asarray(new, float)
        if old.shape != new.shape:
            return Row(what, f"{len(old)} numbers", f"{len(new)} numbers", False, needed)
        scale = max(1e-12, float(np.abs(old).max(initial=0)))
        worst = ~(np.abs(old - new) <= almost * scale)  # NaN too
        if not worst.any():
            summary = f"{len(old)}, to {scale:.3g} {unit}".strip() if np.any(old) else "none"
            return Row(what, summary, "same", True, needed)
        at = np.unravel_index(int(np.argmax(np.abs(old - new))), old.shape)
        where = f"[{', '.join(map(str, at))}]"
        return Row(what, f"{where} {old[at]:.6g} {unit}".strip(), f"{new[at]:.6g} {unit}".strip(), False, needed)

    counts = [("bodies", "body", m.nbody), ("joints", "joint", m.njnt), ("tendons", "tendon", m.ntendon)]
    counts += [("equalities", "equality", m.neq)]
    for what, kind, n in counts:
        old, new = named(kind, n), e.names(kind)
        same = len(old) == len(new) and all(a is None or a == b for a, b in zip(old, new, strict=True))
        yield Row(what, str(len(old)), str(len(new)), same, True)
        if len(old) != len(new):
            return
    driven, every = written.actuators, named("actuator", len(m.actuator_trntype))
    theirs = e.names("actuator")
    same = len(driven) == len(theirs) and all(every[a] in (None, b) for a, b in zip(driven, theirs, strict=True))
    yield Row("actuators", str(len(every)), str(len(theirs)), same and len(driven) == len(every), not same)
    if not same:
        return
    kept, sizes = np.array(written.geoms, int), e.model("geom_size")
    yield Row("colliders", str(len(kept)), str(len(sizes)), len(kept) == len(sizes), True)

    dof, address = m.jnt_dofadr, m.jnt_qposadr
    joint = np.flatnonzero(m.jnt_type >= 2)
    for what, field, unit in (("joint axes", "jnt_axis", ""), ("joint positions", "jnt_pos", "m")):
        yield row(what, getattr(m, field)[joint], e.model(field)[joint], unit)
    yield row("kinds of joints", m.jnt_type, e.model("jnt_type"))
    yield row("joint limits on", m.jnt_limited, e.model("jnt_limited"))
    limited = np.flatnonzero(m.jnt_limited)
    yield row("joint ranges", m.jnt_range[limited], e.model("jnt_range")[limited], "rad")
    yield row("joint springs", m.jnt_stiffness, e.model("jnt_stiffness"), "N.m/rad")
    yield row("their rest angles", m.qpos_spring[address[joint]], e.model("qpos_spring")[address[joint]], "rad")
    yield row("joint damping", m.dof_damping[dof], e.model("dof_damping")[dof], "N.m.s/rad")
    yield row("joint dry friction", m.dof_frictionloss[dof], e.model("dof_frictionloss")[dof], "N.m")
    yield row("joint armature", m.dof_armature[dof], e.model("dof_armature")[dof], "kg.m2")

    for what, field in (
        ("gears", "gear"),
        ("driven joint or tendon", "trnid"),
        ("gains", "gainprm"),
        ("servo stiffness and damping", "biasprm"),
    ):
        yield row(what, getattr(m, f"actuator_{field}")[driven], e.model(f"actuator_{field}"))
    for what, field in (("control ranges", "ctrl"), ("force limits", "force")):
        at = m.actuator_ctrladr[driven] if field == "ctrl" else driven
        on = getattr(m, f"actuator_{field}limited")[at].astype(bool)
        stated = getattr(m, f"actuator_{field}range")[at]
        if field == "force":
            on |= np.isin(driven, list(written.limits))
            stated = np.array([written.limits.get(a, stated[i]) for i, a in enumerate(driven)]).reshape(-1, 2)
        yield row(f"{what} on", on, e.model(f"actuator_{field}limited"))
        yield row(what, stated[on], e.model(f"actuator_{field}range")[on])
    yield row("tendon springs", m.tendon_stiffness, e.model("tendon_stiffness"), "N/m")
    yield row("their rest lengths", m.tendon_lengthspring[:, 0], e.model("tendon_lengthspring"), "m")
    yield row("tendon damping", m.tendon_damping, e.model("tendon_damping"), "N.s/m")
    yield row("tendon dry friction", m.tendon_frictionloss, e.model("tendon_frictionloss"), "N")
    scalar = np.flatnonzero((m.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) | (m.eq_type == int(mujoco.mjtEq.mjEQ_TENDON)))
    yield row("equality ratios", m.eq_data[scalar, :5], e.model("eq_data")[scalar, :5])
    for what, field in (("equality time constants", "eq_solref"), ("equality impedances", "eq_solimp")):
        yield row(what, getattr(m, field), e.model(field))
    yield row("masses", m.body_mass, e.model("body_mass"), "kg", needed=False)
    yield row("inertias", np.sort(m.body_inertia), np.sort(e.model("body_inertia")), "kg.m2", needed=False)
    kinds = m.geom_type[kept]
    yield row("shapes", kinds, e.model("geom_type"))
    plain = np.flatnonzero(kinds != MESH)
    yield row("sizes of shapes", m.geom_size[kept][plain], e.model("geom_size")[plain], "m")
    for field in ("contype", "conaffinity", "condim", "friction", "solref", "solimp", "margin", "gap"):
        yield row(f"{field} of shapes", getattr(m, f"geom_{field}")[kept], e.model(f"geom_{field}"))
    yield from _compare_poses(mujoco, m, e, row, written)


def _compare_poses(mujoco: Any, m: Any, e: _core.Engine, row: Callable[..., Row], written: Written) -> Iterator[Row]:
    """Where bodies, shapes and tendons are in two postures, and how strongly springs and actuators turn the joints."""
    data, kept, driven = mujoco.MjData(m), np.array(written.geoms, int), written.actuators
    gone = [int(m.actuator_trnid[a][0]) for a in range(len(m.actuator_trntype)) if a not in driven]
    compared = ~np.isin(m.dof_jntid, gone)
    compensated = m.jnt_actgravcomp[m.dof_jntid].astype(bool)
    commanded = m.actuator_ctrladr[driven]
    command = np.where(m.actuator_ctrllimited, m.actuator_ctrlrange[:, 1], FULL)[commanded]
    for name, share in (("at rest", None), ("bent", 0.7)):
        q = np.array(m.qpos0)
        for j in np.flatnonzero(m.jnt_type >= 2):
            if share is not None:
                low, high = m.jnt_range[j] if m.jnt_limited[j] else (0.0, 0.7)
                q[m.jnt_qposadr[j]] = low + share * (high - low)
        data.qpos[:], data.ctrl[commanded] = q, command
        mujoco.mj_forward(m, data)
        e.reset()
        e.set("qpos", q)
        e.set("ctrl", command)
        e.forward()
        yield row(f"positions of bodies, {name}", data.xpos, e.data("xpos"), "m")
        yield row(f"tendon lengths, {name}", data.ten_length, e.data("ten_length"), "m")
        plain = np.flatnonzero(m.geom_type[kept] != MESH)
        yield row(f"positions of shapes, {name}", data.geom_xpos[kept][plain], e.data("geom_xpos")[plain], "m")
        compensation = np.where(compensated, 0, data.qfrc_gravcomp), np.where(compensated, data.qfrc_gravcomp, 0)
        for what, field, left_out in zip(("springs", "actuators"), ("passive", "actuator"), compensation, strict=True):
            torques = getattr(data, f"qfrc_{field}") - left_out
            yield row(f"torques of {what}, {name}", torques[compared], e.data(f"qfrc_{field}")[compared], "N.m")
    meshes = [i for i, g in enumerate(kept) if m.geom_type[g] == MESH]
    boxes = np.array([_box(m, data, int(kept[i])) for i in meshes]).reshape(len(meshes), 2, 3)
    theirs = np.array([_converted_box(e, i) for i in meshes]).reshape(len(meshes), 2, 3)
    if meshes:
        yield row("extents of meshes, bent", boxes, theirs, "m", almost=MESH_ALMOST_M / max(1e-3, np.abs(boxes).max()))


def _extent(vertices: Array, rotation: Array, position: Array) -> Array:
    """Corners (2, 3) of the box around vertices, m, in the world."""
    world = vertices @ rotation.reshape(3, 3).T + position
    return np.array([world.min(axis=0), world.max(axis=0)])


def _box(m: Any, data: Any, g: int) -> Array:
    at, n = (int(a[m.geom_dataid[g]]) for a in (m.mesh_vertadr, m.mesh_vertnum))
    return _extent(m.mesh_vert[at : at + n], data.geom_xmat[g], data.geom_xpos[g])


def _converted_box(e: _core.Engine, i: int) -> Array:
    mesh = int(e.model("geom_dataid")[i])
    at, n = (int(e.model(f"mesh_{what}")[mesh]) for what in ("vertadr", "vertnum"))
    return _extent(e.model("mesh_vert")[at : at + n], e.data("geom_xmat")[i], e.data("geom_xpos")[i])
