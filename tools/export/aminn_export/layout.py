"""The order of a model's tables, shared by the C source and the binary: name in C, name of the tensor, shape.

Weights are [out][in] in the exported model and [in][out] in C, so that the runtime's product is a sum of contiguous
columns. `docs/model-format.md` has the same list in words, `runtime/src/tables.hpp` in C++.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn.dims import BRANCH_JOINTS, N_AUX, N_BRANCH, N_CONTACT_INPUT, N_COORD, N_GLOBAL_INPUT, N_HEAD, N_WRENCH
from aminn.errors import AminnError

from .tables import STAGES, Exported, pair_of

FORMAT_VERSION = 1
DQ0_CODES = {"statics": 0, "inverse": 1}
SHA256_HEX_DIGITS = 64
SCALARS = ("length_scale", "log_range", "displacement_log_scale", "tau")
STAGE_SCALARS = ("eps_m", "eps_kx", "eps_jq")


class Table(NamedTuple):
    """One table as the runtime stores it."""

    owner: str  # "" for the model's own, else "s1" or "s2"
    field: str  # member of aminn_model_t or aminn_stage_model_t
    values: NDArray[np.float32]  # flat


class Layout(NamedTuple):
    """A checked model in the runtime's order."""

    widths: tuple[int, int, int]  # contact_width, width, classifier_width
    dq0: str
    sha256: bytes
    scalars: dict[str, np.float32]
    stage_scalars: dict[str, tuple[np.float32, np.float32]]
    tables: list[Table]


def stage_shapes(hc: int, h: int) -> dict[str, tuple[int, ...]]:
    """Shapes of a stage's tensors, in the order of the file; weights [out][in]."""
    return {
        "contact_mean": (N_CONTACT_INPUT,),
        "contact_inv_std": (N_CONTACT_INPUT,),
        "global_mean": (N_GLOBAL_INPUT,),
        "global_inv_std": (N_GLOBAL_INPUT,),
        "contact_w": (hc, N_CONTACT_INPUT),
        "contact_b": (hc,),
        "trunk1_w": (h, hc + N_GLOBAL_INPUT),
        "trunk1_b": (h,),
        "trunk2_w": (h, h),
        "trunk2_b": (h,),
        "head_w": (N_HEAD, h),
        "head_b": (N_HEAD,),
    }


SHARED_SHAPES: dict[str, tuple[int, ...]] = {
    "wrench_log_scale": (N_WRENCH,),
    "chol_nom": (N_BRANCH, 6),
    "tendon_dir_nom": (N_BRANCH, N_COORD),
    "tendon_gain_nom": (N_BRANCH,),
    "gate_nom": (3,),
    "coord_mask": (N_BRANCH, N_COORD),
    "geom_base": (N_BRANCH, 3),
    "geom_axis": (N_BRANCH, N_COORD, 3),
    "geom_link_a": (N_BRANCH, 3),
}


def classifier_shapes(h: int, hd: int) -> dict[str, tuple[int, ...]]:
    """Shapes of stage 1's classifier."""
    return {
        "aux_mean": (N_AUX,),
        "aux_inv_std": (N_AUX,),
        "cls1_w": (hd, h + N_AUX),
        "cls1_b": (hd,),
        "cls2_w": (1, hd),
        "cls2_b": (1,),
    }


def tensor_order(hc: int, h: int, hd: int) -> list[tuple[str, str, tuple[int, ...]]]:
    """(owner, name, shape) of every table in file order; owner is "", "s1" or "s2"."""
    order = [("", name, shape) for name, shape in SHARED_SHAPES.items()]
    for stage in STAGES:
        order += [(stage, name, shape) for name, shape in stage_shapes(hc, h).items()]
    return order + [("", name, shape) for name, shape in classifier_shapes(h, hd).items()]


def tensor_name(owner: str, field: str) -> str:
    """Name in `tensors`: stage tables carry the stage, and the classifier belongs to stage 1."""
    if owner:
        return f"{owner}.{field}"
    return field if field in SHARED_SHAPES else f"s1.{field}"


def _table(exported: Exported, owner: str, field: str, shape: tuple[int, ...]) -> Table:
    name = tensor_name(owner, field)
    if name not in exported.tensors:
        raise AminnError(f"model: tensor {name} is missing")
    value = np.asarray(exported.tensors[name])
    if value.shape != shape:
        raise AminnError(f"model: tensor {name} has shape {value.shape}, expected {shape}")
    if value.dtype != np.float32:
        raise AminnError(f"model: tensor {name} is {value.dtype}, expected float32")
    if not np.isfinite(value).all():
        raise AminnError(f"model: tensor {name} holds NaN or infinite values")
    return Table(owner, field, np.ascontiguousarray(value.T if field.endswith("_w") else value).ravel())


def _scalar(meta: dict, name: str) -> np.float32:
    value = np.float32(meta[name])
    if not np.isfinite(value):
        raise AminnError(f"model: {name} is {value}")
    return value


def layout_of(exported: Exported) -> Layout:
    """Check an exported model and put it into the runtime's order. Raises AminnError that names what does not fit."""
    meta = exported.meta
    wanted = (*SCALARS, *STAGE_SCALARS, "contact_width", "width", "classifier_width", "dq0", "checkpoint_sha256")
    missing = [name for name in wanted if name not in meta]
    if missing:
        raise AminnError(f"model: meta lacks {', '.join(missing)}")
    if int(meta.get("format_version", FORMAT_VERSION)) != FORMAT_VERSION:
        raise AminnError(f"model: format_version is {meta['format_version']}, this exporter writes {FORMAT_VERSION}")
    if tuple(map(tuple, meta.get("branch_joints", BRANCH_JOINTS))) != BRANCH_JOINTS:
        raise AminnError(f"model: branch_joints is {meta['branch_joints']}, the runtime knows {BRANCH_JOINTS} alone")
    if meta["dq0"] not in DQ0_CODES:
        raise AminnError(f"model: dq0 is {meta['dq0']!r}, expected one of {', '.join(DQ0_CODES)}")
    sha = str(meta["checkpoint_sha256"])
    if len(sha) != SHA256_HEX_DIGITS or set(sha) - set("0123456789abcdef"):
        raise AminnError(f"model: checkpoint_sha256 is {sha!r}, expected {SHA256_HEX_DIGITS} lower-case hex digits")
    hc, h, hd = (int(meta[name]) for name in ("contact_width", "width", "classifier_width"))
    stage_scalars = {}
    for name in STAGE_SCALARS:
        first, second = pair_of(meta[name])
        stage_scalars[name] = (np.float32(first), np.float32(second))
    return Layout(
        widths=(hc, h, hd),
        dq0=meta["dq0"],
        sha256=bytes.fromhex(sha),
        scalars={name: _scalar(meta, name) for name in SCALARS},
        stage_scalars=stage_scalars,
        tables=[_table(exported, *entry) for entry in tensor_order(hc, h, hd)],
    )
