"""Other programs: run, and their failure said in one place."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from .errors import AminnError

TIMEOUT_S = 1800.0
LAST_LINES = 15
"""Of what a failed program said, so many are told."""


def run_program(
    command: Sequence[str | Path],
    what: str,
    *,
    packages: str = "",
    timeout_s: float = TIMEOUT_S,
    folder: Path | None = None,
    merged: bool = False,
) -> str:
    """Output of a program that runs in `folder`; with `merged`, its error output too.

    `what` is what messages call it, `packages` the Debian packages that it is in. Raises AminnError with what it said
    where it is not there, fails, or does not end in `timeout_s`.
    """
    words = [str(word) for word in command]
    if shutil.which(words[0]) is None:
        raise AminnError(
            f"{words[0]} is not installed" + (f"; on Debian: apt-get install {packages}" if packages else "")
        )
    errors = subprocess.STDOUT if merged else subprocess.PIPE
    try:
        done = subprocess.run(
            words, stdout=subprocess.PIPE, stderr=errors, text=True, errors="replace", timeout=timeout_s, cwd=folder
        )
    except subprocess.TimeoutExpired as error:
        raise AminnError(f"{what}: no end after {timeout_s:g} s") from error
    if done.returncode:
        said = (done.stderr or "").strip() or done.stdout.strip()
        last = "\n".join(said.splitlines()[-LAST_LINES:])
        raise AminnError(f"{what} failed with exit code {done.returncode}: {last}")
    return done.stdout
