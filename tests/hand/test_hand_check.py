"""Descriptions of hands, right and wrong: each is refused by name, or accepted with the right value."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from variants import MODELS, replaced, write

from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_sim.acceptance import accept
from aminn_sim.hand_check import FORMULA_LIMIT, PRELOADED_LIMIT, Check, check
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import Understood, understand

REFUSED = {
    "no springs and no servos": ("finger1_roll", "not positive definite", "servo_Nm_rad"),
    "a cable without a force": ("invalid force range", "finger1_proximal_flexor"),
    "tendons of the wrong sign": ("finger1", "straightens", "negative coefficients"),
    "friction of 1 mN.m": ("finger1_proximal 0.001 N.m", "drop", "keep"),
    "friction in a tendon": ("thumb_distal_flexor 0.4 N", "drop", "keep"),
    "limits that are not enforced": ("finger1_roll", "not enforced", 'limited="true"'),
    "millimetres": ("55 m long", "millimetres?"),
    "degrees": ("degrees?", "radian"),
    "degrees in a model of radians": ("finger1_roll", "degrees?"),
    "a joint that two fingers share": ("knuckles", "finger1_distal", "finger2_distal", "lock"),
    "a closed loop": ("closes a loop",),
    "fingers coupled with each other": ("finger1 and finger2",),
    "a joint that slides": ("thumb_distal slides", "locked"),
    "a fingertip that touches nothing": ("thumb", "no colliding geom"),
    "servos that are motors": ("finger1_distal", "servo_Nm_rad"),
}
# Of the accepted ones: branches, coordinates of the longest, joints, and what the description must say.
ACCEPTED = {
    "joints that are damped a hundred times more": (3, 3, 8),
    "a fourth finger": (4, 3, 10),
    "a middle joint": (3, 4, 9),
    "a thumb with a roll": (3, 3, 9),
    "distal coupled to proximal": (3, 3, 8),
    "box fingertips": (3, 3, 8),
    "ellipsoid fingertips": (3, 3, 8),
    "tendons that push": (3, 3, 8),
    "a roll axis 30 mm aside": (3, 3, 8),
    "a spatial tendon": (3, 3, 8),
    "wrists above the palm": (3, 3, 8),
}


def test_every_variant_is_judged() -> None:
    assert set(REFUSED) | set(ACCEPTED) == set(MODELS)


@pytest.mark.parametrize("name", REFUSED)
def test_wrong_description_is_refused_by_name(name: str, tmp_path: Path) -> None:
    with pytest.raises(AminnError) as error:
        understand(write(tmp_path, MODELS[name]))
    for words in REFUSED[name]:
        assert words in str(error.value), error.value
    assert str(tmp_path) in str(error.value)


@pytest.mark.parametrize("name", ACCEPTED)
def test_other_shapes_are_understood_and_accepted(name: str, tmp_path: Path) -> None:
    understood = understand(write(tmp_path, MODELS[name]))
    dims = understood.hand.dims
    assert (dims.branches, dims.coordinates, dims.joints) == ACCEPTED[name]
    done = Check(understood, accept(understood, grasps=2, seed=1), 0.5)
    assert done.medians[0] < PRELOADED_LIMIT and done.medians[1] < FORMULA_LIMIT, done.figures()
    _right_value(name, understood)


def test_soft_fingers_are_judged_by_point_contacts() -> None:
    """The ball of the acceptance test is held by points; the gripper's fingertips resist a twist in the simulation."""
    gripper = understand(default_hand_file().parent / "hands" / "gripper.toml")
    assert gripper.hand.contact.kind == "soft_finger"
    assert Check(gripper, accept(gripper, grasps=2), 0.5).medians[0] < PRELOADED_LIMIT


def test_what_stands_in_the_file_before_the_hand_is_left_out(tmp_path: Path) -> None:
    table = '<worldbody><body name="table" pos="0 0 -1"><geom size="0.1"/></body>'
    found = understand(write(tmp_path, replaced(("<worldbody>", table)))).hand
    assert found.joints == understand(default_hand_file()).hand.joints


def _right_value(name: str, understood: Understood) -> None:
    """What a variant changes stands in the description."""
    finger = understood.hand.branches[0]
    if name == "distal coupled to proximal":
        assert [c.ratio for c in finger.couplings] == [(0.0, -1.0, 1.0)] and finger.couplings[0].stiffness_Nm_rad > 0
    if name == "tendons that push":
        assert not any(t.pull_only for b in understood.hand.branches for t in b.tendons) and finger.gated_tendon is None
        assert sum("pulls and pushes" in note for note in understood.notes) == 6
    if name == "a roll axis 30 mm aside":
        assert np.allclose(finger.coordinates[0].anchor_m, (0.052, 0.060, 0.0))
        assert np.allclose(finger.coordinates[1].anchor_m, (0.022, 0.060, 0.0))
    if name == "a spatial tendon":
        arm = finger.tendons[1].arm_m
        assert finger.tendons[1].pull_only and arm[0] == pytest.approx(0, abs=3e-3) and arm[1] > 2e-3 and arm[2] > 2e-3
    if name == "wrists above the palm":
        assert understood.locked[-1] != "" and "wrist" in understood.locked


