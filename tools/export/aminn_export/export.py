"""`aminn export`: everything that runs a trained model elsewhere, from one checkpoint."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.origin import training_part, training_set
from aminn.model.checkpoint import load_checkpoint
from aminn.model.export_tables import export_tables
from aminn_base.errors import AminnError, WriteError
from aminn_base.files import sync_folder, write_atomically
from aminn_base.lock import locked_folder
from aminn_base.read import AnyPath
from aminn_rt.compiled import runtime

from .files.bin_model import BinModel, write_bin_model
from .files.c_model import write_c_model
from .files.c_names import check_prefix
from .files.hand_header import write_hand_header
from .files.known_answer import informative_state
from .files.layout import WEIGHT_CODES, checked_name, default_name
from .files.onnx_model import DEBUG_FILE, ONNX_FILE, write_onnx
from .files.ranges import state_ranges, unknown_ranges
from .files.tables import Exported, dims_of
from .judge.weights import ROUNDED, rounding_error
from .samples.golden import GOLDEN_FILE, inputs_of, write_golden


def write_model_files(exported: Exported, out_dir: AnyPath, prefix: str) -> None:
    """Write the ONNX models, the C model and its binary form into an existing folder."""
    out_dir = Path(out_dir)
    write_c_model(exported, out_dir, prefix)
    write_hand_header(exported, out_dir)
    write_bin_model(exported, out_dir / f"{prefix}.bin")
    write_onnx(exported, out_dir / ONNX_FILE)
    write_onnx(exported, out_dir / DEBUG_FILE, debug=True)


def _check_files(out_dir: Path, prefix: str) -> None:
    """Raises AminnError where another model is there, or a file whose name differs by case alone: one on some disks."""
    mine = {f"{prefix}{ending}" for ending in (".c", ".h", ".bin")}
    there = {file.name for file in out_dir.iterdir()} if out_dir.is_dir() else set()
    for name in sorted(there - mine):
        if name.lower() in {m.lower() for m in mine}:
            raise AminnError(f"{out_dir}: holds {name}, which differs from a file of prefix {prefix!r} by case alone")
        if name.endswith(".h") and {f"{name[:-2]}.bin", ONNX_FILE} <= there:
            raise AminnError(
                f"{out_dir}: holds the model {name[:-2]}, whose {ONNX_FILE} would be replaced; export to another folder"
            )


def _publish(part: Path, out_dir: Path, header: str) -> None:
    """Move finished files into place: the folder at once where it is new, else each file at once.

    The C header of the model that was there before goes first, and the new one comes last: without it nothing takes the
    folder for a model, so that no cut leaves files of two models that pass for one.
    """
    if not out_dir.exists():
        os.replace(part, out_dir)
        sync_folder(out_dir.parent)
        return
    if not (out_dir / header).is_symlink():
        (out_dir / header).unlink(missing_ok=True)
        sync_folder(out_dir)
    for file in sorted(part.iterdir(), key=lambda file: (file.name == header, file.name)):
        target = out_dir / file.name
        if file.name == header:
            sync_folder(out_dir)
        if target.is_symlink() or (target.exists() and not target.is_file()):
            write_atomically(target, file.read_bytes())
        else:
            os.replace(file, target)
    sync_folder(out_dir)


@contextmanager
def _part_of(out_dir: Path, header: str) -> Iterator[Path]:
    """A folder beside `out_dir`, by links too, whose files are moved there in the end; one process at a time."""
    place = Path(os.path.realpath(out_dir))
    part = place.with_name(f".{place.name}.partial")
    with locked_folder(out_dir, place.with_name(f".{place.name}.lock")):
        try:
            shutil.rmtree(part, ignore_errors=True)  # of a killed export
            part.mkdir()
            yield part
            _publish(part, place, header)
        except WriteError as error:
            raise WriteError(out_dir / error.path.name, error.reason) from error
        except OSError as error:
            raise WriteError(out_dir, error.strerror or str(error)) from error
        finally:
            shutil.rmtree(part, ignore_errors=True)


def _rounded(exported: BinModel, weights: str, validation: Dataset | None) -> tuple[BinModel, str]:
    """The model with weights of another type, and a line that says what they change."""
    rounded = ROUNDED[weights](exported)
    if not validation:
        return rounded, f"{weights} weights: without validation samples their error is not known"
    e = rounding_error(exported, rounded, inputs_of(validation, exported))
    return rounded, (
        f"{weights} weights change dx_ht by {e['dx_relative_median']:.1e} of its size (median; "
        f"p99 {e['dx_relative_p99']:.1e}, largest {e['dx_relative_max']:.1e}), p_stable by {e['p_stable_median']:.1e} "
        f"(largest {e['p_stable_max']:.1e}), {e['decisions_different']:.0f} of {len(validation)} decisions "
        "on validation samples"
    )


def export(
    checkpoint_dir: AnyPath,
    out_dir: AnyPath,
    prefix: str = "aminn_model",
    data_dir: AnyPath | None = None,
    weights: str = "float32",
    name: str | None = None,
) -> list[str]:
    """Export the checkpoint in `checkpoint_dir` to `out_dir`; returns lines: each file, what other weights cost.

    The data set in `data_dir` is the one that the model was trained on: it gives the golden vectors and the range of
    the inputs in training. Without one there are no golden vectors, and the runtime takes no input for out of range.
    `name` is what the model says that it is, on the target too; the prefix where it is not given.
    `weights` is "float32", "float16" for half the flash, or "int8" for a quarter. Nothing appears in `out_dir` before
    all files are complete. Raises AminnError for a checkpoint or data set that cannot be used, and for data that the
    model was not trained on, with what differs.
    """
    out_dir = Path(out_dir)
    if weights not in WEIGHT_CODES:
        raise AminnError(f"export: weights is {weights!r}, expected one of {', '.join(WEIGHT_CODES)}")
    check_prefix(prefix)
    _check_files(out_dir, prefix)
    checkpoint = load_checkpoint(checkpoint_dir)
    tables = export_tables(checkpoint)
    dataset = training_set(checkpoint, load_dataset(data_dir)) if data_dir is not None else None
    ranges = (
        state_ranges(training_part(checkpoint, dataset).samples)
        if dataset is not None
        else unknown_ranges(dims_of(tables))
    )
    identity = {"made_by": f"aminn {runtime().version()}"}
    identity["name"] = default_name(prefix) if name is None else checked_name("name", name)
    exported, lines = BinModel(tables.meta | identity, tables.tensors | ranges), []
    if weights in ROUNDED:
        exported, line = _rounded(exported, weights, dataset and dataset.split("validation"))
        lines.append(line)
    if dataset is not None:
        exported = BinModel(exported.meta | {"known_state": informative_state(exported, dataset)}, exported.tensors)
    with _part_of(out_dir, f"{prefix}.h") as part:
        write_model_files(exported, part, prefix)
        if dataset is not None:
            write_golden(exported, part / ONNX_FILE, dataset, part / GOLDEN_FILE)
        sizes = {file.name: file.stat().st_size for file in sorted(part.iterdir())}
    return [f"{size:>9} bytes  {out_dir / name}" for name, size in sizes.items()] + lines
