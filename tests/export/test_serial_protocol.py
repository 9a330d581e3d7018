"""The serial protocol: whatever happens on a line ends in a new question or in a message that says what."""

from __future__ import annotations

import os
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from runtime_models import RandomModel, random_inputs
from serial_lines import (
    WHO,
    Board,
    Disturb,
    FirstBoard,
    MadeUpLine,
    at_once,
    before,
    doubled,
    flipped,
    lost,
    other,
    outputs_of,
)

from aminn_base.errors import AminnError
from aminn_export.files.bin_model import read_bin_model
from aminn_export.judge.verify import verify
from aminn_export.replay import serial_line, serial_protocol
from aminn_export.replay.firmware import build_firmware
from aminn_export.replay.serial_line import Line, open_port
from aminn_export.replay.serial_protocol import ANSWER, QUESTION, Conversation, ask, check_identity, frame, identity_of
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.vectors import write_vectors
from aminn_rt.blob import FORMAT_VERSION as MODEL_FORMAT_VERSION

Figures = dict[str, float | int | str | bool]
FLOATS = np.arange(1, 126, dtype="<f4").tobytes()
QUESTION_BYTES, ANSWER_BYTES, REFUSAL_BYTES = 520, 212, 24
KINDS = {"lost": lost, "doubled": doubled, "flipped": flipped}

needs_qemu = pytest.mark.skipif(
    not all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm", "cmake"))), reason="no cross compiler or no qemu"
)


def _asks(line: Line) -> None:
    """Two questions, the second of which must not get the first one's answer."""
    conversation = Conversation(line)
    for floats in (FLOATS, FLOATS[::-1]):
        status, values = ask(conversation, floats)
        wanted = outputs_of(floats)
        assert status == int.from_bytes(wanted[:4], "little", signed=True) and values.tobytes() == wanted[4:]


@pytest.mark.parametrize("kind", KINDS)
def test_a_byte_of_a_question_or_answer_lost_doubled_or_flipped(kind: str, trust: Figures) -> None:
    """At every place; the question is asked again and the answer is right."""
    disturb = KINDS[kind]
    for at in range(QUESTION_BYTES):
        _asks(MadeUpLine(Board(), to=disturb(at)))
    for at in range(ANSWER_BYTES):
        _asks(MadeUpLine(Board(), back=at_once(disturb(at))))
    for at, first in product(range(REFUSAL_BYTES), (0, 4, 14, 300, 519)):  # the refusal of a damaged question as well
        _asks(MadeUpLine(Board(), to=disturb(first), back=at_once(disturb(at))))
    trust[f"serial_{kind}_places"] = QUESTION_BYTES + ANSWER_BYTES + 5 * REFUSAL_BYTES


def test_bytes_lost_in_a_row_cut_off_and_late() -> None:
    for at, n in product(range(0, QUESTION_BYTES, 7), (2, 16, 100, 520)):
        _asks(MadeUpLine(Board(), to=lost(at, n)))
        _asks(MadeUpLine(Board(), back=at_once(lost(at % ANSWER_BYTES, n))))
    for at, late in product(range(0, ANSWER_BYTES, 5), (0.1, 1.9, 2.1, 3.0, 5.0)):
        _asks(MadeUpLine(Board(), back=lambda data, at=at, late=late: [(0.0, data[:at]), (late, data[at:])]))


def test_an_answer_to_an_earlier_question_is_not_taken_for_this_ones() -> None:
    stale = frame(ANSWER, serial_protocol.PREDICT, 1, outputs_of(FLOATS[::-1]))
    _asks(MadeUpLine(Board(), back=at_once(before(stale))))
    _asks(MadeUpLine(Board(), back=lambda data: [(0.0, data), (2.5, data)]))  # and once more, late


def test_noise_with_marks_before_and_within() -> None:
    random = np.random.default_rng(3)
    noises = [
        ANSWER,
        QUESTION,
        ANSWER * 3,
        frame(ANSWER, 2, 5, bytes(500))[:60],
        frame(QUESTION, 2, 5, bytes(500))[:60],
    ]
    noises += [random.bytes(int(n)) for n in random.integers(1, 700, 100)]
    noises += [random.bytes(9) + mark + random.bytes(30) for mark in (ANSWER, QUESTION) for _ in range(50)]
    for noise in noises:
        _asks(MadeUpLine(Board(), to=before(noise)))
        _asks(MadeUpLine(Board(), back=at_once(before(noise))))


