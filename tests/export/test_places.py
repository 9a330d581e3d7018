"""Where `aminn export` and `aminn verify` write: links, a full disk, two at once, outputs over inputs."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner
from runtime_models import SLIDES

from aminn_app.cli import main
from aminn_base.errors import AminnError, InUseError, WriteError
from aminn_base.lock import locked_folder
from aminn_export.export import export
from aminn_export.files.hand_header import build_name
from aminn_export.replay.runtime_place import find_in, find_runtime


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.is_file()}


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


@pytest.fixture(scope="module")
def whole(checkpoint_dir: Path, data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "export"
    export(checkpoint_dir, folder, data_dir=data_dir)
    return folder


@pytest.mark.parametrize("there", [False, True])
def test_a_full_disk_names_the_file_and_leaves_the_old_ones(
    checkpoint_dir: Path, data_dir: Path, whole: Path, tmp_path: Path, there: bool
) -> None:
    out = tmp_path / "export"
    if there:
        shutil.copytree(whole, out)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for room in (300, 30_000, 200_000):  # not even the header, not the source, not the graph
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            with pytest.raises(
                WriteError, match=r"export/[a-z_]+\.[a-z]+: cannot be written .File too large.; make room"
            ):
                export(checkpoint_dir, out, data_dir=data_dir)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert names(tmp_path) == (["export"] if there else [])
    if there:
        assert contents(out) == contents(whole)
    export(checkpoint_dir, out, data_dir=data_dir)
    assert contents(out) == contents(whole) and names(tmp_path) == ["export"]


def test_links_are_followed(checkpoint_dir: Path, data_dir: Path, whole: Path, tmp_path: Path) -> None:
    """The folder is a link, and one of its files is one to a place outside."""
    (tmp_path / "there").mkdir()
    (tmp_path / "flash").mkdir()
    (tmp_path / "out").symlink_to("there")
    (tmp_path / "there" / "aminn_model.bin").symlink_to(tmp_path / "flash" / "image.bin")
    export(checkpoint_dir, tmp_path / "out", data_dir=data_dir)
    assert (tmp_path / "out").is_symlink() and (tmp_path / "there" / "aminn_model.bin").is_symlink()
    assert contents(tmp_path / "there") == contents(whole) and names(tmp_path) == ["flash", "out", "there"]
    assert (tmp_path / "flash" / "image.bin").read_bytes() == (whole / "aminn_model.bin").read_bytes()


def test_two_exports_to_one_folder(checkpoint_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "export"
    with (
        locked_folder(out, tmp_path / ".export.lock"),
        pytest.raises(InUseError, match=f"export: in use by process {os.getpid()} "),
    ):
        export(checkpoint_dir, out)
    assert not names(tmp_path)


def test_what_a_killed_export_left_is_removed(
    checkpoint_dir: Path, data_dir: Path, whole: Path, tmp_path: Path
) -> None:
    (tmp_path / ".export.partial").mkdir()
    (tmp_path / ".export.partial" / "stale.c").touch()
    (tmp_path / ".export.lock").touch()
    export(checkpoint_dir, tmp_path / "export", data_dir=data_dir)
    assert contents(tmp_path / "export") == contents(whole) and names(tmp_path) == ["export"]


@pytest.mark.parametrize("option", ["--json", "--junit"])
def test_verify_and_compare_do_not_overwrite_their_inputs(
    whole: Path, data_dir: Path, tmp_path: Path, option: str
) -> None:
    out, data = (Path(shutil.copytree(f, tmp_path / name)) for f, name in ((whole, "export"), (data_dir, "data")))
    before = contents(out) | contents(data)
    (tmp_path / "hard").hardlink_to(out / "golden.bin")
    inputs = [*out.iterdir(), data / "manifest.json", data / "shard-00000.h5", tmp_path / "hard"]
    for file in inputs:
        words = ["verify", "--export", str(out), "--data", str(data), "--build", str(tmp_path), option, str(file)]
        result = CliRunner().invoke(main, words)
        assert result.exit_code != 0 and "choose another name" in result.output, result.output
    for file in ("golden.bin", "aminn_model.bin"):
        words = ["compare", str(out / "aminn_model.bin"), str(out / "golden.bin"), option, str(out / file)]
        result = CliRunner().invoke(main, words)
        assert result.exit_code != 0 and "choose another name" in result.output, result.output
    assert contents(out) | contents(data) == before


def test_replay_without_room_says_so_and_leaves_nothing(build_dir: Path, tmp_path: Path) -> None:
    """A limit on the size of files, as a quota sets it: by default it ends a process by a signal."""
    program = find_in(build_dir, "aminn_replay")
    golden = Path(__file__).resolve().parents[1] / "golden"
    out = tmp_path / "out.bin"
    done = subprocess.run(
        [program, golden / "aminn_model.bin", golden / "golden.bin", out],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192)),
        capture_output=True,
        text=True,
    )
    assert done.returncode > 0 and str(out) in done.stderr and "File too large" in done.stderr, done
    assert list(tmp_path.iterdir()) == []


HEADER = """/* a hand */
#define AMINN_HAND_NAME "{name}"
#define AMINN_N_BRANCH {branches}
#define AMINN_N_COORD 3
#define AMINN_N_JOINT 8
#define AMINN_N_GATED {gated}
#define AMINN_N_TWIST 0
#define AMINN_N_STIFF {stiff}
#define AMINN_N_TENDON 6
#define AMINN_N_SLIDE {slides:d}
"""


def _header(folder: Path, name: str, branches: int, gated: int, stiff: int = 10) -> Path:
    folder.mkdir()
    file = folder / "aminn_hand.h"
    file.write_text(HEADER.format(name=name, branches=branches, gated=gated, stiff=stiff, slides=SLIDES))
    return file


def test_a_runtime_for_another_hand_is_refused_by_name(installed: Path, tmp_path: Path) -> None:
    """What is installed cannot be built anew; the counts matter, not the name."""
    same = _header(tmp_path / "same", "three_like", 3, 3)
    assert find_runtime(installed, same) == find_runtime(installed)
    for name, *counts in (("four_like", 4, 3), ("no_cables", 3, 0), ("two_cables", 3, 2), ("own_springs", 3, 3, 12)):
        other = _header(tmp_path / name, name, *counts)
        with pytest.raises(AminnError, match=f"compiled for hand three_finger_hand, the model is of {name}"):
            find_runtime(installed, other)
    assert build_name(same) != build_name(other) and build_name(same).startswith("three_like-")
    (tmp_path / "same" / "aminn_hand.h").write_text("/* damaged */")
    with pytest.raises(AminnError, match=r"aminn_hand\.h: no AMINN_N_BRANCH"):
        find_runtime(installed, same)
