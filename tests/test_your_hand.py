"""docs/your-hand.md to the letter: its hand, saved as it says, goes from the model to a replayed C model."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "your-hand.md").read_text()
WALK = PAGE.split("## From a model to a replayed C model")[1].split("\n## ")[0]


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


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like the checkout to the page's commands."""
    folder = tmp_path_factory.mktemp("walk")
    (folder / ".venv").symlink_to(Path(sys.prefix))
    (folder / "build").mkdir()
    (folder / "build" / "host").symlink_to(ROOT / "build" / "host")
    for name, text in files(WALK).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def test_the_page_leads_from_a_model_to_a_replayed_c_model(place: Path) -> None:
    assert len(files(WALK)) == 2
    lines = commands(WALK)
    words = [line.split()[1] for line in lines]
    assert words == ["hand", "simulate", "train", "train", "evaluate", "export", "verify"]
    for line in lines:
        done = subprocess.run(shlex.split(line), cwd=place, capture_output=True, text=True)
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        if " hand check " in line:
            assert done.stdout.splitlines()[-1] == "accepted"
    exported = place / "build" / "tripod" / "export"
    header = (exported / "aminn_hand.h").read_text()
    for name, count in {"BRANCH": 3, "COORD": 3, "JOINT": 9, "GATED": 0}.items():
        assert re.search(rf"#define AMINN_N_{name} +{count}\b", header), header