def changed(hand: Hand, **coordinate: float) -> Hand:
    """The hand with a branch's second coordinate changed by factors."""
    branch = hand.branches[0]
    one = branch.coordinates[1]
    other = dataclasses.replace(one, **{k: getattr(one, k) * f for k, f in coordinate.items()})
    coordinates = (branch.coordinates[0], other, *branch.coordinates[2:])
    return dataclasses.replace(
        hand, branches=(dataclasses.replace(branch, coordinates=coordinates), *hand.branches[1:])
    )


def stiffer_tendons(hand: Hand) -> Hand:
    return dataclasses.replace(
        hand,
        branches=tuple(
            dataclasses.replace(
                b, tendons=tuple(dataclasses.replace(t, stiffness_N_m=1.5 * t.stiffness_N_m) for t in b.tendons)
            )
            for b in hand.branches
        ),
    )


def aside(hand: Hand) -> Hand:
    """The first finger's proximal axis 10 mm beside where it is."""
    branch = hand.branches[0]
    anchor = tuple(x + d for x, d in zip(branch.coordinates[1].anchor_m, (0.0, 0.0, 0.010), strict=True))
    coordinates = list(branch.coordinates)
    coordinates[1] = dataclasses.replace(coordinates[1], anchor_m=anchor)
    return dataclasses.replace(
        hand, branches=(dataclasses.replace(branch, coordinates=tuple(coordinates)), *hand.branches[1:])
    )


@pytest.mark.parametrize(
    "wrong", [lambda h: changed(h, spring_Nm_rad=4.0), stiffer_tendons, aside], ids=["spring", "tendons", "axis"]
)
def test_a_description_that_is_not_the_models_is_refused(wrong, trust: dict) -> None:
    """The engine simulates the right hand, the description is another: the judge has teeth."""
    right = understand(default_hand_file())
    as_told = accept(right, grasps=2)
    trust["hand_check_right_median"] = float(np.median(as_told.errors("preloaded")))
    done = Check(right, accept(dataclasses.replace(right, hand=wrong(right.hand)), grasps=2), 0.5)
    assert done.medians[0] > 4 * trust["hand_check_right_median"], done.figures()


def test_friction_that_is_kept_is_found_by_the_acceptance(tmp_path: Path) -> None:
    sheet = SHEET_WITH + '\n[stiffness]\nfriction = "keep"\n'
    edit = replaced(('stiffness="0.4" damping="0.025"', 'stiffness="0.4" damping="0.025" frictionloss="0.01"'))
    understood = understand(write(tmp_path, edit, sheet))
    assert any("small motions stick" in note for note in understood.notes)
    assert "does not tell this hand" in Check(understood, accept(understood, grasps=2), 0.5).problem


SHEET_WITH = (
    write.__globals__["SHEET"]
    .replace("{OPEN}", write.__globals__["OPEN"])
    .replace("{CLOSED}", write.__globals__["CLOSED"])
)
SHEETS = {
    'name = "x"\nmodel = "hand.xml"\nstiffness = 3\n': ("stiffness", "a table"),
    'name = "x"\nmodel = "hand.xml"\nlocked = "finger1_roll"\n': ("locked", "a list"),
    'name = 3\nmodel = "hand.xml"\n': ("name", "a text"),
    'model = "hand.xml"\n': ("name", "required"),
    'name = "x"\nmodel = "hands.xml"\n': ("hands.xml", "no file"),
    'name = "x"\nmodel = "package:no_such_package/hand.xml"\n': ("no_such_package", "no installed"),
    'name = "x"\nmodel = "hand.xml"\npalms = "palm"\n': ("palms", "did you mean palm"),
    'name = "x"\nmodel = "hand.xml"\npalm = "hand"\n': ("'hand'", "lacks", "palm"),
    'name = "x"\nmodel = "hand.xml"\nlocked = ["wrist"]\n': ("locked", "'wrist'"),
    'name = "x"\nmodel = "hand.xml"\n[closing]\nopen = {}\nclosed = { thumb_distal = 2.5 }\n': (
        "closing.closed", "thumb_distal", "1.7"),
    'name = "x"\nmodel = "hand.xml"\n[closing]\nopen = { thumb_distal = 1.5, finger1_distal = 1.5 }\nclosed = {}\n': (
        "closing", "mm apart", "exchanged?"),
    'name = "x"\nmodel = "hand.xml"\nlength_m = 100\n': ("length_m", "less than or equal to 2"),
    'name = "x"\nmodel = "hand.xml"\n[contact]\ntorsional_friction_m = 3\n': ("torsional_friction_m", "0.1"),
    'name = "x"\nmodel = "hand.xml"\n[contact]\ncompliance_m_N = 25\n': ("compliance_m_N", "0.01"),
    'name = "x"\nmodel = "hand.xml"\n[[branch]]\nname = "a"\ntip = "palm"\n': ("tip 'palm'",),
    'name = "x"\nmodel = "hand.xml"\n[[branch]]\nname = "a"\ntip = "thumb_distal"\n': (
        "1 branches are named", "finger1", "finger2"),
    'name = "x"\nmodel = "hand.xml"\n' + "".join(
        f'[[branch]]\nname = "{n}"\ntip = "{t}_distal"\n' for n, t in (("a", "thumb"), ("c", "thumb"))): (
        "a and c both name a tip",),
    'name = "x"\nmodel = "hand.xml"\n' + "".join(
        f'[[branch]]\nname = "f"\ntip = "{t}_distal"\n' for t in ("thumb", "finger1", "finger2")): (
        "two are called f",),
    'name = "x"\nmodel = "hand.xml"\n[stiffness]\npull_only = ["flexors_*"]\n': (
        "flexors_*", "finger1_proximal_flexor"),
    'name = "x"\nmodel = "hand.xml"\n[stiffness]\nfriction = "maybe"\n': ("friction", "keep"),
    'name = "x"\nmodel = "hand.xml"\n[[coupling]]\njoint = "a"\nof = "thumb_distal"\n': ("coupling.joint", "'a'"),
    'name = "x"\nmodel = "hand.xml"\nlocked = ["finger1_roll", "finger1_proximal", "finger1_distal", "finger2_roll", '
    '"finger2_proximal", "finger2_distal"]\n': ("one chain", "two branches"),
}  # fmt: skip


