"""Write measured pushes as a data set that every command takes. The same pushes give the same bytes, whatever file
they came from."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_base.files import write_atomically, write_json
from aminn_base.lock import locked_folder
from aminn_base.seal import sealed
from aminn_hand import Hand
from aminn_hand.hand import N_CONTACT_FEATURE, STATE
from aminn_hand.theta import Theta

from ..hand.closure import closure
from ..model.baseline import Mlp
from ..model.network import Aminn
from .dataset import MEASURED, ORIGIN, SCHEMA_VERSION, read_manifest

SHARD = "shard-00000.h5"
FALLBACKS = "fallbacks"
"""Key of the manifest: what stood in for sensors that were missing."""
KNOWN_SHARES = "known"
"""Key of the manifest: share of the pushes that tell each optional sensor of the hand."""
CORRECTED = "joint angles and contacts are made right by the joint zeros and radius that theta tells"


def write_measured(out: Path, hand: Hand, arrays: Mapping[str, NDArray], fallbacks: Sequence[str] = ()) -> dict:
    """Write the data set of checked arrays, with one row per push and no gaps, to folder `out`; returns its manifest.

    Needs q, x_ht, w_e, contacts, dx_ht and grasp_id; `stable` is 1 where it is not told. Rows keep their order, time_s
    is kept, and so are sensors that a row tells; theta, where it is told, is one of each grasp. Its joint zeros and
    radius make states right, and are 0 in the data set. A folder that holds another data set is refused.
    """
    rows, n = {name: np.asarray(values) for name, values in arrays.items()}, len(arrays["grasp_id"])
    factors = Theta(hand).factors
    if "theta" in rows and rows["theta"][:, factors:].any():
        rows["q"], rows["contacts"] = Theta(hand).corrected(rows["theta"], rows["q"], rows["contacts"])
        rows["theta"] = np.where(np.arange(len(Theta(hand))) < factors, rows["theta"], 0.0)
        fallbacks = [*fallbacks, CORRECTED]
    samples = {name: rows[name].astype(np.float64) for name in (*STATE, "dx_ht")}
    samples["j_x"], samples["j_q"] = closure(hand, samples["q"], samples["x_ht"], samples["contacts"])
    samples["grasp_id"] = rows["grasp_id"].astype(np.int64)
    samples["stable"] = rows.get("stable", np.ones(n)).astype(np.uint8)
    if "time_s" in rows:
        samples["time_s"] = rows["time_s"].astype(np.float64)
    shares = {name: float(np.mean(rows[name][:, 0])) if name in rows else 0.0 for name in hand.dims.sensors}
    samples |= {name: rows[name].astype(np.float64) for name, share in shares.items() if share}
    ids, first = np.unique(samples["grasp_id"], return_index=True)
    grasps: dict[str, NDArray] = {"grasp_id": ids}
    theta = {"theta_names": list(Theta(hand).names)} if "theta" in rows else {}
    if theta:
        grasps |= _theta_of_grasps(rows["theta"], ids, first, samples["grasp_id"])
    content = _shard({"samples": samples, "grasps": grasps})
    sha256 = hashlib.sha256(content).hexdigest()
    shard = {"file": SHARD, "n_grasps": len(ids), "n_samples": n, "sha256": sha256}
    manifest = {
        "schema_version": SCHEMA_VERSION,
        ORIGIN: MEASURED,
        "config_sha256": hashlib.sha256(f"{MEASURED} {hand.sha256} {sha256}".encode()).hexdigest(),
        "shards": [shard],
        "n_samples": n,
        "n_grasps": len(ids),
        "tool_families": [],
        "hand": hand.as_dict(),
        FALLBACKS: list(fallbacks),
        KNOWN_SHARES: shares,
        **theta,
    }
    manifest = sealed(manifest)
    with locked_folder(out):
        _refuse_another(out, manifest, content)
        write_atomically(out / SHARD, content)
        write_json(out / "manifest.json", manifest)
    return manifest


def _theta_of_grasps(theta: NDArray, ids: NDArray, first: NDArray, grasp: NDArray) -> dict[str, NDArray]:
    """theta (g, P) and number of its hand (g) of each grasp. Raises AminnError where it changes within one."""
    own = theta[first]
    changed = (theta != own[np.searchsorted(ids, grasp)]).any(1)
    if changed.any():
        raise AminnError(f"theta changes within grasp {grasp[np.argmax(changed)]}: a grasp is of one hand")
    _, at, back = np.unique(own, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(at))  # in the order in which hands come
    return {"theta": own.astype(np.float64), "hand_id": rank[back.ravel()].astype(np.int64)}


def _shard(groups: Mapping[str, Mapping[str, NDArray]]) -> bytes:
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("earliest", "v110")) as file:
        for group, fields in groups.items():
            for name in sorted(fields):
                file.create_dataset(f"{group}/{name}", data=fields[name], track_times=False)
    return image.getvalue()


def _refuse_another(out: Path, manifest: dict, content: bytes) -> None:
    """Raises AminnError where the folder holds another data set than the one of this shard, finished or not."""
    files = [p.name for p in (*out.glob("manifest.json"), *out.glob("shard-*.h5"), *out.glob("unfinished.json"))]
    if files and "manifest.json" in files and read_manifest(out)["config_sha256"] == manifest["config_sha256"]:
        return
    if files == [SHARD] and (out / SHARD).read_bytes() == content:  # an import that was cut off
        return
    if files:
        raise AminnError(f"{out}: holds another data set ({files[0]}); remove it, or choose another folder")


def mean_forces(model: Aminn | Mlp) -> list[float] | None:
    """Mean normal force of each branch's contacts (B), N, in the data that a model was trained on; None of a model that
    has no such constant."""
    if not isinstance(model, Aminn):
        return None
    backbone = model.stage1.backbone
    means = backbone.contact_norm.mean.double().numpy().reshape(backbone.dims.branches, -1)
    return (means[:, N_CONTACT_FEATURE - 1] / np.maximum(means[:, 0], 1e-6)).tolist()
