"""What the mechanics layer makes of one load case: springs, tendons, engagement and friction of each finger, and the
stiffness of the grasped tool with its principal compliances; and how sure the model is. As text and as a picture over
the hand."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath
from aminn_hand import Hand
from aminn_hand.drawing import BRANCH_COLOURS, turning

from ..data.dataset import MEASURED, Dataset
from ..data.origin import check_hand, same_configuration
from ..data.slides import SLID_M, slides
from ..evaluation.metrics import holds, pose_error, pose_size
from ..model.checkpoint import Checkpoint
from ..model.network import Aminn

Array = NDArray[np.float64]
PICTURES = (".png", ".svg", ".pdf")
NEAR_SLIDING = 0.9
"""Share of its friction from which a contact that holds is said to be about to slide."""
LEAST_SHARE, SHIFT_M, SPOKE_M, RING_M = 0.25, 0.05, 0.055, 0.011


@dataclass(frozen=True)
class Explanation:
    """One load case and what both stages say of it. Lengths in m, angles in rad, axes of the hand."""

    sample: int
    data: Dataset
    p_stable: float
    tau: float
    stiffness: Array  # (B, C, C) joint stiffness K_s of each branch, N.m/rad
    tendon: Array  # (B, C) tendon direction, unit in branch coordinates
    gain: Array  # (B,) tendon stiffness k_b, N.m/rad; 0 where a branch has no gated tendon
    gate: Array  # (B,) engagement in (0, 1)
    stretch: Array  # (B,) eta_b = <dq0, d>, rad, what the gate is judged by
    joint: Array  # (B, C) joint deflection of pass 1, rad
    k_x: Array  # (6, 6) stiffness, SI
    dx: Array  # (6,) predicted motion
    nominal_stiffness: Array  # (B, C) diagonal of the springs as described, or as theta has them, N.m/rad
    p_slide: float  # probability that a contact slides, if the grasp holds
    bound: float  # pose error that is not exceeded in 95 of 100
    most: float  # pose size of the motion at which a grasp counts as lost
    slides: bool  # whether the layer lets contacts slide; what follows is 0 where it does not
    use: Array  # (B,) share of its friction that each contact uses if none slides, as stage 1 judges it
    friction: Array  # (B,) friction coefficient that stage 1 takes
    slide: Array  # (B,) how much each contact gives along the tool's surface by sliding, m/N, of stage 2
    of_training: bool = True  # whether the model was trained on data of this configuration and seed

    def row(self, name: str) -> Array:
        """A field of the load case."""
        return np.asarray(self.data.samples[name][self.sample], float)

    @property
    def hand(self) -> Hand:
        return self.data.hand

    @property
    def seen(self) -> str:
        """What the data's own motion is called."""
        return MEASURED if self.data.measured else "simulated"

    @property
    def springs_of(self) -> str:
        """Whose springs `nominal_stiffness` is of."""
        told = self.data.has_theta and np.any(self.row("theta"))
        return "this hand's springs, by theta" if told else "nominal"

    def joints_of(self, branch: int) -> list[tuple[int, str]]:
        """(coordinate, name without the branch's own) of each joint of a branch."""
        own = self.hand.branches[branch]
        first = self.hand.dims.coordinates - len(own.coordinates)
        return [(first + i, short_name(c.joint, own.name)) for i, c in enumerate(own.coordinates)]

    def principal(self) -> tuple[Array, Array]:
        """Principal compliances (6), m/N, largest first, and their directions (6, 6) as columns.

        Of K_x with lengths divided by L: a direction is (translation, rotation times L) and has length 1.
        """
        s = np.repeat([1.0, 1.0 / self.hand.length_m], 3)
        values, vectors = np.linalg.eigh(self.k_x * s[:, None] * s)
        return 1 / values, vectors * np.sign(vectors[np.abs(vectors).argmax(0), range(6)])

    def flat(self) -> dict[str, float | int]:
        """The numbers as flat keys."""
        found: dict[str, float | int] = {"sample": self.sample, "p_stable": self.p_stable, "tau": self.tau}
        found |= {"p_slide": self.p_slide, "bound_95": self.bound}
        for b, own in enumerate(self.hand.branches):
            branch, gated = own.name, self.gain[b] > 0
            if gated:
                found |= {f"{branch}_gate": float(self.gate[b]), f"{branch}_tendon_gain_Nm_rad": float(self.gain[b])}
                found[f"{branch}_stretch_rad"] = float(self.stretch[b])
            if self.slides:
                found |= {f"{branch}_friction_use": float(self.use[b]), f"{branch}_friction": float(self.friction[b])}
                found[f"{branch}_slide_m_N"] = float(self.slide[b])
            for i, joint in self.joints_of(b):
                found[f"{branch}_{joint}_stiffness_Nm_rad"] = float(self.stiffness[b, i, i])
                if gated:
                    found[f"{branch}_{joint}_tendon_direction"] = float(self.tendon[b, i])
        compliances, directions = self.principal()
        for k in range(6):
            found[f"compliance{k}_m_N"] = float(compliances[k])
            found |= {f"compliance{k}_direction{i}": float(directions[i, k]) for i in range(6)}
        found |= {f"dx{i}": float(v) for i, v in enumerate(self.dx)}
        return found


