"""Predictions of a real board over a byte stream (docs/runtime.md has the protocol): questions and answers in frames.

    mark ("AMNQ" to the board, "AMNA" from it), version u16, kind u16, sequence u32, length u32, body, CRC-32

All little endian; the CRC-32 is that of everything between it and the mark. A board repeats the question's sequence, so
that a late answer is not taken for another question's, and refuses what it cannot read. Bytes before a mark are skipped
on both sides, and half a frame is given up after a silence: either may be restarted at any time.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_rt.blob import FORMAT_VERSION

from ..files.bin_model import BinModel, model_crc
from ..files.tables import dims_of
from ..samples.vectors import SENSORS, THETA, pack, shapes_with, write_results
from .serial_line import BAUD_NAME, Line, open_port

__all__ = ["Identity", "ask", "check_identity", "identity_of", "open_port", "replay"]

QUESTION, ANSWER = b"AMNQ", b"AMNA"
VERSION = 3
REFUSED, IDENTITY, PREDICT, SENSE = 0, 1, 2, 3  # kinds
DAMAGED, OTHER_VERSION, OTHER_KIND = 1, 2, 3  # why a question is refused
TIMEOUT_S = 2.0
TRIES = 5
LARGEST_BODY = 512
_HEADER = struct.Struct("<HHII")
_IDENTITY = struct.Struct("<56s56s44s16s32s32sIIfi")
# Protocol 1 had no header: a mark, status and the 47 outputs, their CRC-32. It waits for so many bytes behind a mark.
_FIRST_ANSWER = len(ANSWER) + 4 + 47 * 4 + 4
_FIRST_QUESTION = 504


@dataclass(frozen=True)
class Frame:
    """A whole and undamaged one."""

    kind: int
    sequence: int
    body: bytes


@dataclass(frozen=True)
class Identity:
    """What a board says it runs."""

    name: str
    hand: str
    made_by: str
    library: str
    checkpoint_sha256: str
    data_sha256: str
    format_version: int
    content_crc: int
    tau: float
    self_test: int
    """Status of `aminn_self_test()` there."""


def frame(mark: bytes, kind: int, sequence: int, body: bytes, version: int = VERSION) -> bytes:
    """The bytes of a frame."""
    content = _HEADER.pack(version, kind, sequence, len(body)) + body
    return mark + content + struct.pack("<I", zlib.crc32(content))


class Conversation:
    """Asks a board, again where a frame was lost or damaged."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.sequence = int.from_bytes(os.urandom(4), "little")  # not that of a program that asked before
        self._buffer = bytearray()
        self._forget()

    def _forget(self) -> None:
        self._received = self._damaged = self._refused = self._stale = 0

    def ask(self, kind: int, body: bytes, padding: bytes = b"") -> bytes:
        """The answer's body. `padding` follows the question from the second try on.

        Raises AminnError, which says what came in its place, where TRIES questions had no good answer.
        """
        self.sequence = (self.sequence + 1) % 2**32
        question = frame(QUESTION, kind, self.sequence, body)
        self._forget()
        for attempt in range(TRIES):
            self.line.write(question + (padding if attempt else b""))
            answer = self._await(kind)
            if answer is not None:
                return answer
        raise AminnError(f"{self.line.name}: {self._complaint()}")

    def _await(self, kind: int) -> bytes | None:
        """The body of the answer to the present question; none if it has to be asked again."""
        deadline = self.line.now() + TIMEOUT_S
        while True:
            found = self._next()
            while found is None:
                data = self.line.read(deadline)
                if not data and not self._drop_mark():
                    return None
                self._received += len(data)
                self._buffer += data
                found = self._next()
            if found.kind == REFUSED:
                self._look_at_refusal(found)
                return None
            if (found.kind, found.sequence) == (kind, self.sequence):
                return found.body
            self._stale += 1

    def _next(self) -> Frame | None:
        """The first whole frame among the bytes that have come."""
        buffer = self._buffer
        while True:
            at = buffer.find(ANSWER)
            if at < 0:
                del buffer[: max(0, len(buffer) - len(ANSWER) + 1)]
                return None
            del buffer[:at]
            if len(buffer) < len(ANSWER) + _HEADER.size:
                return None
            version, kind, sequence, length = _HEADER.unpack_from(buffer, len(ANSWER))
            ends = [len(ANSWER) + _HEADER.size + length + 4] if length <= LARGEST_BODY else []
            ends += [_FIRST_ANSWER] if version != VERSION else []
            for end in ends:
                content = bytes(buffer[len(ANSWER) : end - 4])
                if len(buffer) < end or zlib.crc32(content) != int.from_bytes(buffer[end - 4 : end], "little"):
                    continue
                if version != VERSION:
                    raise self._other_version(1 if end == _FIRST_ANSWER else version)
                del buffer[:end]
                return Frame(kind, sequence, content[_HEADER.size :])
            if len(buffer) < max(ends, default=0):
                return None
            self._damaged += version == VERSION
            self._drop_mark()  # it may have been noise: the real one may stand behind it

    def _drop_mark(self) -> bool:
        """Skip the first mark; whether there was one."""
        there = self._buffer.startswith(ANSWER)
        if there:
            del self._buffer[: len(ANSWER)]
        return there

    def _other_version(self, version: int) -> AminnError:
        return AminnError(
            f"{self.line.name}: the board speaks version {version} of the protocol, this program {VERSION}; program it "
            "with the firmware of this version"
        )

    def _look_at_refusal(self, found: Frame) -> None:
        reason = int.from_bytes(found.body, "little")
        if reason == OTHER_VERSION:
            raise AminnError(
                f"{self.line.name}: the board does not know version {VERSION} of the protocol; program it again"
            )
        if reason == OTHER_KIND:
            raise AminnError(f"{self.line.name}: the board does not know this kind of question; program it again")
        self._refused += 1

    def _complaint(self) -> str:
        asked = f"no good answer to {TRIES} questions"
        others = self.line.others()
        also = f"; {others} has the port open too and may take the answers" if others else ""
        if not self._received:
            return f"{asked}, not a byte in {TIMEOUT_S:g} s each; does the board run the serial firmware?{also}"
        if self._refused:
            return f"{asked}: {self._refused} reached the board damaged; check the line to it, or lower its speed{also}"
        if self._damaged:
            return (
                f"{asked}: {self._damaged} damaged frames came; check the line from the board, or lower its speed{also}"
            )
        if self._stale:
            return f"{asked}, but {self._stale} to other questions; does another program ask on this line?{also}"
        return f"{asked}: {self._received} bytes came, no frame among them; is the board set to {BAUD_NAME}?{also}"


