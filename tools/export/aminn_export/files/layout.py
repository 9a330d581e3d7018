"""The order of a model's tables, shared by the C source and the binary: name in C, name of the tensor, shape.

Weights are [out][in] in the exported model and [in][out] in C, so that the runtime's product is a sum of contiguous
rows. The mechanics head's outputs are [branch][output] in the exported model and [output][branch] in C, in HEAD_ORDER,
so that the runtime's functions run over whole arrays. `docs/model-format.md` has the same list in words,
`runtime/src/tables.hpp` in C++.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn.hand.dims import (
    BRANCH_JOINTS,
    N_AUX,
    N_BRANCH,
    N_BRANCH_HEAD,
    N_CONTACT_FEATURE,
    N_CONTACT_INPUT,
    N_COORD,
    N_GLOBAL_INPUT,
    N_HEAD,
    N_JOINT,
    N_WRENCH,
)
from aminn_base.errors import AminnError

from .tables import STAGES, Exported, pair_of

FORMAT_VERSION = 6
"""Of the C model and the binary (AMINN_FORMAT_VERSION in aminn_rt.h)."""
TABLES_VERSION = 1
"""Of the tables that the trainer gives."""
DQ0_CODES = {"statics": 0, "inverse": 1}
SHA256_HEX_DIGITS = 64
NAME_ROOM = {"name": 56, "hand": 56, "made_by": 40}
"""Bytes that a name has in the binary, with the zero behind it."""
UNKNOWN = "unknown"
WEIGHT_CODES = {"float32": 0, "float16": 1}
WEIGHT_TYPES: dict[str, type[np.floating]] = {"float32": np.float32, "float16": np.float16}
N_STATE = N_JOINT + 2 * N_WRENCH + N_BRANCH * N_CONTACT_FEATURE
# Outputs of the mechanics head in C, as places in a branch's row of the exported model (Cholesky diagonal 0-2, entries
# 10 20 21 at 3-5, direction 6-8, gain 9, alpha 10, beta 11, rho 12): what tanh and exp are applied to stands first.
HEAD_ORDER = (0, 1, 2, 9, 10, 3, 4, 5, 6, 7, 8, 11, 12)
N_HEAD_STORED = -(-N_HEAD // 8) * 8
"""With the zeros behind them (AMINN_N_HEAD_STORED)."""
SCALARS = ("length_scale", "log_range", "displacement_log_scale", "tau")
STAGE_SCALARS = ("eps_m", "eps_kx", "eps_jq")


class Table(NamedTuple):
    """One table as the runtime stores it."""

    owner: str  # "" for the model's own, else "s1" or "s2"
    field: str  # member of aminn_model_t or aminn_stage_model_t
    values: NDArray[np.floating]  # flat; float32, or float16 in a weight table of a model with such weights


class Layout(NamedTuple):
    """A checked model in the runtime's order."""

    widths: tuple[int, int, int]  # contact_width, width, classifier_width
    dq0: str
    weights: str  # "float32" or "float16"
    sha256: bytes  # of the checkpoint
    data_sha256: bytes  # of the data set's configuration; zeros: not known
    names: tuple[str, str, str]  # name, hand, made by
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
    "range_min": (N_STATE,),
    "range_max": (N_STATE,),
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


def head_rows() -> NDArray[np.int64]:
    """Row of the exported head that each of C's N_HEAD outputs comes from."""
    return np.array([N_BRANCH_HEAD * b + place for place in HEAD_ORDER for b in range(N_BRANCH)])


