"""The model as C source and as a blob: same content, same bytes every time, damage and misfits named."""

from __future__ import annotations

import dataclasses
import struct

import numpy as np
import pytest
from runtime_models import RandomModel, random_model

from aminn_base.errors import AminnError
from aminn_export.files.bin_model import bin_model_bytes, read_bin_model, write_bin_model
from aminn_export.files.c_model import c_model_texts, float_literal, write_c_model
from aminn_export.files.layout import Widths, head_stored, layout_of
from aminn_export.files.tables import by_branch, shortest
from aminn_rt.blob import FORMAT_VERSION


@pytest.fixture(scope="module")
def model() -> RandomModel:
    return random_model(3, widths=Widths(4, 7, 6, 5))


def changed(model: RandomModel, **values: object) -> RandomModel:
    """The model with other tensors (names with . as __) or other meta."""
    tensors, meta = dict(model.tensors), dict(model.meta)
    for name, value in values.items():
        name = name.replace("__", ".")
        (tensors if name in tensors else meta)[name] = value
    return dataclasses.replace(model, tensors=tensors, meta=meta)


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -1.5, 0.1, 1e-38, 1.4e-45, 3.4028235e38, -(2.0**-126), 1 / 3])
def test_literals_are_exact(value: float) -> None:
    text = float_literal(np.float32(value))
    assert text.endswith("f")
    back = np.float32(float.fromhex(text[:-1]) if "x" in text else float(text[:-1]))
    assert back.tobytes() == np.float32(value).tobytes()


def test_blob_gives_back_the_model(model: RandomModel, tmp_path) -> None:
    write_bin_model(model, tmp_path / "m.bin")
    back = read_bin_model(tmp_path / "m.bin")
    assert set(back.tensors) == set(model.tensors)
    for name, value in model.tensors.items():
        assert back.tensors[name].dtype == value.dtype
        np.testing.assert_array_equal(back.tensors[name], value, err_msg=name)
    for name in model.meta.keys() - {"branches", "joints"}:  # a binary model has no names of parts
        value = model.meta[name]
        expected = np.float32(value) if isinstance(value, float) else value
        if isinstance(value, list) and name != "branch_joints":
            expected = [float(np.float32(v)) for v in value]
        assert back.meta[name] == expected, name


def test_same_model_same_bytes(model: RandomModel, tmp_path) -> None:
    again = random_model(3, widths=Widths(4, 7, 6, 5))
    assert bin_model_bytes(model) == bin_model_bytes(again)
    assert c_model_texts(model) == c_model_texts(again)
    write_bin_model(model, tmp_path / "m.bin")
    assert bin_model_bytes(read_bin_model(tmp_path / "m.bin")) == bin_model_bytes(model)


def test_c_source_holds_every_value(model: RandomModel) -> None:
    source, header = c_model_texts(model, "left_hand")
    weight = model.tensors["s2.trunk1_w"]  # (H, HC + 26), stored [in][out]
    start = source.index("left_hand_s2_trunk1_w[")
    body = source[source.index("{", start) + 1 : source.index("}", start)]
    values = [np.float32(float.fromhex(w.strip()[:-1]) if "x" in w else float(w.strip()[:-1])) for w in body.split(",")]
    np.testing.assert_array_equal(np.array(values, np.float32), weight.T.ravel())
    assert "extern const aminn_model_t left_hand;" in header
    assert model.meta["checkpoint_sha256"] in source
    assert source.count("#include") == 1 and '#include "aminn_rt.h"' in header


