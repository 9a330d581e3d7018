"""The package as people install it: an sdist, the wheel that is built from it, environments outside the tree."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
PACKAGES = sorted(p.parent for p in ROOT.glob("*/aminn*/__init__.py")) + sorted(
    p.parent for p in ROOT.glob("tools/*/aminn*/__init__.py")
)


def run(command: Sequence[object], folder: Path, home: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A program with its output, in `folder`, where it caches in `home`; what is set for Python is not handed on."""
    surroundings = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    if home is not None:
        surroundings |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=folder, env=surroundings, capture_output=True, text=True)


def checked(command: Sequence[object], folder: Path, home: Path | None = None) -> str:
    """The output of a program that has to succeed."""
    done = run(command, folder, home)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    return done.stdout


def build(out: Path, *settings: str) -> tuple[Path, Path]:
    """The sdist of the tree and the wheel that is built from it, with this environment's build tools."""
    options = [f"--config-setting=cmake.define.{setting}" for setting in settings]
    checked([sys.executable, "-m", "build", "--no-isolation", "--outdir", out, *options, ROOT], out.parent)
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return sdist, wheel


def borrowing(folder: Path) -> Path:
    """A new environment that sees the packages of this one, but not what is installed for editing; its Python."""
    checked([sys.executable, "-m", "venv", "--without-pip", folder], folder.parent)
    python = folder / "bin" / "python"
    where = Path(checked([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder).strip())
    (where / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")  # whose own .pth files are not read
    return python


def install(wheel: Path, python: Path) -> Path:
    """Install the wheel alone into an environment; the program `aminn` there."""
    own = (python.parent / "pip").exists()  # one that borrows has none
    pip = [python, "-m", "pip"] if own else [sys.executable, "-m", "pip", f"--python={python}"]
    checked([*pip, "--disable-pip-version-check", "install", "--quiet", "--no-deps", wheel], wheel.parent)
    return python.parent / "aminn"
