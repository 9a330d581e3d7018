"""The head of `aminn_model.bin` (docs/model-format.md): is it a whole model, of which version, and of which hand?"""

from __future__ import annotations

import struct
import zlib

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_hand.hand import MAX_BRANCHES, MAX_COORDINATES, MIN_BRANCHES, N_CONTACT_FEATURE, N_WRENCH, Dims

FORMAT_VERSION = 11
"""Of the C model and the binary (AMINN_FORMAT_VERSION in aminn_rt.h)."""
MAGIC = 0x4D4E4D41  # "AMNM"
HEAD = struct.Struct("<4I")  # magic, format version, size, CRC-32 of what follows
# CRC-32 of the content; dimensions, widths, dq0 and weights, CRC-32 of the known stages, scalars; SHA-256 of checkpoint
# and data set; stage scalars; name, hand, made by
BODY = struct.Struct("<I12I4I2II14f32s32s4f56s56s40s")
_DIMS, _TAU, _NAMES = slice(1, 13), 23, slice(40, 43)
"""Of BODY's fields: the counts of `header_dims`; tau; name, hand, made by."""


def header_dims(dims: Dims) -> dict[str, int]:
    """Members of `aminn_model_t` by which the runtime knows the hand, in the header's order."""
    return {
        "n_branch": dims.branches,
        "n_coord": dims.coordinates,
        "n_joint": dims.joints,
        "n_contact_feature": N_CONTACT_FEATURE,
        "n_wrench": N_WRENCH,
        "n_gated": dims.gates,
        "n_twist": dims.branches if dims.twist else 0,
        "n_stiff": dims.stiff,
        "n_tendon": dims.tendons,
        "n_slide": int(dims.slides),
        "n_told": dims.factors,
        "n_sensed": dims.sensing,
    }


def output_words(dims: Dims) -> int:
    """Words of `aminn_output_t`: the outputs, condition, stable, notes."""
    return dims.output + 3


def check_blob(blob: bytes, source: AnyPath) -> None:
    """Raise AminnError unless the blob is whole and of this version; `source` is what the message calls it."""
    if len(blob) < HEAD.size + BODY.size:
        raise AminnError(f"{source}: truncated: {len(blob)} bytes")
    magic, version, size, crc = HEAD.unpack_from(blob)
    if magic != MAGIC:
        raise AminnError(f"{source}: not an AMINN model (wrong magic)")
    if version != FORMAT_VERSION:
        raise AminnError(f"{source}: format version {version}, this program reads {FORMAT_VERSION}; export it again")
    if size != len(blob):
        raise AminnError(f"{source}: {len(blob)} bytes, its header says {size}: truncated or overwritten")
    if zlib.crc32(blob[HEAD.size :]) != crc:
        raise AminnError(f"{source}: damaged: its CRC-32 does not match")


def dims_in(blob: bytes, source: AnyPath) -> Dims:
    """The counts of the hand of a checked blob. Raises AminnError for those of none."""
    found = BODY.unpack_from(blob, HEAD.size)[_DIMS]
    branches, coordinates, joints, _, _, gates, twist, stiff, tendons, slides, told, sensed = found
    dims = Dims(branches, coordinates, joints, tendons, gates, twist > 0, told, stiff, sensed, slides > 0)
    inside = MIN_BRANCHES <= branches <= MAX_BRANCHES and 1 <= coordinates <= MAX_COORDINATES and gates <= branches
    inside = inside and told in (0, stiff + branches) and sensed in (0, dims.sensed) and gates <= tendons
    if not inside or not branches <= joints <= branches * coordinates or found != tuple(header_dims(dims).values()):
        raise AminnError(f"{source}: dimensions {found} are those of no hand")
    return dims


def tau_in(blob: bytes) -> float:
    """The threshold on `p_stable` of a checked blob."""
    return float(BODY.unpack_from(blob, HEAD.size)[_TAU])


def names_in(blob: bytes) -> tuple[str, str, str]:
    """Name of the model, its hand, and what exported it, of a checked blob."""
    name, hand, made_by = (
        text.rstrip(b"\0").decode("ascii", "replace") for text in BODY.unpack_from(blob, HEAD.size)[_NAMES]
    )
    return name, hand, made_by
