"""`aminn_model.c/.h`: the model as constant tables for flash.

Designated initialisers, hexadecimal float literals (exact), no time stamp: the same checkpoint gives the same bytes.
All names start with the prefix, so that several models link into one image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn_base.files import write_atomically
from aminn_base.read import AnyPath
from aminn_hand.hand import STATE, Dims
from aminn_rt.blob import FORMAT_VERSION, header_dims
from aminn_rt.hand_header import counts_of

from .c_names import check_prefix
from .known_answer import answered
from .layout import BINS, NAME_ROOM, OPTIONAL_TABLES, SCALARS, STAGE_SCALARS, VARIED, Layout, Table, default_name
from .packing import KnownAnswer, content_crc
from .tables import STAGES, Exported

_VALUES_PER_LINE = {np.float32: 6, np.float16: 6, np.int8: 18}


def float_literal(value: np.float32 | float) -> str:
    """Exact C99 literal of a finite float32: 0x1.99999ap-4f."""
    v = float(np.float32(value))
    if v == 0:
        return "-0.0f" if np.signbit(v) else "0.0f"
    mantissa, exponent = v.hex().split("p")
    return f"{mantissa.rstrip('0').rstrip('.') if '.' in mantissa else mantissa}p{exponent}f"


def _symbol(prefix: str, table: Table) -> str:
    return "_".join(part for part in (prefix, table.owner, table.field) if part)


def _array(name: str, values: NDArray[Any]) -> str:
    if values.dtype == np.float16:
        kind, words = "uint16_t", [f"0x{v:04x}u" for v in values.view(np.uint16)]
    elif values.dtype == np.int8:
        kind, words = "int8_t", [str(v) for v in values]
    else:
        kind, words = "float", [float_literal(v) for v in values]
    each = _VALUES_PER_LINE[values.dtype.type]
    lines = [", ".join(words[i : i + each]) for i in range(0, len(words), each)]
    return f"static const {kind} {name}[{len(words)}] = {{\n    " + ",\n    ".join(lines) + "};\n"


def _stage(prefix: str, layout: Layout, i: int) -> list[str]:
    lines = [f".{name} = {float_literal(layout.stage_scalars[name][i])}," for name in STAGE_SCALARS]
    tables = [t for t in layout.tables if t.owner == STAGES[i] and t.field != "eps_m"]
    return lines + [f".{t.field} = {_symbol(prefix, t)}," for t in tables]


def _braced(values: NDArray[np.float32]) -> str:
    """An initialiser with the nesting of the array's shape."""
    if not values.ndim:
        return float_literal(float(values))
    return "{" + ", ".join(_braced(v) for v in values) + "}"


def _members(row: NDArray[np.float32], shapes: dict[str, tuple[int, ...]]) -> list[str]:
    """Initialisers of a struct's arrays that stand one behind the other in a row."""
    lines, at = [], 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        lines.append(f".{name} = {_braced(row[at : at + size].reshape(shape))},")
        at += size
    return lines


def _known_answer(name: str, dims: Dims, answer: KnownAnswer) -> str:
    outputs = answer.output.view(np.float32)
    state = _members(answer.state, {field: dims.inputs[field] for field in STATE})
    output = _members(outputs, dims.outputs | {"condition": ()})
    output += [f".stable = {answer.output[-2]}, .notes = {answer.output[-1]}u,"]
    structs = ["{\n        " + "\n        ".join(lines) + "\n    }" for lines in (state, output)]
    return (
        f"static const aminn_known_answer_t {name} = {{\n    .state = {structs[0]},\n    .output = {structs[1]},\n}};\n"
    )


def _bytes(digest: bytes) -> str:
    return "{" + ", ".join(f"0x{byte:02x}" for byte in digest) + "}"


