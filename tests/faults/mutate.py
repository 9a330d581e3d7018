"""Wrong files from right ones: bytes, words, and parts of JSON, HDF5 and safetensors are changed. Seeded."""

from __future__ import annotations

import copy
import io
import json
import random
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

Mutator = Callable[[random.Random, bytes], bytes]

NUMBERS = ("0", "-1", "1e308", "-1e-320", "nan", "inf", "-inf", "1e999", "4294967296", "-9223372036854775809", "0.5")
PAYLOAD = "__import__('os').system('touch hacked')"
WORDS = (
    *NUMBERS,
    "true",
    "null",
    "",
    '""',
    "[]",
    "{}",
    "[[1]]",
    '"x"',
    "é",
    "\0",
    "../../etc/passwd",
    "9" * 400,
    PAYLOAD,
)
WORDS += ("${HOME}", "%s%n", "{0.__class__}", "<!--", "&a;", "package:os/", "[" * 300)
VALUES: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    2**63,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "text",
    "9" * 400,
    PAYLOAD,
    [],
    {},
    [[1]],
)
DEEP = 1200
TOKEN = re.compile(r"\"[^\"\n]*\"|[\w.+-]+|[^\w\s]")


def flipped(rng: random.Random, content: bytes) -> bytes:
    """Some bytes are others, are gone, or are there twice."""
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, n = rng.randrange(len(out) + 1), rng.choice((1, 1, 2, 4, 16, 256))
        how = rng.randrange(5)
        if how == 0:
            out[at : at + n] = rng.randbytes(len(out[at : at + n]))
        elif how == 1:
            del out[at : at + n]
        elif how == 2:
            out[at:at] = out[at : at + n]
        elif how == 3:
            out[at : at + n] = bytes([rng.choice((0, 255, 127, 128))]) * len(out[at : at + n])
        else:
            del out[rng.randrange(len(out) + 1) :]
    return bytes(out)


def reworded(rng: random.Random, content: bytes) -> bytes:
    """Some words or numbers of a text are others; some lines are gone, twice or elsewhere."""
    text = content.decode("utf-8", "replace")
    for _ in range(rng.choice((1, 1, 2, 5))):
        if rng.random() < 0.25:
            lines = text.splitlines(keepends=True)
            if lines:
                at = rng.randrange(len(lines))
                line = lines.pop(at)
                if rng.random() < 0.6:
                    where = rng.randrange(len(lines) + 1)
                    lines[where:where] = [line] * rng.choice((1, 2))
                text = "".join(lines)
            continue
        tokens = list(TOKEN.finditer(text))
        if not tokens:
            break
        found = rng.choice(tokens)
        old, how = found[0], rng.random()
        new = rng.choice(WORDS) if how < 0.6 else rng.choice(tokens)[0] if how < 0.8 else old * 2 if how < 0.9 else ""
        if old.startswith('"') and rng.random() < 0.7:
            new = json.dumps(new)
        text = text[: found.start()] + new + text[found.end() :]
    return text.encode("utf-8", "surrogatepass")


def changed_value(rng: random.Random, value: Any) -> Any:
    """Parts of a JSON value are others, missing or new."""
    own = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 1, 3))):
        own = _changed(rng, own)
    return own


def _changed(rng: random.Random, value: Any) -> Any:
    keys: list[Any] = (
        list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    )
    if not keys or rng.random() < 0.08:
        if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
            return value * rng.choice((-1, 2, 1e6, 1e-6)) + rng.choice((0, 1, -1))
        return copy.deepcopy(rng.choice(VALUES))
    key, how = rng.choice(keys), rng.random()
    if how < 0.1:
        del value[key]
    elif how < 0.15 and isinstance(value, dict):
        value[rng.choice(("", "x", "theta", "hand", key + " "))] = copy.deepcopy(value[key])
    elif how < 0.2 and isinstance(value, list):
        value.append(copy.deepcopy(value[key]))
    else:
        value[key] = _changed(rng, value[key])
    return value


