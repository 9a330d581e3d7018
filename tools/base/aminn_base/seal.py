"""Checksums inside of files, over the rest of the same file: they find accidents, and nothing done on purpose.

A file without one, of an earlier version or made by hand, is taken as it is.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from .errors import OutdatedError
from .files import finite
from .read import AnyPath

JSON_KEY = "content_sha256"
"""Of a JSON file: SHA-256 of the other keys and values, in canonical form (sorted, without spaces)."""
DIGITS = 64


def _of(content: Mapping[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != JSON_KEY}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """What a JSON file is to hold, with its checksum."""
    plain = json.loads(json.dumps(finite(dict(content))))
    return plain | {JSON_KEY: _of(plain)}


def check_seal(path: AnyPath, content: Mapping[str, Any], do: str) -> None:
    """Raise OutdatedError where the content of a JSON file is not what its checksum says; `do` is the remedy."""
    if JSON_KEY in content and content[JSON_KEY] != _of(content):
        raise OutdatedError(
            f"{path}: damaged, or changed by hand: its {JSON_KEY} is of other content; {do}, or remove that line if "
            "you changed the file"
        )


def sealed_bytes(content: bytes, mark: bytes) -> bytes:
    """A file with its own SHA-256, as it is with zeros in its place, for the DIGITS zeros that stand behind `mark`."""
    head, zeros, rest = _around(content, mark)
    assert zeros == b"0" * DIGITS
    return head + hashlib.sha256(content).hexdigest().encode() + rest


def check_bytes(path: AnyPath, content: bytes, mark: bytes, do: str) -> None:
    """Raise OutdatedError where a file is not what the checksum in it says; `do` is the remedy."""
    if mark in content:
        head, found, rest = _around(content, mark)
        if hashlib.sha256(head + b"0" * DIGITS + rest).hexdigest().encode() != found:
            raise OutdatedError(f"{path}: damaged, or changed by another program: its SHA-256 is of other bytes; {do}")


def _around(content: bytes, mark: bytes) -> tuple[bytes, bytes, bytes]:
    at = content.index(mark) + len(mark)
    return content[:at], content[at : at + DIGITS], content[at + DIGITS :]
