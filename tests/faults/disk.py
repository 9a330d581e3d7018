"""What a cut of power leaves on a disk, worked out from the record of interpose.c.

A file system promises little: content is there for sure after the file's fsync, a name after its folder's, and what was
not synced may be there wholly, in part or not at all, in any order. `Disk` follows a program call by call and gives
the states that a cut at this moment may leave.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

HEAD = struct.Struct("=cqqqq")
Tree = dict[str, bytes | None]
"""Content of each file by its path below the top, "/" between; None: a folder."""


@dataclass(frozen=True)
class Call:
    """One entry of the record; paths are below the watched folder, "" itself."""

    what: str
    handle: int
    offset: int
    path: str
    rest: bytes

    @property
    def target(self) -> str:
        """Of a rename."""
        return self.rest.decode()


def read_record(file: Path, top: Path) -> list[Call]:
    """The calls of a program that changed something below `top`."""
    raw, at, calls = file.read_bytes(), 0, []
    while at < len(raw):
        what, handle, offset, n_path, n_rest = HEAD.unpack_from(raw, at)
        at += HEAD.size
        path, rest = raw[at : at + n_path].decode(), raw[at + n_path : at + n_path + n_rest]
        at += n_path + n_rest
        if what == b"r":
            rest = _below(rest.decode(), top).encode()
        calls.append(Call(what.decode(), handle, offset, _below(path, top) if path else "", rest))
    return calls


def _below(path: str, top: Path) -> str:
    return "" if path == str(top) else os.path.relpath(path, top)


def read_tree(top: Path) -> Tree:
    """What is there."""
    found = sorted(top.rglob("*"))
    return {str(p.relative_to(top)): p.read_bytes() if p.is_file() else None for p in found}


def write_tree(tree: Tree, top: Path) -> None:
    """Put it there; `top` is new."""
    top.mkdir(parents=True)
    for name in sorted(tree):
        content = tree[name]
        if content is None:
            (top / name).mkdir(parents=True, exist_ok=True)
        else:
            (top / name).parent.mkdir(parents=True, exist_ok=True)
            (top / name).write_bytes(content)


@dataclass(eq=False)
class Node:
    """A file (or a folder, whose content stays empty): as it is, and as it is for sure."""

    is_folder: bool
    now: bytearray = field(default_factory=bytearray)
    sure: bytes = b""
    closed: bool = True


@dataclass(frozen=True)
class Step:
    """A change of names: `node` appears at `to`, what was at `gone` disappears."""

    to: str | None
    gone: str | None
    node: Node | None

    @property
    def folders(self) -> set[str]:
        """Where the names are."""
        return {os.path.dirname(p) for p in (self.to, self.gone) if p is not None}


Names = dict[str, Node]


def _stepped(names: Names, step: Step) -> None:
    moved = {}
    if step.gone is not None:
        under = [p for p in names if p == step.gone or p.startswith(step.gone + "/")]
        moved = {p[len(step.gone) :]: names.pop(p) for p in under}
    if step.to is not None and step.node is not None:
        names.update({step.to + rest: node for rest, node in moved.items()})
        names[step.to] = step.node


def _is_reached(names: Names, path: str) -> bool:
    """Whether the folders above have names too."""
    folder = os.path.dirname(path)
    return not folder or (folder in names and _is_reached(names, folder))


class Disk:
    """The watched folder while a program runs."""

    def __init__(self, start: Tree) -> None:
        self.sure: Names = {}
        for path, content in start.items():
            self.sure[path] = Node(content is None, bytearray(content or b""), content or b"")
        self.names = dict(self.sure)
        self.pending: list[Step] = []
        self.open: dict[int, tuple[str, Node | None]] = {}
        self.whole: dict[str, set[bytes]] = {p: {c} for p, c in start.items() if c is not None}
        """Contents that each file has had when it was complete: got its name, or was closed."""

    def follow(self, call: Call) -> None:
        """The disk after a call."""
        if call.what == "o":
            node = self.names.get(call.path)
            if node is None and call.path:
                node = Node(False)
                self._step(Step(call.path, None, node))
            if node is not None and call.offset == 0:
                node.now.clear()
            self.open[call.handle] = (call.path, node)
        elif call.what == "m":
            self._step(Step(call.path, None, Node(True)))
        elif call.what == "u":
            self._step(Step(None, call.path, None))
        elif call.what == "r":
            node = self.names[call.path]
            self._step(Step(call.target, call.path, node))
            self._complete()
        else:
            self._at_handle(call)

    def _step(self, step: Step) -> None:
        _stepped(self.names, step)
        self.pending.append(step)

    def _at_handle(self, call: Call) -> None:
        path, node = self.open[call.handle]
        if call.what == "w" and node is not None:
            end = call.offset + len(call.rest)
            node.now.extend(bytes(max(0, end - len(node.now))))
            node.now[call.offset : end] = call.rest
            node.closed = False
        elif call.what == "t" and node is not None:
            node.now[:] = node.now[: call.offset].ljust(call.offset, b"\0")
        elif call.what == "s":
            self._sync(path, node)
        elif call.what == "c":
            del self.open[call.handle]
            if node is not None:
                node.closed = True
                self._complete()

    def _sync(self, path: str, node: Node | None) -> None:
        if node is not None and not node.is_folder:
            node.sure = bytes(node.now)
            return
        for step in [s for s in self.pending if path in s.folders]:
            _stepped(self.sure, step)
            self.pending.remove(step)

    def _complete(self) -> None:
        for path, node in self.names.items():
            if not node.is_folder and node.closed:
                self.whole.setdefault(path, set()).add(bytes(node.now))

    def tree(self) -> Tree:
        """What a program sees now."""
        return _tree(self.names, lambda node: bytes(node.now))

    def for_sure(self) -> Tree:
        """What a cut of power now leaves in the worst case."""
        return _tree(self.sure, lambda node: node.sure)

    def cuts(self) -> Iterator[tuple[str, Tree]]:
        """(what became of what was not synced, the disk) after a cut of power now."""
        every, sure = self.names, self.sure
        yield "all kept", self.tree()
        yield "nothing kept", self.for_sure()
        yield "names kept, content not", _tree(every, lambda node: node.sure)
        yield "names kept, content half", _tree(every, _torn)
        yield "content kept, names not", _tree(sure, lambda node: bytes(node.now))
        for k in range(len(self.pending)):
            names = dict(sure)
            for step in (*self.pending[:k], *self.pending[k + 1 :]):
                _stepped(names, step)
            yield f"without change of names {k + 1} of {len(self.pending)}", _tree(names, lambda node: node.sure)


def _torn(node: Node) -> bytes:
    """The first half of what is new, then zeros."""
    now = bytes(node.now)
    return now if now == node.sure else now[: len(now) // 2].ljust(len(now), b"\0")


def _tree(names: Names, content: Callable[[Node], bytes]) -> Tree:
    reached = {path: node for path, node in sorted(names.items()) if _is_reached(names, path)}
    return {path: None if node.is_folder else content(node) for path, node in reached.items()}
