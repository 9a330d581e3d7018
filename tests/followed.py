"""A page of docs as one who follows it to the letter: what it says to save, its commands, what they print."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"(?:[Ss]ave as `([^`]+)`:\n\n)?^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)


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


def make_place(folder: Path, text: str = "") -> Path:
    """Make `folder` look like the checkout to the page's commands, with the files that it says to save."""
    (folder / ".venv").symlink_to(Path(sys.prefix))
    (folder / "build").mkdir()
    (folder / "build" / "host").symlink_to(ROOT / "build" / "host")
    for name, content in files(text).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder


def make_tree(folder: Path) -> Path:
    """Make `folder` look like a checkout that is set up, to `make` too."""
    for name in ("Makefile", "CMakeLists.txt", "constraints.txt", "pyproject.toml", "runtime", "sim", "tests", "tools"):
        (folder / name).symlink_to(ROOT / name)
    build = make_place(folder) / "build"
    (build / "logs").mkdir()
    (stamps := build / "stamps").mkdir()
    for stamp in ("apt-host", "apt-arm", "apt-python", "venv", "mujoco", "host", "module"):
        (stamps / stamp).touch()
    return folder


@dataclass(frozen=True)
class Step:
    """One thing that a section of fenced blocks has its reader do."""

    command: str
    """A line for the shell; what saves a file is none."""
    saves: tuple[str, str] | None
    """Name and content of a file to save before."""
    prints: str
    """What the page says that it prints; empty: nothing is said of it."""

    @property
    def name(self) -> str:
        """The program and its first argument that is no path, as a key of a report has it."""
        program, *words = self.command.split()
        word = next((w for w in words if re.fullmatch(r"[a-z][a-z-]+|-m \w+", w)), "")
        return re.sub(r"\W", "_", f"{Path(program).name} {word}".strip())


def steps(section: str) -> list[Step]:
    """What a section of a page has its reader do: a step for each command line of its fenced blocks."""
    found: list[Step] = []
    saved: tuple[str, str] | None = None
    for name, language, content in FENCE.findall(section):
        if language == "sh":
            for line in content.splitlines():
                found.append(Step(line, saved, ""))
                saved = None
        elif language == "text":
            found[-1] = Step(found[-1].command, found[-1].saves, content)
        else:
            assert name and saved is None, f"a block of {language} that is not saved"
            saved = (name, content)
    return found


def run(line: str, folder: Path) -> str:
    """What a line for the shell prints; fails where it fails."""
    done = subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
    return done.stdout


def without_numbers(text: str) -> str:
    """A text without its decimal numbers, which another model or data set changes."""
    return re.sub(r"-?\d+\.\d+", "#", text)


def follow(section: str, folder: Path) -> Iterator[tuple[Step, float]]:
    """Take each step of a section in `folder`; yields it with its seconds. Fails where it fails or prints otherwise."""
    for step in steps(section):
        if step.saves:
            (folder / step.saves[0]).parent.mkdir(parents=True, exist_ok=True)
            (folder / step.saves[0]).write_text(step.saves[1])
        start = time.monotonic()
        said = run(step.command, folder)
        seconds = time.monotonic() - start
        assert without_numbers(step.prints) in without_numbers(said), f"{step.command} printed\n{said}"
        yield step, seconds


def roles(page: str) -> dict[str, str]:
    """The sections of docs/start.md by the user that each is for, the first word of its title."""
    _, *parts = re.split(r"^## (\w+): .+\n", page, flags=re.MULTILINE)
    return dict(zip(map(str.lower, parts[::2]), parts[1::2], strict=True))
