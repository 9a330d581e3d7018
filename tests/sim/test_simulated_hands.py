"""Data sets of hands of other shapes: gripper 2 x 2 with cables, 4 x 4 with servos twice, 2 x 3 + 2 with far axes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_sim import SimulationConfig, _core, simulate
from aminn_sim.open_hand import OpenHand, models_folder, open_hand
from aminn_sim.read import SimulatedData, read_data
from aminn_sim.schema import groups_of
from aminn_sim.statics import surface_curvature
from aminn_sim.theory import compliance, dataset_errors, over_grasps

HANDS = ("gripper", "allegro_like", "leap_like", "barrett_like")
CONFIG = SimulationConfig(grasps=3, cases=6, seed=3, noise_share=0.3)
# Of the built-in hand: SHA-256 of every column of the data set of CONFIG, as it was when the hand was built in.
BUILT_IN = "3652f4b1ed17832929ef9caba58f46a9e749d361bce02811abfcdab7574a05c0"
Made = tuple[OpenHand, SimulatedData, Path]


@pytest.fixture(scope="module", params=HANDS)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A hand, and a small data set of it."""
    file = models_folder() / "hands" / f"{request.param}.toml"
    folder = tmp_path_factory.mktemp("any") / request.param
    simulate(CONFIG, folder, threads=2, hand=file, progress=False)
    return open_hand(file), read_data(folder), folder


def test_shapes_follow_from_the_hand(made: Made) -> None:
    opened, data, _ = made
    dims = opened.hand.dims
    assert data.hand == opened.hand == Hand.from_dict(json.loads(json.dumps(data.manifest["hand"])))
    assert data.samples["q"].shape == (18, dims.joints) and data.samples["j_q"].shape[1:] == (
        dims.branches, 3, dims.coordinates
    )  # fmt: skip
    assert data.samples["tendon_tension_after_N"].shape == (18, dims.tendons)
    for group, fields in groups_of(data.hand).items():
        for name, field in fields.items():
            assert getattr(data, group)[name].shape[1:] == field.shape, name
    assert data.samples["stable"].any()


def test_grasps_are_held_by_enough_branches(made: Made) -> None:
    opened, data, _ = made
    touching = data.grasps["contacts"][:, :, 0] == 1
    assert (touching.sum(1) >= min(3, len(opened.hand.branches))).all()
    groups = np.array([b.group for b in opened.hand.branches])
    for name in set(groups):
        assert touching[:, groups == name].any(1).all()
    assert (data.grasps["contacts"][:, :, 7][touching] >= CONFIG.contact_force_min_N).all()


def test_closure_is_the_engines(made: Made) -> None:
    """j_q = -B against the engine's own Jacobian, and against the description alone."""
    opened, _, _ = made
    simulator, hand = opened.simulator(), opened.hand
    session = _core.Session(simulator, CONFIG.options(), CONFIG.seed, 0, 0, 0, CONFIG.family_indices())
    grasp = {k: v[0] for k, v in session.grasp().items()}
    for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
        n = len(branch.coordinates)
        if not grasp["contacts"][b, 0]:
            assert not grasp["j_q"][b].any()
            continue
        theirs = session.engine_jacobian(b)
        np.testing.assert_allclose(-grasp["j_q"][b][:, -n:], theirs[:, at], atol=1e-12)
        assert not grasp["j_q"][b][:, :-n].any()
        ours = branch.jacobian(grasp["q"][at], grasp["contacts"][b, 1:4])
        np.testing.assert_allclose(ours, theirs[:, at], atol=1e-12)


def test_labels_are_in_balance(made: Made) -> None:
    _, data, _ = made
    stable = data.samples["stable"] == 1
    assert data.samples["equilibrium_residual"][stable].max() < 0.02
    assert data.samples["drift_m_s"][stable].max() <= CONFIG.drift_max_m_s
    figures = dataset_errors(data.hand, data.samples, data.grasps)
    assert all(np.isfinite(v) for v in figures.values())


def test_small_loads_follow_the_statics(made: Made, trust: dict) -> None:
    """With the contact forces to a few per cent: geometry, springs, servos, tendons and frames are as described."""
    opened, _, _ = made
    light = replace(CONFIG, pinch_force_min_N=1.0, pinch_force_max_N=1.5, mass_max_kg=0.03, contact_force_min_N=0.1)
    results = over_grasps(opened.hand, opened.simulator(), light, 2, 2, compliance)
    errors, sticking = (np.concatenate([getattr(r, n) for r in results]) for n in ("preload_errors", "sticking"))
    trust[f"theory_preload_median_{opened.hand.name}"] = float(np.median(errors[sticking]))
    # what holds a tool between two soft fingertips from spinning is stiffer in the statics than in the engine
    limit = 0.3 if opened.hand.contact.kind == "soft_finger" else 0.05
    assert sticking.mean() > 0.4 and np.median(errors[sticking]) < limit, errors


