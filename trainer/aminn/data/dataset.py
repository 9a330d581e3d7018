"""Read a data set, simulated or measured (a manifest and HDF5 shards) into arrays, and split it by grasp.

Load cases of one grasp never stand on both sides of a split: membership follows from a hash of the grasp id alone, so
that it does not change when a data set grows.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import h5py
import numpy as np
import torch
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.hdf5 import read_field
from aminn_base.lock import read_shared
from aminn_base.read import AnyPath, is_file, read_json, require
from aminn_base.seal import check_seal
from aminn_hand import Hand
from aminn_hand.hand import N_WRENCH
from aminn_hand.sensors import faults
from aminn_hand.theta import Theta

from ..hand.nominal import gated_tendons

SCHEMA_VERSION = 4
MANIFEST_KEYS: dict[str, type] = {
    "config_sha256": str,
    "shards": list,
    "hand": dict,
    "n_samples": int,
    "n_grasps": int,
    "tool_families": list,
}
SHARD_KEYS: dict[str, type] = {"file": str, "sha256": str, "n_samples": int, "n_grasps": int}
ANEW = "simulate the data set again, or import it again"
ORIGIN, MEASURED = "origin", "measured"
"""Key of a manifest, and its value where the pushes were measured; where it is missing they were simulated."""
SIMULATED_ONLY = frozenset(
    "q_after tendon_tension_after_N tendon_tension_N tool_family tool_size_m tool_geoms friction tool_mass_kg "
    "gravity_m_s2".split()
)
"""Fields that no sensor gives: measured data lack them, and /noise."""
TAUT_N = 1e-3
"""Tension above which a tendon counts as taut."""
SPLITS = ("train", "validation", "test")
SPLIT_FRACTIONS = (0.70, 0.15, 0.15)

GROUPS = ("samples", "grasps", "noise")
Shapes = dict[str, dict[str, tuple[int, ...]]]  # group -> field -> shape of one row


def shapes_of(hand: Hand, varied: bool = False) -> Shapes:
    """What the trainer reads of a shard. The manifest describes this and the rest. varied: hands have a theta.

    /noise are load cases simulated again with half the time step and with another contact impedance ratio.
    """
    dims = hand.dims
    samples = dims.inputs | {
        "dx_ht": (N_WRENCH,),
        "q_after": (dims.joints,),
        "tendon_tension_after_N": (dims.tendons,),
        "stable": (),
        "grasp_id": (),
    }
    grasps: dict[str, tuple[int, ...]] = {
        "grasp_id": (),
        "tool_family": (),
        "tool_size_m": (3,),
        "tool_geoms": (3, 11),
        "friction": (),
        "tendon_tension_N": (dims.tendons,),
    }
    grasps |= {"theta": (len(Theta(hand)),), "hand_id": ()} if varied else {}
    noise: dict[str, tuple[int, ...]] = {
        "sample": (),
        "dx_half_step": (N_WRENCH,),
        "stable_half_step": (),
        "dx_impratio": (N_WRENCH,),
        "stable_impratio": (),
    }
    return {"samples": samples, "grasps": grasps, "noise": noise}


def optional_shapes_of(hand: Hand) -> Shapes:
    """What the trainer reads of shards that have it: sensors of measured data; what a tool's weight follows from."""
    return {"samples": hand.dims.sensors, "grasps": {"tool_mass_kg": (), "gravity_m_s2": (3,)}, "noise": {}}


