"""Simulate a data set: shards of grasps, each grasp under many loads, written as HDF5 with a JSON manifest.

A shard's bytes follow from the seed, its number and the configuration. It is written under a temporary name and renamed
when complete, so that an interrupted simulation continues where it stopped; its hash is recorded before, so that what
happens to a shard meanwhile shows.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import os
import platform
import re
import shutil
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from aminn_base.errors import OutdatedError, WriteError
from aminn_base.files import refuse_inputs, write_atomically, write_json
from aminn_base.lock import locked_folder, read_shared
from aminn_base.progress import note, progress_bar
from aminn_base.read import AnyPath
from aminn_base.seal import check_seal, sealed
from aminn_hand.hand import Hand
from aminn_hand.theta import Theta

from . import _core
from .build import in_words, is_here, simulator_build
from .config import TOOL_FAMILIES, SimulationConfig
from .engines import Engine, ShardTask, find_engine
from .errors import OutdatedDataError, SimulationError
from .open_hand import OpenHand, open_hand
from .schema import SCHEMA_VERSION, Field, field_table, groups_of
from .vary import draw_theta, hand_ids, is_varied, known_mechanics

# To be raised with every change of the C++ part that changes what is simulated.
PROTOCOL_VERSION = 2
THREADS_MAX = 1024
# Fields of the configuration that do not change what a shard holds.
_NOT_IN_HASH = ("grasps",)
MANIFEST, UNFINISHED = "manifest.json", "unfinished.json"
# What a killed simulation leaves, under the names of this version and of the ones before.
OWN_PARTIAL = re.compile(r"\.?(shard-\d{5,}\.h5|manifest\.json|unfinished\.json)\.partial")

Arrays = dict[str, np.ndarray]


def _open_simulator(config: SimulationConfig, digest: str, build: dict[str, str], hand: Path | None) -> _core.Simulator:
    """The simulator of this machine, if it makes the data set of `digest` on this build of the engine."""
    if not is_here(build):
        raise SimulationError(
            f"{platform.node()} has another build of MuJoCo, {in_words(simulator_build())} instead of "
            f"{in_words(build)}; install the same there"
        )
    opened = open_hand(hand)
    if config_sha256(config, opened) != digest:
        raise SimulationError(
            f"{platform.node()} has another version of the simulation or of the hand; install the same there"
        )
    return opened.simulator()


def config_sha256(config: SimulationConfig, opened: OpenHand) -> str:
    """Hash of everything that decides a shard's content but its number: configuration, hand, protocol."""
    content = {
        "schema_version": SCHEMA_VERSION,
        "protocol_version": PROTOCOL_VERSION,
        "simulator": simulator_name(),
        "config": {k: v for k, v in dataclasses.asdict(config).items() if k not in _NOT_IN_HASH},
        "models": opened.model_hashes(),
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


def simulate(
    config: SimulationConfig,
    out_dir: AnyPath,
    threads: int = 0,
    progress: bool = True,
    engine: str = "threads",
    hand: AnyPath | None = None,
    report: AnyPath | None = None,
) -> dict:
    """Simulate the data set of `config` into `out_dir` and return its manifest.

    threads: 0 takes every core that this process may use. engine: one of `engines.ENGINES`; the bytes are the same.
    Complete shards of the same configuration are kept; a folder with another configuration is an error. Interrupting
    (Ctrl-C) leaves the complete shards and no half-written file. hand: a hand file instead of the package's own.
    report: a file (JSON) for time and rate of this run, if there was anything left to do.

    One process works in a folder at a time: InUseError names the other one.
    """
    out = Path(out_dir)
    if not 0 <= threads <= THREADS_MAX:
        raise SimulationError(f"threads is {threads}, expected 0 (all cores) to {THREADS_MAX}")
    run = find_engine(engine)
    opened = open_hand(hand)
    config, left_out = known_mechanics(config, opened.hand)
    for text in (*opened.understood.notes, *left_out) if progress else ():
        note(f"note: {text}")
    simulator = opened.simulator()
    check_options(config, simulator)
    check_tools_fit(config, opened, simulator)
    report = None if report is None else Path(report)
    refuse_inputs(report, [*opened.files(), *_own_files(config, out)])
    with ExitStack() as stack:
        _enter_folder(stack, out)
        work = _Work(config, config_sha256(config, opened), out, opened.hand)
        _check_room(out, sum(work.sizes[n] for n in work.todo) * config.cases, opened.hand)
        work.run(run, threads or len(os.sched_getaffinity(0)), progress, opened.path if hand else None)
        manifest = build_manifest(config, work.digest, opened.hand, out, work.recorded)
        if work.build:
            manifest["simulator_build"] = work.build
        manifest = sealed(manifest)
        write_json(out / MANIFEST, manifest)
        (out / UNFINISHED).unlink(missing_ok=True)
        if report and work.todo:
            write_json(report, work.figures | {"dataset_engine": engine})
    return manifest


class _Work:
    """The shards of a data set in a folder that this process holds: which are there, and making the rest."""

    def __init__(self, config: SimulationConfig, digest: str, out: Path, hand: Hand) -> None:
        self.config, self.digest, self.out, self.hand = config, digest, out, hand
        self.sizes = shard_sizes(config)
        self.figures: dict[str, float | int | str] = {}
        _refuse_shards_beyond(out, config)
        self.recorded = _recorded(out)
        """SHA-256 of each shard by its file's name, as it was written."""
        self.todo = [n for n in range(len(self.sizes)) if not self._is_complete(n)]
        self.build = self._build()
        """Of the engine that all shards are of; None where a finished data set has none on record."""

    def run(self, engine: Engine, threads: int, progress: bool, hand: Path | None) -> None:
        """Simulate what is missing."""
        config = self.config
        if self.todo:
            if self.recorded:
                self._record()
            (self.out / MANIFEST).unlink(missing_ok=True)  # it would describe shards that are about to change
        open_simulator = partial(_open_simulator, config, self.digest, simulator_build(), hand)
        tasks = [
            ShardTask(config, n, self.sizes[n], open_simulator, draw_theta(config, self.hand, self._grasps(n)))
            for n in self.todo
        ]
        total = config.grasps * config.cases
        done = total - sum(self.sizes[n] for n in self.todo) * config.cases
        with progress_bar("simulate", total, "case", initial=done, disable=not progress, smoothing=0.1) as bar:
            start, steps = time.monotonic(), 0
            with closing(engine(tasks, threads, lambda n: bar.update(done + n - bar.n))) as shards:
                for task, result in shards:
                    self._keep(task, result)
                    steps += result["steps"]
        seconds = time.monotonic() - start
        self.figures = {
            "dataset_cases": total - done,
            "dataset_engine_steps": steps,
            "dataset_seconds": seconds,
            "dataset_cases_a_second": (total - done) / seconds,
            "dataset_threads": threads,
        }

    def _build(self) -> dict[str, str] | None:
        if len(self.todo) == len(self.sizes):
            return simulator_build()
        began = _recorded_build(self.out)
        if self.todo and not is_here(began):
            raise OutdatedDataError(
                f"{self.out}: was begun on another build of MuJoCo, {in_words(began)}; here it is "
                f"{in_words(simulator_build())}; continue where that one is, choose another folder or delete this one"
            )
        return began

    def _grasps(self, number: int) -> range:
        """Ids of the grasps of a shard."""
        first = number * self.config.shard_grasps
        return range(first, first + self.sizes[number])

    def _keep(self, task: ShardTask, result: dict) -> None:
        """Write a shard. Its hash is on record before it is there: no shard is ever without."""
        attributes: dict[str, int | str] = {
            "schema_version": SCHEMA_VERSION,
            "config_sha256": self.digest,
            "shard": task.number,
            "n_grasps": task.grasps,
        }
        if task.theta is not None:
            ids = hand_ids(self.config, self._grasps(task.number))
            result["grasps"] = result["grasps"] | {"theta": task.theta, "hand_id": ids}
        content, name = shard_bytes(result, attributes, self.hand), shard_name(task.number)
        self.recorded[name] = hashlib.sha256(content).hexdigest()
        self._record()
        write_atomically(self.out / name, content)

    def _record(self) -> None:
        shards = [{"file": k, "sha256": v} for k, v in self.recorded.items()]
        origin = {"simulator_build": self.build} | _origin(self.config, self.hand)
        write_json(self.out / UNFINISHED, sealed({"shards": shards} | origin))

    def _is_complete(self, number: int) -> bool:
        """Whether the shard is there and as it was written; one that no record vouches for is to be made again.

        Raises OutdatedDataError where it is damaged, of another configuration, or another one.
        """
        path, wanted = self.out / shard_name(number), self.sizes[number]
        if not path.exists():
            return False
        content = read_shared(path)
        try:
            with h5py.File(io.BytesIO(content), "r") as file:
                digest, count = str(file.attrs["config_sha256"]), int(file.attrs["n_grasps"])
                found = int(file.attrs["shard"])
                ids, of_samples = file["grasps/grasp_id"][()], np.unique(file["samples/grasp_id"][()])
        except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
            raise OutdatedDataError(f"{path}: not a readable shard ({error}); delete it and simulate again") from error
        if digest != self.digest:
            what = _difference(self.out, self.config, self.hand)
            raise OutdatedDataError(
                f"{path}: is of another configuration ({what}); choose another folder or delete this one"
            )
        if found != number:
            raise OutdatedDataError(
                f"{path}: is a copy of shard {found}, whose grasps would count twice; delete it and simulate again"
            )
        if count > wanted:
            raise OutdatedDataError(
                f"{path}: holds {count} grasps, but {self.config.grasps} grasps in all leave {wanted} for it; "
                "choose another folder or ask for at least as many grasps as before"
            )
        if count < wanted:
            return False
        expected = np.array(self._grasps(number))
        sha256 = self.recorded.get(path.name, "")
        if not (np.array_equal(ids, expected) and np.array_equal(of_samples, expected)) or (
            sha256 and hashlib.sha256(content).hexdigest() != sha256
        ):
            raise OutdatedDataError(
                f"{path}: damaged, its SHA-256 is not the recorded one; delete it and simulate again"
            )
        return bool(sha256)


def _origin(config: SimulationConfig, hand: Hand) -> dict:
    """What a data set is made of, as its manifest has it."""
    return {
        "schema_version": SCHEMA_VERSION,
        "protocol_version": PROTOCOL_VERSION,
        "simulator": simulator_name(),
        "config": dataclasses.asdict(config) | {"families": list(config.families)},
        "hand": hand.as_dict(),
    }


def _difference(out: Path, config: SimulationConfig, hand: Hand) -> str:
    """What the data set in `out` has otherwise, as far as its record tells."""
    mine = json.loads(json.dumps(_origin(config, hand)))
    for file in (out / UNFINISHED, out / MANIFEST):
        try:
            found = json.loads(file.read_text())
            theirs = {name: found[name] for name in mine}
            settings, wanted = ({k: v for k, v in o["config"].items() if k not in _NOT_IN_HASH} for o in (theirs, mine))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        changed = [f"{k} {settings.get(k)} instead of {v}" for k, v in wanted.items() if settings.get(k) != v]
        changed += [name for name in mine if name not in ("config", "hand") and theirs[name] != mine[name]]
        if theirs["hand"] != mine["hand"]:
            names = [str(dict(o["hand"]).get("name")) for o in (theirs, mine)]
            changed.append(f"hand {names[0]}" + (f" instead of {names[1]}" if names[0] != names[1] else " as it was"))
        return ", ".join(changed) or "the files of the hand"
    return "what differs is not on record"


def _recorded(out: Path) -> dict[str, str]:
    """SHA-256 by file, as the manifest of a finished data set in `out` or the record of an unfinished one has it."""
    found: dict[str, str] = {}
    for file in (out / UNFINISHED, out / MANIFEST):
        try:
            content = json.loads(file.read_text())
            found |= {str(shard["file"]): str(shard["sha256"]) for shard in content["shards"]}
            check_seal(file, content, "delete it and simulate again")
        except FileNotFoundError:
            continue
        except OutdatedError as error:
            raise OutdatedDataError(str(error)) from error
        except (ValueError, KeyError, TypeError) as error:
            raise OutdatedDataError(f"{file}: not readable ({error}); delete it and simulate again") from error
    return found


def _recorded_build(out: Path) -> dict[str, str] | None:
    """The engine's build as the record of the data set in `out` has it."""
    for file in (out / UNFINISHED, out / MANIFEST):
        try:
            found = json.loads(file.read_text()).get("simulator_build")
        except (OSError, ValueError, AttributeError):
            continue
        if isinstance(found, dict) and {"library", "from", "sha256"} <= found.keys():
            return {str(k): str(v) for k, v in found.items()}
    return None


def check_tools_fit(config: SimulationConfig, opened: OpenHand, simulator: _core.Simulator) -> None:
    """Raises SimulationError where no tool fits between the fingertips, or none of the size that was asked for."""
    gap = opened.largest_gap_m(simulator)
    if 2 * config.radius_min_m > gap:
        raise SimulationError(
            f"configuration: radius_min_m {config.radius_min_m} makes even the smallest tool larger than the hand's "
            f"span: the fingertips of {opened.path} open to {gap:.4f} m at most; choose at most {gap / 2:.4f}, or tell "
            "a wider [closing] or [synergy]"
        )
    if 2 * config.radius_max_m > gap and config.radius_max_m > SimulationConfig().radius_max_m:
        raise SimulationError(
            f"configuration: radius_max_m {config.radius_max_m} makes tools larger than the hand's span: the "
            f"fingertips of {opened.path} open to {gap:.4f} m at most; choose at most {gap / 2:.4f}"
        )


def check_options(config: SimulationConfig, simulator: _core.Simulator) -> None:
    """Raises SimulationError where an option is none for the time step of the hand's model."""
    try:
        simulator.check(config.options())
    except ValueError as error:
        raise SimulationError(f"configuration: {error}") from error


def _check_room(out: Path, cases: int, hand: Hand) -> None:
    """Refuse before any work what the disk cannot hold; the estimate is the numbers of /samples alone."""
    a_case = sum(np.dtype(f.dtype).itemsize * math.prod(f.shape) for f in groups_of(hand)["samples"].values())
    free = shutil.disk_usage(out).free
    if cases * a_case > free:
        raise SimulationError(
            f"{out}: {cases} load cases need {cases * a_case / 1e9:.3g} GB or more, {free / 1e9:.3g} GB are free; "
            "choose fewer grasps or cases, or another folder"
        )


def _own_files(config: SimulationConfig, out: Path) -> list[Path]:
    """The files that a data set in `out` is made of."""
    return [out / MANIFEST, out / UNFINISHED, *(out / shard_name(n) for n in range(len(shard_sizes(config))))]


def _enter_folder(stack: ExitStack, out: Path) -> None:
    """Make `out`, hold it, and so see that it can be written to before time goes into simulating."""
    try:
        stack.enter_context(locked_folder(out))
        for leftover in out.iterdir():
            if OWN_PARTIAL.fullmatch(leftover.name):
                leftover.unlink()
    except (WriteError, OSError) as error:
        reason = error.reason if isinstance(error, WriteError) else error.strerror
        raise SimulationError(
            f"{out}: cannot be made a data set folder ({reason}); choose one that you may write to"
        ) from error


def _refuse_shards_beyond(out: Path, config: SimulationConfig) -> None:
    """Shards that a data set of this size has not: what would they be to it?"""
    count = len(shard_sizes(config))
    beyond = sorted(p for p in out.glob("shard-*.h5") if p.name not in {shard_name(n) for n in range(count)})
    if beyond:
        raise OutdatedDataError(
            f"{beyond[0]}: not of the {count} shards that {config.grasps} grasps make, {config.shard_grasps} in each; "
            "ask for as many grasps as before or more, choose another folder, or delete it"
        )


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


def shard_bytes(arrays: dict[str, Arrays], attributes: dict[str, int | str], hand: Hand) -> bytes:
    """One shard (arrays by group and field) as a file's content. Equal arrays give equal bytes."""
    image = io.BytesIO()  # HDF5 itself does not survive a disk that is full
    with h5py.File(image, "w", libver=("earliest", "v110")) as file:
        for name, value in attributes.items():
            file.attrs[name] = value
        for group, fields in groups_of(hand, "theta" in arrays["grasps"]).items():
            for name, array in _checked(group, fields, arrays[group]).items():
                file.create_dataset(f"{group}/{name}", data=array, track_times=False)
    return image.getvalue()


def build_manifest(config: SimulationConfig, digest: str, hand: Hand, out: Path, recorded: Mapping[str, str]) -> dict:
    """The manifest of the shards in `out`: no time, no path, keys sorted when written.

    recorded: SHA-256 of each shard as it was written, so that what happens to a file later shows.
    """
    shards = [
        {
            "file": shard_name(n),
            "n_grasps": size,
            "n_samples": size * config.cases,
            "sha256": recorded[shard_name(n)],
        }
        for n, size in enumerate(shard_sizes(config))
    ]
    rejections = np.zeros(len(_core.REJECTIONS), int)
    for shard in shards:
        with h5py.File(out / str(shard["file"]), "r") as file:
            rejections += file["grasps/rejections"][()].sum(0)
    bounds = ("translation_max_m", "rotation_max_rad", "drift_max_m_s", "lost_contact_s", "tool_left_m", "stop_factor")
    return {
        "seed": config.seed,
        "config_sha256": digest,
        "shards": shards,
        "n_samples": sum(s["n_samples"] for s in shards),
        "n_grasps": sum(s["n_grasps"] for s in shards),
        "fields": field_table(hand, is_varied(config)),
        "origin": "simulated",
        **({"theta_names": list(Theta(hand).names)} if is_varied(config) else {}),
        "tool_families": list(TOOL_FAMILIES),
        "reasons": list(_core.REASONS),
        "rejection_reasons": list(_core.REJECTIONS),
        "rejections": dict(zip(_core.REJECTIONS, rejections.tolist(), strict=True)),
        "bounds": {name: getattr(config, name) for name in bounds},
        **_origin(config, hand),
    }
