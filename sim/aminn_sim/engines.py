"""Where shards are simulated: threads of this process, or the machines of a Ray cluster.

An engine takes tasks and gives back each finished shard's arrays; the caller alone writes files, so that workers need
no folder in common. Which engine ran cannot be told from a data set: a shard depends on its task alone.
"""

from __future__ import annotations

import importlib
import os
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from . import _core
from .config import SimulationConfig
from .errors import SimulationError

Progress = Callable[[int], None]
"""Told now and then how many load cases of all tasks are done; an exception that it raises stops the engine."""

RAY_OBJECT_STORE_BYTES = 100_000_000  # of a cluster of our own; a shard in flight takes about a megabyte
RAY_KNOCK_S, RAY_CHECK_S = 10.0, 60.0  # for a first answer; for Ray's own check of its cluster
HTTP2_FRAME_HEAD = bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))  # of empty SETTINGS: length (3), type 4, flags, stream (4)
HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + HTTP2_FRAME_HEAD
RAY_STOP_S = 20.0  # a node that does not answer must not keep the program from ending
RAY_TASKS_PER_CPU = 2  # in flight: one that runs and one that waits, so that no worker idles while a shard is written


@dataclass(frozen=True)
class ShardTask:
    """All that a worker needs for one shard."""

    config: SimulationConfig
    number: int
    grasps: int
    open_simulator: Callable[[], _core.Simulator]
    """Makes the simulator where the shard is simulated. Raises SimulationError where that is another one than here."""
    theta: NDArray[np.float64] | None = None
    """(grasps, P) mechanics parameters of each grasp's hand; None: as described."""

    @property
    def first_grasp_id(self) -> int:
        """Id of the first grasp of the shard."""
        return self.number * self.config.shard_grasps

    @property
    def cases(self) -> int:
        """Load cases of the shard."""
        return self.grasps * self.config.cases


Finished = Generator[tuple[ShardTask, dict], None, None]
"""Each task with what `Simulator.shard` gave for it, as they are finished; closing it stops the rest."""
Engine = Callable[[Sequence[ShardTask], int, Progress], Finished]
"""Called with tasks, workers and progress."""


def simulate_task(task: ShardTask, simulator: _core.Simulator, threads: int, progress: Progress) -> dict:
    """Arrays of one shard. Raises SimulationError with the shard's number where it cannot be simulated."""
    config = task.config
    with _naming(task):
        return simulator.shard(
            config.options(),
            config.seed,
            task.number,
            task.first_grasp_id,
            task.grasps,
            config.cases,
            threads,
            config.family_indices(),
            progress,
            task.theta,
        )


@contextmanager
def _naming(task: ShardTask) -> Iterator[None]:
    """Make errors of the simulation those of a shard."""
    try:
        yield
    except (RuntimeError, ValueError) as error:
        raise SimulationError(f"shard {task.number}: {error}") from error


def on_threads(tasks: Sequence[ShardTask], threads: int, progress: Progress) -> Finished:
    """The shards in their order, their grasps and load cases shared by `threads` threads of this process.

    The threads go on with the next shards while the caller has one. The tasks are of one configuration.
    """
    if not tasks:
        return
    config, simulator = tasks[0].config, tasks[0].open_simulator()
    threads = min(threads, sum(task.cases for task in tasks))
    waiting, running = deque(tasks), deque[ShardTask]()
    with closing(
        _core.Shards(simulator, config.options(), config.seed, config.cases, config.family_indices(), threads)
    ) as shards:
        while waiting or running:
            # one that is waited for, and of others a grasp for every thread, so that none idles
            while waiting and (len(running) < 2 or sum(task.grasps for task in running) < running[0].grasps + threads):
                task = waiting.popleft()
                with _naming(task):
                    shards.add(task.number, task.first_grasp_id, task.grasps, task.theta)
                running.append(task)
            task = running.popleft()
            with _naming(task):
                result = shards.next(progress)
            yield task, result


def _work(task: ShardTask) -> dict:
    """A shard on one core of a Ray worker."""
    return simulate_task(task, task.open_simulator(), 1, lambda done: None)


def on_ray(tasks: Sequence[ShardTask], threads: int, progress: Progress) -> Finished:
    """One shard a core of the cluster that RAY_ADDRESS names, or of one with `threads` cores started here.

    Shards come back in any order. A worker that dies is replaced by Ray; what a worker raises ends the simulation.
    """
    ray = _import_ray()
    ours = not ray.is_initialized()
    if ours:
        _connect(ray, threads)
    # A node that is lost costs its shards a new start, an error of a worker would only come again.
    remote = ray.remote(num_cpus=1, max_retries=3, retry_exceptions=False)(_work)
    waiting, done = list(reversed(tasks)), 0
    running: dict[object, ShardTask] = {}
    try:
        while waiting or running:
            most = RAY_TASKS_PER_CPU * max(1, int(ray.cluster_resources().get("CPU", 1)))
            while waiting and len(running) < most:
                task = waiting.pop()
                running[remote.remote(task)] = task
            finished, _ = ray.wait(list(running), num_returns=1, timeout=1.0)
            for reference in finished:
                task = running.pop(reference)
                result = _fetch(ray, reference, task)
                done += task.cases
                progress(done)
                yield task, result
    finally:
        if ours:
            ray.shutdown()  # with its tasks; a task that ends while it is cancelled would abort the program
        else:
            _stop(ray, list(running))


