"""The program's way into the simulator, apart from the other stages so that simulating needs no PyTorch."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from aminn_base.errors import AminnError
from aminn_base.read import read_json
from aminn_base.seal import check_seal

# Fields of the configuration that `--set` leaves to an option of their own.
OWN_OPTIONS = {
    "grasps": "--grasps",
    "cases": "--cases",
    "seed": "--seed",
    "shard_grasps": "--shard-grasps",
    "families": "--family",
    "vary_mechanics": "--vary",
    "mechanics": "--mechanics",
}
VARIED = {"mechanics": "vary_mechanics"}
"""Fields of the configuration by what `--vary` calls them."""


def simulation_settings(changes: Sequence[str]) -> dict[str, float]:
    """Fields of the simulation's configuration from texts NAME=VALUE.

    Raises AminnError where one is no number, unknown, given twice, or has an option of its own.
    """
    from aminn_sim import SimulationConfig

    for change in changes:
        name = change.partition("=")[0].strip()
        if name in OWN_OPTIONS:
            raise AminnError(f"--set {change}: {name} has an option of its own; give {OWN_OPTIONS[name]}")
    whole = {f.name: f.type == "int" for f in dataclasses.fields(SimulationConfig) if f.name not in OWN_OPTIONS}
    return _named_numbers("--set", changes, whole, "of the configuration")


def variation_settings(variations: Sequence[str]) -> dict[str, float]:
    """Fields of the simulation's configuration from texts NAME=HALF_RANGE of what differs from hand to hand.

    Raises AminnError as `simulation_settings` does.
    """
    found = _named_numbers("--vary", variations, dict.fromkeys(VARIED, False), "of what can be varied")
    return {VARIED[name]: value for name, value in found.items()}


def _named_numbers(option: str, texts: Sequence[str], whole: Mapping[str, bool], what: str) -> dict[str, float]:
    """Numbers by name from texts NAME=VALUE; whole: the names that there are, and whether each is an integer."""
    out: dict[str, float] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or name not in whole:
            near = get_close_matches(name, whole, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(whole)}"
            raise AminnError(f"{option} {text}: expected NAME=VALUE with a name {what}; {hint}")
        if name in out:
            raise AminnError(f"{option} {text}: {name} is given twice")
        try:
            out[name] = int(value) if whole[name] else float(value)
        except ValueError as error:
            kind = "an integer" if whole[name] else "a number"
            raise AminnError(f"{option} {text}: {value!r} is not {kind}") from error
    return out


def read_mechanics(file: Path, hand: Path | None) -> dict[str, float]:
    """Mechanics parameters by name from a JSON file with a table `theta`, as `aminn calibrate` writes it.

    Raises AminnError where the file says that it is of another hand than the one of the hand file; None: built in.
    """
    content = read_json(file, "a hand's mechanics parameters")
    check_seal(file, content, "run `aminn calibrate` again")
    theta = content.get("theta")
    if not isinstance(theta, dict):
        raise AminnError(f'{file}: expected {{"theta": {{NAME: VALUE}}}}, as aminn calibrate writes it')
    for name, value in theta.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
            raise AminnError(f"{file}: theta.{name} is {value!r}, expected a finite number")
    if "hand_sha256" in content:
        from aminn_sim.open_hand import open_hand

        simulated = open_hand(hand).hand
        if content["hand_sha256"] != simulated.sha256:
            raise AminnError(
                f"{file}: of hand {content.get('hand', 'unknown')}, and {simulated.name} is to be simulated (the "
                "descriptions differ); give its hand file with --hand, or calibrate this hand"
            )
    return theta


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
    """Simulate a data set into folder `out`, or continue an unfinished one; returns its manifest.

    `engine` is one of `aminn_sim.engines.ENGINES`, `hand` a hand file; `settings` are further fields of
    `aminn_sim.SimulationConfig`. `json_file` gets the time it took, if there was anything left to do.
    """
    from aminn_sim import SimulationConfig, simulate

    config = SimulationConfig(grasps=grasps, cases=cases, seed=seed, **settings)
    return simulate(config, out, threads=threads or 0, engine=engine, hand=hand, report=json_file)
