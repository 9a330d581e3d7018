"""Mirror images of grasps: what the hand's own symmetry says of a load case, said of its mirror image.

The palm's plane x = 0 carries finger 1 onto finger 2 and the thumb onto itself. Polar vectors (positions, forces)
change sign in x, axial ones (rotations, moments) in y and z; joint angles stay, since an axis that is mirrored and
reversed turns the mirrored finger the same way.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from aminn_base.errors import AminnError

from .dims import BRANCH_JOINTS, N_BRANCH, N_WRENCH
from .nominal import Nominal

POLAR = (-1.0, 1.0, 1.0)
AXIAL = (1.0, -1.0, -1.0)
MOTION = POLAR + AXIAL
CONTACT = (1.0, *POLAR, *POLAR, 1.0)
BRANCHES = (1, 0, 2)
JOINTS = tuple(joint for branch in BRANCHES for joint in BRANCH_JOINTS[branch] if joint >= 0)


def check_symmetric(nominal: Nominal) -> None:
    """Raise AminnError unless the hand is its own mirror image."""
    swap, polar, axial = list(BRANCHES), np.array(POLAR), np.array(AXIAL)
    images = {
        "base_m": (nominal.base, nominal.base[swap] * polar),
        "axis": (nominal.axis, nominal.axis[swap] * axial),
        "link_a_m": (nominal.link_a, nominal.link_a[swap] * polar),
        "joint_stiffness_Nm_rad": (nominal.chol, nominal.chol[swap]),
        "tendons": (nominal.tendon_dir, nominal.tendon_dir[swap]),
        "tendons (stiffness)": (nominal.tendon_gain, nominal.tendon_gain[swap]),
    }
    for name, (value, image) in images.items():
        if not np.allclose(value, image, atol=1e-9):
            raise AminnError(
                f"hand.{name}: finger 1 is not the mirror image of finger 2; train with --set mirror=false"
            )


def mirror_inputs(x: dict[str, Tensor]) -> dict[str, Tensor]:
    """Mirror images of inputs, shapes as in `dims.INPUT_SHAPES` after the batch."""
    swap, polar = list(BRANCHES), torch.tensor(POLAR)
    motion, contact = torch.tensor(MOTION), torch.tensor(CONTACT)
    return {
        "q": x["q"][:, list(JOINTS)],
        "x_ht": x["x_ht"] * motion,
        "w_e": x["w_e"] * motion,
        "contacts": (x["contacts"] * contact)[:, swap],
        "j_x": (x["j_x"] * polar[:, None] * motion)[:, swap],
        "j_q": (x["j_q"] * polar[:, None])[:, swap],
    }


def mirror_targets(y: Tensor) -> Tensor:
    """Mirror images of a stage's targets: stability (n) stays, motion and tendons (n, 6 + 3) do not."""
    if y.ndim == 1:
        return y
    dx, taut = y.split([N_WRENCH, N_BRANCH], -1)
    return torch.cat([dx * torch.tensor(MOTION), taut[:, list(BRANCHES)]], -1)
