"""What surrounds a program changes nothing: environment, locale, closed streams, a folder that is gone, signals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from aminn.model.checkpoint import Checkpoint
from aminn_app.cli import main

HOSTILE = {
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "LC_ALL": "C",
    "PYTHONUTF8": "0",
    "PYTHONCOERCECLOCALE": "0",
    "PYTHONIOENCODING": "ascii",
    "HOME": "/nonexistent",
    "COLUMNS": "1",
    "PYTHONOPTIMIZE": "2",
}


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "aminn_app.cli", *map(str, words)]


def test_a_report_is_the_same_in_a_hostile_environment(
    runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path
) -> None:
    words = ["report", "--data", data_dir, "--run", runs["aminn"].path, "--reports", tmp_path / "none"]
    kind = CliRunner().invoke(main, list(map(str, [*words, "--out", tmp_path / "kind.html"])))
    done = subprocess.run(
        command(*words, "--out", tmp_path / "hostile.html"),
        env=os.environ | HOSTILE,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert kind.exit_code == done.returncode == 0 and "Traceback" not in done.stderr, done.stderr[-500:]
    assert (tmp_path / "kind.html").read_bytes() == (tmp_path / "hostile.html").read_bytes()


@pytest.mark.parametrize("closed", ["2>&-", "<&- >&- 2>&-", "| true"])
def test_closed_streams_lose_nothing(runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path, closed: str) -> None:
    words = command("evaluate", "--data", data_dir, "--run", runs["aminn"].path, "--json", tmp_path / "e.json")
    line = " ".join(words) + f" 2>{tmp_path / 'err'} {closed}"
    subprocess.run(["bash", "-c", line], timeout=300, capture_output=True)
    assert '"aminn_f1"' in (tmp_path / "e.json").read_text()
    assert "Traceback" not in (tmp_path / "err").read_text()


def test_a_folder_that_is_gone_is_no_traceback(data_dir: Path, tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    script = (
        f"mkdir {gone}; cd {gone}; rmdir {gone}; exec {' '.join(command('train', '--data', data_dir, '--out', 'run'))}"
    )
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    assert "Error: the current folder is gone" in done.stderr


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_signals_end_with_words_and_leave_what_can_be_gone_on_with(
    data_dir: Path, tmp_path: Path, number: signal.Signals, code: int, word: str
) -> None:
    words = command("train", "--data", data_dir, "--out", tmp_path / "run", "--epochs", 10_000, "--no-tensorboard")
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 200
        while not (tmp_path / "run" / "unfinished.safetensors").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(number)
        _, error = process.communicate(timeout=100)
    assert process.returncode == code
    assert f"Error: {word}; the same command continues where it stopped" in error and "Traceback" not in error
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["unfinished.safetensors"]


def test_an_error_that_nobody_foresaw_is_one_line_and_its_traceback_can_be_had(data_dir: Path, tmp_path: Path) -> None:
    broken = "import aminn.data.dataset as d; d.split_of = None\nfrom aminn_app.cli import main; main()"
    words = [sys.executable, "-c", broken, "train", "--data", str(data_dir), "--out", str(tmp_path / "run")]
    for environment, traceback in (({}, False), ({"AMINN_DEBUG": "1"}, True)):
        done = subprocess.run(words, env=os.environ | environment, capture_output=True, text=True, timeout=300)
        assert ("Traceback" in done.stderr) == traceback and "'NoneType' object is not callable" in done.stderr
        assert traceback or (done.returncode == 70 and len(done.stderr.splitlines()) == 1)
