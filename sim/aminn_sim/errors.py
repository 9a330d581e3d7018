"""What this package raises for a user's mistake."""

from __future__ import annotations

from aminn_base.errors import AminnError


class SimulationError(AminnError):
    """Bad configuration or an unusable data set folder. The text says what was wrong, where, and what to do."""
