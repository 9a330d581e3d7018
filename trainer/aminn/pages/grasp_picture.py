"""A picture of a grasp before and under load: the hand's links, the tool, the force and the moment."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import NDArray

from aminn_hand import Hand
from aminn_hand.drawing import BRANCH_COLOURS, LOAD_COLOUR, turning
from aminn_hand.hand import rotation

from ..data.dataset import Dataset

Array = NDArray[np.float64]

TOOL_COLOUR = "#d9a441"
GHOST = "#9a9a9a"
LABEL = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
LIGHT = np.array([0.4, -0.5, 0.77])
# Motions smaller than this are drawn larger, and the caption says so.
VISIBLE_M = 0.006
SAME_POINT_M = 1e-6
LINK_RADIUS_M = 0.008
"""Of a fingertip that is not round, as it is drawn."""
ARROW_M = 0.04
TURN_M = 0.032  # radius of the curved arrow about a moment's axis
# Where the camera may stand, degrees from the long axis of tools: fingers and thumb are left and right, none in front.
ELEVATION, AZIMUTHS = 18, (-28, 28, 152, -152)


@dataclass(frozen=True)
class GraspPicture:
    """One load case. Lengths in m, angles in rad, everything in the hand's frame."""

    hand: Hand
    q: Array
    """Joint angles before the load (J)."""
    q_after: Array
    """The same under load (J)."""
    x_ht: Array
    """Tool pose before the load (6)."""
    dx_ht: Array
    """Simulated or measured displacement (6)."""
    w_e: Array
    """The load (6), N and N.m; the moment is about the tool's origin."""
    contacts: Array
    """Contact rows before the load (B, 8)."""
    tool_family: str
    """Name of the tool's family, for the caption."""
    tool_geoms: Array
    """The tool's primitives (n, 11): MuJoCo's type, size, position, quaternion; `tool_geoms` of a data set."""
    tool_size_m: Array
    """Half extents of the part that is held, along the tool's axes (3); x is the long one."""
    predicted_dx: Array | None = None
    """Predicted displacement (6), for the caption."""


BALL_M = 0.006
"""Radius of what stands for a tool whose shape is not known."""


def tool_of(data: Dataset, sample: int) -> tuple[str, Array, Array]:
    """What the tool of a load case is called, its primitives, and its half extents, as `GraspPicture` has them."""
    if data.measured:
        ball = np.array([[2, BALL_M, 0, 0, 0, 0, 0, 1, 0, 0, 0]])
        return "tool, a ball at the origin of its frame,", ball, np.full(3, BALL_M)
    grasp = int(data.grasp_rows()[sample])
    geoms, size_m = (np.asarray(data.grasps[name][grasp], float) for name in ("tool_geoms", "tool_size_m"))
    return data.manifest["tool_families"][int(data.grasps["tool_family"][grasp])], geoms, size_m


def joints_under_load(data: Dataset, sample: int) -> Array:
    """Joint angles (J) at the end of a load case; of a measured one the least change that lets contacts stick."""
    s, hand = data.samples, data.hand
    if not data.measured:
        return np.asarray(s["q_after"][sample], float)
    q = np.array(s["q"][sample], float)
    for b, at in enumerate(hand.branch_joints):
        turn = -np.linalg.pinv(s["j_q"][sample, b]) @ s["j_x"][sample, b] @ s["dx_ht"][sample]
        q[at] += turn[hand.dims.coordinates - (at.stop - at.start) :]
    return q


def branch_points(hand: Hand, branch: int, q: Array) -> Array:
    """The joints of a branch from the palm outwards, then the pad point of its tip (n, 3), m, by forward kinematics.

    Joints whose axes meet in a point are one.
    """
    own = hand.branches[branch]
    angles = np.asarray(q, float)[hand.branch_joints[branch]]
    _, anchors, _, _ = own.pose(angles)
    points = [*anchors, own.moved(angles, np.array(own.tip_point_m))]
    apart = [i for i, p in enumerate(points) if i == 0 or np.linalg.norm(p - points[i - 1]) > SAME_POINT_M]
    return np.array([points[i] for i in apart])


