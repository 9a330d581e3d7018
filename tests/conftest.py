"""Figures that tests measure: `make test` collects them in build/reports/trust.json."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from aminn_base.files import write_json

Figures = dict[str, float | int | str | bool]
_trust = pytest.StashKey[Figures]()


@pytest.fixture(scope="session", autouse=True)
def runtimes_of_other_hands() -> Iterator[None]:
    """Kept in the build folder, so that they are compiled once and no home folder is written to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(Path(__file__).resolve().parent.parent / "build" / "cache"))
        yield


@pytest.fixture(scope="session")
def trust(request: pytest.FixtureRequest) -> Figures:
    """Flat figures of the report; a test that shows something adds what it found under a name of its own."""
    return request.config.stash.setdefault(_trust, {})


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the report where AMINN_TRUST_REPORT names a file."""
    figures, report = session.config.stash.get(_trust, {}), os.environ.get("AMINN_TRUST_REPORT")
    if figures and report:
        write_json(Path(report), {"aims_missed": ""} | figures)
