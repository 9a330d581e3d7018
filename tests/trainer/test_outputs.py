"""Outputs of the commands: into a FIFO, over an input, onto a disk that is full."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from aminn.model.checkpoint import META, WEIGHTS, Checkpoint
from aminn.training.run_state import FILE
from aminn_app.cli import main

Figures = dict[str, float | int | str | bool]
OLD = "old"


def command(name: str, data: Path, run: Path, *more: str) -> Result:
    """A command on a data set and a run."""
    if name == "report":
        more = (*more, "--reports", str(data / "none"))
    if name == "explain":
        more = (*more, "--sample", "3")
    return CliRunner().invoke(main, [name, "--data", str(data), "--run", str(run), *more])


@contextmanager
def full_disk(room: int = 300) -> Iterator[None]:
    """No file may grow beyond `room` bytes meanwhile."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


OUTPUTS = [("evaluate", "--json"), ("explain", "--json"), ("explain", "--out"), ("report", "--out")]


@pytest.mark.parametrize(("name", "option"), OUTPUTS)
def test_a_full_disk_leaves_the_old_file(
    runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path, name: str, option: str
) -> None:
    out = tmp_path / "out.png"
    out.write_text(OLD)
    with full_disk():
        result = command(name, data_dir, runs["aminn"].path, option, str(out))
    assert result.exit_code == 1, result.output
    assert f"{out}: cannot be written (File too large); make room" in result.output and "Traceback" not in result.output
    assert out.read_text() == OLD and names(tmp_path) == ["out.png"]


@pytest.mark.parametrize(("name", "option"), OUTPUTS)
def test_every_command_writes_into_a_fifo(
    runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path, name: str, option: str
) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with ThreadPoolExecutor(1) as pool:
        got = pool.submit(fifo.read_bytes)
        result = command(name, data_dir, runs["aminn"].path, option, str(fifo))
        if result.exit_code:  # so that the reader ends
            fifo.write_bytes(b"")
        assert result.exit_code == 0, result.output
        assert len(got.result()) > 300
    assert fifo.is_fifo() and names(tmp_path) == ["fifo"]


@pytest.mark.parametrize(("name", "option"), OUTPUTS)
def test_no_command_overwrites_its_inputs(
    runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path, name: str, option: str, trust: Figures
) -> None:
    data, run = Path(shutil.copytree(data_dir, tmp_path / "data")), tmp_path / "run"
    shutil.copytree(runs["aminn"].path, run)
    (tmp_path / "link").symlink_to(run / META)
    (tmp_path / "hard").hardlink_to(data / "manifest.json")
    before = {p: p.read_bytes() for folder in (data, run) for p in folder.iterdir() if p.is_file()}
    refused = [data / "manifest.json", data / "shard-00000.h5", run / WEIGHTS, run / META]
    for out in (*refused, tmp_path / "link", tmp_path / "hard"):
        result = command(name, data, run, option, str(out))
        assert result.exit_code == 1 and "choose another name" in result.output, result.output
        trust["files_outputs_over_inputs"] = int(trust.get("files_outputs_over_inputs", 0)) + 1
    assert before == {p: p.read_bytes() for folder in (data, run) for p in folder.iterdir() if p.is_file()}


def test_two_outputs_are_not_one_file(runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "out.png")
    result = command("explain", data_dir, runs["aminn"].path, "--out", out, "--json", out)
    assert result.exit_code == 1 and "choose another name" in result.output and not names(tmp_path)
    assert command("explain", data_dir, runs["aminn"].path, "--json", "/dev/null", "--out", "/dev/null").exit_code == 0


@pytest.mark.parametrize("board", ["--tensorboard", "--no-tensorboard"])
def test_training_goes_on_after_a_full_disk(data_dir: Path, tmp_path: Path, board: str) -> None:
    """The last good state stays, and the same command ends in the bytes of an undisturbed run."""
    words = ["train", "--data", str(data_dir), "--epochs", "2", board, "--out"]
    assert CliRunner().invoke(main, [*words, str(tmp_path / "whole")]).exit_code == 0
    out = tmp_path / "run"
    for room in (300, 20_000, 400_000):
        with full_disk(room):
            result = CliRunner().invoke(main, [*words, str(out)])
        if result.exit_code:
            assert "cannot be written (File too large); make room" in result.output, result.output
            assert "Traceback" not in result.output
            assert set(names(out)) <= {FILE, "tensorboard"}
    assert CliRunner().invoke(main, [*words, str(out)]).exit_code == 0
    for name in (WEIGHTS, META):
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert set(names(out)) == set(names(tmp_path / "whole"))
