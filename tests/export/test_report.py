"""The report page: self-contained, complete with what it is given, and readable where figures are missing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from page_checks import faults, watch_labels
from synthetic import closure, draw_inputs, hand

from aminn.evaluation.metrics import operating_curve, refusal_curve, reliability
from aminn.pages.grasp_picture import GraspPicture, branch_points, draw_grasp, magnification, tool_faces
from aminn.pages.other_reports import told_reports
from aminn.pages.report import (
    ReportInputs,
    conclusion,
    difference_table,
    format_value,
    pictures,
    read_reports,
    result_table,
    write_report,
)
from aminn_base.errors import AminnError
from aminn_base.page import data_uri
from aminn_hand.hand import rotation

RNG = np.random.default_rng(0)
ALONG_X = [0.5**0.5, 0, 0.5**0.5, 0]
# Tools of 120 x 24 x 24 mm from MuJoCo's primitives.
TOOLS = {
    "cylinder": np.array([[5, 0.012, 0.06, 0, 0, 0, 0, *ALONG_X], [-1] + [0] * 10]),
    "capsule": np.array([[3, 0.012, 0.048, 0, 0, 0, 0, *ALONG_X]]),
    "ellipsoid": np.array([[4, 0.06, 0.012, 0.012, 0, 0, 0, 1, 0, 0, 0]]),
    "screwdriver": np.array([[2, 0.012, 0, 0, -0.048, 0, 0, 1, 0, 0, 0], [3, 0.012, 0.048, 0, 0, 0, 0, *ALONG_X]]),
}


def _grasp(family: str = "capsule", scale: float = 1.0) -> GraspPicture:
    h = hand()
    x = draw_inputs(np.random.default_rng(1), h)
    dx = scale * np.array([1e-3, 2e-3, 0, 0.05, 0, 0.02])
    size = np.array([0.06, 0.012, 0.012])
    tool = (family, TOOLS[family], size)
    return GraspPicture(h, x["q"], x["q"] + 0.05, x["x_ht"], dx, np.ones(6), x["contacts"], *tool, 1.1 * dx)


def _inputs() -> ReportInputs:
    true = RNG.normal(size=(50, 6)) * 1e-3
    work = {"label": RNG.normal(size=50), "aminn": np.abs(RNG.normal(size=50)), "mlp": np.zeros(0)}
    p, held = np.linspace(0, 1, 80), np.linspace(0, 1, 80) > 0.4
    curve = {"train": [1.0, 0.5, 0.3], "validation": [1.1, 0.7, 0.5]}
    return ReportInputs(
        title="A <run> & more",
        rows=[
            {"model": "aminn", "f1": 0.9123, "rmse_mm_all": float("nan"), "bound_coverage": 0.9512},
            {"model": "mine", "passivity_violation_full": 0.0},
        ],
        signed_work=work,
        signed_work_translational=work,
        true_dx=true,
        predicted_dx={"aminn": true * 1.1, "mine": true * 0},
        histories={"aminn": {"stage1": curve, "stage2": curve}},
        operating={"aminn": (operating_curve(p, held, 1 - p), 0.5)},
        reliability={"aminn": reliability(p, held)},
        slide_reliability={"aminn": reliability(p, ~held)},
        refusal={"aminn": refusal_curve(p, 1 - p)},
        grasp=_grasp(),
        verification={"ok": True, "samples": 1234, "host_bin_dx_relative_max": 1.5e-5, "host_bin_refused": 0},
        dataset={"grasps": 12, "stable share": 0.6123},
        notes=["A note."],
    )


def test_page_is_self_contained_and_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    overlaps = watch_labels(monkeypatch)
    write_report(_inputs(), tmp_path / "reports" / "page.html")
    assert faults(tmp_path / "reports" / "page.html") == [] and overlaps == []
    page = (tmp_path / "reports" / "page.html").read_text()
    assert "A &lt;run&gt; &amp; more" in page
    assert page.count("data:image/png;base64,") == 2 + 4 + 2 + 2 + 1 + 2 + 2  # a panel each
    assert all(link.startswith("data:") for link in re.findall(r'(?:src|href)="([^"]*)"', page))
    assert not re.search(r"https?://", page)
    for text in (
        "0.912",
        "1234",
        "1.5e-05",
        "stable share",
        "0.6123",
        "A note.",
        "95.1%",
        "Every sample within its limit",
    ):
        assert text in page
    assert [f.name for f in (tmp_path / "reports").iterdir()] == ["page.html"]


def test_empty_inputs_give_a_page_without_figures(tmp_path: Path) -> None:
    write_report(ReportInputs(), tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "<img" not in page
    assert "<table" not in page
    assert pictures(ReportInputs()) == []


def test_page_of_measured_data_has_no_slides(tmp_path: Path) -> None:
    curve = refusal_curve(np.ones(9), np.arange(9.0))
    assert [p.title for p in pictures(ReportInputs(refusal={"aminn": curve}))] == [
        "How sure the models are of a motion"
    ]


def test_the_conclusion_is_what_the_table_says() -> None:
    rows = [
        {"model": name, "f1": 0.9, "relative_error_median_all": error}
        for name, error in (("mlp", 0.2), ("aminn", 0.05), ("analytical", 0.1), ("no_motion", 1.0))
    ]
    assert conclusion(rows) == (
        "AMINN tells whether a grasp holds with an F1 of 0.900, and how far the tool moves with a median relative "
        "error of 5.0%; MLP 20.0%, analytical 10.0%."
    )
    assert conclusion([{"model": "no_motion"}]) == conclusion([]) == ""


def test_hands_calibration_and_cost_have_tables_where_they_were_run() -> None:
    reports = {
        "hands": {"gripper_joints": 2, "gripper_aminn_f1": 0.91, "leap_like_aminn_f1": 0.93, "aims_missed": ""},
        "calibrate": {
            "pushes_40_after_relative_error_median": 0.04, "pushes_10_after_relative_error_median": 0.06,
            "pushes_10_before_relative_error_median": 0.3, "aims_missed": "10 pushes: too few",
        },
        "cost": {"base_commit": "abc", "base_instructions": 9, "stuck_instructions": 7, "sliding_instructions": 8},
        "bench": {"prediction_us": 1.0},
    }  # fmt: skip
    hands, calibrate, cost = told_reports(reports)
    assert [row[:3] for row in hands.rows] == [["gripper", "2", "0.910"], ["leap_like", "–", "0.930"]]
    assert [row[:3] for row in calibrate.rows] == [["10", "0.300", "0.060"], ["40", "–", "0.040"]]
    assert calibrate.note.endswith("Aims missed: 10 pushes: too few.") and "missed" not in hands.note
    assert cost.rows == [["instructions", "9", "7", "8"]] and "abc" in cost.note
    assert told_reports({"hands": {}, "cost": {"base_commit": "abc"}}) == []


def test_failed_verification_is_said(tmp_path: Path) -> None:
    write_report(ReportInputs(verification={"ok": False, "host_c_refused": 3}), tmp_path / "page.html")
    assert "outside their limit" in (tmp_path / "page.html").read_text()


def test_cells() -> None:
    assert result_table(_inputs().rows)[0][:4] == ["AMINN", "0.912", "–", "–"]
    assert result_table(_inputs().rows)[1][-2] == "0.00%"
    assert format_value(True) == "yes"
    assert format_value(1234567) == "1234567"
    headings, cells = difference_table({"cortex_m7_refused": 0, "onnx_float64_dx_relative_max": 1e-5})
    assert headings == ["Cortex-M7 (qemu)", "ONNX Runtime"]
    assert ["samples refused", "0", "–"] in cells


@pytest.mark.parametrize("family", TOOLS)
def test_grasp_of_each_family_is_drawn(family: str) -> None:
    figures, caption = draw_grasp(_grasp(family))
    assert len(figures) == 2 and all(len(data_uri(figure)) > 20_000 for figure in figures)
    assert family in caption
    assert "predicted" in caption
    points = np.concatenate(tool_faces(TOOLS[family]))
    np.testing.assert_allclose(np.abs(points).max(0), [0.06, 0.012, 0.012], rtol=0.06)


def test_small_motions_are_drawn_larger() -> None:
    assert magnification(_grasp(scale=10).dx_ht) == 1
    assert magnification(_grasp(scale=1e-3).dx_ht) == 20
    assert "times as large" in draw_grasp(_grasp(scale=0.1))[1]


def test_forward_kinematics_agree_with_the_closure() -> None:
    """The fingertip's velocity is B qdot: finite differences of the drawn links against the columns of -J_q."""
    h, q, step = hand(), np.random.default_rng(3).uniform(0.2, 0.6, 8), 1e-6
    tips = np.stack([branch_points(h, b, q)[-1] for b in range(3)])
    _, j_q = closure(h, q, np.zeros(3), tips)
    for b, joints in enumerate(h.coordinate_joints):
        for k, j in enumerate(joints):
            if j >= 0:
                ahead = branch_points(h, b, q + step * (np.arange(8) == j))[-1]
                np.testing.assert_allclose((ahead - tips[b]) / step, -j_q[b][:, k], atol=1e-6)


def test_rotation_matrix_turns_about_its_vector() -> None:
    turn = rotation(np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(turn @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(rotation(np.zeros(3)), np.eye(3))


def test_the_page_lists_the_other_reports_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "bench.json").write_text('{"prediction_us": 1.5, "aims_missed": ""}')
    (tmp_path / "page.json").write_text('{"own": 1}')
    found = read_reports(tmp_path, tmp_path / "page.html")
    assert found == {"bench": {"prediction_us": 1.5, "aims_missed": ""}}
    write_report(ReportInputs(reports=found), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "bench.json, 2 figures" in text and "<td>prediction_us</td><td>1.5</td>" in text
    assert read_reports(tmp_path / "none", tmp_path / "page.html") == {}


def test_a_damaged_report_is_named(tmp_path: Path) -> None:
    (tmp_path / "size.json").write_text('{"cortex_m7_')
    with pytest.raises(AminnError, match=r"size\.json: not a report"):
        read_reports(tmp_path, tmp_path / "page.html")
