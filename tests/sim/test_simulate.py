"""Shards, manifest, resuming: what is on disk after a simulation, and after one that was cut off."""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from small_data import SMALL, begin

from aminn_base.errors import AminnError, InUseError
from aminn_base.lock import NAME as LOCK
from aminn_hand import Hand
from aminn_sim import SimulationConfig, SimulationError, _core, simulate
from aminn_sim.open_hand import default_hand_file, open_hand
from aminn_sim.read import read_data
from aminn_sim.schema import groups_of
from aminn_sim.simulate import UNFINISHED, shard_name
from aminn_sim.understand import understand

Figures = dict[str, float | int | str | bool]


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of every file of a folder."""
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


@pytest.mark.parametrize("threads", [1, 3])
def test_bytes_do_not_depend_on_the_number_of_threads(dataset_dir: Path, tmp_path: Path, threads: int) -> None:
    simulate(SimulationConfig(**SMALL), tmp_path / "data", threads=threads, progress=False)
    assert contents(tmp_path / "data") == contents(dataset_dir)


def test_a_shard_does_not_depend_on_the_others(dataset_dir: Path, tmp_path: Path) -> None:
    longer = SimulationConfig(**SMALL | {"grasps": 8})
    shutil.copytree(dataset_dir, tmp_path / "data")
    simulate(longer, tmp_path / "data", threads=2, progress=False)
    first = shard_name(0)
    assert (tmp_path / "data" / first).read_bytes() == (dataset_dir / first).read_bytes()
    with h5py.File(dataset_dir / shard_name(1)) as short, h5py.File(tmp_path / "data" / shard_name(1)) as full:
        n = len(short["samples/w_e"])
        assert n == 2 * SMALL["cases"] and len(full["samples/w_e"]) == 4 * SMALL["cases"]
        for name in groups_of(open_hand().hand)["samples"]:
            np.testing.assert_array_equal(full["samples"][name][:n], short["samples"][name])


def test_other_seeds_give_other_grasps(dataset_dir: Path, tmp_path: Path) -> None:
    simulate(SimulationConfig(**SMALL | {"seed": 8}), tmp_path / "data", threads=2, progress=False)
    ours, theirs = read_data(dataset_dir).samples, read_data(tmp_path / "data").samples
    assert (np.abs(ours["q"] - theirs["q"]).max(1) > 0).all()


def test_manifest_describes_the_shards(dataset_dir: Path) -> None:
    data = read_data(dataset_dir)
    manifest, samples, grasps = data.manifest, data.samples, data.grasps
    assert manifest["schema_version"] == 4 and manifest["simulator"].startswith("MuJoCo 2.2")
    assert manifest["n_samples"] == len(samples["stable"]) == SMALL["grasps"] * SMALL["cases"]
    assert manifest["n_grasps"] == len(grasps["grasp_id"]) == SMALL["grasps"]
    assert manifest["config"]["seed"] == manifest["seed"] == SMALL["seed"]
    for shard in manifest["shards"]:
        assert hashlib.sha256((dataset_dir / shard["file"]).read_bytes()).hexdigest() == shard["sha256"]
    text = (dataset_dir / "manifest.json").read_text()
    assert text == json.dumps(json.loads(text), sort_keys=True, indent=1) + "\n"
    groups = groups_of(data.hand)
    others = {f"{g}/{n}" for g in ("grasps", "noise") for n in groups[g]}
    assert set(manifest["fields"]) == set(groups["samples"]) | others
    assert Hand.from_dict(manifest["hand"]) == understand(default_hand_file()).hand


def test_samples_are_finite_and_consistent(dataset_dir: Path) -> None:
    data = read_data(dataset_dir)
    manifest, samples, grasps = data.manifest, data.samples, data.grasps
    for name, field in groups_of(data.hand)["samples"].items():
        assert samples[name].shape[1:] == field.shape and np.isfinite(samples[name]).all(), name
    assert (samples["stable"] == (samples["reason"] == 0)).all()
    stable = samples["stable"] == 1
    assert samples["settled"][stable].all() and not samples["contact_lost"][stable].any()
    assert (samples["max_translation_m"][stable] <= manifest["bounds"]["translation_max_m"]).all()
    assert (np.linalg.norm(samples["dx_ht"][:, :3], axis=1) <= samples["max_translation_m"] + 1e-6).all()
    assert (samples["contacts"][:, :, 0] == 1).all() and (samples["contacts"][:, :, 7] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(samples["contacts"][:, :, 4:7], axis=2), 1, atol=1e-9)
    r = samples["contacts"][:, :, 1:4] - samples["x_ht"][:, None, :3]
    turn = np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(samples["j_x"][..., 3:] @ turn, np.cross(turn, r), atol=1e-12)
    assert (samples["j_q"][:, 2, :, 0] == 0).all()  # the thumb has no roll
    assert (grasps["tendon_tension_N"] >= 0).all() and (samples["tendon_tension_after_N"] >= 0).all()


def test_grasp_ids_are_unique_and_consecutive(dataset_dir: Path) -> None:
    data = read_data(dataset_dir)
    samples, grasps = data.samples, data.grasps
    assert grasps["grasp_id"].tolist() == list(range(SMALL["grasps"]))
    assert np.bincount(samples["grasp_id"]).tolist() == [SMALL["cases"]] * SMALL["grasps"]
    for i in range(1, SMALL["grasps"]):  # cases of one grasp share its state, grasps differ
        assert (samples["q"][i * SMALL["cases"] - 1] != samples["q"][i * SMALL["cases"]]).any()


def test_interrupted_simulation_goes_on(tmp_path: Path, dataset_dir: Path) -> None:
    """Ctrl-C after the first shard: no half-written file, exit, and the second run ends with the same bytes."""
    code = (
        "import signal, sys; from aminn_sim import SimulationConfig, simulate\n"
        # a background job of a shell inherits an ignored SIGINT
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"simulate(SimulationConfig(**{SMALL | {'grasps': 60}!r}), sys.argv[1], threads=2, progress=False)"
    )
    folder = tmp_path / "data"
    process = subprocess.Popen([sys.executable, "-c", code, str(folder)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (folder / shard_name(0)).exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode != 0 and "KeyboardInterrupt" in errors
    names = sorted(p.name for p in folder.iterdir() if p.name != UNFINISHED)
    assert names and all(n.endswith(".h5") for n in names) and len(names) < 15
    before = (folder / shard_name(0)).stat().st_mtime_ns
    simulate(SimulationConfig(**SMALL | {"grasps": 4 * len(names) + 2}), folder, threads=2, progress=False)
    assert (folder / shard_name(0)).stat().st_mtime_ns == before
    assert (folder / shard_name(0)).read_bytes() == (dataset_dir / shard_name(0)).read_bytes()


def test_repeated_simulation_changes_nothing(dataset_dir: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset_dir, tmp_path / "data")
    times = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "data").glob("*.h5")}
    simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False)
    assert contents(tmp_path / "data") == contents(dataset_dir)
    assert times == {p.name: p.stat().st_mtime_ns for p in (tmp_path / "data").glob("*.h5")}


def test_progress_may_stop_the_workers(simulator: _core.Simulator) -> None:
    def stop(done: int) -> None:
        raise InterruptedError("enough")

    start = time.monotonic()
    with pytest.raises(InterruptedError, match="enough"):
        simulator.shard(SimulationConfig().options(), 0, 0, 0, 200, 16, 2, [0, 1, 2], stop)
    assert time.monotonic() - start < 5


def test_folder_of_another_configuration_is_refused(dataset_dir: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset_dir, tmp_path / "data")
    with pytest.raises(SimulationError, match=rf"another configuration \(cases {SMALL['cases']} instead of 5\)"):
        simulate(SimulationConfig(**SMALL | {"cases": 5}), tmp_path / "data", progress=False)
    assert contents(tmp_path / "data") == contents(dataset_dir)


def test_fewer_grasps_than_there_are_is_refused(dataset_dir: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset_dir, tmp_path / "data")
    with pytest.raises(SimulationError, match=r"shard-00001\.h5: not of the 1 shards that 3 grasps make"):
        simulate(SimulationConfig(**SMALL | {"grasps": 3}), tmp_path / "data", progress=False)
    with pytest.raises(SimulationError, match=r"shard-00001\.h5: holds 2 grasps, but 5 grasps in all leave 1 for it"):
        simulate(SimulationConfig(**SMALL | {"grasps": 5}), tmp_path / "data", progress=False)
    assert contents(tmp_path / "data") == contents(dataset_dir)


def test_damaged_shard_is_named(dataset_dir: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset_dir, tmp_path / "data")
    shard = tmp_path / "data" / shard_name(1)
    shard.write_bytes(shard.read_bytes()[:500])
    with pytest.raises(SimulationError, match=r"shard-00001.h5: not a readable shard.*delete it"):
        simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False)


def test_changed_byte_in_a_finished_data_set_is_named(dataset_dir: Path, tmp_path: Path) -> None:
    """HDF5 may read such a shard all the same; the manifest's hash tells, and is not renewed."""
    copy = Path(shutil.copytree(dataset_dir, tmp_path / "copy"))
    shard, manifest = copy / shard_name(0), (copy / "manifest.json").read_bytes()
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(SimulationError, match=r"shard-00000.h5: damaged"):
        simulate(SimulationConfig(**SMALL), copy, progress=False)
    assert (copy / "manifest.json").read_bytes() == manifest


