"""Files with a wrong byte or without their end are refused: samples. All of a binary model: tests/runtime/corrupt.c."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import CARD, CARD_HASH, META, WEIGHTS, load_checkpoint
from aminn_base.errors import AminnError
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


def test_binary_models_in_python(export_dir: Path, trust: dict) -> None:
    whole = (export_dir / "aminn_model.bin").read_bytes()
    tried = 0
    for _, content in damaged(whole, 6, head=384):
        with pytest.raises(AminnError):
            check_blob(content, "model")
        tried += 1
    trust["corrupt_model_bin_tried"] = tried
