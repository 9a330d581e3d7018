"""The program `aminn`: one command per stage, from simulation to verification."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from aminn import __version__
from aminn_base.errors import AminnError
from aminn_base.program import Commands, Judges
from aminn_base.read import read_json

if TYPE_CHECKING:
    from aminn.data.dataset import Dataset
    from aminn.model.checkpoint import Checkpoint

FOLDER = click.Path(path_type=Path, file_okay=False)
EXISTING = click.Path(path_type=Path, file_okay=False, exists=True)


class DataFolder(click.Path):
    """The folder of a data set; says what to do with a table."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if Path(value).is_file():
            self.fail(
                f"{value} is a file, and this takes the folder of a data set; "
                f"`aminn import {value} --like RUN --out FOLDER` makes one of a table of pushes",
                param,
                ctx,
            )
        return super().convert(value, param, ctx)


DATA = DataFolder(path_type=Path, file_okay=False, exists=True)
FILE_OR_FOLDER = click.Path(path_type=Path, exists=True)
READABLE = click.Path(path_type=Path, exists=True, dir_okay=False)
NEW_FILE = click.Path(path_type=Path, dir_okay=False)
TRAINED_ON = click.option(
    "--trained-on",
    type=EXISTING,
    default=None,
    help="Where --data is another one: the data set of the training, whose grasps are then left out.",
)


CALIBRATION = click.option(
    "--calibration",
    type=READABLE,
    help="The data are measured on a hand with this calibration (JSON of `aminn calibrate`).",
)


def with_calibration(data: Dataset, calibration: Path | None, run: Checkpoint) -> Dataset:
    """The measured samples as a model is to see them, if there is a calibration."""
    if calibration is None:
        return data
    from aminn.calibration.store import calibrated, read_calibration

    return calibrated(data, read_calibration(calibration, run.model.hand))


SENSORS = click.option(
    "--sensors",
    metavar="WORDS",
    help="What models are given of friction, the tool's weight and tendon tensions: friction or class (low, mid, "
    "high), weight and tension joined by +, as in class+weight; nothing; all.  [default: what was measured; of "
    "simulated data nothing]",
)


def with_told(data: Dataset, words: str | None) -> Dataset:
    """The data with what a model is given of their sensors, if `words` says it."""
    if words is None:
        return data
    from aminn.data.sensors import Told, sensed

    return sensed(data, Told.parse(words))


def read_verification(file: Path) -> dict:
    """The report that `aminn verify --json` wrote."""
    report = read_json(file, "a report of `aminn verify --json`")
    if "ok" not in report or "failures" not in report:
        raise AminnError(f"{file}: not a report of `aminn verify --json`")
    return report


def _show_version(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    if not wanted or ctx.resilient_parsing:
        return
    click.echo(f"aminn, version {__version__}")
    try:
        from aminn_sim.build import in_words, simulator_build

        click.echo(f"simulates on {in_words(simulator_build())}")
    except AminnError as error:
        click.echo(f"does not simulate: {error}")
    ctx.exit()


@click.group(cls=Commands)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_version,
    help="Show the version, and the engine that simulates, and exit.",
)  # fmt: skip
def main() -> None:
    """Predict how a robot hand's grasp gives way under load.

    Simulate, train, sweep, evaluate, compare, calibrate, explain, export, verify, report, play.

    \b
    Complete names by the Tab key (bash; zsh and fish alike, with their names):
      eval "$(_AMINN_COMPLETE=bash_source aminn)"
    """


