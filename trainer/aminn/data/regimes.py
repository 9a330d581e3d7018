"""Parts of a data set by what differs in them: what the studies train on, and what their models have never seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError

from .dataset import Dataset

NEW_FAMILY = "ellipsoid"
FRICTION_MAX, FORCE_MAX_N, MOMENT_MAX_NM = 0.95, 8.0, 0.2
SELECTION = (
    f"family not {NEW_FAMILY}, friction <= {FRICTION_MAX}, force <= {FORCE_MAX_N} N, moment <= {MOMENT_MAX_NM} N.m"
)
REGIMES = ("iid", "new_family", "new_friction", "larger_loads")


def regimes(data: Dataset) -> dict[str, NDArray[np.bool_]]:
    """Masks over the samples: what is trained on, and what differs from it in one respect."""
    rows, w = data.grasp_rows(), data.samples["w_e"]
    kind, families = data.simulated("grasps", "tool_family"), data.manifest["tool_families"]
    if NEW_FAMILY not in families:
        raise AminnError(
            f"the data set has no {NEW_FAMILY} among its tools ({', '.join(families)}): make dataset again"
        )
    family = kind[rows] != families.index(NEW_FAMILY)
    friction = data.simulated("grasps", "friction")[rows] <= FRICTION_MAX
    load = (np.linalg.norm(w[:, :3], axis=1) <= FORCE_MAX_N) & (np.linalg.norm(w[:, 3:], axis=1) <= MOMENT_MAX_NM)
    masks = (family & friction & load, ~family & friction & load, family & ~friction & load, family & friction & ~load)
    return dict(zip(REGIMES, masks, strict=True))


def known(data: Dataset) -> Dataset:
    """The part that is trained, validated and (on test grasps) tested on."""
    return data.where(regimes(data)["iid"], SELECTION)
