"""The current MuJoCo reads the same model and moves the same grasps as far."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from aminn_hand.hand import ContactModel
from aminn_hand.hand import rotation as rotation_matrix
from aminn_sim import SimulationConfig, SimulationError, _core
from aminn_sim.crosscheck import crosscheck
from aminn_sim.current_mujoco import CurrentGrasp, rotation_vector
from aminn_sim.open_hand import OpenHand, open_hand
from aminn_sim.vary import theta_of

pytest.importorskip("mujoco", reason="the extra mujoco is not installed")


@pytest.fixture(scope="module")
def hand_file() -> OpenHand:
    return open_hand(None)


@pytest.fixture(scope="module")
def session(hand_file: OpenHand) -> _core.Session:
    config = SimulationConfig()
    return _core.Session(hand_file.simulator(), config.options(), 4, 0, 1, 1, config.family_indices())


def test_displacements_agree(hand_file: OpenHand) -> None:
    figures = crosscheck(SimulationConfig(), hand_file, seed=5, grasps=8, cases=3)
    print(figures)
    assert figures["current_mujoco_cases"] >= 8
    assert figures["current_mujoco_relative_difference_median"] < 0.05
    assert figures["current_mujoco_rest_shift_m_max"] < 1e-5


def test_displacements_of_varied_hands_agree(hand_file: OpenHand) -> None:
    config = SimulationConfig(vary_mechanics=1.0)
    figures = crosscheck(config, hand_file, seed=5, grasps=4, cases=3)
    assert figures["current_mujoco_cases"] >= 4
    assert figures["current_mujoco_relative_difference_median"] < 0.05
    assert figures["current_mujoco_rest_shift_m_max"] < 1e-5
    simulator, theta = hand_file.simulator(), theta_of(config, hand_file.hand, 0)
    session = _core.Session(simulator, config.options(), 5, 0, 0, 0, [0], theta)
    as_described = CurrentGrasp(hand_file, session.scene())
    assert np.linalg.norm(as_described.load(np.zeros(6), 0.2, 0.2)[:3]) > 1e-4  # at rest in the varied hand alone


def test_the_comparison_would_notice(hand_file: OpenHand, session: _core.Session) -> None:
    """Softer tendons in one of the two: the displacements part."""
    case = session.load(np.array([0.4, -0.5, 0.6, 0.01, 0.02, -0.01]))
    other = CurrentGrasp(hand_file, session.scene())
    same = other.load(case["w_e"][0], 0.2, float(case["hold_time_s"][0]))
    other.model.actuator_gainprm[:, 0] *= 0.5
    other.model.actuator_biasprm[:, 1] *= 0.5
    softer = other.load(case["w_e"][0], 0.2, float(case["hold_time_s"][0]))
    size = np.linalg.norm(case["dx_ht"][0])
    assert np.linalg.norm(same - case["dx_ht"][0]) < 0.05 * size < np.linalg.norm(softer - case["dx_ht"][0])


def test_the_settled_grasp_is_the_same(hand_file: OpenHand, session: _core.Session) -> None:
    """Pose, contacts and contact forces, as the other version sees them."""
    grasp = {name: rows[0] for name, rows in session.grasp().items()}
    other = CurrentGrasp(hand_file, session.scene())
    position, rotation = other.tool_pose()
    np.testing.assert_allclose(position, grasp["x_ht"][:3], atol=1e-9)
    np.testing.assert_allclose(rotation, rotation_matrix(grasp["x_ht"][3:]), atol=1e-9)
    points, forces = other.contact_forces()
    assert len(points) == 3
    for point, normal, size in zip(
        grasp["contacts"][:, 1:4], grasp["contacts"][:, 4:7], grasp["contacts"][:, 7], strict=True
    ):
        near = int(np.argmin(np.linalg.norm(points - point, axis=1)))
        np.testing.assert_allclose(points[near], point, atol=1e-5)
        np.testing.assert_allclose(forces[near] @ normal, size, rtol=0.02)
    weight = grasp["tool_mass_kg"] * grasp["gravity_m_s2"]
    np.testing.assert_allclose(forces.sum(0) + weight, 0, atol=0.02 * np.abs(forces).max())


def test_a_placed_grasp_is_where_it_was_put(hand_file: OpenHand, session: _core.Session) -> None:
    grasp = {name: rows[0] for name, rows in session.grasp().items()}
    other = CurrentGrasp(hand_file, session.scene())
    dx = np.array([1e-3, -2e-3, 3e-3, 0.1, -0.2, 0.3])
    other.place(grasp["q"], grasp["x_ht"], dx)
    position, rotation = other.tool_pose()
    np.testing.assert_allclose(position, grasp["x_ht"][:3] + dx[:3], atol=1e-12)
    np.testing.assert_allclose(rotation_vector(rotation @ rotation_matrix(grasp["x_ht"][3:]).T), dx[3:], atol=1e-9)


def test_pairs_of_convex_geoms_have_one_contact(hand_file: OpenHand, session: _core.Session) -> None:
    """A cylinder that stands on the palm has four by default in MuJoCo 4, and one in the simulation's 2.2."""
    import mujoco

    scene = session.scene()
    cylinder = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
    scene["tool_geoms"] = [{"type": cylinder, "size": [0.01, 0.02, 0], "pos": [0, 0, 0], "quat": [1, 0, 0, 0]}]
    other = CurrentGrasp(hand_file, scene)
    other.place(session.grasp()["q"][0], np.array([0, 0, 0.0119, 0, 0, 0]), np.zeros(6))
    mujoco.mj_forward(other.model, other.data)
    pairs = [tuple(sorted(contact.geom)) for contact in other.data.contact]
    assert len(pairs) == len(set(pairs)) > 0


def test_tool_rests_whatever_integrator_the_model_names(hand_file: OpenHand, session: _core.Session) -> None:
    """With noslip, the integrator "discrete" moves an unloaded tool through the hand, by 0.3 to 1.1 mm/s."""
    scene = hand_file.understood.scene.replace('integrator="implicit"', 'integrator="discrete"')
    assert 'integrator="discrete"' in scene
    other = replace(hand_file, understood=replace(hand_file.understood, scene=scene))
    rest = CurrentGrasp(other, session.scene()).load(np.zeros(6), 0.1, 0.1)
    assert np.linalg.norm(rest[:3]) < 1e-6


def test_soft_fingers_pass_on_a_moment(hand_file: OpenHand, session: _core.Session) -> None:
    hand = replace(hand_file.hand, contact=ContactModel("soft_finger", 0.003))
    other = CurrentGrasp(replace(hand_file, understood=replace(hand_file.understood, hand=hand)), session.scene())
    assert set(other.data.contact.dim) == {4}


def test_missing_package_is_named(monkeypatch, hand_file: OpenHand, session: _core.Session) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(SimulationError, match=r"mujoco cannot be imported.*pip install 'aminn\[mujoco\]'"):
        CurrentGrasp(hand_file, session.scene())


def test_model_that_it_does_not_take_is_named(hand_file: OpenHand, session: _core.Session) -> None:
    broken = replace(hand_file, understood=replace(hand_file.understood, scene="<mujoco><nothing/></mujoco>"))
    with pytest.raises(SimulationError, match=r"hand\.xml: MuJoCo 4.* does not take this model"):
        CurrentGrasp(broken, session.scene())
