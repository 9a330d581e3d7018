"""One grasp: its kinematics against the engine's and against finite differences, its loads, its tendons."""

from __future__ import annotations

import numpy as np
import pytest

from aminn_sim import SimulationConfig, _core
from aminn_sim.open_hand import open_hand
from aminn_sim.theory import branch_turns

FAMILIES = _core.TOOL_FAMILIES
HAND = open_hand().hand
BRANCH_JOINTS = HAND.coordinate_joints


def state(session: _core.Session) -> dict[str, np.ndarray]:
    return {k: v[0] for k, v in session.grasp().items()}


def load(session: _core.Session, w_e: np.ndarray) -> dict[str, np.ndarray]:
    return {k: v[0] for k, v in session.load(w_e).items() if k != "noise"}


def unit(n: int, i: int, size: float) -> np.ndarray:
    out = np.zeros(n)
    out[i] = size
    return out


def test_psi_and_posture_are_inverse(simulator: _core.Simulator) -> None:
    rng = np.random.default_rng(0)
    for psi in rng.uniform(-1, 1, (20, 3)):
        q = simulator.posture_of(psi)
        np.testing.assert_allclose(simulator.psi_of(q), psi, rtol=0, atol=1e-12)
        np.testing.assert_allclose(simulator.posture_of(simulator.psi_of(q)), q, rtol=0, atol=1e-12)
        assert q[0] == q[3] and q[1] == q[4] and q[2] == q[5]  # mirrored fingers
    opened, spread, curled = (simulator.posture_of(e) - simulator.posture_of(np.zeros(3)) for e in np.eye(3))
    assert opened[1] < 0 and opened[6] < 0  # a larger size opens
    assert spread[0] > 0 and np.abs(spread[[1, 2, 6, 7]]).max() < 1e-12
    assert curled[2] > 0 and curled[7] > 0


def test_vectors_of_a_wrong_length_are_refused(simulator: _core.Simulator) -> None:
    with pytest.raises(ValueError, match="q has 7 entries, expected 8"):
        simulator.psi_of(np.zeros(7))
    with pytest.raises(ValueError, match="psi is not finite"):
        simulator.posture_of(np.array([0, np.nan, 0]))


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
def test_geometry_of_the_manifest_gives_the_closure(sessions: dict[str, _core.Session], family: str) -> None:
    """Who has q, the contacts and `hand` alone (the runtime) finds the same j_q."""
    grasp = state(sessions[family])
    for b, (branch, at) in enumerate(zip(HAND.branches, HAND.branch_joints, strict=True)):
        columns = branch.jacobian(grasp["q"][at], grasp["contacts"][b, 1:4])
        np.testing.assert_allclose(-columns, grasp["j_q"][b][:, -len(branch.coordinates) :], atol=1e-12)


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
        turns = branch_turns(HAND, result["q_after"] - grasp["q"])
        residuals.append(np.linalg.norm(tool + np.einsum("bij,bj->bi", grasp["j_q"], turns)) / np.linalg.norm(tool))
    assert np.median(residuals) < 0.05, residuals


@pytest.mark.parametrize("family", FAMILIES)
def test_normals_point_into_the_tool(sessions: dict[str, _core.Session], family: str) -> None:
    grasp = state(sessions[family])
    for row in grasp["contacts"]:
        assert row[4:7] @ (grasp["x_ht"][:3] - row[1:4]) > 0
    assert grasp["contacts"][0, 5] < -0.5 and grasp["contacts"][2, 5] > 0.5  # fingers press towards -y, the thumb to +y


@pytest.mark.parametrize("family", FAMILIES)
def test_a_wrench_accelerates_the_tool_along_itself(sessions: dict[str, _core.Session], family: str) -> None:
    """In free flight without gravity: v = F/m t and omega = R I^-1 R^T M t, both in the axes of H."""
    session, grasp = sessions[family], state(sessions[family])
    mass, inertia, seconds = grasp["tool_mass_kg"], grasp["tool_inertia_kg_m2"], 0.02
    assert np.abs(grasp["base_pose"][3:5]).max() > 0.1  # H is turned against the world, so that a mixed-up frame shows
    force, moment = np.array([0.3, -0.2, 0.5]), np.array([1e-5, 2e-5, -3e-5])
    turn = grasp["x_ht"][3:]
    R = rotation(turn / np.linalg.norm(turn), float(np.linalg.norm(turn)))
    v = session.free_flight(np.r_[force, moment], seconds)
    np.testing.assert_allclose(v[:3], force / mass * seconds, rtol=1e-3, atol=1e-6)
    expected = R @ np.diag(1 / inertia) @ R.T @ moment * seconds
    np.testing.assert_allclose(v[3:], expected, rtol=2e-2, atol=2e-3 * np.linalg.norm(expected))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_force_at_the_origin_does_not_turn_the_tool(sessions: dict[str, _core.Session], family: str) -> None:
    v = sessions[family].free_flight(np.array([1.0, 2.0, -1.0, 0, 0, 0]), 0.02)
    assert np.linalg.norm(v[:3]) > 0.1 and np.linalg.norm(v[3:]) < 1e-9


