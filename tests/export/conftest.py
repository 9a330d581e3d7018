"""A random model, its exported files, the compiled runtime, and an untrained checkpoint on a made-up data set."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent.parent
# Helpers of the other folders: random models and states of the runtime's tests, the made-up data set of the trainer's.
sys.path[:0] = [str(TESTS / "runtime"), str(TESTS / "trainer")]

from runtime_models import RandomModel, random_model  # noqa: E402
from untrained import made_up_data, untrained_run  # noqa: E402, F401

from aminn_export.export import write_model_files  # noqa: E402


@pytest.fixture(scope="session")
def exported() -> RandomModel:
    return random_model(1)


@pytest.fixture(scope="session")
def export_dir(exported: RandomModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All model files of the random model."""
    folder = tmp_path_factory.mktemp("export")
    write_model_files(exported, folder, "aminn_model")
    return folder


@pytest.fixture(scope="session")
def build_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A build folder of the runtime: the tree's own, else a new one."""
    folder = TESTS.parent / "build" / "host"
    if not list(folder.rglob("libaminn_rt.a")):
        folder = tmp_path_factory.mktemp("host")
        for command in (["cmake", "-S", TESTS.parent / "runtime", "-B", folder], ["cmake", "--build", folder]):
            subprocess.run([str(c) for c in command], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="session")
def checkpoint_dir(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained AMINN that says it was trained on the made-up data set."""
    return untrained_run(tmp_path_factory.mktemp("checkpoint") / "aminn", data_dir)


@pytest.fixture(scope="session")
def installed(build_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The runtime in a folder of its own, as `make install PREFIX=` leaves it."""
    prefix = tmp_path_factory.mktemp("installed")
    subprocess.run(["cmake", "--install", str(build_dir), "--prefix", str(prefix)], check=True, capture_output=True)
    return prefix