def changed_json(rng: random.Random, content: bytes) -> bytes:
    """`changed_value` of a file, as JSON has it."""
    return json.dumps(changed_value(rng, json.loads(content))).encode()


def changed_xml(rng: random.Random, content: bytes) -> bytes:
    """Values of attributes are others; attributes and elements are gone, twice, elsewhere or deep. It stays XML."""
    root = ET.fromstring(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        elements = list(root.iter())
        _change_element(rng, rng.choice(elements), rng.choice(elements), root)
    return ET.tostring(root)


def _change_element(rng: random.Random, one: ET.Element, other: ET.Element, root: ET.Element) -> None:
    how = rng.randrange(12)
    if how < 6 and one.attrib:
        key = rng.choice(list(one.attrib))
        words = one.attrib[key].split() or [""]
        at = rng.randrange(len(words))
        words[at : at + 1] = [rng.choice((*NUMBERS, *NUMBERS, *WORDS, "", f"{words[at]} {words[at]}"))]
        one.attrib[key] = " ".join(words).replace("\0", "")
    elif how == 6 and one.attrib:
        del one.attrib[rng.choice(list(one.attrib))]
    elif how == 7 and other.attrib:
        key = rng.choice(list(other.attrib))
        one.set(key, other.attrib[key])
    elif how == 8:
        one.tag = other.tag
    elif how == 9 and not any(e is other for e in one.iter()):
        other.append(copy.deepcopy(one))
    elif how == 10 and rng.random() < 0.1:
        for _ in range(DEEP):
            one = ET.SubElement(one, other.tag)
    else:
        for parent in root.iter():
            if any(e is one for e in parent):
                parent.remove(one)
                break


def changed_hdf5(rng: random.Random, content: bytes) -> bytes:
    """Fields are gone, of another type or shape, or hold other numbers."""
    image = io.BytesIO(content)
    with h5py.File(image, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        for _ in range(rng.choice((1, 1, 2))):
            name = rng.choice(names)
            if name in file:
                _change_field(rng, file, name)
    return image.getvalue()


def _change_field(rng: random.Random, file: h5py.File, name: str) -> None:
    old, how = np.asarray(file[name][()]), rng.randrange(9)
    del file[name]
    if how == 0:
        return
    if how == 1:
        file.create_group(name)
    elif how == 2:
        file[name] = h5py.SoftLink(rng.choice(("/", f"/{name}", "/nowhere")))
    elif how == 3:
        file[name] = old.astype(rng.choice(("f2", "f4", "i1", "u8", "S5", "c16")))
    elif how == 4:
        file[name] = old[: rng.randrange(len(old) + 1)] if old.ndim else old[None]
    elif how == 5:
        file[name] = old.reshape(-1) if old.ndim > 1 else old[..., None]
    elif how == 6:
        file[name] = np.array(["a", PAYLOAD], dtype=h5py.string_dtype())
    elif how == 7:
        file.create_dataset(name, shape=(2**40,) if rng.random() < 0.5 else (2**20, 2**20), dtype="f8", chunks=True)
    else:
        flat = old.astype(float).reshape(-1)
        if flat.size:
            flat[rng.randrange(flat.size)] = rng.choice((np.nan, np.inf, -np.inf, 1e308, -1, 0, 2**62))
        with np.errstate(all="ignore"):
            file[name] = flat.reshape(old.shape).astype(old.dtype)


def changed_tensors(rng: random.Random, content: bytes) -> bytes:
    """The header of a safetensors file says other things; the numbers stay."""
    n = int.from_bytes(content[:8], "little")
    head = changed_json(rng, content[8 : 8 + n])
    size = len(head) if rng.random() < 0.9 else rng.choice((0, 2**62, len(head) - 1))
    return size.to_bytes(8, "little") + head + content[8 + n :]
