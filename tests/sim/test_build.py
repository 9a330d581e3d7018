"""The engine's build: which one, on record with the data, and the same labels from another."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner
from small_data import SMALL, begin

from aminn_app.cli import main
from aminn_base.seal import JSON_KEY
from aminn_sim import SimulationConfig, SimulationError, _core, simulate
from aminn_sim.build import in_words, simulator_build
from aminn_sim.labels import Variant, compare, system_library
from aminn_sim.open_hand import open_hand
from aminn_sim.simulate import MANIFEST, UNFINISHED, _open_simulator, config_sha256

ROOT = Path(__file__).resolve().parents[2]
OTHER = {"library": "libmujoco.so.2.2.2", "from": "the system", "sha256": "ab" * 32}


def test_another_build_gives_the_same_bytes() -> None:
    library = system_library()
    if library is None:
        pytest.skip("one build of MuJoCo 2.2.2 is here, nothing to compare: `make test` installs Debian's as well")
    variants = {"here": Variant(sys.executable), "system": Variant(sys.executable, library)}
    figures = compare(variants, grasps=10, cases=20, seed=5, threads=2, rounds=1)
    assert figures["labels_same_bits_as_system"] is True
    here, there = (figures[f"labels_{name}_library_sha256"] for name in variants)
    assert here == simulator_build()["sha256"] != there


def test_manifest_and_program_name_the_build(dataset_dir: Path) -> None:
    build = json.loads((dataset_dir / MANIFEST).read_text())["simulator_build"]
    assert build == simulator_build() and len(build["sha256"]) == 64
    shown = CliRunner().invoke(main, ["--version"])
    assert shown.exit_code == 0 and shown.output.startswith("aminn, version ") and in_words(build) in shown.output


def test_going_on_with_another_build_is_refused(dataset_dir: Path, tmp_path: Path) -> None:
    for name, build in (("other", OTHER), ("unknown", None)):
        folder = begin(dataset_dir, tmp_path / name)
        record = json.loads((folder / UNFINISHED).read_text())
        (folder / UNFINISHED).write_text(json.dumps(record | {"simulator_build": build}))
        before = {p.name: p.read_bytes() for p in folder.iterdir()}
        with pytest.raises(SimulationError, match=r"begun on another build of MuJoCo, .*(abababab|not on record)"):
            simulate(SimulationConfig(**SMALL), folder, progress=False)
        assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


@pytest.mark.parametrize("build", [OTHER, None])
def test_a_finished_data_set_keeps_the_build_that_it_is_of(dataset_dir: Path, tmp_path: Path, build: dict) -> None:
    folder = Path(shutil.copytree(dataset_dir, tmp_path / "data"))
    manifest = json.loads((folder / MANIFEST).read_text())
    del manifest["simulator_build"], manifest[JSON_KEY]
    (folder / MANIFEST).write_text(json.dumps(manifest | ({"simulator_build": build} if build else {})))
    assert simulate(SimulationConfig(**SMALL), folder, progress=False).get("simulator_build") == build
    assert json.loads((folder / MANIFEST).read_text()).get("simulator_build") == build


def test_a_worker_with_another_build_is_refused() -> None:
    config = SimulationConfig(**SMALL)
    digest = config_sha256(config, open_hand())
    assert _open_simulator(config, digest, simulator_build(), None)
    with pytest.raises(SimulationError, match=r"has another build of MuJoCo, .* instead of .*abababab"):
        _open_simulator(config, digest, OTHER, None)


def set_up(tmp_path: Path, wheel: dict[str, bytes] | None) -> tuple[str, Path, bool]:
    """Run mujoco.sh where pip gives this wheel, or none: what it says, the folder, whether Debian's was asked for."""
    scripts = tmp_path / "tools" / "setup"
    scripts.mkdir(parents=True)
    shutil.copy(ROOT / "tools/setup/mujoco.sh", scripts)
    (scripts / "apt.sh").write_text('#!/bin/sh\necho "$@" >asked\n')
    if wheel is not None:
        with zipfile.ZipFile(tmp_path / "mujoco-2.2.2.whl", "w") as file:
            for name, content in wheel.items():
                file.writestr(name, content)
    python = tmp_path / "python"
    python.write_text(
        f"""#!/bin/bash
        [[ $2 != pip ]] && exec {sys.executable} "$@"
        while [[ $1 != --dest ]]; do shift; done
        cp {tmp_path}/mujoco-2.2.2.whl "$2" || {{ echo "no such wheel" >&2; exit 1; }}
        """
    )
    for file in (scripts / "apt.sh", python):
        file.chmod(0o755)
    left = tmp_path / "build" / "mujoco"
    (left / "lib").mkdir(parents=True)
    (left / "lib" / "of_before").touch()
    run = subprocess.run(
        [scripts / "mujoco.sh", "build/mujoco", python], capture_output=True, text=True, check=True, env=os.environ
    )
    assert not (left / "lib" / "of_before").exists()
    return run.stdout, left, (tmp_path / "asked").exists()


def test_set_up_takes_the_registrys_build(tmp_path: Path) -> None:
    content = {
        "mujoco/libmujoco.so.2.2.2": Path(_core.MUJOCO_LIBRARY).read_bytes(),
        "mujoco/include/mujoco/mujoco.h": b"",
        "mujoco-2.2.2.dist-info/LICENSE": b"",
        "mujoco-2.2.2.dist-info/LICENSES_THIRD_PARTY.md": b"",
    }
    said, folder, asked = set_up(tmp_path, content)
    assert said == "MuJoCo 2.2.2: the build of the Python package registry\n" and not asked
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert found == {"lib/libmujoco.so.2.2.2", "include/mujoco/mujoco.h", "LICENSE", "LICENSES_THIRD_PARTY.md"}


@pytest.mark.parametrize(
    ("wheel", "why"),
    [
        (None, "no such wheel"),
        ({"mujoco/include/mujoco/mujoco.h": b""}, "does not run here"),
        ({"mujoco/libmujoco.so.2.2.2": b"no library"}, "does not run here"),
    ],
)
def test_set_up_falls_back_on_debians_build(tmp_path: Path, wheel: dict[str, bytes] | None, why: str) -> None:
    said, folder, asked = set_up(tmp_path, wheel)
    assert said.startswith("MuJoCo 2.2.2: Debian's build, which is slower (") and why in said
    assert asked and not folder.exists() and (tmp_path / "asked").read_text() == "sim\n"
