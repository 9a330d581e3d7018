"""Figures that tests measure: `make test` collects them in build/reports/trust.json and people.json."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from aminn_base.files import write_json
from aminn_base.read import read_json

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


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write each report where AMINN_TRUST_REPORT or AMINN_PEOPLE_REPORT names a file."""
    for name, figures in session.config.stash.get(_reports, {}).items():
        if report := os.environ.get(f"AMINN_{name.upper()}_REPORT"):
            before = {"aims_missed": ""}
            if name == "people" and Path(report).is_file():
                before = read_json(Path(report), "a report")
            write_json(Path(report), before | figures)