def _stop(ray: ModuleType, references: list) -> None:
    """Cancel tasks until each has ended: Ray loses the request for a task that is just moving to its worker."""
    deadline = time.monotonic() + RAY_STOP_S
    while references and time.monotonic() < deadline:
        for reference in references:
            ray.cancel(reference, force=True)  # also a worker that inherited an ignored SIGINT
        _, references = ray.wait(references, num_returns=len(references), timeout=0.5)


def _import_ray() -> ModuleType:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a simulation sends nothing anywhere
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise SimulationError(
            f"engine ray: the package ray cannot be imported ({error}); install it (pip install 'aminn[ray]'), or use "
            "the engine threads"
        ) from error


def _connect(ray: ModuleType, threads: int) -> None:
    quiet = {"log_to_driver": False, "logging_level": "ERROR"}
    local = {"num_cpus": threads, "include_dashboard": False, "object_store_memory": RAY_OBJECT_STORE_BYTES}
    address = os.environ.get("RAY_ADDRESS")
    # Without workers that start before they are asked for: Ray 2.60 can wait for one without end, deaf to Ctrl-C.
    os.environ.setdefault("RAY_prestart_worker_first_driver", "0")
    try:
        if address:
            _knock(address)
        ray.init(address=address, **quiet) if address else ray.init(address="local", **quiet, **local)
    except Exception as error:  # a node that does not come up is a plain Exception in Ray
        where = f"the cluster RAY_ADDRESS={address}" if address else "a cluster on this machine"
        raise SimulationError(f"engine ray: {where} cannot be used ({error})") from error


def _knock(address: str) -> None:
    """Raise OSError where no Ray cluster answers at `host:port`: Ray itself would try for minutes, or without end."""
    place = address.removeprefix("ray://")
    host, colon, port = place.rpartition(":")
    if not colon or not port.isdecimal():
        return  # "auto", "local": Ray looks for it on this machine
    with socket.create_connection((host.strip("[]"), int(port)), timeout=RAY_KNOCK_S) as line:
        if os.environ.get("RAY_USE_TLS", "0") == "0":
            _expect_grpc(line)
    if place == address:
        _expect_ray(address)


def _expect_grpc(line: socket.socket) -> None:
    """Ray speaks gRPC, and a gRPC server begins with HTTP/2's SETTINGS."""
    line.sendall(HTTP2_PREFACE)
    head = b""
    try:
        while len(head) < len(HTTP2_FRAME_HEAD) and (more := line.recv(len(HTTP2_FRAME_HEAD) - len(head))):
            head += more
    except TimeoutError as error:
        raise ConnectionError(f"what listens there says nothing for {RAY_KNOCK_S:g} s") from error
    if head[3:5] != HTTP2_FRAME_HEAD[3:5]:
        raise ConnectionError("what listens there does not speak Ray's protocol, gRPC")


def _expect_ray(address: str) -> None:
    """Ask by Ray's own check, in a process that can be ended: the library waits for an answer without end."""
    command = [sys.executable, "-m", "ray.scripts.scripts", "health-check", "--address", address]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=RAY_CHECK_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise ConnectionError(f"what listens there does not answer as Ray within {RAY_CHECK_S:g} s") from error
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines()
        raise ConnectionError(f"`ray health-check` finds no cluster there{': ' + said[-1] if said else ''}")


def _fetch(ray: ModuleType, reference: object, task: ShardTask) -> dict:
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        if isinstance(cause, SimulationError):
            raise SimulationError(str(cause)) from error
        raise SimulationError(f"shard {task.number}: a worker failed: {error}") from error
    except ray.exceptions.RayError as error:
        raise SimulationError(f"shard {task.number}: {error}") from error


ENGINES: dict[str, Engine] = {"threads": on_threads, "ray": on_ray}


def find_engine(name: str) -> Engine:
    """The engine of a name. Raises SimulationError where there is none, or where its package is not installed."""
    if name not in ENGINES:
        raise SimulationError(f"engine is {name!r}, expected one of {', '.join(ENGINES)}")
    if name == "ray":
        _import_ray()
    return ENGINES[name]
