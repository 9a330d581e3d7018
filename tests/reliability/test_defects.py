"""The seeded defects are still changes of what stands in the runtime."""

from __future__ import annotations

import pytest
from defects import DEFECTS, RUNTIME, Defect


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.name)
def test_there_is_something_to_change(defect: Defect) -> None:
    assert defect.sound in (RUNTIME / defect.file).read_text()
