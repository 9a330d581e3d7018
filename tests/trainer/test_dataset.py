"""Reading data: what is wrong is said, and no grasp stands in two splits."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from aminn.data.dataset import SPLITS, Dataset, load_dataset, split_of
from aminn_base.errors import AminnError, InUseError
from aminn_hand import Hand
from aminn_hand.theta import Theta


def test_splits_share_no_grasp_and_cover_all(dataset: Dataset) -> None:
    ids = [set(dataset.split(name).samples["grasp_id"]) for name in SPLITS]
    assert sum(len(dataset.split(name)) for name in SPLITS) == len(dataset)
    assert not (ids[0] & ids[1] or ids[0] & ids[2] or ids[1] & ids[2])
    assert all(ids)


def test_split_does_not_change_when_data_grows() -> None:
    few, many = np.arange(100), np.arange(1000)
    np.testing.assert_array_equal(split_of(few), split_of(many)[:100])
    shares = np.bincount(split_of(many)) / 1000
    np.testing.assert_allclose(shares, [0.70, 0.15, 0.15], atol=0.05)


@pytest.fixture
def copy(data_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(data_dir, tmp_path / "copy"))


def break_manifest(path: Path) -> None:
    (path / "manifest.json").write_text("{")


def other_schema(path: Path) -> None:
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps(manifest | {"schema_version": 99}))


def flip_a_bit(path: Path) -> None:
    shard = path / "shard-00000.h5"
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)


def record_hash(path: Path) -> None:
    """Make the manifest agree with the shard, so that only the later checks can find what is wrong."""
    manifest = json.loads((path / "manifest.json").read_text())
    manifest["shards"][0]["sha256"] = hashlib.sha256((path / "shard-00000.h5").read_bytes()).hexdigest()
    (path / "manifest.json").write_text(json.dumps(manifest))


def truncate_shard(path: Path) -> None:
    shard = path / "shard-00000.h5"
    shard.write_bytes(shard.read_bytes()[:1000])
    record_hash(path)


def put_nan(path: Path) -> None:
    with h5py.File(path / "shard-00000.h5", "r+") as file:
        file["samples/w_e"][3, 2] = np.nan
    record_hash(path)


def drop_field(path: Path) -> None:
    with h5py.File(path / "shard-00000.h5", "r+") as file:
        del file["samples/j_x"]
    record_hash(path)


def drop_noise(path: Path) -> None:
    with h5py.File(path / "shard-00000.h5", "r+") as file:
        del file["noise"]
    record_hash(path)


def change_manifest(path: Path, **changes: object) -> None:
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps(manifest | changes))


def list_a_copy(path: Path) -> None:
    """A shard that was copied over another before its hash was taken."""
    shutil.copy(path / "shard-00000.h5", path / "shard-00001.h5")
    entry = json.loads((path / "manifest.json").read_text())["shards"][0]
    change_manifest(path, shards=[entry, entry | {"file": "shard-00001.h5"}])


def list_twice(path: Path) -> None:
    change_manifest(path, shards=json.loads((path / "manifest.json").read_text())["shards"] * 2)


def name_too_long(path: Path) -> None:
    """For any file system."""
    entry = json.loads((path / "manifest.json").read_text())["shards"][0]
    change_manifest(path, shards=[entry | {"file": "9" * 400}])


def lose_a_grasp(path: Path) -> None:
    with h5py.File(path / "shard-00000.h5", "r+") as file:
        file["samples/grasp_id"][5] = 10_000
    record_hash(path)


def test_fractions_of_a_split_are_nested(dataset: Dataset) -> None:
    ids = [set(dataset.split("train", f).samples["grasp_id"].tolist()) for f in (0.1, 0.3, 1.0)]
    assert ids[0] < ids[1] < ids[2]
    assert ids[2] == set(dataset.split("train").samples["grasp_id"].tolist())


def test_grasp_and_noise_rows_belong_to_their_samples(dataset: Dataset) -> None:
    part = dataset.split("test")
    np.testing.assert_array_equal(part.grasps["grasp_id"][part.grasp_rows()], part.samples["grasp_id"])
    again = part.samples["noise_row"] >= 0
    rows = part.samples["noise_row"][again]
    assert again.any()
    np.testing.assert_allclose(part.noise["dx_half_step"][rows], 0.999 * part.samples["dx_ht"][again])


def varied(path: Path, theta: np.ndarray, names: list[str] | None = None) -> None:
    """Tell a theta of every grasp."""
    with h5py.File(path / "shard-00000.h5", "r+") as file:
        file["grasps/theta"], file["grasps/hand_id"] = theta, np.arange(len(theta)) // 2
    record_hash(path)
    change_manifest(path, theta_names=list(Theta(read_hand(path)).names) if names is None else names)


def read_hand(path: Path) -> Hand:
    return Hand.from_dict(json.loads((path / "manifest.json").read_text())["hand"])


def test_samples_have_the_theta_of_their_grasp(copy: Path) -> None:
    plain = load_dataset(copy)
    assert "theta" not in plain.samples and "theta" not in plain.inputs()
    grasps = len(plain.grasps["grasp_id"])
    theta = np.random.default_rng(0).uniform(-0.5, 0.5, (grasps, len(Theta(plain.hand))))
    varied(copy, theta)
    data = load_dataset(copy)
    np.testing.assert_array_equal(data.samples["theta"], theta[data.samples["grasp_id"]])
    part = data.split("test")
    np.testing.assert_array_equal(part.inputs(torch.float64)["theta"], theta[part.samples["grasp_id"]])


def test_a_theta_that_is_none_is_named(copy: Path, tmp_path: Path) -> None:
    theta = Theta(read_hand(copy))
    n = len(theta)
    whole = np.zeros((120, n))
    for name, values, names, message in (
        ("short", whole[:, 1:], None, rf"/grasps/theta has rows of shape \({n - 1},\), expected \({n},\)"),
        ("names", whole, ["softness"], f"theta_names are not the parameters of its hand, {theta.names[0]}"),
        ("nan", np.where(np.arange(120)[:, None] == 7, np.nan, whole), None, "theta is not finite in sample"),
    ):
        folder = Path(shutil.copytree(copy, tmp_path / name))
        varied(folder, values, names)
        with pytest.raises(AminnError, match=message):
            load_dataset(folder)


def test_a_selection_is_another_data_set(dataset: Dataset) -> None:
    some = dataset.where(np.arange(len(dataset)) < 100, "the first hundred")
    assert len(some) == 100 and some.sha256 != dataset.sha256
    assert some.split("train").sha256 == some.sha256


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda p: (p / "manifest.json").unlink(), "no manifest.json"),
        (break_manifest, "not valid JSON"),
        (lambda p: (p / "manifest.json").write_text("[]"), "not the manifest of a data set"),
        (lambda p: (p / "manifest.json").write_text('{"schema_version": 4}'), "shards, hand, n_samples"),
        (other_schema, "schema_version is 99.*newer AMINN"),
        (flip_a_bit, "damaged"),
        (lambda p: (p / "shard-00000.h5").unlink(), "missing"),
        (truncate_shard, "not a readable shard"),
        (put_nan, "w_e is not finite in sample 3"),
        (drop_field, "/samples/j_x is missing"),
        (drop_noise, "not a readable shard"),
        (lambda p: shutil.copy(p / "shard-00000.h5", p / "shard-00007.h5"), "shard-00007.h5: the manifest does not"),
        (list_a_copy, "shard-00001.h5: holds grasp 0, which shard-00000.h5 holds too"),
        (list_twice, "shard-00000.h5: holds grasp 0, which shard-00000.h5 holds too"),
        (name_too_long, "999: the manifest names this shard, but it is missing"),
        (lose_a_grasp, "samples of grasps that it does not hold"),
        (lambda p: change_manifest(p, n_grasps=3), "n_grasps of the manifest is 3, the shards hold 120"),
        (lambda p: change_manifest(p, n_samples=3), "n_samples of the manifest is 3"),
    ],
)
def test_damaged_data_gives_a_clear_error(copy: Path, damage, message: str) -> None:
    damage(copy)
    with pytest.raises(AminnError, match=message):
        load_dataset(copy)


def test_a_shard_that_is_open_elsewhere_is_not_called_damaged(copy: Path) -> None:
    with (copy / "shard-00000.h5").open("r+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # as HDF5 does
        with pytest.raises(InUseError, match=f"shard-00000.h5: open for writing in process {os.getpid()} "):
            load_dataset(copy)
    load_dataset(copy)
