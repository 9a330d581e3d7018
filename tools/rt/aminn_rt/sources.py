"""The sources of the C runtime that come with the program: in the tree, or in the installed package."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from aminn_base.errors import AminnError

DEBIAN_PACKAGES = "cmake g++ make"
"""What compiles them on this machine."""
_FOLDERS = (
    *("runtime", "runtime/cmake", "runtime/host", "runtime/include", "runtime/src", "runtime/tools"),
    *("tools/rt", "tools/rt/src"),
)
_SUFFIXES = {".c", ".cpp", ".h", ".hpp", ".txt", ".cmake", ".map"}


def source_tree() -> Path:
    """Folder that holds `runtime/` and `tools/rt/` as the repository does.

    Raises AminnError where this installation lacks them.
    """
    package = Path(__file__).resolve().parent
    places = (package / "source", package.parents[2])
    for tree in places:
        if all((tree / part / "CMakeLists.txt").is_file() for part in ("runtime", "tools/rt")):
            return tree
    raise AminnError(f"the C runtime's sources are in none of {', '.join(map(str, places))}; install the package again")


def runtime_source() -> Path:
    """Folder of the C runtime: `include`, `src`, `tools`, `firmware`. Raises AminnError as `source_tree` does."""
    return source_tree() / "runtime"


def sources_digest(tree: Path, *texts: str) -> str:
    """Name for what is compiled for this machine from the sources in `tree` and these texts: 16 hexadecimal digits."""
    digest = hashlib.sha256("\n".join(texts).encode())
    for folder in _FOLDERS:
        for file in sorted((tree / folder).glob("*")):
            if file.suffix in _SUFFIXES:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Where built runtimes are kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "aminn" / "runtime"
