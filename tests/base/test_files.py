"""Files that are written whole or not at all, wherever their names lead."""

from __future__ import annotations

import json
import os
import pickle
import resource
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from aminn_base.errors import AminnError, WriteError
from aminn_base.files import refuse_inputs, write_atomically, write_json

Figures = dict[str, float | int | str | bool]
OLD, NEW = b"old", b"new" * 50_000  # more than a pipe holds


@pytest.fixture(autouse=True)
def count(trust: Figures) -> None:
    """Every test of this file is a kind of place, or of a disturbance there."""
    trust["files_places"] = int(trust.get("files_places", 0)) + 1


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def other_disk(tmp_path: Path) -> Path:
    """A new folder on another file system than `tmp_path`."""
    shared = Path("/dev/shm")
    if not os.access(shared, os.W_OK) or shared.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("no second file system to write to")
    return Path(tempfile.mkdtemp(dir=shared))


def unshared(script: str, *arguments: str) -> subprocess.CompletedProcess:
    """Run a shell script that may mount what it likes."""
    return subprocess.run(["unshare", "--mount", "sh", "-ec", script, "sh", *arguments], capture_output=True, text=True)


MAY_MOUNT = bool(shutil.which("unshare")) and unshared("mount -t tmpfs tmpfs /mnt").returncode == 0
needs_mount = pytest.mark.skipif(not MAY_MOUNT, reason="no right to mount a file system")


def test_a_report_is_written_whole_into_a_new_folder(tmp_path: Path) -> None:
    write_json(tmp_path / "new" / "sim.json", {"b": 1.0, "a": "x", "c": float("nan")})
    assert json.loads((tmp_path / "new" / "sim.json").read_text()) == {"a": "x", "b": 1.0, "c": None}
    assert names(tmp_path / "new") == ["sim.json"]