def _tube(start: Array, end: Array, radius: float, caps: bool = True, n: int = 20) -> list[Array]:
    """Quadrilaterals of a capsule from `start` to `end`."""
    axis = end - start
    length = float(np.linalg.norm(axis))
    z = axis / length if length > 0 else np.array([0.0, 0, 1])
    x = np.cross(z, [1.0, 0, 0] if abs(z[0]) < 0.9 else [0, 1.0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    around = np.linspace(0, 2 * math.pi, n + 1)
    ring = np.cos(around)[:, None] * x + np.sin(around)[:, None] * y  # (n + 1, 3)
    up = np.linspace(0, math.pi / 2, 6) if caps else np.zeros(1)
    rings = [start + radius * (math.cos(a) * ring - math.sin(a) * z) for a in up[::-1]]
    rings += [end + radius * (math.cos(a) * ring + math.sin(a) * z) for a in up]
    return [np.stack([a[i], a[i + 1], b[i + 1], b[i]]) for a, b in pairwise(rings) for i in range(n)]


def _cylinder(radius: float, half_length: float, n: int = 24) -> list[Array]:
    """Polygons of a cylinder along z: its side, and its ends cut in sectors."""
    top = np.array([0.0, 0, half_length])
    faces = _tube(-top, top, radius, caps=False, n=n)
    angle = np.linspace(0, 2 * math.pi, n + 1)
    rim = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(n + 1)], 1)
    return faces + [np.stack([z, z, z + b, z + a]) for z in (top, -top) for a, b in pairwise(rim)]


# MuJoCo's numbers of the shapes that tools are made of, and the polygons of each in its own frame by its size.
_SHAPES: dict[int, Callable[[Array], list[Array]]] = {
    2: lambda size: _tube(np.zeros(3), np.zeros(3), size[0]),
    3: lambda size: _tube(np.array([0, 0, -size[1]]), np.array([0, 0, size[1]]), size[0]),
    4: lambda size: [face * size for face in _tube(np.zeros(3), np.zeros(3), 1.0, n=28)],
    5: lambda size: _cylinder(size[0], size[1]),
}


def _rotated(quaternion: Array) -> Array:
    """Rotation matrix of a unit quaternion, scalar first."""
    w, v = float(quaternion[0]), np.asarray(quaternion[1:], float)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def tool_faces(geoms: Array) -> list[Array]:
    """Polygons (k, 3) of a tool in its own frame from its primitives (n, 11), as a data set has them."""
    faces = []
    for kind, *rest in np.asarray(geoms, float):
        if kind < 0:
            continue
        size, position, quaternion = np.split(np.array(rest), [3, 6])
        turn = _rotated(quaternion)
        faces += [face @ turn.T + position for face in _SHAPES[int(kind)](size)]
    return faces


def tool_outline(geoms: Array) -> list[Array]:
    """Lines (k, 3) that suggest a tool's shape, in its own frame."""
    return [np.concatenate([face, face[:1]]) for face in tool_faces(geoms)]


def _shade(faces: Sequence[Array], colour: str) -> list[tuple[float, float, float]]:
    """Colour of each face in a fixed light."""
    base = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    shades = []
    for face in faces:
        normal = np.cross(face[2] - face[0], face[3] - face[1])
        size = np.linalg.norm(normal)
        light = abs(float(normal @ LIGHT)) / size if size > 0 else 1.0
        shades.append(tuple(np.clip(base * (0.62 + 0.45 * light), 0, 1)))
    return shades


def _draw_solid(ax: Axes3D, faces: Sequence[Array], colour: str, alpha: float = 1.0) -> None:
    shades = [(*s, alpha) for s in _shade(faces, colour)]
    ax.add_collection3d(
        Poly3DCollection([1e3 * f for f in faces], facecolors=shades, edgecolors="none", zsort="average")
    )


def _placed(faces: Sequence[Array], pose: Array) -> list[Array]:
    turn = rotation(pose[3:])
    return [face @ turn.T + pose[:3] for face in faces]


def _moved(pose: Array, dx: Array) -> Array:
    """Pose (6) after a displacement; the rotation stays a matrix product, so it is exact for any size."""
    turn = rotation(dx[3:]) @ rotation(pose[3:])
    return np.concatenate([pose[:3] + dx[:3], _rotation_vector(turn)])


def _rotation_vector(turn: Array) -> Array:
    """Rotation vector of a matrix (angles below pi)."""
    axial = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine, cosine = float(np.linalg.norm(axial)), 0.5 * (float(np.trace(turn)) - 1)
    if sine < 1e-9:
        if cosine > 0:
            return axial
        values, vectors = np.linalg.eigh(0.5 * (turn + turn.T))
        return math.pi * vectors[:, int(np.argmax(values))]
    return axial / sine * math.atan2(sine, cosine)


def _draw_hand(ax: Axes3D, hand: Hand, q: Array) -> None:
    bases = []
    for b, branch in enumerate(hand.branches):
        points, colour = branch_points(hand, b, q), BRANCH_COLOURS[b]
        bases.append(points[0])
        radius = branch.tip_radius_m or LINK_RADIUS_M
        for start, end in pairwise(points):
            _draw_solid(ax, _tube(start, end, (0.55 if end is points[-1] else 0.6) * radius), colour)
        _draw_solid(ax, _tube(points[-1], points[-1], radius), colour)
    palm = Poly3DCollection([1e3 * _around(np.array(bases))], facecolors="#c9ced4", edgecolors="#9aa0a6", alpha=0.5)
    ax.add_collection3d(palm)


