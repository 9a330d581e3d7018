"""The tree in a folder whose name holds what shells and make take apart."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[1]


def test_the_firmware_is_built_and_checked_in_a_folder_with_spaces(tmp_path: Path) -> None:
    compare = TREE / "build" / "host" / "runtime" / "aminn_compare"
    if not compare.exists():
        pytest.skip("no build/host: make setup-host")
    folder = tmp_path / "it's a folder, größer"
    stamps = folder / "build" / "stamps"
    stamps.mkdir(parents=True)
    for name in ("Makefile", "CMakeLists.txt", "runtime", "tests", "tools"):
        (folder / name).symlink_to(TREE / name)
    (folder / "build" / "host").symlink_to(TREE / "build" / "host")
    for stamp in ("apt-host", "apt-arm", "host"):
        (stamps / stamp).touch()
    done = subprocess.run(["make", "firmware"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert (folder / "build" / "reports" / "firmware.json").is_file()
