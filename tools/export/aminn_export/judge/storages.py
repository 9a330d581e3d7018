"""What float16 and int8 weights save, cost and change beside float32: flash, instructions on boards, errors, bits."""

from __future__ import annotations

import hashlib
from pathlib import Path

import click

from aminn_base.files import check_outputs, write_json
from aminn_base.program import Messages
from aminn_hand.hand import OUTPUTS

from ..files.bin_model import BinModel, model_crc, read_bin_model, write_bin_model
from ..files.c_model import write_c_model
from ..replay.firmware import BOARDS
from ..replay.targets import replay_all
from ..samples.golden import GOLDEN_FILE
from ..samples.reference import Reference
from ..samples.vectors import read_vectors, write_vectors
from .weights import ROUNDED, rounding_error

MODEL = "aminn_model"
MACHINES = (
    *BOARDS,
    *("x86_64_library", "x86_64_library_avx2", "x86_64_library_sse2", "x86_64_gcc_O3_scalar"),
    *("aarch64_gcc_O2", "powerpc_gcc_O2"),
)
"""One of each form of the layers, and of each byte order."""
EXACT = "float32"
Figures = dict[str, float | int]


def storages(model_dir: Path, work: Path, targets: tuple[str, ...], jobs: int = 1) -> Figures:
    """Figures of each type of weights, its name before theirs, on the golden samples of a float32 model.

    `bin_bytes` of the binary model; `different_results`, 1 where all `targets` give the same bits; of each board among
    them `instructions_per_prediction`; of the rounded ones what `rounding_error` has.
    """
    exact, inputs = read_bin_model(model_dir / f"{MODEL}.bin"), read_vectors(model_dir / GOLDEN_FILE).inputs
    models: dict[str, BinModel] = {EXACT: exact} | {weights: rounded(exact) for weights, rounded in ROUNDED.items()}
    figures: Figures = {"targets": len(targets), "samples": len(inputs["q"])}
    for weights, model in models.items():
        folder = work / weights
        folder.mkdir(parents=True, exist_ok=True)
        write_c_model(model, folder, MODEL)
        write_bin_model(model, folder / f"{MODEL}.bin")
        exact_outputs = Reference(model)(inputs)
        outputs = {name: exact_outputs[name] for name in OUTPUTS}
        write_vectors(folder / GOLDEN_FILE, inputs, outputs, outputs, model_crc(model))
        done = replay_all(targets, folder, MODEL, folder / GOLDEN_FILE, work, jobs)
        results = {hashlib.sha256(out.read_bytes()).hexdigest() for out, _ in done.values()}
        figures[f"{weights}_bin_bytes"] = (folder / f"{MODEL}.bin").stat().st_size
        figures[f"{weights}_different_results"] = len(results)
        for board in BOARDS.keys() & done.keys():
            figures[f"{weights}_{board}_instructions"] = done[board][1]["instructions_per_prediction"]
        if weights != EXACT:
            figures |= {f"{weights}_{key}": value for key, value in rounding_error(exact, model, inputs).items()}
    return figures


@click.command(cls=Messages)
@click.option("--model", "model_dir", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
@click.option("--work", type=click.Path(path_type=Path, file_okay=False), required=True)
@click.option("--targets", default=",".join(MACHINES), show_default=True, help="Where to replay, separated by commas.")
@click.option("--jobs", default=1, show_default=True, help="Targets at a time.")
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(model_dir: Path, work: Path, targets: str, jobs: int, json_file: Path) -> None:
    """Compare the types of weights on a float32 model with golden samples."""
    check_outputs([json_file], [model_dir])
    figures = storages(model_dir, work, tuple(targets.split(",")), jobs)
    write_json(json_file, figures)
    for name, value in figures.items():
        click.echo(f"  {name:44s} {value:>12.4g}" if isinstance(value, float) else f"  {name:44s} {value:>12}")
    if any(figures[f"{weights}_different_results"] != 1 for weights in (EXACT, *ROUNDED)):
        raise click.ClickException(f"the targets' bit patterns differ (figures: {json_file})")


if __name__ == "__main__":
    main()
