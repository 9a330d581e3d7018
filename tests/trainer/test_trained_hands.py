"""Hands of ten shapes through training, evaluation, explanation and report; and models of one on data of another."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import HANDS, draw_inputs, draw_wrench, write_dataset
from untrained import WIDE

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.origin import differences
from aminn.evaluation.analysis import breakdown, gate_figures, noise_figures
from aminn.evaluation.evaluate import evaluate, learned
from aminn.hand.closure import closure, fingertips
from aminn.model.checkpoint import META, Checkpoint, load_checkpoint
from aminn.model.config import MechanicsConfig, ModelConfig, TrainConfig
from aminn.model.network import Aminn
from aminn.pages.explain import as_text, draw, explain_sample
from aminn.pages.grasp_picture import branch_points
from aminn.training.train import train
from aminn_app.pipeline import run_report
from aminn_base.errors import AminnError, OutdatedError
from aminn_base.files import write_json
from aminn_hand import Hand
from aminn_hand.hand import ContactModel
from aminn_hand.sensors import NOMINAL_FRICTION
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

SHIPPED = sorted((default_hand_file().parent / "hands").glob("*.toml"))
Made = tuple[str, Dataset, dict[str, Checkpoint]]


@pytest.fixture(scope="module", params=HANDS)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A hand's name, a data set of it, a trained model of each kind."""
    folder = tmp_path_factory.mktemp("hand")
    write_dataset(folder / "data", grasps=50, cases=6, of=HANDS[request.param])
    data = load_dataset(folder / "data")
    config = TrainConfig(epochs=4, batch=32, weight_decay=0.5, model=WIDE)
    return request.param, data, {k: train(replace(config, kind=k), data, folder / k) for k in ("aminn", "mlp")}


def test_training_learns_and_keeps_the_hand(made: Made) -> None:
    name, data, runs = made
    assert data.hand == HANDS[name]
    for run in runs.values():
        assert load_checkpoint(run.path).model.hand == HANDS[name]
        for stage in ("stage1", "stage2"):
            curve = run.meta["history"][stage]["train"]
            assert curve[-1] < curve[0]


def test_outputs_have_the_shapes_of_the_hand(made: Made) -> None:
    name, data, runs = made
    dims, x = HANDS[name].dims, {k: v[:5] for k, v in data.inputs().items()}
    out = runs["aminn"].model.debug(**x)
    shapes = dims.outputs | {f"s{k}_{n}": shape for k in (1, 2) for n, shape in dims.debug.items()}
    assert {n: tuple(v.shape) for n, v in out.items()} == {n: (5, *s) for n, s in shapes.items()}
    gated = torch.tensor([b.gated_tendon is not None for b in HANDS[name].branches])
    assert ((out["gate"] > 0) == gated).all() and ((x["w_e"] * out["dx_ht"]).sum(1) > 0).all()


def test_evaluation_and_its_parts(made: Made) -> None:
    """Every table; figures of gates where there are some."""
    name, data, runs = made
    result = evaluate(list(runs.values()), data)
    assert set(result.table) == {"aminn", "mlp", "analytical", "analytical_stick", "no_motion"}
    assert result.table["aminn"]["passivity_violation_full"] == 0
    seen = learned(runs["aminn"], data, "aminn")
    has_gates = HANDS[name].dims.gates > 0
    assert ("gate_auroc" in gate_figures(seen, data)) == has_gates
    assert any(key.startswith("tendons_") for key in breakdown(seen, data)) == has_gates
    assert np.isfinite(noise_figures(runs["aminn"], data)["noise1"]["relative_error_median_all"])


def test_explanation_names_each_joint(made: Made) -> None:
    name, data, runs = made
    e = explain_sample(runs["aminn"], data, 3)
    text, numbers = as_text(e), e.flat()
    for b, branch in enumerate(HANDS[name].branches):
        assert branch.name in text
        for i, joint in e.joints_of(b):
            assert f"{joint} {e.stiffness[b, i, i]:.3f} N.m/rad" in text
            assert f"{branch.name}_{joint}_stiffness_Nm_rad" in numbers
        assert (f"{branch.name}_gate" in numbers) == (branch.gated_tendon is not None)
    assert ("engaged" in text) == (HANDS[name].dims.gates > 0)


