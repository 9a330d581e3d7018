"""What stands in for sensors that a lab does not have, and notes that say so; docs/own-data.md has what it costs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aminn_hand import Hand

from .columns import FORCE, NORMAL, ON, POINT, Arrays

Array = NDArray[np.float64]

PINCH_N = 5.0
"""Nominal: what the contacts of each side of a pinch push with, all together."""
NEAR_CENTRE = 0.3
"""A contact point nearer to the fingertip's centre, in radii of the tip, says nothing of the normal."""

NO_POINTS = "no contact points: the fingertips' centres by the joint angles, moved by their radius along the normals"
NO_NORMALS = "no contact normals: the directions from the fingertips' centres to the contact points"
NO_SHAPE = "no contact normals: the direction of the pinch, between the middles of both sides' fingertips"
NO_FORCES = "no contact forces: the nominal pinch of {:g} N a side, shared by its contacts"
TRAINED_FORCES = "no contact forces: the means of the model's training"


def complete(hand: Hand, arrays: Arrays, force_N: Sequence[float] | None = None) -> tuple[Arrays, tuple[str, ...]]:
    """Arrays without NaN among the contacts (n, B, 8), and a note for each kind of sensor that something stands in for.

    `force_N` (B) are the normal forces to take where none was measured; default: a nominal pinch.
    """
    contacts = np.array(arrays["contacts"], np.float64)
    on = contacts[..., ON] > 0
    no_points, no_normals, no_forces = (
        np.isnan(contacts[..., part]).any(-1) & on for part in (POINT, NORMAL, slice(FORCE, None))
    )
    notes: list[str] = []
    centres = hand.tips(np.asarray(arrays["q"]))
    radius = np.array([b.tip_radius_m for b in hand.branches])
    if no_normals.any():
        pinch = _pinch(hand, centres)
        outward = contacts[..., POINT] - centres
        length = np.linalg.norm(outward, axis=-1)
        round_tip = (radius > 0) & (length > NEAR_CENTRE * radius)  # false where the point is not known either
        if (no_normals & round_tip).any():
            notes.append(NO_NORMALS)
        if (no_normals & ~round_tip).any():
            notes.append(NO_SHAPE)
        found = np.where(round_tip[..., None], outward / np.where(length > 0, length, 1.0)[..., None], pinch)
        contacts[..., NORMAL] = np.where(no_normals[..., None], found, contacts[..., NORMAL])
    if no_points.any():
        notes.append(NO_POINTS)
        surface = centres + radius[:, None] * contacts[..., NORMAL]
        contacts[..., POINT] = np.where(no_points[..., None], surface, contacts[..., POINT])
    if no_forces.any():
        notes.append(NO_FORCES.format(PINCH_N) if force_N is None else TRAINED_FORCES)
        force = _shares(hand, on) if force_N is None else np.broadcast_to(np.asarray(force_N, float), on.shape)
        contacts[..., FORCE] = np.where(no_forces, force, contacts[..., FORCE])
    contacts[~on] = 0.0
    return arrays | {"contacts": contacts}, tuple(notes)


def _pinch(hand: Hand, centres: Array) -> Array:
    """Unit directions (n, B, 3) in which the fingertips push: parallel to the line between the sides' middles."""
    first, second = (list(side) for side in hand.sides)
    out = np.empty_like(centres)
    for b in range(hand.dims.branches):
        if second:
            across = centres[:, second].mean(1) - centres[:, first].mean(1)
            out[:, b] = across if b in first else -across
        else:
            out[:, b] = np.delete(centres, b, 1).mean(1) - centres[:, b]
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def _shares(hand: Hand, on: NDArray[np.bool_]) -> Array:
    """Normal force (n, B), N, of each contact if every side pushes with the nominal pinch."""
    out = np.zeros(on.shape)
    for side in filter(None, hand.sides):
        own = on[:, list(side)]
        out[:, list(side)] = own * PINCH_N / np.maximum(own.sum(1, keepdims=True), 1)
    return out
