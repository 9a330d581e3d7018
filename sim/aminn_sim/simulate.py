"""Simulate a data set: shards of grasps, each grasp under many loads, written as HDF5 with a JSON manifest.

A shard's bytes follow from the seed, its number and the configuration. It is written under a temporary name and renamed
when complete, so that an interrupted simulation goes on where it stopped.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import platform
import sys
from contextlib import closing
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from tqdm import tqdm

from . import _core
from .config import TOOL_FAMILIES, SimulationConfig
from .engines import ShardTask, find_engine
from .errors import SimulationError
from .schema import GRASP_FIELDS, SAMPLE_FIELDS, SCHEMA_VERSION, Field, field_table

# To be raised with every change of the C++ part that changes what is simulated.
PROTOCOL_VERSION = 1
# Fields of the configuration that do not change what a shard holds.
_NOT_IN_HASH = ("grasps",)

Arrays = dict[str, np.ndarray]


def model_folder() -> Path:
    """Folder of the MJCF files: inside the installed package, or in the source tree of an editable installation."""
    here = Path(__file__)
    candidates = [here.parent / "models", here.parents[1] / "models", Path(_core.__file__).parent / "models"]
    for folder in candidates:
        if (folder / "scene.xml").is_file():
            return folder
    raise SimulationError(f"scene.xml is in none of {', '.join(map(str, candidates))}; install the package again")


def load_simulator() -> _core.Simulator:
    """The compiled hand and tool. Raises SimulationError with the parser's message if the model files are damaged."""
    try:
        return _core.Simulator(str(model_folder() / "scene.xml"))
    except _core.MujocoError as error:
        raise SimulationError(f"the hand's model cannot be used: {error}") from error


def _open_simulator(config: SimulationConfig, digest: str) -> _core.Simulator:
    """The simulator of this machine, if it makes the data set of `digest`."""
    if config_sha256(config) != digest:
        raise SimulationError(
            f"{platform.node()} has another version of the simulation or of its models; install the same there"
        )
    return load_simulator()


