"""What long work says of itself: lines in a log, a bar in a terminal, nothing with --quiet."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner

from aminn_base import progress
from aminn_base.program import Commands


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def loud() -> Iterator[None]:
    yield
    progress.be_quiet(False)


def work(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch, **settings: object) -> str:
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.progress_bar("simulate", 10, "case", initial=2, **settings) as bar:
        bar.update(3)
        if "delay" not in settings:
            bar.refresh()
        bar.update(5)
    progress.note("by the way")
    return stream.getvalue()


def test_a_log_gets_a_line_for_each_state(monkeypatch: pytest.MonkeyPatch) -> None:
    said = work(io.StringIO(), monkeypatch)
    assert "\r" not in said and "\x1b" not in said
    lines = said.splitlines()
    assert [line.split(",")[0] for line in lines] == ["simulate: 20%", "simulate: 50%", "simulate: 100%", "by the way"]
    assert "5 of 10" in lines[1]


def test_a_log_gets_nothing_of_what_was_too_short(monkeypatch: pytest.MonkeyPatch) -> None:
    assert work(io.StringIO(), monkeypatch, delay=5, leave=False) == "by the way\n"


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    said = work(Terminal(), monkeypatch)
    assert said.count("\r") >= 3 and said.count("\n") == 2


def test_quiet_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    progress.be_quiet()
    assert work(Terminal(), monkeypatch) == ""


@click.group(cls=Commands)
def program() -> None:
    """A program."""


@program.command()
def noisy() -> None:
    """A command."""
    progress.note("by the way")
    click.echo("result")


def test_every_command_has_quiet_and_a_short_help() -> None:
    run = CliRunner().invoke
    for word, said in (("-q", ""), ("--quiet", ""), (None, "by the way\n")):  # not quiet for good
        done = run(program, ["noisy", *filter(None, [word])])
        assert (done.stdout, done.stderr) == ("result\n", said)
    for words in ([], ["noisy"]):
        assert run(program, [*words, "-h"]).output == run(program, [*words, "--help"]).output != ""
