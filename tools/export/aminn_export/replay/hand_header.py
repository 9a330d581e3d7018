"""The hand that a model and a compiled runtime are for, as `aminn_hand.h` states it."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from aminn_base.errors import AminnError

HAND_HEADER = "aminn_hand.h"
"""Beside the C model, of the model's hand; beside `aminn_rt.h`, of the hand that the library is compiled for."""
_COUNTS = ("AMINN_N_BRANCH", "AMINN_N_COORD", "AMINN_N_JOINT", "AMINN_N_GATED")


def header_beside(model_dir: Path) -> Path | None:
    """The header of an exported model's hand; none beside a model that is for the runtime's own."""
    header = model_dir / HAND_HEADER
    return header.resolve() if header.is_file() else None


def name_in(header: Path) -> str:
    """The hand's name."""
    found = re.search(r'^#define AMINN_HAND_NAME "(.*)"', header.read_text(), re.MULTILINE)
    return found[1] if found else "unknown"


def _counts(header: Path) -> tuple[int, ...]:
    """What a build follows from: branches, coordinates, joints, branches with a gated tendon."""
    text = header.read_text()
    found = [re.search(rf"^#define {name} (\d+)", text, re.MULTILINE) for name in _COUNTS]
    missing = [name for name, match in zip(_COUNTS, found, strict=True) if match is None]
    if missing:
        raise AminnError(f"{header}: no {', '.join(missing)} there; export the model again")
    return tuple(int(match[1]) for match in found if match is not None)


def same_build(first: Path, second: Path) -> bool:
    """Whether a library that is compiled for one of the headers is right for the other's hand too."""
    return _counts(first) == _counts(second)


def build_name(header: Path) -> str:
    """Name of a build folder for a hand: its name and its header's content."""
    name = re.sub(r"\W", "_", name_in(header))
    return f"{name}-{hashlib.sha256(header.read_bytes()).hexdigest()[:12]}"
