"""The Makefile's way to run a build: quiet, and one at a time in a tree."""

from __future__ import annotations

import subprocess
from pathlib import Path

QUIET = Path(__file__).resolve().parents[2] / "tools" / "setup" / "quiet.sh"


def test_two_makes_do_not_build_at_once(tmp_path: Path) -> None:
    script = "mkdir inside && sleep 0.2 && rmdir inside"
    builds = [
        subprocess.Popen(
            [QUIET, tmp_path / "logs" / f"{k}.log", "sh", "-ec", script], cwd=tmp_path, stderr=subprocess.PIPE
        )
        for k in range(4)
    ]
    errors = [build.communicate()[1] for build in builds]
    assert [build.returncode for build in builds] == [0] * 4, errors
    assert sum(b"waiting for it" in text for text in errors) == 3


def test_a_failure_shows_the_end_of_its_output(tmp_path: Path) -> None:
    done = subprocess.run([QUIET, tmp_path / "log", "sh", "-c", "echo why; exit 3"], capture_output=True, text=True)
    assert done.returncode == 3 and "why" in done.stderr and "Failed with status 3" in done.stderr