@dataclass(frozen=True)
class Dataset:
    """Samples (leading dimension n) and grasps (g); float64 but for `stable` (uint8) and `grasp_id` (int64).

    Where hands differ from their description (the manifest has `theta_names`), samples have their grasp's `theta`.
    Measured samples have the sensors of `Dims.sensors` that the data tell; of simulated ones `sensors.py` says them.
    """

    manifest: dict
    samples: dict[str, NDArray]
    grasps: dict[str, NDArray]
    noise: dict[str, NDArray]
    """The repeated simulations (m rows), as in /noise; `samples["noise_row"]` says which row belongs to a sample."""
    selection: str = ""
    """What the samples were chosen by, if they are not all: part of the data's identity."""

    def __len__(self) -> int:
        return len(self.samples["stable"])

    @cached_property
    def hand(self) -> Hand:
        """The hand that was simulated."""
        return hand_of(self.manifest, "manifest")

    def take(self, index: NDArray) -> Dataset:
        """The samples that `index` (indices or a mask) selects; grasps stay whole."""
        return replace(self, samples={k: v[index] for k, v in self.samples.items()})

    def where(self, mask: NDArray[np.bool_], selection: str) -> Dataset:
        """The samples of `mask` as a data set of its own, known by the text `selection`."""
        return replace(self.take(mask), selection=selection)

    def split(self, name: str, fraction: float = 1.0) -> Dataset:
        """The samples of one of `SPLITS`, or of a fraction of its grasps; smaller fractions are part of larger ones."""
        if name not in SPLITS:
            raise AminnError(f"split {name!r} is unknown; there are {', '.join(SPLITS)}")
        ids = self.samples["grasp_id"]
        return self.take((split_of(ids) == SPLITS.index(name)) & (_draws(b"share %d", ids) < fraction))

    @property
    def measured(self) -> bool:
        """Whether a lab measured the pushes; what only a simulator knows is missing then."""
        return is_measured(self.manifest)

    def simulated(self, group: str, name: str) -> NDArray:
        """A field of `SIMULATED_ONLY`. Raises AminnError where the data are measured."""
        fields: dict[str, NDArray] = getattr(self, group)
        if name not in fields:
            raise AminnError(f"{name} is known of simulated data alone, and these are {MEASURED}; give simulated ones")
        return fields[name]

    def taut(self) -> NDArray[np.bool_] | None:
        """Whether the tendon that each branch's gate stands for is taut under load: (n, B); no where there is none.

        None where tensions are not known.
        """
        if "tendon_tension_after_N" not in self.samples:
            return None
        tension, gated = self.samples["tendon_tension_after_N"], gated_tendons(self.hand)
        taut = [tension[:, i] > TAUT_N if i >= 0 else np.zeros(len(self), bool) for i in gated]
        return np.stack(taut, 1)

    def grasp_rows(self) -> NDArray[np.int64]:
        """For each sample, the row of its grasp in `grasps`."""
        order = np.argsort(self.grasps["grasp_id"])
        return order[np.searchsorted(self.grasps["grasp_id"], self.samples["grasp_id"], sorter=order)]

    @property
    def sha256(self) -> str:
        """Identity of the data: of the configuration and of every shard."""
        content = self.manifest["config_sha256"] + "".join(shard["sha256"] for shard in self.manifest["shards"])
        content += self.selection
        return hashlib.sha256(content.encode()).hexdigest()

    @property
    def has_theta(self) -> bool:
        """Whether the data tell mechanics parameters: `samples["theta"]` (n, P)."""
        return "theta" in self.samples

    def inputs(self, dtype: torch.dtype = torch.float32) -> dict[str, torch.Tensor]:
        """Model inputs as tensors; `theta` and sensors among them where the data tell them."""
        more = [name for name in ("theta", *self.hand.dims.sensors) if name in self.samples]
        names = [*self.hand.dims.inputs, *more]
        return {k: torch.as_tensor(self.samples[k]).to(dtype) for k in names}


def split_of(grasp_id: NDArray) -> NDArray[np.int64]:
    """Index into `SPLITS` for each grasp id."""
    return np.searchsorted(np.cumsum(SPLIT_FRACTIONS)[:-1], _draws(b"split %d", grasp_id), side="right")


def _draws(purpose: bytes, grasp_id: NDArray) -> NDArray[np.float64]:
    """A number in [0, 1) for each grasp id, from a hash of it and the purpose."""
    unique, inverse = np.unique(grasp_id, return_inverse=True)
    draws = [int.from_bytes(hashlib.sha256(purpose % g).digest()[:8]) / 2.0**64 for g in unique.tolist()]
    return np.asarray(draws)[inverse]


