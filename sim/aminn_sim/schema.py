"""What each field of a data set is: shape of a row, type, unit, frame, meaning. The manifest carries this table."""

from __future__ import annotations

from dataclasses import dataclass

from aminn_hand.hand import N_CONTACT_FEATURE, Hand
from aminn_hand.theta import Theta

from . import _core

SCHEMA_VERSION = 4


@dataclass(frozen=True)
class Field:
    """One data set of a shard; `shape` is that of a row."""

    shape: tuple[int, ...]
    unit: str
    frame: str
    meaning: str
    dtype: str = "f8"


_FLAG = "u1"

# Load cases that were simulated again, otherwise: how far a label can be trusted.
NOISE_FIELDS: dict[str, Field] = {
    "sample": Field((), "1", "", "the case, as a row of this shard's /samples", "i8"),
    "dx_half_step": Field((6,), "m, rad", "H", "dx_ht at half the time step"),
    "stable_half_step": Field((), "1", "", "stable at half the time step", _FLAG),
    "dx_impratio": Field((6,), "m, rad", "H", "dx_ht at ten times impratio"),
    "stable_impratio": Field((), "1", "", "stable at ten times impratio", _FLAG),
}


def theta_fields(hand: Hand) -> dict[str, Field]:
    """Of /grasps where hands differ from their description."""
    return {
        "theta": Field((len(Theta(hand)),), "1, rad, m", "", "mechanics parameters: the manifest's `theta_names`"),
        "hand_id": Field((), "1", "", "grasps of one number are of one hand, with one theta", "i8"),
    }


