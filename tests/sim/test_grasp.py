"""One grasp: its kinematics against the engine's and against finite differences, its loads, its tendons."""

from __future__ import annotations

import numpy as np
import pytest

from aminn_sim import SimulationConfig, _core
from aminn_sim.fidelity import BRANCH_JOINTS, branch_turns

FAMILIES = _core.TOOL_FAMILIES


def state(session: _core.Session) -> dict[str, np.ndarray]:
    return {k: v[0] for k, v in session.grasp().items()}


def load(session: _core.Session, w_e: np.ndarray) -> dict[str, np.ndarray]:
    return {k: v[0] for k, v in session.load(w_e).items()}


def unit(n: int, i: int, size: float) -> np.ndarray:
    out = np.zeros(n)
    out[i] = size
    return out


def test_psi_and_posture_are_inverse() -> None:
    rng = np.random.default_rng(0)
    for psi in rng.uniform(-1, 1, (20, 3)):
        q = _core.posture_of(psi)
        np.testing.assert_allclose(_core.psi_of(q), psi, atol=1e-12)
        assert q[0] == q[3] and q[1] == q[4] and q[2] == q[5]  # mirrored fingers
    opened, spread, curled = (_core.posture_of(e) - _core.posture_of(np.zeros(3)) for e in np.eye(3))
    assert opened[1] < 0 and opened[6] < 0  # a larger size opens
    assert spread[0] > 0 and np.abs(spread[[1, 2, 6, 7]]).max() < 1e-12
    assert curled[2] > 0 and curled[7] > 0


def test_vectors_of_a_wrong_length_are_refused() -> None:
    with pytest.raises(ValueError, match="q has 7 entries, expected 8"):
        _core.psi_of(np.zeros(7))
    with pytest.raises(ValueError, match="psi is not finite"):
        _core.posture_of(np.array([0, np.nan, 0]))


@pytest.mark.parametrize("family", FAMILIES)
def test_joint_side_of_the_closure(sessions: dict[str, _core.Session], family: str) -> None:
    """j_q = -B against the engine's Jacobian, and against moving the joints."""
    session, grasp = sessions[family], state(sessions[family])
    step = 1e-5
    for b, joints in enumerate(BRANCH_JOINTS):
        engine = session.engine_jacobian(b)
        assert engine.shape == (3, 8)
        for c, j in enumerate(joints):
            column = -grasp["j_q"][b][:, c]
            if j < 0:
                assert (column == 0).all()
                continue
            plus, minus = (session.fingertip_point(b, unit(8, j, s)) for s in (step, -step))
            np.testing.assert_allclose(engine[:, j], column, atol=1e-12)
            np.testing.assert_allclose((plus - minus) / (2 * step), column, atol=1e-9)
        others = [j for j in range(8) if j not in joints]
        assert (engine[:, others] == 0).all()


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    k = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@pytest.mark.parametrize("family", FAMILIES)
def test_geometry_of_the_manifest_gives_the_closure(
    simulator: _core.Simulator, sessions: dict[str, _core.Session], family: str
) -> None:
    """Who has q, the contacts and `hand` alone (the runtime) finds the same j_q."""
    hand, grasp = {k: np.array(v) for k, v in simulator.hand().items() if k != "tendons"}, state(sessions[family])
    for b, joints in enumerate(BRANCH_JOINTS):
        axes, (roll, proximal, _) = hand["axis"][b], (grasp["q"][j] if j >= 0 else 0.0 for j in joints)
        r1, r2 = rotation(axes[0], roll), rotation(axes[1], proximal)
        s = grasp["contacts"][b, 1:4] - hand["base_m"][b]
        a = r1 @ r2 @ hand["link_a_m"][b]
        columns = [np.cross(axes[0], s), np.cross(r1 @ axes[1], s), np.cross(r1 @ r2 @ axes[2], s - a)]
        np.testing.assert_allclose(-np.stack(columns, 1), grasp["j_q"][b], atol=1e-12)


@pytest.mark.parametrize("family", FAMILIES)
def test_tool_side_of_the_closure(sessions: dict[str, _core.Session], family: str) -> None:
    session, grasp = sessions[family], state(sessions[family])
    step = 1e-5
    for b in range(3):
        columns = [
            (session.tool_point(b, unit(6, i, step)) - session.tool_point(b, unit(6, i, -step))) / (2 * step)
            for i in range(6)
        ]
        np.testing.assert_allclose(np.stack(columns, 1), grasp["j_x"][b], atol=1e-9)
        np.testing.assert_allclose(session.tool_point(b, np.zeros(6)), grasp["contacts"][b, 1:4], atol=1e-12)
        np.testing.assert_allclose(session.fingertip_point(b, np.zeros(8)), grasp["contacts"][b, 1:4], atol=1e-12)


@pytest.mark.parametrize("family", FAMILIES)
def test_closure_holds_for_small_simulated_motions(sessions: dict[str, _core.Session], family: str) -> None:
    """J_x dx + J_q dq = 0 for what the simulation does: left over is the contacts' own give and rolling."""
    session, grasp = sessions[family], state(sessions[family])
    rng = np.random.default_rng(3)
    residuals = []
    for _ in range(6):
        w = rng.normal(size=6) * np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005])
        result = load(session, w)
        assert result["stable"]
        tool = np.einsum("bij,j->bi", grasp["j_x"], result["dx_ht"])
        turns = branch_turns(result["q_after"] - grasp["q"])
        residuals.append(np.linalg.norm(tool + np.einsum("bij,bj->bi", grasp["j_q"], turns)) / np.linalg.norm(tool))
    assert np.median(residuals) < 0.05, residuals


