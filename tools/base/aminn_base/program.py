"""How every program meets its user: errors as one line, whatever terminal, locale and signals there are."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from types import FrameType
from typing import Any

import click

from .errors import AminnError
from .progress import be_quiet

DEBUG = "AMINN_DEBUG"
"""Environment variable: where it is set, an unexpected error shows its traceback."""
HELP = {"help_option_names": ["-h", "--help"]}
UNEXPECTED, INTERRUPTED, TERMINATED = 70, 128 + signal.SIGINT, 128 + signal.SIGTERM


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived: what is under way is undone as after Ctrl-C."""


class Ended(click.ClickException):
    """A message and an exit code other than 1."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code  # type: ignore[misc]


class Messages(click.Command):
    """A command whose errors are one line, with -h and --quiet.

    Exit code 1: bad input or an impossible request; 2: wrong options; 70: a fault of the program; 130 and 143: Ctrl-C
    and SIGTERM.
    """

    failed = 1
    """Exit code where the command cannot do its work."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.context_settings = {**HELP, **self.context_settings}
        if not isinstance(self, click.Group):
            self.params.append(_quiet_option())

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        if standalone_mode:
            prepare()
        return super().main(*args, standalone_mode=standalone_mode, **extra)  # type: ignore[call-overload]

    def invoke(self, ctx: click.Context) -> object:
        try:
            _check_place()
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except AminnError as error:
            raise Ended(_line(str(error)), self.failed) from error
        except Terminated as error:
            raise Ended(_stopped("terminated"), TERMINATED) from error
        except KeyboardInterrupt as error:
            raise Ended(_stopped("interrupted"), INTERRUPTED) from error
        except OSError as error:
            if error.errno == errno.EPIPE:  # who read the output has gone: click ends without a word
                raise
            raise Ended(_line(str(error)), self.failed) from error
        except MemoryError as error:
            raise Ended("not enough memory; ask for less at a time, or end other programs", self.failed) from error
        except Exception as error:
            if os.environ.get(DEBUG):
                raise
            raise Ended(_unexpected(error), UNEXPECTED) from error


class Judges(Messages):
    """A command that judges: exit code 1 says that something differs, 3 that it cannot tell."""

    failed = 3


class Commands(Messages, click.Group):
    """A group whose commands do so."""

    command_class = Messages


def _quiet_option() -> click.Option:
    return click.Option(
        ["-q", "--quiet"],
        is_flag=True,
        expose_value=False,
        callback=lambda ctx, param, wanted: be_quiet(wanted),
        help="Say results and errors alone: no progress, no notes.",
    )


def prepare() -> None:
    """Make the surroundings of this process such that nothing in them changes what a program does.

    A closed stream becomes one that swallows, a character that the terminal cannot show becomes "?", pictures need no
    window or notebook, and SIGTERM is as gentle as Ctrl-C.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, mode))  # takes the free descriptor, which a file would get else
        elif mode == "w" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    os.environ["MPLBACKEND"] = "agg"
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _terminate)


def _check_place() -> None:
    """Libraries that are loaded in a folder that is gone end the process without a word."""
    try:
        os.getcwd()
    except OSError as error:
        raise AminnError(f"the current folder is gone ({error.strerror}); change to one that is there") from error


def _terminate(number: int, frame: FrameType | None) -> None:
    for child in multiprocessing.active_children():
        child.terminate()  # the pool that they belong to is waited for
    raise Terminated


def _stopped(how: str) -> str:
    return f"{how}; the same command continues where it stopped"


def _line(text: str) -> str:
    return " ".join(text.split()) if "\n" in text else text


def _unexpected(error: Exception) -> str:
    """What is said of an error that no code foresaw: itself, where, and how to report it."""
    place: Sequence[traceback.FrameSummary] = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in place if "aminn" in frame.filename] or list(place)
    where = f" ({os.path.basename(ours[-1].filename)}:{ours[-1].lineno})" if ours else ""
    text = _line(str(error)) or "no text"
    return (
        f"{type(error).__name__}: {text}{where}; this is a fault of AMINN, please report it with what the same command "
        f"prints when {DEBUG}=1 is set"
    )
