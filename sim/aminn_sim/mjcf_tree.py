"""An MJCF model as one tree without includes, for the engine to compile from memory, and edits of it.

Every file that the model is made of is read once: the engine gets these bytes and can open no others. Skins and
textures, which no mechanics has, are left out of what it gets. A hand's own files are never changed: what the hand file
tells (locked joints, dropped friction, servos, couplings) and what a simulation adds (a base, a tool, the solver's
options) is written into the tree.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from aminn_base.errors import AminnError
from aminn_base.read import is_file

from .field_check import WHOLE, check_field_file, check_field_size
from .mesh_check import check_mesh_file, check_mesh_text

Element = ET.Element
FOLDERS = {"texture": ("texturedir", "assetdir"), "": ("meshdir", "assetdir")}
"""Attributes of <compiler> that say where files of an element lie; "" stands for all others."""
MAX_DEPTH = 200
"""Of elements; a finger of 20 links is 25 deep."""
CHECKS = {"mesh": ("mesh", check_mesh_file), "hfield": ("height field", check_field_file)}
"""What the file of an asset is, and how it is checked: MuJoCo 2.2.2 may end the process on a wrong one. These are
called after their file where they have no name."""
LOOKS = ("skin", "texture")
"""Assets that nothing but a picture shows: MuJoCo 2.2.2 may end the process on a wrong one, and is given none."""

MAX_INCLUDES = 1000
"""Of a model, those that lie in each other among them."""
COPIES = ("composite", "replicate", "flexcomp")
"""Elements that stand for as many copies as the product of their `count`."""
MAX_COPIES = 1000
"""Of an element, in all that it lies in."""
MAX_KEPT = 10_000
"""Of numbers that a model keeps for each of its elements (`nuser_...`), and of keyframes."""


@dataclass
class Model:
    """A model and the files that it is made of."""

    root: Element
    """Refers to assets by the names of `assets`."""
    assets: dict[str, bytes] = field(default_factory=dict)
    """What the engine is given beside the text."""
    files: dict[Path, bytes] = field(default_factory=dict)
    """Every file that was read, as it was then."""


def _read(path: Path, files: dict[Path, bytes]) -> bytes:
    try:
        return files.setdefault(path, path.read_bytes())
    except OSError as error:
        raise AminnError(f"{path}: cannot be read ({error.strerror})") from error


def parse(path: Path, content: bytes) -> Element:
    """The tree in an XML file. Raises AminnError where it is no XML, or too deep."""
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:  # also of an encoding that it names
        raise AminnError(f"{path}: not XML ({error})") from error
    refuse_deep(path, root)
    return root


def refuse_deep(path: Path, root: Element) -> None:
    """Raise AminnError where elements lie deeper in each other than a tree of Python's can be walked and written."""
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise AminnError(f"{path}: elements lie more than {MAX_DEPTH} deep in each other, in <{level[0].tag}>")


def refuse_large(path: Path, root: Element) -> None:
    """Raise AminnError where a few digits ask for more than an engine survives: it may end the process, or never."""
    for element in root.iter("size"):
        for key, text in element.attrib.items():
            if (key == "nkey" or key.startswith("nuser_")) and _whole(text) > MAX_KEPT:
                raise AminnError(f"{path}: <size {key}={text[:40]!r}>: more than {MAX_KEPT} are not taken")
    for element in root.iter("hfield"):
        try:
            if not element.get("file"):
                check_field_size(element.get("nrow", ""), element.get("ncol", ""))
        except ValueError as error:
            raise AminnError(f"{path}: <hfield> {element.get('name', '')!r}: {error}") from error
    level = [(root, 1)]
    while level:
        element, copies = level.pop()
        if element.tag in COPIES:
            for text in element.get("count", "").split():
                copies *= max(1, _whole(text))
            if copies > MAX_COPIES:
                raise AminnError(
                    f"{path}: <{element.tag} count={element.get('count', '')[:40]!r}> makes {copies} copies; "
                    f"{MAX_COPIES} are taken, with those of what it lies in"
                )
        level += [(child, copies) for child in element]


def refuse_large_file(path: Path) -> None:
    """The same of an MJCF that another engine reads. What cannot be read here is left to that."""
    files: dict[Path, bytes] = {}
    root = _parse(path, files)
    with suppress(AminnError, RecursionError):
        _expand(root, path, files)
    refuse_large(path, root)


def _whole(text: str) -> int:
    """0 of what is no whole number, which an engine refuses."""
    return int(text) if WHOLE.fullmatch(text) else 0


def _parse(path: Path, files: dict[Path, bytes], seen: tuple[Path, ...] = ()) -> Element:
    root = parse(path, _read(path, files))
    if path.resolve() in seen:
        raise AminnError(f"{path}: includes itself")
    for element in root.iter():  # the engine's own parser does not mind the case of a tag
        element.tag = element.tag.lower()
    return root


