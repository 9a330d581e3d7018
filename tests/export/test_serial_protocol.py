"""The serial protocol: the firmware's UART in qemu answers what the host computes; bad lines and ports are named."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from runtime_models import random_inputs

from aminn_base.errors import AminnError
from aminn_export import serial_protocol
from aminn_export.firmware import build_firmware
from aminn_export.golden import run_onnx, single_thread_session
from aminn_export.serial_protocol import ANSWER, BAD_FRAME, Stream, ask, open_port
from aminn_export.vectors import write_vectors
from aminn_export.verify import verify

needs_qemu = pytest.mark.skipif(
    not all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm", "cmake"))), reason="no cross compiler or no qemu"
)


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


@needs_qemu
def test_verify_over_the_serial_port(board: str, export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    x = random_inputs(20, 15)
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = verify(export_dir, tmp_path / "v.bin", build_dir, port=board, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert report["board_dx_relative_max"] == report["host_c_dx_relative_max"]


@needs_qemu
def test_the_board_finds_damage_and_goes_on(board: str) -> None:
    with open_port(board) as stream:
        stream.write(b"noise AMN AMNQ" + bytes(504))  # its CRC-32 is not 0
        body = stream.read_after(ANSWER, 4)
        assert int.from_bytes(body, "little", signed=True) == BAD_FRAME
        stream.read(4 * 48, time.monotonic() + 5)
        status, _ = ask(stream, np.full(125, np.nan, "<f4").tobytes())
        assert status == -4  # AMINN_E_NONFINITE


def _answers(answer: bytes) -> Iterator[Stream]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        thread = threading.Thread(target=lambda: [theirs.recv(1000) and theirs.sendall(answer) for _ in range(3)])
        thread.start()
        yield Stream(ours.fileno(), "line")
        thread.join()


def test_a_bad_line_is_named() -> None:
    for stream in _answers(b"??" + ANSWER + bytes(4 * 48) + b"\1\2\3\4"):
        with pytest.raises(AminnError, match="3 damaged frames"):
            ask(stream, bytes(500))


def test_silence_and_missing_ports_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_protocol, "TIMEOUT_S", 0.2)
    master, slave = os.openpty()
    with open_port(os.ttyname(slave)) as stream, pytest.raises(AminnError, match="no answer within"):
        ask(stream, bytes(500))
    os.close(master)
    os.close(slave)
    with pytest.raises(AminnError, match="cannot open"), open_port(str(tmp_path / "none")):
        pass
    with pytest.raises(AminnError, match="tcp:HOST:PORT"), open_port("tcp:localhost:none"):
        pass