def read_manifest(path: AnyPath) -> dict:
    """The manifest of the data set in folder `path`. Raises AminnError with the key that is wrong."""
    path = Path(path)
    file = path / "manifest.json"
    if not file.is_file():
        raise AminnError(f"{path}: no manifest.json; is this a data set, and did what makes it finish?")
    manifest = read_json(file, "the manifest of a data set")
    version = manifest.get("schema_version")
    if version != SCHEMA_VERSION:
        newer = isinstance(version, int) and version > SCHEMA_VERSION
        remedy = "it was written by a newer AMINN, read it with that" if newer else ANEW
        raise AminnError(f"{file}: schema_version is {version}, this program reads {SCHEMA_VERSION}; {remedy}")
    check_seal(file, manifest, ANEW)
    require(file, manifest, MANIFEST_KEYS, ANEW)
    for n, shard in enumerate(manifest["shards"]):
        require(f"{file}: shards[{n}]", _table(file, f"shards[{n}]", shard), SHARD_KEYS, ANEW)
        if Path(shard["file"]).name != shard["file"]:
            name = shard["file"]
            raise AminnError(f"{file}: shards[{n}].file is {name!r}, expected a file beside the manifest; {ANEW}")
    hand = hand_of(manifest, f"{file}")
    if "theta_names" in manifest and manifest["theta_names"] != list(Theta(hand).names):
        raise AminnError(
            f"{file}: theta_names are not the parameters of its hand, {', '.join(Theta(hand).names)}; {ANEW}"
        )
    return manifest


def is_measured(manifest: dict) -> bool:
    """Whether the data set of a manifest was measured."""
    return manifest.get(ORIGIN) == MEASURED


def hand_of(manifest: dict, source: str) -> Hand:
    """The hand of a manifest. Raises AminnError where its description is damaged."""
    try:
        return Hand.from_dict(manifest["hand"])
    except AminnError as error:
        raise AminnError(f"{source}: {error}; {ANEW}") from error


def _table(file: Path, place: str, value: object) -> dict:
    if not isinstance(value, dict):
        raise AminnError(f"{file}: {place} is no table; {ANEW}")
    return value


Shard = dict[str, dict[str, NDArray]]  # group -> field -> rows


def _read_shard(folder: Path, entry: dict, groups: Shapes, optional: Shapes) -> Shard:
    path = folder / entry["file"]
    if not is_file(path):
        raise AminnError(f"{path}: the manifest names this shard, but it is missing; {ANEW}")
    content = read_shared(path)
    if hashlib.sha256(content).hexdigest() != entry["sha256"]:
        raise AminnError(f"{path}: damaged, its SHA-256 is not the manifest's; delete it, and {ANEW}")
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            shard = {
                group: {name: read_field(rows, len(content)) for name, rows in file[group].items()} for group in groups
            }
    except (OSError, KeyError, AttributeError, TypeError, ValueError, RuntimeError) as error:  # all of them h5py's
        raise AminnError(f"{path}: not a readable shard ({error}); {ANEW}") from error
    for group, key in (("samples", "n_samples"), ("grasps", "n_grasps")):
        found = {len(np.atleast_1d(values)) for values in shard[group].values()}
        if found != {entry[key]}:
            raise AminnError(f"{path}: /{group} has {_rows(found)} rows, the manifest says {entry[key]}; {ANEW}")
    for group, shapes in groups.items():
        rows = None
        more = {name: shape for name, shape in optional[group].items() if name in shard[group]}
        for name, shape in (shapes | more).items():
            if name not in shard[group]:
                raise AminnError(f"{path}: /{group}/{name} is missing; {ANEW}")
            values = np.asarray(shard[group][name])
            if values.dtype.kind not in "biuf":
                raise AminnError(f"{path}: /{group}/{name} holds {values.dtype}, expected numbers; {ANEW}")
            if values.ndim == 0 or values.shape[1:] != shape:
                row = values.shape[1:]
                raise AminnError(f"{path}: /{group}/{name} has rows of shape {row}, expected {shape}; {ANEW}")
            rows = len(values) if rows is None else rows
            if len(values) != rows:
                raise AminnError(f"{path}: /{group}/{name} has {len(values)} rows where others have {rows}; {ANEW}")
    return shard


