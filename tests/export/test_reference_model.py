"""The reference model in tests/golden: its files are one model, and the writers still give the same bytes for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from aminn_export.files.bin_model import read_bin_model, write_bin_model
from aminn_export.files.c_model import write_c_model
from aminn_export.files.onnx_model import build_onnx
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import read_vectors
from aminn_hand.hand import INPUTS, OUTPUTS

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


def test_c_and_binary_writers_give_the_committed_bytes(tmp_path: Path) -> None:
    """A change of a format shows here first: `make golden` renews the files."""
    model = read_bin_model(GOLDEN / "aminn_model.bin")
    write_c_model(model, tmp_path)
    write_bin_model(model, tmp_path / "aminn_model.bin")
    for file in sorted(tmp_path.iterdir()):
        assert file.read_bytes() == (GOLDEN / file.name).read_bytes(), file.name


@pytest.mark.parametrize("debug", [False, True])
def test_onnx_files_are_those_that_the_writer_gives(debug: bool) -> None:
    """Node by node; constants of double precision are in the ONNX metadata alone."""
    file = GOLDEN / ("aminn_debug.onnx" if debug else "aminn.onnx")
    wanted, found = build_onnx(read_bin_model(GOLDEN / "aminn_model.bin"), debug).graph, onnx.load(file).graph
    assert list(found.node) == list(wanted.node)
    assert [t.name for t in found.initializer] == [t.name for t in wanted.initializer]


@pytest.mark.parametrize("debug", [False, True])
def test_onnx_repeats_the_reference_predictions(debug: bool) -> None:
    vectors = read_vectors(GOLDEN / "golden.bin")
    inputs = {name: vectors.inputs[name] for name in INPUTS}
    file = GOLDEN / ("aminn_debug.onnx" if debug else "aminn.onnx")
    out = run_onnx(single_thread_session(file), inputs)
    for name in OUTPUTS:
        scale = np.abs(vectors.reference[name]).max()
        assert np.abs(out[name] - vectors.reference[name]).max() <= 2e-6 * scale, name


def test_double_precision_predictions_are_the_oracle_s() -> None:
    """Up to the rounding of constants: a binary model holds them in float32."""
    vectors = read_vectors(GOLDEN / "golden.bin")
    out = Reference(read_bin_model(GOLDEN / "aminn_model.bin"))({name: vectors.inputs[name] for name in INPUTS})
    for name in OUTPUTS:
        np.testing.assert_allclose(vectors.reference_f64[name], out[name], rtol=1e-5, atol=1e-9, err_msg=name)


def test_whole_folder_is_small() -> None:
    assert sum(file.stat().st_size for file in GOLDEN.iterdir()) < 2_000_000
