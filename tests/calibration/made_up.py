"""What the tests of calibration call made-up pushes by."""

from __future__ import annotations

from collections.abc import Callable

from aminn.calibration.pushes import Array, Pushes

Draw = Callable[..., tuple[Pushes, Array]]
"""`draw(seed, pushes, grasps, error, off, vary)`: pushes of a hand, and its theta."""
