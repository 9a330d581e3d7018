"""Choice and content of golden vectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from runtime_models import RandomModel

from aminn.data.dataset import load_dataset
from aminn_export.samples.golden import spread, write_golden
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import read_vectors


@pytest.mark.parametrize(("n_stable", "n_unstable", "wanted"), [(900, 100, 60), (5, 995, 60), (995, 5, 60), (9, 9, 60)])
def test_samples_are_spread_and_of_both_outcomes(n_stable: int, n_unstable: int, wanted: int) -> None:
    stable = np.random.default_rng(0).permutation([1] * n_stable + [0] * n_unstable)
    index = spread(stable, wanted)
    assert len(index) == len(np.unique(index)) == min(wanted, n_stable + n_unstable)
    assert (np.diff(index) > 0).all()
    smaller = min(n_stable, n_unstable, wanted // 2)
    assert min(stable[index].sum(), (1 - stable[index]).sum()) == smaller
    if wanted < 100:
        assert index[-1] - index[0] > 0.8 * len(stable) or len(stable) < 100


def test_golden_file_holds_both_precisions(
    exported: RandomModel, export_dir: Path, data_dir: Path, tmp_path: Path
) -> None:
    n = write_golden(exported, export_dir / "aminn.onnx", load_dataset(data_dir), tmp_path / "golden.bin", 50)
    vectors = read_vectors(tmp_path / "golden.bin")
    assert n == len(vectors.inputs["q"]) == 50
    exact = Reference(exported)(vectors.inputs)
    assert vectors.reference_f64 is not None
    for name, value in vectors.reference_f64.items():
        np.testing.assert_array_equal(value, exact[name])
        np.testing.assert_allclose(vectors.reference[name], value, rtol=5e-3, atol=1e-4 * np.abs(value).max())