def short_name(joint: str, branch: str) -> str:
    """A joint's name without that of its branch before it."""
    return joint.removeprefix(branch).strip("_-./ ") or joint


def explain_sample(checkpoint: Checkpoint, data: Dataset, sample: int) -> Explanation:
    """Both stages' view of load case number `sample`. Raises AminnError for another kind of model, hand or number."""
    model, dims = checkpoint.model, checkpoint.model.hand.dims
    if not isinstance(model, Aminn):
        raise AminnError(f"{checkpoint.path}: a {model.kind} has no mechanics to explain; give an aminn run")
    if not 0 <= sample < len(data):
        raise AminnError(f"sample {sample} is not there: the data set has load cases 0 to {len(data) - 1}")
    check_hand(checkpoint, data)
    with torch.no_grad():
        x = data.take(np.array([sample])).inputs()
        out, (chol, _) = model.debug(**x), model.stage2.backbone.nominal(x.get("theta"))
    value = {name: v[0].double().numpy() for name, v in out.items()}
    rows, cols = np.transpose(dims.cholesky_entries)
    lower = np.zeros((dims.branches, dims.coordinates, dims.coordinates))
    lower[:, rows, cols] = chol[..., 0].mT.double().numpy()
    return Explanation(
        sample,
        data,
        float(value["p_stable"]),
        float(checkpoint.meta["tau"]),
        value["s2_k_spring"],
        value["s2_tendon_dir"],
        value["s2_tendon_gain"],
        value["gate"],
        (value["s2_dq0"] * value["s2_tendon_dir"]).sum(1),
        value["s2_dq0"],
        value["k_x"],
        value["dx_ht"],
        np.diagonal(lower @ lower.transpose(0, 2, 1), axis1=1, axis2=2),
        float(value["p_slide"]),
        float(value["bound_95"]),
        math.hypot(model.config.motion_limits[0] / model.hand.length_m, model.config.motion_limits[1]),
        model.stage2.backbone.dims.slides,
        value["friction_use"],
        value["s1_friction"],
        value["s2_slide"],
        same_configuration(checkpoint, data),
    )


def _motion(dx: Array) -> str:
    p, r = 1e3 * dx[:3], np.rad2deg(dx[3:])
    return f"({p[0]:+.3f} {p[1]:+.3f} {p[2]:+.3f}) mm, ({r[0]:+.2f} {r[1]:+.2f} {r[2]:+.2f}) deg"


