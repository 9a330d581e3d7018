"""The labels' displacements against those of the current MuJoCo, from the same settled grasps under the same loads."""

from __future__ import annotations

import numpy as np

from . import _core
from .config import SimulationConfig
from .current_mujoco import CurrentGrasp, import_mujoco
from .errors import SimulationError
from .open_hand import OpenHand
from .theory import relative_error
from .vary import theta_of


def crosscheck(config: SimulationConfig, opened: OpenHand, seed: int, grasps: int = 40, cases: int = 4) -> dict:
    """Flat figures `current_mujoco_*` over the stable cases of fresh grasps, the tool families in turn.

    Relative differences are taken as errors against the formula are (rotations by an arm of 0.1 m). `rest_shift_m` is
    how far a tool moves, unloaded, when its settled grasp goes on in the other version.
    """
    simulator, options, families = opened.simulator(), config.options(), config.family_indices()
    differences: dict[int, list[float]] = {family: [] for family in families}
    shifts = []
    for index in range(grasps):
        family = families[index % len(families)]
        theta = theta_of(config, opened.hand, index)
        session = _core.Session(simulator, options, seed, 0, index, index, [family], theta)
        other = CurrentGrasp(opened, session.scene(), numbers=() if theta is None else simulator.numbers(theta))
        shifts.append(float(np.linalg.norm(other.load(np.zeros(6), config.ramp_s, config.hold_s)[:3])))
        for _ in range(cases):
            case = session.next_case()
            if case["stable"][0]:
                moved = other.load(case["w_e"][0], config.ramp_s, float(case["hold_time_s"][0]))
                differences[family].append(float(relative_error(moved, case["dx_ht"][0])))
    every = np.concatenate([np.array(found) for found in differences.values()])
    if len(every) == 0:
        raise SimulationError(f"cross-check: none of {grasps * cases} load cases is stable; choose smaller loads")
    figures: dict[str, float | str] = {
        "version": import_mujoco().__version__,
        "grasps": grasps,
        "cases": len(every),
        "relative_difference_median": float(np.median(every)),
        "relative_difference_p90": float(np.percentile(every, 90)),
        "relative_difference_max": float(every.max()),
        "rest_shift_m_median": float(np.median(shifts)),
        "rest_shift_m_max": float(np.max(shifts)),
    }
    for family, found in differences.items():
        if found:
            name = _core.TOOL_FAMILIES[family]
            figures[f"relative_difference_median_{name}"] = float(np.median(found))
    return {f"current_mujoco_{name}": value for name, value in figures.items()}
