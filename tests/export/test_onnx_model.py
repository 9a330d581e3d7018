"""The ONNX model: its contract, its bytes, and its numbers against float64 and against the paper's dense form."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from runtime_models import RandomModel, random_inputs, random_model

from aminn.model.config import MechanicsConfig
from aminn.model.mechanics import dense_stiffness
from aminn_base.errors import AminnError
from aminn_export.files.onnx_model import build_onnx, read_metadata, write_onnx
from aminn_export.files.tables import dims_of
from aminn_export.judge.verify import scaled_norm
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_hand.hand import INPUTS, OUTPUTS

HAND = dims_of(random_model(1))
STAGE_SHAPES = {f"{stage}_{name}": shape for stage in ("s1", "s2") for name, shape in HAND.debug.items()}


def _run(model: RandomModel, inputs: dict, debug: bool = False) -> dict[str, np.ndarray]:
    return run_onnx(single_thread_session(build_onnx(model, debug).SerializeToString()), inputs)


def _shapes(values: object) -> dict[str, tuple]:
    return {v.name: tuple(d.dim_param or d.dim_value for d in v.type.tensor_type.shape.dim) for v in values}


@pytest.mark.parametrize(("debug", "extra"), [(False, {}), (True, STAGE_SHAPES)])
def test_names_and_shapes_are_the_contract(exported: RandomModel, debug: bool, extra: dict) -> None:
    graph = build_onnx(exported, debug).graph
    assert _shapes(graph.input) == {k: ("N", *s) for k, s in HAND.inputs.items()}
    assert _shapes(graph.output) == {k: ("N", *s) for k, s in (HAND.outputs | extra).items()}
    kinds = {v.type.tensor_type.elem_type for v in (*graph.input, *graph.output)}
    assert kinds == {onnx.TensorProto.FLOAT}


def test_standard_operators_only_and_few(exported: RandomModel) -> None:
    model = build_onnx(exported)
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 18)]
    assert {n.domain for n in model.graph.node} == {""}
    assert len(model.graph.node) < (700 if HAND.slides else 275)
    onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)


def test_same_tables_give_the_same_bytes(exported: RandomModel, export_dir: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])\n"
        "from runtime_models import random_model; from aminn_export.files.onnx_model import write_onnx\n"
        "write_onnx(random_model(1), Path(sys.argv[1]), debug=True)"
    )
    file = tmp_path / "other.onnx"
    helpers = str(Path(__file__).resolve().parent.parent / "runtime")
    subprocess.run([sys.executable, "-c", code, str(file), helpers], check=True)
    assert file.read_bytes() == (export_dir / "aminn_debug.onnx").read_bytes()


def test_metadata_is_lossless_json(tmp_path: Path) -> None:
    meta = {"tau": float(np.float32(0.1) + np.float32(0.2)), "eps_m": [1e-4 / 3, 1e-4 / 3], "eps_kx": [1e-3 / 7, 2e-3]}
    model = random_model(2)
    model = replace(model, meta=model.meta | meta)
    write_onnx(model, tmp_path / "m.onnx")
    read = read_metadata(tmp_path / "m.onnx")
    assert read["tau"] == meta["tau"]
    assert read["eps_m"] == 1e-4 / 3
    assert read["eps_kx"] == meta["eps_kx"]
    assert read["eps_jq"] == 1e-3
    assert read["dq0"] == "statics"
    assert read["format_version"] == 1
    assert read["checkpoint_sha256"] == model.meta["checkpoint_sha256"]
    assert read["joint_order"] == model.meta["joints"]
    assert read["branch_order"] == model.meta["branches"]
    assert set(INPUTS) | set(OUTPUTS) <= set(read["units"])
    for prop in onnx.load(tmp_path / "m.onnx").metadata_props:
        json.loads(prop.value)


@pytest.mark.parametrize("fade", [False, True])
@pytest.mark.parametrize("dq0", ["statics", "inverse"])
def test_every_output_repeats_float64(dq0: str, fade: bool) -> None:
    model, x = random_model(3, dq0=dq0), random_inputs(600, 5, fade)
    out, exact = _run(model, x, debug=True), Reference(model)(x)
    for name, value in out.items():
        assert np.isfinite(value).all(), name
        assert value.dtype == np.float32
        if name.endswith(("dx", "dx0", "dx_ht")):
            relative = scaled_norm(value - exact[name]) / scaled_norm(exact[name])
            print(f"{name}: median {np.median(relative):.1e}, largest {relative.max():.1e}")
            assert np.median(relative) < 2e-6
            assert relative.max() < 1e-3
        else:
            size = np.abs(exact[name]).reshape(len(value), -1).max(1)
            difference = np.abs(value - exact[name]).reshape(len(value), -1).max(1) / np.maximum(size, 1e-6)
            print(f"{name}: largest {difference.max():.1e}")
            assert np.median(difference) < 1e-5
            assert difference.max() < 2e-2


def test_debug_model_repeats_the_model(exported: RandomModel) -> None:
    x = random_inputs(20, 6)
    plain, debug = _run(exported, x), _run(exported, x, debug=True)
    for name, value in plain.items():
        np.testing.assert_array_equal(value, debug[name])
    for name in ("k_x", "gate"):
        np.testing.assert_array_equal(debug[name], debug[f"s2_{name}"])
    np.testing.assert_array_equal(debug["dx_ht"], debug["s2_dx"])


@pytest.mark.parametrize("n", [0, 1, 2, 33])
def test_batch_size_is_free(exported: RandomModel, n: int) -> None:
    x = random_inputs(33, 7)
    session = single_thread_session(build_onnx(exported).SerializeToString())
    all_at_once = run_onnx(session, x)
    part = run_onnx(session, {k: v[:n] for k, v in x.items()})
    for name, value in part.items():
        assert value.shape == (n, *HAND.outputs[name])
        np.testing.assert_allclose(value, all_at_once[name][:n], rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("debug", [False, True])
@pytest.mark.parametrize("dq0", ["statics", "inverse"])
def test_inputs_of_another_batch_size_are_refused(dq0: str, debug: bool) -> None:
    """Whichever inputs differ, and by however much: none is broadcast, and an empty one does not count as absent."""
    x = random_inputs(6, 7)
    session = single_thread_session(build_onnx(random_model(3, dq0=dq0), debug).SerializeToString())
    sizes = [(n, other) for n in (1, 2, 5) for other in (0, 1, n - 1, n + 1) if other != n]
    subsets = [s for size in range(1, len(INPUTS)) for s in itertools.combinations(INPUTS, size)]
    accepted = []
    for (n, other), some in itertools.product(sizes, subsets):
        try:
            session.run(["dx_ht"], {name: v[: other if name in some else n] for name, v in x.items()})
        except Exception:  # ONNX Runtime's exceptions have no common base of their own
            continue
        accepted.append((n, other, some))
    assert accepted == []


@pytest.mark.parametrize("name", INPUTS)
def test_inputs_of_another_shape_are_refused(exported: RandomModel, name: str) -> None:
    session = single_thread_session(build_onnx(exported).SerializeToString())
    x = random_inputs(3, 7)
    for wrong in (x[name][..., None], x[name][None], x[name][0], x[name][..., :-1], np.repeat(x[name], 2, -1)):
        with pytest.raises(Exception, match=r"(?i)invalid (rank|dimensions)"):
            session.run(["dx_ht"], x | {name: wrong})


def test_zero_rows_and_zero_load_stay_finite(exported: RandomModel) -> None:
    x = {k: v.copy() for k, v in random_inputs(4, 8).items()}
    x["w_e"][0] = 0
    for name in ("contacts", "j_x", "j_q"):
        x[name][1] = 0  # no branch in contact: only eps_kx holds the tool
        x[name][2, :2] = 0
    out = _run(exported, x, debug=True)
    assert all(np.isfinite(v).all() for v in out.values())
    np.testing.assert_array_equal(out["dx_ht"][0], 0)
    np.testing.assert_array_equal(out["s1_dq0"][1], 0)
    np.testing.assert_array_equal(out["s1_dq0"][:, 2, 0], 0)  # the thumb has no roll


def test_branch_out_of_contact_has_no_influence(exported: RandomModel) -> None:
    x = {k: v.copy() for k, v in random_inputs(8, 9).items()}
    x["contacts"][:, 1] = 0
    noisy = {k: v.copy() for k, v in x.items()}
    noisy["j_x"][:, 1] += 1
    noisy["j_q"][:, 1] += 0.1
    noisy["contacts"][:, 1, 1:] = 3
    clean, changed = _run(exported, x), _run(exported, noisy)
    for name in ("p_stable", "dx_ht", "k_x"):
        np.testing.assert_array_equal(clean[name], changed[name])
    np.testing.assert_array_equal(clean["gate"][:, [0, 2]], changed["gate"][:, [0, 2]])


def test_stiffness_is_the_dense_form_of_the_paper(exported: RandomModel) -> None:
    x = random_inputs(50, 10)
    meta = exported.meta | {"friction_nominal": 1e6}  # so that nothing slides
    out = _run(replace(exported, meta=meta), x, debug=True)
    for i, stage in enumerate(("s1", "s2")):
        values = {k: torch.as_tensor(out[f"{stage}_{k}"], dtype=torch.float64) for k in HAND.debug}
        d, engaged = values["tendon_dir"], values["tendon_gain"] * values["gate"]
        k_q = values["k_spring"] + engaged[..., None, None] * d[..., :, None] * d[..., None, :]
        closure = (torch.as_tensor(x[k], dtype=torch.float64) for k in ("j_x", "j_q"))
        contact = torch.as_tensor(x["contacts"][..., 0], dtype=torch.float64)
        config, eps_m = MechanicsConfig(eps_kx=meta["eps_kx"][i]), torch.tensor(meta["eps_m"][i], dtype=torch.float64)
        dense = dense_stiffness(k_q, contact, *closure, eps_m, config).numpy()
        difference = np.abs(out[f"{stage}_k_x"] - dense).max((1, 2)) / np.abs(dense).max((1, 2))
        print(f"{stage}: largest relative difference from the dense form {difference.max():.1e}")
        assert difference.max() < 1e-4


@pytest.mark.parametrize(("key", "value"), [("eps_m", 0.0), ("eps_kx", [1e-3, 0.0]), ("dq0", "guess")])
def test_impossible_constants_are_refused(exported: RandomModel, key: str, value: object) -> None:
    with pytest.raises(AminnError, match=key):
        build_onnx(replace(exported, meta=exported.meta | {key: value}))