def _model(prefix: str, layout: Layout, answer: KnownAnswer) -> str:
    lines = [f".format_version = {FORMAT_VERSION}u,", f".content_crc = 0x{content_crc(layout, answer):08x}u,"]
    lines += [f".{name} = {value}u," for name, value in header_dims(layout.dims).items()]
    contact, *stages, classifier = (f"{width}u" for width in layout.widths)
    lines += [f".contact_width = {contact},", f".width = {{{', '.join(stages)}}},"]
    lines += [f".classifier_width = {classifier},"]
    lines += [f".dq0 = AMINN_DQ0_{layout.dq0.upper()},", f".weight_type = AMINN_WEIGHTS_{layout.weights.upper()},"]
    lines += [f".stages_crc = 0x{answer.stages_crc:08x}u,"]
    lines += [f".{name} = {float_literal(layout.scalars[name])}," for name in SCALARS]
    lines += [f".{name} = {_braced(layout.bins[name])}," for name in BINS]
    lines += [f".checkpoint_sha256 = {_bytes(layout.sha256)},", f".data_sha256 = {_bytes(layout.data_sha256)},"]
    lines += [f'.{kind} = "{text}",' for kind, text in zip(NAME_ROOM, layout.names, strict=True)]
    lines += [".library = AMINN_LIBRARY,"]
    own = {t.field: _symbol(prefix, t) for t in layout.tables if not t.owner}
    eps_m = ", ".join(_symbol(prefix, t) for t in layout.tables if t.field == "eps_m")
    varied = [f".{member} = {own.get(field, 'NULL')}," for field, member in VARIED.items()]
    varied += [f".eps_m = {{{eps_m}}},"]
    lines += [".nominal = {\n        " + "\n        ".join(varied) + "\n    },"]
    fields = dict.fromkeys(("wrench_log_scale", *OPTIONAL_TABLES, *own))
    lines += [f".{field} = {own.get(field, 'NULL')}," for field in fields if field not in VARIED]
    lines += [f".known_answer = &{prefix}_known_answer,"]
    lines += [f".storage = {'NULL' if layout.weights == 'float32' else f'&aminn_storage_{layout.weights}'},"]
    own_stages = ["{\n        " + "\n        ".join(_stage(prefix, layout, i)) + "\n    }" for i in range(len(STAGES))]
    lines += [".stage = {" + ", ".join(own_stages) + "},"]
    return f"const aminn_model_t {prefix} = {{\n    " + "\n    ".join(lines) + "\n};\n"


def _header(prefix: str, layout: Layout) -> str:
    guard = f"{prefix.upper()}_H"
    other = " || ".join(f"{name} != {count}" for name, count in counts_of(layout.dims).items())
    return f"""\
/* Generated by aminn export from checkpoint {layout.sha256.hex()}. Do not edit. */
#ifndef {guard}
#define {guard}

#include "aminn_rt.h"

#if {other}
#error "this model is for another hand ({layout.names[1]}): compile library and program with its aminn_hand.h"
#endif
#if AMINN_MAX_WIDTH < {max(layout.widths)}
#error "this model needs AMINN_MAX_WIDTH >= {max(layout.widths)}, in the library too"
#endif

#ifdef __cplusplus
extern "C" {{
#endif

extern const aminn_model_t {prefix};

#ifdef __cplusplus
}}
#endif

#endif
"""


def c_model_texts(exported: Exported, prefix: str = "aminn_model") -> tuple[str, str]:
    """(source, header) of a model."""
    check_prefix(prefix)
    layout, answer = answered(exported)
    if "name" not in exported.meta:
        layout = layout._replace(names=(default_name(prefix), *layout.names[1:]))
    first = f"/* Generated by aminn export from checkpoint {layout.sha256.hex()}. Do not edit. */\n"
    arrays = "\n".join(_array(_symbol(prefix, t), t.values) for t in layout.tables)
    arrays += "\n" + _known_answer(f"{prefix}_known_answer", layout.dims, answer)
    source = f'{first}#include "{prefix}.h"\n\n{arrays}\n{_model(prefix, layout, answer)}'
    return source, _header(prefix, layout)


def write_c_model(exported: Exported, out_dir: AnyPath, prefix: str = "aminn_model") -> list[Path]:
    """Write PREFIX.c and PREFIX.h into out_dir; returns their paths. Raises AminnError if the model does not fit."""
    source, header = c_model_texts(exported, prefix)
    paths = [Path(out_dir) / f"{prefix}.c", Path(out_dir) / f"{prefix}.h"]
    for path, text in zip(paths, (source, header), strict=True):
        write_atomically(path, text.encode())
    return paths
