"""What compares a prediction's cost with an earlier build's."""

from __future__ import annotations

from pathlib import Path

import pytest

from aminn_base.errors import AminnError
from aminn_export.files.bin_model import bin_model_bytes, read_bin_model
from aminn_export.files.hand_header import write_hand_header
from aminn_export.files.tables import dims_of
from aminn_export.judge.cost import ROOT, judged, stuck_model, work_tree

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


def test_an_unknown_commit_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(AminnError, match="checking out no-such-commit failed"),
        work_tree("no-such-commit", tmp_path / "t"),
    ):
        pass
    assert not (tmp_path / "t").exists()
