"""Files that are written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

from aminn_base.files import write_json


def test_a_report_is_written_whole_into_a_new_folder(tmp_path: Path) -> None:
    write_json(tmp_path / "new" / "sim.json", {"b": 1.0, "a": "x", "c": float("nan")})
    assert json.loads((tmp_path / "new" / "sim.json").read_text()) == {"a": "x", "b": 1.0, "c": None}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["sim.json"]
