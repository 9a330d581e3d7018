"""The engines: the same bytes from threads and from a Ray cluster, and errors that name the shard."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from small_data import SMALL, begin, command_line

from aminn_app.cli import simulate as command
from aminn_sim import SimulationConfig, SimulationError, _core, engines, simulate
from aminn_sim.build import simulator_build
from aminn_sim.engines import ENGINES, ShardTask
from aminn_sim.open_hand import open_hand
from aminn_sim.simulate import UNFINISHED, shard_name
from aminn_sim.vary import draw_theta

open_simulator = open_hand().simulator
ray = pytest.importorskip("ray", reason="the extra ray is not installed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """Two workers on this machine."""
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield
    ray.shutdown()


def files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_ray_gives_the_bytes_of_threads(cluster: None, dataset_dir: Path, tmp_path: Path) -> None:
    simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False, engine="ray")
    assert files(tmp_path / "data") == files(dataset_dir)


def test_ray_simulates_the_hands_of_threads(cluster: None, tmp_path: Path) -> None:
    config = SimulationConfig(**SMALL | {"vary_mechanics": 0.5, "grasps_per_hand": 5})
    for engine in ENGINES:
        simulate(config, tmp_path / engine, progress=False, engine=engine)
    assert files(tmp_path / "ray") == files(tmp_path / "threads")


def test_ray_goes_on_with_what_threads_began(cluster: None, dataset_dir: Path, tmp_path: Path) -> None:
    began = begin(dataset_dir, tmp_path / "data") / shard_name(0)
    time_before = began.stat().st_mtime_ns
    simulate(SimulationConfig(**SMALL), began.parent, progress=False, engine="ray")
    assert files(began.parent) == files(dataset_dir) and began.stat().st_mtime_ns == time_before


def tasks(opener: object, count: int = 3) -> list[ShardTask]:
    config = SimulationConfig(**SMALL)
    return [ShardTask(config, n, 1, opener) for n in range(count)]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_shard_that_cannot_be_made_is_named(cluster: None, engine: str) -> None:
    config = SimulationConfig(**SMALL | {"grasp_attempts": 1, "contact_force_min_N": 1e6})
    impossible = [ShardTask(config, 5, 1, open_simulator)]
    with pytest.raises(SimulationError, match=r"^shard 5: grasp .*none of 1 attempts"):
        list(ENGINES[engine](impossible, 1, lambda done: None))


@pytest.mark.parametrize("engine", ENGINES)
def test_an_error_of_the_worker_is_passed_on(cluster: None, engine: str) -> None:
    def opener() -> _core.Simulator:  # local, so that Ray sends its code and not its name
        raise SimulationError("node7 has another version")

    with pytest.raises(SimulationError, match="node7 has another version"):
        list(ENGINES[engine](tasks(opener), 1, lambda done: None))


def test_many_threads_share_the_cases_of_few_grasps() -> None:
    """Threads that have no grasp left take cases of those that others are at; the arrays are the same."""
    config = SimulationConfig(**SMALL | {"vary_mechanics": 0.5, "cases": 12})
    theta = draw_theta(config, open_hand().hand, range(2))
    shards = [ShardTask(config, n, 1, open_simulator, theta[n : n + 1]) for n in range(2)]
    alone, shared = (list(engines.on_threads(shards, threads, lambda done: None)) for threads in (1, 7))
    for (task, one), (same_task, many) in zip(alone, shared, strict=True):
        assert task is same_task and one["steps"] == many["steps"]
        for group in ("samples", "grasps", "noise"):
            assert one[group].keys() == many[group].keys()
            for name, values in one[group].items():
                assert values.tobytes() == many[group][name].tobytes(), (group, name)


def test_shards_before_one_that_fails_are_kept() -> None:
    """However far ahead the threads are, each shard before comes out whole, and the error names the one that failed."""
    config = SimulationConfig(**SMALL | {"grasp_attempts": 4, "cases": 1})
    six, kept = [ShardTask(config, n, 1, open_simulator) for n in range(6)], []
    with pytest.raises(SimulationError, match=r"^shard \d: grasp .*none of 4 attempts") as error:
        for task, result in engines.on_threads(six, 4, lambda done: None):
            kept.append(task.number)
            alone = engines.simulate_task(task, open_simulator(), 1, lambda done: None)
            assert result["samples"]["dx_ht"].tobytes() == alone["samples"]["dx_ht"].tobytes()
    assert kept and kept == list(range(int(str(error.value)[len("shard ")])))


def test_a_worker_that_dies_is_told(cluster: None) -> None:
    def die() -> _core.Simulator:
        os._exit(3)

    with pytest.raises(SimulationError, match=r"^shard 0: .*(died|crashed)"):
        list(engines.on_ray(tasks(die, 1), 1, lambda done: None))


def test_another_version_on_a_worker_is_refused(dataset_dir: Path, tmp_path: Path, monkeypatch) -> None:
    """The digest that a task carries is compared where the shard is made."""
    from aminn_sim.simulate import _open_simulator

    with pytest.raises(SimulationError, match="another version of the simulation"):
        _open_simulator(SimulationConfig(**SMALL), "0" * 64, simulator_build(), None)


def test_progress_counts_the_cases_of_all_shards(cluster: None) -> None:
    config = SimulationConfig(**SMALL)
    two = [ShardTask(config, n, 1, open_simulator) for n in range(2)]
    for engine in ENGINES.values():
        seen: list[int] = []
        assert {task.number for task, _ in engine(two, 1, seen.append)} == {0, 1}
        assert seen == sorted(seen) and seen[-1] == 2 * SMALL["cases"]


def test_a_caller_that_stops_early_leaves_no_task_behind(cluster: None) -> None:
    config = replace(SimulationConfig(**SMALL), cases=2000)
    run = engines.on_ray(
        [ShardTask(SimulationConfig(**SMALL), 0, 1, open_simulator)]
        + [ShardTask(config, n, 4, open_simulator) for n in range(1, 6)],
        1,
        lambda done: None,
    )
    next(run)
    run.close()
    deadline = time.monotonic() + 30
    while ray.available_resources().get("CPU", 0) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert ray.available_resources().get("CPU", 0) == 2


def test_interrupted_ray_simulation_goes_on(dataset_dir: Path, tmp_path: Path) -> None:
    """Ctrl-C with a cluster of one's own: message, whole shards only, and the second run ends with the same bytes."""
    folder, log = tmp_path / "data", tmp_path / "log"
    words = [*"-m aminn_app.cli simulate --engine ray --threads 2 --grasps 400".split(), "--out", str(folder)]
    words += command_line({k: v for k, v in SMALL.items() if k != "grasps"})
    starter = "import signal, runpy, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    starter += "sys.argv = sys.argv[1:]; runpy.run_module('aminn_app.cli', run_name='__main__')"
    with log.open("w") as stderr:
        process = subprocess.Popen([sys.executable, "-c", starter, *words[1:]], stderr=stderr, start_new_session=True)
        deadline = time.monotonic() + 90
        while not list(folder.glob("*.h5")) and time.monotonic() < deadline:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the whole group
        assert process.wait(timeout=60) == 130
    assert "interrupted; the same command continues" in log.read_text() and "Traceback" not in log.read_text()
    names = sorted(p.name for p in folder.iterdir() if p.name != UNFINISHED)
    assert names and all(n.endswith(".h5") for n in names) and len(names) < 100
    for name in {shard_name(0)} & set(names):
        assert (folder / name).read_bytes() == (dataset_dir / name).read_bytes()


