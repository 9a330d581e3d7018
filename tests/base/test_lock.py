"""One process a folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from aminn_base.errors import AminnError, InUseError, WriteError
from aminn_base.lock import NAME, locked_folder

HOLD = """
import sys
from pathlib import Path
from aminn_base.lock import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(folder: Path) -> subprocess.Popen:
    """Another process that holds the folder until its standard input ends."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_a_second_process_is_told_who_is_first(tmp_path: Path) -> None:
    first = holder(tmp_path / "data")
    try:
        with pytest.raises(InUseError, match=f"data: in use by process {first.pid} on .* since .*wait until"):
            with locked_folder(tmp_path / "data"):
                raise AssertionError("both are in")
    finally:
        first.communicate("")
    with locked_folder(tmp_path / "data"):
        assert (tmp_path / "data" / NAME).exists()
    assert not list((tmp_path / "data").iterdir())


def test_the_same_process_is_kept_out_too(tmp_path: Path) -> None:
    with locked_folder(tmp_path), pytest.raises(InUseError, match=f"process {os.getpid()} "), locked_folder(tmp_path):
        pass


def test_a_killed_holder_blocks_nobody(tmp_path: Path) -> None:
    first = holder(tmp_path)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    assert (tmp_path / NAME).exists()
    with locked_folder(tmp_path):
        pass
    assert not (tmp_path / NAME).exists()


def test_it_ends_with_an_error(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(AminnError, match="no data"), locked_folder(tmp_path):
            raise AminnError("no data")
    assert not list(tmp_path.iterdir())


def test_a_lock_beside_the_folder(tmp_path: Path) -> None:
    out, file = tmp_path / "out", tmp_path / ".out.lock"
    with locked_folder(out, file), pytest.raises(InUseError, match="out: in use"), locked_folder(out, file):
        pass
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match="file/data: cannot be written"), locked_folder(tmp_path / "file" / "data"):
        pass


def test_one_at_a_time(tmp_path: Path) -> None:
    """Many processes that come and go: never two inside, though each removes the lock's file."""
    script = """
import sys
from pathlib import Path
from aminn_base.errors import InUseError
from aminn_base.lock import locked_folder
folder, inside, entered = Path(sys.argv[1]), Path(sys.argv[1]) / "inside", 0
while entered < 40:
    try:
        with locked_folder(folder):
            inside.touch(exist_ok=False)
            inside.unlink()
            entered += 1
    except InUseError:
        pass
"""
    crowd = [subprocess.Popen([sys.executable, "-c", script, str(tmp_path)]) for _ in range(4)]
    assert [p.wait() for p in crowd] == [0] * 4
