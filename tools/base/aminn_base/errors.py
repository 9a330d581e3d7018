"""The exceptions that reach a user as a message rather than as a traceback."""

from __future__ import annotations

from pathlib import Path


class AminnError(Exception):
    """Bad input or an impossible request. The text says what was wrong, where, and what to do."""


class OutdatedError(AminnError):
    """What lies on disk is damaged, or was made with other settings, other data or another version."""


class WriteError(AminnError):
    """A file cannot be written; `path` and `reason` say which and why."""

    def __init__(self, path: Path, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(
            f"{path}: cannot be written ({reason}); make room or choose another place, then repeat the command"
        )

    def __reduce__(self) -> tuple:
        return WriteError, (self.path, self.reason)


class InUseError(AminnError):
    """Another process works in the folder."""
