"""Checksums inside of files, fields that claim too much, and names that last."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import h5py
import numpy as np
import pytest

from aminn_base.errors import OutdatedError, WriteError
from aminn_base.files import make_folder, write_atomically, write_json
from aminn_base.hdf5 import read_field
from aminn_base.seal import JSON_KEY, check_bytes, check_seal, sealed, sealed_bytes

CONTENT = {"b": [1, 2.5, None], "a": {"x": (1e-17, "é")}, "n": float("nan")}
MARK = b"hash="


def test_a_sealed_file_is_taken_and_a_changed_one_is_not(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", sealed(CONTENT))
    read = json.loads((tmp_path / "a.json").read_text())
    check_seal("a.json", read, "make it again")
    for key, value in (("b", [1, 2.5]), ("a", {}), (JSON_KEY, "0" * 64), ("new", 1)):
        with pytest.raises(OutdatedError, match=r"a\.json: damaged, or changed by hand.*make it again"):
            check_seal("a.json", read | {key: value}, "make it again")


def test_a_file_without_a_seal_is_taken() -> None:
    check_seal("a.json", CONTENT, "")
    check_bytes("a.bin", b"some bytes", MARK, "")


def test_bytes_are_sealed_where_the_mark_says() -> None:
    whole = sealed_bytes(b"before " + MARK + b"0" * 64 + b" after", MARK)
    check_bytes("a.bin", whole, MARK, "")
    for at in (0, len(MARK) + 10, len(whole) - 1):
        with pytest.raises(OutdatedError, match=r"a\.bin: damaged"):
            check_bytes("a.bin", whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :], MARK, "")
    with pytest.raises(OutdatedError, match="damaged"):
        check_bytes("a.bin", whole[:-1], MARK, "")


def test_a_field_may_claim_what_its_file_can_hold_and_no_more(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["small"], file["none"], file["one"] = np.arange(6.0).reshape(2, 3), np.zeros((0, 4)), 3.0
        file.create_dataset("packed", data=np.zeros(100_000), compression="gzip", compression_opts=9)
        file.create_dataset("huge", shape=(2**40,), dtype="f8", chunks=True)
        file.create_dataset("overflow", shape=(2**40, 2**40), dtype="f8", chunks=True)
    size = (tmp_path / "a.h5").stat().st_size
    with h5py.File(tmp_path / "a.h5") as file:
        assert read_field(file["small"], size).tolist() == [[0, 1, 2], [3, 4, 5]]
        assert read_field(file["none"], size).shape == (0, 4) and read_field(file["one"], size) == 3
        assert len(read_field(file["packed"], size)) == 100_000
        for name in ("huge", "overflow"):
            with pytest.raises(ValueError, match=f"/{name} claims .* bytes, and the file has {size}"):
                read_field(file[name], size)


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Folders that were brought to the disk."""
    found: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            found.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return found


def test_every_folder_that_is_made_lasts(tmp_path: Path, synced: list[str]) -> None:
    make_folder(tmp_path / "a" / "b")
    assert set(synced) == {str(tmp_path), str(tmp_path / "a")}
    synced.clear()
    make_folder(tmp_path / "a" / "b")
    assert not synced
    write_atomically(tmp_path / "c" / "file", b"")
    assert set(synced) == {str(tmp_path), str(tmp_path / "c")}


@pytest.mark.parametrize(("error", "refused"), [(errno.EIO, True), (errno.ENOSPC, True), (errno.EINVAL, False)])
def test_a_folder_that_cannot_be_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, refused: bool
) -> None:
    """A disk that fails is told; a file system that knows of no such thing is not."""
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(error, os.strerror(error))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    if refused:
        with pytest.raises(WriteError, match=os.strerror(error)):
            write_atomically(tmp_path / "file", b"new")
    else:
        write_atomically(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"new"
