"""Work in a forked process: it may be killed, run out of memory or hang, and leaves nothing in this one."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE.parent / name) for name in ("trainer", "table", "hand")]
LIBRARY = ROOT / "build" / "faults" / "interpose.so"
MARK = "AMINN_FAULTS"


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    status: int
    """Exit code; negative: the signal that killed it."""
    value: object
    """What the work returned; of one that did not return, the traceback or None."""
    seconds: float


def forked(work: Callable[[], object], limit_s: float = 60.0, memory: int = 0) -> Ended:
    """Do `work` in a process of its own. `memory`: bytes that it may take beyond what it has now; 0: any."""
    reads, writes = os.pipe()
    started = time.monotonic()
    if (child := os.fork()) == 0:
        os.close(reads)
        status, value = 0, None
        try:
            if memory:
                _limit(memory)
            value = work()
        except BaseException:
            status, value = 99, traceback.format_exc()
        try:
            with open(writes, "w", encoding="utf-8") as pipe:
                json.dump(value, pipe)
        finally:
            os._exit(status)
    os.close(writes)
    text, until = b"", started + limit_s
    while True:
        ready, _, _ = select.select([reads], [], [], max(0.0, until - time.monotonic()))
        part = os.read(reads, 1 << 16) if ready else b""
        if not part:
            break
        text += part
    if time.monotonic() >= until:
        os.kill(child, signal.SIGKILL)
    os.close(reads)
    _, status = os.waitpid(child, 0)
    value = json.loads(text) if text else None
    return Ended(os.waitstatus_to_exitcode(status), value, time.monotonic() - started)


def _limit(memory: int) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    now = pages * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + memory, resource.getrlimit(resource.RLIMIT_AS)[1]))


# --- the preloaded library ------------------------------------------------------------------------------------------
def build() -> Path:
    """interpose.so, compiled where it is older than its source."""
    source = HERE / "interpose.c"
    if not LIBRARY.is_file() or LIBRARY.stat().st_mtime < source.stat().st_mtime:
        LIBRARY.parent.mkdir(parents=True, exist_ok=True)
        part = LIBRARY.with_suffix(f".{os.getpid()}")
        flags = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        subprocess.run(["cc", *flags, "-o", str(part), str(source), "-ldl"], check=True)
        part.replace(LIBRARY)
    return LIBRARY


def preloaded() -> None:
    """Begin this program again with the library before the C library, unless it is there."""
    if MARK not in os.environ:
        environment = os.environ | {MARK: "1", "LD_PRELOAD": str(build())}
        os.execve(sys.executable, [sys.executable, *sys.argv], environment)
    del os.environ["LD_PRELOAD"]  # nor any program that is started from here


class Disturber:
    """The library in this process."""

    HALF, KILL = -1, -2

    def __init__(self) -> None:
        self._c = ctypes.CDLL(None)
        self._c.faults_arm.argtypes = [ctypes.c_int64] * 3 + [ctypes.c_int, ctypes.c_char_p]
        self._c.faults_calls.restype = ctypes.c_int64
        self._c.faults_clock.argtypes = [ctypes.c_double]

    def watch(self, folder: Path, record: Path | None = None) -> None:
        """Count the calls that change something in `folder`, and record them."""
        self._c.faults_watch(os.fsencode(folder), None if record is None else os.fsencode(record))

    def arm(self, error: int, first: int = 1, last: int = 1 << 62, step: int = 1, kinds: Sequence[str] = ()) -> None:
        """Let calls fail with an errno, write HALF, or KILL."""
        self._c.faults_arm(first, last, step, error, "".join(kinds).encode())

    def calls(self) -> int:
        """So far."""
        return int(self._c.faults_calls())

    def clock(self, offset_s: float) -> None:
        """Put the time of day forward, or back."""
        self._c.faults_clock(offset_s)
