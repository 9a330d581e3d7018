"""Read a simulated data set (a manifest and HDF5 shards) into arrays, and split it by grasp.

Load cases of one grasp never stand on both sides of a split: membership follows from a hash of the grasp id alone, so
that it does not change when a data set grows.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import torch
from numpy.typing import NDArray

from .dims import INPUT_SHAPES, N_JOINT, N_WRENCH
from .errors import AminnError

SCHEMA_VERSION = 1
MANIFEST_KEYS = ("config_sha256", "shards", "hand", "n_samples", "n_grasps")
SPLITS = ("train", "validation", "test")
SPLIT_FRACTIONS = (0.70, 0.15, 0.15)

# What the trainer reads of /samples, shape of one row. The manifest describes these and the rest.
SAMPLE_SHAPES: dict[str, tuple[int, ...]] = INPUT_SHAPES | {
    "dx_ht": (N_WRENCH,),
    "dx_ht_early": (N_WRENCH,),
    "q_after": (N_JOINT,),
    "stable": (),
    "grasp_id": (),
}


@dataclass(frozen=True)
class Dataset:
    """Samples (leading dimension n) and grasps (g); float64 but for `stable` (uint8) and `grasp_id` (int64)."""

    manifest: dict
    samples: dict[str, NDArray]
    grasps: dict[str, NDArray]

    def __len__(self) -> int:
        return len(self.samples["stable"])

    def take(self, index: NDArray) -> Dataset:
        """The samples that `index` (indices or a mask) selects; grasps stay whole."""
        return Dataset(self.manifest, {k: v[index] for k, v in self.samples.items()}, self.grasps)

    def split(self, name: str) -> Dataset:
        """The samples of one of `SPLITS`."""
        if name not in SPLITS:
            raise AminnError(f"split {name!r} is unknown; there are {', '.join(SPLITS)}")
        return self.take(split_of(self.samples["grasp_id"]) == SPLITS.index(name))

    @property
    def sha256(self) -> str:
        """Identity of the data: of the configuration and of every shard."""
        content = self.manifest["config_sha256"] + "".join(shard["sha256"] for shard in self.manifest["shards"])
        return hashlib.sha256(content.encode()).hexdigest()

    def inputs(self, dtype: torch.dtype = torch.float32) -> dict[str, torch.Tensor]:
        """Model inputs as tensors."""
        return {k: torch.as_tensor(self.samples[k]).to(dtype) for k in INPUT_SHAPES}


def split_of(grasp_id: NDArray) -> NDArray[np.int64]:
    """Index into `SPLITS` for each grasp id."""
    unique, inverse = np.unique(grasp_id, return_inverse=True)
    draws = [int.from_bytes(hashlib.sha256(b"split %d" % g).digest()[:8]) / 2.0**64 for g in unique.tolist()]
    return np.searchsorted(np.cumsum(SPLIT_FRACTIONS)[:-1], draws, side="right")[inverse]


def read_manifest(path: Path) -> dict:
    """The manifest of the data set in folder `path`."""
    file = path / "manifest.json"
    if not file.is_file():
        raise AminnError(f"{path}: no manifest.json; is this a data set, and did its simulation finish?")
    try:
        manifest = json.loads(file.read_text())
    except json.JSONDecodeError as error:
        raise AminnError(f"{file}: not valid JSON ({error})") from error
    if not isinstance(manifest, dict):
        raise AminnError(f"{file}: not the manifest of a data set")
    if manifest.get("schema_version") != SCHEMA_VERSION:
        raise AminnError(
            f"{file}: schema_version is {manifest.get('schema_version')}, this program reads {SCHEMA_VERSION}; "
            "simulate the data set again"
        )
    missing = [key for key in MANIFEST_KEYS if key not in manifest]
    if missing:
        raise AminnError(f"{file}: {', '.join(missing)} missing; simulate the data set again")
    return manifest


def _read_shard(folder: Path, entry: dict) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
    path = folder / entry["file"]
    if not path.is_file():
        raise AminnError(f"{path}: the manifest names this shard, but it is missing; run the simulation again")
    if hashlib.sha256(path.read_bytes()).hexdigest() != entry["sha256"]:
        raise AminnError(f"{path}: damaged, its SHA-256 is not the manifest's; delete it and run the simulation again")
    try:
        with h5py.File(path, "r") as file:
            samples = {name: dataset[()] for name, dataset in file["samples"].items()}
            grasps = {name: dataset[()] for name, dataset in file["grasps"].items()}
    except (OSError, KeyError) as error:
        raise AminnError(f"{path}: not a readable shard ({error})") from error
    for name, shape in SAMPLE_SHAPES.items():
        if name not in samples:
            raise AminnError(f"{path}: /samples/{name} is missing")
        if samples[name].shape[1:] != shape:
            raise AminnError(f"{path}: /samples/{name} has rows of shape {samples[name].shape[1:]}, expected {shape}")
    return samples, grasps


def load_dataset(path: Path) -> Dataset:
    """Read and check the data set in folder `path`. Raises AminnError with the file and field that is wrong."""
    manifest = read_manifest(path)
    shards = [_read_shard(path, entry) for entry in manifest["shards"]]
    if not shards:
        raise AminnError(f"{path}: the data set has no shards")
    samples = {name: np.concatenate([s[name] for s, _ in shards]) for name in shards[0][0]}
    grasps = {name: np.concatenate([g[name] for _, g in shards]) for name in shards[0][1]}
    for name in SAMPLE_SHAPES:
        bad = ~np.isfinite(samples[name].reshape(len(samples[name]), -1).astype(float)).all(1)
        if bad.any():
            where = f"sample {int(np.argmax(bad))} ({int(bad.sum())} such samples)"
            raise AminnError(f"{path}: {name} is not finite in {where}; simulate the data set again")
    return Dataset(manifest, samples, grasps)
