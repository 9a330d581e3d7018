"""The README's commands exist and its C snippet compiles: a newcomer can follow it to the letter."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import click
import pytest

from aminn_app.cli import main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^((?: {4}\S.*\n)+)", README, re.MULTILINE)
LINES = [line.split("#")[0].strip() for block in BLOCKS for line in block.splitlines()]


def test_make_targets_exist() -> None:
    listed = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    named = {line.split()[1] for line in LINES if line.startswith("make ")}
    assert {"demo", "test"} <= named
    assert named <= set(re.findall(r"^  make (\S+)", listed, re.MULTILINE))


def commands() -> list[list[str]]:
    return [shlex.split(line)[1:] for line in LINES if line.startswith(".venv/bin/aminn ")]


@pytest.mark.parametrize("words", commands(), ids=lambda words: words[0])
def test_aminn_commands_are_accepted(words: list[str]) -> None:
    """Each command and each of its options exists, and no required one is left out."""
    command = main.commands[words[0]]
    known = {name: p for p in command.params if isinstance(p, click.Option) for name in p.opts}
    given = [word for word in words[1:] if word.startswith("--")]
    assert set(given) <= set(known)
    assert {name for name, p in known.items() if p.required and name == p.opts[0]} <= set(given)


def test_readme_shows_every_command() -> None:
    assert {words[0] for words in commands()} == set(main.commands)


def test_c_snippet_compiles(tmp_path: Path, people: dict[str, object]) -> None:
    snippet = re.search(r"```c\n(.*?)```", README, re.DOTALL).group(1)
    (tmp_path / "snippet.c").write_text(snippet)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wdouble-promotion", "-c"]
    include = [f"-I{ROOT / 'runtime' / 'include'}", f"-I{ROOT / 'tests' / 'golden'}"]
    subprocess.run(["cc", *flags, *include, "snippet.c", "-o", "snippet.o"], cwd=tmp_path, check=True)
    people["snippets_in_readme"] = 1


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