def _pose(error: float, length_m: float) -> str:
    """A pose error in the units of a motion."""
    return f"{error:.2g} ({1e3 * length_m * error:.2g} mm, or {np.rad2deg(error):.2g} deg)"


def bound_in_words(e: Explanation) -> str:
    """What the bound of the pose error says; nothing, where it is more than a grasp that holds can move."""
    if e.bound >= e.most:
        return f"pose error not bounded: {e.bound:.2g} is more than a grasp that holds can move ({e.most:.2g})"
    return f"pose error below {_pose(e.bound, e.hand.length_m)} in 95 of 100"


def contact_in_words(e: Explanation, branch: int) -> str:
    """What friction says of a contact, if contacts can slide: in a word or two."""
    if not e.slides:
        return ""
    if e.slide[branch] > 0:
        return f"slides, {1e3 * e.slide[branch]:.2g} mm/N"
    return "sticks" if e.use[branch] < NEAR_SLIDING else "about to slide"


def _slid(e: Explanation) -> str:
    """What the data say of how far contacts slid."""
    if e.data.measured:
        return ""
    far = 1e3 * slides(e.data.take(np.array([e.sample])))[0]
    names = [f"{own.name} {far[b]:.2f}" for b, own in enumerate(e.hand.branches) if e.row("contacts")[b, 0] > 0]
    return f"; {e.seen}: {', '.join(names)} mm" if names else ""


def as_text(e: Explanation) -> str:
    """The explanation for a terminal."""
    w, true = e.row("w_e"), e.row("dx_ht")
    held = bool(e.data.samples["stable"][e.sample])
    lines = [
        f"load case {e.sample}, grasp {int(e.data.samples['grasp_id'][e.sample])}",
        f"  load        ({w[0]:+.2f} {w[1]:+.2f} {w[2]:+.2f}) N, ({w[3]:+.4f} {w[4]:+.4f} {w[5]:+.4f}) N.m",
        f"  verdict     p_stable {e.p_stable:.3f}, threshold {e.tau:.3f}: "
        f"{'holds' if holds(e.p_stable, e.tau) else 'gives way'}; {e.seen}: {'holds' if held else 'gives way'}",
        f"  predicted   {_motion(e.dx)}",
        f"  {e.seen:10}  {_motion(true)}" + ("" if held else "  (gave way: the model is not trained on such motion)"),
    ]
    lines += [
        f"  sure        {bound_in_words(e)}",
        f"  slides      p_slide {e.p_slide:.3f}, that a contact slides by over {1e3 * SLID_M:g} mm if the grasp holds"
        + _slid(e),
    ]
    if not e.of_training:
        other = "measured, where" if e.data.measured else "of another configuration or seed than"
        lines.append(f"  data        {other} the model was trained on" + (" others" if e.data.measured else ""))
    if held:
        length_m = e.hand.length_m
        error = pose_error(e.dx[None], true[None], length_m)[0]
        share = error / max(pose_size(true[None], length_m)[0], 1e-9)
        within = "within" if error <= e.bound else "beyond"
        lines.append(f"  error       {share:.1%} of the motion: {_pose(error, length_m)}, {within} the bound")
    tendons = ", tendon direction, tendon stiffness, stretch, engagement" if e.hand.dims.gates else ""
    tendons = (", friction" if e.slides else "") + tendons
    lines += ["", f"fingers: joint stiffness (times {e.springs_of}){tendons}"]
    for b, own in enumerate(e.hand.branches):
        branch, joints = own.name, e.joints_of(b)
        if e.row("contacts")[b, 0] == 0:
            lines.append(f"  {branch:8} out of contact: it carries nothing")
            continue
        springs = ", ".join(
            f"{joint} {e.stiffness[b, i, i]:.3f} N.m/rad ({e.stiffness[b, i, i] / e.nominal_stiffness[b, i]:.2f})"
            for i, joint in joints
        )
        lines.append(f"  {branch:8} {springs}")
        if e.slides:
            lines.append(
                f"           uses {e.use[b]:.2f} of its friction (mu {e.friction[b]:.2f}): {contact_in_words(e, b)}"
            )
        if e.gain[b] == 0:
            continue
        direction = " ".join(f"{e.tendon[b, i]:+.2f}" for i, _ in joints)
        state = "taut" if e.gate[b] > 0.8 else "slack" if e.gate[b] < 0.2 else "partly engaged"
        lines += [
            f"           tendon ({direction}), {e.gain[b]:.3f} N.m/rad, "
            f"stretched by {np.rad2deg(e.stretch[b]):+.2f} deg, engaged {e.gate[b]:.2f}: {state}",
        ]
    compliances, directions = e.principal()
    length = f"{e.hand.length_m:g} m"
    lines += ["", f"K_x: principal compliances, softest first; directions are (translation | rotation times {length})"]
    for value, d in zip(compliances, directions.T, strict=True):
        kind = "translation" if np.linalg.norm(d[:3]) > np.linalg.norm(d[3:]) else "rotation"
        text = " ".join(f"{v:+.2f}" for v in d[:3]) + " | " + " ".join(f"{v:+.2f}" for v in d[3:])
        lines.append(f"  {1e3 * value:8.4f} mm/N  ({text})  {kind}")
    return "\n".join(lines)