def groups_of(hand: Hand, varied: bool = False) -> dict[str, dict[str, Field]]:
    """Fields of each group of a shard, in the order in which they are written; varied: hands have a theta."""
    dims, axes = hand.dims, hand.synergy.axes if hand.synergy else ()
    b, c, j, t, s = dims.branches, dims.coordinates, dims.joints, dims.tendons, len(axes)
    samples = {
        "grasp_id": Field((), "1", "", "grasp of this load case, unique in the data set", "i8"),
        "q": Field((j,), "rad", "", "joint angles of the settled grasp, before the load"),
        "x_ht": Field((6,), "m, rad", "H", "tool pose before the load: position, rotation vector"),
        "w_e": Field((6,), "N, N.m", "H", "load on the tool: force, moment about the tool frame's origin"),
        "load_point_m": Field(
            (3,), "m", "H", "point that the load's force acts at; the tool frame's origin unless drawn"
        ),
        "contacts": Field(
            (b, N_CONTACT_FEATURE),
            "1, m, 1, N",
            "H",
            "per branch: in contact, position, unit normal into the tool, normal force",
        ),
        "j_x": Field((b, 3, 6), "1, m", "H", "closure Jacobian, tool side: [I | -[r]x], r from tool origin to contact"),
        "j_q": Field((b, 3, c), "m", "H", "closure Jacobian, joint side: -B; a short branch has its own columns last"),
        "dx_ht": Field(
            (6,), "m, rad", "H", "displacement by the load: translation, rotation vector of R_after R_before^T"
        ),
        "q_after": Field((j,), "rad", "", "joint angles at the end"),
        "tendon_tension_after_N": Field((t,), "N", "", "tendon tensions at the end; 0 is slack"),
        "stable": Field((), "1", "", "1 = the grasp holds", _FLAG),
        "reason": Field((), "1", "", "index into `reasons`: 0 stable, else why not", "i1"),
        "max_translation_m": Field((), "m", "H", "largest translation at any time; bound translation_max_m"),
        "max_rotation_rad": Field((), "rad", "H", "largest rotation at any time; bound rotation_max_rad"),
        "drift_m_s": Field(
            (), "m/s", "H", "speed over the last window, rotation times 0.1 m added; bound drift_max_m_s"
        ),
        "contact_lost": Field((), "1", "", "a contact was open for longer than lost_contact_s", _FLAG),
        "tool_left": Field((), "1", "", "no fingertip touched the tool, or it moved further than tool_left_m", _FLAG),
        "settled": Field((), "1", "", "drift fell below its bound", _FLAG),
        "other_contact": Field((), "1", "", "the tool touched something other than a fingertip", _FLAG),
        "creep_rate_m_s": Field((), "m/s", "H", "speed of the tool's origin over the last window"),
        "lost_time_s": Field(
            (b,), "s", "", "per branch: when its contact opened, from the start of the load; -1: not lost"
        ),
        "equilibrium_residual": Field(
            (), "1", "H", "what contact forces, weight and load leave on the tool at the end, relative to the load"
        ),
        "worst_penetration_m": Field((), "m", "", "deepest penetration at any time"),
        "solver_residual": Field((), "1", "", "scaled change of cost in the constraint solver's last iteration"),
        "hold_time_s": Field((), "s", "", "time at full load; shorter than hold_s where the case was stopped as lost"),
        "settle_time_s": Field(
            (), "s", "", "time at full load after which the drift stayed below its bound; -1: never"
        ),
    }

    grasps = {
        "grasp_id": Field((), "1", "", "unique in the data set", "i8"),
        "psi": Field((s,), "1", "", f"synergy coordinates of the pre-shape: {', '.join(axes)}"),
        "tool_family": Field((), "1", "", "index into `tool_families`", "i1"),
        "tool_size_m": Field(
            (3,), "m", "T", "half extents of the part that is held; x is the tool's long axis, y the pinch"
        ),
        "tool_geoms": Field(
            (3, 11),
            "1, m, m, 1",
            "T",
            "primitives: MuJoCo's geom type (-1: none), its size (3), position (3), quaternion (4)",
        ),
        "tool_inertia_kg_m2": Field((3,), "kg.m^2", "T", "principal moments of inertia about the tool's origin"),
        "tool_mass_kg": Field((), "kg", "", "mass, uniform density"),
        "friction": Field((), "1", "", "Coulomb friction between tool and fingertips"),
        "pinch_force_N": Field((), "N", "", "force asked of the second side (a thumb) when the hand closed"),
        "tendon_tension_N": Field((t,), "N", "", "tendon tensions of the settled grasp; 0 is slack"),
        "base_pose": Field((6,), "m, rad", "world", "commands of the base: slides x y z, hinges x y z"),
        "gravity_m_s2": Field((3,), "m/s^2", "H", "gravity"),
        "drift_m_s": Field((), "m/s", "H", "speed of the tool when the grasp was taken as settled"),
        "worst_penetration_m": Field((), "m", "", "deepest penetration of the settled grasp"),
        "rejections": Field(
            (len(_core.REJECTIONS),),
            "1",
            "",
            "attempts before this grasp held, by reason: the manifest's `rejection_reasons`",
            "i4",
        ),
        "q": Field((j,), "rad", "", "joint angles of the settled grasp"),
        "x_ht": Field((6,), "m, rad", "H", "tool pose of the settled grasp"),
        "contacts": Field((b, N_CONTACT_FEATURE), "1, m, 1, N", "H", "contacts of the settled grasp, as in /samples"),
    }
    grasps |= theta_fields(hand) if varied else {}
    return {"samples": samples, "grasps": grasps, "noise": NOISE_FIELDS}


def field_table(hand: Hand, varied: bool = False) -> dict[str, dict]:
    """The manifest's `fields`: plain names for /samples, with their group for the others."""
    named = {
        name if group == "samples" else f"{group}/{name}": field
        for group, fields in groups_of(hand, varied).items()
        for name, field in fields.items()
    }
    return {
        name: {"shape": list(f.shape), "dtype": f.dtype, "unit": f.unit, "frame": f.frame, "meaning": f.meaning}
        for name, f in named.items()
    }
