"""An MJCF file as one text without includes, for the engine to compile from memory, and edits of it.

A hand's own file is never changed: what the hand file tells (locked joints, dropped friction, servos, couplings) and
what a check adds (a tool, the solver's options) is written into the text.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator
from pathlib import Path

from aminn_base.errors import AminnError

Element = ET.Element
# Elements whose `file` is an asset, and the compiler's attribute that names its folder.
ASSET_FOLDERS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


def _parse(path: Path, seen: tuple[Path, ...] = ()) -> Element:
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise AminnError(f"{path}: cannot be read ({error.strerror})") from error
    except ET.ParseError as error:
        raise AminnError(f"{path}: not XML ({error})") from error
    if path in seen:
        raise AminnError(f"{path}: includes itself")
    return root


def _expanded(element: Element, folder: Path, seen: tuple[Path, ...]) -> Iterator[Element]:
    """The element, or what its include stands for; paths of includes are relative to the main file, as in MuJoCo."""
    if element.tag == "include":
        path = (folder / element.get("file", "")).resolve()
        for child in _parse(path, seen):
            yield from _expanded(child, folder, (*seen, path))
        return
    children = [c for child in list(element) for c in _expanded(child, folder, seen)]
    element[:] = children
    yield element


def read_mjcf(path: Path, hand_file: Path | None = None) -> Element:
    """The model as one tree: includes are expanded, files of assets have absolute paths. Raises AminnError."""
    root = _parse(path)
    if root.tag == "robot":
        raise AminnError(
            f"{path}: a URDF; aminn hand convert {hand_file or path} --out FOLDER makes an MJCF of it, without the "
            "stiffness and the actuators that a URDF lacks"
        )
    if root.tag != "mujoco":
        raise AminnError(f"{path}: <{root.tag}> is no MuJoCo model; an MJCF file begins with <mujoco>")
    next(_expanded(root, path.parent, (path.resolve(),)))
    folders: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        folders |= {
            key: compiler.attrib.pop(key) for key in ("meshdir", "texturedir", "assetdir") if key in compiler.keys()
        }
    for element in root.iter():
        if element.tag in ASSET_FOLDERS and element.get("file"):
            folder = folders.get(ASSET_FOLDERS[element.tag], folders.get("assetdir", ""))
            element.set("file", str((path.parent / folder / element.get("file", "")).resolve()))
    return root


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