def test_closure_is_that_of_the_data_and_moves_the_fingertips(made: Made) -> None:
    """B dq is what fingertips do, for small turns of all joints."""
    name, data, _ = made
    hand, s, step = HANDS[name], data.samples, 1e-6
    j_x, j_q = closure(hand, s["q"], s["x_ht"], s["contacts"])
    np.testing.assert_allclose(j_x, s["j_x"], atol=1e-12)
    np.testing.assert_allclose(j_q, s["j_q"], atol=1e-12)
    dq = np.random.default_rng(0).normal(size=s["q"].shape)
    moved = fingertips(hand, s["q"], s["q"] + step * dq, s["contacts"][..., 1:4]) - s["contacts"][..., 1:4]
    rows = np.array(hand.coordinate_joints)
    by_branch = np.where(rows >= 0, dq[:, rows], 0.0)  # (n, B, C)
    np.testing.assert_allclose(moved / step, -(j_q @ by_branch[..., None])[..., 0], atol=1e-5)


def test_links_are_drawn_from_the_palm_to_the_tip(made: Made) -> None:
    name, data, _ = made
    hand, q = HANDS[name], data.samples["q"][0]
    for b, branch in enumerate(hand.branches):
        points = branch_points(hand, b, q)
        bends = len({c.anchor_m for c in branch.coordinates})
        assert len(points) == bends + 1
        at = hand.branch_joints[b]
        np.testing.assert_allclose(points[-1], branch.moved(q[at], np.array(branch.tip_point_m)), atol=1e-12)


@pytest.mark.parametrize("file", SHIPPED, ids=lambda p: p.stem)
def test_hands_that_are_shipped_go_the_same_way(file: Path, tmp_path: Path) -> None:
    hand = understand(file).hand
    write_dataset(tmp_path / "data", grasps=40, cases=6, of=hand)
    data = load_dataset(tmp_path / "data")
    run = train(TrainConfig(epochs=2, batch=32), data, tmp_path / "run")
    assert load_checkpoint(run.path).model.hand == hand == data.hand
    assert evaluate([run], data).table["aminn"]["passivity_violation_full"] == 0
    text = as_text(explain_sample(run, data, 3))
    assert all(branch.name in text for branch in hand.branches) and ("engaged" in text) == (hand.dims.gates > 0)