def stored_shape(field: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of a table in C, weights [out][in]: the exported tensor's, with the zeros behind the head's outputs."""
    return (N_HEAD_STORED, *shape[1:]) if field.startswith("head_") else shape


def is_weight(field: str) -> bool:
    """Whether a table holds weights, which may be float16."""
    return field.endswith("_w")


def _stored(field: str, value: NDArray[np.float32], weights: str) -> NDArray[np.floating]:
    """A table's values in the order and type of C."""
    if field.startswith("head_"):
        value = np.concatenate([value[head_rows()], np.zeros((N_HEAD_STORED - N_HEAD, *value.shape[1:]), np.float32)])
    if not is_weight(field):
        return np.ascontiguousarray(value).ravel()
    stored = np.ascontiguousarray(value.T, WEIGHT_TYPES[weights]).ravel()
    if weights != "float32" and not np.array_equal(stored.astype(np.float32), value.T.ravel()):
        raise AminnError(
            f"model: {field} is not representable in {weights}; round it first (aminn_export.judge.weights)"
        )
    return stored


def restored(field: str, flat: NDArray[np.floating], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The inverse of `_stored`: a tensor of the exported model, from a table and its `stored_shape`."""
    value = flat.reshape(shape[::-1]).T if is_weight(field) else flat.reshape(shape)
    if field.startswith("head_"):
        value = value[np.argsort(head_rows())]
    return np.array(value, np.float32, order="C")


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
    return Table(owner, field, _stored(field, value, weights_of(exported.meta)))


def weights_of(meta: dict) -> str:
    """Type of the weights in flash. Raises AminnError for one that the runtime does not know."""
    weights = meta.get("weights", "float32")
    if weights not in WEIGHT_CODES:
        raise AminnError(f"model: weights is {weights!r}, expected one of {', '.join(WEIGHT_CODES)}")
    return str(weights)


def _scalar(meta: dict, name: str) -> np.float32:
    value = np.float32(meta[name])
    if not np.isfinite(value):
        raise AminnError(f"model: {name} is {value}")
    return value


def _digest(meta: dict, name: str) -> bytes:
    """A SHA-256 of the meta data; zeros for none."""
    sha = str(meta.get(name, "0" * SHA256_HEX_DIGITS))
    if len(sha) != SHA256_HEX_DIGITS or set(sha) - set("0123456789abcdef"):
        raise AminnError(f"model: {name} is {sha!r}, expected {SHA256_HEX_DIGITS} lower-case hex digits")
    return bytes.fromhex(sha)


def checked_name(kind: str, text: str) -> str:
    """A name that the model carries. Raises AminnError unless it is printable ASCII and fits."""
    if not text or not text.isascii() or not text.isprintable() or set(text) & set('"\\?'):
        raise AminnError(f"model: {kind} {text!r} is not of printable ASCII characters without quotes, \\ and ?")
    if len(text) >= NAME_ROOM[kind]:
        raise AminnError(f"model: {kind} {text!r} has {len(text)} characters, at most {NAME_ROOM[kind] - 1} fit")
    return text


def default_name(prefix: str) -> str:
    """Of a model that was given none."""
    return prefix[: NAME_ROOM["name"] - 1]


def layout_of(exported: Exported) -> Layout:
    """Check an exported model and put it into the runtime's order. Raises AminnError that names what does not fit."""
    meta = exported.meta
    wanted = (*SCALARS, *STAGE_SCALARS, "contact_width", "width", "classifier_width", "dq0", "checkpoint_sha256")
    missing = [name for name in wanted if name not in meta]
    if missing:
        raise AminnError(f"model: meta lacks {', '.join(missing)}")
    if int(meta.get("format_version", TABLES_VERSION)) != TABLES_VERSION:
        raise AminnError(f"model: format_version is {meta['format_version']}, this exporter knows {TABLES_VERSION}")
    if tuple(map(tuple, meta.get("branch_joints", BRANCH_JOINTS))) != BRANCH_JOINTS:
        raise AminnError(f"model: branch_joints is {meta['branch_joints']}, the runtime knows {BRANCH_JOINTS} alone")
    if meta["dq0"] not in DQ0_CODES:
        raise AminnError(f"model: dq0 is {meta['dq0']!r}, expected one of {', '.join(DQ0_CODES)}")
    names = {"name": "aminn_model", "hand": UNKNOWN, "made_by": UNKNOWN}
    carried = tuple(checked_name(kind, str(meta.get(kind, default))) for kind, default in names.items())
    hc, h, hd = (int(meta[name]) for name in ("contact_width", "width", "classifier_width"))
    stage_scalars = {}
    for name in STAGE_SCALARS:
        first, second = pair_of(meta[name])
        stage_scalars[name] = (np.float32(first), np.float32(second))
    return Layout(
        widths=(hc, h, hd),
        dq0=meta["dq0"],
        weights=weights_of(meta),
        sha256=_digest(meta, "checkpoint_sha256"),
        data_sha256=_digest(meta, "data_sha256"),
        names=(carried[0], carried[1], carried[2]),
        scalars={name: _scalar(meta, name) for name in SCALARS},
        stage_scalars=stage_scalars,
        tables=[_table(exported, *entry) for entry in tensor_order(hc, h, hd)],
    )
