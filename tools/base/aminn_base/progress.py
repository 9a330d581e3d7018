"""What long work says of itself on standard error: a bar in a terminal, one line per state in a log, or nothing."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

LIVE_S, LOG_S = 0.2, 10.0
"""Seconds between two states, in a terminal and in a log."""
_quiet = False


def be_quiet(wanted: bool = True) -> None:
    """Whether this process keeps its progress and notes to itself; what fails is said all the same."""
    global _quiet
    _quiet = wanted


def is_quiet() -> bool:
    """Whether it does."""
    return _quiet


class _Lines(tqdm):
    """A state is a line of its own: a log has no cursor that could go back."""

    said = ""
    leave: bool

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        text = str(self) if msg is None else msg
        if text and text != self.said:
            self.fp.write(f"{text}\n")
            self.fp.flush()
            self.said = text

    def close(self) -> None:
        if not self.disable and self.leave:
            self.refresh()
        self.leave = False  # else the bar moves on to a new line by itself
        super().close()


def progress_bar(desc: str, total: int | None, unit: str, *, position: int = 0, **settings: Any) -> tqdm:
    """A bar of tqdm for `total` units of work; None: nobody knows how many.

    position: its line in a terminal, for work side by side. settings: further ones of tqdm, e.g. initial, leave, delay.
    """
    live = sys.stderr.isatty()
    settings |= {"desc": desc, "total": total, "unit": unit, "disable": _quiet or settings.pop("disable", False)}
    if live:
        return tqdm(position=position, mininterval=LIVE_S, **settings)
    if total is not None:
        settings["bar_format"] = (
            "{desc}: {percentage:.0f}%, {n_fmt} of {total_fmt}, {elapsed}<{remaining}, {rate_fmt}{postfix}"
        )
    return _Lines(mininterval=LOG_S, **settings)


def note(text: str) -> None:
    """Say something by the way, on a line of its own above the bars."""
    if not _quiet:
        tqdm.write(text, file=sys.stderr)
