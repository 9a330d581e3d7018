"""The one exception that reaches a user as a message rather than as a traceback."""

from __future__ import annotations


class AminnError(Exception):
    """Bad input or an impossible request. The text says what was wrong, where, and what to do."""