def _sensed(fields: dict[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    return {name: shape for name, shape in fields.items() if name not in SIMULATED_ONLY}


def _rows(lengths: set[int]) -> str:
    return " and ".join(map(str, sorted(lengths))) or "no"


def _check_together(path: Path, manifest: dict, shards: list[Shard]) -> None:
    """The shards are those of the manifest, all of them and no others, and no grasp is there twice."""
    names = [entry["file"] for entry in manifest["shards"]]
    foreign = sorted({p.name for p in path.glob("shard-*.h5")} - set(names))
    if foreign:
        raise AminnError(
            f"{path / foreign[0]}: the manifest does not name this shard; delete it if it is left from a larger data "
            f"set, else {ANEW}"
        )
    holder: dict[int, str] = {}
    for name, shard in zip(names, shards, strict=True):
        ids, of_samples = shard["grasps"]["grasp_id"].tolist(), set(shard["samples"]["grasp_id"].tolist())
        for grasp in ids:
            if grasp in holder:
                raise AminnError(
                    f"{path / name}: holds grasp {grasp}, which {holder[grasp]} holds too; delete manifest and "
                    f"shard, and {ANEW}"
                )
            holder[grasp] = name
        if of_samples - set(ids):
            raise AminnError(f"{path / name}: has samples of grasps that it does not hold; {ANEW}")
    for key, group in (("n_grasps", "grasps"), ("n_samples", "samples")):
        rows = sum(len(shard[group]["grasp_id"]) for shard in shards)
        if rows != manifest[key]:
            raise AminnError(f"{path}: {key} of the manifest is {manifest[key]}, the shards hold {rows}")


def _check_fields(path: Path, manifest: dict, shards: list[Shard]) -> None:
    """All shards have the fields of the first one."""
    for entry, shard in zip(manifest["shards"], shards, strict=True):
        for group, fields in shards[0].items():
            if odd := sorted(fields.keys() ^ shard[group].keys()):
                where = f"{path / entry['file']}: /{group}/{odd[0]}"
                raise AminnError(f"{where} is not both here and in {manifest['shards'][0]['file']}; {ANEW}")


def _joined(shards: list[Shard], group: str) -> dict[str, NDArray]:
    return {name: np.concatenate([shard[group][name] for shard in shards]) for name in shards[0][group]}


def load_dataset(path: AnyPath) -> Dataset:
    """Read and check the data set in folder `path`. Raises AminnError with the file and field that is wrong."""
    path = Path(path)
    manifest = read_manifest(path)
    groups = shapes_of(hand_of(manifest, str(path)), "theta_names" in manifest)
    if is_measured(manifest):
        groups = {name: _sensed(fields) for name, fields in groups.items() if name != "noise"}
    optional = optional_shapes_of(hand_of(manifest, str(path)))
    shards = [_read_shard(path, entry, groups, optional) for entry in manifest["shards"]]
    if not shards:
        raise AminnError(f"{path}: the data set has no shards")
    _check_together(path, manifest, shards)
    _check_fields(path, manifest, shards)
    starts = np.cumsum([0] + [len(shard["samples"]["stable"]) for shard in shards])
    for shard, start in zip(shards, starts, strict=False):
        again = shard.setdefault("noise", {"sample": np.zeros(0, np.int64)})
        again["sample"] = again["sample"] + start
    samples, grasps, noise = (_joined(shards, group) for group in GROUPS)
    if not len(samples["stable"]):
        raise AminnError(f"{path}: the data set has no load cases; {ANEW}")
    strange = np.setdiff1d(samples["grasp_id"], grasps["grasp_id"])
    if len(strange):
        raise AminnError(f"{path}: grasp_id {strange[0]} of /samples is not in /grasps; {ANEW}")
    if len(noise["sample"]) and not (0 <= noise["sample"].min() and noise["sample"].max() < len(samples["stable"])):
        raise AminnError(f"{path}: /noise/sample names rows that /samples does not have; {ANEW}")
    family = grasps.get("tool_family", np.zeros(0))
    if len(family) and not (0 <= family.min() and family.max() < len(manifest["tool_families"])):
        raise AminnError(f"{path}: /grasps/tool_family is outside of the manifest's tool_families; {ANEW}")
    dataset = Dataset(manifest, samples, grasps, noise)
    if "theta_names" in manifest:
        samples["theta"] = grasps["theta"][dataset.grasp_rows()]
    for name in [*groups["samples"], *(["theta"] if "theta_names" in manifest else [])]:
        bad = ~np.isfinite(samples[name].reshape(len(samples[name]), -1).astype(float)).all(1)
        if bad.any():
            where = f"sample {int(np.argmax(bad))} ({int(bad.sum())} such samples)"
            raise AminnError(f"{path}: {name} is not finite in {where}; {ANEW}")
    for name in [name for name in optional["samples"] if name in samples]:
        for rows, fault in faults(name, np.asarray(samples[name], float)):
            if rows.any():
                where = f"sample {int(np.argmax(rows))} ({int(rows.sum())} such samples)"
                raise AminnError(f"{path}: {fault} in {where}; {ANEW}")
    samples["noise_row"] = np.full(len(samples["stable"]), -1)
    samples["noise_row"][noise["sample"]] = np.arange(len(noise["sample"]))
    return dataset