def _expand(root: Element, path: Path, files: dict[Path, bytes]) -> None:
    """Put what they stand for in the place of includes, whose paths are relative to the model, as in MuJoCo."""
    met = count(1)

    def expanded(element: Element, seen: tuple[Path, ...]) -> Iterator[Element]:
        if element.tag == "include":
            file = path.parent / element.get("file", "")
            if next(met) > MAX_INCLUDES:  # ten files that include each other twice stand for a thousand
                raise AminnError(f"{file}: one more include; {MAX_INCLUDES} are taken, with those within each other")
            for child in _parse(file, files, seen):
                yield from expanded(child, (*seen, file.resolve()))
            return
        element[:] = [c for child in list(element) for c in expanded(child, seen)]
        yield element

    next(expanded(root, (path.resolve(),)))


def read_mjcf(path: Path, hand_file: Path | None = None) -> Model:
    """The model in `path`: includes are expanded, assets are read. Raises AminnError that names a file."""
    files: dict[Path, bytes] = {}
    root = _parse(path, files)
    if root.tag == "robot":
        raise AminnError(
            f"{path}: a URDF; aminn hand convert {hand_file or path} --out FOLDER makes an MJCF of it, without the "
            "stiffness and the actuators that a URDF lacks"
        )
    if root.tag != "mujoco":
        raise AminnError(f"{path}: <{root.tag}> is no MuJoCo model; an MJCF file begins with <mujoco>")
    try:
        _expand(root, path, files)
    except RecursionError as error:
        raise AminnError(f"{path}: its includes lie too deep in each other") from error
    refuse_deep(path, root)
    refuse_large(path, root)
    model = Model(root, files=files)
    told: dict[str, list[str]] = {key: [] for keys in FOLDERS.values() for key in keys}
    for compiler in root.iter("compiler"):
        for key in [k for k in compiler.keys() if k in told or k == "strippath"]:
            told.get(key, []).append(compiler.attrib.pop(key))
    for element in root.iter():
        folders = [f for key in FOLDERS.get(element.tag, FOLDERS[""]) for f in told[key]] or [""]
        for key, name in [(k, v) for k, v in element.attrib.items() if k.startswith("file")]:
            places = [path.parent / folder / n for folder in folders for n in (name, Path(name).name)]
            found = next((p for p in places if is_file(p)), None)
            if found is None:
                raise AminnError(f"{path}: <{element.tag}> names the file {name}, which is not there ({places[0]})")
            content = _read(found, files)
            if element.tag in LOOKS:
                continue
            own = f"{len(model.assets)}_{found.name[-80:]}"
            model.assets[own] = content
            _check_file(element.tag, found, content)
            element.set(key, own)
            if element.tag in CHECKS and key == "file" and not element.get("name"):
                element.set("name", Path(name).stem)
    for element in root.iter():
        try:
            if element.tag == "mesh" and element.get("face") and not element.get("file"):
                check_mesh_text(element.get("vertex", ""), element.get("face", ""))
        except ValueError as error:
            raise AminnError(f"{path}: <{element.tag}> {element.get('name', '')!r}: {error}") from error
    _leave_out_looks(root)
    return model


def _check_file(tag: str, path: Path, content: bytes) -> None:
    """Raise AminnError where the engine cannot read the file of an asset, and might end the process."""
    if tag not in CHECKS:
        return
    what, check = CHECKS[tag]
    try:
        check(path.suffix, content)
    except ValueError as error:
        raise AminnError(f"{path}: not a {what} that the engine can read: {error}") from error


def _leave_out_looks(root: Element) -> None:
    """Take skins and textures out, and what names them."""
    remove(root, [e for section in root.iter("asset") for e in section if e.tag in LOOKS])
    for material in root.iter("material"):
        material.attrib.pop("texture", None)
    for names in root.iter("tuple"):
        remove(names, [e for e in names if e.get("objtype") in LOOKS])


def text_of(root: Element) -> str:
    """For the engine."""
    return ET.tostring(root, encoding="unicode")


def remove(root: Element, unwanted: Collection[Element]) -> None:
    """Take elements out of the tree, wherever they are."""
    ids = {id(e) for e in unwanted}
    for parent in list(root.iter()):
        for child in [c for c in parent if id(c) in ids]:
            parent.remove(child)


def remove_joints(root: Element, names: Collection[str]) -> None:
    """Take joints out, and every actuator, tendon and equality that would miss one: these joints do not move."""
    if not names:
        return
    gone = [e for e in root.iter() if e.tag in ("joint", "freejoint") and e.get("name") in names]
    gone = [e for body in root.iter("body") for e in body if e in gone]
    referring = ("joint", "joint1", "joint2", "jointinparent")
    sections = [s for tag in ("actuator", "equality", "sensor") for s in root.iter(tag)]
    gone += [e for s in sections for e in s if any(e.get(a) in names for a in referring)]
    for section in root.iter("tendon"):
        for tendon in section:
            parts = [p for p in tendon if p.tag == "joint" and p.get("joint") in names]
            remove(tendon, parts)
            if tendon.tag == "fixed" and len(tendon) == 0:
                gone.append(tendon)
    dead = {e.get("name") for e in gone if e.tag == "fixed"}
    gone += [e for s in sections for e in s if dead & {e.get(a) for a in ("tendon", "tendon1", "tendon2")} - {None}]
    remove(root, gone)


def section(root: Element, tag: str) -> Element:
    """The first section of this name, made if there is none."""
    found = root.find(tag)
    return found if found is not None else ET.SubElement(root, tag)