@dataclass(frozen=True)
class SoftMotion:
    """A principal motion of the tool as a picture shows it; lengths in m, axes of the hand."""

    compliance: float  # m/N
    shift: Array  # (3,) its share of translation
    turn: Array  # (3,) its share of rotation, times L
    lines: tuple[Array, ...]  # (n, 3) each: one along the shift through the tool's origin; the turn's axis, with a ring
    label_at: Array  # (3,)


def softest(e: Explanation, count: int = 3) -> list[SoftMotion]:
    """The motions that the grasp resists least, of all six, softest first; shares below a quarter are not drawn."""
    compliances, directions = e.principal()
    origin, motions = e.row("x_ht")[:3], []
    for rank in range(count):
        shift, turn = directions[:3, rank], directions[3:, rank]
        lines: list[Array] = []
        label_at = origin
        if np.linalg.norm(turn) > LEAST_SHARE:
            axis = _down(turn) / np.linalg.norm(turn)
            lines += turning(axis, origin + SPOKE_M * axis, RING_M)
            lines.append(np.stack([origin, origin + (SPOKE_M + RING_M) * axis]))
            label_at = lines[-1][1]
        if np.linalg.norm(shift) > LEAST_SHARE:
            reach = SHIFT_M * _down(shift)
            lines.append(np.stack([origin - reach, origin + reach]))
            label_at = origin + reach if np.linalg.norm(shift) > np.linalg.norm(turn) else label_at
        motions.append(SoftMotion(float(compliances[rank]), shift, turn, tuple(lines), label_at))
    return motions


def _down(direction: Array) -> Array:
    """A direction whose sign is arbitrary, so that it stays in the picture: above the tool there is no room."""
    return -direction if direction[2] > 0 else direction