@main.command()
@click.option("--out", type=FOLDER, required=True, help="Folder of the data set; an unfinished one is continued.")
@click.option("--grasps", type=click.IntRange(1), default=400, show_default=True, help="Number of grasps.")
@click.option("--cases", type=click.IntRange(1), default=16, show_default=True, help="Load cases per grasp.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--threads", type=click.IntRange(1), default=None, help="Worker threads  [default: all cores]")
@click.option(
    "--engine",
    type=click.Choice(["threads", "ray"]),
    default="threads",
    show_default=True,
    help="Threads here, or the Ray cluster of RAY_ADDRESS (else one started here). The bytes are the same.",
)
@click.option("--shard-grasps", type=click.IntRange(1), default=None, help="Grasps per shard.")
@click.option("--family", "families", multiple=True, help="Tool family; may be repeated.  [default: all]")
@click.option("--json", "json_file", type=NEW_FILE, help="Write time and rate here, as flat keys.")
@click.option("--hand", type=click.Path(path_type=Path), default=None, help="Hand file (TOML)  [default: built in]")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="Any other number of the configuration, e.g. friction_min=0.6; may be repeated. The names are the fields of "
    "aminn_sim.SimulationConfig.",
)
@click.option(
    "--vary",
    "variations",
    multiple=True,
    metavar="NAME=HALF_RANGE",
    help="What differs from hand to hand: mechanics=0.5 draws stiffnesses and contact compliances within exp(+-0.5). "
    "--set grasps_per_hand=40 gives each hand so many grasps in a row.",
)
@click.option(
    "--mechanics",
    type=READABLE,
    default=None,
    help='Simulate this hand: JSON with {"theta": {NAME: VALUE}}, as aminn calibrate writes it. --vary is about it.',
)
def simulate(
    out: Path,
    grasps: int,
    cases: int,
    seed: int,
    threads: int | None,
    engine: str,
    shard_grasps: int | None,
    families: tuple[str, ...],
    json_file: Path | None,
    hand: Path | None,
    changes: tuple[str, ...],
    variations: tuple[str, ...],
    mechanics: Path | None,
) -> None:
    """Simulate grasps under load and write a labelled data set.

    `aminn card` and `aminn gallery` then show what it holds.
    """
    from .simulation import read_mechanics, run_simulation, simulation_settings, variation_settings

    settings: dict[str, object] = {"shard_grasps": shard_grasps, "families": families or None}
    given = {name: value for name, value in settings.items() if value is not None}
    given |= simulation_settings(changes) | variation_settings(variations)
    given |= {"mechanics": read_mechanics(mechanics, hand)} if mechanics else {}
    manifest = run_simulation(out, grasps, cases, seed, threads, engine, hand, json_file, **given)
    click.echo(f"{manifest['n_samples']} load cases of {manifest['n_grasps']} grasps in {out}")


@main.command()
@click.option("--data", type=DATA, required=True, help="Finished data set that `aminn simulate` wrote.")
def card(data: Path) -> None:
    """Write the data card of a simulated data set, DATA/card.html: what it holds and how good its labels are."""
    from aminn_sim.card import data_card

    click.echo(f"data card: {data_card(data)}")


@main.command()
@click.option("--data", type=DATA, required=True, help="Finished data set that `aminn simulate` wrote.")
@click.option("--count", type=click.IntRange(1), default=16, show_default=True, help="Number of grasps.")
@click.option("--hand", type=click.Path(path_type=Path), default=None, help="Its hand file (TOML)  [default: built in]")
def gallery(data: Path, count: int, hand: Path | None) -> None:
    """Draw grasps of a simulated data set before and after their load, DATA/gallery/index.html."""
    from aminn_sim.gallery import gallery as draw

    click.echo(f"pictures: {draw(data, count, hand)}")


@main.command("import")
@click.argument("tables", type=FILE_OR_FOLDER, nargs=-1, required=True)
@click.option("--hand", type=READABLE, default=None, help="Hand file (TOML) of the hand that was pushed in.")
@click.option("--like", type=EXISTING, default=None, help="Instead: a run, or a data set, of the same hand.")
@click.option("--out", type=FOLDER, required=True, help="Folder of the data set.")
@click.option("--map", "map_file", type=READABLE, default=None, help="TOML file: names, topics, frames, units, signs.")
@click.option("--table", type=NEW_FILE, default=None, help="Write what was read here too (.csv, .parquet, .h5).")
def import_(
    tables: tuple[Path, ...],
    hand: Path | None,
    like: Path | None,
    out: Path,
    map_file: Path | None,
    table: Path | None,
) -> None:
    """Check measured pushes (CSV, Parquet, HDF5, ROS 2 bags) and write them as a data set that every command takes.

    One row per push; docs/own-data.md has the columns, and how a map finds them in a bag. Every fault is named with its
    column and row, or its topic and message, and nothing is written then. It says what replaces sensors that the
    table lacks, and keeps it in the manifest.
    """
    from .importing import run_import

    manifest = run_import(tables, hand, like, out, click.echo, map_file, table)
    click.echo(f"{manifest['n_samples']} pushes of {manifest['n_grasps']} grasps in {out}")


