"""Files with a wrong byte or without their end are refused: samples. All of a binary model: tests/runtime/corrupt.c."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import CARD, CARD_HASH, META, WEIGHTS, load_checkpoint
from aminn.prediction.engines import open_engine
from aminn.prediction.onnx_session import HASH_MARK
from aminn_base.errors import AminnError
from aminn_export.files.bin_model import read_bin_model
from aminn_export.files.hand_header import HAND_HEADER, name_in
from aminn_export.files.onnx_model import read_metadata
from aminn_export.judge.identity import misfits
from aminn_export.judge.verify import evaluate_exact
from aminn_export.samples import vectors
from aminn_export.samples.vectors import read_results, read_vectors, write_results
from aminn_rt.blob import check_blob

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FLIPS = (0x01, 0x80, 0xFF)
MODEL_WORD = range(28, 32)
"""Of a vector file: which model it is of. `verify` compares it."""


def damaged(
    whole: bytes, seed: int, bytes_tried: int = 60, cuts: int = 20, head: int = 0
) -> Iterator[tuple[int, bytes]]:
    """(place, content): each byte of the first `head` and a sample of the others with other values, and cut short."""
    rng = np.random.default_rng(seed)
    places = [*range(head), *rng.integers(head, len(whole), bytes_tried).tolist()]
    for at in places:
        for flip in FLIPS:
            yield at, whole[:at] + bytes([whole[at] ^ flip]) + whole[at + 1 :]
    for at in [0, len(whole) - 1, *rng.integers(0, len(whole), cuts).tolist()]:
        yield at, whole[:at]


def passed(file: Path, read: Callable[[], object], cases: Iterator[tuple[int, bytes]]) -> tuple[list[int], int]:
    """Places whose damage was not refused, and how many cases were tried. `file` is what it was afterwards."""
    whole, silent, tried = file.read_bytes(), [], 0
    try:
        for at, content in cases:
            file.write_bytes(content)
            tried += 1
            try:
                read()
            except AminnError as error:
                assert file.name in str(error) or str(file.parent) in str(error)
            else:
                silent.append(at)
    finally:
        file.write_bytes(whole)
    return silent, tried


def test_vector_files(tmp_path: Path, trust: dict) -> None:
    file = tmp_path / "golden.bin"
    shutil.copy(GOLDEN / "byte_golden.bin", file)
    silent, tried = passed(file, lambda: read_vectors(file), damaged(file.read_bytes(), 1, head=32))
    assert set(silent) == set(MODEL_WORD)
    trust["corrupt_vectors_tried"] = tried


def test_result_files(tmp_path: Path, trust: dict) -> None:
    file = tmp_path / "out.bin"
    write_results(file, np.random.default_rng(2).normal(size=(9, 52)), np.zeros(9, np.int32))
    silent, tried = passed(file, lambda: read_results(file), damaged(file.read_bytes(), 2, head=32))
    assert not silent
    trust["corrupt_results_tried"] = tried


def test_a_reader_without_the_checksum_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same damage, told from the same reader with a defect."""
    file = tmp_path / "golden.bin"
    shutil.copy(GOLDEN / "byte_golden.bin", file)
    crc = vectors.zlib.crc32(file.read_bytes()[32:])
    monkeypatch.setattr(vectors.zlib, "crc32", lambda content: crc)
    silent, _ = passed(file, lambda: read_vectors(file), damaged(file.read_bytes(), 3))
    assert len(silent) > 100


def test_shards(data_dir: Path, tmp_path: Path, trust: dict) -> None:
    shutil.copytree(data_dir, tmp_path / "data")
    file = tmp_path / "data" / "shard-00000.h5"
    silent, tried = passed(file, lambda: load_dataset(tmp_path / "data"), damaged(file.read_bytes(), 4, 20))
    assert not silent
    trust["corrupt_shards_tried"] = tried


@pytest.fixture
def run(checkpoint_dir: Path, tmp_path: Path) -> Path:
    """A checkpoint with the line of its card that names its files."""
    shutil.copytree(checkpoint_dir, tmp_path / "run")
    (tmp_path / "run" / CARD).write_text(f"{CARD_HASH}: {load_checkpoint(tmp_path / 'run').sha256}\n")
    return tmp_path / "run"


