"""The WebAssembly module of the reference hand, and a page of untrained models on made-up data sets."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(TESTS / "trainer")]

from synthetic import HANDS, write_dataset  # noqa: E402
from untrained import made_up_data, untrained_run  # noqa: E402, F401

from aminn_app.play import play  # noqa: E402
from aminn_export.replay.wasm import build_wasm  # noqa: E402


@pytest.fixture(scope="session")
def module(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_wasm(tmp_path_factory.mktemp("wasm") / "aminn.wasm")


@pytest.fixture(scope="session")
def page(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of two hands, the second one without tendons."""
    folder = tmp_path_factory.mktemp("play")
    write_dataset(folder / "gripper", grasps=20, cases=2, of=HANDS["gripper 2x2"])
    data = [data_dir, folder / "gripper"]
    runs = [untrained_run(folder / f"run-{i}", each) for i, each in enumerate(data)]
    told = play(folder / "play.html", runs, [], data, grasps=5)
    assert told[0] == "synthetic: 5 grasps of 40" and told[1].startswith("gripper: ")
    return folder / "play.html"