@pytest.mark.parametrize("name", ["gripper 2x2", "5x5"])
def test_pages_are_written(name: str, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", grasps=40, cases=6, of=HANDS[name])
    data = load_dataset(tmp_path / "data")
    run = train(TrainConfig(epochs=1), data, tmp_path / "run")
    draw(explain_sample(run, data, 3), tmp_path / "why.png")
    run_report(evaluate([run], data), [run], {}, tmp_path / "data", tmp_path / "page.html")
    assert (tmp_path / "why.png").stat().st_size > 10_000 and "A grasp under load" in (
        tmp_path / "page.html"
    ).read_text()


def damaged(path: Path, **changes: object) -> None:
    content = json.loads(path.read_text())
    content["hand"] |= changes
    write_json(path, content)


def test_a_damaged_hand_is_refused_by_name(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", grasps=40, of=HANDS["2x3+2"])
    data = load_dataset(tmp_path / "data")
    run = train(TrainConfig(epochs=1), data, tmp_path / "run")
    damaged(tmp_path / "data" / "manifest.json", length_m=-1)
    with pytest.raises(AminnError, match=r"manifest\.json: .*length_m: is -1.*simulate the data set again"):
        load_dataset(tmp_path / "data")
    (tmp_path / "run" / "card.md").unlink()
    damaged(run.path / META, branches=[])
    with pytest.raises(OutdatedError, match=r"model\.json: .*0 branches; 2 to 5 are supported.*train again"):
        load_checkpoint(run.path)
    meta = json.loads((run.path / META).read_text())
    write_json(run.path / META, meta | {"format_version": 3})
    with pytest.raises(OutdatedError, match="format_version 3, this program reads 6; train again"):
        load_checkpoint(run.path)


def test_a_checkpoint_of_another_hand_is_refused(made: Made, tmp_path: Path) -> None:
    name, _, runs = made
    other = "reference" if name != "reference" else "5x5"
    write_dataset(tmp_path / "data", grasps=20, of=HANDS[other])
    with pytest.raises(AminnError, match=r"trained for another hand than that of the data set .they differ in"):
        evaluate([runs["aminn"]], load_dataset(tmp_path / "data"))


def test_what_differs_between_hands_is_named() -> None:
    hand = HANDS["asymmetric"]
    first, *others = hand.branches
    coordinate, *rest = first.coordinates

    def changed(**fields: object) -> Hand:
        return replace(hand, branches=(replace(first, **fields), *others))

    for other, names in (
        (hand, []),
        (changed(coordinates=(replace(coordinate, spring_Nm_rad=1.0), *rest)), ["springs"]),
        (changed(coordinates=(replace(coordinate, axis=(0.0, 0.6, 0.8)), *rest)), ["axes of joints"]),
        (changed(coordinates=(replace(coordinate, joint="twist"), *rest)), ["branches and joints"]),
        (changed(coordinates=tuple(rest), tendons=()), ["branches and joints"]),
        (changed(eps_m=2e-5), ["compliance of contacts"]),
        (changed(tendons=()), ["springs", "arms of tendons", "stiffness of tendons"]),
        (replace(hand, contact=ContactModel("soft_finger", 0.003)), ["kind of contact"]),
        (replace(hand, length_m=0.2), ["length_m"]),
    ):
        assert differences(hand, other) == names


def test_soft_fingertips_resist_twisting_by_default() -> None:
    hand = HANDS["gripper 2x2"]
    soft = replace(hand, contact=ContactModel("soft_finger", 0.003))

    def heads(of: Hand, **settings: object) -> list[bool]:
        model = Aminn(ModelConfig(**settings), of)
        return [stage.backbone.twist_head is not None for stage in (model.stage1, model.stage2)]

    assert heads(hand) == [False, False] and heads(soft) == [True, True]
    assert heads(soft, soft_finger=False) == [False, False] and heads(hand, soft_finger=True) == [True, True]


def test_an_untrained_model_of_soft_fingertips_resists_twisting_as_their_patch_does() -> None:
    """Else nothing but eps_Kx would hold a tool that two fingertips pinch, and nothing learned were far from it."""
    hand = replace(HANDS["gripper 2x2"], contact=ContactModel("soft_finger", 0.003))
    rng = np.random.default_rng(0)
    rows = [draw_inputs(rng, hand) | {"w_e": 1e-3 * draw_wrench(rng)} for _ in range(5)]  # no contact slides
    x = {k: torch.tensor(np.stack([r[k] for r in rows])) for k in rows[0]}
    plain, soft = (
        Aminn(ModelConfig(soft_finger=on), hand).double().stage2.backbone.nominal_response(x).k_x
        for on in (False, True)
    )
    normal = x["contacts"][..., 4:7]
    stiffness = torch.tensor([(0.003 / NOMINAL_FRICTION) ** 2 / b.eps_m for b in hand.branches])
    wanted = (stiffness[:, None, None] * normal[..., :, None] * normal[..., None, :]).sum(1)
    torch.testing.assert_close((soft - plain)[:, 3:, 3:], wanted, rtol=1e-5, atol=1e-5)
    assert stiffness.min() > 0.5  # N.m/rad


def test_contact_compliance_is_the_hands_unless_it_is_told() -> None:
    hand = HANDS["asymmetric"]
    own = Aminn(ModelConfig(), hand).stage2.backbone
    assert own.eps_m == [b.eps_m for b in hand.branches]
    with torch.no_grad():
        own.eps_m_change += np.log(2)
    assert own.eps_m == pytest.approx([2 * b.eps_m for b in hand.branches])
    told = ModelConfig(mechanics=(MechanicsConfig(eps_m=3e-5),) * 2)
    assert Aminn(told, hand).stage2.backbone.eps_m == [3e-5] * 3


def test_the_papers_inverse_is_for_three_joints_a_branch() -> None:
    config = ModelConfig(mechanics=(MechanicsConfig(dq0="inverse"),) * 2)
    with pytest.raises(AminnError, match=r'dq0 = "inverse" .*hand five has up to 5: take "statics"'):
        Aminn(config, HANDS["5x5"])
