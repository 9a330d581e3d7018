"""The whole path at a small size: what `make demo` promises holds, and a second run changes nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]


def demo(build: Path) -> str:
    command = [sys.executable, "-m", "aminn_app.demo", "--build", str(build), "--grasps", "72"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("build")
    (folder / "host").symlink_to(ROOT / "build" / "host")
    return folder


@pytest.fixture(scope="module")
def output(build: Path) -> str:
    return demo(build)


def test_report_holds_what_the_demo_promises(build: Path, output: str) -> None:
    report = json.loads((build / "reports" / "demo.json").read_text())
    assert report["ok"] and report["n_grasps"] == 72 and report["n_samples"] == 72 * 16
    assert report["samples"] >= 1000
    assert 0.3 <= report["stable_share"] <= 0.8
    assert report["grasps_in_train_and_test"] == 0
    assert report["aminn_passivity_violation_full"] == 0
    assert report["aminn_rmse_to_no_motion_all"] < 0.9
    for model in ("aminn", "mlp"):
        for figure in ("f1", "rmse_pose", "rmse_mm", "rmse_deg", "passivity_violation_translational"):
            assert report[f"{model}_{figure}"] is not None
    for target in ("host_bin", "host_c", "cortex_m7"):
        assert report[f"{target}_dx_relative_median"] < 2e-6
        assert report[f"{target}_p_stable_abs_max"] < 1e-5
        assert report[f"{target}_decisions_different"] == 0
    page = (build / "reports" / "demo.html").read_text()
    assert page.count("data:image/png;base64,") >= 4
    assert "demo.html" in output and "ground truth" in output


def test_second_run_repeats_the_figures_and_makes_nothing_again(build: Path, output: str) -> None:
    weights = build / "demo" / "aminn" / "model.safetensors"
    first, stamp = json.loads((build / "reports" / "demo.json").read_text()), weights.stat().st_mtime_ns
    demo(build)
    second = json.loads((build / "reports" / "demo.json").read_text())
    assert weights.stat().st_mtime_ns == stamp
    timed = {key for key in first if key.startswith("seconds_")}
    assert {k: v for k, v in first.items() if k not in timed} == {k: v for k, v in second.items() if k not in timed}
