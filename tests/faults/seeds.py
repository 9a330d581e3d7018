"""Defects that the campaign of powercut.py must find: each is planted in the process that is disturbed."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aminn.calibration import store
from aminn.data import measured
from aminn.training import train
from aminn_base import files, lock
from aminn_export import export


@dataclass(frozen=True)
class Seed:
    """A defect."""

    what: str
    scenario: str
    """In which it is looked for."""
    plant: Callable[[], None]


def _file_not_synced() -> None:
    real = os.fsync
    os.fsync = lambda d: None if stat.S_ISREG(os.fstat(d).st_mode) else real(d)  # type: ignore[assignment]


def _folder_not_synced() -> None:
    files.sync_folder = lambda folder: None


def _made_folder_not_synced() -> None:
    files.make_folder = lock.make_folder = lambda folder: folder.mkdir(parents=True, exist_ok=True)


def _in_place() -> None:
    def replace(target: Path, content: bytes) -> None:
        files.make_folder(target.parent)
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        files._write_all(descriptor, content)
        os.fsync(descriptor)
        os.close(descriptor)
        files.sync_folder(target.parent)

    files._replace = replace


def _renamed_first() -> None:
    def replace(target: Path, content: bytes) -> None:
        files.make_folder(target.parent)
        partial = target.with_name(f".{target.name}.partial")
        descriptor = files._open_empty(partial)
        partial.replace(target)
        files._write_all(descriptor, content)
        os.fsync(descriptor)
        os.close(descriptor)
        files.sync_folder(target.parent)

    files._replace = replace


def _failed_sync_passed_over() -> None:
    real = os.fsync

    def fsync(descriptor: int) -> None:
        with suppress(OSError):
            real(descriptor)

    os.fsync = fsync  # type: ignore[assignment]


def _failed_write_passed_over() -> None:
    real = files._write_all

    def write_all(descriptor: int, content: bytes) -> None:
        with suppress(OSError):
            real(descriptor, content)

    files._write_all = write_all


def _one_write() -> None:
    files._write_all = lambda descriptor, content: [os.write(descriptor, content)] and None


def _left_over() -> None:
    unlink = Path.unlink

    def kept(self: Path, missing_ok: bool = False) -> None:
        if not (self.name.endswith(".partial") and sys.exc_info()[0]):
            unlink(self, missing_ok)

    Path.unlink = kept  # type: ignore[method-assign]


def _published_in_turn() -> None:
    def publish(part: Path, out_dir: Path, header: str) -> None:
        if not out_dir.exists():
            os.replace(part, out_dir)
            return
        for file in sorted(part.iterdir()):
            os.replace(file, out_dir / file.name)
        files.sync_folder(out_dir)

    export._publish = publish


def _header_first() -> None:
    def write(out: Path, found: Any, run_sha256: str) -> list[Path]:
        content, header = store.as_json(found, run_sha256), Path(out).with_suffix(".h")
        files.write_atomically(header, store.as_header(content).encode())
        files.write_json(out, store.sealed(content))
        return [out, header]

    store.write_calibration = write


def _finished_too_soon() -> None:
    saved: list[bool] = []
    save, completed = train.save_checkpoint, train._completed

    def noted(*arguments: Any) -> None:
        saved.append(True)
        save(*arguments)

    train.save_checkpoint = noted
    train._completed = lambda checkpoint: completed(checkpoint) if saved else checkpoint


def _own_shard_refused() -> None:
    refuse = measured._refuse_another
    measured._refuse_another = lambda out, manifest, content: refuse(out, manifest, b"")


SEEDS = {
    "file_not_synced": Seed("a file is renamed before its content is on the disk", "import", _file_not_synced),
    "folder_not_synced": Seed("a rename is not made to last", "import", _folder_not_synced),
    "made_folder_not_synced": Seed("a folder that was made is not made to last", "import", _made_folder_not_synced),
    "in_place": Seed("a file is written under its own name", "import", _in_place),
    "renamed_first": Seed("a file gets its name before its content", "import", _renamed_first),
    "failed_sync": Seed("an fsync that fails is passed over", "import", _failed_sync_passed_over),
    "failed_write": Seed("a write that fails is passed over", "import", _failed_write_passed_over),
    "one_write": Seed("half a write is taken for a whole one", "import", _one_write),
    "left_over": Seed("a temporary file is left after an error", "import", _left_over),
    "published_in_turn": Seed("an export puts files of two models side by side", "export_again", _published_in_turn),
    "header_first": Seed("a calibration's files are of two fits", "calibrate_again", _header_first),
    "finished_too_soon": Seed("a training counts as finished before its last steps", "train", _finished_too_soon),
    "own_shard_refused": Seed("an import does not know its own first half", "import", _own_shard_refused),
}
