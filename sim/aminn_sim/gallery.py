"""Pictures of simulated grasps before and after their load, and a page that shows them side by side.

Drawn off-screen by the renderer of the `mujoco` package on OSMesa: no display and no graphics card are needed. Every
picture is in the palm frame H, whatever the wrist does: x to the viewer, y to the right, z up along the fingers.
"""

from __future__ import annotations

import importlib
import io
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgba
from numpy.typing import NDArray

from aminn_base.errors import WriteError
from aminn_base.files import sync_folder, write_atomically
from aminn_base.lock import locked_folder
from aminn_base.page import render
from aminn_base.read import AnyPath
from aminn_hand.drawing import BRANCH_COLOURS, LOAD_COLOUR, branch_key, turning

from . import _core
from .config import SimulationConfig
from .current_mujoco import CurrentGrasp, import_mujoco
from .errors import SimulationError
from .open_hand import OpenHand, open_hand
from .read import SimulatedData, read_data
from .replay import session_of
from .simulate import config_sha256
from .vary import theta_of

Array = NDArray[np.float64]

PIXELS = 480  # width and height of a picture
LOOK_AT_M = (0.0, 0.006, 0.050)  # H
TOOL_RGBA, TOOL_SHARE = (0.95, 0.66, 0.25, 1.0), 0.7  # contacts are seen through it
GHOST_RGBA, GHOST_SHARE = (0.55, 0.55, 0.55, 1.0), 0.4  # where the tool was before the load
LOAD_RGBA = to_rgba(LOAD_COLOUR)
CONTACT_RGBA = (0.90, 0.10, 0.60, 1.0)
TURN_M, TURN_STEP = 0.028, 3  # radius of a moment's curved arrow, and every which point of it is drawn
LONGEST_ARROW_M = 0.06
SKY_RGB = (0.96, 0.97, 0.98)
FINER = 2  # rendered at so many times the resolution, against jagged edges
HIDDEN_SHARE = 0.7  # of an arrow's colour where the hand is in front of it


@dataclass(frozen=True)
class Pose:
    """What a picture shows: joint angles (8), tool position (3, m, H) and rotation (3, 3), forces on the tool in H."""

    q: Array
    position: Array
    rotation: Array
    contact_points: Array
    """(n, 3) m."""
    contact_forces: Array
    """(n, 3) N."""


def gallery(folder: AnyPath, count: int, hand: AnyPath | None = None) -> Path:
    """Draw `count` grasps of the finished data set in `folder`; returns the page, folder/gallery/index.html.

    Tool families come in turn, cases that hold and cases that do not alternate. The page appears whole or not at all,
    whatever ends program or machine; that of an earlier call goes before it. Raises SimulationError where the data
    set is of another configuration or version, and where the renderer cannot be used.
    """
    folder = Path(folder)
    data, opened = read_data(folder), open_hand(hand)
    config, simulator = _config(folder, data, opened), opened.simulator()
    out, unfinished = folder / "gallery", folder / "gallery.unfinished"
    with locked_folder(folder):
        shutil.rmtree(unfinished, ignore_errors=True)
        try:
            unfinished.mkdir()
            with offscreen() as screen:
                entries = [
                    _draw(data, config, opened, simulator, row, unfinished, screen) for row in choose(data, count)
                ]
            page = render(
                Path(__file__).with_name("gallery.html.j2"),
                entries=entries,
                manifest=data.manifest,
                folder=folder,
                version=import_mujoco().__version__,
                fingers=branch_key(data.hand),
                forces=[("contact force", to_hex(CONTACT_RGBA)), ("load: force straight, moment curved", LOAD_COLOUR)],
            )
            write_atomically(unfinished / "index.html", page.encode())
            if out.exists():
                shutil.rmtree(out)
            unfinished.rename(out)
            sync_folder(folder)
        except (WriteError, OSError) as error:
            reason = error.reason if isinstance(error, WriteError) else error.strerror
            raise SimulationError(f"{out}: cannot be written ({reason}); make room or copy the data set") from error
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return out / "index.html"


