"""A page of docs as one who follows it to the letter: what it says to save, and its commands."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def blocks(text: str) -> list[str]:
    """Indented blocks of a page."""
    found = re.findall(r"(?:^(?: {4}.*)?\n)+", text, re.MULTILINE)
    return ["\n".join(line[4:] for line in block.strip("\n").split("\n")) + "\n" for block in found if block.strip()]


def files(text: str) -> dict[str, str]:
    """What the page says to save, by name."""
    parts = re.split(r"[Ss]ave as\s+`([^`]+)`:", text)
    return {name: blocks(rest)[0] for name, rest in zip(parts[1::2], parts[2::2], strict=True)}


def commands(text: str) -> list[str]:
    """Every command line of the page."""
    return [line for block in blocks(text) for line in block.splitlines() if line.startswith(".venv/bin/")]


def make_place(folder: Path, text: str) -> Path:
    """Make `folder` look like the checkout to the page's commands, with the files that it says to save."""
    (folder / ".venv").symlink_to(Path(sys.prefix))
    (folder / "build").mkdir()
    (folder / "build" / "host").symlink_to(ROOT / "build" / "host")
    for name, content in files(text).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder
