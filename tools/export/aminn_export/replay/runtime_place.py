"""Where a compiled runtime is: a build folder of CMake, or a place that it is installed in."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.lock import locked_folder
from aminn_base.run import run_program
from aminn_rt.sources import DEBIAN_PACKAGES, cache_folder, source_tree, sources_digest

from ..files.hand_header import HAND_HEADER, build_name, name_in, same_build

REPLAY_SOURCES = ("aminn_replay.c", "host_file.c")
"""What the replay program is compiled from, beside the library."""
_KEPT = ("CMAKE_BUILD_TYPE", "CMAKE_C_COMPILER", "CMAKE_CXX_COMPILER", "AMINN_MAX_WIDTH")
"""Of a build folder, for the build of another hand."""
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
    hand: Path
    """`aminn_hand.h` that the library was compiled with."""

    @property
    def flags(self) -> list[str]:
        """For the compiler: where the headers are, and which hand they are for."""
        return [f"-I{self.include}", f'-DAMINN_HAND_HEADER="{self.hand}"']


def find_in(folder: Path, name: str) -> Path:
    """The file of this name below a folder; of several the least deep: builds for other hands lie below."""
    found = sorted(folder.rglob(name), key=lambda file: (len(file.parts), file))
    if not found:
        raise AminnError(f"{folder}: no {name} there; build the C runtime first (`make` targets do)")
    return found[0]


def _cmake_cache(build_dir: Path) -> dict[str, str]:
    """The variables of a CMake build folder."""
    text = (build_dir / "CMakeCache.txt").read_text()
    return dict(re.findall(r"^(\w+):\w+=(.*)$", text, re.MULTILINE))


def source_of(build_dir: Path) -> Path:
    """The runtime's source folder, from the build folder of the tree or of the runtime alone."""
    if not (build_dir / "CMakeCache.txt").is_file():
        raise AminnError(f"{build_dir}: no CMakeCache.txt; this is not a build folder of the C runtime")
    home = Path(_cmake_cache(build_dir)["CMAKE_HOME_DIRECTORY"])
    for folder in (home / "runtime", home):
        if (folder / "include" / "aminn_rt.h").is_file():
            return folder
    raise AminnError(f"{build_dir}: its source folder {home} has no runtime/include/aminn_rt.h")


def own_build() -> Path:
    """A build folder of the runtime that comes with the program: the tree's build/host, else one in the user's cache.

    That of the cache is built where it is not there yet. Raises AminnError with what is missing or what the compiler
    said, InUseError while another process builds there.
    """
    tree = source_tree()
    folder = tree / "build" / "host"
    if (folder / "CMakeCache.txt").is_file():
        return folder
    folder = cache_folder() / f"build-{sources_digest(tree, str(tree))}"
    with locked_folder(folder):
        what = "building the C runtime"
        configure = ["cmake", "-S", str(tree / "runtime"), "-B", str(folder)]
        run_program(configure, what, packages=DEBIAN_PACKAGES)
        run_program(["cmake", "--build", str(folder), "--parallel", "--target", "aminn_replay"], what)
    return folder


def _built_for(source: Path, folder: Path, hand: Path) -> Path:
    """A build folder of the runtime for another hand, beside that of this one; built, or brought up to date.

    Raises AminnError with what the compiler said, InUseError while another process builds there.
    """
    folder = folder.resolve()
    own = folder.with_name(f"{folder.name}-hands") / build_name(hand)  # not inside, where its files would be found
    cache = _cmake_cache(folder)
    options = [f"-D{key}={cache[key]}" for key in _KEPT if cache.get(key)]
    options += ["-G", cache["CMAKE_GENERATOR"]] if "CMAKE_GENERATOR" in cache else []
    with locked_folder(own):
        copy = own / HAND_HEADER  # the model may be in a folder that goes
        if not copy.is_file() or copy.read_bytes() != hand.read_bytes():
            write_atomically(copy, hand.read_bytes())
        configure = ["cmake", "-S", str(source), "-B", str(own), f"-DAMINN_HAND={copy}", *options]
        what = f"building the runtime for hand {name_in(hand)}"
        run_program(configure, what)
        run_program(["cmake", "--build", str(own), "--target", "aminn_replay"], what)
    return own


def find_runtime(folder: Path | None = None, hand: Path | None = None) -> RuntimePlace:
    """The runtime in a build folder, or below the prefix that it was installed with; None: in `own_build`.

    It is compiled for the hand of the header `hand`, where one is given: from a build folder it is built for that, once
    for each, in a folder beside it; what is installed has to be for that hand.
    Raises AminnError that says what was looked for.
    """
    folder = folder or own_build()
    if (folder / "CMakeCache.txt").is_file():
        source, compiler = source_of(folder), _cmake_cache(folder).get("CMAKE_C_COMPILER", "cc")
        own = Path(_cmake_cache(folder).get("AMINN_HAND", "") or source / "include" / HAND_HEADER)
        if hand is not None and not same_build(hand, own):
            folder, own = _built_for(source, folder, hand), hand
        replay, library = find_in(folder, "aminn_replay"), find_in(folder, "libaminn_rt.a")
        return RuntimePlace(replay, library, source / "include", source / "tools", compiler, own)
    if not (folder / "bin" / "aminn_replay").is_file():
        raise AminnError(
            f"{folder}: neither a build folder of the C runtime (no CMakeCache.txt) nor a prefix that it is installed "
            "in (no bin/aminn_replay); `make setup-host` makes build/host in the checkout, `make install PREFIX=DIR` "
            "an installed one: give either as --build"
        )
    sources = folder / _INSTALLED_SOURCES
    missing = [str(sources / name) for name in REPLAY_SOURCES if not (sources / name).is_file()]
    missing += [] if (folder / "include" / "aminn_rt.h").is_file() else [str(folder / "include" / "aminn_rt.h")]
    if missing:
        raise AminnError(f"{folder}: {', '.join(missing)} is missing there; install the runtime again")
    library, own = find_in(folder, "libaminn_rt.a"), folder / "include" / HAND_HEADER
    if hand is not None and not same_build(hand, own):
        raise AminnError(
            f"{folder}: the runtime installed there is compiled for hand {name_in(own)}, the model is of "
            f"{name_in(hand)}; compile it with -DAMINN_HAND={hand} and install that"
        )
    return RuntimePlace(folder / "bin" / "aminn_replay", library, folder / "include", sources, "cc", own)