def test_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SimulationError, match="cannot be made a data set folder"):
        simulate(SimulationConfig(**SMALL), tmp_path / "file" / "data", progress=False)


def flipped(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)


def test_flipped_bytes_in_an_unfinished_data_set(dataset_dir: Path, tmp_path: Path, trust: Figures) -> None:
    """Wherever the byte lies: the shard is named, nothing is written over it, and its hash is not renewed."""
    folder = begin(dataset_dir, tmp_path / "data")
    shard, size = folder / shard_name(0), (dataset_dir / shard_name(0)).stat().st_size
    before = contents(folder)
    places = [*range(0, 2000, 97), *range(2000, size, size // 40), size - 1]
    for at in places:
        flipped(shard, at)
        damaged = contents(folder)
        with pytest.raises(SimulationError, match=r"shard-00000\.h5: "):
            simulate(SimulationConfig(**SMALL), folder, progress=False)
        assert contents(folder) == damaged
        flipped(shard, at)
    assert contents(folder) == before
    trust["files_flipped_bytes_of_a_shard"] = len(places)
    simulate(SimulationConfig(**SMALL), folder, progress=False)
    assert contents(folder) == contents(dataset_dir)


def test_a_shard_copied_over_another_is_named(dataset_dir: Path, tmp_path: Path) -> None:
    config = SimulationConfig(**SMALL | {"grasps": 8})
    whole = tmp_path / "whole"
    simulate(config, whole, progress=False)
    for folder in (Path(shutil.copytree(whole, tmp_path / "finished")), begin(whole, tmp_path / "unfinished", 2)):
        shutil.copy(folder / shard_name(0), folder / shard_name(1))
        before = contents(folder)
        with pytest.raises(SimulationError, match=r"shard-00001\.h5: is a copy of shard 0"):
            simulate(config, folder, progress=False)
        assert contents(folder) == before


def test_a_shard_without_a_record_is_made_again(dataset_dir: Path, tmp_path: Path) -> None:
    """As one of an earlier version, or one put there by hand: nothing says that it is as it was."""
    folder = begin(dataset_dir, tmp_path / "data")
    (folder / UNFINISHED).unlink()
    flipped(folder / shard_name(0), (folder / shard_name(0)).stat().st_size // 2)
    simulate(SimulationConfig(**SMALL), folder, progress=False)
    assert contents(folder) == contents(dataset_dir)


def test_a_record_that_is_none_is_named(dataset_dir: Path, tmp_path: Path) -> None:
    folder = begin(dataset_dir, tmp_path / "data")
    for text in (b"", b"{}", b"[1]", b'{"shards": [{}]}', b"\xff"):
        (folder / UNFINISHED).write_bytes(text)
        with pytest.raises(SimulationError, match=r"unfinished\.json: not readable .*delete it"):
            simulate(SimulationConfig(**SMALL), folder, progress=False)


def test_shards_beyond_the_last_are_named(dataset_dir: Path, tmp_path: Path) -> None:
    """6 grasps in shards of 2, then 4: the third shard would be nobody's."""
    config = SimulationConfig(**SMALL | {"shard_grasps": 2, "cases": 1})
    simulate(config, tmp_path / "data", progress=False)
    before = contents(tmp_path / "data")
    with pytest.raises(
        SimulationError, match=r"shard-00002\.h5: not of the 2 shards that 4 grasps make, 2 in each; ask"
    ):
        simulate(replace(config, grasps=4), tmp_path / "data", progress=False)
    assert contents(tmp_path / "data") == before


def test_foreign_files_stay_and_own_leftovers_go(dataset_dir: Path, tmp_path: Path) -> None:
    folder = begin(dataset_dir, tmp_path / "data")
    foreign = ["film.partial", ".film.partial", "shard-00001.h5.partial.mine", "notes.txt", "my-shard-00000.h5.partial"]
    own = [".shard-00001.h5.partial", "shard-00001.h5.partial", ".manifest.json.partial", LOCK]
    for name in (*foreign, *own):
        (folder / name).write_text("x")
    simulate(SimulationConfig(**SMALL), folder, progress=False)
    assert sorted(contents(folder)) == sorted([*foreign, *contents(dataset_dir)])


def test_two_simulations_of_one_folder(tmp_path: Path) -> None:
    """The second is told who is there; the first ends as if it had been alone."""
    start = [sys.executable, "-m", "aminn_app.cli", "simulate", "--out", str(tmp_path / "data"), "--cases=2"]
    first = subprocess.Popen([*start, "--grasps=8", "--seed=1"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while not (tmp_path / "data" / LOCK).exists() and first.poll() is None:
        time.sleep(0.005)
    first.send_signal(signal.SIGSTOP)
    second = subprocess.run([*start, "--grasps=8", "--seed=2"], capture_output=True, text=True)
    first.send_signal(signal.SIGCONT)
    assert second.returncode == 1 and f"data: in use by process {first.pid} on " in second.stderr, second.stderr
    assert "simulate --out" in second.stderr and "Traceback" not in second.stderr
    _, errors = first.communicate()
    assert first.returncode == 0, errors
    assert read_data(tmp_path / "data").manifest["seed"] == 1


def test_a_shard_that_somebody_has_open_is_not_called_damaged(dataset_dir: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(dataset_dir, tmp_path / "data"))
    code = "import h5py, sys; f = h5py.File(sys.argv[1], sys.argv[2]); print('open', flush=True); sys.stdin.read()"
    for mode in ("r", "r+"):
        command = [sys.executable, "-c", code, str(folder / shard_name(0)), mode]
        other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert other.stdout is not None and other.stdout.readline() == "open\n"
        try:
            if mode == "r":
                simulate(SimulationConfig(**SMALL), folder, progress=False)
                read_data(folder)
                continue
            with pytest.raises(InUseError, match=f"shard-00000.h5: open for writing in process {other.pid} .*close it"):
                simulate(SimulationConfig(**SMALL), folder, progress=False)
            with pytest.raises(InUseError, match="open for writing"):
                read_data(folder)
        finally:
            other.communicate("")


def test_a_report_over_the_data_set_is_refused(dataset_dir: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(dataset_dir, tmp_path / "data"))
    for name in ("manifest.json", shard_name(0)):
        with pytest.raises(AminnError, match="which this command needs itself"):
            simulate(SimulationConfig(**SMALL | {"grasps": 8}), folder, progress=False, report=folder / name)
    with pytest.raises(AminnError, match="which this command needs itself"):
        simulate(SimulationConfig(**SMALL), folder, progress=False, report=default_hand_file())
    assert contents(folder) == contents(dataset_dir)
