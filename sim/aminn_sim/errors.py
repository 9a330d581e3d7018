"""The one exception that reaches a user as a message rather than as a traceback."""

from __future__ import annotations


class SimulationError(Exception):
    """Bad configuration or an unusable data set folder. The text says what was wrong, where, and what to do."""
