"""A killed training run goes on to the same bytes. `make resume` kills each model 20 times."""

from __future__ import annotations

from pathlib import Path

import pytest
from resume import Resume

from aminn.model.checkpoint import WEIGHTS


def test_killed_at_random_steps(tmp_path: Path) -> None:
    resume = Resume(tmp_path, "aminn", seed=1)
    while resume.figures["kills"] < 3:
        resume.kill()
    assert resume.finish()["finished_runs"] >= 1


def test_other_bytes_would_be_found(tmp_path: Path) -> None:
    resume = Resume(tmp_path, "mlp", seed=1)
    assert resume.start(resume.killed, None) == 0
    weights = bytearray((resume.killed / WEIGHTS).read_bytes())
    weights[-1] ^= 1
    (resume.killed / WEIGHTS).write_bytes(weights)
    with pytest.raises(AssertionError):
        resume.compare()