def draw(e: Explanation, out: AnyPath) -> None:
    """The picture: the hand with tool, engagement and springs at the fingers, the three softest motions at the tool.

    Its kind is the name's ending, of a device or FIFO without one PNG.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from .grasp_picture import LABEL, draw_scene, load_legend, on_picture, tool_of

    out = Path(out)
    kind = out.suffix or (".png" if out.exists() and not out.is_file() else "")
    if kind not in PICTURES:
        raise AminnError(f"{out}: pictures are written as {', '.join(PICTURES)}")
    figure = Figure(figsize=(10.8, 6.0), dpi=130)
    ax = figure.add_axes((0.03, 0.19, 0.58, 0.81), projection="3d", computed_zorder=True)
    hand = e.hand
    _, geoms, size_m = tool_of(e.data, e.sample)
    draw_scene(
        ax,
        hand,
        e.row("q"),
        e.row("x_ht"),
        geoms,
        size_m,
        e.row("w_e"),
        "springs, tendons and softest motions" if hand.dims.gates else "springs and softest motions",
    )
    for rank, motion in enumerate(softest(e)):
        for line in motion.lines:
            x, y = on_picture(ax, line).T
            ax.add_line(Line2D(x, y, color="#111111", linewidth=2.6 - 0.8 * rank, zorder=100))
        at = on_picture(ax, motion.label_at[None])[0]
        label = f"{rank + 1}: {1e3 * motion.compliance:.3g} mm/N"
        ax.annotate(label, at, fontsize=8, ha="center", va="bottom", bbox=LABEL, zorder=101)
    for b, branch in enumerate(hand.branches):  # side by side: at the fingers they would lie on one another
        state = f"\nengaged {e.gate[b]:.2f}" if e.gain[b] > 0 else ""
        state += f"\n{e.use[b]:.2f} of friction:\n{contact_in_words(e, b)}" if e.slides else ""
        text = branch.name + (state if e.row("contacts")[b, 0] > 0 else "\nno contact")
        x = 0.62 * (b + 0.5) / len(hand.branches)
        figure.text(x, 0.19, text, color=BRANCH_COLOURS[b], fontsize=8, ha="center", va="top")
    bars = figure.add_axes((0.68, 0.6, 0.3, 0.32))
    names = [(b, i, joint) for b in range(len(hand.branches)) for i, joint in e.joints_of(b)]
    ratio = [e.stiffness[b, i, i] / e.nominal_stiffness[b, i] for b, i, _ in names]
    bars.bar(range(len(names)), ratio, color=[BRANCH_COLOURS[b] for b, _, _ in names])
    bars.axhline(1, color="#777777", linewidth=0.8)
    bars.set_yscale("log")
    bars.set_ylim(min(0.4, 0.9 * min(ratio)), max(2.5, 1.1 * max(ratio)))
    bars.set_yticks([0.5, 1, 2], ["0.5", "1", "2"])
    bars.minorticks_off()
    many = len(names) > 9
    labels = [f"{hand.branches[b].name}{' ' if many else chr(10)}{joint}" for b, _, joint in names]
    bars.set_xticks(range(len(names)), labels, rotation=90 if many else 0)
    bars.set_title(f"joint stiffness, times {e.springs_of}", fontsize=9, loc="left")
    work = figure.add_axes((0.68, 0.12, 0.3, 0.34))
    scaled = np.repeat([1e3, 1e3 * hand.length_m], 3)
    at = np.arange(6)
    work.bar(at - 0.2, scaled * e.dx, 0.4, color="#1f5fa8", label="predicted")
    work.bar(at + 0.2, scaled * e.row("dx_ht"), 0.4, color="#111111", label=e.seen)
    work.axhline(0, color="#777777", linewidth=0.8)
    work.set_xticks(at, ["x", "y", "z", "rot x", "rot y", "rot z"])
    work.set_title(f"motion, mm (rotations times {hand.length_m:g} m)", fontsize=9, loc="left")
    work.legend(fontsize=7, frameon=False)
    for panel in (bars, work):
        panel.tick_params(labelsize=7)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    bars.tick_params(axis="x", labelsize=5.5)
    verdict = f"p_stable {e.p_stable:.3f} (threshold {e.tau:.3f}), p_slide {e.p_slide:.3f}, {bound_in_words(e)}"
    black = "Black, 1 to 3: what K_x resists least. A line: a shift along it; a ring: a turn about its axis."
    text = f"Load case {e.sample}: {verdict}.\n{load_legend(e.row('w_e'))} {black}"
    figure.text(0.02, 0.02, text, fontsize=8)
    picture = io.BytesIO()
    figure.savefig(picture, format=kind.removeprefix("."), facecolor="white")
    write_atomically(out, picture.getvalue())
