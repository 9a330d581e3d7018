"""The ONNX model in each engine that `aminn verify --onnx` offers, and what is particular to one of them."""

from __future__ import annotations

import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper
from runtime_models import RandomModel, random_inputs, random_model

from aminn.evaluation.metrics import holds
from aminn.prediction import onnx_session
from aminn_base.errors import AminnError
from aminn_export.files.bin_model import read_bin_model
from aminn_export.files.head import TANH, head_order
from aminn_export.files.onnx_model import IR_VERSION, OPSET, build_onnx
from aminn_export.files.tables import dims_of
from aminn_export.judge.verify import scaled_norm
from aminn_export.replay.engines import ENGINES, load_engine
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.vectors import Vectors, read_vectors

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
DX_LIMIT, LOST_LIMIT, P_STABLE_LIMIT = 2e-6, 4e-5, 2e-6
"""Of samples whose grasp holds or whose contacts are well within their friction, and of those that give way."""
# Heads that tanh squashes, and inputs for which ONNX Runtime's Tanh is above 1.
HAND = dims_of(random_model(3))
SQUASHED = head_order(HAND, TANH)
BEYOND_ONE = (8.13, 9.0)


@pytest.fixture(scope="module")
def vectors() -> Vectors:
    return read_vectors(GOLDEN / "golden.bin")


@pytest.mark.parametrize("rows", [1, 200])
@pytest.mark.parametrize("engine", ENGINES)
def test_engine_repeats_float64(engine: str, rows: int, vectors: Vectors, trust: dict) -> None:
    """One sample a call, and all in a batch."""
    if engine == "openvino":
        pytest.importorskip("openvino", reason="optional: pip install openvino, as docs/compatibility.md has it")
    inputs, tau = (
        {name: vectors.inputs[name] for name in HAND.inputs},
        read_bin_model(GOLDEN / "aminn_model.bin").meta["tau"],
    )
    run = load_engine(engine, GOLDEN / "aminn.onnx")
    parts = [run({name: v[i : i + rows] for name, v in inputs.items()}) for i in range(0, 200, rows)]
    out = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    for reference in (vectors.reference, vectors.reference_f64):
        assert reference is not None
        dx = scaled_norm(out["dx_ht"] - reference["dx_ht"]) / scaled_norm(reference["dx_ht"])
        slides, kept = reference["friction_use"].max(1) >= 0.9, holds(reference["p_stable"], tau)
        lost = slides & ~kept
        assert (slides & kept).any() and 50 < lost.sum() < 150
        assert dx[~lost].max() < DX_LIMIT and dx[lost].max() < LOST_LIMIT
        dx = dx.max()
        p = np.abs(out["p_stable"] - reference["p_stable"]).max()
        assert p < P_STABLE_LIMIT
    trust[f"consumers_{engine}_batch_{rows}_dx_relative_max"] = float(dx)
    trust[f"consumers_{engine}_batch_{rows}_p_stable_abs_max"] = float(p)


def test_missing_engine_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(AminnError, match=r"OpenVINO cannot be imported.*pip install openvino"):
        load_engine("openvino", GOLDEN / "aminn.onnx")


@pytest.mark.parametrize("version", ["1.20.1", "1.9.0", "0.99.0"])
def test_too_old_onnxruntime_is_refused(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ort, "__version__", version)
    with pytest.raises(AminnError, match=rf"ONNX Runtime {version} is installed.*1\.21 or later.*pip install"):
        single_thread_session(GOLDEN / "aminn.onnx")


def test_oldest_onnxruntime_is_the_one_that_pip_is_told() -> None:
    requirements = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert "onnxruntime>=" + ".".join(map(str, onnx_session.ONNXRUNTIME_AT_LEAST)) in requirements


def _one_operator(kind: str, x: np.ndarray) -> np.ndarray:
    """What ONNX Runtime makes of float32 numbers x (n)."""
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N"]) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node(kind, ["x"], ["y"])], kind, ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    return single_thread_session(model.SerializeToString()).run(None, {"x": x})[0]


def test_square_roots_are_rounded_correctly() -> None:
    """What the version stands for: of numbers over the whole range, and of infinity."""
    x = np.exp(np.random.default_rng(0).uniform(-80, 80, 20_000)).astype(np.float32)
    x[:3] = 0, np.inf, np.finfo(np.float32).tiny
    np.testing.assert_array_equal(_one_operator("Sqrt", x), np.sqrt(x))


# --- Tanh beyond 1 -------------------------------------------------------------------------------------------------
def _with_heads(model: RandomModel, values: np.ndarray) -> RandomModel:
    """The model with these constants (3 branches, 8) before each tanh, whatever the input."""
    tensors = dict(model.tensors)
    for stage in ("s1", "s2"):
        weight, bias = tensors[f"{stage}.head_w"].copy(), tensors[f"{stage}.head_b"].copy()
        for branch in range(HAND.branches):
            rows = branch * HAND.branch_head + SQUASHED
            weight[rows], bias[rows] = 0, values[branch]
        tensors |= {f"{stage}.head_w": weight, f"{stage}.head_b": bias}
    return replace(model, tensors=tensors)


def _tanh_above_one() -> np.ndarray:
    """Every float32 between 8.13 and 9 whose tanh ONNX Runtime puts above 1."""
    low, high = (int(np.float32(x).view(np.int32)) for x in BEYOND_ONE)
    x = np.arange(low, high, dtype=np.int32).view(np.float32)
    return x[_one_operator("Tanh", x) > 1]


def test_heads_hold_their_bounds_where_tanh_passes_one(trust: dict) -> None:
    """Springs stay positive definite, gates in [0, 1], gains in their range, all finite, no motion against the load."""
    above = _tanh_above_one()
    trust["consumers_onnxruntime_tanh_above_one"] = len(above)
    if len(above) == 0:
        above = np.linspace(*BEYOND_ONE, 1000).astype(np.float32)
    picked = np.random.default_rng(5).choice(above, (6, HAND.branches, len(SQUASHED)))
    signs = np.random.default_rng(6).choice([-1, 1], picked.shape)
    for values, mixed in zip(picked, signs, strict=True):
        model = _with_heads(random_model(3), values * mixed)
        x = random_inputs(8, 5)
        out = run_onnx(single_thread_session(build_onnx(model, debug=True).SerializeToString()), x)
        log_range = float(model.meta["log_range"])
        for stage in ("s1", "s2"):
            assert (np.linalg.eigvalsh(out[f"{stage}_k_spring"].astype(np.float64)) > 0).all()
            assert (np.linalg.eigvalsh(out[f"{stage}_k_x"].astype(np.float64)) > 0).all()
            assert ((out[f"{stage}_gate"] >= 0) & (out[f"{stage}_gate"] <= 1)).all()
            np.testing.assert_allclose(np.linalg.norm(out[f"{stage}_tendon_dir"], axis=-1), 1, rtol=1e-6)
            gain = out[f"{stage}_tendon_gain"] / model.tensors["tendon_gain_nom"]
            np.testing.assert_allclose(np.abs(np.log(gain)), log_range, rtol=1e-6)
        assert all(np.isfinite(value).all() for value in out.values())
        assert ((out["p_stable"] >= 0) & (out["p_stable"] <= 1)).all()
        assert ((x["w_e"] * out["dx_ht"]).sum(1) >= 0).all()  # no motion against the load