def _around(points: Array) -> Array:
    """The points in the order of a walk around their middle, for a polygon."""
    apart = points - points.mean(0)
    _, _, axes = np.linalg.svd(apart)
    return points[np.argsort(np.arctan2(apart @ axes[1], apart @ axes[0]))]


def _draw_ghost(ax: Axes3D, picture: GraspPicture) -> None:
    """Outlines of hand and tool before the load."""
    lines = [1e3 * branch_points(picture.hand, b, picture.q) for b in range(len(picture.hand.branches))]
    ax.add_collection3d(Line3DCollection(lines, colors=GHOST, linewidths=1.4, linestyles="dashed"))
    outline = _placed(tool_outline(picture.tool_geoms), np.asarray(picture.x_ht))
    edges = Line3DCollection([1e3 * line for line in outline], colors=GHOST, linewidths=0.3, alpha=0.6)
    ax.add_collection3d(edges)


def _draw_load(ax: Axes3D, w_e: Array, tool_size_m: Array, pose: Array) -> None:
    """The force as a straight arrow, the moment about the tool's origin as a curved one; what is zero is left out."""
    if np.linalg.norm(w_e[:3]) > 0:
        _draw_force(ax, np.asarray(w_e[:3], float), tool_size_m, pose)
    if np.linalg.norm(w_e[3:]) > 0:
        _draw_moment(ax, np.asarray(w_e[3:], float), np.asarray(pose[:3], float))


def on_picture(ax: Axes3D, points: Array) -> Array:
    """Points (n, 3), m, as points (n, 2) of the framed picture, for what must stand in front of everything."""
    x, y, _ = proj_transform(*(1e3 * points.T), ax.get_proj())
    return np.stack([x, y], 1)


def _draw_moment(ax: Axes3D, moment: Array, origin: Array) -> None:
    size = float(np.linalg.norm(moment))
    axis = moment / size
    for line in turning(axis, origin, TURN_M):
        ax.add_line(Line2D(*on_picture(ax, line).T, color=LOAD_COLOUR, linewidth=2.2, zorder=99))
    ends = on_picture(ax, origin + np.outer([-1.0, 1.4], 1.1 * TURN_M * axis))
    ax.add_line(Line2D(*ends.T, color=LOAD_COLOUR, linewidth=0.9, linestyle=(0, (4, 2)), zorder=99))
    text = {"color": LOAD_COLOUR, "fontsize": 9, "ha": "center", "va": "center", "bbox": LABEL, "zorder": 101}
    ax.annotate(f"{size:.3f} N.m", ends[1], **text)


def _draw_force(ax: Axes3D, force: Array, tool_size_m: Array, pose: Array) -> None:
    """An arrow that leaves the tool where the force's line through the tool's origin does."""
    size = float(np.linalg.norm(force))
    along = rotation(pose[3:]).T @ force / size
    depth = float((np.asarray(tool_size_m) / np.maximum(np.abs(along), 1e-9)).min())
    start, vector = 1e3 * (pose[:3] + (depth + 0.002) * force / size), 1e3 * ARROW_M * force / size
    ax.quiver(*start, *vector, color=LOAD_COLOUR, linewidth=2.2, arrow_length_ratio=0.3)
    a = math.radians(ax.azim)
    to_the_right = math.cos(a) * force[1] - math.sin(a) * force[0] >= 0
    side = "left" if to_the_right else "right"
    text = {"color": LOAD_COLOUR, "fontsize": 9, "ha": side, "va": "center", "bbox": LABEL, "zorder": 101}
    ax.annotate(f"{size:.1f} N", on_picture(ax, 1e-3 * (start + 1.15 * vector)[None])[0], **text)


def _azimuth(w_e: Array, hand: Hand) -> float:
    """The side to look from: where the force points across the picture, or rather towards the reader.

    A moment alone is seen from where it turns in the picture rather than across it.
    """
    alone = not np.any(w_e[:3])
    arrow, wanted = (np.asarray(w_e[3:], float), 0.7) if alone else (np.asarray(w_e[:3], float), 0.2)
    size = max(float(np.linalg.norm(arrow)), 1e-9)

    def towards(azimuth: float) -> float:
        a, e = math.radians(azimuth), math.radians(ELEVATION)
        view = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        across = float(view @ arrow) / size
        return abs(across) if alone else across

    x, y, _ = hand.tool_axis
    along = math.degrees(math.atan2(y, x))
    return min((along + a for a in AZIMUTHS), key=lambda azimuth: abs(towards(azimuth) - wanted))


