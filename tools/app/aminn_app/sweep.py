"""`aminn sweep`: train every combination of a grid of settings, and compare."""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from aminn.model.config import TrainConfig, build_config, put_setting
from aminn.training.train import train
from aminn_base.errors import AminnError
from aminn_base.read import read_toml

from .processes import data_of, side_by_side, workers_for

GRID = "grid"
"""Table of the file whose settings are lists; the rest is what all runs share."""
RUNS_MAX = 10_000


def read_grid(file: Path) -> dict[str, TrainConfig]:
    """The configuration of each run by its folder's name, all combinations of the lists in table `grid`.

    Raises AminnError with the key where one is no setting, no list, or where two runs would be the same.
    """
    shared = read_toml(file)
    table = shared.pop(GRID, None)
    if not isinstance(table, dict) or not table:
        raise AminnError(f"{file}: expected a table [{GRID}] of lists, as in seed = [0, 1, 2]")
    lists = dict(_lists(file, table))
    if len(combinations := list(itertools.product(*lists.values()))) > RUNS_MAX:
        raise AminnError(f"{file}: {len(combinations)} runs, at most {RUNS_MAX} are possible")
    configs: dict[str, TrainConfig] = {}
    for values in combinations:
        settings = copy.deepcopy(shared)
        for key, value in zip(lists, values, strict=True):
            put_setting(settings, key, value)
        name = "_".join(f"{key}-{_as_name(value)}" for key, value in zip(lists, values, strict=True))
        if name in configs:
            raise AminnError(f"{file}: two runs would both be called {name}; give each value once")
        configs[name] = build_config(TrainConfig, settings, str(file))
    return configs


def _lists(file: Path, table: dict, prefix: str = "") -> Iterator[tuple[str, list]]:
    """The lists of a table by dotted key; tables within it may be written either way."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _lists(file, value, f"{prefix}{name}.")
        elif isinstance(value, list) and value:
            yield prefix + name, value
        else:
            raise AminnError(f"{file}: {GRID}.{prefix}{name} is {value!r}, expected a list of values")


def _as_name(value: Any) -> str:
    """A value as a part of a folder's name."""
    return re.sub(r"[^\w.+-]+", "-", str(value)).strip("-")


def run_sweep(
    configs: dict[str, TrainConfig], data: Path, out: Path, jobs: int | None = None, tensorboard: bool = True
) -> tuple[list[Path], dict[str, str]]:
    """Train what is not yet trained, each run in a folder of `out`; finished runs, and what became of the others."""
    data_of(data)  # what is wrong with it is said once
    workers = workers_for(len(configs), jobs)
    calls = {
        name: (config, data, out / name, k % workers, tensorboard) for k, (name, config) in enumerate(configs.items())
    }
    with closing(side_by_side(_train, calls, workers)) as ended:
        failed = {name: error for name, error in ended if error}
    return [out / name for name in configs if name not in failed], failed


def _train(config: TrainConfig, data: Path, out: Path, position: int, tensorboard: bool) -> str:
    """Train one run; what went wrong, if anything: the others continue."""
    try:
        train(config, data_of(data), out, bar_position=position, tensorboard=tensorboard)
    except AminnError as error:
        return str(error)
    return ""
