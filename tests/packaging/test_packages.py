"""The library as other build systems take it in: Meson and Conan build it, the rest is held against the tree.

ESP-IDF, Arduino, vcpkg and CMSIS-Pack tools are in no package registry: their files are read by the rules stated here.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import yaml

TREE = Path(__file__).resolve().parents[2]
RUNTIME, PACKAGING, GOLDEN = TREE / "runtime", TREE / "packaging", TREE / "tests/golden"
BIN = Path(sys.executable).parent
SOURCES = {source.name for source in (RUNTIME / "src").glob("*.cpp")}
VERSION = re.search(r'#define AMINN_VERSION_STRING "([^"]+)"', (RUNTIME / "include/aminn_rt.h").read_text())[1]
OPTIONS = re.sub("#.*", "", (RUNTIME / "cmake/options.cmake").read_text())
PROGRAM = """
#include <aminn_model.h>
int main(void)
{
    static aminn_t ctx;
    return aminn_init(&ctx, &aminn_model, 0) != AMINN_OK || aminn_self_test(&ctx) != AMINN_OK;
}
"""


def run(*command: str | Path, folder: Path | None = None, **more: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env={**os.environ, **more})
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def options(name: str) -> list[str]:
    return re.search(rf"^set\(AMINN_RT_{name}\s+([^)]*)\)", OPTIONS, re.MULTILINE)[1].split()


def test_meson_builds_a_program_with_the_library(tmp_path: Path, people: dict[str, object]) -> None:
    (tmp_path / "subprojects").mkdir()
    shutil.copytree(RUNTIME, tmp_path / "subprojects/aminn_rt")
    (tmp_path / "main.c").write_text(PROGRAM)
    model = f"'main.c', '{GOLDEN}/aminn_model.c', include_directories: include_directories('golden')"
    (tmp_path / "golden").symlink_to(GOLDEN)
    (tmp_path / "meson.build").write_text(
        "project('user', 'c')\naminn = subproject('aminn_rt').get_variable('aminn_rt_dep')\n"
        f"test('self_test', executable('user', {model}, dependencies: aminn))\n"
    )
    path = f"{BIN}:{os.environ['PATH']}"
    # without optimisation it is compiled in a third of the time; the bits are the same
    debug = ["-Daminn_rt:buildtype=debug", "-Daminn_rt:cpp_args=-DAMINN_RT_SCALAR"]
    run(BIN / "meson", "setup", "build", *debug, folder=tmp_path, PATH=path)
    run(BIN / "meson", "test", "-C", "build", folder=tmp_path, PATH=path)
    people["package_meson"] = "used"


def test_meson_has_the_sources_and_options_of_cmake() -> None:
    text = (RUNTIME / "meson.build").read_text()
    assert set(re.findall(r"'src/(\w+\.cpp)'", text)) == SOURCES
    assert re.search(r"version: '([^']+)'", text)[1] == VERSION
    for name in ("ARITHMETIC", "NO_ALLOCATOR", "EMBEDDED"):
        assert re.findall(r"'(-f[^']+)'", re.search(rf"^{name.lower()} = (.*)$", text, re.M)[1]) == options(name)


def test_conan_makes_a_package_that_a_program_links(tmp_path: Path, people: dict[str, object]) -> None:
    home = {"CONAN_HOME": str(tmp_path / "home"), "PATH": f"{BIN}:{os.environ['PATH']}"}
    run(BIN / "conan", "profile", "detect", **home)
    debug = ["-s", "build_type=Debug", "-c", "tools.build:cxxflags=['-DAMINN_RT_SCALAR']"]
    run(BIN / "conan", "create", PACKAGING / "conan", *debug, "--no-remote", **home)
    (tmp_path / "main.c").write_text(PROGRAM)
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.22)\nproject(user C)\nfind_package(aminn_rt REQUIRED)\n"
        f"add_executable(user main.c {GOLDEN}/aminn_model.c)\ntarget_include_directories(user PRIVATE {GOLDEN})\n"
        "target_link_libraries(user PRIVATE aminn_rt::aminn_rt m)\n"
    )
    wanted = ["--requires", f"aminn_rt/{VERSION}", "-g", "CMakeToolchain", "--no-remote", *debug, "-of", tmp_path]
    run(BIN / "conan", "install", *wanted, folder=tmp_path, **home)
    toolchain = next(tmp_path.rglob("conan_toolchain.cmake"))
    run("cmake", "-B", "build", f"-DCMAKE_TOOLCHAIN_FILE={toolchain}", "-DCMAKE_BUILD_TYPE=Debug", folder=tmp_path)
    run("cmake", "--build", "build", folder=tmp_path)
    run(tmp_path / "build/user")
    people["package_conan"] = "used"


def test_arduino_has_a_library_that_compiles_flat(tmp_path: Path, people: dict[str, object]) -> None:
    """Rules: one `name=value` a line, these names, a known category; all sources in src/, the include path."""
    run(PACKAGING / "arduino/lay_out.sh", tmp_path)
    lines = (tmp_path / "library.properties").read_text().splitlines()
    properties = dict(line.split("=", 1) for line in lines)
    needed = {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url", "architectures"}
    assert properties.keys() == needed | {"includes"} and properties["version"] == VERSION
    assert properties["category"] in {"Device Control", "Data Processing", "Signal Input/Output", "Other"}
    assert (tmp_path / "src" / properties["includes"]).is_file() and (tmp_path / "LICENSE").is_file()
    assert {source.name for source in (tmp_path / "src").glob("*.cpp")} == SOURCES
    run("g++", "-std=gnu++17", "-fsyntax-only", f"-I{tmp_path}/src", *sorted((tmp_path / "src").glob("*.cpp")))
    people["package_arduino"] = "compiled"


def test_esp_idf_registers_the_library(tmp_path: Path, people: dict[str, object]) -> None:
    """CMake runs the component's file; the functions of ESP-IDF, and those that need a target, print what they get."""
    names = ("idf_component_register", "target_compile_features", "target_compile_options")
    stubs = "\n".join(f'function({name})\n  message("{name} ${{ARGN}}")\nendfunction()' for name in names)
    (tmp_path / "run.cmake").write_text(
        f"{stubs}\nset(ESP_PLATFORM 1)\nset(COMPONENT_LIB c)\ninclude({TREE}/CMakeLists.txt)\n"
    )
    done = subprocess.run(["cmake", "-P", tmp_path / "run.cmake"], capture_output=True, text=True, check=True)
    registered, features, compiled = done.stderr.splitlines()
    assert set(re.findall(r"/src/(\w+\.cpp)", registered)) == SOURCES and "runtime/include" in registered
    assert "cxx_std_17" in features and all(o in compiled for o in options("ARITHMETIC") + options("NO_ALLOCATOR"))
    component = yaml.safe_load((TREE / "idf_component.yml").read_text())
    assert component.keys() == {"version", "description", "license", "dependencies"} and component["version"] == VERSION
    people["package_esp_idf"] = "checked"


