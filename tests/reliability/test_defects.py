"""The seeded defects are still changes of what stands in runtime and simulator."""

from __future__ import annotations

import pytest
import races
from defects import DEFECTS, RUNTIME, Defect


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.name)
def test_there_is_something_to_change(defect: Defect) -> None:
    assert defect.sound in (RUNTIME / defect.file).read_text()


@pytest.mark.parametrize("race", races.DEFECTS)
def test_there_is_a_race_to_make(race: str) -> None:
    file, sound, defect = races.DEFECTS[race]
    text = (races.SIM / file).read_text()
    assert races.changed(race, text) == text.replace(sound, defect) != text