def _print_config(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from aminn.model.config import as_toml, load_config

        click.echo(as_toml(load_config()))
        ctx.exit()


@main.command()
@click.option("--data", type=DATA, required=True, help="Folder that `aminn simulate` wrote.")
@click.option("--out", type=FOLDER, required=True, help="Folder of the checkpoint; an unfinished run is continued.")
@click.option("--model", "kind", type=click.Choice(["aminn", "mlp"]), default=None, help="AMINN or the baseline.")
@click.option("--seed", type=click.IntRange(0), default=None, help="Weights and order of samples.")
@click.option("--epochs", type=click.IntRange(1), default=None, help="Passes over the data, each stage.")
@click.option("--config", "file", type=READABLE, default=None, help="TOML file of settings.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="One setting; may be repeated.")
@click.option(
    "--print-config",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_config,
    help="Print every setting with its meaning and default, as a TOML file, and stop.",
)
@click.option("--finetune", type=EXISTING, default=None, help="Run to start from: its weights and normalisation.")
@click.option("--tensorboard/--no-tensorboard", default=True, show_default=True, help="Curves in OUT/tensorboard.")
@click.option("--device", default="cpu", show_default=True, help="Where steps are computed: cpu, cuda or cuda:N.")
def train(
    data: Path,
    out: Path,
    kind: str | None,
    seed: int | None,
    epochs: int | None,
    file: Path | None,
    overrides: tuple[str, ...],
    finetune: Path | None,
    tensorboard: bool,
    device: str,
) -> None:
    """Train AMINN or the MLP baseline.

    Stage 1 learns on every load case of the training grasps whether the grasp holds; stage 2 learns on the stable ones
    how far the tool moves. Of each stage the weights of the epoch with the least validation loss are kept, then the
    threshold tau on p_stable is chosen on validation data. Test grasps are never read.

    \b
    A first run, watched in a browser (tensorboard --logdir runs):
      aminn train --data data --out runs/first
    The black box beside it, same schedule and size:
      aminn train --data data --out runs/mlp --model mlp
    Other settings, one by one or from a file:
      aminn train --data data --out runs/wide --set model.width=96 --set loss.relative=0.05
      aminn train --print-config > mine.toml
      aminn train --data data --out runs/mine --config mine.toml --seed 3
    From a trained model on, with data of the same hand and smaller steps:
      aminn train --data more --finetune runs/first --out runs/tuned --epochs 20 --set learning_rate=1e-3

    Settings come from the defaults, then the file, then the options, then --set; later ones win. One table
    model.mechanics stands for both stages.

    Interrupt or kill it at will: the same command continues from the last finished epoch and ends in the same bytes. A
    folder that holds a run of other settings or data is refused, and the message names what differs. A loss that
    diverges ends the run with step and term, and leaves the last good state.

    OUT holds in the end model.safetensors (weights), model.json (settings, history, tau, operating curve), card.md
    (what it is, figures, limits) and tensorboard/.
    """
    from aminn.data.dataset import load_dataset
    from aminn.model.checkpoint import load_checkpoint
    from aminn.model.config import load_config
    from aminn.training.train import train as run

    config = load_config(file, overrides, kind=kind, seed=seed, epochs=epochs)
    start = load_checkpoint(finetune) if finetune else None
    checkpoint = run(config, load_dataset(data), out, tensorboard=tensorboard, finetune=start, device=device)
    meta = checkpoint.meta
    click.echo(
        f"{config.kind}: {meta['n_parameters']} parameters, tau {meta['tau']:.4f}, "
        f"F1 {meta['validation']['f1']:.3f} on validation grasps, in {out}"
    )


@main.command()
@click.argument("grid", type=READABLE)
@click.option("--data", type=DATA, required=True, help="Folder that `aminn simulate` wrote.")
@click.option("--out", type=FOLDER, required=True, help="Folder of the runs, one folder each.")
@click.option("--jobs", type=click.IntRange(1), default=None, help="Runs side by side  [default: all cores]")
@click.option("--tensorboard/--no-tensorboard", default=True, show_default=True, help="Curves of each run.")
def sweep(grid: Path, data: Path, out: Path, jobs: int | None, tensorboard: bool) -> None:
    """Train every combination of the settings in GRID, a TOML file, and compare them.

    \b
    Its table [grid] has a list for each setting that varies; the rest is what all runs share, as in train --config:
      epochs = 40
      [grid]
      seed = [0, 1, 2]
      kind = ["aminn", "mlp"]
      model.width = [32, 64, [16, 32]]

    Each run has one thread and a folder named by its settings. Interrupt or kill it at will: the same command
    continues. A run that fails is named, and the others continue. The table at the end is that of `aminn compare`;
    OUT/sweep.json has every figure, OUT/sweep.html the training curves.
    """
    from .run_comparison import compare_runs
    from .sweep import read_grid, run_sweep

    finished, failed = run_sweep(read_grid(grid), data, out, jobs, tensorboard)
    if finished:
        compare_runs(finished, None, out / "sweep.html", out / "sweep.json", [("grid", str(grid)), ("data", str(data))])
    for name, error in failed.items():
        click.echo(f"{name}: {error}", err=True)
    if failed:
        raise click.ClickException(f"{len(failed)} of {len(failed) + len(finished)} runs failed")


@main.command()
@click.option("--data", type=DATA, required=True, help="Data set of the training, or another of the hand.")
@click.option("--run", "runs", type=EXISTING, multiple=True, required=True, help="Checkpoint folder; may be repeated.")
@click.option(
    "--split",
    default="test",
    show_default=True,
    type=click.Choice(["train", "validation", "test", "all"]),
    help="all: every load case, of data that no model was trained on.",
)
@TRAINED_ON
@CALIBRATION
@SENSORS
@click.option("--json", "json_file", type=NEW_FILE, help="Write every figure here, as flat keys.")
def evaluate(
    data: Path,
    runs: tuple[Path, ...],
    split: str,
    trained_on: Path | None,
    calibration: Path | None,
    sensors: str | None,
    json_file: Path | None,
) -> None:
    """Print the figures of trained models beside the analytical model, no motion and the ground truth."""
    from aminn.data.dataset import load_dataset
    from aminn.evaluation.evaluate import evaluate as run
    from aminn.evaluation.evaluate import flat_report, format_table
    from aminn.model.checkpoint import load_checkpoint
    from aminn_base.files import check_outputs, write_json

    check_outputs([json_file], [data, *runs, trained_on, calibration])
    origin = load_dataset(trained_on) if trained_on else None
    checkpoints = [load_checkpoint(r) for r in runs]
    told = with_calibration(with_told(load_dataset(data), sensors), calibration, checkpoints[0])
    result = run(checkpoints, told, split, origin)
    if json_file:
        write_json(json_file, flat_report(result))
    click.echo(format_table(result))
    if json_file:
        click.echo(f"figures: {json_file}")


@main.command()
@click.option("--run", "checkpoint", type=EXISTING, required=True, help="Checkpoint folder.")
@click.option("--data", type=FILE_OR_FOLDER, required=True, help="Pushes of the hand: a table, a bag or a data set.")
@click.option(
    "--map",
    "map_file",
    type=READABLE,
    help="TOML file: names, frames, units and signs that differ from ours.",
)
@click.option("--out", type=NEW_FILE, required=True, help="Write theta here (JSON); a C table beside it, .h.")
@click.option(
    "--prior",
    nargs=3,
    type=click.FloatRange(0, min_open=True),
    metavar="LOG RAD M",
    help="Standard deviations before anything is measured: of logarithms of factors, joint zeros, tip radius.  "
    "[default: 0.3 0.02 0.001]",
)
@click.option(
    "--noise",
    type=click.FloatRange(0),
    default=0.0,
    show_default=True,
    help="How noisy your sensors are, in multiples of docs/evaluation.md's under noisy sensors; 0: not at all.",
)
@click.option(
    "--errors-from",
    type=EXISTING,
    help="Measure the model's own errors on this data set of known hands (simulated with --vary mechanics=...; "
    "the training's will do). Kept in the run, as errors.json.",
)
@click.option("--as-told", is_flag=True, help="Continue where the data look misread: take them as they are.")
@click.option("--page", type=NEW_FILE, help="Write a page with plots here (HTML).")
def calibrate(
    checkpoint: Path,
    data: Path,
    out: Path,
    prior: tuple[float, float, float] | None,
    noise: float,
    errors_from: Path | None,
    as_told: bool,
    page: Path | None,
    map_file: Path | None,
) -> None:
    """Fit a hand's stiffnesses, contacts, joint zeros and tip radius to a few measured pushes.

    Ten pushes in two grasps do well, forty in five better; docs/calibration.md says what to push. Prints the error of
    pushes that theta was not fitted to, before and after, and which parameters the pushes do not determine. Writes
    nothing where theta would make things worse, or where the data look as if read wrongly: sign, units, frames,
    exchanged fingers.
    """
    from aminn.calibration.calibrate import calibrate as run
    from aminn.calibration.calibrate import refusals
    from aminn.calibration.fit import Prior
    from aminn.calibration.pushes import predictor, read_pushes
    from aminn.calibration.store import as_text, errors_of, learn_errors, write_calibration, write_errors
    from aminn.data.dataset import load_dataset
    from aminn.model.checkpoint import load_checkpoint
    from aminn_base.files import check_outputs
    from aminn_table import TableError, read_map

    from .importing import tell_faults

    check_outputs([out, out.with_suffix(".h"), page], [checkpoint, data, errors_from, map_file])
    loaded = load_checkpoint(checkpoint)
    if errors_from:
        click.echo(f"errors: {write_errors(loaded, learn_errors(loaded, load_dataset(errors_from)))}")
    try:
        pushes, notes = read_pushes(data, loaded, read_map(map_file) if map_file else None)
    except TableError as error:
        tell_faults(error, click.echo)
        raise
    for note in notes:
        click.echo(note)
    chosen = Prior(*prior) if prior else Prior()
    found = run(predictor(loaded.model), pushes, chosen, errors_of(loaded), noise, not as_told)
    for reason in refusals(found):
        raise AminnError(f"{data}: {reason}")
    click.echo(as_text(found))
    if page:
        from aminn.pages.calibration import write_calibration_page
        from aminn.pages.provenance import provenance

        write_calibration_page(found, page, provenance([loaded], data))
        click.echo(f"page: {page}")
    for file in write_calibration(out, found, loaded.sha256):
        click.echo(f"theta: {file}")


@main.command()
@click.option("--run", "checkpoint", type=EXISTING, required=True, help="Folder of an AMINN checkpoint.")
@click.option("--data", type=DATA, required=True, help="Data set to draw the golden vectors from.")
@click.option("--out", type=FOLDER, required=True)
@click.option("--prefix", default="aminn_model", show_default=True, help="Symbol prefix and file name of the C model.")
@click.option("--name", help="What the model calls itself, on the target too  [default: the prefix]")
@click.option(
    "--weights",
    type=click.Choice(["float32", "float16", "int8"]),
    default="float32",
    show_default=True,
    help="Type of the weights in flash; float16 halves it, int8 quarters it, and the error is reported.",
)
def export(checkpoint: Path, data: Path, out: Path, prefix: str, name: str | None, weights: str) -> None:
    """Write aminn.onnx, aminn_debug.onnx, the C model, its binary form and golden vectors."""
    from .pipeline import run_export

    for line in run_export(checkpoint, data, out, prefix, weights, name):
        click.echo(line)


@main.command()
@click.argument("table")
@click.option("--run", type=EXISTING, help="Folder of a checkpoint that `aminn train` wrote.")
@click.option("--export", "export_dir", type=EXISTING, help="Folder that `aminn export` wrote.")
@click.option(
    "--engine",
    type=click.Choice(["torch", "onnx", "runtime"]),
    default=None,
    help="PyTorch, ONNX Runtime or the compiled runtime  [default: torch of a run, runtime of an export]",
)
@click.option("--calibration", type=READABLE, help="What `aminn calibrate` found of this very hand.")
@click.option("--map", "map_file", type=READABLE, help="TOML file: names, units and signs that differ from ours.")
@click.option("--threads", type=click.IntRange(1), default=None, help="Cores to use  [default: all]")
@click.option("--out", type=NEW_FILE, help="Write table and predictions here: .csv, .parquet, .h5 or .jsonl.")
def predict(
    table: str,
    run: Path | None,
    export_dir: Path | None,
    engine: str | None,
    calibration: Path | None,
    map_file: Path | None,
    threads: int | None,
    out: Path | None,
) -> None:
    """Predict whether grasps hold, and how far the tool moves, for every row of a table.

    TABLE is a CSV, Parquet, HDF5 or JSON-lines file of states (docs/own-data.md lists the columns), a ROS 2 bag, a data
    set folder, "-" for standard input, or one state as JSON: '{"q": [...], "x_ht": [...], "w_e": [...], "contacts":
    [[...], ...]}'. Without --out predictions are printed as JSON, one line per row.

    The columns are the same whatever evaluates the model. A row that cannot be predicted from stays in its place:
    status and notes say why, its numbers are empty.
    """
    from .predicting import run_prediction

    if (run is None) == (export_dir is None):
        raise click.UsageError("give --run or --export")
    model = run or export_dir
    assert model is not None
    run_prediction(model, table, out, engine, calibration, map_file, threads or 0)


@main.command(cls=Judges)
@click.option("--export", "export_dir", type=EXISTING, required=True, help="Folder that `aminn export` wrote.")
@click.option("--data", type=FILE_OR_FOLDER, required=True, help="Data set, or vector file, to replay.")
@click.option(
    "--build",
    "build_dir",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    help="Compiled runtime: a build folder, or the prefix that it is installed with  [default: the checkout's "
    "build/host, else built from the sources that come along and kept in your cache folder]",
)
@click.option(
    "--samples",
    type=click.IntRange(1),
    default=None,
    help="Replay at least so many of a data set  [default: its test split and others up to 1000, or all]",
)
@click.option("--firmware", is_flag=True, help="Also on the emulated Cortex-M7 (--target cortex_m7).")
@click.option("--target", "targets", multiple=True, help="Also there; may be repeated: cortex_m4, aarch64_gcc_O2, ...")
@click.option("--port", help="Also on a real board: the serial port, Unix socket or tcp:HOST:PORT of its firmware.")
@click.option(
    "--onnx",
    "engine",
    type=click.Choice(["onnxruntime", "openvino", "reference"]),
    default="onnxruntime",
    show_default=True,
    help="What evaluates the ONNX model; reference: the slow evaluator of the package onnx.",
)
@click.option("--show", type=click.IntRange(0), default=3, show_default=True, help="Print so many numbers of a check.")
@click.option("--json", "json_file", type=NEW_FILE, help="Write the figures here, and each number that differs.")
@click.option("--junit", "junit_file", type=NEW_FILE, help="Write a test case for each check, for a build server.")
def verify(
    export_dir: Path,
    data: Path,
    build_dir: Path | None,
    samples: int | None,
    firmware: bool,
    targets: tuple[str, ...],
    port: str | None,
    engine: str,
    show: int,
    json_file: Path | None,
    junit_file: Path | None,
) -> None:
    """Replay a data set through ONNX Runtime and the compiled runtime; fail on a mismatch.

    Every output of every sample is judged: against ONNX Runtime within the limits of docs/export.md, and the runtime's
    replays against one another bit by bit. Exit code 0: all the same; 1: something differs; 3: no answer, since a file
    is damaged or missing.
    """
    from aminn_base.files import check_outputs
    from aminn_export.judge.verdict_report import write_junit, write_verdict

    from .pipeline import run_verify

    check_outputs([json_file, junit_file], [export_dir, data])
    done = run_verify(
        export_dir, data, build_dir, samples, firmware, targets=targets, port=port, show=show, engine=engine
    )
    if json_file:
        write_verdict(json_file, done.report, done.failures)
        click.echo(f"differences: {json_file}")
    if junit_file:
        write_junit(junit_file, "aminn verify", done.cases)
        click.echo(f"test cases: {junit_file}")
    if not done.report["ok"]:
        raise click.ClickException("the runtime does not repeat ONNX Runtime, or the files are not of one model")


@main.command(cls=Judges)
@click.argument("paths", type=FILE_OR_FOLDER, nargs=-1, required=True, metavar="RUN... | FILE...")
@click.option("--data", type=DATA, help="Runs: figures on the test grasps of this data set, not on validation grasps.")
@click.option("--page", type=NEW_FILE, help="Runs: write a page with table and training curves here (HTML).")
@click.option("--json", "json_file", type=NEW_FILE, help="Write the figures here; of files each number that differs.")
@click.option("--show", type=click.IntRange(0), default=10, show_default=True, help="Files: print so many numbers.")
@click.option("--junit", "junit_file", type=NEW_FILE, help="Files: write one test case per output, for a build server.")
def compare(
    paths: tuple[Path, ...],
    data: Path | None,
    page: Path | None,
    json_file: Path | None,
    show: int,
    junit_file: Path | None,
) -> None:
    """Compare trained models (RUN...), or results of a replay (WANT.bin GOT.bin, or MODEL.bin VECTORS.bin RESULTS.bin).

    \b
    Three seeds of each model, and how they learned:
      aminn compare runs/aminn-* runs/mlp-* --page runs.html

    Runs that differ in nothing but the seed make one row, mean and standard deviation; a row is named by the settings
    in which it differs from others. The figures are those on the validation grasps that chose each run.

    Two result files must have the same bits. Results of a vector file may differ from its reference by the limits of
    docs/export.md. Files are told apart by what they hold. Exit code 0: the same; 1: something differs; 3: it cannot
    be told, since a file is damaged or empty. `aminn_compare` does the same without Python.
    """
    folders = [path for path in paths if path.is_dir()]
    if folders and len(folders) < len(paths):
        raise click.UsageError("give folders of runs, or files of a replay, not both")
    if junit_file if folders else data or page:
        raise click.UsageError("--junit is for files of a replay, --data and --page are for runs")
    if folders:
        from .run_comparison import compare_runs

        compare_runs(folders, data, page, json_file)
    else:
        _compare_results(paths, show, json_file, junit_file)


def _compare_results(files: tuple[Path, ...], show: int, json_file: Path | None, junit_file: Path | None) -> None:
    from aminn_base.files import check_outputs
    from aminn_export.judge.compare import compare_files
    from aminn_export.judge.verdict_report import Case, shown, write_junit, write_verdict

    check_outputs([json_file, junit_file], files)
    verdict = compare_files(files)
    for name, value in verdict.figures.items():
        click.echo(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}")
    for line in shown(verdict.failures, show):
        click.echo(line)
    if json_file:
        write_verdict(json_file, verdict.figures | {"ok": not verdict.failures}, verdict.failures)
    if junit_file:
        kinds = dict.fromkeys((*verdict.judged, *(f.kind for f in verdict.failures)))
        cases = [Case(files[-1].name, kind, [f for f in verdict.failures if f.kind == kind]) for kind in kinds]
        write_junit(junit_file, "aminn compare", cases)
    if verdict.failures:
        raise click.ClickException(f"{files[-1]}: {len(verdict.failures)} numbers differ")


@main.command()
@click.option("--data", type=DATA, required=True, help="Data set of the training, or another of the hand.")
@click.option("--run", "runs", type=EXISTING, multiple=True, required=True, help="Checkpoint folder; may be repeated.")
@click.option(
    "--verification",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="`aminn verify --json`.",
)
@click.option(
    "--reports",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("build/reports"),
    show_default=True,
    help="Folder of other reports, whose figures the page lists.",
)
@TRAINED_ON
@SENSORS
@click.option("--out", type=NEW_FILE, default=Path("build/reports/report.html"), show_default=True)
def report(
    data: Path,
    runs: tuple[Path, ...],
    verification: Path | None,
    reports: Path,
    trained_on: Path | None,
    sensors: str | None,
    out: Path,
) -> None:
    """Write the report page: table, signed work, predicted motion, training curves, a grasp under load."""
    from aminn.data.dataset import load_dataset
    from aminn.evaluation.evaluate import evaluate as run
    from aminn.model.checkpoint import load_checkpoint
    from aminn_base.files import check_outputs

    from .pipeline import run_report

    check_outputs([out], [data, *runs, verification, trained_on, *reports.glob("*.json")])
    checkpoints = [load_checkpoint(r) for r in runs]
    differences = read_verification(verification) if verification else {}
    origin = load_dataset(trained_on) if trained_on else None
    told = with_told(load_dataset(data), sensors)
    run_report(run(checkpoints, told, trained_on=origin), checkpoints, differences, data, out, reports)
    click.echo(f"report: {out}")


@main.command()
@click.option("--run", "checkpoint", type=EXISTING, required=True, help="Folder of an AMINN checkpoint.")
@click.option("--data", type=DATA, required=True, help="Data set that the sample is taken from.")
@click.option("--sample", type=click.IntRange(0), required=True, help="Number of the load case in the data set.")
@click.option("--out", type=NEW_FILE, default=None, help="Write the picture here (.png, .svg or .pdf).")
@click.option("--json", "json_file", type=NEW_FILE, default=None, help="Write the numbers here.")
@CALIBRATION
@SENSORS
def explain(
    checkpoint: Path,
    data: Path,
    sample: int,
    out: Path | None,
    json_file: Path | None,
    calibration: Path | None,
    sensors: str | None,
) -> None:
    """Say what the mechanics layer makes of one load case.

    Springs, tendon directions and engagement of each finger, the stiffness K_x with its principal compliances and their
    directions, and the predicted motion beside the simulated one; as text, and as a picture over the hand.
    """
    from aminn.data.dataset import load_dataset
    from aminn.model.checkpoint import load_checkpoint
    from aminn.pages.explain import as_text, draw, explain_sample
    from aminn_base.files import check_outputs, write_json

    check_outputs([out, json_file], [data, checkpoint, calibration])
    run = load_checkpoint(checkpoint)
    told = with_calibration(with_told(load_dataset(data), sensors), calibration, run)
    found = explain_sample(run, told, sample)
    click.echo(as_text(found))
    if json_file:
        write_json(json_file, found.flat())
        click.echo(f"numbers: {json_file}")
    if out:
        draw(found, out)
        click.echo(f"picture: {out}")


@main.command()
@click.option("--run", "runs", type=EXISTING, multiple=True, help="Folder of an AMINN checkpoint; may be repeated.")
@click.option("--export", "exports", type=EXISTING, multiple=True, help="Folder that `aminn export` wrote; likewise.")
@click.option(
    "--data",
    type=DATA,
    multiple=True,
    required=True,
    help="Data set to show grasps of; of a run the one that it was trained on. One for each hand.",
)
@click.option("--grasps", type=click.IntRange(1), default=12, show_default=True, help="Grasps to show of each hand.")
@click.option("--out", type=NEW_FILE, required=True, help="The page (.html).")
def play(runs: tuple[Path, ...], exports: tuple[Path, ...], data: tuple[Path, ...], grasps: int, out: Path) -> None:
    """Write a page to play with: drag a load and see what the model predicts.

    One HTML file that needs no server and no network: the runtime is compiled to WebAssembly (clang, lld and wasi-libc
    must be installed), the model and recorded grasps are in it. Give --run or --export, for several hands repeatedly.
    """
    from .play import play as write

    if not runs and not exports:
        raise click.UsageError("give a model: --run RUN or --export FOLDER")
    for line in write(out, runs, exports, data, grasps):
        click.echo(line)
    click.echo(f"page: {out} ({out.stat().st_size / 1e6:.1f} MB)")


@main.group(cls=Commands)
def hand() -> None:
    """Describe a hand of your own."""


@hand.command()
@click.argument("file", type=READABLE)
@click.option(
    "--pinch",
    default=0.5,
    show_default=True,
    type=click.FloatRange(0, min_open=True),
    help="Mean force of a contact, N.",
)
@click.option("--grasps", default=16, show_default=True, type=click.IntRange(1), help="Grasps to try it with.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0))
@click.option("--picture", type=NEW_FILE, help="Draw joints, axes and names here (.png, .svg or .pdf).")
@click.option("--json", "json_file", type=NEW_FILE, help="Write the figures here, as flat keys.")
def check(file: Path, pinch: float, grasps: int, seed: int, picture: Path | None, json_file: Path | None) -> None:
    """Say what a hand file (TOML) and its MJCF describe, and compare that with the engine.

    Prints each branch's joints, axes, springs, servos, tendons and couplings; refuses by name what the statics cannot
    hold; then moves a ball in light grasps and says how far theory and simulation are apart.
    """
    from aminn_base.files import write_json
    from aminn_base.progress import progress_bar
    from aminn_sim.hand_check import check as run

    with progress_bar("acceptance", grasps, "grasp", delay=1.0, leave=False) as bar:
        done = run(file, pinch, grasps, seed, picture, lambda n: bar.update(n - bar.n), click.echo)
    if json_file:
        write_json(json_file, done.figures())
        click.echo(f"figures: {json_file}")
    if done.problem:
        raise click.ClickException(f"{file}: {done.problem}")
    click.echo("accepted")


@hand.command()
@click.argument("source", type=FILE_OR_FOLDER, metavar="HAND")
@click.option("--out", type=NEW_FILE, help="Write it here instead (.csv).")
def columns(source: Path, out: Path | None) -> None:
    """Print every column of a table of pushes in a hand, with unit and meaning, as a CSV without rows.

    HAND is a hand file (.toml), a run or a data set. Fill in rows below, and `aminn import` takes it; what is optional
    may stay empty. docs/own-data.md says more.
    """
    from aminn_base.files import check_outputs, write_atomically
    from aminn_table import template

    from .importing import hand_of

    check_outputs([out], [source])
    of, _ = hand_of(source, None) if source.is_file() else hand_of(None, source)
    if out is None:
        click.echo(template(of), nl=False)
        return
    if out.suffix.lower() != ".csv":
        raise AminnError(f"{out}: the template is CSV; give the file an end of .csv")
    write_atomically(out, template(of).encode())
    click.echo(f"columns: {out}")


@hand.command()
@click.argument("file", type=READABLE)
@click.option(
    "--out", type=FOLDER, required=True, help="Folder for the model, a report, and the hand file that names it."
)
def convert(file: Path, out: Path) -> None:
    """Make a model that the simulation's MuJoCo takes of one for a newer MuJoCo, or of a URDF.

    FILE is a hand file (.toml) or a model. The current MuJoCo (pip install 'aminn[mujoco]') compiles it; the outcome is
    written again, compared with the original and reported. Refuses by name what would be lost: a plugin actuator, a
    spring that is not linear, a fingertip that touches nothing.
    """
    from aminn_sim.convert import convert_to

    made = convert_to(file, out, click.echo)
    click.echo(f"continue with {made}")


if __name__ == "__main__":
    main()
