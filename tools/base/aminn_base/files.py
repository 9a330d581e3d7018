"""Files that are written whole or not at all."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

from .errors import AminnError


def write_atomically(path: Path, content: bytes) -> None:
    """A reader sees the old file or the new one, never half of it, whatever ends the program or the machine.

    Raises AminnError where the file cannot be written; nothing is left behind then.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise AminnError(
            f"{path}: cannot be written ({error.strerror}); make room or choose another place, then repeat the command"
        ) from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_json(path: Path, value: dict) -> None:
    """Write a JSON file with sorted keys, atomically. A figure that is not finite becomes null: NaN is no JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(_finite(value), indent=1, sort_keys=True, allow_nan=False) + "\n").encode())


def _finite(value: object) -> object:
    """The value with null for every float that is not finite."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
