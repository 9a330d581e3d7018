"""Simulated pushes as a lab's tables: what came out of the simulator, through files, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from synthetic import draw_inputs, draw_wrench, true_stiffness

from aminn.data.dataset import Dataset
from aminn_hand import Hand
from aminn_sim import SimulationConfig, simulate
from aminn_table import write_table
from aminn_table.columns import LABELLED, Arrays

CONFIG = SimulationConfig(grasps=40, cases=5, seed=12, noise_share=0.0)
PAUSE_S = 20.0
GRASPS, PUSHES = 6, 4


def made_up(hand: Hand) -> Arrays:
    """Four pushes of each of six grasps, ten seconds apart; contacts on the round tips."""
    rng, rows = np.random.default_rng(5), []
    for grasp in range(GRASPS):
        x = draw_inputs(rng, hand)
        radius = np.array([b.tip_radius_m for b in hand.branches])
        x["contacts"][:, 1:4] = hand.tips(x["q"]) + radius[:, None] * x["contacts"][:, 4:7]
        stiffness = true_stiffness(hand, x)
        for push in range(PUSHES):
            w = 0.05 * draw_wrench(rng)
            state = {name: x[name] for name in ("q", "x_ht", "contacts")}
            time = 1e3 + 70.0 * grasp + 10.0 * push
            rows.append(state | {"w_e": w, "dx_ht": np.linalg.solve(stiffness, w), "grasp_id": grasp, "time_s": time})
    arrays = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return arrays | {"stable": np.ones(len(rows), np.uint8)}


def simulate_pushes(folder: Path) -> Path:
    """A small simulated data set in `folder`."""
    simulate(CONFIG, folder, threads=2, progress=False)
    return folder


def as_measured(data: Dataset) -> Arrays:
    """What a lab with all sensors would have measured of the load cases."""
    time = 1.7e9 + PAUSE_S * np.arange(len(data))
    return {name: data.samples[name] for name in (*LABELLED, "stable")} | {"time_s": time}


def write_tables(folder: Path, data: Dataset) -> dict[str, Path]:
    """The same pushes in every format; end of the name -> file."""
    files = {end: folder / f"pushes{end}" for end in (".csv", ".parquet", ".h5")}
    for file in files.values():
        write_table(file, data.hand, as_measured(data))
    return files
