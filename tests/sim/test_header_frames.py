"""What `aminn_rt.h` says of frames, signs and times, held against the simulated hand and its data."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from aminn.data.dataset import Dataset, load_dataset
from aminn_sim import _core

TIP_RADIUS_M, BASE_X_M, BASE_Y_M, LINK_A_M, LINK_B_M = 0.010, 0.022, 0.060, 0.055, 0.045


@pytest.fixture(scope="module")
def data(dataset_dir: Path) -> Dataset:
    return load_dataset(dataset_dir)


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def _tips(q: np.ndarray) -> np.ndarray:
    """Centres of the fingertips (3, 3) from joint angles and nothing but what the header says."""
    tips = []
    for x, y, closes, roll_axis, (roll, proximal, distal) in (
        (BASE_X_M, BASE_Y_M, -1, 1, q[0:3]),
        (-BASE_X_M, BASE_Y_M, -1, -1, q[3:6]),
        (0.0, -BASE_Y_M, 1, 0, (0.0, *q[6:8])),
    ):
        lean = [np.array([0, closes * np.sin(a), np.cos(a)]) for a in (proximal, proximal + distal)]
        link = LINK_A_M * lean[0] + LINK_B_M * lean[1]
        tips.append(np.array([x, y, 0]) + _turn(np.array([0, 0, 1.0]), roll_axis * roll) @ link)
    return np.array(tips)


def test_branches_joints_and_contacts(data: Dataset) -> None:
    """Base points, links, joint zeros and signs give the fingertip; a contact lies its radius further."""
    s = data.samples
    for q, contacts in zip(s["q"], s["contacts"], strict=True):
        point, normal = contacts[:, 1:4], contacts[:, 4:7]
        assert np.abs(_tips(q) + TIP_RADIUS_M * normal - point).max() < 3e-4  # the fingertip's rubber gives way
    assert (s["contacts"][:, 0, 1] > 0).all() and (s["contacts"][:, 1, 1] < 0).all()
    assert (s["contacts"][:, :2, 2] > 0).all() and (s["contacts"][:, 2, 2] < 0).all()
    assert (s["contacts"][:, :2, 5] < -0.8).all() and (s["contacts"][:, 2, 5] > 0.8).all()
    assert (s["contacts"][..., 7] > 0).all()


def test_roll_parts_the_fingers() -> None:
    bent = np.array([0, 0.5, 0.5, 0, 0.5, 0.5, 0.5, 0.5])
    rolled = bent + np.array([0.2, 0, 0, 0.2, 0, 0, 0, 0])
    assert np.all((_tips(rolled) - _tips(bent))[:2, 0] * [1, -1] > 0)


def test_the_moment_is_about_the_tools_origin(data: Dataset, dataset_dir: Path) -> None:
    shards = [h5py.File(dataset_dir / shard["file"]) for shard in data.manifest["shards"]]
    point = np.concatenate([shard["samples/load_point_m"][()] for shard in shards])
    s = data.samples
    force, moment, arm = s["w_e"][:, :3], s["w_e"][:, 3:], point - s["x_ht"][:, :3]
    at_point = np.linalg.norm(arm, axis=1) > 1e-6
    assert at_point.any()
    np.testing.assert_allclose(moment[at_point], np.cross(arm, force)[at_point], atol=1e-12)


def test_states_are_before_the_load_under_gravity(sessions: dict[str, _core.Session], data: Dataset) -> None:
    """All cases of a grasp share one state; a load of nothing moves nothing, though the tool has a weight."""
    s = data.samples
    for grasp in np.unique(s["grasp_id"]):
        rows = s["grasp_id"] == grasp
        for name in ("q", "x_ht", "contacts"):
            assert (s[name][rows] == s[name][rows][0]).all()
    for session in sessions.values():
        assert np.abs(session.load(np.zeros(6))["dx_ht"]).max() < 5e-6


def test_displacements_are_those_of_the_tool_in_the_hand(data: Dataset) -> None:
    """The load's work is positive, and what the joints did by themselves closes the chain: j_x dx + j_q dq is small."""
    s = data.samples
    stable = s["stable"] > 0
    assert ((s["w_e"] * s["dx_ht"]).sum(1)[stable] > 0).all()
    dq = (s["q_after"] - s["q"])[:, [0, 1, 2, 3, 4, 5, 0, 6, 7]].reshape(-1, 3, 3)
    tool = np.einsum("nbij,nj->nbi", s["j_x"], s["dx_ht"])[stable]
    left = tool + np.einsum("nbij,nbj->nbi", s["j_q"], dq)[stable]
    assert np.median(np.linalg.norm(left, axis=(1, 2)) / np.linalg.norm(tool, axis=(1, 2))) < 0.3
