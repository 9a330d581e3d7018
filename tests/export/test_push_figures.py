"""What learning costs on the device, as `make calibrate` reports it."""

from __future__ import annotations

from pathlib import Path

import pytest

from aminn_export.judge import push_figures as judge
from aminn_export.replay.targets import TARGETS

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
BOARD = {
    "pushes": 34,
    "calibration_crc": 7,
    "instructions_per_push": 138_000,
    "instructions_push_worst": 139_000,
    "instructions_per_prediction": 77_000,
    "calibration_bytes": 236,
    "calibrator_bytes": 692,
    "stack_push_bytes": 3632,
    "stack_predict_bytes": 2736,
}


@pytest.mark.parametrize(
    ("changed", "missed"),
    [
        ({}, ""),
        ({"calibration_crc": 8}, "device: the targets learn other bits of theta"),
        ({"instructions_per_push": 160_000}, "device: a push takes 2.08 predictions on cortex_m7"),
        ({"calibrator_bytes": 2000}, "device: learning takes 2660 bytes on cortex_m7"),
    ],
)
def test_cost_and_bits_are_judged(monkeypatch, tmp_path: Path, changed: dict, missed: str) -> None:
    def replayed(names, *_):
        return {name: (tmp_path, BOARD | changed if name == "cortex_m7" else BOARD) for name in names}

    monkeypatch.setattr(judge, "replay_all", replayed)
    out = judge.push_figures(GOLDEN, GOLDEN / "golden.bin", tmp_path, targets=("x86_64_gcc_O2", "cortex_m7"))
    assert out["device_aims_missed"] == missed
    assert out["device_targets"] == 2 and out["device_pushes"] == 34
    if not changed:
        assert out["device_cortex_m7_push_predictions"] == 1.792
        assert out["device_cortex_m7_push_ram_bytes"] == 1352


def test_only_targets_that_can_be_built_are_taken(monkeypatch) -> None:
    assert set(judge.available()) <= set(TARGETS)
    monkeypatch.setattr(judge.shutil, "which", lambda name: name if name in ("gcc", "g++") else None)
    assert all(name.startswith("x86_64_gcc") for name in judge.available()) and judge.available()