def test_random_disturbances_of_both_directions(trust: Figures) -> None:
    """Several at once and several times: a right answer or a message, never a wrong answer."""
    random = np.random.default_rng(5)
    answered = said = 0

    def some(data: bytes) -> bytes:
        for _ in range(random.integers(0, 4)):
            if data:
                make = [lost, doubled, flipped, lambda at: before(random.bytes(at % 9))][random.integers(4)]
                data = make(int(random.integers(len(data))))(data)
        return data

    for _ in range(2000):
        try:
            _asks(MadeUpLine(Board(), some, at_once(some), times=int(random.integers(1, 12))))
            answered += 1
        except AminnError as error:
            assert "no good answer to 5 questions" in str(error)
            said += 1
    assert answered > 1000 and answered + said == 2000
    trust |= {"serial_random_lines": 2000, "serial_random_lines_answered": answered}


@pytest.mark.parametrize(
    ("to", "back", "message"),
    [
        (lambda data: b"", bytes, "not a byte in 2 s each; does the board run the serial firmware"),
        (bytes, lambda data: b"\x80\xfe" * 40, r"\d+ bytes came, no frame among them; is the board set to 115200 baud"),
        (flipped(100), bytes, "5 reached the board damaged; check the line to it"),
        (bytes, flipped(100), "damaged frames came; check the line from the board"),
        (bytes, lambda _: frame(ANSWER, 2, 7, bytes(192)), "to other questions; does another program ask"),
    ],
)
def test_a_line_that_stays_bad_is_described(to: Disturb, back: Disturb, message: str) -> None:
    with pytest.raises(AminnError, match=message):
        ask(Conversation(MadeUpLine(Board(), to, at_once(back), times=99)), FLOATS)


def test_boards_of_other_protocols_are_named() -> None:
    with pytest.raises(AminnError, match="speaks version 1 of the protocol, this program 3"):
        identity_of(Conversation(MadeUpLine(FirstBoard())))
    with pytest.raises(AminnError, match="speaks version 4"):
        identity_of(Conversation(MadeUpLine(Board(version=4))))


def test_the_identity_is_compared_before_anything_is_replayed(exported: RandomModel, export_dir: Path) -> None:
    assert identity_of(Conversation(MadeUpLine(Board()))) == WHO
    model = read_bin_model(export_dir / "aminn_model.bin")
    same = {k: model.meta[k] for k in ("name", "hand", "made_by", "checkpoint_sha256", "data_sha256")}
    same["content_crc"] = serial_protocol.model_crc(model)

    def check(**changes: object) -> None:
        check_identity(Conversation(MadeUpLine(Board(who=other(**same | changes)))), model)

    check()
    for name, value in {
        "name": "mine",
        "hand": "claw",
        "made_by": "aminn 9",
        "format_version": MODEL_FORMAT_VERSION + 1,
        "content_crc": 1,
        "checkpoint_sha256": "00" * 32,
        "data_sha256": "11" * 32,
    }.items():
        with pytest.raises(AminnError, match=f"the board runs another model: {name} {value!r}"):
            check(**{name: value})
    with pytest.raises(AminnError, match="fails its self-test with status -20"):
        check(self_test=-20)


# --- ports ----------------------------------------------------------------------------------------------------------
@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """The board's end of a pseudo-terminal, and the path of the other end."""
    master, slave = os.openpty()
    name = os.ttyname(slave)
    os.close(slave)
    yield master, name
    try:
        os.close(master)
    except OSError:
        pass  # the test has unplugged it


def test_what_is_no_port_is_refused_and_not_written_to(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"precious")
    os.mkfifo(tmp_path / "pipe")
    for path, message in (
        (file, "a regular file"),
        (tmp_path, "a folder"),
        (tmp_path / "pipe", "a pipe"),
        (tmp_path / "none", "No such file"),
        ("/dev/null", "no serial port"),
        ("/dev/tty", "the terminal that this command runs in"),
        ("tcp:localhost:none", "expected tcp:HOST:PORT"),
        ("tcp:localhost:70000", "expected tcp:HOST:PORT"),
        ("tcp:5577", "cannot connect"),
    ):
        with pytest.raises(AminnError, match=message), open_port(str(path)):
            pass
    assert file.read_bytes() == b"precious"


