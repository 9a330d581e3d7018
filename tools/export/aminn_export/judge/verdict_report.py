"""What a comparison found, told as lines, as JSON and as JUnit."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from aminn_base.files import write_atomically, write_json

from .verdict import Failure

JSON_FAILURES = 10_000
"""At most so many are listed, worst first; their number is always given."""
JUNIT_FAILURES = 20
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Case:
    """One thing that was checked."""

    group: str
    """Whose: a target, the files."""
    name: str
    failures: Sequence[Failure | str]
    """What is wrong with it; empty if nothing is."""


def shown(failures: Sequence[Failure | str], n: int) -> list[str]:
    """Lines: the first n, and how many there are where that is more."""
    lines = [str(f) for f in failures[:n]]
    if len(failures) > n:
        lines.append(f"{len(failures)} in all")
    return lines


def write_verdict(path: Path, figures: Mapping[str, object], failures: Sequence[Failure]) -> None:
    """Write flat figures, and the numbers that differ under "differences", as JSON."""
    write_json(path, dict(figures) | {"differences": [f.record() for f in failures[:JSON_FAILURES]]})


def write_junit(path: Path, suite: str, cases: Sequence[Case]) -> None:
    """Write a JUnit file with one suite."""
    failed = sum(bool(case.failures) for case in cases)
    counts = {"tests": str(len(cases)), "failures": str(failed), "errors": "0"}
    root = ElementTree.Element("testsuites")
    element = ElementTree.SubElement(root, "testsuite", {"name": suite} | counts)
    for case in cases:
        names = {"classname": f"{suite}.{case.group}", "name": case.name}
        entry = ElementTree.SubElement(element, "testcase", {k: _NOT_XML.sub("?", v) for k, v in names.items()})
        if case.failures:
            failure = ElementTree.SubElement(entry, "failure", {"message": f"{len(case.failures)} differ"})
            failure.text = _NOT_XML.sub("?", "\n".join(shown(case.failures, JUNIT_FAILURES)))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, ElementTree.tostring(root, "utf-8", xml_declaration=True) + b"\n")
