"""Files that are written whole or not at all, and outputs that must not be inputs."""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
import stat
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from .errors import AminnError, WriteError

MAX_LINKS = 40  # as many as Linux follows
NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
"""What flock says on a file system that has no locks."""
NO_SYNC = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
"""What fsync says of a folder where names need none."""


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file: a reader sees the old one or the new one, never half of it, whatever ends program or machine.

    A new file gets the mode that the umask leaves, a file that is there keeps mode and owner. Links are followed: what
    they name is replaced, in its own folder. A device, a FIFO and an open descriptor of this process (/dev/stdout) stay
    what they are and are written into, and so is a file that something is mounted on. Missing folders are made.

    Raises WriteError where the file cannot be written: the old file is untouched then and nothing is left behind. Where
    the disk fails at the very last, as the name is made to last, the new file is there.
    """
    path = Path(path)
    try:
        target = _target(path)
        if isinstance(target, int):
            _write_descriptor(target, content)
        elif _is_replaceable(target):
            _replace(target, content)
        else:
            _write_into(target, content)
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from error


def write_json(path: str | os.PathLike[str], value: dict) -> None:
    """Write a JSON file with sorted keys, as `write_atomically`. A figure that is not finite becomes null."""
    write_atomically(path, (json.dumps(finite(value), indent=1, sort_keys=True, allow_nan=False) + "\n").encode())


def same_place(a: Path, b: Path) -> bool:
    """Whether both paths name one file, by whatever links; or would, where none is there yet."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return os.path.realpath(a) == os.path.realpath(b)


READ: tuple[str, ...] = ("manifest.json", "unfinished.json", "shard-*.h5", "model.json", "*.safetensors")
READ += ("*.onnx", "*.c", "*.h", "*.bin")
"""What the commands read of a data set, of a run and of an export."""


def check_outputs(outputs: Iterable[Path | None], places: Iterable[Path | None]) -> None:
    """Raise AminnError if one of `outputs` is another one, or an input: one of `places`, or in one that is a folder."""
    inputs: list[Path] = []
    for place in filter(None, places):
        inputs += [file for pattern in READ for file in place.glob(pattern)] if place.is_dir() else [place]
    for output in filter(None, outputs):
        refuse_inputs(output, inputs)
        inputs.append(output)


def refuse_inputs(output: Path | None, inputs: Iterable[Path]) -> None:
    """Raise AminnError if writing `output` would overwrite one of `inputs`, files that the command reads or makes."""
    if output is None or (output.exists() and not output.is_file()):
        return
    for file in inputs:
        if same_place(output, file):
            raise AminnError(
                f"{output}: is {file}, which this command needs itself; choose another name for the output"
            )


def open_locked(path: Path, wait: bool) -> int:
    """Descriptor of the file `path`, made where it is not there, with an exclusive lock that ends with the descriptor.

    Raises BlockingIOError where another process holds the lock and `wait` is false. A file system that has no locks
    gives the descriptor all the same.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except OSError as error:
                if error.errno not in NO_LOCKS:
                    raise
            # who held the lock before may have renamed or removed the file
            if _is_file_at(path, descriptor):
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _is_file_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _target(path: Path) -> Path | int:
    """Where `path` leads by its links: a path that is no link, or the number of a descriptor of this process."""
    own = [os.path.realpath(folder) for folder in ("/proc/self/fd", "/proc/thread-self/fd", "/dev/fd")]
    for _ in range(MAX_LINKS):
        folder = os.path.realpath(path.parent)
        path = Path(folder, path.name)
        if folder in own and path.name.isdecimal():
            return int(path.name)
        if not path.is_symlink():
            return path
        path = Path(folder, os.readlink(path))
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))


def _is_replaceable(target: Path) -> bool:
    """Whether `target` is a regular file that may be written, or nothing yet."""
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return True
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if stat.S_ISSOCK(mode):
        raise OSError(errno.ENXIO, "it is a socket")
    if not os.access(target, os.W_OK):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))
    return stat.S_ISREG(mode)


def _replace(target: Path, content: bytes) -> None:
    make_folder(target.parent)
    partial = target.with_name(f".{target.name}.partial")
    descriptor = _open_empty(partial)
    try:
        if target.exists():
            _adopt(descriptor, target.stat())
        _write_all(descriptor, content)
        os.fsync(descriptor)
        try:
            partial.replace(target)
        except OSError as error:
            if error.errno != errno.EBUSY:  # of a file that something is mounted on
                raise
            _write_into(target, content)
            partial.unlink()
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise
    finally:
        os.close(descriptor)
    sync_folder(target.parent)


def _open_empty(partial: Path) -> int:
    """A new file under the lock of `partial`; what a killed program left there is removed."""
    while os.fstat(descriptor := open_locked(partial, wait=True)).st_size:
        partial.unlink()
        os.close(descriptor)
    return descriptor


def _adopt(descriptor: int, old: os.stat_result) -> None:
    """Give the new file owner and mode of the old one, as far as this user may."""
    with suppress(PermissionError):
        os.fchown(descriptor, old.st_uid, old.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(old.st_mode))


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, so that they last: each name is in the folder above."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for place in missing:
        sync_folder(place.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder last, where the file system knows of such a thing. Raises OSError where that fails."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except PermissionError:  # a folder that may be written to, and not read
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise
    finally:
        os.close(descriptor)


def _write_into(target: Path, content: bytes) -> None:
    truncate = os.O_TRUNC if stat.S_ISREG(target.stat().st_mode) else 0
    descriptor = os.open(target, os.O_WRONLY | os.O_NOCTTY | os.O_CLOEXEC | truncate)
    try:
        _write_all(descriptor, content)
    finally:
        os.close(descriptor)


def _write_descriptor(number: int, content: bytes) -> None:
    """Through a copy of the descriptor, behind what the program printed before."""
    if sys.stdout is not None:
        sys.stdout.flush()
    descriptor = os.dup(number)
    try:
        _write_all(descriptor, content)
    finally:
        os.close(descriptor)


def _write_all(descriptor: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def finite(value: object) -> object:
    """The value with null for every float that is not finite."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
