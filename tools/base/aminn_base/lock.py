"""Who works where: a lock of a folder that names its holder and ends with it, and files that others have open."""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import InUseError, WriteError
from .files import NO_LOCKS, make_folder, open_locked

NAME = ".aminn-lock"


@contextmanager
def locked_folder(folder: Path, file: Path | None = None) -> Iterator[None]:
    """Keep every other process that asks for it out of `folder` meanwhile.

    The lock is flock's on `file`, else on NAME in the folder, which is made where it is not there. It ends with the
    process: what a killed one leaves is a file that blocks nobody. It holds between machines too where the file system
    passes flock on, as NFS does since version 4; one without locks lets everybody in.

    Raises InUseError, which names the holder, and WriteError where the folder cannot be written to.
    """
    path = file or folder / NAME
    try:
        make_folder(path.parent)
        descriptor = open_locked(path, wait=False)
    except BlockingIOError as error:
        raise InUseError(
            f"{folder}: in use by {_holder(path)}; wait until that has ended, end it, or choose another folder"
        ) from error
    except OSError as error:
        raise WriteError(folder, error.strerror or str(error)) from error
    try:
        os.ftruncate(descriptor, 0)
        with suppress(OSError):  # a full disk: the lock holds without its holder's name
            os.fchmod(descriptor, 0o666)  # whoever may write to the folder may take over what a killed process left
            os.write(descriptor, json.dumps(_this_process()).encode())
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _this_process() -> dict[str, str | int]:
    return {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "since": time.strftime("%Y-%m-%d %H:%M:%S %z"),
    }


def read_shared(path: Path) -> bytes:
    """The content of a file that no other program has locked for writing, as HDF5 does while it has it open.

    Raises InUseError, which names that program where this machine tells, and OSError where the file cannot be read.
    """
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InUseError(
                f"{path}: open for writing in {_writer(os.fstat(file.fileno()).st_ino)}; close it there, then repeat "
                "the command"
            ) from error
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
        return file.read()


def _writer(inode: int) -> str:
    """Who holds flock's exclusive lock on a file, as Linux tells."""
    with suppress(OSError, ValueError):
        for line in Path("/proc/locks").read_text().splitlines():
            _, kind, _, access, pid, place, *_ = line.split()
            if (kind, access) == ("FLOCK", "WRITE") and place.endswith(f":{inode}"):
                words = Path("/proc", pid, "cmdline").read_text().split("\0")
                return f"process {pid} ({shlex.join(words[:-1])})"
    return "another program"


def _holder(path: Path) -> str:
    try:
        holder = json.loads(path.read_text())
        return f"process {holder['pid']} on {holder['host']} since {holder['since']} ({holder['command']})"
    except (OSError, ValueError, KeyError, TypeError):  # it has just begun, or just ended
        return "another process"