@pytest.mark.parametrize("sheet", SHEETS)
def test_a_wrong_hand_file_is_refused_by_field(sheet: str, tmp_path: Path) -> None:
    with pytest.raises(AminnError) as error:
        understand(write(tmp_path, sheet=sheet))
    for words in SHEETS[sheet]:
        assert words in str(error.value), error.value


def test_a_told_cable_that_can_push_is_refused(tmp_path: Path) -> None:
    sheet = SHEET_WITH + '\n[stiffness]\npull_only = ["*_flexor"]\n'
    with pytest.raises(AminnError, match="finger1_proximal_flexor can push"):
        understand(write(tmp_path, MODELS["tendons that push"], sheet))


def test_what_is_told_and_not_used_is_noted(tmp_path: Path) -> None:
    sheet = SHEET_WITH + "\n[stiffness]\nservo_Nm_rad = { finger1_roll = 5 }\n[contact]\ntorsional_friction_m = 0.01\n"
    notes = " ".join(understand(write(tmp_path, sheet=sheet)).notes)
    assert "servo_Nm_rad.finger1_roll is not used" in notes and "soft_finger" in notes


def test_what_the_file_tells_is_simulated(tmp_path: Path) -> None:
    """Servos of torque motors, a coupling in firmware, a locked joint: in the description and in the engine's model."""
    sheet = SHEET_WITH.replace("model =", 'locked = ["finger2_roll"]\nmodel =')
    sheet += "\n[stiffness]\nservo_Nm_rad = { finger1_distal = 1.5 }\n"
    sheet += '\n[[coupling]]\njoint = "thumb_distal"\nof = "thumb_proximal"\n'
    understood = understand(write(tmp_path, sheet=sheet))
    first, second, thumb = understood.hand.branches
    assert first.coordinates[2].servo_Nm_rad == 1.5 and len(second.coordinates) == 2 and len(thumb.couplings) == 1
    done = Check(understood, accept(understood, grasps=2), 0.5)
    assert done.medians[0] < PRELOADED_LIMIT, done.figures()


def test_command_prints_draws_and_reports(tmp_path: Path) -> None:
    picture, report = tmp_path / "hand.png", tmp_path / "check.json"
    command = ["hand", "check", str(default_hand_file()), "--grasps=2", f"--picture={picture}", f"--json={report}"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    for words in (
        "3 branches of 3 + 3 + 2 joints, 6 tendons",
        "finger1_roll",
        "servo 4",
        "accepted",
    ):
        assert words in result.output, result.output
    assert picture.read_bytes().startswith(b"\x89PNG") and '"accepted": true' in report.read_text()


@pytest.mark.parametrize("pinch", ["nan", "inf", "-1"])
def test_a_pinch_that_is_no_force_is_refused(pinch: str) -> None:
    result = CliRunner().invoke(main, ["hand", "check", str(default_hand_file()), "--pinch", pinch])
    assert result.exit_code in (1, 2) and "pinch" in result.output.lower(), result.output


def test_a_pinch_too_heavy_for_the_servos_is_said(tmp_path: Path) -> None:
    lines: list[str] = []
    done = check(default_hand_file().parent / "hands" / "leap_like.toml", pinch_N=4.0, grasps=2, echo=lines.append)
    assert "too soft for 4 N" in done.problem and any("acceptance:" in line for line in lines)
