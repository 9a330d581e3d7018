"""A byte stream to a board: a serial port, a pseudo-terminal, or a socket of an emulator. What goes wrong is named."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import socket
import stat
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from aminn_base.errors import AminnError

BAUD, BAUD_NAME = termios.B115200, "115200 baud, 8N1"
WRITE_TIMEOUT_S = 5.0
_KINDS = {
    stat.S_IFREG: "a regular file",
    stat.S_IFDIR: "a folder",
    stat.S_IFBLK: "a block device",
    stat.S_IFIFO: "a pipe, which carries one direction only",
}


class Line:
    """An open descriptor that is read and written with a deadline."""

    def __init__(self, descriptor: int, name: str) -> None:
        self.descriptor, self.name = descriptor, name
        os.set_blocking(descriptor, False)

    def now(self) -> float:
        """The clock of the deadlines, s."""
        return time.monotonic()

    def write(self, data: bytes) -> None:
        """Send all of it. Raises AminnError if the line is gone or takes nothing for WRITE_TIMEOUT_S."""
        while data:
            _, ready, _ = select.select([], [self.descriptor], [], WRITE_TIMEOUT_S)
            if not ready:
                raise AminnError(
                    f"{self.name}: takes no byte for {WRITE_TIMEOUT_S:g} s: nobody reads at the other end, or flow "
                    f"control holds it; {BAUD_NAME}, without flow control"
                )
            try:
                data = data[os.write(self.descriptor, data) :]
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._gone(error.strerror) from error

    def read(self, deadline: float) -> bytes:
        """The bytes that have come, at least one; none at the deadline. Raises AminnError if the line is gone."""
        while True:
            ready, _, _ = select.select([self.descriptor], [], [], max(0.0, deadline - self.now()))
            if not ready:
                return b""
            try:
                data = os.read(self.descriptor, 4096)
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._gone(error.strerror) from error
            if not data:
                raise self._gone("end of the stream")
            return data

    def _gone(self, why: str | None) -> AminnError:
        return AminnError(f"{self.name}: unplugged, or closed at the other end ({why}); plug it in and start again")

    def others(self) -> str:
        """Who else has the port open, as far as this machine tells; else empty."""
        return _others(self.name)


def _others(name: str) -> str:
    found = []
    device = os.path.realpath(name)
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        with suppress(OSError):  # it has ended, or is another user's
            if any(os.path.realpath(link) == device for link in (process / "fd").iterdir()):
                found.append(f"{(process / 'comm').read_text(errors='replace').strip()} (process {process.name})")
    return ", ".join(found)


@contextmanager
def open_port(port: str) -> Iterator[Line]:
    """A serial port by its path (115200 baud, 8N1, raw, alone), a Unix socket by its path, or "tcp:HOST:PORT".

    Raises AminnError, before anything is opened, if the path is a file, a folder or a pipe; if the port is in use.
    """
    if port.startswith("tcp:"):
        with _connected(port, *_tcp(port)) as connection:
            yield Line(connection.fileno(), port)
        return
    try:
        status = os.stat(port)
    except (OSError, ValueError) as error:
        raise AminnError(f"{port}: cannot open: {getattr(error, 'strerror', error)}") from error
    kind = stat.S_IFMT(status.st_mode)
    if kind == stat.S_IFSOCK:
        with _connected(port, socket.AF_UNIX, port) as connection:
            yield Line(connection.fileno(), port)
        return
    if kind != stat.S_IFCHR:
        raise AminnError(
            f"{port}: {_KINDS.get(kind, 'not a device')}; expected a serial port, a socket or tcp:HOST:PORT"
        )
    if status.st_rdev in _own_terminals():
        raise AminnError(f"{port}: the terminal that this command runs in; expected the board's port")
    with _opened_terminal(port) as descriptor:
        yield Line(descriptor, port)


def _own_terminals() -> set[int]:
    own = {os.makedev(5, 0)}  # /dev/tty
    for descriptor in (0, 1, 2):
        with suppress(OSError):
            if os.isatty(descriptor):
                own.add(os.fstat(descriptor).st_rdev)
    return own


def _tcp(port: str) -> tuple[int, tuple[str, int]]:
    host, _, number = port[4:].rpartition(":")
    if not number.isdecimal() or not 0 < int(number) < 65536:
        raise AminnError(f"{port}: {number!r} is no port number; expected tcp:HOST:PORT")
    return 0, (host.strip("[]") or "localhost", int(number))


@contextmanager
def _connected(port: str, family: int, address: tuple[str, int] | str) -> Iterator[socket.socket]:
    connection = None
    try:
        if isinstance(address, tuple):
            connection = socket.create_connection(address, WRITE_TIMEOUT_S)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            connection = socket.socket(family)
            connection.settimeout(WRITE_TIMEOUT_S)
            connection.connect(address)
    except (OSError, UnicodeError) as error:
        if connection is not None:
            connection.close()
        why = getattr(error, "strerror", None) or error
        raise AminnError(f"{port}: cannot connect ({why}); is the board or emulator running?") from error
    with connection:
        yield connection


@contextmanager
def _opened_terminal(port: str) -> Iterator[int]:
    try:
        descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        busy = f" by {_others(port) or 'another program'}; close it there" if error.errno == errno.EBUSY else ""
        raise AminnError(f"{port}: cannot open: {error.strerror}{busy}") from error
    try:
        if not os.isatty(descriptor):
            raise AminnError(f"{port}: a device, but no serial port")
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = _others(port) or "another program"
            raise AminnError(f"{port}: in use by {holder}; close it there, then repeat the command") from error
        mode = _make_raw(descriptor, port)
        fcntl.ioctl(descriptor, termios.TIOCEXCL)
        try:
            yield descriptor
        finally:
            with suppress(OSError, termios.error):  # an unplugged port
                termios.tcflush(descriptor, termios.TCIOFLUSH)
                termios.tcsetattr(descriptor, termios.TCSANOW, mode)
                fcntl.ioctl(descriptor, termios.TIOCNXCL)
    finally:
        os.close(descriptor)


def _make_raw(descriptor: int, port: str) -> list:
    """Set the port up; returns how it was before."""
    try:
        before = termios.tcgetattr(descriptor)
        mode = [0, 0, termios.CS8 | termios.CREAD | termios.CLOCAL, 0, BAUD, BAUD, before[6]]
        termios.tcsetattr(descriptor, termios.TCSANOW, mode)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
        if termios.tcgetattr(descriptor)[4] != BAUD:
            raise AminnError(f"{port}: does not offer {BAUD_NAME}")
    except termios.error as error:
        raise AminnError(f"{port}: cannot be set to {BAUD_NAME} ({error.args[-1]})") from error
    return before
