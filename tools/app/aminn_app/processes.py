"""Trainings side by side, each in a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from aminn.data.dataset import Dataset, load_dataset
from aminn_base.progress import be_quiet, is_quiet

K = TypeVar("K")
T = TypeVar("T")


@cache
def data_of(folder: Path) -> Dataset:
    """The data set in a folder, read once a process."""
    return load_dataset(folder)


def workers_for(calls: int, wanted: int | None) -> int:
    """How many processes are worth while."""
    return min(calls, wanted or len(os.sched_getaffinity(0)))


def side_by_side(
    work: Callable[..., T], calls: Mapping[K, tuple[Any, ...]], workers: int
) -> Generator[tuple[K, T], None, None]:
    """(key, what `work` returned of the key's arguments), as they end. Close it, and nothing more is done.

    Ctrl-C, and an error of one call, end the processes at once: what they write is whole or absent.
    """
    context, others = multiprocessing.get_context("spawn"), set(multiprocessing.active_children())
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(is_quiet(),)) as pool:
        try:
            futures = {pool.submit(work, *args): key for key, args in calls.items()}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def _begin(quiet: bool) -> None:
    """In a new process: Ctrl-C is for the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    be_quiet(quiet)
