"""docs/your-hand.md to the letter: its hand, saved as it says, goes from the model to a replayed C model."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from followed import ROOT, commands, files, make_place

pytestmark = pytest.mark.long

PAGE = (ROOT / "docs" / "your-hand.md").read_text()
WALK = PAGE.split("## From a model to a replayed C model")[1].split("\n## ")[0]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_place(tmp_path_factory.mktemp("walk"), WALK)


def test_the_page_leads_from_a_model_to_a_replayed_c_model(place: Path, people: dict[str, object]) -> None:
    assert len(files(WALK)) == 2
    lines = commands(WALK)
    words = [line.split()[1] for line in lines]
    assert words == ["hand", "simulate", "train", "train", "evaluate", "export", "verify"]
    for line in lines:
        done = subprocess.run(shlex.split(line), cwd=place, capture_output=True, text=True)
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        if " hand check " in line:
            assert done.stdout.splitlines()[-1] == "accepted"
    exported = place / "build" / "tripod" / "export"
    header = (exported / "aminn_hand.h").read_text()
    for name, count in {"BRANCH": 3, "COORD": 3, "JOINT": 9, "GATED": 0}.items():
        assert re.search(rf"#define AMINN_N_{name} +{count}\b", header), header
    people["snippets_in_your_hand"] = len(lines) + len(files(WALK))
