"""Every example builds alone, runs, and says what it should."""

from __future__ import annotations

import configparser
import re
import subprocess
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[2]
EXAMPLES = TREE / "examples"
HOST = TREE / "build/host"
PLATFORMIO = EXAMPLES / "platformio"


def run(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert (HOST / "runtime/libaminn_rt.a").is_file(), "the C runtime is not built: make setup-host"
    folder = tmp_path_factory.mktemp("installed")
    run("cmake", "--install", HOST, "--prefix", folder)
    return folder


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (
            "two_hands",
            r"left hand: p_stable ([\d.]+), .* by ([\d.]+) mm\nright hand: p_stable ([\d.]+), .* by ([\d.]+) mm",
        ),
        (
            "eigen",
            r"  0 degrees: p_stable ([\d.]+), moves by ([\d.]+) mm, work ([\d.e-]+) J\n(?:.*\n){6}315 degrees: ",
        ),
    ],
)
def test_an_example_of_the_installed_library(
    name: str, says: str, prefix: Path, tmp_path: Path, people: dict[str, object]
) -> None:
    run("cmake", "-S", EXAMPLES / name, "-B", tmp_path, "-G", "Ninja", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", tmp_path)
    said = run(tmp_path / name)
    found = re.search(says, said)
    assert found and all(float(number) > 0 for number in found.groups()), said
    people |= {f"example_{name}": True, "package_cmake": "used"}


def test_an_interrupt_predicts_while_the_background_searches(tmp_path: Path, people: dict[str, object]) -> None:
    source = EXAMPLES / "interrupt_and_background"
    lines = re.findall(r"^#   (.*)$", (source / "CMakeLists.txt").read_text(), re.MULTILINE)
    for line in lines:
        program, *arguments = line.replace("build/isr", str(tmp_path)).split()
        said = run(program, *(a.replace("examples/", f"{EXAMPLES}/") for a in arguments))
    assert "searches that an interrupt changed: 0" in said
    people["example_interrupt_and_background"] = True


def test_the_platformio_program_runs_as_its_settings_say(
    prefix: Path, tmp_path: Path, people: dict[str, object]
) -> None:
    settings = configparser.ConfigParser(inline_comment_prefixes=(";",))
    settings.read(PLATFORMIO / "platformio.ini")
    native = settings["env:native"]
    assert native["lib_deps"] == "aminn_rt=symlink://../.." and (PLATFORMIO / "../../library.json").is_file()
    sources = [PLATFORMIO / "src/main.c"]
    sources += [PLATFORMIO / "src" / path for path in re.findall(r"\+<(\S+\.c)>", native["build_src_filter"])]
    flags = [flag.replace("-I", f"-I{PLATFORMIO}/") for flag in native["build_flags"].split()]
    library = [f"-I{prefix}/include", f"-L{prefix}/lib", "-laminn_rt"]
    run("gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", *sources, *library, *flags, "-o", tmp_path / "program")
    assert "AMINN_OK: p_stable" in run(tmp_path / "program")
    people |= {"example_platformio": True, "package_platformio": "compiled"}


def test_the_page_lists_every_example() -> None:
    linked = set(re.findall(r"\]\(([^)]*)\)", (EXAMPLES / "README.md").read_text()))
    assert all((EXAMPLES / link).is_file() for link in linked)
    folders = {folder.name for folder in EXAMPLES.iterdir() if folder.is_dir()}
    assert folders <= {Path(link).parts[0] for link in linked}
