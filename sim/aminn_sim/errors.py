"""What the simulation raises where the user made a mistake."""

from __future__ import annotations

from aminn_base.errors import AminnError, OutdatedError


class SimulationError(AminnError):
    """Bad configuration or an unusable data set folder. The text says what was wrong, where, and what to do."""


class OutdatedDataError(SimulationError, OutdatedError):
    """The folder holds a data set that is damaged, or of another configuration or version."""


class MissingLibrary(SimulationError, ImportError):
    """The compiled part or a library that it needs is not there; also an ImportError, which it was."""
