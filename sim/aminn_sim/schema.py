"""What each field of a data set is: shape of a row, type, unit, frame, meaning. The manifest carries this table."""

from __future__ import annotations

from dataclasses import dataclass

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Field:
    """One data set of a shard; `shape` is that of a row."""

    shape: tuple[int, ...]
    unit: str
    frame: str
    meaning: str
    dtype: str = "f8"


_FLAG = "u1"

SAMPLE_FIELDS: dict[str, Field] = {
    "grasp_id": Field((), "1", "", "grasp of this load case, unique in the data set", "i8"),
    "q": Field((8,), "rad", "", "joint angles of the settled grasp, before the load"),
    "x_ht": Field((6,), "m, rad", "H", "tool pose before the load: position, rotation vector"),
    "w_e": Field((6,), "N, N.m", "H", "load on the tool: force, moment about the tool frame's origin"),
    "contacts": Field(
        (3, 8), "1, m, 1, N", "H", "per branch: in contact, position, unit normal into the tool, normal force"
    ),
    "j_x": Field((3, 3, 6), "1, m", "H", "closure Jacobian, tool side: [I | -[r]x], r from tool origin to contact"),
    "j_q": Field((3, 3, 3), "m", "H", "closure Jacobian, joint side: -B, columns roll, proximal, distal"),
    "dx_ht": Field((6,), "m, rad", "H", "displacement by the load: translation, rotation vector of R_after R_before^T"),
    "dx_ht_early": Field(
        (6,), "m, rad", "H", "the same half-way through the hold; its distance from dx_ht is label noise"
    ),
    "q_after": Field((8,), "rad", "", "joint angles at the end"),
    "tendon_tension_after_N": Field((6,), "N", "", "tendon tensions at the end; 0 is slack"),
    "stable": Field((), "1", "", "1 = the grasp holds", _FLAG),
    "reason": Field((), "1", "", "index into `reasons`: 0 stable, else why not", "i1"),
    "max_translation_m": Field((), "m", "H", "largest translation at any time; bound translation_max_m"),
    "max_rotation_rad": Field((), "rad", "H", "largest rotation at any time; bound rotation_max_rad"),
    "drift_m_s": Field((), "m/s", "H", "speed over the last window, rotation times 0.1 m added; bound drift_max_m_s"),
    "contact_lost": Field((), "1", "", "a contact was open for longer than lost_contact_s", _FLAG),
    "tool_left": Field((), "1", "", "no fingertip touched the tool, or it moved further than tool_left_m", _FLAG),
    "settled": Field((), "1", "", "drift fell below its bound", _FLAG),
    "other_contact": Field((), "1", "", "the tool touched something other than a fingertip", _FLAG),
    "creep_rate_m_s": Field(
        (), "m/s", "H", "mean speed of the tool's origin from half-way through the hold to the end"
    ),
    "worst_penetration_m": Field((), "m", "", "deepest penetration at any time"),
    "solver_residual": Field((), "1", "", "scaled change of cost in the constraint solver's last iteration"),
    "hold_time_s": Field((), "s", "", "time at full load; shorter than hold_s where the case was stopped as lost"),
}

GRASP_FIELDS: dict[str, Field] = {
    "grasp_id": Field((), "1", "", "unique in the data set", "i8"),
    "psi": Field((3,), "1", "", "synergy coordinates of the pre-shape: size, spread, curl"),
    "tool_family": Field((), "1", "", "index into `tool_families`", "i1"),
    "tool_size_m": Field(
        (3,), "m", "T", "half extents along the tool's axes; x is its long axis, y between the fingers"
    ),
    "tool_mass_kg": Field((), "kg", "", "mass, uniform density"),
    "friction": Field((), "1", "", "Coulomb friction between tool and fingertips"),
    "pinch_force_N": Field((), "N", "", "force asked of the thumb when the hand closed"),
    "tendon_tension_N": Field((6,), "N", "", "tendon tensions of the settled grasp; 0 is slack"),
    "base_pose": Field((6,), "m, rad", "world", "commands of the base: slides x y z, hinges x y z"),
    "gravity_m_s2": Field((3,), "m/s^2", "H", "gravity"),
    "drift_m_s": Field((), "m/s", "H", "speed of the tool when the grasp was taken as settled"),
    "worst_penetration_m": Field((), "m", "", "deepest penetration of the settled grasp"),
    "attempts": Field((), "1", "", "draws until this grasp held", "i4"),
    "q": Field((8,), "rad", "", "joint angles of the settled grasp"),
    "x_ht": Field((6,), "m, rad", "H", "tool pose of the settled grasp"),
    "contacts": Field((3, 8), "1, m, 1, N", "H", "contacts of the settled grasp, as in /samples"),
}


def field_table() -> dict[str, dict]:
    """The manifest's `fields`: names with their group for /grasps, plain names for /samples."""
    named = dict(SAMPLE_FIELDS) | {f"grasps/{name}": field for name, field in GRASP_FIELDS.items()}
    return {
        name: {"shape": list(f.shape), "dtype": f.dtype, "unit": f.unit, "frame": f.frame, "meaning": f.meaning}
        for name, f in named.items()
    }
