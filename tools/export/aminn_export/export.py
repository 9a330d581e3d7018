"""`aminn export`: everything that runs a trained model elsewhere, from one checkpoint."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from aminn.checkpoint import load_checkpoint
from aminn.dataset import load_dataset
from aminn.export_tables import export_tables

from .bin_model import write_bin_model
from .c_model import write_c_model
from .golden import write_golden
from .onnx_model import write_onnx
from .tables import Exported

ONNX_FILE, DEBUG_FILE, GOLDEN_FILE = "aminn.onnx", "aminn_debug.onnx", "golden.bin"


def write_model_files(exported: Exported, out_dir: Path, prefix: str) -> None:
    """Write the ONNX models, the C model and its binary form into an existing folder."""
    write_c_model(exported, out_dir, prefix)
    write_bin_model(exported, out_dir / f"{prefix}.bin")
    write_onnx(exported, out_dir / ONNX_FILE)
    write_onnx(exported, out_dir / DEBUG_FILE, debug=True)


def _publish(part: Path, out_dir: Path) -> None:
    """Move finished files into place: the folder at once where it is new, else each file at once."""
    if not out_dir.exists():
        os.replace(part, out_dir)
        return
    for file in sorted(part.iterdir()):
        os.replace(file, out_dir / file.name)


def export(checkpoint_dir: Path, out_dir: Path, prefix: str = "aminn_model", data_dir: Path | None = None) -> list[str]:
    """Export the checkpoint in `checkpoint_dir` to `out_dir`; returns a line for each file.

    Golden vectors are drawn from the data set in `data_dir`; without one there are none. Nothing appears in `out_dir`
    before all files are complete. Raises AminnError for a checkpoint or data set that cannot be used.
    """
    exported = export_tables(load_checkpoint(checkpoint_dir))
    dataset = load_dataset(data_dir) if data_dir is not None else None
    out_dir.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=f".{out_dir.name}-", dir=out_dir.parent))
    try:
        part.chmod(0o755)
        write_model_files(exported, part, prefix)
        if dataset is not None:
            write_golden(exported, part / ONNX_FILE, dataset, part / GOLDEN_FILE)
        sizes = {file.name: file.stat().st_size for file in sorted(part.iterdir())}
        _publish(part, out_dir)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return [f"{size:>9} bytes  {out_dir / name}" for name, size in sizes.items()]
