"""Mistakes in data of a hand whose theta is not known: each is named, and nothing in clean data."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import Draw
from synthetic import HANDS, draw_inputs, draw_wrench

from aminn.calibration.fit import Errors
from aminn.calibration.mistakes import Mistake, find_mistakes, mistakes_of
from aminn.calibration.pushes import FIELDS, Predict, Pushes
from aminn_hand import Hand

ERRORS = Errors(relative=0.01, deviation=0.03, freedom=3.0)


def kinds(hand: Hand) -> dict[str, list[Mistake]]:
    found: dict[str, list[Mistake]] = {}
    for m in mistakes_of(hand):
        found.setdefault(f"{m.name} {m.variant}".strip(), []).append(m)
    return found


NAMES = [name for name in kinds(HANDS["reference"]) if "turned_twice" not in name]


@pytest.mark.parametrize("name", NAMES)
def test_mistakes_are_named(predict: Predict, draw: Draw, lab_hand: Hand, name: str) -> None:
    mistake = kinds(lab_hand)[name][-1]
    found = find_mistakes(predict, mistake.made(draw(200, 12, 3)[0]), errors=ERRORS)
    assert mistake.name in {f.mistake.name for f in found}
    assert found[0].relative_error_median < 0.15


def test_nothing_is_named_in_clean_data(predict: Predict, draw: Draw, trust: dict) -> None:
    named = [find_mistakes(predict, draw(300 + seed, 12, 3)[0], errors=ERRORS) for seed in range(6)]
    trust["calibrate_made_up_clean_named"] = sum(map(bool, named))
    assert not any(named)


@pytest.mark.parametrize("shape", list(HANDS))
def test_mistakes_go_back_and_forth(shape: str) -> None:
    hand, rng = HANDS[shape], np.random.default_rng(3)
    rows = [draw_inputs(rng, hand) | {"w_e": draw_wrench(rng), "dx_ht": 1e-3 * rng.normal(size=6)} for _ in range(3)]
    pushes = Pushes(hand, **{f: np.stack([r[f] for r in rows]) for f in FIELDS}, grasp_id=np.arange(3))
    for mistake in mistakes_of(hand):
        made = mistake.made(pushes)
        back = mistake.mended(made)
        assert any(not np.array_equal(getattr(made, f), getattr(pushes, f)) for f in FIELDS), mistake.detail
        for f in FIELDS:
            assert np.allclose(getattr(back, f), getattr(pushes, f), rtol=1e-9, atol=1e-12), mistake.detail
