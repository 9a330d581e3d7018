"""A line to a board without hardware or real time, and what can happen to the bytes on one."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aminn_export.replay import serial_protocol as protocol
from aminn_export.replay.serial_line import Line
from aminn_export.replay.serial_protocol import Identity, frame
from aminn_rt.blob import FORMAT_VERSION as MODEL_FORMAT_VERSION

Disturb = Callable[[bytes], bytes]
Arrivals = Callable[[bytes], list[tuple[float, bytes]]]

WHO = Identity(
    "model", "hand 12345678", "aminn 0.1.0", "0.1.0", "ab" * 32, "cd" * 32, MODEL_FORMAT_VERSION, 0x12345678, 0.5, 0
)


def pack_identity(who: Identity) -> bytes:
    texts = [text.encode() for text in (who.name, who.hand, who.made_by, who.library)]
    sha = bytes.fromhex(who.checkpoint_sha256), bytes.fromhex(who.data_sha256)
    numbers = who.format_version, who.content_crc, who.tau, who.self_test
    return struct.pack("<56s56s44s16s32s32sIIfi", *texts, *sha, *numbers)


def outputs_of(floats: bytes) -> bytes:
    """What the made-up board answers: a status, and numbers that depend on every input."""
    x = np.frombuffer(floats, "<f4")
    y = np.resize(x[:52] + x[-52:] * np.float32(0.5), 52).astype("<f4")
    return struct.pack("<i", int(x[0]) % 7) + y.tobytes()


class Board:
    """The firmware's side of the protocol (runtime/firmware/serial.c)."""

    def __init__(self, version: int = protocol.VERSION, who: Identity = WHO) -> None:
        self.version, self.who, self.bytes, self.questions = version, who, b"", 0

    def hear(self, data: bytes, silence: bool = False) -> bytes:
        """What it says to more bytes, or to a silence within a frame."""
        self.bytes += data
        said = b""
        while (at := self.bytes.find(protocol.QUESTION)) >= 0:
            rest = self.bytes[at + 4 :]
            length = struct.unpack_from("<HHII", rest)[3] if len(rest) >= 12 else 0
            if len(rest) >= 12 and length > 500:
                self.bytes = rest[12:]
                said += self._refuse(0, protocol.DAMAGED)
            elif len(rest) >= 16 + length:
                self.bytes = rest[16 + length :]
                said += self._answer(rest[: 16 + length])
            elif silence:
                self.bytes = b""
                return said + self._refuse(0, protocol.DAMAGED)
            else:
                return said
        self.bytes = self.bytes[-3:]
        return said

    def _refuse(self, sequence: int, reason: int) -> bytes:
        return frame(protocol.ANSWER, protocol.REFUSED, sequence, struct.pack("<I", reason), self.version)

    def _answer(self, content: bytes) -> bytes:
        version, kind, sequence, length = struct.unpack_from("<HHII", content)
        body = content[12 : 12 + length]
        if zlib.crc32(content[: 12 + length]) != int.from_bytes(content[12 + length :], "little"):
            return self._refuse(sequence, protocol.DAMAGED)
        if version != self.version:
            return self._refuse(sequence, protocol.OTHER_VERSION)
        self.questions += 1
        answers = {protocol.IDENTITY: pack_identity, protocol.PREDICT: lambda _: outputs_of(body)}
        if kind not in answers:
            return self._refuse(sequence, protocol.OTHER_KIND)
        return frame(protocol.ANSWER, kind, sequence, answers[kind](self.who), self.version)


class FirstBoard:
    """The firmware of protocol 1: a mark, so many bytes, their CRC-32."""

    bytes = b""

    def hear(self, data: bytes, silence: bool = False) -> bytes:
        self.bytes += data
        at = self.bytes.find(protocol.QUESTION)
        if at < 0 or len(self.bytes) < at + 508:
            return b""
        self.bytes = self.bytes[at + 508 :]
        body = struct.pack("<i", -100) + bytes(188)
        return protocol.ANSWER + body + struct.pack("<I", zlib.crc32(body))


class MadeUpLine(Line):
    """Connects to a `Board`; the first `times` writes and answers are disturbed. Its clock stands but for waiting."""

    def __init__(
        self, board: Board | FirstBoard, to: Disturb = bytes, back: Arrivals | None = None, times: int = 1
    ) -> None:
        self.name, self.board, self.time = "line", board, 0.0
        self._to, self._back, self._left = to, back or (lambda data: [(0.0, data)]), [times, times]
        self._coming: list[tuple[float, bytes]] = []

    def now(self) -> float:
        return self.time

    def others(self) -> str:
        return ""

    def write(self, data: bytes) -> None:
        self._left[0] -= 1
        self._say(self.board.hear(self._to(data) if self._left[0] >= 0 else data))

    def _say(self, data: bytes) -> None:
        if data:
            self._left[1] -= 1
            arrivals = self._back(data) if self._left[1] >= 0 else [(0.0, data)]
            self._coming += [(self.time + late, part) for late, part in arrivals if part]
            self._coming.sort(key=lambda arrival: arrival[0])

    def read(self, deadline: float) -> bytes:
        if not self._coming:
            self._say(self.board.hear(b"", silence=True))
        if not self._coming or self._coming[0][0] > deadline:
            self.time = max(self.time, deadline)
            return b""
        late, data = self._coming.pop(0)
        self.time = max(self.time, late)
        return data


def lost(at: int, n: int = 1) -> Disturb:
    return lambda data: data[:at] + data[at + n :]


def doubled(at: int) -> Disturb:
    return lambda data: data[: at + 1] + data[at:]


def flipped(at: int, bit: int = 0) -> Disturb:
    return lambda data: data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :] if at < len(data) else data


def before(noise: bytes) -> Disturb:
    return lambda data: noise + data


def at_once(disturb: Disturb) -> Arrivals:
    return lambda data: [(0.0, disturb(data))]


def other(**changes: object) -> Identity:
    return replace(WHO, **changes)
