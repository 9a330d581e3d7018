"""Hands described wrongly or unusually: edits of the built-in hand's MJCF and hand file, by name."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from aminn_sim.open_hand import default_hand_file

MODEL = "three_finger_hand.xml"
SHEET = 'name = "variant"\nmodel = "hand.xml"\n[closing]\nopen = {OPEN}\nclosed = {CLOSED}\n'
OPEN = (
    "{ finger1_proximal = 0.05, finger1_distal = 0.45, finger2_proximal = 0.05, finger2_distal = 0.45, "
    "thumb_proximal = 0.05, thumb_distal = 0.45 }"
)
CLOSED = OPEN.replace("0.05", "0.25").replace("0.45", "0.65")
Edit = Callable[[str], str]


def replaced(*pairs: tuple[str, str]) -> Edit:
    """An edit that replaces texts, each of which must be there."""

    def edit(text: str) -> str:
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new)
        return text

    return edit


FINGER_3 = """
      <body name="finger3_proximal" pos="0 0.060 0">
        <joint name="finger3_proximal" class="finger_proximal"/>
        <geom class="finger_link" fromto="0 0 0 0 0 0.055"/>
        <body name="finger3_distal" pos="0 0 0.055">
          <joint name="finger3_distal" class="finger_distal"/>
          <geom name="finger3_tip" class="tip"/>
        </body>
      </body>
      <body name="finger1_base" """
MIDDLE = """
          <body name="finger1_middle" pos="0 0 0.030">
            <joint name="finger1_middle" class="finger_distal"/>
            <geom class="finger_link" fromto="0 0 0.005 0 0 0.020"/>
            <body name="finger1_distal" pos="0 0 0.025">"""
END = '<site name="finger1_distal_flexor" class="anchor" pos="0 -0.006 0.025"/>\n          </body>'
WORLD = "  </worldbody>"
EQUALITY = '  </worldbody>\n  <equality><joint joint1="{}" joint2="{}" polycoef="0 1 0 0 0"/></equality>'
FIXED = (
    '<fixed name="finger1_distal_flexor">\n      <joint joint="finger1_proximal" coef="-0.010"/>\n'
    '      <joint joint="finger1_distal" coef="-0.007"/>\n    </fixed>'
)
SPATIAL = (
    '<spatial name="finger1_distal_flexor"><site site="route"/><site site="finger1_proximal_flexor"/>'
    '<site site="finger1_distal_flexor"/></spatial>'
)
ROUTE = '<geom name="palm" type="box"'
MODELS: dict[str, Edit] = {
    "joints that are damped a hundred times more": lambda text: re.sub(r'" damping="0', '" damping="1', text),
    "a fourth finger": replaced(('\n      <body name="finger1_base" ', FINGER_3)),
    "a middle joint": replaced(
        ('\n          <body name="finger1_distal" pos="0 0 0.055">', MIDDLE), (END, END + "</body>")
    ),
    "a thumb with a roll": replaced(
        (
            '<joint name="thumb_proximal" class',
            '<joint name="thumb_roll" class="finger_roll" axis="0 0 1"/>\n        <joint name="thumb_proximal" class',
        )
    ),
    "distal coupled to proximal": replaced((WORLD, EQUALITY.format("finger1_distal", "finger1_proximal"))),
    "box fingertips": replaced(
        (
            '<geom type="sphere" size="0.010" pos="0 0 0.045"',
            '<geom type="box" size="0.008 0.010 0.012" pos="0 0 0.045"',
        )
    ),
    "ellipsoid fingertips": replaced(
        (
            '<geom type="sphere" size="0.010" pos="0 0 0.045"',
            '<geom type="ellipsoid" size="0.008 0.010 0.013" pos="0 0 0.045"',
        )
    ),
    "no springs and no servos": lambda text: re.sub(r' stiffness="[0-9.]+"', "", text).replace('kp="4"', 'kp="0"'),
    "tendons that push": replaced(
        ('forcelimited="true"\n          forcerange="-250 0"', 'forcelimited="false"'),
        ('forcelimited="true"\n          forcerange="-500 0"', 'forcelimited="false"'),
    ),
    "a cable without a force": replaced(('forcerange="-250 0"', 'forcerange="-0 0"')),
    "tendons of the wrong sign": replaced(('coef="-0.010"', 'coef="0.010"'), ('coef="-0.007"', 'coef="0.007"')),
    "a roll axis 30 mm aside": replaced(
        (
            '<joint name="finger1_roll" class="finger_roll" axis="0 0 1"/>',
            '<joint name="finger1_roll" class="finger_roll" axis="0 0 1" pos="0.030 0 0"/>',
        )
    ),
    "friction of 1 mN.m": replaced(
        ('<joint axis="1 0 0" range="-0.8 1.5"', '<joint frictionloss="0.001" axis="1 0 0" range="-0.8 1.5"')
    ),
    "friction in a tendon": replaced(
        ('<fixed name="thumb_distal_flexor">', '<fixed name="thumb_distal_flexor" frictionloss="0.4">')
    ),
    "limits that are not enforced": replaced(
        ('<joint type="hinge" limited="true"', '<joint type="hinge" limited="false"')
    ),
    "a spatial tendon": replaced(
        (FIXED, SPATIAL), (ROUTE, '<site name="route" pos="0.022 0.052 -0.01"/>\n      ' + ROUTE)
    ),
    "millimetres": replaced(
        ('pos="0 0 0.055"', 'pos="0 0 55"'),
        ('pos="0 0 0.045"', 'pos="0 0 45"'),
        ('0 0 0 0 0 0.055"', '0 0 0 0 0 55"'),
        ('0 0 0 0 0 0.036"', '0 0 0 0 0 36"'),
        ('pos="0.022 0.060 0"', 'pos="22 60 0"'),
    ),
    "degrees": replaced(('<compiler angle="radian"', '<compiler angle="degree"')),
    "degrees in a model of radians": replaced(('joint range="-0.8 0.8"', 'joint range="-45 45"')),
    "a joint that two fingers share": replaced(
        (
            '      <body name="finger1_base" pos="0.022 0.060 0">',
            '      <body name="knuckles" pos="0 0 0">\n        '
            '<joint name="knuckles" class="finger_proximal"/>\n        <geom class="knuckle"/>\n      '
            '<body name="finger1_base" pos="0.022 0.060 0">',
        ),
        ('      <body name="thumb_proximal" pos', '      </body>\n      <body name="thumb_proximal" pos'),
    ),
    "a closed loop": replaced(
        (
            WORLD,
            WORLD
            + '\n  <equality><connect body1="finger1_distal" body2="finger2_distal" anchor="0 0 0.01"/></equality>',
        )
    ),
    "fingers coupled with each other": replaced((WORLD, EQUALITY.format("finger1_proximal", "finger2_proximal"))),
    "a joint that slides": replaced(
        (
            '<joint name="thumb_distal" class="thumb_distal"/>',
            '<joint name="thumb_distal" type="slide" axis="0 0 1" limited="true" range="0 0.02"/>',
        )
    ),
    "a fingertip that touches nothing": replaced(
        ('<geom name="thumb_tip" class="tip"/>', '<geom name="thumb_tip" class="tip" contype="0" conaffinity="0"/>'),
        ('<geom name="thumb_distal" class="thumb_link"', '<geom contype="0" name="thumb_distal" class="thumb_link"'),
    ),
    "servos that are motors": replaced(
        (
            '<general name="finger1_distal_flexor" class="finger_flexor" tendon="finger1_distal_flexor"/>',
            '<motor name="finger1_distal_flexor" tendon="finger1_distal_flexor"/>',
        ),
        ('range="-0.1 1.7" stiffness="0.2"', 'range="-0.1 1.7"'),
    ),
    "wrists above the palm": replaced(
        (
            '<body name="palm" childclass="hand">',
            '<body name="forearm"><joint name="wrist" type="hinge" axis="1 0 0" '
            'limited="true" range="-1 1"/><geom type="sphere" size="0.02" mass="0.1"/>'
            '<body name="palm" childclass="hand">',
        ),
        ("\n  </worldbody>", "</body>\n  </worldbody>"),
    ),
}


def write(folder: Path, edit: Edit = lambda text: text, sheet: str = "") -> Path:
    """A hand file and its model in `folder`; returns the hand file."""
    model = (default_hand_file().parent / MODEL).read_text()
    (folder / "hand.xml").write_text(edit(model))
    file = folder / "hand.toml"
    file.write_text(sheet or SHEET.replace("{OPEN}", OPEN).replace("{CLOSED}", CLOSED))
    return file
