"""Do the files of an export folder belong together? Each holds the model in its own form; no number may differ.

A replay cannot tell everything: a weight of a unit that no sample wakes has no influence, and the closure's geometry
none on samples that bring their Jacobians.
"""

from __future__ import annotations

import json
import re
from itertools import zip_longest
from pathlib import Path

import numpy as np
from onnx import numpy_helper

from aminn.data.dataset import Dataset
from aminn.model.export_tables import geometry_tables
from aminn.prediction.onnx_session import check_onnx
from aminn_base.errors import AminnError
from aminn_base.read import read_bytes
from aminn_rt.compiled import runtime, runtime_for

from ..files.bin_model import BinModel, model_crc
from ..files.c_model import c_model_texts
from ..files.hand_header import HAND_HEADER, fits, header_beside, name_in
from ..files.onnx_model import DEBUG_FILE, ONNX_FILE, build_onnx, metadata_in, onnx_metadata, parsed
from ..files.tables import dims_of
from ..samples.golden import GOLDEN_FILE
from ..samples.vectors import read_vectors

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_TOKEN = re.compile(r"\w[\w.+-]*|\S")


def check_model_hand(model: BinModel, dataset: Dataset, source: Path) -> None:
    """Raises AminnError where the data set in `source` is of a hand of another geometry than the model's."""
    tables = geometry_tables(dataset.hand) | {"coord_mask": dataset.hand.coordinate_mask}
    for table, other in tables.items():
        mine, name = model.tensors[table], table.removeprefix("geom_")
        same = np.size(mine) == np.size(other)
        if not same or not np.allclose(np.reshape(mine, np.shape(other)), other, rtol=1e-5, atol=1e-7):
            raise AminnError(f"{source}: of another hand than the model (they differ in {name}); give data of its hand")


def _tokens(text: str) -> list[str]:
    """The words of a C file without comments and layout."""
    return _TOKEN.findall(_COMMENT.sub(" ", text))


def _c_difference(found: str, wanted: str) -> str | None:
    """What the first difference of two C files lies in, or None."""
    last = ""
    for a, b in zip_longest(_tokens(found), _tokens(wanted), fillvalue="the end"):
        if a != b:
            return f"{last}: {a} instead of {b}" if last else f"{a} instead of {b}"
        if re.match(r"[A-Za-z_]\w*$", b):
            last = b
    return None


def _single(value: object) -> object:
    """A number of the metadata as the binary model has it, in single precision."""
    if isinstance(value, list):
        return [_single(v) for v in value]
    return float(np.float32(value)) if isinstance(value, float) else value


def _onnx_difference(file: Path, model: BinModel, debug: bool) -> str | None:
    content = read_bytes(file)
    check_onnx(file, content)
    found = parsed(file, content)
    metadata = metadata_in(file, found)
    for key, value in onnx_metadata(model.meta).items():
        if key not in metadata:
            return f"its metadata lacks {key}"
        if _single(json.loads(metadata[key])) != _single(json.loads(value)):
            return f"its metadata has {key} {metadata[key]}, the binary model {value}"
    # constants of the graph were made in double precision, from what its metadata says
    own_meta = {"length_scale" if k == "length_scale_m" else k: json.loads(metadata[k]) for k in metadata}
    same = BinModel(model.meta | {k: v for k, v in own_meta.items() if k in model.meta}, model.tensors)
    wanted = {t.name: numpy_helper.to_array(t) for t in build_onnx(same, debug).graph.initializer}
    try:
        own = {t.name: numpy_helper.to_array(t) for t in found.graph.initializer}
    except (ValueError, TypeError) as error:  # names that are not UTF-8, numbers that are too few
        raise AminnError(f"{file}: its constants cannot be read ({error}); export the model again") from error
    if set(own) != set(wanted):
        return "its constants have other names: it was written by another version"
    for name, array in wanted.items():
        if own[name].shape != array.shape or own[name].tobytes() != array.tobytes():
            return f"its constant {name} is another"
    return None


def misfits(export_dir: Path, prefix: str, model: BinModel) -> list[str]:
    """A line for each file that does not hold `model`, which is that of PREFIX.bin.

    Raises AminnError on a damaged file, OSError on a missing one.
    """
    lines = []
    status = runtime_for(dims_of(model)).self_test((export_dir / f"{prefix}.bin").read_bytes())
    if status:
        lines.append(f"{prefix}.bin fails its self-test: {runtime().status_text(status)}")
    for name, wanted in zip((f"{prefix}.c", f"{prefix}.h"), c_model_texts(model, prefix), strict=True):
        difference = _c_difference((export_dir / name).read_text(errors="replace"), wanted)
        if difference:
            lines.append(f"{name} is not {prefix}.bin: {difference}")
    header = header_beside(export_dir)
    if header is not None and not fits(header, dims_of(model)):
        lines.append(f"{HAND_HEADER} is not of {prefix}.bin's hand, but of {name_in(header)}")
    for name, debug in ((ONNX_FILE, False), (DEBUG_FILE, True)):
        file = export_dir / name
        difference = _onnx_difference(file, model, debug) if file.is_file() else None
        if difference:
            lines.append(f"{name} is not {prefix}.bin: {difference}")
    golden = export_dir / GOLDEN_FILE
    crc = read_vectors(golden).model if golden.is_file() else 0
    if crc and crc != model_crc(model):
        lines.append(
            f"{GOLDEN_FILE} is of another model than {prefix}.bin: content_crc {crc:08x}, not {model_crc(model):08x}"
        )
    return lines
