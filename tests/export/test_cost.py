"""What compares a prediction's cost with an earlier build's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aminn_base.errors import AminnError
from aminn_export.files.bin_model import bin_model_bytes, read_bin_model
from aminn_export.files.hand_header import write_hand_header
from aminn_export.files.tables import dims_of
from aminn_export.judge.cost import ROOT, gathered, judged, stuck_model, work_tree

GOLDEN = ROOT / "tests" / "golden"


def test_stuck_model_has_the_layer_without_slides_and_the_same_widths(tmp_path: Path) -> None:
    model = read_bin_model(GOLDEN / "aminn_model.bin")
    plain = stuck_model(model)
    dims = dims_of(plain)
    assert not dims.slides and not dims.sensing and dims.tendons == dims_of(model).tendons
    assert plain.tensors["s1.trunk2_w"].shape == model.tensors["s1.trunk2_w"].shape
    assert len(bin_model_bytes(plain)) < len(bin_model_bytes(model))
    assert "#define AMINN_N_SLIDE 0" in write_hand_header(plain, tmp_path).read_text()


def test_ratios_are_to_the_earlier_build_and_each_missed_aim_is_named() -> None:
    report = judged(
        {"base_instructions": 100, "stuck_instructions": 50, "sliding_instructions": 70, "sliding_model_int8_bytes": 1}
    )
    assert report["stuck_instructions_ratio"] == 0.5
    assert report["sliding_to_stuck_instructions"] == pytest.approx(1.4)
    assert report["aims_missed"] == "sliding_to_stuck_instructions"


def test_figures_of_other_reports_are_taken_over_and_missing_ones_named(tmp_path: Path) -> None:
    (tmp_path / "step.json").write_text(json.dumps({"ratio": 2.5, "paper_layer_ratio": 1.5, "other": 1}))
    (tmp_path / "bench.json").write_text(json.dumps({"batch_runtime_to_onnx_ratio": 9.0}))
    found = gathered(tmp_path)
    assert found["step_ratio"] == 2.5 and "other" not in found
    assert found["not_measured"] == "labels_wall_to_system, runtime_to_floor_ratio, runtime_to_compiler_ratio"
    report = judged(found | {"base_instructions": 100, "stuck_instructions": 50, "sliding_instructions": 60})
    assert report["aims_missed"] == "step_ratio, batch_runtime_to_onnx_ratio"


def test_an_unknown_commit_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(AminnError, match="checking out no-such-commit failed"),
        work_tree("no-such-commit", tmp_path / "t"),
    ):
        pass
    assert not (tmp_path / "t").exists()
