"""Vector and result files: read back what was written, name what is wrong."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from runtime_models import random_inputs, random_model

from aminn_base.errors import AminnError
from aminn_export.files.layout import Widths
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import read_results, read_vectors, write_results, write_vectors
from aminn_hand.hand import MAX_BRANCHES, MAX_COORDINATES, MIN_BRANCHES, OUTPUTS, Dims


@pytest.fixture(scope="module")
def samples() -> tuple[dict, dict]:
    inputs = random_inputs(5, 1)
    out = Reference(random_model(0, widths=Widths(4, 5, 5, 6)))(inputs)
    return inputs, {name: out[name] for name in OUTPUTS}


def test_two_numbers_tell_every_hand() -> None:
    """Of inputs and of outputs: a file needs no more to say which counts its hand has."""
    counts = [
        Dims(b, c, joints, 0, 0)
        for b in range(MIN_BRANCHES, MAX_BRANCHES + 1)
        for c in range(1, MAX_COORDINATES + 1)
        for joints in range(b + c - 1, b * c + 1)
    ]
    assert len({(dims.input, dims.output) for dims in counts}) == len(counts) > 100


@pytest.mark.parametrize(("b", "c", "joints"), [(2, 1, 2), (3, 3, 8), (5, 5, 25), (4, 4, 13)])
def test_a_file_says_of_which_hand_it_is(tmp_path, b: int, c: int, joints: int) -> None:
    dims, rng = Dims(b, c, joints, 0, 0), np.random.default_rng(0)
    x, y = ({k: rng.normal(size=(4, *s)) for k, s in shapes.items()} for shapes in (dims.inputs, dims.outputs))
    write_vectors(tmp_path / "v.bin", x, y, y)
    back = read_vectors(tmp_path / "v.bin", dims)
    assert back.dims == dims
    np.testing.assert_array_equal(back.reference_f64["gate"], y["gate"])
    with pytest.raises(AminnError, match=rf"v\.bin: of another hand \({b} branches, {joints} joints, at most {c}"):
        read_vectors(tmp_path / "v.bin", Dims(3, 4, 12, 0, 0))
    write_results(tmp_path / "r.bin", rng.normal(size=(4, dims.output + 1)), np.zeros(4, np.int32))
    assert read_results(tmp_path / "r.bin").outputs["gate"].shape == (4, b)


@pytest.mark.parametrize("with_f64", [False, True])
def test_read_gives_back_what_was_written(samples, tmp_path, with_f64: bool) -> None:
    inputs, reference = samples
    write_vectors(tmp_path / "v.bin", inputs, reference, reference if with_f64 else None)
    back = read_vectors(tmp_path / "v.bin")
    for name, value in inputs.items():
        np.testing.assert_array_equal(back.inputs[name], value)
    for name, value in reference.items():
        np.testing.assert_array_equal(back.reference[name], value.astype(np.float32))
        if with_f64:
            np.testing.assert_array_equal(back.reference_f64[name], value)
    assert with_f64 == (back.reference_f64 is not None)


def test_no_sample_is_a_valid_file(samples, tmp_path) -> None:
    inputs, reference = samples
    write_vectors(tmp_path / "v.bin", {k: v[:0] for k, v in inputs.items()}, {k: v[:0] for k, v in reference.items()})
    assert len(read_vectors(tmp_path / "v.bin").inputs["q"]) == 0


def test_misfits_are_named(samples, tmp_path) -> None:
    inputs, reference = samples
    with pytest.raises(AminnError, match="w_e is missing"):
        write_vectors(tmp_path / "v.bin", {k: v for k, v in inputs.items() if k != "w_e"}, reference)
    with pytest.raises(AminnError, match="x_ht has shape"):
        write_vectors(tmp_path / "v.bin", inputs | {"x_ht": inputs["x_ht"][:, :5]}, reference)
    with pytest.raises(AminnError, match="5 inputs but 4"):
        write_vectors(tmp_path / "v.bin", inputs, {k: v[:4] for k, v in reference.items()})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda b: b[:20], "truncated"),
        (lambda b: b[:-8], "CRC-32"),
        (lambda b: b"AMNX" + b[4:], "wrong magic"),
        (lambda b: b[:4] + struct.pack("<I", 7) + b[8:], "version 7"),
        (lambda b: b[:12] + struct.pack("<I", 300) + b[16:], "300 inputs"),
        (lambda b: b[:8] + struct.pack("<I", 4) + b[12:], "do not fit"),
        (lambda b: b[:50] + bytes([b[50] ^ 4]) + b[51:], "CRC-32"),
    ],
)
def test_a_damaged_vector_file_is_named(samples, tmp_path, damage, message: str) -> None:
    path = tmp_path / "v.bin"
    write_vectors(path, *samples)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(AminnError, match=message):
        read_vectors(path)


def test_results_are_read(tmp_path) -> None:
    rows = np.arange(2 * 52, dtype="<f4").reshape(2, 52)
    rows[:, 51] = [1, 0]
    payload = rows.tobytes() + np.array([0, -9], "<i4").tobytes()
    header = struct.pack("<8I", 0x4F4E4D41, 2, 2, 0, 52, 0, zlib.crc32(payload), 0)
    (tmp_path / "r.bin").write_bytes(header + payload)
    results = read_results(tmp_path / "r.bin")
    assert results.outputs["p_stable"].tolist() == [0, 52]
    assert results.outputs["gate"].shape == (2, 3)
    assert results.stable.tolist() == [True, False]
    assert results.status.tolist() == [0, -9]
    (tmp_path / "r.bin").write_bytes(header[:-4] + b"\1\0\0\0" + payload)
    with pytest.raises(AminnError, match="last word"):
        read_results(tmp_path / "r.bin")
    (tmp_path / "r.bin").write_bytes(header + payload[:-4])
    with pytest.raises(AminnError, match="CRC-32"):
        read_results(tmp_path / "r.bin")
