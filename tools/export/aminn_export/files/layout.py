"""The order of a model's tables, shared by the C source and the binary: name in C, name of the tensor, shape.

Weights are [out][in] in the exported model and [in][out] in C, so that the runtime's product is a sum of contiguous
rows. The mechanics head's outputs are [branch][output] in the exported model and [output][branch] in C, in the order of
`head_order`, so that the runtime's functions run over whole arrays. `docs/model-format.md` has the same list in words,
`runtime/src/tables.hpp` in C++.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import N_GATE, N_WRENCH, Dims

from .head import head_order
from .tables import STAGES, Exported, dims_of, pair_of

TABLES_VERSION = 1
"""Of the tables that the trainer gives."""
DQ0_CODES = {"statics": 0, "inverse": 1}
SHA256_HEX_DIGITS = 64
NAME_ROOM = {"name": 56, "hand": 56, "made_by": 40}
"""Bytes that a name has in the binary, with the zero behind it."""
UNKNOWN = "unknown"
WEIGHT_CODES = {"float32": 0, "float16": 1, "int8": 2}
WEIGHT_TYPES: dict[str, type[np.number]] = {"float32": np.float32, "float16": np.float16, "int8": np.int8}
SCALARS = (
    *("length_scale", "log_range", "displacement_log_scale", "tau"),
    *("friction_nominal", "max_translation", "max_rotation"),
)
BINS = {"bound_edge": 3, "bound_factor": 4}
"""Of p_slide, where they end, and the factor that the bound of the error has in each."""
STAGE_SCALARS = ("eps_kx", "eps_jq")
OPTIONAL_TABLES = ("tendon_dir_nom", "gate_nom")
"""Of hands with gates."""
TOLD_TABLE = "told_nom"
"""Of a told model: factors of the nominal hand, which the runtime sees without a calibration; zeros."""
VARIED = {"chol_nom": "chol", "tendon_gain_nom": "tendon_gain", "twist_nom": "twist", TOLD_TABLE: "told"}
"""Tables that theta changes, and what they are called in `aminn_varied_t`; all but the first may be left out."""


class Table(NamedTuple):
    """One table as the runtime stores it."""

    owner: str  # "" for the model's own, else "s1" or "s2"
    field: str  # member of aminn_model_t or aminn_stage_model_t
    values: NDArray[Any]  # flat; float32, or in a weight table what the model's weights are


class Widths(NamedTuple):
    """Of a model's layers, in the order of the file."""

    contact: int
    stage1: int
    stage2: int
    classifier: int

    @property
    def trunks(self) -> tuple[int, int]:
        """Of stage 1 and stage 2."""
        return self.stage1, self.stage2


class Layout(NamedTuple):
    """A checked model in the runtime's order."""

    dims: Dims  # of the hand
    widths: Widths
    dq0: str
    weights: str  # "float32", "float16" or "int8"
    sha256: bytes  # of the checkpoint
    data_sha256: bytes  # of the data set's configuration; zeros: not known
    names: tuple[str, str, str]  # name, hand, made by
    scalars: dict[str, np.float32]
    bins: dict[str, NDArray[np.float32]]
    stage_scalars: dict[str, tuple[np.float32, np.float32]]
    tables: list[Table]


def widths_of(meta: dict) -> Widths:
    """Of an exported model's meta."""
    stage1, stage2 = pair_of(meta["width"])
    return Widths(int(meta["contact_width"]), int(stage1), int(stage2), int(meta["classifier_width"]))


def stage_shapes(dims: Dims, hc: int, h: int) -> dict[str, tuple[int, ...]]:
    """Shapes of a stage's tensors, in the order of the file; weights [out][in]."""
    return {
        "eps_m": (dims.branches,),
        "contact_mean": (dims.contact_input,),
        "contact_inv_std": (dims.contact_input,),
        "global_mean": (dims.global_input,),
        "global_inv_std": (dims.global_input,),
        "contact_w": (hc, dims.contact_input),
        "contact_b": (hc,),
        "trunk1_w": (h, hc + dims.global_input),
        "trunk1_b": (h,),
        "trunk2_w": (h, h),
        "trunk2_b": (h,),
        "head_w": (dims.head, h),
        "head_b": (dims.head,),
    }


def shared_shapes(dims: Dims) -> dict[str, tuple[int, ...]]:
    """Shapes of what both stages share; without gates the tendons are left out."""
    b, c = dims.branches, dims.coordinates
    tendons: dict[str, tuple[int, ...]] = {"tendon_dir_nom": (b, c), "tendon_gain_nom": (b,), "gate_nom": (N_GATE,)}
    return {
        "wrench_log_scale": (N_WRENCH,),
        "chol_nom": (b, dims.cholesky),
        **(tendons if dims.gates else {}),
        **({"twist_nom": (b,)} if dims.twist else {}),
        **({TOLD_TABLE: (dims.factors,)} if dims.factors else {}),
        "theta_terms": (1 + dims.stiff, b, dims.cholesky + 1),
        "coord_mask": (b, c),
        "geom_axis": (b, c, 3),
        "geom_anchor": (b, c, 3),
        "range_min": (dims.state,),
        "range_max": (dims.state,),
    }