def test_missing_package_is_named(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SimulationError, match=r"ray cannot be imported.*pip install 'aminn\[ray\]'"):
        simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False, engine="ray")
    assert not (tmp_path / "data").exists()


def test_a_cluster_that_does_not_come_up_is_named(tmp_path: Path, monkeypatch) -> None:
    def init(**_: object) -> None:
        assert os.environ["RAY_prestart_worker_first_driver"] == "0"
        raise Exception("the node timed out")  # as Ray does

    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", init)
    with pytest.raises(SimulationError, match=r"a cluster on this machine cannot be used \(the node timed out\)"):
        simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False, engine="ray")


def test_unknown_engine_is_named(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="engine is 'spark', expected one of threads, ray"):
        simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False, engine="spark")


def test_cluster_out_of_reach_is_named(tmp_path: Path) -> None:
    arguments = [sys.executable, "-m", "aminn_app.cli", "simulate", "--engine", "ray", "--out", str(tmp_path / "data")]
    result = subprocess.run(
        arguments, env=os.environ | {"RAY_ADDRESS": "127.0.0.1:1"}, capture_output=True, text=True, timeout=120
    )
    assert result.returncode == 1 and "RAY_ADDRESS=127.0.0.1:1 cannot be used" in result.stderr, result.stderr


def test_command_line_offers_every_engine() -> None:
    option = next(p for p in command.params if p.name == "engine")
    assert list(option.type.choices) == list(ENGINES)
    assert "ray" in CliRunner().invoke(command, ["--help"]).output
