"""Figures that tests measure: `make test` collects them in build/reports/trust.json and people.json."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from aminn_base.files import write_json
from aminn_base.read import read_json

if TYPE_CHECKING:
    from xdist.workermanage import WorkerController

Figures = dict[str, float | int | str | bool]
_reports = pytest.StashKey[dict[str, Figures]]()


@pytest.fixture(scope="session", autouse=True)
def runtimes_of_other_hands() -> Iterator[None]:
    """Kept in the build folder, so that they are compiled once and no home folder is written to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(Path(__file__).resolve().parent.parent / "build" / "cache"))
        yield


def _figures(config: pytest.Config, report: str) -> Figures:
    return config.stash.setdefault(_reports, {}).setdefault(report, {})


@pytest.fixture(scope="session")
def trust(request: pytest.FixtureRequest) -> Figures:
    """Flat figures of the report; a test that shows something adds what it found under a name of its own."""
    return _figures(request.config, "trust")


@pytest.fixture(scope="session")
def people(request: pytest.FixtureRequest) -> Figures:
    """The same of package forms, examples and snippets; the figures of `make people` stay beside them."""
    return _figures(request.config, "people")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest, so that workers end together."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: WorkerController, error: object) -> None:
    """Add what a worker of pytest-xdist found; what several of them count is added up."""
    for name, found in json.loads(getattr(node, "workeroutput", {}).get("figures", "{}")).items():
        figures = _figures(node.config, name)
        figures.update({key: figures[key] + value if key in figures else value for key, value in found.items()})


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write each report where AMINN_TRUST_REPORT or AMINN_PEOPLE_REPORT names a file; a worker sends its part."""
    reports = session.config.stash.get(_reports, {})
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["figures"] = json.dumps(reports)
        return
    for name, figures in reports.items():
        if report := os.environ.get(f"AMINN_{name.upper()}_REPORT"):
            before = {"aims_missed": ""}
            if name == "people" and Path(report).is_file():
                before = read_json(Path(report), "a report")
            write_json(Path(report), before | figures)