def _frame(ax: Axes3D, points: Array, title: str) -> None:
    """Equal axes around the points, no clutter."""
    middle, half = 0.5 * (points.max(0) + points.min(0)), 0.5 * float(np.ptp(points, axis=0).max())
    for setter, m in zip((ax.set_xlim, ax.set_ylim, ax.set_zlim), middle, strict=True):
        setter(1e3 * (m - half), 1e3 * (m + half))
    ax.set_box_aspect((1, 1, 1), zoom=1.08)
    ax.set_title(title, fontsize=10, y=0.95)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_pane_color((1, 1, 1, 0))
        axis.line.set_color("#bbbbbb")
    ax.tick_params(labelsize=7, colors="#777777", pad=-2)
    ax.grid(False)
    ax.set_xlabel("x, mm", fontsize=8, labelpad=-6)
    ax.set_ylabel("y, mm", fontsize=8, labelpad=-6)
    ax.set_zlabel("z, mm", fontsize=8, labelpad=-6)
    ax.locator_params(nbins=4)


def magnification(dx: Array) -> int:
    """How many times larger a motion is drawn: 1 where it shows by itself."""
    size = max(float(np.linalg.norm(dx[:3])), 0.04 * float(np.linalg.norm(dx[3:])))
    return next((k for k in (1, 2, 5, 10) if k * size >= VISIBLE_M), 20)


def _caption(picture: GraspPicture, factor: int) -> str:
    def motion(dx: Array) -> str:
        return f"{1e3 * np.linalg.norm(dx[:3]):.2f} mm and {np.degrees(np.linalg.norm(dx[3:])):.2f} deg"

    force, moment = np.linalg.norm(picture.w_e[:3]), np.linalg.norm(picture.w_e[3:])
    load = f"{force:.2f} N and {moment:.3f} N.m"
    text = f"The {picture.tool_family} under {load} moves {motion(picture.dx_ht)} in the hand"
    if picture.predicted_dx is not None:
        text += f"; predicted: {motion(picture.predicted_dx)}"
    text += f". Dashed and grey: before the load. {load_legend(picture.w_e)}"
    return text + (f" The motion is drawn {factor} times as large." if factor > 1 else "")


def load_legend(w_e: Array) -> str:
    """What is red in a picture."""
    parts = []
    if np.any(w_e[:3]):
        parts.append("the force, in the tool's origin")
    if np.any(w_e[3:]):
        parts.append("curved, the moment about it" if parts else "the moment, about the dashed axis")
    return f"Red: {'; '.join(parts)}." if parts else "No load."


def draw_scene(
    ax: Axes3D, hand: Hand, q: Array, x_ht: Array, tool_geoms: Array, tool_size_m: Array, w_e: Array, title: str
) -> None:
    """One state of a grasp with the load: hand, see-through tool, force and moment."""
    ax.view_init(elev=ELEVATION, azim=_azimuth(w_e, hand))
    faces = _placed(tool_faces(tool_geoms), x_ht)
    _draw_hand(ax, hand, q)
    _draw_solid(ax, faces, TOOL_COLOUR, 0.35)
    reach = [branch_points(hand, b, q) for b in range(len(hand.branches))]
    _frame(ax, np.concatenate([*reach, *faces]), title)
    _draw_load(ax, w_e, tool_size_m, x_ht)


def draw_grasp(picture: GraspPicture) -> tuple[list[Figure], str]:
    """(figures, caption): the grasp before the load and under it, a figure each."""
    factor = magnification(picture.dx_ht)
    q_after = picture.q + factor * (np.asarray(picture.q_after) - picture.q)
    states = (
        (picture.q, np.asarray(picture.x_ht)),
        (q_after, _moved(picture.x_ht, factor * np.asarray(picture.dx_ht))),
    )
    half = np.asarray(picture.tool_size_m, float)
    reach = [branch_points(picture.hand, b, q) for q, _ in states for b in range(len(picture.hand.branches))]
    tools = [np.concatenate(_placed(tool_faces(picture.tool_geoms), pose)) for _, pose in states]
    points, figures = np.concatenate(reach + tools), []
    for k, ((q, pose), title) in enumerate(zip(states, ("before the load", "under load"), strict=True)):
        figure = Figure(figsize=(5.0, 5.0))
        figures.append(figure)
        ax = figure.add_subplot(projection="3d", computed_zorder=True)
        ax.set_position((0.05, 0.02, 0.86, 0.94))
        ax.view_init(elev=ELEVATION, azim=_azimuth(picture.w_e, picture.hand))
        _draw_hand(ax, picture.hand, q)
        _draw_solid(ax, _placed(tool_faces(picture.tool_geoms), pose), TOOL_COLOUR, 0.8)
        if k == 1:
            _draw_ghost(ax, picture)
        _frame(ax, points, title)
        if k == 1:
            _draw_load(ax, picture.w_e, half, pose)
    return figures, _caption(picture, factor)