def test_commands_take_any_hand(tmp_path: Path) -> None:
    """simulate, card and gallery for a hand that is not built in."""
    hand, out = str(models_folder() / "hands" / "allegro_like.toml"), tmp_path / "data"
    commands = [["simulate", "--hand", hand, "--grasps", "2", "--cases", "2", "--out"], ["card", "--data"]]
    pages = ["manifest.json", "card.html"]
    if find_spec("mujoco"):
        commands.append(["gallery", "--hand", hand, "--count", "1", "--data"])
        pages.append("gallery/index.html")
    for command, page in zip(commands, pages, strict=True):
        result = CliRunner().invoke(main, [*command, str(out)])
        assert result.exit_code == 0, result.output
        assert (out / page).is_file()


def test_a_tool_of_another_hand_does_not_matter(tmp_path: Path) -> None:
    """A mirrored gripper: other signs of the axes, the same data in the mirror's plane."""
    folder = models_folder() / "hands"
    text = (folder / "gripper.xml").read_text()
    turned = text.replace('pos="0 0.03 0"', 'pos="0 @ 0"').replace('pos="0 -0.03 0"', 'pos="0 0.03 0"')
    turned = turned.replace('pos="0 @ 0"', 'pos="0 -0.03 0"').replace('axis="1 0 0"', 'axis="@ 0 0"')
    turned = turned.replace('axis="-1 0 0"', 'axis="1 0 0"').replace('axis="@ 0 0"', 'axis="-1 0 0"')
    (tmp_path / "gripper.xml").write_text(turned)
    (tmp_path / "gripper.toml").write_text((folder / "gripper.toml").read_text())
    first, second = (open_hand(f / "gripper.toml").hand for f in (folder, tmp_path))
    assert first.mirror is not None and second.mirror is not None
    for one, other in zip(first.branches, second.branches, strict=True):
        np.testing.assert_allclose(np.array(one.tip_point_m) * [1, -1, 1], other.tip_point_m, atol=1e-12)
    simulate(replace(CONFIG, grasps=1), tmp_path / "data", hand=tmp_path / "gripper.toml", progress=False)
    assert read_data(tmp_path / "data").samples["stable"].any()


def test_an_asymmetric_hand_has_no_mirror(tmp_path: Path) -> None:
    folder = models_folder() / "hands"
    text = (folder / "gripper.xml").read_text()
    (tmp_path / "gripper.xml").write_text(text.replace('pos="0 0.03 0"', 'pos="0 0.04 0"'))
    (tmp_path / "gripper.toml").write_text((folder / "gripper.toml").read_text())
    assert open_hand(tmp_path / "gripper.toml").hand.mirror is None


def test_two_point_contacts_are_noted(tmp_path: Path) -> None:
    folder = models_folder() / "hands"
    (tmp_path / "gripper.xml").write_text((folder / "gripper.xml").read_text())
    (tmp_path / "gripper.toml").write_text((folder / "gripper.toml").read_text().replace("soft_finger", "point"))
    notes = open_hand(tmp_path / "gripper.toml").understood.notes
    assert any("spin about the line through both" in n and "soft_finger" in n for n in notes)


def test_what_kept_grasps_from_being_made_is_listed(tmp_path: Path) -> None:
    """Fingers that can only curl up around nothing: every reason, the most frequent first."""
    folder = models_folder() / "hands"
    text = (folder / "gripper.xml").read_text()
    narrow = text.replace('range="-0.6 1.4"', 'range="1.0 1.4"').replace('range="-0.2 1.6"', 'range="1.2 1.6"')
    (tmp_path / "gripper.xml").write_text(narrow)
    sheet = (folder / "gripper.toml").read_text()
    (tmp_path / "gripper.toml").write_text(sheet[: sheet.index("[closing]")])
    config = replace(CONFIG, grasps=1, grasp_attempts=5)
    with pytest.raises(AminnError, match=r"none of 5 attempts held the tool .most often \w+, \d times"):
        simulate(config, tmp_path / "data", hand=tmp_path / "gripper.toml", progress=False)


def test_the_built_in_hand_gives_the_same_bits(tmp_path: Path) -> None:
    simulate(CONFIG, tmp_path / "data", threads=2, progress=False)
    data, digest = read_data(tmp_path / "data"), hashlib.sha256()
    for group in ("samples", "grasps", "noise"):
        for name, values in sorted(getattr(data, group).items()):
            digest.update(name.encode() + np.ascontiguousarray(values).tobytes())
    assert digest.hexdigest() == BUILT_IN


@pytest.mark.parametrize(("kind", "size"), [(2, (0.01, 0, 0)), (3, (0.01, 0.02, 0)), (4, (0.01, 0.02, 0.03))])
def test_curvature_of_a_surface(kind: int, size: tuple[float, ...]) -> None:
    """Against the turn of the normal along the surface."""
    point = np.array([0.01, 0.0, 0.0])
    found = surface_curvature(kind, np.array(size), np.zeros(3), np.eye(3), point)
    along_y = 1 / 0.01 if kind != 4 else 0.01 / 0.02**2
    along_z = {2: 1 / 0.01, 3: 0.0, 4: 0.01 / 0.03**2}[kind]
    np.testing.assert_allclose(found, np.diag([0.0, along_y, along_z]), atol=1e-9)
