"""A hand of three branches of at most three coordinates as flat lists by branch, for readers that know no `Hand`."""

from __future__ import annotations

from typing import Any

import numpy as np

from .hand import Hand


def flat(hand: Hand) -> dict[str, Any]:
    """Geometry, stiffness and tendons by branch; a coordinate that a branch lacks is 0."""
    width = hand.dims.coordinates

    def padded(b: int, name: str) -> list[float]:
        values = [float(getattr(c, name)) for c in hand.branches[b].coordinates]
        return [0.0] * (width - len(values)) + values

    numbers = range(len(hand.branches))
    anchors = [np.array([c.anchor_m for c in b.coordinates]) for b in hand.branches]
    tips = [np.array(b.tip_point_m) for b in hand.branches]
    axes = [[[0.0] * 3] * (width - len(b.coordinates)) + [list(c.axis) for c in b.coordinates] for b in hand.branches]
    tendons = [
        {
            "branch": b,
            "moment_arm_m": [0.0] * (width - len(t.arm_m)) + list(t.arm_m),
            "stiffness_N_m": t.stiffness_N_m,
            "max_tension_N": t.max_tension_N,
            "name": t.name,
        }
        for b in numbers
        for t in hand.branches[b].tendons
    ]
    return {
        "name": hand.name,
        "branches": [b.name for b in hand.branches],
        "joints": list(hand.joints),
        "branch_joints": [list(row) for row in hand.coordinate_joints],
        "base_m": [a[-2 if len(a) > 1 else -1].tolist() for a in anchors],
        "axis": axes,
        "link_a_m": [(a[-1] - a[-2 if len(a) > 1 else -1]).tolist() for a in anchors],
        "link_b_m": [(tip - a[-1]).tolist() for a, tip in zip(anchors, tips, strict=True)],
        "tip_radius_m": [b.tip_radius_m for b in hand.branches],
        "joint_stiffness_Nm_rad": [padded(b, "stiffness_Nm_rad") for b in numbers],
        "joint_spring_Nm_rad": [padded(b, "spring_Nm_rad") for b in numbers],
        "joint_spring_reference_rad": [padded(b, "reference_rad") for b in numbers],
        "joint_low_rad": [padded(b, "low_rad") for b in numbers],
        "joint_high_rad": [padded(b, "high_rad") for b in numbers],
        "tendons": tendons,
    }