def ask(conversation: Conversation, floats: bytes, kind: int = PREDICT) -> tuple[int, NDArray[np.float32]]:
    """(status, outputs and the decision) for the floats of one input. Raises AminnError on a bad line."""
    body = conversation.ask(kind, floats)
    return int.from_bytes(body[:4], "little", signed=True), np.frombuffer(body, "<f4", -1, 4)


def identity_of(conversation: Conversation) -> Identity:
    """What runs on the board. Raises AminnError on a bad line, or if the board speaks another version."""
    body = conversation.ask(IDENTITY, b"", bytes(_FIRST_QUESTION))
    *texts, checkpoint, data, version, crc, tau, self_test = _IDENTITY.unpack(body)
    name, hand, made_by, library = (text.rstrip(b"\0").decode("ascii", "replace") for text in texts)
    return Identity(name, hand, made_by, library, checkpoint.hex(), data.hex(), version, crc, tau, self_test)


def check_identity(conversation: Conversation, model: BinModel) -> Identity:
    """Refuse a board that runs another model than `model`, or whose library fails its self-test.

    Raises AminnError with what differs.
    """
    found = identity_of(conversation)
    wanted = {name: model.meta[name] for name in ("name", "hand", "made_by", "checkpoint_sha256", "data_sha256")} | {
        "format_version": FORMAT_VERSION,
        "content_crc": model_crc(model),
    }
    wrong = [
        f"{name} {getattr(found, name)!r}, not {value!r}"
        for name, value in wanted.items()
        if getattr(found, name) != value
    ]
    if wrong:
        raise AminnError(
            f"{conversation.line.name}: the board runs another model: {'; '.join(wrong)}; program it again"
        )
    if found.self_test != 0:
        raise AminnError(
            f"{conversation.line.name}: the board's library fails its self-test with status {found.self_test} "
            "(aminn_rt.h has the names); build its firmware again"
        )
    return found


def replay(line: Line, model: BinModel, inputs: dict[str, NDArray[np.float32]], out: Path) -> dict[str, float]:
    """Ask for every sample and write a result file; returns the round trip's mean time.

    The board must run `model`: it is asked first.
    """
    hand = dims_of(model)
    sensing = SENSORS[0] in inputs
    shapes = shapes_with(hand, np.shape(inputs[THETA])[-1] if THETA in inputs else 0, sensing)
    rows = pack(inputs, shapes, "<f4")
    conversation = Conversation(line)
    check_identity(conversation, model)
    start = line.now()
    answers = [ask(conversation, row.tobytes(), SENSE if sensing else PREDICT) for row in rows]
    spent = line.now() - start
    values = np.array([a[1] for a in answers], "<f4").reshape(len(rows), hand.output + 1)
    write_results(out, values, np.array([a[0] for a in answers], "<i4"))
    return {"round_trip_s": spent / max(len(rows), 1)}
