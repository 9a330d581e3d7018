"""What missing sensors cost: the reference model on simulated pushes whose contacts are told in part, as documented."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

from aminn.data.dataset import Dataset
from aminn.evaluation.metrics import pose_error, pose_size
from aminn.hand.closure import closure
from aminn_table import complete

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "own-data.md"
LACKING: dict[str, list[int]] = {
    "nothing": [],
    "normals": [4, 5, 6],
    "points": [1, 2, 3],
    "forces": [7],
    "points and normals": [1, 2, 3, 4, 5, 6],
    "points, normals and forces": [1, 2, 3, 4, 5, 6, 7],
}
"""What a lab lacks, as the page calls it -> features of a contact."""


@pytest.fixture(scope="module")
def errors(truth: Dataset) -> dict[str, np.ndarray]:
    """Relative errors of the stable pushes."""
    session = ort.InferenceSession(ROOT / "tests" / "golden" / "aminn.onnx", providers=["CPUExecutionProvider"])
    s, held, found = truth.samples, truth.samples["stable"] > 0, {}
    for name, features in LACKING.items():
        told = s["contacts"].copy()
        told[..., features] = np.nan
        contacts = complete(truth.hand, {"q": s["q"], "contacts": told})[0]["contacts"]
        j_x, j_q = closure(truth.hand, s["q"], s["x_ht"], contacts)
        inputs = {"q": s["q"], "x_ht": s["x_ht"], "w_e": s["w_e"], "contacts": contacts, "j_x": j_x, "j_q": j_q}
        (dx,) = session.run(["dx_ht"], {k: v.astype(np.float32) for k, v in inputs.items()})
        true, length_m = s["dx_ht"][held], truth.hand.length_m
        found[name] = pose_error(dx[held].astype(float), true, length_m) / pose_size(true, length_m)
    return found


def test_missing_sensors_cost_what_the_page_says(errors: dict[str, np.ndarray], trust: dict) -> None:
    rows = re.findall(r"^\| ([a-z ,]+) \| (0\.\d+) \| (0\.\d+) \|", PAGE.read_text(), re.MULTILINE)
    documented = {name: (float(median), float(p90)) for name, median, p90 in rows}
    assert set(documented) == set(LACKING)
    for name, error in errors.items():
        median, p90 = float(np.median(error)), float(np.quantile(error, 0.9))
        trust[f"own_data_without_{re.sub(r'[ ,]+', '_', name)}_relative_error_median"] = median
        trust[f"own_data_without_{re.sub(r'[ ,]+', '_', name)}_relative_error_p90"] = p90
        np.testing.assert_allclose((median, p90), documented[name], rtol=0.15, err_msg=name)


def test_round_fingertips_need_no_normals(errors: dict[str, np.ndarray]) -> None:
    np.testing.assert_allclose(errors["normals"], errors["nothing"], rtol=1e-3, atol=1e-5)
    assert np.median(errors["points"]) < 1.2 * np.median(errors["nothing"])