def _config(folder: Path, data: SimulatedData, opened: OpenHand) -> SimulationConfig:
    """The configuration of a data set that this version, with this hand, makes in the same way."""
    try:
        config = SimulationConfig(**data.manifest["config"])
        same = config_sha256(config, opened) == data.manifest["config_sha256"]
    except (TypeError, KeyError):  # a field that this version does not have, or that the manifest lacks
        same = False
    if not same:
        raise SimulationError(
            f"{folder}: was simulated by another version or with another hand than {opened.path}; simulate it again"
        )
    return config


def choose(data: SimulatedData, count: int) -> list[int]:
    """Rows of /samples, one a grasp: families in turn, alternately the largest stable motion and a case that fails."""
    family, stable = data.grasps["tool_family"], data.samples["stable"] == 1
    turn = np.argsort([np.sum(family[:i] == f) for i, f in enumerate(family)], kind="stable")
    size = np.linalg.norm(data.samples["dx_ht"][:, :3], axis=1)
    rows = []
    for k, grasp in enumerate(turn[:count]):
        mine = np.flatnonzero(data.grasp_row == grasp)
        wanted = mine[stable[mine] == (k // len(set(family)) % 2 == 0)]
        rows.append(int(max(wanted if len(wanted) else mine, key=lambda row: size[row] if stable[row] else -row)))
    return rows


def _draw(
    data: SimulatedData,
    config: SimulationConfig,
    opened: OpenHand,
    simulator: _core.Simulator,
    row: int,
    out: Path,
    screen: Screen,
) -> dict:
    """Two pictures of a load case, and what the page says of it."""
    sample = {name: values[row] for name, values in data.samples.items()}
    number = int(sample["grasp_id"])
    theta = theta_of(config, opened.hand, number)
    session = session_of(config, opened, simulator, number)
    numbers = () if theta is None else simulator.numbers(theta)
    grasp = CurrentGrasp(opened, session.scene(), offscreen=PIXELS * FINER, numbers=numbers)
    for branch, colour in zip(opened.hand.branches, BRANCH_COLOURS, strict=False):
        grasp.colour([c.joint for c in branch.coordinates], to_rgba(colour))
    before = _pose(grasp, sample["q"])
    after = _loaded(grasp, sample)
    reference = max(float(np.linalg.norm(p.contact_forces, axis=1).max(initial=0.0)) for p in (before, after))
    reference = max(reference, float(np.linalg.norm(sample["w_e"][:3])), 1.0)
    names = {}
    for when, pose, ghost in (("before", before, None), ("after", after, before)):
        names[when] = f"case-{row:06d}-{when}.png"
        screen.draw(grasp, pose, ghost, sample, reference, out / names[when])
    return names | _facts(data, row, sample)


def _facts(data: SimulatedData, row: int, sample: dict) -> dict:
    """Numbers of the page, in the units that it shows."""
    grasp = {name: values[data.grasp_row[row]] for name, values in data.grasps.items()}
    manifest, dx, w = data.manifest, sample["dx_ht"], sample["w_e"]
    tendons = [tendon.name.replace("_", " ") for branch in data.hand.branches for tendon in branch.tendons]
    return {
        "grasp": int(sample["grasp_id"]),
        "tool": manifest["tool_families"][int(grasp["tool_family"])],
        "mass_g": 1e3 * float(grasp["tool_mass_kg"]),
        "friction": float(grasp["friction"]),
        "size_mm": [2e3 * float(x) for x in grasp["tool_size_m"]],
        "stable": bool(sample["stable"]),
        "reason": manifest["reasons"][int(sample["reason"])].replace("_", " "),
        "force_N": float(np.linalg.norm(w[:3])),
        "moment_Nm": float(np.linalg.norm(w[3:])),
        "translation_mm": 1e3 * float(np.linalg.norm(dx[:3])),
        "rotation_deg": float(np.degrees(np.linalg.norm(dx[3:]))),
        "tensions": "; ".join(
            f"{name} {before:.1f} → {after:.1f}"
            for name, before, after in zip(
                tendons, grasp["tendon_tension_N"], sample["tendon_tension_after_N"], strict=True
            )
        ),
    }


def _pose(grasp: CurrentGrasp, q: Array) -> Pose:
    """The present state of `grasp.data`."""
    position, rotation = grasp.tool_pose()
    points, forces = grasp.contact_forces()
    return Pose(q, position, rotation, points, forces)


def _loaded(grasp: CurrentGrasp, sample: dict) -> Pose:
    """The state at the end of a load case, from the joint angles and the displacement that were stored."""
    grasp.place(sample["q_after"], sample["x_ht"], sample["dx_ht"])
    grasp.apply(sample["w_e"])
    grasp.mujoco.mj_forward(grasp.model, grasp.data)
    return _pose(grasp, sample["q_after"])


class Screen:
    """An off-screen picture of PIXELS by PIXELS. Needs a current OpenGL context."""

    def __init__(self) -> None:
        self.mujoco = import_mujoco()

    def draw(
        self, grasp: CurrentGrasp, pose: Pose, ghost: Pose | None, sample: dict, reference: float, file: Path
    ) -> None:
        """Write one PNG. `reference` (N) is the force whose arrow is longest; the load is shown beside a ghost."""
        model, data = grasp.model, self.mujoco.MjData(grasp.model)
        grasp.show(data, pose.q, pose.position, pose.rotation)
        parts = np.flatnonzero(model.geom_bodyid == grasp.tool)
        model.geom_rgba[parts, 3] = 0  # the hand alone; the tool is a layer of its own
        hand, before, tool, arrows = (self._scene(model, data) for _ in range(4))
        before.ngeom = tool.ngeom = arrows.ngeom = 0  # what stays is the light
        self._tool(tool, model, parts, pose, TOOL_RGBA)
        for point, force in zip(pose.contact_points, pose.contact_forces, strict=True):
            self._arrow(arrows, point - LONGEST_ARROW_M * force / reference, point, 0.0028, CONTACT_RGBA)
        if ghost is not None:
            self._tool(before, model, parts, ghost, GHOST_RGBA)
            self._load(arrows, pose, sample, reference)
        layers = [(hand, 1.0, 0.0), (before, GHOST_SHARE, 0.0), (tool, TOOL_SHARE, 0.0), (arrows, 1.0, HIDDEN_SHARE)]
        _write_png(file, self._picture(model, layers))

    def _scene(self, model: Any, data: Any) -> Any:
        scene, camera = self.mujoco.MjvScene(model, 200), self.mujoco.MjvCamera()
        camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = LOOK_AT_M, 0.29, 152, -14
        scene.flags[self.mujoco.mjtRndFlag.mjRND_SHADOW] = False
        everything = self.mujoco.mjtCatBit.mjCAT_ALL
        seen = self.mujoco.MjvOption()
        seen.sitegroup[:] = 0  # those of tendons are red, as the load is
        self.mujoco.mjv_updateScene(model, data, seen, None, camera, everything, scene)
        return scene

    def _picture(self, model: Any, layers: list[tuple[Any, float, float]]) -> NDArray[np.uint8]:
        """Layers on a light ground, each with its share of the colour where it is in front, and where behind."""
        context = self.mujoco.MjrContext(model, self.mujoco.mjtFontScale.mjFONTSCALE_100)
        self.mujoco.mjr_setBuffer(self.mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        n = PIXELS * FINER
        picture, solid = np.tile(255.0 * np.array(SKY_RGB), (n, n, 1)), np.ones((n, n), np.float32)
        for k, (scene, in_front, behind) in enumerate(layers):
            colours, depths = self._render(context, scene)
            share = np.where(depths < 1, np.where(depths <= solid, in_front, behind), 0.0)[..., None]
            picture = share * colours + (1 - share) * picture
            solid = depths if k == 0 else solid
        context.free()
        small = picture.reshape(PIXELS, FINER, PIXELS, FINER, 3).mean((1, 3))
        return small[::-1].round().astype(np.uint8)

    def _render(self, context: Any, scene: Any) -> tuple[Array, NDArray[Any]]:
        """Colours (n, n, 3; 0 to 255) and depths (n, n; 1 is the background), bottom row first."""
        n = PIXELS * FINER
        colours, depths, area = (
            np.zeros((n, n, 3), np.uint8),
            np.zeros((n, n), np.float32),
            self.mujoco.MjrRect(0, 0, n, n),
        )
        self.mujoco.mjr_render(area, scene, context)
        self.mujoco.mjr_readPixels(colours, depths, area, context)
        return colours.astype(float), depths

    def _load(self, scene: Any, pose: Pose, sample: dict, reference: float) -> None:
        """The load's force where it acts, its moment beyond that of this force about the tool's origin."""
        force, moment = sample["w_e"][:3], sample["w_e"][3:]
        arm = sample["load_point_m"] - sample["x_ht"][:3]
        if np.linalg.norm(force) > 0:
            length = LONGEST_ARROW_M * max(0.25, float(np.linalg.norm(force)) / reference)
            tail = pose.position + arm
            self._arrow(scene, tail, tail + length * force / np.linalg.norm(force), 0.0038, LOAD_RGBA)
        rest = moment - np.cross(arm, force)
        if np.linalg.norm(rest) > 1e-6:
            arc, _ = turning(rest, pose.position, TURN_M)
            *line, last = pairwise(arc[::TURN_STEP])
            for start, end in line:
                self._connect(scene, self.mujoco.mjtGeom.mjGEOM_CAPSULE, start, end, 0.0016, LOAD_RGBA)
            self._arrow(scene, last[0], last[0] + 2.5 * (last[1] - last[0]), 0.0034, LOAD_RGBA)

    def _geom(self, scene: Any, kind: Any, size: Array, pos: Array, rotation: Array, rgba: tuple) -> Any:
        geom = scene.geoms[scene.ngeom]
        self.mujoco.mjv_initGeom(geom, kind, size, pos, rotation.ravel(), np.array(rgba, np.float32))
        scene.ngeom += 1
        return geom

    def _arrow(self, scene: Any, start: Array, end: Array, width: float, rgba: tuple) -> None:
        self._connect(scene, self.mujoco.mjtGeom.mjGEOM_ARROW, start, end, width, rgba)

    def _connect(self, scene: Any, kind: Any, start: Array, end: Array, width: float, rgba: tuple) -> None:
        geom = self._geom(scene, kind, np.zeros(3), np.zeros(3), np.eye(3), rgba)
        self.mujoco.mjv_connector(geom, kind, width, start, end)

    def _tool(self, scene: Any, model: Any, parts: NDArray[np.intp], pose: Pose, rgba: tuple) -> None:
        for g in parts:
            local = np.zeros(9)
            self.mujoco.mju_quat2Mat(local, model.geom_quat[g])
            rotation = pose.rotation @ local.reshape(3, 3)
            position = pose.position + pose.rotation @ model.geom_pos[g]
            kind = self.mujoco.mjtGeom(int(model.geom_type[g]))
            self._geom(scene, kind, model.geom_size[g], position, rotation, rgba)


def _write_png(file: Path, pixels: NDArray[np.uint8]) -> None:
    """Also without a word about the program that wrote it: equal pictures are equal bytes."""
    from PIL import Image  # comes with matplotlib

    image = io.BytesIO()
    Image.fromarray(pixels).save(image, "PNG", optimize=True)
    write_atomically(file, image.getvalue())


def _remedy() -> str:
    """What to do where OSMesa gives no context."""
    if find_library("OSMesa") is None:
        return "install Debian's libosmesa6 (apt-get install libosmesa6)"
    platform = os.environ.get("PYOPENGL_PLATFORM")
    if platform != "osmesa":
        return (
            f"libosmesa6 is there, but this process imported mujoco for OpenGL by {platform}; draw in a process of its "
            "own, or set MUJOCO_GL=osmesa and PYOPENGL_PLATFORM=osmesa before that"
        )
    return "libosmesa6 is there, so it is damaged or of another version; install it again"


@contextmanager
def offscreen() -> Iterator[Screen]:
    """An OpenGL context without a display. Raises SimulationError with what to install, or what stands in the way."""
    import_mujoco()
    try:
        context = importlib.import_module("mujoco.osmesa").GLContext(PIXELS * FINER, PIXELS * FINER)
        context.make_current()
    except (ImportError, AttributeError, RuntimeError) as error:
        raise SimulationError(f"pictures: no off-screen OpenGL by OSMesa ({error}); {_remedy()}") from error
    try:
        yield Screen()
    finally:
        context.free()
