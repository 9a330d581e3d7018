"""Text files as people and other programs hand them over: any of them may be empty, cut short or of another kind."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from .errors import AminnError, OutdatedError

AnyPath = str | os.PathLike[str]
"""A place in the file system as a caller may write it."""


def read_bytes(path: AnyPath) -> bytes:
    """The content of a file. Raises AminnError where it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise AminnError(f"{path}: cannot be read ({error.strerror})") from error


def is_file(path: AnyPath) -> bool:
    """Whether a file is there. A name that another file tells may be none that a file system has, one too long."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def read_text(path: AnyPath, content: bytes | None = None) -> str:
    """The text of a UTF-8 file, with or without a byte-order mark; whatever the locale says, lines end in LF.

    content: what the file held, where it was read before. Raises AminnError where it cannot be read or is of another
    encoding.
    """
    try:
        return (read_bytes(path) if content is None else content).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise AminnError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8, or make it again") from error


def read_json(path: AnyPath, what: str) -> dict[str, Any]:
    """The object in a JSON file that should be `what`, as in "the manifest of a data set".

    Raises AminnError where it cannot be read, OutdatedError where it is no JSON or holds something else than names and
    values.
    """
    text = read_text(path)
    if not text.strip("\0 \n\t"):
        raise OutdatedError(f"{path}: is empty, expected {what}; make it again")
    try:
        return json_object(text, what)
    except ValueError as error:
        raise OutdatedError(f"{path}: not {what}: {error}") from error


def json_object(text: str, what: str = "names and values") -> dict[str, Any]:
    """The object in a JSON text. Raises ValueError with what is wrong."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"not valid JSON ({error})") from error
    except RecursionError as error:
        raise ValueError("not valid JSON (nested too deeply)") from error
    if not isinstance(value, dict):
        raise ValueError(f"it holds {_kind(value)}, expected names and values")
    return value


def read_toml(path: AnyPath, content: bytes | None = None) -> dict[str, Any]:
    """The table in a TOML file, or in its `content`. Raises AminnError where it cannot be read or is no TOML."""
    try:
        return tomllib.loads(read_text(path, content))
    except (ValueError, RecursionError) as error:
        raise AminnError(f"{path}: not valid TOML ({error})") from error


_MISSED = {
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_type": "a text",
    "float_type": "a number",
    "float_parsing": "a number",
}
"""What TOML calls what pydantic misses."""


def complaint(error: Mapping[str, Any], names: Iterable[str], what: str) -> str:
    """One of pydantic's errors: which field, what is wrong with it, the nearest of `names` where `what` has no such."""
    where = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        near = get_close_matches(str(error["loc"][-1]), list(names), 1)
        return f"{where} is not a field of {what}" + (f"; did you mean {near[0]}?" if near else "")
    kind = _MISSED.get(error["type"])
    return f"{where}: expected {kind}" if kind else f"{where}: {error['msg'][0].lower()}{error['msg'][1:]}"


def require(source: AnyPath, table: Mapping[str, Any], keys: Mapping[str, type | tuple[type, ...]], do: str) -> None:
    """Raise OutdatedError unless `table` has every key, of its type; `do` is the remedy."""
    missing = [key for key in keys if key not in table]
    if missing:
        raise OutdatedError(f"{source}: {', '.join(missing)} missing; {do}")
    for key, kind in keys.items():
        value = table[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise OutdatedError(f"{source}: {key} is {_kind(value)}, expected {_expected(kind)}; {do}")


_KINDS: dict[type, str] = {
    dict: "a table",
    list: "a list",
    str: "a text",
    int: "an integer",
    float: "a number",
    bool: "true or false",
    type(None): "nothing",
}


def _expected(kind: type | tuple[type, ...]) -> str:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    return _KINDS[float] if float in kinds else " or ".join(_KINDS[k] for k in kinds)


def _kind(value: object) -> str:
    return _KINDS.get(type(value), type(value).__name__)