def config_sha256(config: SimulationConfig) -> str:
    """Hash of everything that decides a shard's content but its number: configuration, model files, protocol."""
    content = {
        "schema_version": SCHEMA_VERSION,
        "protocol_version": PROTOCOL_VERSION,
        "simulator": simulator_name(),
        "config": {k: v for k, v in dataclasses.asdict(config).items() if k not in _NOT_IN_HASH},
        "models": {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(model_folder().glob("*.xml"))},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def simulator_name() -> str:
    """Name and version of the engine."""
    return f"MuJoCo {_core.MUJOCO_VERSION}"


def shard_name(number: int) -> str:
    """File name of a shard."""
    return f"shard-{number:05d}.h5"


def shard_sizes(config: SimulationConfig) -> list[int]:
    """Grasps of each shard."""
    full, rest = divmod(config.grasps, config.shard_grasps)
    return [config.shard_grasps] * full + ([rest] if rest else [])


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def simulate(
    config: SimulationConfig,
    out_dir: Path | str,
    threads: int = 0,
    progress: bool = True,
    engine: str = "threads",
) -> dict:
    """Simulate the data set of `config` into `out_dir` and return its manifest.

    threads: 0 takes every core that this process may use. engine: one of `engines.ENGINES`; the bytes are the same.
    Complete shards of the same configuration are kept; a folder with another configuration is an error. Interrupting
    (Ctrl-C) leaves the complete shards and no half-written file.
    """
    out = Path(out_dir)
    if threads < 0:
        raise SimulationError(f"threads is {threads}, expected 0 (all cores) or more")
    threads = threads or len(os.sched_getaffinity(0))
    run = find_engine(engine)
    digest = config_sha256(config)
    sizes = shard_sizes(config)
    _make_folder(out)
    todo = [n for n, size in enumerate(sizes) if not _is_complete(out / shard_name(n), digest, size, config)]
    _refuse_damaged_shards(out)
    if todo:
        (out / "manifest.json").unlink(missing_ok=True)  # it would describe shards that are about to change
    tasks = [ShardTask(config, n, sizes[n], partial(_open_simulator, config, digest)) for n in todo]
    total = config.grasps * config.cases
    done = total - sum(sizes[n] for n in todo) * config.cases
    interval = 0.2 if sys.stderr.isatty() else 10.0  # seconds between two states of the bar; few lines in a log
    with tqdm(
        total=total,
        initial=done,
        unit="case",
        desc="simulate",
        disable=not progress,
        smoothing=0.1,
        mininterval=interval,
    ) as bar:
        with closing(run(tasks, threads, lambda n: bar.update(done + n - bar.n))) as shards:
            for task, result in shards:
                attributes: dict[str, int | str] = {
                    "schema_version": SCHEMA_VERSION,
                    "config_sha256": digest,
                    "shard": task.number,
                    "n_grasps": task.grasps,
                }
                write_shard(out / shard_name(task.number), result["samples"], result["grasps"], attributes)
    manifest = build_manifest(config, digest, load_simulator().hand(), out)
    _write_atomically(out / "manifest.json", (json.dumps(manifest, sort_keys=True, indent=1) + "\n").encode())
    return manifest


def _make_folder(out: Path) -> None:
    """Make `out` and see that it can be written to, before time goes into simulating."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for leftover in out.glob("*.partial"):
            leftover.unlink()
        probe = out / "probe.partial"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise SimulationError(
            f"{out}: cannot be made a data set folder ({error.strerror}); choose one that you may write to"
        ) from error


def _refuse_damaged_shards(out: Path) -> None:
    """Hold the shards against the manifest of the finished data set in `out`, if there is one."""
    manifest = out / "manifest.json"
    if not manifest.exists():
        return
    try:
        entries = json.loads(manifest.read_text())["shards"]
        recorded = {str(entry["file"]): str(entry["sha256"]) for entry in entries}
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise SimulationError(f"{manifest}: not a manifest ({error}); delete it and simulate again") from error
    for name, sha256 in recorded.items():
        if (out / name).exists() and file_sha256(out / name) != sha256:
            raise SimulationError(
                f"{out / name}: damaged, its SHA-256 is not the manifest's; delete it and simulate again"
            )


def _is_complete(path: Path, digest: str, grasps: int, config: SimulationConfig) -> bool:
    """Whether the shard is there and of this configuration. Raises SimulationError where it is of another one."""
    if not path.exists():
        return False
    try:
        with h5py.File(path, "r") as file:
            found, count = str(file.attrs["config_sha256"]), int(file.attrs["n_grasps"])
    except (OSError, KeyError) as error:
        raise SimulationError(f"{path}: not a readable shard ({error}); delete it and simulate again") from error
    if found != digest:
        raise SimulationError(
            f"{path}: is of another configuration ({found[:12]}, this one is {digest[:12]}); "
            "choose another folder or delete this one"
        )
    if count > grasps:
        raise SimulationError(
            f"{path}: holds {count} grasps, but {config.grasps} grasps in all leave {grasps} for it; "
            "choose another folder or ask for at least as many grasps as before"
        )
    return count == grasps


def _checked(group: str, fields: dict[str, Field], arrays: Arrays) -> Arrays:
    """The arrays in schema order and type. Raises SimulationError where one is not as the schema says."""
    out = {}
    for name, field in fields.items():
        array = np.ascontiguousarray(arrays[name], dtype=field.dtype)
        if array.shape[1:] != field.shape:
            raise SimulationError(f"/{group}/{name}: rows of shape {array.shape[1:]}, expected {field.shape}")
        if not np.isfinite(array).all():
            raise SimulationError(f"/{group}/{name}: holds NaN or infinity")
        out[name] = array
    return out


def write_shard(path: Path, samples: Arrays, grasps: Arrays, attributes: dict[str, int | str]) -> None:
    """Write one shard, complete or not at all. Equal content gives equal bytes."""
    image = io.BytesIO()  # HDF5 itself does not survive a disk that is full
    with h5py.File(image, "w", libver=("earliest", "v110")) as file:
        for name, value in attributes.items():
            file.attrs[name] = value
        for group, fields, arrays in (("samples", SAMPLE_FIELDS, samples), ("grasps", GRASP_FIELDS, grasps)):
            for name, array in _checked(group, fields, arrays).items():
                file.create_dataset(f"{group}/{name}", data=array, track_times=False)
    _write_atomically(path, image.getvalue())


def _write_atomically(path: Path, content: bytes) -> None:
    """The file is there whole or not at all, whatever ends the program or the machine."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise SimulationError(
            f"{path}: cannot be written ({error.strerror}); make room or choose another folder, then repeat the "
            "command: it goes on where it stopped"
        ) from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def build_manifest(config: SimulationConfig, digest: str, hand: dict, out: Path) -> dict:
    """The manifest of the shards in `out`: no time, no path, keys sorted when written."""
    shards = [
        {
            "file": shard_name(n),
            "n_grasps": size,
            "n_samples": size * config.cases,
            "sha256": file_sha256(out / shard_name(n)),
        }
        for n, size in enumerate(shard_sizes(config))
    ]
    bounds = ("translation_max_m", "rotation_max_rad", "drift_max_m_s", "lost_contact_s", "tool_left_m", "stop_factor")
    return {
        "schema_version": SCHEMA_VERSION,
        "protocol_version": PROTOCOL_VERSION,
        "simulator": simulator_name(),
        "seed": config.seed,
        "config": dataclasses.asdict(config) | {"families": list(config.families)},
        "config_sha256": digest,
        "shards": shards,
        "n_samples": sum(s["n_samples"] for s in shards),
        "n_grasps": sum(s["n_grasps"] for s in shards),
        "fields": field_table(),
        "tool_families": list(TOOL_FAMILIES),
        "reasons": list(_core.REASONS),
        "bounds": {name: getattr(config, name) for name in bounds},
        "hand": hand,
    }
