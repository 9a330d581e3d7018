"""`make sim`: is the simulation physics, and how fast? Flat figures in build/reports/sim.json, printed as they come."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np

from aminn_base.files import check_outputs, write_json
from aminn_base.program import Messages

from . import _core
from .config import SimulationConfig
from .crosscheck import crosscheck
from .errors import SimulationError
from .open_hand import OpenHand, open_hand
from .quality import dataset_figures, waiting_figures
from .read import SimulatedData, read_data
from .theory import Grasp, compliance_figures, dataset_errors, over_grasps, preload_figures, slack_figures

COVERAGE_CELLS = 8  # along each synergy axis


def synergy_figures(simulator: _core.Simulator, data: SimulatedData) -> dict[str, float]:
    """Round trip psi -> q -> psi and q -> psi -> q inside the subspace, and how much of the range the grasps fill."""
    assert data.hand.synergy is not None
    rng = np.random.default_rng(0)
    low, high = np.array(data.hand.synergy.ranges).T
    psi = rng.uniform(low, high, (2000, len(low)))
    q = np.stack([simulator.posture_of(x) for x in psi])
    back = np.stack([simulator.psi_of(x) for x in q])
    again = np.stack([simulator.posture_of(x) for x in back])
    cell = np.clip((data.grasps["psi"] - low) / (high - low) * COVERAGE_CELLS, 0, COVERAGE_CELLS - 1).astype(int)
    return {
        "synergy_round_trip_psi_max": float(np.abs(back - psi).max()),
        "synergy_round_trip_q_rad_max": float(np.abs(again - q).max()),
        "synergy_cells": float(COVERAGE_CELLS ** len(low)),
        "synergy_cells_filled_share": len(np.unique(cell, axis=0)) / COVERAGE_CELLS ** len(low),
    }


def speed_figures(
    opened: OpenHand,
    simulator: _core.Simulator,
    config: SimulationConfig,
    grasps: int = 16,
    cases: int = 8,
    rounds: int = 5,
) -> dict[str, float]:
    """The label protocol against the engine alone on the same steps; two threads against one, taken in turn."""

    def timed(grasp: Grasp) -> dict[str, float]:
        return grasp.session.speed(cases)

    parts = over_grasps(opened.hand, simulator, config, grasps, 1, timed)
    steps, protocol, bare = (sum(p[k] for p in parts) for k in ("steps", "protocol_s", "bare_s"))
    rates: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(rounds):
        for threads, seen in rates.items():
            start = time.perf_counter()
            simulator.shard(config.options(), config.seed, 0, 0, 2 * grasps, cases, threads, config.family_indices())
            seen.append(2 * grasps * cases / (time.perf_counter() - start))
    return {
        "speed_steps": float(steps),
        "speed_steps_a_second": steps / protocol,
        "speed_of_bare_engine_share": bare / protocol,
        "speed_cases_a_second_1_thread": float(np.median(rates[1])),
        "speed_cases_a_second_2_threads": float(np.median(rates[2])),
        "speed_2_threads_over_1": float(np.median(np.array(rates[2]) / np.array(rates[1]))),
        "speed_cores": float(len(os.sched_getaffinity(0))),
    }


@click.command(cls=Messages)
@click.option("--data", type=click.Path(path_type=Path), required=True, help="Folder of a finished data set.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Report to write (JSON).")
@click.option("--grasps", type=click.IntRange(4), default=240, show_default=True, help="Fresh grasps for the theory.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the fresh grasps.")
@click.option("--hand", type=click.Path(path_type=Path), help="Hand file of the data set; default: the built-in hand.")
def main(data: Path, out: Path, grasps: int, seed: int, hand: Path | None) -> None:
    """Hold theory against simulation, judge a data set's labels, and time the simulation."""
    check_outputs([out], [data])
    opened, threads = open_hand(hand), len(os.sched_getaffinity(0))
    simulator, config, simulated = opened.simulator(), SimulationConfig(seed=seed), read_data(data)
    if simulated.hand != opened.hand:
        raise SimulationError(f"{data}: of another hand than {opened.path}; tell its hand file (--hand)")
    shape = opened.hand
    parts: dict[str, Callable[[], dict]] = {
        "speed": lambda: speed_figures(opened, simulator, config),
        "data set": lambda: dataset_figures(simulated),
        "synergy space": lambda: synergy_figures(simulator, simulated),
        "theory, small loads": lambda: compliance_figures(shape, simulator, config, grasps, threads),
        "theory, by pinch force": lambda: preload_figures(shape, simulator, config, grasps // 6, threads),
        "theory, all loads": lambda: dataset_errors(simulated.hand, simulated.samples, simulated.grasps),
        "slackening tendons": lambda: (
            slack_figures(shape, simulator, config, grasps // 2, threads) if shape.dims.gates else {}
        ),
        "current MuJoCo": lambda: crosscheck(config, opened, seed),
        "waiting longer": lambda: waiting_figures(simulator, config, threads, grasps // 2, 10),
    }
    figures: dict[str, float | str] = {}
    for name, measure in parts.items():
        click.echo(f"{name}:")
        found = measure()
        for key, value in found.items():
            click.echo(f"  {key:52s} {value if isinstance(value, str) else format(value, '.4g')}")
        figures |= found
    write_json(out, figures)


if __name__ == "__main__":
    main()
