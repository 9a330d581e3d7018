"""Programs that are run: what they say is given back, what fails is told."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from aminn_base.errors import AminnError
from aminn_base.run import run_program


def _python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_output_comes_back(tmp_path: Path) -> None:
    both = _python("import os, sys; print(os.getcwd()); print('aside', file=sys.stderr)")
    assert run_program(both, "printing", folder=tmp_path) == f"{tmp_path}\n"
    assert "aside" in run_program(both, "printing", merged=True)


def test_failures_are_told() -> None:
    with pytest.raises(AminnError, match=r"^no-such-program is not installed; on Debian: apt-get install this that$"):
        run_program(["no-such-program"], "trying", packages="this that")
    long = _python("import sys; [print(f'line {i}', file=sys.stderr) for i in range(40)]; sys.exit(5)")
    with pytest.raises(AminnError, match=r"^counting failed with exit code 5: line 25\n(.*\n)*line 39$"):
        run_program(long, "counting")
    with pytest.raises(AminnError, match=r"^speaking failed with exit code 1: only here$"):
        run_program(_python("print('only here'); raise SystemExit(1)"), "speaking")
    with pytest.raises(AminnError, match=r"^sleeping: no end after 0.1 s$"):
        run_program(_python("import time; time.sleep(9)"), "sleeping", timeout_s=0.1)
