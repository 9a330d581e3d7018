"""The report lists what is missing and what misses its aim; campaigns find what is planted."""

from __future__ import annotations

import copy
import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from aminn_base.files import write_json

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from mutate import VALUES, changed_value  # noqa: E402
from reliability import PARTS, main, missed  # noqa: E402


def test_what_is_missing_is_listed(tmp_path: Path) -> None:
    good = {"powercut_cuts": 5, "powercut_cuts_survived": 5, "fuzz_executions": 3e7, "x_seeds": 30, "x_seeds_found": 30}
    for name in PARTS:
        write_json(tmp_path / "parts" / f"{name}.json", good if name == "powercut" else {"aims_missed": ""})
    main(tmp_path / "parts", tmp_path / "all.json")
    assert json.loads((tmp_path / "all.json").read_text()) == good | {"aims_missed": ""}
    (tmp_path / "parts" / "soak_sim.json").unlink()
    main(tmp_path / "parts", tmp_path / "all.json")
    assert "soak_sim: no figures yet (make soak-sim)" in json.loads((tmp_path / "all.json").read_text())["aims_missed"]


@pytest.mark.parametrize(
    "figures",
    [{"a_cuts": 5, "a_cuts_survived": 4}, {"fuzz_files_broken": 1}, {"a_seeds": 3, "a_seeds_found": 2}],
)
def test_an_aim_that_is_missed_is_listed(figures: dict[str, float]) -> None:
    reached = {"fuzz_executions": 2e7, "b_seeds": 20}
    assert not list(missed(reached)) and len(list(missed(reached | figures))) == 1


def test_a_wrong_value_is_none_of_an_earlier_one() -> None:
    """Values that shared a list changed with each other, until one held itself."""
    before, rng, value = copy.deepcopy(VALUES), random.Random(0), {"a": [1, [2]], "b": {}}
    for _ in range(30_000):
        changed_value(rng, value)
    assert repr(before) == repr(VALUES)


def run(*words: str) -> str:
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    return done.stdout


def test_power_cuts_and_failing_calls(tmp_path: Path, trust: dict) -> None:
    """A sample of `make powercut`."""
    report = tmp_path / "powercut.json"
    only = ["--only", "import", "--only", "simulate_more"]
    run(str(HERE / "powercut.py"), "--work", str(tmp_path / "work"), "--sample", "3", "--report", str(report), *only)
    found = json.loads(report.read_text())
    for kind in ("cuts", "kills", "failures"):
        assert found[f"powercut_{kind}"] == found[f"powercut_{kind}_survived"] == 6
    trust |= found


def test_wrong_files(tmp_path: Path, trust: dict) -> None:
    """A few seconds of `make fuzz-files`."""
    report, only = (
        tmp_path / "fuzz.json",
        [
            w
            for name in ("manifest", "shard", "calibration", "grid", "table_hdf5", "convert_urdf")
            for w in ("--only", name)
        ],
    )
    run(str(HERE / "fuzz_files.py"), "--work", str(tmp_path / "work"), "--seconds", "5", "--report", str(report), *only)
    found = json.loads(report.read_text())
    assert found["fuzz_files_refused"] > 5 and found["fuzz_files_broken"] == 0
    trust |= found