@pytest.mark.parametrize("family", FAMILIES)
def test_normals_point_into_the_tool(sessions: dict[str, _core.Session], family: str) -> None:
    grasp = state(sessions[family])
    for row in grasp["contacts"]:
        assert row[4:7] @ (grasp["x_ht"][:3] - row[1:4]) > 0
    assert grasp["contacts"][0, 5] < -0.5 and grasp["contacts"][2, 5] > 0.5  # fingers press towards -y, the thumb to +y


def test_a_force_accelerates_the_tool_along_itself(sessions: dict[str, _core.Session]) -> None:
    """In free flight without gravity: v = F/m t and, for a ball, omega = M/I t, both in the axes of H."""
    session, grasp = sessions["ball"], state(sessions["ball"])
    mass, radius, seconds = grasp["tool_mass_kg"], grasp["tool_size_m"][0], 0.02
    assert np.abs(grasp["base_pose"][3:5]).max() > 0.1  # H is turned against the world, so that a mixed-up frame shows
    force, moment = np.array([0.3, -0.2, 0.5]), np.array([1e-4, 2e-4, -3e-4])
    v = session.free_flight(np.r_[force, moment], seconds)
    np.testing.assert_allclose(v[:3], force / mass * seconds, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(v[3:], moment / (0.4 * mass * radius**2) * seconds, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("family", ["handle", "block"])
def test_a_force_at_the_origin_does_not_turn_the_tool(sessions: dict[str, _core.Session], family: str) -> None:
    v = sessions[family].free_flight(np.array([1.0, 2.0, -1.0, 0, 0, 0]), 0.02)
    assert np.linalg.norm(v[:3]) > 0.1 and np.linalg.norm(v[3:]) < 1e-9


def test_no_load_moves_nothing(sessions: dict[str, _core.Session]) -> None:
    for session in sessions.values():
        result = load(session, np.zeros(6))
        assert result["stable"] and np.linalg.norm(result["dx_ht"]) < 2e-5


def test_cases_start_from_the_same_state(sessions: dict[str, _core.Session]) -> None:
    """The same load gives the same bits whatever was simulated in between."""
    session = sessions["block"]
    w, hard = np.array([0.5, -0.4, 0.3, 0.01, 0.0, -0.01]), np.array([0, 0, 60.0, 0, 0, 0])
    first = load(session, w)
    lost = load(session, hard)
    assert not lost["stable"] and lost["reason"] != 0
    session.tendon_forces(0.001)
    again = load(session, w)
    for name, value in first.items():
        np.testing.assert_array_equal(value, again[name], err_msg=name)


def test_a_session_repeats_the_data_set(simulator: _core.Simulator) -> None:
    options = SimulationConfig().options()
    shard = simulator.shard(options, 5, 2, 100, 2, 2, 2, [0, 1, 2])
    session = _core.Session(simulator, options, 5, 2, 1, [0, 1, 2])
    np.testing.assert_array_equal(state(session)["q"], shard["grasps"]["q"][1])
    assert shard["grasps"]["grasp_id"].tolist() == [100, 101]
    for k in range(2):
        w = session.draw_wrench()
        np.testing.assert_array_equal(w, shard["samples"]["w_e"][2 + k])
        np.testing.assert_array_equal(load(session, w)["dx_ht"], shard["samples"]["dx_ht"][2 + k])


def test_tendons_only_pull(sessions: dict[str, _core.Session], simulator: _core.Simulator) -> None:
    session, grasp = sessions["handle"], state(sessions["handle"])
    tendons = simulator.hand()["tendons"]
    stiffness = np.array([t["stiffness_N_m"] for t in tendons])
    tension = grasp["tendon_tension_N"]
    np.testing.assert_allclose(session.tendon_forces(0.0), -tension, atol=1e-9)
    taut = tension > 0
    pulled = -session.tendon_forces(-1e-3)  # a shorter command pulls
    np.testing.assert_allclose((pulled - tension)[taut], (stiffness * 1e-3)[taut], rtol=1e-9)
    assert (session.tendon_forces(0.1) == 0).all()  # a far longer one is slack, never pushes
    limit = [t["max_tension_N"] for t in tendons]
    np.testing.assert_allclose(-session.tendon_forces(-1.0), limit)


def test_hand_is_read_from_the_model(simulator: _core.Simulator) -> None:
    hand = simulator.hand()
    for b in range(3):
        arms = np.array([t["moment_arm_m"] for t in hand["tendons"] if t["branch"] == b])
        assert arms.shape == (2, 3)
        assert (arms[:, 1] > 0).all() and arms[0, 2] == 0 and arms[1, 2] > 0 and (arms[:, 0] == 0).all()
    axes = np.array(hand["axis"])
    np.testing.assert_allclose(np.linalg.norm(axes, axis=2), [[1, 1, 1], [1, 1, 1], [0, 1, 1]], atol=1e-12)
    assert hand["joint_stiffness_Nm_rad"][2][0] == 0
    np.testing.assert_allclose(np.array(hand["base_m"])[0] * [-1, 1, 1], hand["base_m"][1])  # mirrored fingers


def test_engine_errors_are_exceptions(simulator: _core.Simulator) -> None:
    session = _core.Session(simulator, SimulationConfig().options(), 0, 0, 0, [1])
    with pytest.raises(_core.MujocoError, match="Stack overflow"):
        session.provoke_engine_error()
    assert load(session, np.zeros(6))["stable"]  # and the grasp is usable afterwards


def test_model_errors_name_the_file(tmp_path) -> None:
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    with pytest.raises(_core.MujocoError, match=r"broken\.xml"):
        _core.Simulator(str(broken))
    other = tmp_path / "other.xml"
    other.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(_core.MujocoError, match="no body named palm"):
        _core.Simulator(str(other))
