"""docs/start.md to the letter, where all is set up; `make people` starts from a clone."""

from __future__ import annotations

from pathlib import Path

import pytest
from followed import ROOT, follow, make_tree, roles

PAGE = roles((ROOT / "docs" / "start.md").read_text())
MADE = {"researcher": "first/predictions.csv", "firmware": "first/grasp", "tests": "reports/firmware.json"}


def test_there_is_a_section_for_each_user() -> None:
    assert PAGE.keys() == MADE.keys()


@pytest.mark.parametrize("role", MADE)
def test_a_section_leads_to_a_first_prediction(role: str, tmp_path: Path, people: dict[str, object]) -> None:
    """The folder's name holds what shells and make take apart."""
    tree = tmp_path / "it's a folder, größer"
    tree.mkdir()
    taken = [step for step, _ in follow(PAGE[role], make_tree(tree))]
    assert (tree / "build" / MADE[role]).is_file()
    people[f"snippets_in_start_{role}"] = len(taken) + sum(step.saves is not None for step in taken)
