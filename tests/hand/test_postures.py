"""The search for postures that pinch a tool."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import Branch
from aminn_sim.open_hand import default_hand_file
from aminn_sim.postures import HEIGHTS_M, RADII_M, _reaching, find_synergy, pinch_frame
from aminn_sim.understand import Understood, understand

HANDS = default_hand_file().parent / "hands"


def shipped(name: str) -> Understood:
    return understand(HANDS / f"{name}.toml")


@pytest.mark.parametrize("name", ["barrett_like", "aero_like"])  # the second has couplings
def test_a_posture_has_the_bits_that_it_has_alone(name: str) -> None:
    """Whatever is sought beside it, so that a hand's synergy space depends on nothing else."""
    understood = shipped(name)
    hand, middle = understood.hand, np.mean(understood.postures, axis=0)
    centre, R = pinch_frame(hand, middle, np.array(hand.tool_axis))
    tools = list(product(RADII_M, HEIGHTS_M))
    centres = np.array([centre + height * R[:, 2] for _, height in tools])
    distances = np.array([[radius] * len(hand.branches) for radius, _ in tools])
    limits = np.full(len(hand.joints), -0.2), np.full(len(hand.joints), 1.4)
    q, reached = _reaching(hand, middle, centres, distances, R, limits)
    assert len(np.unique(q, axis=0)) > 5
    for i in (0, 7, 14):
        alone = _reaching(hand, middle, centres[i : i + 1], distances[i : i + 1], R, limits)
        assert (alone[0].tobytes(), alone[1][0]) == (q[i].tobytes(), reached[i])


def test_what_is_reached_lies_where_the_tool_is() -> None:
    understood = shipped("leap_like")
    hand, middle = understood.hand, np.mean(understood.postures, axis=0)
    centre, R = pinch_frame(hand, middle, np.array(hand.tool_axis))
    distances = np.array([[radius] * len(hand.branches) for radius in RADII_M])
    limits = np.full(len(hand.joints), -3.0), np.full(len(hand.joints), 3.0)
    q, reached = _reaching(hand, middle, np.tile(centre, (len(RADII_M), 1)), distances, R, limits)
    off, side = (hand.tips(q) - centre) @ R, np.where(np.isin(np.arange(len(hand.branches)), hand.sides[0]), 1, -1)
    assert reached.all()
    np.testing.assert_allclose(off[..., 1], side * distances, atol=1.5e-3)


def _apart(hand: Hand) -> Hand:
    """Its thumb is half a metre away."""
    out = list(hand.branches)
    for b in hand.sides[1]:
        moved = tuple(
            replace(c, anchor_m=(c.anchor_m[0], c.anchor_m[1], c.anchor_m[2] + 0.5)) for c in out[b].coordinates
        )
        x, y, z = out[b].tip_point_m
        out[b] = replace(out[b], coordinates=moved, tip_point_m=(x, y, z + 0.5))
    return replace(hand, branches=tuple(out))


@pytest.mark.parametrize("name", ["aero_like", "leap_like"])
def test_a_hand_that_reaches_no_tool_is_refused_soon(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a hundred steps that all tools share; it took 17 s to 25 s where each of 75 places had its own."""
    understood = shipped(name)
    hand, q = _apart(understood.hand), np.mean(understood.postures, axis=0)
    steps = []
    jacobian = Branch.jacobian
    monkeypatch.setattr(Branch, "jacobian", lambda branch, at: (steps.append(at), jacobian(branch, at))[1])
    with pytest.raises(AminnError, match="the fingertips reach no tool of 16 to 50 mm"):
        find_synergy(hand, (q, q), np.zeros(len(hand.branches)))
    assert 0 < len(steps) <= 100 * len(hand.branches)
