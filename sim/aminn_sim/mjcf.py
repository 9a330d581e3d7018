"""The files that an MJCF model is made of, read once: the engine gets these bytes and can open no others."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

from .errors import SimulationError

FOLDERS = {"texture": ("texturedir", "assetdir"), "": ("meshdir", "assetdir")}
"""Attributes of <compiler> that say where files of an element lie; "" stands for all others."""
NOWHERE = "/dev/null/"
"""Folder that the engine is told: nothing can lie in it, so what it is not given it does not find."""


@dataclass
class ModelFiles:
    """Content of every file that a scene refers to, and the references that lead to none."""

    scene: Path
    content: dict[Path, bytes] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)

    def by_name(self) -> dict[str, bytes]:
        """What the engine is given: it knows files by their names, without folders."""
        return {path.name: content for path, content in self.content.items()}


def read_model(scene: Path) -> ModelFiles:
    """Follow the includes of `scene` and its meshes, height fields, skins and textures, as the engine does.

    A file that is missing is left for the engine to name. Raises SimulationError where two files have one name, or
    where a file cannot be read.
    """
    found, roots, todo = ModelFiles(scene), [], [scene]
    while todo:
        path = todo.pop()
        if path in found.content or not _add(found, path):
            continue
        root = _root(found, path)
        roots.append(root)
        todo += [scene.parent / name for e in root.iter() if _tag(e) == "include" for name in _names(e)]
    told: dict[str, list[str]] = {key: [] for keys in FOLDERS.values() for key in keys}
    for compiler in (e for root in roots for e in root.iter() if _tag(e) == "compiler"):
        for key, value in compiler.attrib.items():
            told.get(key.lower(), []).append(value)
    for element in (e for root in roots for e in root.iter() if _tag(e) != "include"):
        folders = [f for key in FOLDERS.get(_tag(element), FOLDERS[""]) for f in told[key]] or [""]
        for name in _names(element):
            places = [scene.parent / folder / n for folder in folders for n in (name, Path(name).name)]
            existing = list(dict.fromkeys(p for p in places if p.is_file()))[:1]
            if not existing or not _add(found, existing[0]):
                found.lost.append(name)
    return found


def _tag(element: ET.Element) -> str:
    return element.tag.lower()  # the engine's own parser does not mind the case


def _names(element: ET.Element) -> list[str]:
    """Files that an element names: file, and of a texture's sides fileright, fileup and so on."""
    return [value for key, value in element.attrib.items() if key.lower().startswith("file")]


def _add(found: ModelFiles, path: Path) -> bool:
    """Read a file; False where there is none."""
    if path in found.content:
        return True
    if not path.is_file():
        return False
    for other in found.content:
        if other.name.lower() == path.name.lower() and not other.samefile(path):
            raise SimulationError(
                f"{found.scene}: refers to {other} and {path}; the engine tells files by their names alone, rename one"
            )
    try:
        found.content[path] = path.read_bytes()
    except OSError as error:
        raise SimulationError(f"{path}: cannot be read ({error.strerror})") from error
    return True


def _root(found: ModelFiles, path: Path) -> ET.Element:
    """The file's root element; what cannot be followed is on record, and the engine says what it thinks of it."""
    text = found.content[path]
    try:
        if re.search(rb"<!DOCTYPE", text, re.IGNORECASE):
            raise ET.ParseError("a document type may rename files")
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, LookupError):
        found.lost.append(str(path))
        return ET.Element("")
