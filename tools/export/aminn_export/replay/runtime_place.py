"""Where a compiled runtime is: a build folder of CMake, or a place that it is installed in."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from aminn_base.errors import AminnError

REPLAY_SOURCES = ("aminn_replay.c", "host_file.c")
"""What the replay program is compiled from, beside the library."""
_INSTALLED_SOURCES = Path("share/aminn_rt/replay")


@dataclass(frozen=True)
class RuntimePlace:
    """What is needed to replay with a binary model, and to compile the replay program with a C model."""

    replay: Path
    """The program `aminn_replay`."""
    library: Path
    """`libaminn_rt.a`."""
    include: Path
    """Folder of `aminn_rt.h`."""
    sources: Path
    """Folder of REPLAY_SOURCES."""
    compiler: str
    """The C compiler that the library was built with, where it is known."""


def find_in(folder: Path, name: str) -> Path:
    """The file of this name below a folder."""
    found = sorted(folder.rglob(name))
    if not found:
        raise AminnError(f"{folder}: no {name} there; build the C runtime first (`make` targets do)")
    return found[0]


def _cmake_cache(build_dir: Path) -> dict[str, str]:
    """The variables of a CMake build folder."""
    text = (build_dir / "CMakeCache.txt").read_text()
    return dict(re.findall(r"^(\w+):\w+=(.*)$", text, re.MULTILINE))


def runtime_source(build_dir: Path) -> Path:
    """The runtime's source folder, from the build folder of the tree or of the runtime alone."""
    if not (build_dir / "CMakeCache.txt").is_file():
        raise AminnError(f"{build_dir}: no CMakeCache.txt; this is not a build folder of the C runtime")
    home = Path(_cmake_cache(build_dir)["CMAKE_HOME_DIRECTORY"])
    for folder in (home / "runtime", home):
        if (folder / "include" / "aminn_rt.h").is_file():
            return folder
    raise AminnError(f"{build_dir}: its source folder {home} has no runtime/include/aminn_rt.h")


def find_runtime(folder: Path) -> RuntimePlace:
    """The runtime in a build folder, or below the prefix that it was installed with.

    Raises AminnError that says what was looked for.
    """
    if (folder / "CMakeCache.txt").is_file():
        source, compiler = runtime_source(folder), _cmake_cache(folder).get("CMAKE_C_COMPILER", "cc")
        replay, library = find_in(folder, "aminn_replay"), find_in(folder, "libaminn_rt.a")
        return RuntimePlace(replay, library, source / "include", source / "tools", compiler)
    if not (folder / "bin" / "aminn_replay").is_file():
        raise AminnError(
            f"{folder}: neither a build folder of the C runtime (no CMakeCache.txt) nor a prefix that it is installed "
            "in (no bin/aminn_replay); `make install PREFIX=DIR` makes one"
        )
    sources = folder / _INSTALLED_SOURCES
    missing = [str(sources / name) for name in REPLAY_SOURCES if not (sources / name).is_file()]
    missing += [] if (folder / "include" / "aminn_rt.h").is_file() else [str(folder / "include" / "aminn_rt.h")]
    if missing:
        raise AminnError(f"{folder}: {', '.join(missing)} is missing there; install the runtime again")
    library = find_in(folder, "libaminn_rt.a")
    return RuntimePlace(folder / "bin" / "aminn_replay", library, folder / "include", sources, "cc")
