"""A data set as arrays, for figures and pages; the trainer has a reader of its own that checks more."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError, InUseError
from aminn_base.hdf5 import read_field
from aminn_base.lock import read_shared
from aminn_base.read import AnyPath, read_json, require
from aminn_base.seal import check_seal
from aminn_hand.hand import Hand

from .errors import SimulationError
from .schema import groups_of

Array = NDArray[np.float64]
MANIFEST_KEYS: dict[str, type] = {
    "bounds": dict,
    "config": dict,
    "config_sha256": str,
    "fields": dict,
    "hand": dict,
    "n_grasps": int,
    "n_samples": int,
    "protocol_version": int,
    "reasons": list,
    "rejection_reasons": list,
    "rejections": dict,
    "seed": int,
    "shards": list,
    "simulator": str,
    "tool_families": list,
}
"""What figures and pages read of a manifest."""


@dataclass(frozen=True)
class SimulatedData:
    """Fields by name; `noise["sample"]` counts rows of `samples` over all shards."""

    manifest: dict
    samples: dict[str, Array]
    grasps: dict[str, Array]
    noise: dict[str, Array]

    @cached_property
    def hand(self) -> Hand:
        """The hand that was simulated."""
        return Hand.from_dict(self.manifest["hand"])

    @property
    def grasp_row(self) -> NDArray[np.int64]:
        """Row of `grasps` of each sample."""
        return np.searchsorted(self.grasps["grasp_id"], self.samples["grasp_id"])

    def of_grasp(self, name: str) -> Array:
        """A field of /grasps, one row per sample."""
        return self.grasps[name][self.grasp_row]


def read_data(folder: AnyPath) -> SimulatedData:
    """Read the finished data set in `folder`.

    Raises SimulationError where there is none or a shard is damaged, InUseError where another program writes to one.
    """
    folder = Path(folder)
    try:
        manifest = read_json(folder / "manifest.json", "the manifest of a data set")
        if manifest.get("origin") == "measured":
            raise AminnError("it was measured, and this is for simulated data")
        check_seal(folder / "manifest.json", manifest, "simulate the data set again")
        require(folder / "manifest.json", manifest, MANIFEST_KEYS, "simulate the data set again")
        schema = groups_of(Hand.from_dict(manifest["hand"]), "theta_names" in manifest)
        groups: dict[str, list[dict[str, Array]]] = {group: [] for group in schema}
        before = 0
        for shard in manifest["shards"]:
            content = read_shared(folder / shard["file"])
            if hashlib.sha256(content).hexdigest() != shard["sha256"]:
                raise ValueError(f"{shard['file']} is damaged, its SHA-256 is not the manifest's")
            with h5py.File(io.BytesIO(content), "r") as file:
                for group, parts in groups.items():
                    parts.append({name: read_field(data, len(content)) for name, data in file[group].items()})
            groups["noise"][-1]["sample"] = groups["noise"][-1]["sample"] + before
            before += shard["n_samples"]
        joined = {g: {k: np.concatenate([p[k] for p in parts]) for k in parts[0]} for g, parts in groups.items()}
        for group, fields in schema.items():
            lengths = {name: joined[group][name].shape for name in fields}
            rows = {shape[:1] for shape in lengths.values()}
            wrong = [name for name, field in fields.items() if lengths[name][1:] != field.shape]
            if wrong or len(rows) != 1:
                raise ValueError(f"/{group} is not as the schema says{': ' + ', '.join(wrong) if wrong else ''}")
    except InUseError:
        raise
    except (AminnError, OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RuntimeError) as error:
        raise SimulationError(f"{folder}: not a readable data set ({error}); simulate it again") from error
    return SimulatedData(manifest, **joined)
