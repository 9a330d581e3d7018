"""Models of hands of many shapes: ONNX against float64, contract, batch, metadata."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import onnx
import pytest
from hands import HANDS, UNEVEN, Model, made_up, random_model, random_states, same_eps_m

from aminn.evaluation.metrics import holds
from aminn.prediction.onnx_session import check_graph
from aminn_base.errors import AminnError
from aminn_export.files.onnx_model import build_onnx, onnx_metadata
from aminn_export.files.tables import by_branch, dims_of
from aminn_export.judge.fidelity import SquareRootReference
from aminn_export.judge.verdict import compare_within
from aminn_export.judge.verify import scaled_norm
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import Results
from aminn_hand.hand import OUTPUTS, Hand

N = 200


@pytest.fixture(scope="module", params=HANDS)
def hand(request: pytest.FixtureRequest) -> Iterator[Hand]:
    return HANDS[request.param]()


@pytest.fixture(scope="module")
def model(hand: Hand) -> Model:
    return random_model(hand, 1, widths=UNEVEN)


@pytest.fixture(scope="module")
def states(hand: Hand) -> dict[str, np.ndarray]:
    return random_states(hand, N, 5)


def _run(model: Model, inputs: dict, debug: bool = False) -> dict[str, np.ndarray]:
    return run_onnx(single_thread_session(build_onnx(model, debug).SerializeToString()), inputs)


def test_counts_come_from_the_tables(hand: Hand, model: Model) -> None:
    found, dims = dims_of(model), replace(hand.dims, twist=hand.contact.kind == "soft_finger")
    assert (found.inputs, found.outputs, found.debug) == (dims.inputs, dims.outputs, dims.debug)
    assert (found.head, found.aux, found.gates) == (dims.head, dims.aux, dims.gates)


@pytest.mark.parametrize("debug", [False, True])
def test_names_and_shapes_are_the_contract(hand: Hand, model: Model, debug: bool) -> None:
    """`build_onnx` has checked it; every shape can be inferred too."""
    built = onnx.shape_inference.infer_shapes(build_onnx(model, debug), check_type=True, strict_mode=True)
    stages = {f"{stage}_{k}": shape for stage in ("s1", "s2") for k, shape in hand.dims.debug.items()}
    wanted = hand.dims.outputs | (stages if debug else {})
    for values, shapes in ((built.graph.input, hand.dims.inputs), (built.graph.output, wanted)):
        found = {v.name: tuple(d.dim_param or d.dim_value for d in v.type.tensor_type.shape.dim) for v in values}
        assert found == {k: ("N", *shape) for k, shape in shapes.items()}
    assert {n.domain for n in built.graph.node} == {""}
    check_graph(single_thread_session(built.SerializeToString()), hand.dims, "aminn.onnx")  # which ONNX Runtime infers


def test_outputs_are_those_of_float64(hand: Hand, model: Model, states: dict[str, np.ndarray]) -> None:
    """Within the tolerances that every runtime is judged by."""
    exact, out = Reference(model)(states), _run(model, states)
    decided = holds(exact["p_stable"], model.meta["tau"]).astype(np.float32)
    as_results = Results(out, holds(out["p_stable"], model.meta["tau"]).astype(np.float32), np.zeros(N, np.int32))
    single = {name: exact[name].astype(np.float32) for name in OUTPUTS}
    verdict = compare_within(as_results, single, model.meta["tau"], hand.length_m, symmetric=False)
    print(hand.name, {k: f"{v:.2g}" for k, v in verdict.figures.items()})
    assert verdict.failures == []
    assert 0 < decided.mean() < 1


def test_intermediate_values_are_those_of_float64(hand: Hand, model: Model, states: dict[str, np.ndarray]) -> None:
    exact, out = Reference(model)(states), _run(model, states, debug=True)
    assert set(exact) == set(out)
    for name, value in out.items():
        assert value.shape == exact[name].shape and np.isfinite(value).all(), name
        if name.endswith(("dx", "dx0", "dx_ht")):
            relative = scaled_norm(value - exact[name]) / scaled_norm(exact[name])
        else:
            size = np.abs(exact[name]).reshape(N, -1).max(1)
            relative = np.abs(value - exact[name]).reshape(N, -1).max(1) / np.maximum(size, 1e-6)
        if name.endswith("gate"):  # the sigmoid of a steep function
            relative = np.abs(value - exact[name]).max(1)
        assert np.median(relative) < 1e-4 and relative.max() < 0.1, name
    without = np.array([branch.gated_tendon is None for branch in hand.branches])
    assert (out["gate"][:, without] == 0).all() and (out["s1_gate"][:, ~without].max(0, initial=0) > 0.1).all()
    assert not out["s2_tendon_dir"][:, without].any() and not out["s2_tendon_gain"][:, without].any()
    if not hand.dims.gates:
        np.testing.assert_array_equal(out["s2_dx"], out["s2_dx0"])
        assert not any(out[f"s1_{k}"].any() for k in ("tendon_dir", "tendon_gain", "gate_params"))


def test_both_float64_forms_agree(model: Model, states: dict[str, np.ndarray]) -> None:
    plain, root = Reference(model)(states), SquareRootReference(model)(states)
    for name in OUTPUTS:
        np.testing.assert_allclose(root[name], plain[name], rtol=1e-5, atol=1e-8 * np.abs(plain[name]).max())


def test_soft_fingertips_resist_a_twist(hand: Hand, model: Model, states: dict[str, np.ndarray]) -> None:
    """About the normals of closed contacts, and by what the head says: the rest of K_x stays."""
    if hand.contact.kind != "soft_finger":
        assert "twist_nom" not in model.tensors
        return
    none = replace(model, tensors=model.tensors | {"twist_nom": np.zeros_like(model.tensors["twist_nom"])})
    added = Reference(model)(states)["k_x"] - Reference(none)(states)["k_x"]
    if hand.dims.gates:  # which change with it
        assert np.abs(added[:, 3:, 3:]).max() > 1e-4
        return
    np.testing.assert_allclose(added[:, :3], 0, atol=1e-9 * np.abs(added).max())
    normal, closed = states["contacts"][..., 4:7].astype(float), states["contacts"][..., 0] > 0
    along = np.einsum("nbi,nij,nbj->nb", normal, added[:, 3:, 3:], normal)
    assert (along[closed] > 1e-4).all() and np.linalg.eigvalsh(added[:, 3:, 3:])[:, 0].min() > -1e-12
    assert np.trace(added, axis1=1, axis2=2).std() > 1e-5


@pytest.mark.parametrize("n", [0, 1, 7])
def test_batch_size_is_free(hand: Hand, model: Model, states: dict[str, np.ndarray], n: int) -> None:
    some = _run(model, {k: v[:n] for k, v in states.items()}, debug=True)
    many = _run(model, states, debug=True)
    for name, value in some.items():
        assert value.shape == (n, *many[name].shape[1:])
        np.testing.assert_allclose(value, many[name][:n], rtol=2e-3, atol=1e-5 * np.abs(many[name]).max(initial=1e-9))


def test_metadata_holds_the_hand(hand: Hand, model: Model) -> None:
    read = {key: json.loads(value) for key, value in onnx_metadata(model.meta).items()}
    assert Hand.from_dict(read["hand"]) == hand
    assert read["joint_order"] == list(hand.joints)
    assert read["branch_order"] == [b.name for b in hand.branches]
    assert read["branch_joints"] == [list(row) for row in hand.coordinate_joints]
    b = hand.dims.branches
    np.testing.assert_array_equal(by_branch(read["eps_m"], b), by_branch(model.meta["eps_m"], b))
    assert json.loads(onnx_metadata(same_eps_m(model, 1e-5).meta)["eps_m"]) == 1e-5


def test_compliance_by_branch_counts(model: Model, states: dict[str, np.ndarray]) -> None:
    """Each branch's own, in the graph as in float64."""
    values = [[1e-5 * 3**b for b in range(model.tensors["coord_mask"].shape[0])]] * 2
    own = replace(model, meta=model.meta | {"eps_m": values})
    swapped = replace(model, meta=model.meta | {"eps_m": [v[::-1] for v in values]})
    for changed in (own, swapped):
        out, exact = _run(changed, states)["k_x"], Reference(changed)(states)["k_x"]
        relative = np.abs(out - exact).max((1, 2)) / np.abs(exact).max((1, 2))
        assert np.quantile(relative, 0.95) < 1e-5
    assert np.abs(_run(own, states)["k_x"] - _run(swapped, states)["k_x"]).max() > 1


def with_inverse(hand: Hand) -> Model:
    model = random_model(hand)
    return replace(model, meta=model.meta | {"dq0": "inverse"})


@pytest.mark.parametrize("joints", [(1, 2), (4, 4, 4), (5, 5)])
def test_inverse_of_j_q_is_for_three_coordinates(joints: tuple[int, ...]) -> None:
    model = with_inverse(made_up(joints, (1,) * len(joints), "other"))
    for use in (build_onnx, Reference):
        with pytest.raises(AminnError, match=r"'inverse'.*not 3|3 coordinates"):
            use(model)
    hand = made_up((3, 2), (1, 1), "three")
    three, x = with_inverse(hand), random_states(hand, 50)
    assert np.median(np.abs(_run(three, x)["gate"] - Reference(three)(x)["gate"])) < 1e-5


def test_states_of_another_hand_do_not_run(model: Model) -> None:
    session = single_thread_session(build_onnx(model).SerializeToString())
    other = random_states(made_up((1,) * 4, (0,) * 4, "four_by_one"), 3)
    with pytest.raises(Exception, match=r"(?i)invalid dimensions"):
        session.run(["dx_ht"], other)
