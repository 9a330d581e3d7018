"""The compiled part (sim/src), for a type checker."""

from typing import Any

def __getattr__(name: str) -> Any: ...
