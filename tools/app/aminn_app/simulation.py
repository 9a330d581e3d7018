"""The program's way into the simulator, apart from the other stages so that simulating needs no PyTorch."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from aminn_base.errors import AminnError

# Fields of the configuration that `--set` leaves to an option of their own.
OWN_OPTIONS = {
    "grasps": "--grasps",
    "cases": "--cases",
    "seed": "--seed",
    "shard_grasps": "--shard-grasps",
    "families": "--family",
}


def simulation_settings(changes: Sequence[str]) -> dict[str, float]:
    """Fields of the simulation's configuration from texts NAME=VALUE.

    Raises AminnError where one is no number, unknown, given twice, or has an option of its own.
    """
    from aminn_sim import SimulationConfig

    whole = {f.name: f.type == "int" for f in dataclasses.fields(SimulationConfig) if f.name not in OWN_OPTIONS}
    out: dict[str, float] = {}
    for change in changes:
        name, equals, text = (part.strip() for part in change.partition("="))
        if name in OWN_OPTIONS:
            raise AminnError(f"--set {change}: {name} has an option of its own; give {OWN_OPTIONS[name]}")
        if not equals or name not in whole:
            near = get_close_matches(name, whole, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(whole)}"
            raise AminnError(f"--set {change}: expected NAME=VALUE with a name of the configuration; {hint}")
        if name in out:
            raise AminnError(f"--set {change}: {name} is given twice")
        try:
            out[name] = int(text) if whole[name] else float(text)
        except ValueError as error:
            kind = "an integer" if whole[name] else "a number"
            raise AminnError(f"--set {change}: {text!r} is not {kind}") from error
    return out


def run_simulation(
    out: Path,
    grasps: int,
    cases: int,
    seed: int,
    threads: int | None = None,
    engine: str = "threads",
    hand: Path | None = None,
    json_file: Path | None = None,
    **settings: Any,
) -> dict:
    """Simulate a data set into folder `out`, or go on with an unfinished one; returns its manifest.

    `engine` is one of `aminn_sim.engines.ENGINES`, `hand` a hand file; `settings` are further fields of
    `aminn_sim.SimulationConfig`. `json_file` gets the time it took, if there was anything left to do.
    """
    from aminn_sim import SimulationConfig, simulate

    config = SimulationConfig(grasps=grasps, cases=cases, seed=seed, **settings)
    return simulate(config, out, threads=threads or 0, engine=engine, hand=hand, report=json_file)


def run_gallery(data: Path, count: int, hand: Path | None = None) -> Path:
    """Draw `count` grasps of the data set in folder `data`; returns the page that shows them."""
    from aminn_sim.gallery import gallery

    return gallery(data, count, hand)


def run_card(data: Path) -> Path:
    """Write the data card of the data set in folder `data`; returns the page."""
    from aminn_sim.card import data_card

    return data_card(data)
