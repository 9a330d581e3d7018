"""A killed simulation leaves whole shards and goes on to the same bytes. `make crash` does this 50 times."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from crash import Crash


def test_killed_at_random_moments(tmp_path: Path) -> None:
    crash = Crash(tmp_path, seed=1, grasps=12, shard_grasps=4, cases=4, directly=True)
    while crash.figures["kills"] < 3:
        crash.kill(while_writing=crash.figures["kills"] == 2)
    assert crash.finish()["finished_data_sets"] >= 1

    damaged = Path(shutil.copytree(tmp_path / "whole", crash.folder)) / "shard-00000.h5"
    damaged.write_bytes(damaged.read_bytes()[:-1])
    with pytest.raises(AssertionError):  # the comparison has teeth
        crash.finish_one()
