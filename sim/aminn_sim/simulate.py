"""Simulate a data set: shards of grasps, each grasp under many loads, written as HDF5 with a JSON manifest.

A shard's bytes follow from the seed, its number and the configuration. It is written under a temporary name and renamed
when complete, so that an interrupted simulation goes on where it stopped.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import os
import platform
import shutil
import sys
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from tqdm import tqdm

from aminn_base.files import write_atomically, write_json

from . import _core
from .config import TOOL_FAMILIES, SimulationConfig
from .engines import ShardTask, find_engine
from .errors import SimulationError
from .hand_file import HandFile, read_hand_file
from .schema import GROUPS, SCHEMA_VERSION, Field, field_table

# To be raised with every change of the C++ part that changes what is simulated.
PROTOCOL_VERSION = 2
THREADS_MAX = 1024
# Fields of the configuration that do not change what a shard holds.
_NOT_IN_HASH = ("grasps",)

Arrays = dict[str, np.ndarray]


def _open_simulator(config: SimulationConfig, digest: str, hand: Path | None) -> _core.Simulator:
    """The simulator of this machine, if it makes the data set of `digest`."""
    hand_file = read_hand_file(hand)
    if config_sha256(config, hand_file) != digest:
        raise SimulationError(
            f"{platform.node()} has another version of the simulation or of the hand; install the same there"
        )
    return hand_file.simulator()


def config_sha256(config: SimulationConfig, hand_file: HandFile) -> str:
    """Hash of everything that decides a shard's content but its number: configuration, hand, protocol."""
    content = {
        "schema_version": SCHEMA_VERSION,
        "protocol_version": PROTOCOL_VERSION,
        "simulator": simulator_name(),
        "config": {k: v for k, v in dataclasses.asdict(config).items() if k not in _NOT_IN_HASH},
        "models": hand_file.model_hashes(),
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
    hand: Path | str | None = None,
    report: Path | None = None,
) -> dict:
    """Simulate the data set of `config` into `out_dir` and return its manifest.

    threads: 0 takes every core that this process may use. engine: one of `engines.ENGINES`; the bytes are the same.
    Complete shards of the same configuration are kept; a folder with another configuration is an error. Interrupting
    (Ctrl-C) leaves the complete shards and no half-written file. hand: a hand file instead of the package's own.
    report: a file (JSON) for time and rate of this run, if there was anything left to do.
    """
    out = Path(out_dir)
    if not 0 <= threads <= THREADS_MAX:
        raise SimulationError(f"threads is {threads}, expected 0 (all cores) to {THREADS_MAX}")
    threads = threads or len(os.sched_getaffinity(0))
    run = find_engine(engine)
    hand_file = read_hand_file(hand)
    simulator = hand_file.simulator()
    check_options(config, simulator)
    check_tools_fit(config, hand_file, simulator)
    digest = config_sha256(config, hand_file)
    sizes = shard_sizes(config)
    _make_folder(out)
    todo = [n for n, size in enumerate(sizes) if not _is_complete(out / shard_name(n), digest, size, config)]
    _refuse_damaged_shards(out)
    _check_room(out, sum(sizes[n] for n in todo) * config.cases)
    if todo:
        (out / "manifest.json").unlink(missing_ok=True)  # it would describe shards that are about to change
    tasks = [
        ShardTask(config, n, sizes[n], partial(_open_simulator, config, digest, hand and hand_file.path)) for n in todo
    ]
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
        start, steps = time.monotonic(), 0
        with closing(run(tasks, threads, lambda n: bar.update(done + n - bar.n))) as shards:
            for task, result in shards:
                attributes: dict[str, int | str] = {
                    "schema_version": SCHEMA_VERSION,
                    "config_sha256": digest,
                    "shard": task.number,
                    "n_grasps": task.grasps,
                }
                write_shard(out / shard_name(task.number), result, attributes)
                steps += result["steps"]
    manifest = build_manifest(config, digest, hand_file.as_dict() | simulator.hand(), out)
    write_json(out / "manifest.json", manifest)
    if report and todo:
        _write_report(report, total - done, steps, time.monotonic() - start, threads, engine)
    return manifest


def _write_report(path: Path, cases: int, steps: int, seconds: float, threads: int, engine: str) -> None:
    figures = {
        "dataset_cases": cases,
        "dataset_engine_steps": steps,
        "dataset_seconds": seconds,
        "dataset_cases_a_second": cases / seconds,
        "dataset_threads": threads,
        "dataset_engine": engine,
    }
    write_json(path, figures)


def check_tools_fit(config: SimulationConfig, hand_file: HandFile, simulator: _core.Simulator) -> None:
    """Raises SimulationError where the largest tool does not fit between the fingertips."""
    gap = hand_file.largest_gap_m(simulator)
    if 2 * config.radius_max_m > gap:
        raise SimulationError(
            f"configuration: radius_max_m {config.radius_max_m} makes tools larger than the hand's span: the "
            f"fingertips of {hand_file.path} open to {gap:.4f} m at most; choose at most {gap / 2:.4f}"
        )


def check_options(config: SimulationConfig, simulator: _core.Simulator) -> None:
    """Raises SimulationError where an option is none for the time step of the hand's model."""
    try:
        simulator.check(config.options())
    except ValueError as error:
        raise SimulationError(f"configuration: {error}") from error


def _check_room(out: Path, cases: int) -> None:
    """Refuse before any work what the disk cannot hold; the estimate is the numbers of /samples alone."""
    a_case = sum(np.dtype(f.dtype).itemsize * math.prod(f.shape) for f in GROUPS["samples"].values())
    free = shutil.disk_usage(out).free
    if cases * a_case > free:
        raise SimulationError(
            f"{out}: {cases} load cases need {cases * a_case / 1e9:.3g} GB or more, {free / 1e9:.3g} GB are free; "
            "choose fewer grasps or cases, or another folder"
        )


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


def write_shard(path: Path, arrays: dict[str, Arrays], attributes: dict[str, int | str]) -> None:
    """Write one shard (arrays by group and field), complete or not at all. Equal content gives equal bytes."""
    image = io.BytesIO()  # HDF5 itself does not survive a disk that is full
    with h5py.File(image, "w", libver=("earliest", "v110")) as file:
        for name, value in attributes.items():
            file.attrs[name] = value
        for group, fields in GROUPS.items():
            for name, array in _checked(group, fields, arrays[group]).items():
                file.create_dataset(f"{group}/{name}", data=array, track_times=False)
    write_atomically(path, image.getvalue())


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
    rejections = np.zeros(len(_core.REJECTIONS), int)
    for shard in shards:
        with h5py.File(out / str(shard["file"]), "r") as file:
            rejections += file["grasps/rejections"][()].sum(0)
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
        "rejection_reasons": list(_core.REJECTIONS),
        "rejections": dict(zip(_core.REJECTIONS, rejections.tolist(), strict=True)),
        "bounds": {name: getattr(config, name) for name in bounds},
        "hand": hand,
    }
