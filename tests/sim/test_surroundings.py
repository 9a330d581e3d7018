"""What the simulation meets on a machine: other services where Ray should be, other ideas of OpenGL, no MuJoCo."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from small_data import SMALL

from aminn_sim import SimulationConfig, SimulationError, engines, simulate
from aminn_sim.gallery import _remedy


@contextmanager
def listening(answer: Callable[[socket.socket], None]) -> Iterator[str]:
    """Address of a server that gives every caller the same answer."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            held = []
            while True:
                try:
                    line, _ = server.accept()
                except OSError:
                    return
                held.append(line)
                answer(line)

        threading.Thread(target=serve, daemon=True).start()
        yield f"127.0.0.1:{server.getsockname()[1]}"


def silent(line: socket.socket) -> None:
    pass


def web(line: socket.socket) -> None:
    line.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")


def hangs_up(line: socket.socket) -> None:
    line.close()


def settings_and_no_more(line: socket.socket) -> None:
    line.sendall(engines.HTTP2_FRAME_HEAD)


@pytest.mark.parametrize("scheme", ["", "ray://"])
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (silent, "says nothing for 0.5 s"),
        (web, "does not speak Ray's protocol"),
        (hangs_up, "does not speak Ray's protocol|Connection reset"),
    ],
)
def test_a_service_that_is_not_ray_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scheme: str, answer: Callable, message: str
) -> None:
    monkeypatch.setattr(engines, "RAY_KNOCK_S", 0.5)
    with listening(answer) as address:
        monkeypatch.setenv("RAY_ADDRESS", scheme + address)
        with pytest.raises(SimulationError, match=f"RAY_ADDRESS={scheme}{address} cannot be used .*({message})"):
            simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False, engine="ray")


def test_a_service_that_begins_like_ray_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "RAY_CHECK_S", 6.0)
    with listening(settings_and_no_more) as address:
        monkeypatch.setenv("RAY_ADDRESS", address)
        with pytest.raises(SimulationError, match=r"cannot be used \((what listens there does not answer|`ray health)"):
            simulate(SimulationConfig(**SMALL), tmp_path / "data", progress=False, engine="ray")


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], env=os.environ | environment, capture_output=True, text=True, timeout=120
    )


@pytest.mark.parametrize("name", ["MUJOCO_GL", "PYOPENGL_PLATFORM"])
@pytest.mark.parametrize("value", ["egl", "glfw", "banana", ""])
def test_pictures_do_not_depend_on_what_the_environment_wants_of_opengl(name: str, value: str) -> None:
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed: pip install aminn[mujoco]")
    result = run(
        "from aminn_sim.gallery import offscreen\nwith offscreen() as s: print(s.mujoco.__name__)", **{name: value}
    )
    assert result.stdout == "mujoco\n", result.stderr[-500:]


def test_a_process_that_draws_otherwise_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")
    monkeypatch.setattr("aminn_sim.gallery.find_library", lambda name: "libOSMesa.so.8")
    assert "libosmesa6 is there, but this process imported mujoco for OpenGL by egl" in _remedy()
    monkeypatch.setattr("aminn_sim.gallery.find_library", lambda name: None)
    assert _remedy() == "install Debian's libosmesa6 (apt-get install libosmesa6)"


def test_a_machine_without_mujoco_is_told_what_to_do(tmp_path: Path) -> None:
    hide = "import sys; sys.modules['aminn_sim._core'] = None\n"
    words = ["aminn", "simulate", "--out", str(tmp_path / "data")]
    result = run(f"{hide}sys.argv = {words!r}\nfrom aminn_app.cli import main; main()")
    assert result.returncode == 1 and "tools/setup/mujoco.sh" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert run(f"{hide}try:\n  import aminn_sim\nexcept ImportError as e: print('ok')").stdout == "ok\n"
