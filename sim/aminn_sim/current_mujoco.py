"""A simulated grasp in the current MuJoCo, the `mujoco` package: to draw it, and to load it again.

The simulation itself runs on Debian's MuJoCo 2.2. Here the same MJCF and the state of a settled grasp go to a later
version of the engine. It is of the same lineage: that both agree shows that the model does not hang on one version, and
not that its physics is right.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import rotation as rotation_matrix

from .errors import SimulationError
from .open_hand import OpenHand

Array = NDArray[np.float64]


def import_mujoco() -> ModuleType:
    """The package. Raises SimulationError with what to install.

    It takes its OpenGL from the environment when it is imported. Ours is OSMesa, whatever the environment asks for: it
    needs no display and no graphics card, and gives the same pixels everywhere.
    """
    if "mujoco" not in sys.modules:
        os.environ |= dict.fromkeys(("MUJOCO_GL", "PYOPENGL_PLATFORM"), "osmesa")
    try:
        try:
            found = importlib.import_module("mujoco")
        except AttributeError:  # of PyOpenGL, which found no OSMesa: all but pictures is there without it
            os.environ["MUJOCO_GL"] = "disabled"
            found = importlib.import_module("mujoco")
        if found.get_mju_user_warning() is None:
            found.set_mju_user_warning(_unsaid)
    except (ImportError, RuntimeError) as error:
        raise SimulationError(
            f"the package mujoco cannot be imported ({error}); install it (pip install 'aminn[mujoco]')"
        ) from error
    return found


def _unsaid(message: str) -> None:
    """The engine counts its warnings; left alone it writes them to MUJOCO_LOG.TXT in the working folder as well."""


def rotation_vector(rotation: Array) -> Array:
    """Rotation vector (3), angle in [0, pi], of a rotation matrix (3, 3)."""
    mujoco = import_mujoco()
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


class CurrentGrasp:
    """One grasp, set up in the current MuJoCo from the MJCF and from what `Session.scene` gives."""

    def __init__(
        self, opened: OpenHand, scene: dict, offscreen: int = 0, numbers: Sequence[tuple[str, int, float]] = ()
    ) -> None:
        """`offscreen` pixels a side make room for pictures; `numbers` are those of `Simulator.numbers`, if any."""
        self.mujoco = import_mujoco()
        understood = opened.understood
        parts = understood.parts
        try:
            spec = self.mujoco.MjSpec.from_string(understood.scene, assets=understood.assets)
            self._set_options(spec)
            self._set_tool(spec, f"{parts.prefix}tool", scene, opened.hand.contact.torsional_friction_m)
            if offscreen:
                spec.visual.global_.offwidth = spec.visual.global_.offheight = offscreen
            self.model = spec.compile()
            self.palm, self.tool = (self.model.body(name).id for name in (parts.palm, f"{parts.prefix}tool"))
            joints = [self.model.joint(name).id for name in opened.hand.joints]
            self.addresses = self.model.jnt_qposadr[joints]
        except (ValueError, KeyError) as error:  # what the parser and the compiler raise
            raise SimulationError(
                f"{understood.source}: MuJoCo {self.mujoco.__version__} does not take this model: {error}"
            ) from error
        if numbers:
            self._vary([name for names in parts.tips for name in names], f"{parts.prefix}tool_0", numbers)
        self.data = self.mujoco.MjData(self.model)
        self.scene = scene
        self.restore()

    def _set_options(self, spec: Any) -> None:
        """What the simulation's MuJoCo 2.2 does: one contact a pair of convex geoms, and an integrator that it has."""
        options, integrators = spec.option, self.mujoco.mjtIntegrator
        options.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_MULTICCD)  # on by default from 4.0 on
        if options.integrator == integrators.mjINT_DISCRETE:  # with noslip it pushes an unloaded tool out of the hand
            options.integrator = integrators.mjINT_IMPLICIT

    def _set_tool(self, spec: Any, name: str, scene: dict, torsional_friction_m: float) -> None:
        """Shape, mass, inertia and friction of the tool; the first geoms of the model's tool become its primitives."""
        body = spec.body(name)
        geoms = list(body.geoms)
        for geom, wanted in zip(geoms, scene["tool_geoms"], strict=False):
            geom.type = self.mujoco.mjtGeom(int(wanted["type"]))
            geom.size, geom.pos, geom.quat = wanted["size"], wanted["pos"], wanted["quat"]
            geom.alt.type = self.mujoco.mjtOrientation.mjORIENTATION_QUAT
            geom.friction[0] = scene["friction"]
            if torsional_friction_m > 0:
                geom.condim, geom.friction[1] = 4, torsional_friction_m
        for geom in geoms[len(scene["tool_geoms"]) :]:
            spec.delete(geom)
        body.explicitinertial = True
        body.mass, body.inertia = scene["mass_kg"], scene["inertia_kgm2"]

    def _vary(self, tips: Sequence[str], tool: str, numbers: Sequence[tuple[str, int, float]]) -> None:
        """Let the fingertips' contact parameters rule in place of the tool's, and set `numbers`."""
        model, other = self.model, self.model.geom(tool).id
        for tip in (model.geom(name).id for name in tips):
            for array in ("geom_condim", "geom_friction", "geom_solimp", "geom_solref"):
                getattr(model, array)[tip] = getattr(model, array)[other]
            model.geom_priority[tip] = model.geom_priority[other] + 1
        for array, index, value in numbers:
            getattr(model, array).reshape(-1)[index] = value

    def colour(self, joints: Sequence[str], rgba: Sequence[float]) -> None:
        """Draw what the joints move in a colour, whatever its material is."""
        moved = {int(self.model.joint(name).bodyid[0]) for name in joints}
        for body in range(1, self.model.nbody):  # parents come before their children
            if int(self.model.body_parentid[body]) in moved:
                moved.add(body)
        geoms = np.isin(self.model.geom_bodyid, list(moved))
        self.model.geom_rgba[geoms], self.model.geom_matid[geoms] = rgba, -1

    def restore(self) -> None:
        """The settled grasp, without a load."""
        self.mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = self.scene["qpos"], self.scene["qvel"]
        self.data.ctrl[:] = self.scene["ctrl"]
        self.mujoco.mj_forward(self.model, self.data)

    def palm_rotation(self) -> Array:
        """Axes of H in the world, as columns (3, 3)."""
        return self.data.xmat[self.palm].reshape(3, 3)

    def tool_pose(self) -> tuple[Array, Array]:
        """Position (3, m) and rotation (3, 3) of the tool in H."""
        palm = self.palm_rotation()
        return (
            palm.T @ (self.data.xpos[self.tool] - self.data.xpos[self.palm]),
            palm.T @ self.data.xmat[self.tool].reshape(3, 3),
        )

    def contact_forces(self) -> tuple[Array, Array]:
        """Contacts of the tool with the hand: points (n, 3; m, H) and the forces on the tool (n, 3; N, H)."""
        palm, points, forces = self.palm_rotation(), [], []
        bodies, local = self.model.geom_bodyid, np.zeros(6)
        for i, contact in enumerate(self.data.contact):
            on_tool = [bodies[geom] == self.tool for geom in contact.geom]
            if sum(on_tool) != 1:
                continue
            self.mujoco.mj_contactForce(self.model, self.data, i, local)
            force = contact.frame.reshape(3, 3).T @ local[:3]  # on the second geom; its opposite on the first
            points.append(palm.T @ (contact.pos - self.data.xpos[self.palm]))
            forces.append(palm.T @ force * (1 if on_tool[1] else -1))
        return np.array(points).reshape(-1, 3), np.array(forces).reshape(-1, 3)

    def place(self, q: Array, x_ht: Array, dx_ht: Array) -> None:
        """From the settled grasp, set the joints to q (8) and move the tool by dx_ht (6; m, rad; H) from x_ht (6)."""
        self.restore()
        self._place(self.data, q, x_ht[:3] + dx_ht[:3], rotation_matrix(dx_ht[3:]) @ rotation_matrix(x_ht[3:]))
        self.mujoco.mj_kinematics(self.model, self.data)

    def show(self, data: Any, q: Array, position: Array, rotation: Array) -> None:
        """Put hand and tool into other `data`, with the palm frame H as the world."""
        self._place(data, q, position, rotation)
        self.mujoco.mj_forward(self.model, data)

    def _place(self, data: Any, q: Array, position: Array, rotation: Array) -> None:
        """Joint angles, and the tool's pose in H, with the palm where `data` has it."""
        self.mujoco.mj_kinematics(self.model, data)
        palm, origin = data.xmat[self.palm].reshape(3, 3), data.xpos[self.palm]
        free = self.model.body_jntadr[self.tool]
        data.qpos[self.addresses] = q
        start = self.model.jnt_qposadr[free]
        data.qpos[start : start + 3] = origin + palm @ position
        quaternion = np.zeros(4)
        self.mujoco.mju_mat2Quat(quaternion, (palm @ rotation).ravel())
        data.qpos[start + 3 : start + 7] = quaternion

    def apply(self, w_e: Array) -> None:
        """Put the wrench w_e (6; N, N.m; H) on the tool from the next step on."""
        palm = self.palm_rotation()
        self.data.xfrc_applied[self.tool, :3] = palm @ w_e[:3]
        self.data.xfrc_applied[self.tool, 3:] = palm @ w_e[3:]

    def load(self, w_e: Array, ramp_s: float, hold_s: float) -> Array:
        """Displacement (6; m, rad; H) under w_e: a smooth ramp, then a hold, from the settled grasp."""
        self.restore()
        position, rotation = self.tool_pose()
        ramp, hold = (round(s / self.model.opt.timestep) for s in (ramp_s, hold_s))
        for n in range(1, ramp + hold + 1):
            x = min(1.0, n / ramp)
            self.apply(x * x * (3 - 2 * x) * w_e)
            self.mujoco.mj_step(self.model, self.data)
        self.mujoco.mj_kinematics(self.model, self.data)
        after, turned = self.tool_pose()
        return np.concatenate([after - position, rotation_vector(turned @ rotation.T)])
