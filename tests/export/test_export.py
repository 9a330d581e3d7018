"""`aminn export` as a whole: complete, repeatable, and nothing half-written."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from runtime_models import random_model

from aminn.data.dataset import load_dataset, split_of
from aminn.model.checkpoint import load_checkpoint
from aminn.prediction.engines import open_engine
from aminn_base.errors import AminnError
from aminn_export.export import export
from aminn_export.files.bin_model import bin_model_bytes, read_bin_model
from aminn_export.files.c_names import check_prefix
from aminn_export.files.layout import Widths, in_steps, layout_of, of_steps, tensor_order
from aminn_export.files.onnx_model import read_metadata
from aminn_export.files.tables import dims_of
from aminn_export.judge.verify import check_golden
from aminn_export.judge.weights import ROUNDED, rounding_error
from aminn_export.samples.golden import inputs_of
from aminn_export.samples.vectors import read_vectors

FILES = {"aminn_hand.h", "aminn.onnx", "aminn_debug.onnx", "left.c", "left.h", "left.bin", "golden.bin"}


def _names(folder: Path) -> set[str]:
    return {f.name for f in folder.iterdir()}


def test_export_writes_everything_twice_the_same(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    lines = export(checkpoint_dir, tmp_path / "a" / "one", "left", data_dir)
    export(checkpoint_dir, tmp_path / "two", "left", data_dir)
    assert _names(tmp_path / "a" / "one") == FILES
    assert _names(tmp_path / "a") == {"one"}
    assert len(lines) == len(FILES)
    for name in FILES:
        assert (tmp_path / "a" / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert read_metadata(tmp_path / "two" / "aminn.onnx")["checkpoint_sha256"] == load_checkpoint(checkpoint_dir).sha256


# One checkpoint exported by two processes that differ as two machines and two days do: clock, time zone, language, host
# name, home, hash seed, permissions, working folder, number of threads, and which kernels BLAS, NumPy and torch pick.
ELSEWHERE = """
import os, socket, sys, time
os.umask(0o077)
now = time.time
time.time = lambda: now() + 7e7
socket.gethostname = lambda: "elsewhere"
sys.argv = sys.argv[1:]
from aminn_app.cli import main
main()
"""
OTHER_MACHINE = {
    "TZ": "Pacific/Auckland", "LC_ALL": "C", "LANG": "C", "HOME": "/nowhere", "PYTHONHASHSEED": "12345",
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX", "ATEN_CPU_CAPABILITY": "default",
}  # fmt: skip


def test_another_machine_and_day_give_the_same_bytes(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    words = ["export", "--run", str(checkpoint_dir), "--data", str(data_dir), "--prefix", "left"]
    here = [sys.executable, "-m", "aminn_app.cli", *words, "--out", str(tmp_path / "here")]
    there = [sys.executable, "-c", ELSEWHERE, "aminn", *words, "--out", str(tmp_path / "there")]
    other = tmp_path / "folder"
    other.mkdir()
    subprocess.run(here, check=True, env=os.environ | {"PYTHONHASHSEED": "1"})
    subprocess.run(there, check=True, env=os.environ | OTHER_MACHINE, cwd=other)
    assert _names(tmp_path / "here") == _names(tmp_path / "there") == FILES
    for name in FILES - {"golden.bin"}:
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes(), name
    # What LAPACK and ONNX Runtime compute beside the vectors' inputs may differ in last places with their kernels.
    a, b = (read_vectors(tmp_path / name / "golden.bin") for name in ("here", "there"))
    for name, value in a.inputs.items():
        np.testing.assert_array_equal(value, b.inputs[name])
    for name, value in a.reference_f64.items():
        np.testing.assert_allclose(value, b.reference_f64[name], rtol=1e-9, atol=1e-12)


def test_other_files_in_the_folder_stay(checkpoint_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    export(checkpoint_dir, tmp_path)
    assert _names(tmp_path) == {
        "notes.txt",
        "aminn.onnx",
        "aminn_debug.onnx",
        "aminn_hand.h",
        "aminn_model.c",
        "aminn_model.h",
        "aminn_model.bin",
    }


CLASHES = (
    *("2fast", "a-b", "", "_model", "int", "namespace", "bool", "static_assert", "co_await", "char8_t"),
    *("main", "printf", "errno", "int32_t", "hand_t", "NULL", "NAN", "stdin", "std", "sinf", "read", "time", "PRId32"),
    *("left__hand", "left_", "HAND", "limits", "Math", "stdio", "string", "pthread_hand"),
    *("aminn", "AMINN", "aminn_predict", "AMINN_OK", "aminn_model_t", "Aminn_rt", "aminn_debug", "golden", "Golden"),
    *("nul", "Con", "COM1"),
)


@pytest.mark.parametrize("prefix", CLASHES)
def test_bad_prefix_leaves_nothing(checkpoint_dir: Path, tmp_path: Path, prefix: str) -> None:
    with pytest.raises(AminnError, match=f"prefix {prefix!r}"):
        export(checkpoint_dir, tmp_path / "out", prefix)
    assert _names(tmp_path) == set()


def test_other_prefixes_are_free() -> None:
    for prefix in ("aminn_model", "aminn_model_2", "left", "gripper", "Hand", "hand_l", "tool1", "strong", "island"):
        check_prefix(prefix)


def test_no_name_of_the_runtime_is_free_or_made() -> None:
    """Every name in the public headers, whatever its case: as a prefix, and as what a prefix makes."""
    runtime = Path(__file__).resolve().parents[2] / "runtime" / "include"
    text = "".join((runtime / name).read_text() for name in ("aminn_hand.h", "aminn_rt.h", "aminn_rt.hpp"))
    names = set(re.findall(r"\b(?i:aminn)\w*", text)) - {"aminn_model", "aminn_model_"}  # these are of the example
    order = tensor_order(dims_of(random_model(0)), Widths(1, 1, 1, 1))
    fields = {f"{owner}_{field}" if owner else field for owner, field, _ in order} | {"known_answer"}
    assert len(names) > 60
    for name in sorted(names):
        made = [name[: -len(field) - 1] for field in fields if name.lower().endswith(f"_{field}")]
        for prefix in (name, *made):
            with pytest.raises(AminnError, match="prefix"):
                check_prefix(prefix)


@pytest.mark.parametrize("dialect", ["-std=c17", "-std=gnu17", "-std=gnu17 -D_GNU_SOURCE"])
def test_compilers_agree_about_their_names(tmp_path: Path, dialect: str) -> None:
    """What the C headers of this machine declare is refused: to strict C, to gcc without options, to g++ of any."""
    names = "complex ctype errno fcntl math signal stdio stdlib string strings time unistd wchar wctype".split()
    (tmp_path / "in.c").write_text("".join(f"#include <{name}.h>\n" for name in names))
    command = ["gcc", *dialect.split(), "-fsyntax-only", "-aux-info", "aux.txt", "in.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    declared = set(re.findall(r"\b([a-z][a-z0-9_]*) \(", (tmp_path / "aux.txt").read_text()))
    assert len(declared) > 400
    free = []
    for name in sorted(declared):
        with contextlib.suppress(AminnError):
            check_prefix(name)
            free.append(name)
    assert free == []


def test_files_of_another_model_are_not_replaced(checkpoint_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "Left.bin").write_text("mine")
    with pytest.raises(AminnError, match=r"holds Left\.bin.* by case alone"):
        export(checkpoint_dir, tmp_path, "left")
    assert _names(tmp_path) == {"Left.bin"}
    export(checkpoint_dir, tmp_path / "out", "left")
    export(checkpoint_dir, tmp_path / "out", "left")
    before = (tmp_path / "out" / "aminn.onnx").read_bytes()
    with pytest.raises(AminnError, match="holds the model left"):
        export(checkpoint_dir, tmp_path / "out", "right")
    assert (tmp_path / "out" / "aminn.onnx").read_bytes() == before


def test_a_cut_export_over_another_leaves_nothing_that_passes_for_a_model(
    checkpoint_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(checkpoint_dir, tmp_path / "out")
    replace, moved = os.replace, []

    def cut(source: Path, target: Path) -> None:
        if Path(target).parent.name == "out":
            moved.append(target)
        if len(moved) == 3:
            raise KeyboardInterrupt
        replace(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", cut)
        with pytest.raises(KeyboardInterrupt):
            export(checkpoint_dir, tmp_path / "out", name="another")
    with pytest.raises(AminnError, match=r"out: one C model with its \.bin expected"):
        open_engine(tmp_path / "out")
    export(checkpoint_dir, tmp_path / "out", name="another")
    assert open_engine(tmp_path / "out").name == "another"


def test_a_damaged_onnx_model_is_named(checkpoint_dir: Path, tmp_path: Path) -> None:
    export(checkpoint_dir, tmp_path)
    file = tmp_path / "aminn.onnx"
    whole = bytearray(file.read_bytes())
    whole[len(whole) // 2] ^= 1
    file.write_bytes(whole)
    with pytest.raises(AminnError, match=r"aminn\.onnx: damaged, or changed by another program"):
        open_engine(file)
    file.write_bytes(b"no model")
    with pytest.raises(AminnError, match=r"aminn\.onnx: ONNX Runtime cannot load it"):
        open_engine(file)


def test_missing_inputs_leave_nothing(checkpoint_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(AminnError, match="missing"):
        export(tmp_path / "none", tmp_path / "out")
    with pytest.raises(AminnError, match=r"manifest\.json"):
        export(checkpoint_dir, tmp_path / "out", data_dir=tmp_path)
    assert _names(tmp_path) == set()


def test_float16_weights_halve_the_tables_and_say_what_they_cost(
    checkpoint_dir: Path, data_dir: Path, tmp_path: Path
) -> None:
    lines = export(checkpoint_dir, tmp_path / "half", data_dir=data_dir, weights="float16")
    export(checkpoint_dir, tmp_path / "full", data_dir=data_dir)
    half, full = (read_bin_model(tmp_path / name / "aminn_model.bin") for name in ("half", "full"))
    assert "float16 weights change dx_ht" in lines[-1]
    sizes = [(tmp_path / name / "aminn_model.bin").stat().st_size for name in ("half", "full")]
    assert sizes[0] < 0.55 * sizes[1]
    for name, value in full.tensors.items():
        expected = value.astype(np.float16).astype(np.float32) if name.endswith("_w") else value
        np.testing.assert_array_equal(half.tensors[name], expected)
    assert half.meta["weights"] == "float16"


def test_int8_weights_quarter_the_tables_and_say_what_they_cost(
    checkpoint_dir: Path, data_dir: Path, tmp_path: Path
) -> None:
    lines = export(checkpoint_dir, tmp_path / "byte", data_dir=data_dir, weights="int8")
    export(checkpoint_dir, tmp_path / "full", data_dir=data_dir)
    byte, full = (read_bin_model(tmp_path / name / "aminn_model.bin") for name in ("byte", "full"))
    dataset = load_dataset(data_dir)
    validation = dataset.split("validation")
    error = rounding_error(full, byte, inputs_of(validation, full))
    assert f"int8 weights change dx_ht by {error['dx_relative_median']:.1e}" in lines[-1]
    assert f"of {len(validation)} decisions on validation samples" in lines[-1] and len(validation) < len(dataset)
    assert 0 < error["dx_relative_median"] < 0.05 and error["p_stable_median"] < 0.05
    sizes = [(tmp_path / name / "aminn_model.bin").stat().st_size for name in ("byte", "full")]
    assert sizes[0] < 0.36 * sizes[1]
    for name, value in full.tensors.items():
        if name.endswith("_w"):
            step = np.abs(value).max(1, keepdims=True) / 127
            assert (np.abs(byte.tensors[name] - value) <= 0.501 * step).all()
        else:
            np.testing.assert_array_equal(byte.tensors[name], value)
    assert byte.meta["weights"] == "int8"
    assert check_golden(tmp_path / "byte", byte) == []  # the graph has the same weights, and so has the oracle
    assert bin_model_bytes(byte) == (tmp_path / "byte" / "aminn_model.bin").read_bytes()


def test_steps_of_int8_weights_are_exact_and_to_nearest() -> None:
    rng = np.random.default_rng(0)
    rows = [np.zeros(9), np.full(9, 1e-40), np.r_[np.arange(8) + 0.5, 127.0], *rng.normal(size=(40, 9))]
    value = np.array(rows, np.float32) * np.float32(1.0)
    steps, size = in_steps(value)
    rounded = of_steps(steps, size)
    assert (steps[:2] == 0).all() and (size[:3] == 1).all()
    np.testing.assert_array_equal(steps[2], [0, 2, 2, 4, 4, 6, 6, 8, 127])  # ties to even
    assert (np.abs(steps[2:].astype(int)).max(1) == 127).all()
    np.testing.assert_array_equal(rounded, steps.astype(np.float64) * size.astype(np.float64)[:, None])
    again, same = in_steps(rounded)
    np.testing.assert_array_equal(again, steps)
    np.testing.assert_array_equal(same, size)


@pytest.mark.parametrize("weights", ["float16", "int8"])
def test_weights_that_were_not_rounded_are_refused(weights: str) -> None:
    model = random_model(2, widths=Widths(4, 5, 5, 6))
    model.meta["weights"] = weights
    with pytest.raises(AminnError, match=f"contact_w is not representable in {weights}; round it first"):
        layout_of(model)


def test_a_weight_too_large_for_float16_is_refused() -> None:
    model = random_model(2, widths=Widths(4, 5, 5, 6))
    model.tensors["s2.trunk1_w"][0, 0] = 7e4
    with pytest.raises(AminnError, match=r"s2\.trunk1_w holds a weight beyond 65504"):
        ROUNDED["float16"](model)


def test_ranges_come_from_the_training_split(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    export(checkpoint_dir, tmp_path / "out", data_dir=data_dir)
    tensors = read_bin_model(tmp_path / "out" / "aminn_model.bin").tensors
    dataset = load_dataset(data_dir)
    q = dataset.samples["q"][split_of(dataset.samples["grasp_id"]) == 0]
    width = q.max(0) - q.min(0)
    np.testing.assert_allclose(tensors["range_min"][:8], q.min(0) - 0.05 * width, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(tensors["range_max"][:8], q.max(0) + 0.05 * width, rtol=1e-5, atol=1e-6)
    export(checkpoint_dir, tmp_path / "bare")
    assert read_bin_model(tmp_path / "bare" / "aminn_model.bin").tensors["range_max"][0] > 3e38