def classifier_shapes(dims: Dims, h: int, hd: int) -> dict[str, tuple[int, ...]]:
    """Shapes of stage 1's classifier."""
    return {
        "aux_mean": (dims.aux,),
        "aux_inv_std": (dims.aux,),
        "cls1_w": (hd, h + dims.aux),
        "cls1_b": (hd,),
        "cls2_w": (1, hd),
        "cls2_b": (1,),
    }


def sure_shapes(dims: Dims, h: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what says how sure stage 2 is: logit of p_slide, logarithm of the error's bound."""
    return {"sure_mean": (dims.sure,), "sure_inv_std": (dims.sure,), "sure_w": (2, h + dims.sure), "sure_b": (2,)}


def tensor_order(dims: Dims, widths: Widths) -> list[tuple[str, str, tuple[int, ...]]]:
    """(owner, name, shape) of every table in file order; owner is "", "s1" or "s2"."""
    order = [("", name, shape) for name, shape in shared_shapes(dims).items()]
    for stage, width in zip(STAGES, widths.trunks, strict=True):
        order += [(stage, name, shape) for name, shape in stage_shapes(dims, widths.contact, width).items()]
    last = classifier_shapes(dims, widths.stage1, widths.classifier) | sure_shapes(dims, widths.stage2)
    return order + [("", name, shape) for name, shape in last.items()]


def tensor_name(owner: str, field: str) -> str:
    """Name in `tensors`: stage tables carry the stage, the classifier's are of stage 1, how sure it is of stage 2."""
    if owner:
        return f"{owner}.{field}"
    if field.startswith("sure_"):
        return f"s2.{field}"
    return f"s1.{field}" if field.startswith(("aux_", "cls")) else field


def head_rows(dims: Dims) -> NDArray[np.int64]:
    """Row of the exported head that each of C's outputs comes from."""
    return np.array([dims.branch_head * b + place for place in head_order(dims) for b in range(dims.branches)])


def head_stored(dims: Dims) -> int:
    """Outputs of the head in C, with the zeros behind them (AMINN_N_HEAD_STORED)."""
    return -(-dims.head // 8) * 8


def stored_shape(dims: Dims, field: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of a table in C, weights [out][in]: the exported tensor's, with the zeros behind the head's outputs."""
    return (head_stored(dims), *shape[1:]) if field.startswith("head_") else shape


def is_weight(field: str) -> bool:
    """Whether a table holds weights, which may be float16 or int8."""
    return field.endswith("_w")


def has_steps(field: str, weights: str) -> bool:
    """Whether behind the numbers of a table are as many sizes of steps: biases of a model with int8 weights."""
    return field.endswith("_b") and weights == "int8"


def weights_of_biases(field: str) -> str:
    """The table whose outputs have these biases."""
    return f"{field[:-2]}_w"


def stored_type(field: str, weights: str) -> type[np.generic]:
    """Type of a table's numbers in C."""
    return WEIGHT_TYPES[weights] if is_weight(field) else np.float32


MOST_STEPS = 127
STEP_DIGITS = 17
"""Binary digits of a step's size, so that any number of steps is a float32."""


def step_sizes(value: NDArray[np.float32]) -> NDArray[np.float32]:
    """Size (out) of the steps of which int8 weights [out][in] are numbers: an output's largest weight is 127 of them.

    1 where all of its weights are zero, or so small that as a float32 the size would be subnormal.
    """
    digits, exponent = np.frexp(np.abs(value.astype(np.float64)).max(1, initial=0.0) / MOST_STEPS)
    size = np.ldexp(np.rint(np.ldexp(digits, STEP_DIGITS)), exponent - STEP_DIGITS)
    return np.where(size >= np.finfo(np.float32).tiny, size, 1.0).astype(np.float32)


def in_steps(value: NDArray[np.float32]) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """int8 weights [out][in], rounded to nearest, ties to even, and the size of each output's steps."""
    size = step_sizes(value)
    return np.rint(value.astype(np.float64) / size[:, None]).astype(np.int8), size


def of_steps(steps: NDArray[np.int8], size: NDArray[np.float32]) -> NDArray[np.float32]:
    """The weights that these are; exact for sizes of `step_sizes`."""
    return steps.astype(np.float32) * size[:, None]


def _in_order(dims: Dims, field: str, value: NDArray[Any]) -> NDArray[Any]:
    """A tensor's outputs in C's order; behind the head's are zeros."""
    if not field.startswith("head_"):
        return value
    zeros = np.zeros((head_stored(dims) - dims.head, *value.shape[1:]), np.float32)
    return np.concatenate([value[head_rows(dims)], zeros])


def _stored(dims: Dims, field: str, value: NDArray[Any], weights: str) -> NDArray[Any]:
    """A table's values in the order and type of C."""
    value = _in_order(dims, field, value)
    if not is_weight(field):
        return np.ascontiguousarray(value).ravel()
    stored = in_steps(value)[0] if weights == "int8" else value.astype(WEIGHT_TYPES[weights])
    same = of_steps(stored, step_sizes(value)) if weights == "int8" else stored.astype(np.float32)
    if weights != "float32" and not np.array_equal(same, value):
        raise AminnError(
            f"model: {field} is not representable in {weights}; round it first (aminn_export.judge.weights)"
        )
    return np.ascontiguousarray(stored.T).ravel()


def restored(dims: Dims, field: str, flat: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """The inverse of `_stored`: a tensor of the exported model, from a table and its `stored_shape`."""
    value = flat.reshape(shape[::-1]).T if is_weight(field) else flat.reshape(shape)
    if field.startswith("head_"):
        value = value[np.argsort(head_rows(dims))]
    return np.array(value, stored_type(field, "float32"), order="C")


def _table(exported: Exported, dims: Dims, owner: str, field: str, shape: tuple[int, ...]) -> Table:
    name = tensor_name(owner, field)
    if name == TOLD_TABLE:
        return Table(owner, field, np.zeros(shape, np.float32))
    if name not in exported.tensors:
        raise AminnError(f"model: tensor {name} is missing")
    value = np.asarray(exported.tensors[name])
    if value.shape != shape:
        raise AminnError(f"model: tensor {name} has shape {value.shape}, expected {shape}")
    expected = np.dtype(stored_type(field, "float32"))
    if value.dtype != expected:
        raise AminnError(f"model: tensor {name} is {value.dtype}, expected {expected}")
    if not np.isfinite(value).all():
        raise AminnError(f"model: tensor {name} holds NaN or infinite values")
    weights = weights_of(exported.meta)
    stored = _stored(dims, field, value, weights)
    if has_steps(field, weights):
        of = weights_of_biases(field)
        sizes = step_sizes(_in_order(dims, of, np.asarray(exported.tensors[tensor_name(owner, of)])))
        stored = np.concatenate([stored, sizes])
    return Table(owner, field, stored)


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


def _bins(meta: dict) -> dict[str, NDArray[np.float32]]:
    """`BINS` of the meta data. Raises AminnError unless edges ascend within 0 to 1 and factors are positive."""
    found = {name: np.asarray(meta[name], np.float32) for name in BINS}
    for name, values in found.items():
        if values.shape != (BINS[name],) or not np.isfinite(values).all():
            raise AminnError(f"model: {name} is {meta[name]}, expected {BINS[name]} finite numbers")
    edges, factors = found["bound_edge"], found["bound_factor"]
    if edges.min() < 0 or edges.max() > 1 or (np.diff(edges) < 0).any():
        raise AminnError(f"model: bound_edge is {meta['bound_edge']}, expected ascending numbers from 0 to 1")
    if factors.min() <= 0:
        raise AminnError(f"model: bound_factor is {meta['bound_factor']}, expected positive numbers")
    return found


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
    wanted = (*SCALARS, *BINS, *STAGE_SCALARS, "contact_width", "width", "classifier_width", "dq0", "checkpoint_sha256")
    missing = [name for name in wanted if name not in meta]
    if missing:
        raise AminnError(f"model: meta lacks {', '.join(missing)}")
    if int(meta.get("format_version", TABLES_VERSION)) != TABLES_VERSION:
        raise AminnError(f"model: format_version is {meta['format_version']}, this exporter knows {TABLES_VERSION}")
    dims = dims_of(exported)
    if meta["dq0"] not in DQ0_CODES:
        raise AminnError(f"model: dq0 is {meta['dq0']!r}, expected one of {', '.join(DQ0_CODES)}")
    names = {"name": "aminn_model", "hand": UNKNOWN, "made_by": UNKNOWN}
    carried = tuple(checked_name(kind, str(meta.get(kind, default))) for kind, default in names.items())
    widths = widths_of(meta)
    stage_scalars = {}
    for name in STAGE_SCALARS:
        first, second = pair_of(meta[name])
        stage_scalars[name] = (np.float32(first), np.float32(second))
    return Layout(
        dims=dims,
        widths=widths,
        dq0=meta["dq0"],
        weights=weights_of(meta),
        sha256=_digest(meta, "checkpoint_sha256"),
        data_sha256=_digest(meta, "data_sha256"),
        names=(carried[0], carried[1], carried[2]),
        scalars={name: _scalar(meta, name) for name in SCALARS},
        bins=_bins(meta),
        stage_scalars=stage_scalars,
        tables=[_table(exported, dims, *entry) for entry in tensor_order(dims, widths)],
    )
