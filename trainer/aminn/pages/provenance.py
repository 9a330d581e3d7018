"""What a page's figures are from: runs with their settings, data with their date, and the version of this program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from aminn_base.read import AnyPath

from .. import __version__
from ..model.checkpoint import Checkpoint
from ..model.config import TrainConfig
from ..training.run_state import flat_settings


def data_in_words(path: AnyPath) -> str:
    """Where data are and when they were written: a data set's folder, or a file."""
    path = Path(path)
    written = (path / "manifest.json" if path.is_dir() else path).stat().st_mtime
    return f"{path}, written on {datetime.fromtimestamp(written, UTC):%Y-%m-%d}"


def settings_in_words(run: Checkpoint) -> str:
    """The settings of a run's training that are not the defaults."""
    defaults = flat_settings(asdict(TrainConfig()))
    found = flat_settings(run.meta.get("identity", {}).get("config", {}))
    changed = [f"{key} {value}" for key, value in found.items() if value != defaults.get(key, value)]
    return ", ".join(changed) or "default settings"


def run_in_words(run: Checkpoint) -> str:
    """Where a run is, by which hash it is known, and how it was trained."""
    data = run.meta.get("data", {})
    trained = f", on {data['train_samples']} load cases of {data['train_grasps']} grasps" if data else ""
    return f"{run.path}, SHA-256 {run.sha256[:16]}: {settings_in_words(run)}{trained}"


def provenance(runs: Sequence[Checkpoint], data: AnyPath | None = None) -> dict[str, str]:
    """Version, data and runs of a page, by name."""
    found = {"version": f"AMINN {__version__}"}
    found |= {"data": data_in_words(data)} if data is not None else {}
    return found | {f"run {k}" if len(runs) > 1 else "run": run_in_words(run) for k, run in enumerate(runs, 1)}
