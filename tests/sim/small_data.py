"""The configuration of the tests' data set: two shards, the second one shorter."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from aminn_sim.simulate import MANIFEST, UNFINISHED

SMALL = {"grasps": 6, "cases": 3, "seed": 7, "shard_grasps": 4, "noise_share": 0.3}

_OWN_OPTIONS = ("grasps", "cases", "seed", "shard_grasps")


def begin(whole: Path, folder: Path, shards: int = 1) -> Path:
    """A folder like that of a simulation of `whole` that was ended after so many shards."""
    folder.mkdir(parents=True)
    manifest = json.loads((whole / MANIFEST).read_text())
    entries = manifest["shards"][:shards]
    for entry in entries:
        shutil.copy(whole / entry["file"], folder)
    (folder / UNFINISHED).write_text(json.dumps({"shards": entries, "simulator_build": manifest["simulator_build"]}))
    return folder


def command_line(settings: dict[str, float]) -> list[str]:
    """Options of `aminn simulate` for a configuration."""
    own = [f"--{name.replace('_', '-')}={value}" for name, value in settings.items() if name in _OWN_OPTIONS]
    return own + [f"--set={name}={value}" for name, value in settings.items() if name not in _OWN_OPTIONS]
