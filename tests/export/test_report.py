"""The report page: self-contained, complete with what it is given, and readable where figures are missing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from synthetic import closure, draw_inputs, hand

from aminn.evaluation.metrics import operating_curve, refusal_curve, reliability
from aminn.pages.grasp_picture import GraspPicture, branch_points, draw_grasp, magnification, tool_faces
from aminn.pages.report import (
    ReportInputs,
    difference_table,
    format_value,
    pictures,
    read_reports,
    result_table,
    to_png,
    write_report,
)
from aminn_base.errors import AminnError
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


def test_page_is_self_contained_and_complete(tmp_path: Path) -> None:
    write_report(_inputs(), tmp_path / "reports" / "page.html")
    page = (tmp_path / "reports" / "page.html").read_text()
    assert "A &lt;run&gt; &amp; more" in page
    assert page.count("data:image/png;base64,") == 7
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
    figure, caption = draw_grasp(_grasp(family))
    assert len(to_png(figure)) > 20_000
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