def test_a_port_in_use_is_refused_and_free_again_afterwards(terminal: tuple[int, str]) -> None:
    _, name = terminal
    hold = (
        "import fcntl, os, sys; d = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); fcntl.flock(d, 2); print(); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other_one:
        assert other_one.stdout is not None
        other_one.stdout.readline()
        with pytest.raises(AminnError, match=rf"in use by python\S* \(process {other_one.pid}\)"), open_port(name):
            pass
        other_one.communicate(b"\n")
    for _ in range(2):
        with open_port(name) as line:
            assert line.others() == ""


def test_an_unplugged_line_is_named(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with open_port(name) as line:
        os.close(master)
        with pytest.raises(AminnError, match="unplugged, or closed at the other end"):
            ask(Conversation(line), FLOATS)
    ours, theirs = socket.socketpair()
    with ours:
        theirs.close()
        with pytest.raises(AminnError, match="unplugged, or closed at the other end"):
            ask(Conversation(Line(ours.fileno(), "line")), FLOATS)


def test_a_line_that_takes_nothing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "WRITE_TIMEOUT_S", 0.05)
    ours, theirs = socket.socketpair()
    with ours, theirs, pytest.raises(AminnError, match="nobody reads at the other end"):
        Line(ours.fileno(), "line").write(bytes(10_000_000))


def test_sockets_by_path(tmp_path: Path) -> None:
    path = tmp_path / "board"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        with open_port(str(path)) as line:
            board, _ = server.accept()
            with board:
                line.write(b"question")
                assert board.recv(8) == b"question"
                board.sendall(b"answer")
                assert line.read(line.now() + 5) == b"answer"
    with pytest.raises(AminnError, match="cannot connect"), open_port(str(path)):
        pass


# --- the firmware ---------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def board(export_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A port with the emulated Cortex-M4F behind it."""
    image = build_firmware(export_dir, tmp_path_factory.mktemp("firmware"), target="cortex_m4")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-monitor", "none"]
    command += ["-serial", f"tcp:127.0.0.1:{port},server=on,wait=off", "-kernel", str(image)]
    command += ["-semihosting-config", "enable=on,target=native,arg=firmware,arg=--serial"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        for _ in range(100):
            time.sleep(0.1)
            with socket.socket() as attempt:
                if attempt.connect_ex(("127.0.0.1", port)) == 0:
                    break
        yield f"tcp:127.0.0.1:{port}"
    finally:
        process.kill()
        process.wait()


class Disturbed(Line):
    """Disturbs the first write, or the first bytes that are read."""

    to: Disturb = bytes
    back: Disturb = bytes

    def write(self, data: bytes) -> None:
        to, self.to = self.to, bytes
        super().write(to(data))

    def read(self, deadline: float) -> bytes:
        data = super().read(deadline)
        if not data:
            return data
        back, self.back = self.back, bytes
        return back(data) or self.read(deadline)


@needs_qemu
def test_verify_over_the_serial_port(board: str, export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    x = random_inputs(20, 15)
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = verify(export_dir, tmp_path / "v.bin", build_dir, port=board, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert report["board_dx_relative_max"] == report["host_c_dx_relative_max"]


@needs_qemu
def test_the_firmware_finds_damage_and_goes_on(board: str, export_dir: Path) -> None:
    model = read_bin_model(export_dir / "aminn_model.bin")
    with open_port(board) as plain:
        who = check_identity(Conversation(plain), model)
        assert who.self_test == 0 and who.tau == pytest.approx(model.meta["tau"])
        line = Disturbed(plain.descriptor, "board")
        conversation = Conversation(line)
        nan = np.full(125, np.nan, "<f4").tobytes()
        disturbances = [make(at) for make in KINDS.values() for at in (0, 5, 13, 300)]
        disturbances += [
            lost(30, 400),
            lambda data: data[:9],
            before(b"noise AMN AMNQ"),
            before(frame(QUESTION, 2, 1, nan)[:99]),
        ]
        for disturb in disturbances:
            line.to = disturb
            assert ask(conversation, nan)[0] == -4  # AMINN_E_NONFINITE
        for disturb in (flipped(30), lost(0), doubled(20), before(ANSWER)):
            line.back = disturb
            assert ask(conversation, nan)[0] == -4
        line.write(frame(QUESTION, 9, 1, b""))
        with pytest.raises(AminnError, match="does not know this kind of question"):
            conversation.ask(serial_protocol.PREDICT, nan)
        line.write(frame(QUESTION, serial_protocol.PREDICT, 1, nan, version=4))
        with pytest.raises(AminnError, match="does not know version 3"):
            conversation.ask(serial_protocol.PREDICT, nan)
        while select.select([line.descriptor], [], [], 0.5)[0]:  # what was asked beside
            os.read(line.descriptor, 4096)
