"""Predictions of a real board over a byte stream: a serial port, a pseudo-terminal, or a socket of an emulator.

The protocol (docs/runtime.md) is one question and one answer, all little endian, no handshake:

    host to board   "AMNQ", 125 floats (aminn_input_t), CRC-32 of the floats
    board to host   "AMNA", status code (int32), 46 floats, stable (0 or 1, float), CRC-32 of what follows "AMNA"

A board that reads a damaged question answers with status BAD_FRAME; the host then asks once more. Bytes before a mark
are skipped on both sides, so that either may be restarted at any time.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import termios
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn.dims import INPUT_SHAPES
from aminn_base.errors import AminnError

from .vectors import N_OUT, pack, write_results

QUESTION, ANSWER = b"AMNQ", b"AMNA"
BAD_FRAME = -100
BAUD = termios.B115200
TIMEOUT_S = 5.0
TRIES = 3
_BODY = struct.Struct(f"<i{N_OUT + 1}f")


class Stream:
    """A file descriptor that is read with a deadline."""

    def __init__(self, descriptor: int, name: str) -> None:
        self.descriptor, self.name = descriptor, name

    def write(self, data: bytes) -> None:
        """Send all of it."""
        while data:
            data = data[os.write(self.descriptor, data) :]

    def read(self, n: int, deadline: float) -> bytes:
        """Exactly n bytes; AminnError if they do not come in time."""
        got = b""
        while len(got) < n:
            ready, _, _ = select.select([self.descriptor], [], [], max(0.0, deadline - time.monotonic()))
            part = os.read(self.descriptor, n - len(got)) if ready else b""
            if not part:
                raise AminnError(
                    f"{self.name}: no answer within {TIMEOUT_S:g} s; does the board run the serial firmware?"
                )
            got += part
        return got

    def read_after(self, mark: bytes, n: int) -> bytes:
        """The n bytes behind the next mark."""
        deadline = time.monotonic() + TIMEOUT_S
        window = self.read(len(mark), deadline)
        while window != mark:
            window = window[1:] + self.read(1, deadline)
        return self.read(n, deadline)


@contextmanager
def open_port(port: str) -> Iterator[Stream]:
    """A device or pipe by its path (115200 baud, 8N1, raw), or "tcp:HOST:PORT"."""
    if port.startswith("tcp:"):
        host, _, number = port[4:].rpartition(":")
        try:
            connection = socket.create_connection((host or "localhost", int(number)), TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise AminnError(f"{port}: cannot connect ({error}); expected tcp:HOST:PORT") from error
        with connection:
            connection.settimeout(None)
            yield Stream(connection.fileno(), port)
        return
    try:
        descriptor = os.open(Path(port), os.O_RDWR | os.O_NOCTTY)
    except OSError as error:
        raise AminnError(f"{port}: cannot open: {error.strerror}") from error
    try:
        if os.isatty(descriptor):
            _make_raw(descriptor)
        yield Stream(descriptor, port)
    finally:
        os.close(descriptor)


def _make_raw(descriptor: int) -> None:
    mode = termios.tcgetattr(descriptor)
    mode[0] = mode[1] = mode[3] = 0
    mode[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    mode[4] = mode[5] = BAUD
    termios.tcsetattr(descriptor, termios.TCSAFLUSH, mode)


def ask(stream: Stream, floats: bytes) -> tuple[int, NDArray[np.float32]]:
    """(status, 46 outputs and the decision) for the 125 floats of one input. Raises AminnError on a bad line."""
    frame = QUESTION + floats + struct.pack("<I", zlib.crc32(floats))
    for _ in range(TRIES):
        stream.write(frame)
        answer = stream.read_after(ANSWER, _BODY.size + 4)
        body, crc = answer[: _BODY.size], int.from_bytes(answer[_BODY.size :], "little")
        status = int.from_bytes(body[:4], "little", signed=True)
        if zlib.crc32(body) == crc and status != BAD_FRAME:
            return status, np.frombuffer(body, "<f4", N_OUT + 1, 4)
    raise AminnError(f"{stream.name}: {TRIES} damaged frames in a row; lower the baud rate or check the line")


def replay(stream: Stream, inputs: dict[str, NDArray[np.float32]], out: Path) -> dict[str, float]:
    """Ask for every sample and write a result file; returns the round trip's mean time."""
    rows = pack(inputs, INPUT_SHAPES, "<f4")
    start = time.monotonic()
    answers = [ask(stream, row.tobytes()) for row in rows]
    spent = time.monotonic() - start
    values = np.array([a[1] for a in answers], "<f4").reshape(len(rows), N_OUT + 1)
    write_results(out, values, np.array([a[0] for a in answers], "<i4"))
    return {"round_trip_s": spent / max(len(rows), 1)}