def test_vcpkg_has_a_port(people: dict[str, object]) -> None:
    """Rules: a name of lower-case words, a version, an SPDX licence; the port configures and installs in order."""
    port = json.loads((PACKAGING / "vcpkg/vcpkg.json").read_text())
    assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", port["name"]) and port["version"] == VERSION
    assert port["license"] == "Apache-2.0" and {"name": "vcpkg-cmake", "host": True} in port["dependencies"]
    calls = re.findall(r"^(vcpkg_\w+)\(", (PACKAGING / "vcpkg/portfile.cmake").read_text(), re.MULTILINE)
    order = ["vcpkg_cmake_configure", "vcpkg_cmake_install", "vcpkg_cmake_config_fixup", "vcpkg_install_copyright"]
    assert [call for call in calls if call in order] == order
    people["package_vcpkg"] = "checked"


def test_cmsis_pack_names_every_file(people: dict[str, object]) -> None:
    """Rules: a package's elements in their order; every file is in the tree, every source named, ids resolve."""
    root = ET.parse(PACKAGING / "cmsis/AMINN.aminn_rt.pdsc").getroot()
    first = ["vendor", "name", "description", "url", "license", "releases", "conditions", "components"]
    assert root.tag == "package" and [child.tag for child in root] == first
    assert root.findtext("name") == "aminn_rt" and root.find("releases/release").get("version") == VERSION
    conditions = {condition.get("id") for condition in root.findall("conditions/condition")}
    for component in root.findall("components/component"):
        assert component.get("Cversion") == VERSION and component.get("condition") in conditions
    files = [element.get("name") for element in root.iter("file")]
    assert all((TREE / name).exists() for name in files) and (TREE / root.findtext("license")).is_file()
    assert {Path(name).name for name in files if name.endswith(".cpp")} == SOURCES
    people["package_cmsis_pack"] = "checked"


def test_the_page_names_each() -> None:
    page = (TREE / "docs/runtime.md").read_text()
    files = [
        file.relative_to(TREE)
        for file in PACKAGING.rglob("*")
        if file.suffix in {".py", ".cmake", ".properties", ".pdsc"}
    ]
    assert len(files) == 5 and all(f"`{file}`" in page for file in files)
