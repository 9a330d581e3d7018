"""`make calibrate` in a reduced form: every figure of its report, and a second call that finds everything done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aminn_app.calibrate_study import Scale, missed, study

TINY = Scale(
    train_grasps=24, reference_grasps=4, cases=6, validation_hands=2, validation_grasps=4, test_hands=2, grasps=6,
    epochs=1, seeds=1, mistakes=2, only=("load_sign",), tune_steps=(0, 2), budgets=((4, 2), (6, 3)), device=False,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


def test_reduced_study(folder: Path) -> None:
    told: list[str] = []
    report = study(folder, TINY, 1, told.append)
    assert [line for line in told if line.startswith("==")]
    figures = ("relative_error_median", "relative_error_p90", "f1", "full_work_violations", "worst_hand_median")
    starts = [*("known", "uncalibrated", "untold_known", "mlp_known")]
    for n in (4, 6):
        for start in ("pushes", "noise1", "radius", "zeros", "mlp", "untold"):
            starts += [f"{start}_{n}_{when}" for when in ("before", "after", "known")]
        starts += [f"aminn_tuned_{n}", f"mlp_tuned_{n}"]
    missing = [f"{start}_{figure}" for start in starts for figure in figures if f"{start}_{figure}" not in report]
    assert not missing
    assert all(report[f"{start}_full_work_violations"] == 0 for start in starts if "mlp" not in start)
    assert report["mistake_clean_sets"] == report["mistake_load_sign_sets"] == 2
    assert isinstance(report["aims_missed"], str)
    text = json.dumps(report)  # NaN, where no grasp of so few slid, is not equal to itself
    assert json.dumps(json.loads(text)) == text
    again = study(folder, TINY, 1, lambda line: None)
    assert json.dumps(again) == text


def test_aims_are_named_where_they_are_missed(folder: Path) -> None:
    report = study(folder, TINY, 1, lambda line: None)
    good = {k: 0.0 for k in report} | {"reference_f1": 0.9, "known_f1": 0.9, "mistake_clean_sets": 2}
    for n in (4, 6):
        good |= {f"pushes_{n}_coverage_90": 0.9}
    for key in report:
        if key.startswith("mistake_") and key.endswith(("_sets", "_named")) and "clean" not in key:
            good[key] = 100
    assert missed(good, TINY) == []
    bad = {"known_relative_error_median": 1.0, "pushes_4_after_relative_error_median": 1.0, "pushes_6_worse_hands": 1,
           "pushes_6_coverage_90": 1.0, "mistake_load_sign_named": 94, "mistake_clean_named": 1,
           "known_full_work_violations": 1, "known_f1": 0.8, "known_ratio_to_reference": 3.0}  # fmt: skip
    for key, value in bad.items():
        assert len(missed(good | {key: value}, TINY)) == 1, key
