"""Simulated pushes as a lab's tables: what came out of the simulator, through files, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aminn.data.dataset import Dataset
from aminn_sim import SimulationConfig, simulate
from aminn_table import write_table
from aminn_table.columns import LABELLED, Arrays

CONFIG = SimulationConfig(grasps=40, cases=5, seed=12, noise_share=0.0)
PAUSE_S = 20.0


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
