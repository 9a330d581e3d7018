"""Sdist and wheel: whole, and of use outside the tree. `make wheels` has the simulation and other Pythons."""

from __future__ import annotations

import json
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest
from wheelhouse import GOLDEN, PACKAGES, ROOT, borrowing, build, checked, install, run

pytestmark = pytest.mark.long
QUICKLY = ("AMINN_SIM=OFF", "AMINN_RT_DISPATCH=OFF", "CMAKE_CXX_FLAGS_RELEASE=-O1")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return build(tmp_path_factory.mktemp("dist"), *QUICKLY)


@pytest.fixture(scope="module")
def outside(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder outside the tree, with an environment `env` and the reference model as `golden`."""
    folder = tmp_path_factory.mktemp("outside")
    install(built[1], borrowing(folder / "env"))
    shutil.copytree(GOLDEN, folder / "golden")
    return folder


def of_tree(*folders: Path) -> dict[str, bytes]:
    """Content of the files in these folders, by name relative to the folder above."""
    found = (
        (file.relative_to(folder.parent), file)
        for folder in folders
        for file in folder.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    )
    return {str(name): file.read_bytes() for name, file in found}


def test_the_wheel_holds_every_file_of_the_packages_and_of_the_runtime(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[1]) as wheel:
        inside = {name: wheel.read(name) for name in wheel.namelist()}
    expected = {name: content for name, content in of_tree(*PACKAGES).items() if not name.endswith(".pyi")}
    expected |= {f"aminn_sim/{name}": content for name, content in of_tree(ROOT / "sim" / "models").items()}
    expected |= {f"aminn_rt/source/{name}": content for name, content in of_tree(ROOT / "runtime").items()}
    assert len(expected) > 200
    assert {name for name, content in expected.items() if inside.get(name) != content} == set()
    assert any(name.endswith("licenses/LICENSE") for name in inside)
    assert not [name for name in inside if "tests/" in name or name.startswith(("runtime", "tools"))]


def test_the_sdist_holds_what_is_built_and_no_more(built: tuple[Path, Path], people: dict[str, object]) -> None:
    with tarfile.open(built[0]) as sdist:
        tops = {name.split("/")[1] for name in sdist.getnames() if "/" in name}
    tracked = {"CMakeLists.txt", "LICENSE", "README.md", "pyproject.toml", "runtime", "sim", "tools", "trainer"}
    assert tracked | {"PKG-INFO"} <= tops
    assert not tops & {"tests", "docs", "build", ".venv", ".git"}
    people["package_sdist"] = "used"  # the wheel is built from it


def test_a_wheel_without_the_simulation_says_what_to_do(outside: Path) -> None:
    aminn = outside / "env" / "bin" / "aminn"
    version = checked([aminn, "--version"], outside)
    assert "does not simulate: this installation has no simulation: MuJoCo 2.2.2 or Eigen" in version
    done = run([aminn, "simulate", "--out", "data", "--grasps", "2"], outside)
    assert done.returncode == 1 and done.stdout == "" and len(done.stderr.splitlines()) == 1
    assert "tools/setup/mujoco.sh build/mujoco python3" in done.stderr and "pip install" in done.stderr
    assert not (outside / "data").exists()


def test_where_the_engine_is_missing_the_package_to_install_is_named(outside: Path, tmp_path: Path) -> None:
    """An extension that the loader refuses, as it does where MuJoCo was there when it was built."""
    (package,) = outside.glob("env/lib/python*/site-packages/aminn_sim")
    (tmp_path / "stub.c").write_text("int gone(void); int (*user)(void) = gone;\n")
    (tmp_path / "gone.c").write_text("int gone(void) { return 0; }\n")
    module, library = package / "_core.abi3.so", tmp_path / "libgone.so"
    checked(["cc", "-shared", "-fPIC", "gone.c", "-o", library], tmp_path)
    checked(["cc", "-shared", "-fPIC", "stub.c", library, "-o", module], tmp_path)
    library.unlink()
    try:
        done = run([outside / "env" / "bin" / "aminn", "simulate", "--out", "data"], outside)
    finally:
        module.unlink()
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1, done.stderr
    assert "libgone.so" in done.stderr and "libmujoco2.2.2" in done.stderr


def test_a_model_is_predicted_with_and_verified_outside_the_tree(outside: Path, people: dict[str, object]) -> None:
    """The runtime of the replay, the C model in it and the firmware are compiled from what the wheel carries."""
    aminn, home = outside / "env" / "bin" / "aminn", outside / "home"
    words = ["--export", "golden", "--data", "golden/golden.bin", "--firmware", "--json", "verify.json"]
    checked([aminn, "verify", *words], outside, home)
    report = json.loads((outside / "verify.json").read_text())
    assert report["ok"] is True and report["cortex_m7_different_words"] == report["host_c_different_words"] == 0
    assert [folder.name.split("-")[0] for folder in (home / "cache/aminn/runtime").iterdir()] == ["build"]
    people["package_wheel"] = "used"


def test_cmake_leaves_the_simulation_out_or_refuses(tmp_path: Path) -> None:
    """Where there is no MuJoCo; a folder without it stands in for the registry's, Debian's is said not to be found."""
    gone = ["-DAMINN_MUJOCO=nowhere", "-DCMAKE_DISABLE_FIND_PACKAGE_mujoco=ON", "-DAMINN_MUJOCO_INCLUDE="]
    python = shutil.which("python", path=str(ROOT / ".venv" / "bin"))
    configure = ["cmake", "-S", str(ROOT / "sim"), f"-DPython_EXECUTABLE={python}", *gone]
    for how, code in (("AUTO", 0), ("ON", 1)):
        build = tmp_path / how
        done = subprocess.run([*configure, "-B", str(build), f"-DAMINN_SIM={how}"], capture_output=True, text=True)
        assert done.returncode == code and "no MuJoCo 2.2.2; run tools/setup/mujoco.sh" in done.stderr.replace(
            "\n  ", " "
        )