def test_no_load_moves_nothing(sessions: dict[str, _core.Session]) -> None:
    for session in sessions.values():
        result = load(session, np.zeros(6))
        assert result["stable"] and np.linalg.norm(result["dx_ht"]) < 2e-5


def test_cases_start_from_the_same_state(sessions: dict[str, _core.Session]) -> None:
    """The same load gives the same bits whatever was simulated in between."""
    session = sessions["screwdriver"]
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
    session = _core.Session(simulator, options, 5, 2, 1, 101, [0, 1, 2])
    np.testing.assert_array_equal(state(session)["q"], shard["grasps"]["q"][1])
    assert shard["grasps"]["grasp_id"].tolist() == [100, 101]
    for k in range(2):
        case = session.next_case()
        for name in ("w_e", "load_point_m", "dx_ht", "stable"):
            np.testing.assert_array_equal(case[name][0], shard["samples"][name][2 + k])


def test_tendons_only_pull(sessions: dict[str, _core.Session]) -> None:
    session, grasp = sessions["capsule"], state(sessions["capsule"])
    tendons = [t for branch in HAND.branches for t in branch.tendons]
    stiffness = np.array([t.stiffness_N_m for t in tendons])
    tension = grasp["tendon_tension_N"]
    np.testing.assert_allclose(session.tendon_forces(0.0), -tension, atol=1e-9)
    taut = tension > 0
    pulled = -session.tendon_forces(-1e-3)  # a shorter command pulls
    np.testing.assert_allclose((pulled - tension)[taut], (stiffness * 1e-3)[taut], rtol=1e-9)
    assert (session.tendon_forces(0.1) == 0).all()  # a far longer one is slack, never pushes
    limit = [t.max_tension_N for t in tendons]
    np.testing.assert_allclose(-session.tendon_forces(-1.0), limit)


def test_engine_errors_are_exceptions(simulator: _core.Simulator) -> None:
    session = _core.Session(simulator, SimulationConfig().options(), 0, 0, 0, 0, [1])
    with pytest.raises(_core.MujocoError, match="Stack overflow"):
        session.provoke_engine_error()
    assert load(session, np.zeros(6))["stable"]  # and the grasp is usable afterwards


def test_contact_forces_balance_the_load(sessions: dict[str, _core.Session]) -> None:
    rng = np.random.default_rng(5)
    for session in sessions.values():
        for _ in range(4):
            case = load(session, rng.normal(size=6) * [1, 1, 1, 0.02, 0.02, 0.02])
            assert not case["stable"] or case["equilibrium_residual"] < 0.01


def test_a_case_is_simulated_again_otherwise(sessions: dict[str, _core.Session]) -> None:
    session, w = sessions["cylinder"], np.array([0.4, -0.3, 0.2, 0.004, 0.0, -0.003])
    plain, again = session.load(w), session.load(w, True)
    assert len(plain["noise"]["sample"]) == 0 and again["noise"]["sample"].tolist() == [0]
    np.testing.assert_array_equal(plain["dx_ht"], again["dx_ht"])  # and the options are as before
    for name in ("half_step", "impratio"):
        apart = np.linalg.norm(again["noise"][f"dx_{name}"] - again["dx_ht"]) / np.linalg.norm(again["dx_ht"])
        assert again["noise"][f"stable_{name}"][0] and 0 < apart < 0.05


def test_loads_are_those_of_the_configuration(simulator: _core.Simulator) -> None:
    config = SimulationConfig()
    samples = simulator.shard(config.options(), 3, 0, 0, 4, 40, 2, [0, 1, 2, 3])["samples"]
    force, moment = (np.linalg.norm(samples["w_e"][:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    arm = samples["load_point_m"] - samples["x_ht"][:, :3]
    at_a_point = np.linalg.norm(arm, axis=1) > 0
    assert (force[force > 0] >= 0.1 - 1e-12).all() and force.max() <= 20 and moment.max() <= 0.5 + 1e-12
    for kind, share in ((moment == 0, 0.25), (force == 0, 0.20), (at_a_point, 0.30)):
        assert abs(kind.mean() - share) < 0.12
    np.testing.assert_allclose(
        np.cross(arm, samples["w_e"][:, :3])[at_a_point], samples["w_e"][at_a_point, 3:], atol=1e-12
    )


def test_lost_contacts_have_a_time(sessions: dict[str, _core.Session]) -> None:
    case = load(sessions["ellipsoid"], np.array([0, 15.0, 0, 0, 0, 0]))
    lost = case["lost_time_s"]
    assert case["contact_lost"] and (lost.max() > 0) and ((lost == -1) | (lost > 0)).all()
    held = load(sessions["ellipsoid"], np.array([0.2, 0, 0, 0, 0, 0.0]))
    assert (held["lost_time_s"] == -1).all() and 0 < held["settle_time_s"] <= held["hold_time_s"]
