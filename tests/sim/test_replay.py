"""Any load on the grasps of a data set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from small_data import SMALL

from aminn_sim import SimulationConfig, SimulationError
from aminn_sim.replay import ReplayedGrasp, replay

CONFIG = SimulationConfig(**SMALL)


def test_grasps_and_cases_of_a_data_set_come_again(dataset_dir: Path) -> None:
    """From any shard, in any order, on several threads: the numbers that the data set has."""
    with h5py.File(dataset_dir / "shard-00001.h5") as file:
        grasps = {k: v[()] for k, v in file["grasps"].items()}
        samples = {k: v[()] for k, v in file["samples"].items()}
    ids = [5, 4, 5]

    def again(grasp: ReplayedGrasp) -> list[dict]:
        return [grasp.load(w) for w in samples["w_e"][samples["grasp_id"] == grasp.grasp_id]]

    states = replay(CONFIG, ids, lambda grasp: grasp.state, threads=2)
    cases = replay(CONFIG, ids, again, threads=2)
    for number, state, found in zip(ids, states, cases, strict=True):
        row = int(np.flatnonzero(grasps["grasp_id"] == number)[0])
        for name in grasps:
            np.testing.assert_array_equal(state[name], grasps[name][row], err_msg=name)
        for k, sample in enumerate(np.flatnonzero(samples["grasp_id"] == number)):
            for name in ("w_e", "dx_ht", "q_after", "stable", "reason", "max_translation_m", "drift_m_s"):
                np.testing.assert_array_equal(found[k][name], samples[name][sample], err_msg=name)


def test_other_loads_have_other_outcomes() -> None:
    ((light, heavy),) = replay(CONFIG, [0], lambda g: (g.load([0, 0, 0.05, 0, 0, 0]), g.load([0, 0, 80, 0, 0, 0])))
    assert light["stable"] and not heavy["stable"]
    assert np.linalg.norm(light["dx_ht"][:3]) < 1e-3


def test_what_is_no_load_or_no_grasp_is_named() -> None:
    for load in ([0, 0, 1], [0, 0, np.nan, 0, 0, 0]):
        with pytest.raises(SimulationError, match="no wrench of 6 finite numbers"):
            replay(CONFIG, [0], lambda grasp, load=load: grasp.load(load))
    none = replace(CONFIG, grasp_attempts=1, grasp_drift_max_m_s=1e-12)
    with pytest.raises(SimulationError, match="grasp 3: none of 1 attempts held the tool"):
        replay(none, [3], lambda grasp: grasp.state)
