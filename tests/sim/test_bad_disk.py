"""A folder that cannot be written to, or that runs full: a message, exit 1, and nothing half written."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from small_data import SMALL, begin, command_line

from aminn_sim import SimulationConfig, simulate
from aminn_sim.simulate import UNFINISHED, shard_name


def command(folder: Path) -> list[str]:
    settings = command_line(SMALL)
    return [sys.executable, "-m", "aminn_app.cli", "simulate", "--out", str(folder), "--threads=1", *settings]


def half_of_second(dataset_dir: Path) -> int:
    """Bytes too few for the second shard."""
    return (dataset_dir / shard_name(1)).stat().st_size // 2


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def assert_refused(result: subprocess.CompletedProcess, *words: str) -> None:
    assert result.returncode == 1, result.stderr
    assert "Error: " in result.stderr and "Traceback" not in result.stderr, result.stderr
    for word in words:
        assert word in result.stderr, result.stderr


def resumed(folder: Path, whole: Path) -> bool:
    """Whether the simulation goes on, with room, to the bytes of an undisturbed one."""
    simulate(SimulationConfig(**SMALL), folder, threads=1, progress=False)
    return {p.name: p.read_bytes() for p in folder.iterdir()} == {p.name: p.read_bytes() for p in whole.iterdir()}


def test_a_file_that_may_not_grow(tmp_path: Path, dataset_dir: Path) -> None:
    """The first shard is there, the second finds no room (a limit on the size of a file, as a quota sets it)."""
    folder = begin(dataset_dir, tmp_path / "data")
    room, limit = half_of_second(dataset_dir), resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    result = subprocess.run(
        command(folder),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, limit)),
        capture_output=True,
        text=True,
    )
    assert_refused(result, shard_name(1), "File too large", "make room")
    assert names(folder) == [shard_name(0), UNFINISHED]
    assert resumed(folder, dataset_dir)


def mount_is_allowed() -> bool:
    words = ["unshare", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
    return bool(shutil.which("unshare")) and subprocess.run(words, capture_output=True).returncode == 0


@pytest.mark.skipif(not mount_is_allowed(), reason="no right to mount a file system")
def test_a_full_disk(tmp_path: Path, dataset_dir: Path) -> None:
    """A file system with room for one shard, seen by the program alone."""
    disk, rescued = tmp_path / "disk", tmp_path / "rescued"
    disk.mkdir()
    room = (dataset_dir / shard_name(0)).stat().st_size + half_of_second(dataset_dir)
    script = (
        f'mount -t tmpfs -o size={room} tmpfs "$1"; shift; "$@"; status=$?; cp -r {disk}/data {rescued}; exit $status'
    )
    result = subprocess.run(
        ["unshare", "--mount", "sh", "-c", script, "sh", str(disk), *command(disk / "data")],
        capture_output=True,
        text=True,
    )
    assert_refused(result, shard_name(1), "No space left on device", "make room")
    assert names(rescued) == [shard_name(0), UNFINISHED]
    assert resumed(rescued, dataset_dir)


def test_a_folder_that_cannot_be_written_to() -> None:
    """/proc takes no file from anybody, root included."""
    result = subprocess.run(command(Path("/proc")), capture_output=True, text=True)
    assert_refused(result, "/proc: cannot be made a data set folder", "choose one that you may write to")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_of_somebody_else(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    result = subprocess.run(command(tmp_path), capture_output=True, text=True)
    tmp_path.chmod(0o700)
    assert_refused(result, "cannot be made a data set folder (Permission denied)")
    assert not list(tmp_path.iterdir())
