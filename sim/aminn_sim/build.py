"""Which build of the engine simulates here: the same version of it, built otherwise, may have other last bits."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from . import _core


@cache
def simulator_build() -> dict[str, str]:
    """The engine's library as it was loaded: `library` (its file's name), `from` (who built it) and `sha256`."""
    library = Path(_core.MUJOCO_LIBRARY).resolve()
    carried = library.parent == Path(_core.__file__).resolve().parent
    return {
        "library": library.name,
        "from": "the Python package registry" if carried else "the system",
        "sha256": hashlib.sha256(library.read_bytes()).hexdigest(),
    }


def is_here(build: dict[str, str] | None) -> bool:
    """Whether a build on record is the one that simulates here."""
    return build is not None and build["sha256"] == simulator_build()["sha256"]


def in_words(build: dict[str, str] | None) -> str:
    """A build as messages and pages name it; None: that of a data set of before builds were on record."""
    return f"{build['library']} from {build['from']} ({build['sha256'][:12]})" if build else "one that is not on record"