def test_write_c_model_names_files_after_the_prefix(model: RandomModel, tmp_path) -> None:
    paths = write_c_model(model, tmp_path, "right")
    assert [p.name for p in paths] == ["right.c", "right.h"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["right.c", "right.h"]
    with pytest.raises(AminnError, match="identifier"):
        write_c_model(model, tmp_path, "2nd-hand")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"s1__trunk2_w": np.zeros((6, 7), np.float32)}, "s1.trunk2_w has shape"),
        ({"chol_nom": np.full((3, 6), np.nan, np.float32)}, "chol_nom holds NaN"),
        ({"gate_nom": np.zeros(3)}, "gate_nom is float64"),
        ({"dq0": "guess"}, "dq0 is 'guess'"),
        ({"format_version": 2}, "format_version"),
        ({"tau": float("nan")}, "tau"),
        ({"checkpoint_sha256": "abc"}, "checkpoint_sha256"),
        ({"coord_mask": np.float32([[1, 1, 1], [1, 1, 1], [1, 1, 0]])}, "0 for the first ones"),
        ({"coord_mask": np.float32([[1, 1, 1], [1, 1, 1], [1, 0, 1]])}, "0 for the first ones"),
        ({"coord_mask": np.float32([[1, 1, 0.5], [1, 1, 1], [0, 1, 1]])}, "1 where a branch has one"),
        ({"coord_mask": np.ones((1, 3), np.float32)}, "2 to 5 branches"),
        ({"coord_mask": np.ones((3, 6), np.float32)}, "of 1 to 5 coordinates"),
        ({"coord_mask": np.ones(9, np.float32)}, "expected 2 to 5 branches"),
        ({"s1__eps_m": np.zeros(2, np.float32)}, r"s1.eps_m has shape"),
    ],
)
def test_a_model_that_does_not_fit_is_named(model: RandomModel, change: dict, message: str) -> None:
    with pytest.raises(AminnError, match=message):
        bin_model_bytes(changed(model, **change))


def test_contact_compliance_is_a_value_a_branch(model: RandomModel, tmp_path) -> None:
    other = np.array([1e-5, 2e-5, 4e-5], np.float32)
    write_bin_model(changed(model, s2__eps_m=other), tmp_path / "m.bin")
    back = read_bin_model(tmp_path / "m.bin")
    np.testing.assert_array_equal(back.tensors["s2.eps_m"], other)
    stages = by_branch(back.meta["eps_m"], 3)
    np.testing.assert_array_equal(stages.astype(np.float32), [model.tensors["s1.eps_m"], other])
    assert shortest(stages) == back.meta["eps_m"] and shortest(by_branch(1e-5, 3)) == 1e-5
    assert shortest(by_branch([1e-5, 2e-5], 3)) == [1e-5, 2e-5]


def test_rows_of_the_head_end_with_zeros(model: RandomModel) -> None:
    layout = layout_of(model)
    for table in layout.tables:
        if table.field.startswith("head_"):
            rows = table.values.reshape(-1, head_stored(layout.dims))
            assert rows[:, : layout.dims.head].all()
            assert not rows[:, layout.dims.head :].any()


def test_missing_parts_are_named(model: RandomModel) -> None:
    tensors = {k: v for k, v in model.tensors.items() if k != "s2.head_b"}
    with pytest.raises(AminnError, match=r"s2\.head_b is missing"):
        bin_model_bytes(dataclasses.replace(model, tensors=tensors))
    meta = {k: v for k, v in model.meta.items() if k not in ("tau", "eps_kx")}
    with pytest.raises(AminnError, match="tau, eps_kx"):
        bin_model_bytes(dataclasses.replace(model, meta=meta))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda b: b[:100], "truncated"),
        (lambda b: b[:-4], "truncated or overwritten"),
        (lambda b: b"ELF!" + b[4:], "wrong magic"),
        (lambda b: b[:4] + struct.pack("<I", FORMAT_VERSION + 1) + b[8:], f"format version {FORMAT_VERSION + 1}"),
        (lambda b: b[:300] + bytes([b[300] ^ 1]) + b[301:], "CRC-32"),
    ],
)
def test_a_damaged_blob_is_named(model: RandomModel, tmp_path, damage, message: str) -> None:
    path = tmp_path / "m.bin"
    path.write_bytes(damage(bin_model_bytes(model)))
    with pytest.raises(AminnError, match=message):
        read_bin_model(path)


def test_nothing_half_written_is_left(model: RandomModel, tmp_path) -> None:
    with pytest.raises(AminnError):
        write_bin_model(changed(model, dq0="guess"), tmp_path / "m.bin")
    assert list(tmp_path.iterdir()) == []