def test_a_new_file_gets_the_umask_s_mode_and_an_old_one_keeps_its_own(tmp_path: Path) -> None:
    file = tmp_path / "file"
    before = os.umask(0o027)
    try:
        write_atomically(file, NEW)
        assert mode_of(file) == 0o640
        file.chmod(0o604)
        write_atomically(file, OLD)
    finally:
        os.umask(before)
    assert mode_of(file) == 0o604 and file.read_bytes() == OLD


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a file away")
def test_a_file_keeps_its_owner(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(OLD)
    os.chown(tmp_path / "file", 1234, 1235)
    write_atomically(tmp_path / "file", NEW)
    found = (tmp_path / "file").stat()
    assert (found.st_uid, found.st_gid) == (1234, 1235)


@pytest.mark.parametrize("relative", [True, False])
def test_a_link_stays_and_its_target_is_replaced(tmp_path: Path, relative: bool) -> None:
    (tmp_path / "there").mkdir()
    target, link, chain = tmp_path / "there" / "file", tmp_path / "link", tmp_path / "chain"
    target.write_bytes(OLD)
    link.symlink_to("there/file" if relative else target)
    chain.symlink_to(link)
    inode = target.stat().st_ino
    write_atomically(chain, NEW)
    assert link.is_symlink() and chain.is_symlink() and target.read_bytes() == NEW
    assert target.stat().st_ino != inode, "rewritten in place: half of it could be seen"
    assert names(tmp_path) == ["chain", "link", "there"] and names(target.parent) == ["file"]


def test_a_link_to_another_file_system(tmp_path: Path) -> None:
    disk = other_disk(tmp_path)
    try:
        (disk / "file").write_bytes(OLD)
        (tmp_path / "link").symlink_to(disk / "file")
        write_atomically(tmp_path / "link", NEW)
        assert (tmp_path / "link").is_symlink() and (disk / "file").read_bytes() == NEW
        assert names(disk) == ["file"] and names(tmp_path) == ["link"]
    finally:
        shutil.rmtree(disk)


def test_a_link_that_leads_nowhere_yet(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("new/file")
    write_atomically(tmp_path / "link", NEW)
    assert (tmp_path / "link").is_symlink() and (tmp_path / "new" / "file").read_bytes() == NEW


def test_links_in_a_circle_are_named(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(WriteError, match=r"a: cannot be written .*symbolic links"):
        write_atomically(tmp_path / "a", NEW)
    assert names(tmp_path) == ["a", "b"]


def test_a_fifo_passes_it_on(tmp_path: Path) -> None:
    fifo, link, got = tmp_path / "fifo", tmp_path / "link", []
    os.mkfifo(fifo)
    link.symlink_to(fifo)
    for path in (fifo, link):
        reader = threading.Thread(target=lambda: got.append(fifo.read_bytes()))
        reader.start()
        write_atomically(path, NEW)
        reader.join()
    assert got == [NEW, NEW] and stat.S_ISFIFO(fifo.stat().st_mode) and names(tmp_path) == ["fifo", "link"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes devices")
@pytest.mark.parametrize(("minor", "refused"), [(3, None), (7, "No space left on device")], ids=["null", "full"])
def test_a_device_stays_one(tmp_path: Path, minor: int, refused: str | None) -> None:
    device, link = tmp_path / "device", tmp_path / "link"
    try:
        os.mknod(device, 0o666 | stat.S_IFCHR, os.makedev(1, minor))
        device.open("rb").close()
    except OSError:
        pytest.skip("this machine lets nobody make a device node")
    link.symlink_to(device)
    for path in (device, link):
        if refused:
            with pytest.raises(WriteError, match=refused):
                write_atomically(path, NEW)
        else:
            write_atomically(path, NEW)
    assert stat.S_ISCHR(device.stat().st_mode) and names(tmp_path) == ["device", "link"]


def test_a_terminal_gets_it() -> None:
    ours, theirs = os.openpty()
    write_atomically(Path(os.ttyname(theirs)), b"figures")
    assert os.read(ours, 100) == b"figures"
    os.close(ours)
    os.close(theirs)


WRITE = "import sys; from pathlib import Path; from aminn_base.files import *; print('table'); "
WRITE += "write_atomically(Path(sys.argv[1]), b'figures\\n'); print('end')"


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "link"])
@pytest.mark.parametrize("end", [">{file}", ">>{file}", "| cat >{file}", "> >(cat >{file}); wait $!"])
def test_standard_output(tmp_path: Path, name: str, end: str) -> None:
    """Before, in and behind what the program prints, wherever the shell has sent it."""
    (tmp_path / "link").symlink_to("/dev/stdout")
    path = str(tmp_path / name) if name == "link" else name
    command = f'"$1" -c "$2" "$3" {end.format(file=tmp_path / "file")}'
    done = subprocess.run(["bash", "-c", command, "bash", sys.executable, WRITE, path], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert (tmp_path / "file").read_text() == "table\nfigures\nend\n"


def test_a_substituted_process(tmp_path: Path) -> None:
    command = f'"$1" -c "$2" >(cat >{tmp_path / "file"}) >/dev/null; wait $!'
    subprocess.run(["bash", "-c", command, "bash", sys.executable, WRITE], check=True)
    assert (tmp_path / "file").read_text() == "figures\n"


def test_a_socket_as_standard_output() -> None:
    ours, theirs = socket.socketpair()
    subprocess.run([sys.executable, "-c", WRITE, "/dev/stdout"], stdout=theirs, check=True)
    theirs.close()
    assert ours.makefile().read() == "table\nfigures\nend\n"


def test_what_cannot_be_written_is_named_and_stays(tmp_path: Path) -> None:
    folder, sock, file = tmp_path / "folder", tmp_path / "socket", tmp_path / "file"
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(sock))
    file.write_bytes(OLD)
    before = names(tmp_path)
    for path, reason in ((folder, "Is a directory"), (sock, "it is a socket"), (file / "below", "Not a directory")):
        with pytest.raises(WriteError, match=f"{path}: cannot be written .{reason}.; make room or choose another"):
            write_atomically(path, NEW)
    assert names(tmp_path) == before and file.read_bytes() == OLD and stat.S_ISSOCK(sock.stat().st_mode)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_protected_file_stays(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(OLD)
    (tmp_path / "file").chmod(0o400)
    with pytest.raises(WriteError, match="Permission denied"):
        write_atomically(tmp_path / "file", NEW)
    assert (tmp_path / "file").read_bytes() == OLD


def limited(work: Callable[[], None], room: int = 1000) -> None:
    """Do `work` in a process that may make no larger file."""
    if (child := os.fork()) == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        try:
            work()
        except AssertionError:
            os._exit(1)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0


def test_a_disk_that_is_full_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(OLD)

    def work() -> None:
        for name in ("file", "other"):
            try:
                write_atomically(tmp_path / name, NEW)
            except WriteError as error:
                assert str(tmp_path / name) in str(error) and "File too large" in str(error)
            else:
                raise AssertionError("written")

    limited(work)
    assert names(tmp_path) == ["file"] and (tmp_path / "file").read_bytes() == OLD


def test_what_a_killed_program_left_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".file.partial").write_bytes(NEW + NEW)
    (tmp_path / ".file.partial").chmod(0o600)
    before = os.umask(0o022)
    write_atomically(tmp_path / "file", NEW)
    os.umask(before)
    assert (
        names(tmp_path) == ["file"] and (tmp_path / "file").read_bytes() == NEW and mode_of(tmp_path / "file") == 0o644
    )


def test_many_writers_of_one_file(tmp_path: Path) -> None:
    """Each writes all of its own letter; whoever is last wins whole."""
    script = "import sys; from pathlib import Path; from aminn_base.files import write_atomically\n"
    script += f"for _ in range(20): write_atomically(Path({str(tmp_path / 'file')!r}), sys.argv[1].encode() * 100_000)"
    writers = [subprocess.Popen([sys.executable, "-c", script, letter]) for letter in "abcd"]
    seen = set()
    while any(w.poll() is None for w in writers):
        if (tmp_path / "file").exists():
            seen.add((tmp_path / "file").read_bytes())
    assert [w.wait() for w in writers] == [0] * 4
    assert seen <= {letter.encode() * 100_000 for letter in "abcd"} and names(tmp_path) == ["file"]


@needs_mount
def test_a_file_that_is_a_mount(tmp_path: Path) -> None:
    """As a container's volume of a single file: no rename can replace it."""
    (tmp_path / "outer").write_bytes(OLD)
    (tmp_path / "inner").write_bytes(b"")
    code = "import sys; from pathlib import Path; from aminn_base.files import *; "
    code += "write_atomically(Path(sys.argv[1]), b'new')"
    done = unshared(
        'mount --bind "$1" "$2"; "$3" -c "$4" "$2"',
        *map(str, (tmp_path / "outer", tmp_path / "inner", sys.executable, code)),
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "outer").read_bytes() == b"new" and names(tmp_path) == ["inner", "outer"]


@pytest.mark.parametrize("kind", ["path", "detour", "hard link", "link", "not there yet"])
def test_an_output_that_is_an_input(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "input"
    if kind != "not there yet":
        file.write_bytes(OLD)
    output = tmp_path / "output"
    if kind == "detour":
        (tmp_path / "folder").mkdir()
        output = tmp_path / "folder" / ".." / "input"
    elif kind == "hard link":
        output.hardlink_to(file)
    elif kind == "link":
        output.symlink_to(file)
    else:
        output = file
    with pytest.raises(AminnError, match=r"needs itself; choose another name"):
        refuse_inputs(output, [tmp_path / "first", file])
    refuse_inputs(tmp_path / "new", [tmp_path / "first", file])
    refuse_inputs(None, [file])


def test_a_device_may_be_input_and_output() -> None:
    refuse_inputs(Path("/dev/null"), [Path("/dev/null")])


def test_the_error_passes_between_processes() -> None:
    error = pickle.loads(pickle.dumps(WriteError(Path("file"), "No space left on device")))
    assert isinstance(error, WriteError) and error.path == Path("file") and "No space" in str(error)