@pytest.mark.parametrize("name", [WEIGHTS, META])
def test_checkpoints(run: Path, name: str, trust: dict) -> None:
    file = run / name
    silent, tried = passed(file, lambda: load_checkpoint(run), damaged(file.read_bytes(), 5, 20, 10, head=16))
    assert not silent
    trust[f"corrupt_{file.stem}_{file.suffix[1:]}_tried"] = tried


def test_without_its_card_a_checkpoint_s_numbers_are_what_they_are(run: Path) -> None:
    """What the card is for: the seeded defect of `test_checkpoints`."""
    (run / CARD).unlink()
    silent, _ = passed(run / WEIGHTS, lambda: load_checkpoint(run), damaged((run / WEIGHTS).read_bytes(), 5, 15, 2))
    assert len(silent) > 15


def test_an_unknown_kind_of_model_is_refused_by_its_file(run: Path) -> None:
    """Found by `make fuzz-files`: the message did not say where."""
    (run / META).write_text((run / META).read_text().replace('"kind": "aminn"', '"kind": "forest"'))
    with pytest.raises(AminnError, match=r"model\.json: kind is 'forest', expected aminn or mlp"):
        load_checkpoint(run)


ONNX = (GOLDEN / "aminn.onnx").read_bytes().replace(HASH_MARK, b"x" + HASH_MARK[1:])
"""An ONNX model without a checksum, as one of an earlier export."""
STRANGE = {
    "a value that is not UTF-8": ONNX.replace(b'"finger1_roll"', b'"finger1\xffroll"'),
    "a key that is not UTF-8": ONNX.replace(b"\x0a\x03tau", b"\x0a\x03t\xffu"),
    "an input that is not UTF-8": ONNX.replace(b"x_ht", b"x_h\xff"),
    "no JSON": re.sub(rb"(\x0a\x03tau\x12.)0\.", rb"\1{.", ONNX, flags=re.DOTALL),
    "no tau": ONNX.replace(b"\x0a\x03tau", b"\x0a\x03rho"),
}


@pytest.mark.parametrize("name", STRANGE)
def test_metadata_of_onnx_models(name: str, tmp_path: Path) -> None:
    """Found by `make fuzz-files`: texts that are not UTF-8 and thresholds that are none ended in a traceback."""
    file, content = tmp_path / "strange.onnx", STRANGE[name]
    assert content != ONNX
    file.write_bytes(content)
    with pytest.raises(AminnError, match=rf"^{re.escape(str(file))}: .*export the model again"):
        open_engine(file)
    if name != "no tau" and "input" not in name:
        with pytest.raises(AminnError, match=rf"^{re.escape(str(file))}: .*export the model again"):
            read_metadata(file)


def _named(graph: onnx.GraphProto, old: str, new: str) -> None:
    """What nodes call `old` has another name."""
    for node in graph.node:
        for names in (node.input, node.output):
            names[:] = [new if name == old else name for name in names]


def _last(graph: onnx.GraphProto, name: str, kind: str, *more: str, **attributes: object) -> onnx.ValueInfoProto:
    """A further node makes the output `name` of what it was."""
    _named(graph, name, f"own_{name}")
    graph.node.append(helper.make_node(kind, [f"own_{name}", *more], [name], **attributes))
    return _value(graph.output, name)


def _value(values: Iterable[onnx.ValueInfoProto], name: str) -> onnx.ValueInfoProto:
    return next(value for value in values if value.name == name)


def _without(graph: onnx.GraphProto) -> None:
    graph.output.remove(_value(graph.output, "k_x"))


def _renamed(graph: onnx.GraphProto) -> None:
    _named(graph, "p_slide", "p_slip")
    _value(graph.output, "p_slide").name = "p_slip"


def _of_another_type(graph: onnx.GraphProto) -> None:
    output = _last(graph, "dx_ht", "Cast", to=TensorProto.DOUBLE)
    output.type.tensor_type.elem_type = TensorProto.DOUBLE


