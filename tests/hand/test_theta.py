"""The mechanics parameters of a hand: what they are called, and what they do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aminn.hand.nominal import nominal_of, stiffness_terms
from aminn_hand import Hand
from aminn_hand.theta import KINDS, Theta
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

MODELS = default_hand_file().parent
FILES = [MODELS / "hand.toml", *sorted((MODELS / "hands").glob("*.toml"))]
REFERENCE = (
    "spring_finger1_roll",
    "spring_finger1_proximal",
    "spring_finger1_distal",
    "spring_thumb_proximal",
    "spring_thumb_distal",
    "servo_finger1_roll",
    "tendon_finger1_proximal_flexor",
    "tendon_finger1_distal_flexor",
    "tendon_thumb_proximal_flexor",
    "tendon_thumb_distal_flexor",
    "contact_finger1",
    "contact_finger2",
    "contact_thumb",
)


@pytest.fixture(scope="module", params=FILES, ids=lambda p: p.stem)
def hand(request: pytest.FixtureRequest) -> Hand:
    file: Path = request.param
    return understand(file).hand


def test_names_of_the_reference_hand() -> None:
    hand = understand(MODELS / "hand.toml").hand
    theta = Theta(hand)
    assert theta.names == (*REFERENCE, *(f"zero_{j}" for j in hand.joints), "radius_tips")
    assert (theta.stiff, theta.factors, len(theta)) == (10, 13, 22)
    shared = {p.name: p.parts for p in theta.parameters}
    assert shared["spring_finger1_proximal"] == ("finger1_proximal", "finger2_proximal")
    assert shared["spring_thumb_distal"] == ("thumb_distal",)


def test_every_part_has_one_parameter(hand: Hand) -> None:
    theta = Theta(hand)
    assert len(set(theta.names)) == len(theta)
    assert [KINDS.index(p.kind) for p in theta.parameters] == sorted(KINDS.index(p.kind) for p in theta.parameters)
    parts = [(p.kind, part) for p in theta.parameters for part in p.parts]
    assert len(set(parts)) == len(parts)
    stiff = {(kind, c.joint) for b in hand.branches for c in b.coordinates
             for kind, value in (("spring", c.spring_Nm_rad), ("servo", c.servo_Nm_rad)) if value > 0}  # fmt: skip
    stiff |= {("tendon", t.name) for b in hand.branches for t in b.tendons if t.stiffness_N_m > 0}
    assert {part for part in parts if part[0] in ("spring", "servo", "tendon")} == stiff


def test_terms_give_the_nominal_of_the_varied_hand(hand: Hand) -> None:
    theta, terms, rng = Theta(hand), stiffness_terms(hand), np.random.default_rng(1)
    rows, cols = np.transpose(hand.dims.cholesky_entries)
    for values in (np.zeros(len(theta)), rng.uniform(-0.5, 0.5, len(theta))):
        nominal = nominal_of(theta.varied(values))
        sums = terms[0] + np.tensordot(np.exp(values[: theta.stiff]), terms[1:], 1)
        lower = np.zeros((hand.dims.branches, hand.dims.coordinates, hand.dims.coordinates))
        lower[:, rows, cols] = nominal.chol
        springs = (lower @ lower.transpose(0, 2, 1))[:, rows, cols]
        np.testing.assert_allclose(sums[:, :-1], springs, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(sums[:, -1], nominal.tendon_gain, rtol=1e-12)
        at = slice(theta.stiff, theta.factors)
        np.testing.assert_allclose(nominal.eps_m, nominal_of(hand).eps_m * np.exp(values[at]), rtol=1e-12)


def test_varied_by_nothing_is_the_hand(hand: Hand) -> None:
    assert Theta(hand).varied(np.zeros(len(Theta(hand)))) == hand


def test_measured_states_are_corrected(hand: Hand) -> None:
    theta, rng = Theta(hand), np.random.default_rng(2)
    values = np.zeros(len(theta))
    values[theta.zeros], values[-1] = rng.normal(size=len(hand.joints)), 1e-3
    q, contacts = rng.normal(size=(4, len(hand.joints))), rng.normal(size=(4, hand.dims.branches, 8))
    true_q, moved = theta.corrected(values, q, contacts)
    np.testing.assert_array_equal(true_q, q + values[theta.zeros])
    np.testing.assert_array_equal(moved[..., 1:4], contacts[..., 1:4] + 1e-3 * contacts[..., 4:7])
    np.testing.assert_array_equal(np.delete(moved, [1, 2, 3], -1), np.delete(contacts, [1, 2, 3], -1))
