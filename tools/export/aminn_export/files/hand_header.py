"""The hand that a model and a compiled runtime are for, as `aminn_hand.h` states it."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath, read_text
from aminn_hand.hand import Dims
from aminn_rt.hand_header import COUNTS, HAND_HEADER, counts_of, hand_header

from .tables import Exported, dims_of


def write_hand_header(exported: Exported, out_dir: AnyPath) -> Path:
    """Write the header of an exported model's hand into a folder; returns its path."""
    path, meta = Path(out_dir) / HAND_HEADER, exported.meta
    name = str(meta.get("hand", "unknown")).rpartition(" ")[0] or "unknown"
    text = hand_header(name, dims_of(exported), meta.get("joints", ()), meta.get("theta_names", ()))
    write_atomically(path, text.encode())
    return path


def header_beside(model_dir: Path) -> Path | None:
    """The header of an exported model's hand; none beside a model that is for the runtime's own."""
    header = model_dir / HAND_HEADER
    return header.resolve() if header.is_file() else None


def name_in(header: Path) -> str:
    """The hand's name."""
    found = re.search(r'^#define AMINN_HAND_NAME "(.*)"', read_text(header), re.MULTILINE)
    return found[1] if found else "unknown"


def counts_in(header: Path) -> tuple[int, ...]:
    """What a build follows from: branches, coordinates, joints, gated tendons, soft fingertips, stiffnesses."""
    text = read_text(header)
    found = [re.search(rf"^#define {name} (\d+)", text, re.MULTILINE) for name in COUNTS]
    missing = [name for name, match in zip(COUNTS, found, strict=True) if match is None]
    if missing:
        raise AminnError(f"{header}: no {', '.join(missing)} there; export the model again")
    return tuple(int(match[1]) for match in found if match is not None)


def same_build(first: Path, second: Path) -> bool:
    """Whether a library that is compiled for one of the headers is right for the other's hand too."""
    return counts_in(first) == counts_in(second)


def fits(header: Path, dims: Dims) -> bool:
    """Whether a header is that of a hand of these counts."""
    return counts_in(header) == tuple(counts_of(dims).values())


def build_name(header: Path) -> str:
    """Name of a build folder for a hand: its name and its header's content."""
    name = re.sub(r"\W", "_", name_in(header))
    return f"{name}-{hashlib.sha256(header.read_bytes()).hexdigest()[:12]}"
