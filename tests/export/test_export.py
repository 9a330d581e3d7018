"""`aminn export` as a whole: complete, repeatable, and nothing half-written."""

from __future__ import annotations

from pathlib import Path

import pytest

from aminn.checkpoint import load_checkpoint
from aminn.errors import AminnError
from aminn_export.export import export
from aminn_export.onnx_model import read_metadata

FILES = {"aminn.onnx", "aminn_debug.onnx", "left.c", "left.h", "left.bin", "golden.bin"}


def _names(folder: Path) -> set[str]:
    return {f.name for f in folder.iterdir()}


def test_export_writes_everything_twice_the_same(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    lines = export(checkpoint_dir, tmp_path / "a" / "one", "left", data_dir)
    export(checkpoint_dir, tmp_path / "two", "left", data_dir)
    assert _names(tmp_path / "a" / "one") == FILES
    assert _names(tmp_path / "a") == {"one"}
    assert len(lines) == len(FILES)
    for name in FILES:
        assert (tmp_path / "a" / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert read_metadata(tmp_path / "two" / "aminn.onnx")["checkpoint_sha256"] == load_checkpoint(checkpoint_dir).sha256


def test_other_files_in_the_folder_stay(checkpoint_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    export(checkpoint_dir, tmp_path)
    assert _names(tmp_path) == {
        "notes.txt",
        "aminn.onnx",
        "aminn_debug.onnx",
        "aminn_model.c",
        "aminn_model.h",
        "aminn_model.bin",
    }


@pytest.mark.parametrize(
    "prefix", ["2fast", "a-b", "", "int", "namespace", "aminn_predict", "AMINN_OK", "aminn_model_t"]
)
def test_bad_prefix_leaves_nothing(checkpoint_dir: Path, tmp_path: Path, prefix: str) -> None:
    with pytest.raises(AminnError, match="prefix"):
        export(checkpoint_dir, tmp_path / "out", prefix)
    assert _names(tmp_path) == set()


def test_missing_inputs_leave_nothing(checkpoint_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(AminnError, match="missing"):
        export(tmp_path / "none", tmp_path / "out")
    with pytest.raises(AminnError, match=r"manifest\.json"):
        export(checkpoint_dir, tmp_path / "out", data_dir=tmp_path)
    assert _names(tmp_path) == set()