def _of_another_shape(graph: onnx.GraphProto) -> None:
    graph.initializer.append(numpy_helper.from_array(np.array([1]), "behind"))
    _last(graph, "p_stable", "Unsqueeze", "behind")


def _one_row(graph: onnx.GraphProto) -> None:
    for value in (*graph.input, *graph.output):
        value.type.tensor_type.shape.dim[0].dim_value = 1


def _another_input(graph: onnx.GraphProto) -> None:
    _named(graph, "w_e", "load")
    _value(graph.input, "w_e").name = "load"


def _a_further_input(graph: onnx.GraphProto) -> None:
    graph.input.append(helper.make_tensor_value_info("time", TensorProto.FLOAT, ["N"]))


OTHER_GRAPHS: dict[str, tuple[Callable[[onnx.GraphProto], None], str]] = {
    "an output less": (_without, "its graph has no output k_x"),
    "an output of another name": (_renamed, "its graph has no output p_slide"),
    "an output of another type": (_of_another_type, r"its output dx_ht is tensor\(double\), not tensor\(float\)"),
    "an output of another shape": (_of_another_shape, r"its output p_stable has the shape \(N, 1\), not \(N\)"),
    "one row alone": (_one_row, r"its input q has the shape \(1, 8\), not \(N, 8\)"),
    "an input of another name": (_another_input, "its graph has no input w_e"),
    "an input more": (_a_further_input, "its graph needs an input time, which no model has"),
}


@pytest.mark.parametrize("name", OTHER_GRAPHS)
def test_graphs_that_are_not_written_here(name: str, tmp_path: Path) -> None:
    """All but another type ended in an exception of Python's, NumPy's or ONNX Runtime's once the model predicted."""
    change, message = OTHER_GRAPHS[name]
    model = onnx.load_model_from_string(ONNX)
    change(model.graph)
    file = tmp_path / "aminn.onnx"
    file.write_bytes(model.SerializeToString())
    line = rf"^{re.escape(str(file))}: {message}; export the model again$"
    with pytest.raises(AminnError, match=line):
        open_engine(file)
    golden = read_vectors(GOLDEN / "golden.bin").inputs
    with pytest.raises(AminnError, match=line):
        evaluate_exact(tmp_path, read_bin_model(GOLDEN / "aminn_model.bin"), golden)


def test_further_outputs_pass() -> None:
    """Those of `aminn_debug.onnx`."""
    assert open_engine(GOLDEN / "aminn_debug.onnx").hand.name == open_engine(GOLDEN / "aminn.onnx").hand.name


def test_onnx_models_by_verify(tmp_path: Path) -> None:
    """The comparison with the binary model reads the same texts."""
    for name in ("aminn_model.bin", "aminn_model.c", "aminn_model.h"):
        shutil.copy(GOLDEN / name, tmp_path)
    model = read_bin_model(tmp_path / "aminn_model.bin")
    (tmp_path / "aminn.onnx").write_bytes(ONNX)
    assert misfits(tmp_path, "aminn_model", model) == []
    (tmp_path / "aminn.onnx").write_bytes(STRANGE["a key that is not UTF-8"])
    with pytest.raises(AminnError, match=r"aminn\.onnx: its metadata are no JSON texts"):
        misfits(tmp_path, "aminn_model", model)


def test_a_hand_header_of_another_encoding(tmp_path: Path) -> None:
    header = tmp_path / HAND_HEADER
    header.write_bytes(b'#define AMINN_HAND_NAME "gr\xe9iffer"\n')
    with pytest.raises(AminnError, match=rf"{HAND_HEADER}: not UTF-8 text"):
        name_in(header)


def test_binary_models_in_python(export_dir: Path, trust: dict) -> None:
    whole = (export_dir / "aminn_model.bin").read_bytes()
    tried = 0
    for _, content in damaged(whole, 6, head=384):
        with pytest.raises(AminnError):
            check_blob(content, "model")
        tried += 1
    trust["corrupt_model_bin_tried"] = tried
