"""The stages of the path as single calls: the one place that knows simulation, trainer and exporter.

The other packages are imported where they are used: who trains needs no exporter, who exports no simulator.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import MEASURED, is_measured
from aminn.data.slides import slid_cases
from aminn.evaluation.evaluate import Evaluation, names_of, truth
from aminn.evaluation.metrics import pose_error, pose_size, refusal_curve, reliability, signed_work
from aminn.model.checkpoint import Checkpoint
from aminn_base.errors import OutdatedError

if TYPE_CHECKING:
    from aminn.pages.grasp_picture import GraspPicture
    from aminn_export.judge.verify import Verification

T = TypeVar("T")


def anew_if_outdated(folder: Path, work: Callable[[], T]) -> T:
    """Do `work`, which fills a build folder; what an earlier version of the program left there is made again.

    Any other error, a full disk or another program in the folder, leaves the folder alone.
    """
    existed = folder.exists()
    try:
        return work()
    except OutdatedError as error:
        if not existed:
            raise
        click.echo(f"{folder} is made again: {error}")
        shutil.rmtree(folder)
        return work()


def run_export(
    run: Path,
    data: Path,
    out: Path,
    prefix: str = "aminn_model",
    weights: str = "float32",
    name: str | None = None,
) -> list[str]:
    """Export the checkpoint in folder `run` to `out`, golden vectors and input ranges from `data`; lines to print."""
    from aminn_export.export import export

    return export(run, out, prefix, data, weights, name)


def run_verify(
    exported: Path,
    data: Path,
    build: Path | None,
    samples: int | None = None,
    firmware: bool = False,
    echo: Callable[[str], object] = click.echo,
    targets: tuple[str, ...] = (),
    port: str | None = None,
    show: int = 3,
    engine: str = "onnxruntime",
) -> Verification:
    """Replay `data` through ONNX Runtime and the compiled runtime; flat figures and what differs. `echo` prints.

    `targets` are further machines of `aminn_export.replay.targets`, `port` is a serial port or socket with a board
    behind it; another `engine` of `aminn_export.replay.engines` stands in for ONNX Runtime.
    """
    from aminn_export.judge.verify import run_verification, tell

    targets = (*targets, *(("cortex_m7",) if firmware else ()))
    done = run_verification(exported, data, build, samples, targets, port, engine)
    tell(done, echo, show)
    return done


def _report_data(labels: dict, manifest: dict) -> dict[str, float | int | str | None]:
    """What the page says of the data."""
    whole = {
        "simulator": MEASURED if is_measured(manifest) else manifest.get("simulator"),
        "seed": manifest.get("seed"),
    }
    whole |= {"grasps, in all": manifest["n_grasps"], "load cases, in all": manifest["n_samples"]}
    return whole | {f"test split: {name.replace('_', ' ')}": value for name, value in labels.items()}


def _example_grasp(result: Evaluation) -> GraspPicture:
    """A stable test case that moves visibly: the one whose motion is nearest to the 95th percentile."""
    from aminn.pages.grasp_picture import GraspPicture, joints_under_load, tool_of

    data, s = result.data, result.data.samples
    held = np.flatnonzero(s["stable"] > 0)
    size = pose_size(s["dx_ht"][held], data.hand.length_m)
    row = int(held[np.argmin(np.abs(size - np.quantile(size, 0.95)))])
    name, geoms, size_m = tool_of(data, row)
    return GraspPicture(
        hand=data.hand,
        tool_family=name,
        tool_geoms=geoms,
        tool_size_m=size_m,
        q_after=joints_under_load(data, row),
        predicted_dx=result.predictions["aminn"].dx[row] if "aminn" in result.predictions else None,
        **{name: s[name][row] for name in ("q", "x_ht", "dx_ht", "w_e", "contacts")},
    )


def _slide_reliability(result: Evaluation, names: list[str]) -> dict[str, list[dict[str, float]]]:
    """How often contacts slid by p_slide, of stable cases; nothing of measured data, which do not tell."""
    if result.data.measured:
        return {}
    held = np.flatnonzero(result.data.samples["stable"] > 0)
    slid = slid_cases(result.data.take(held))
    found = {name: result.predictions[name].p_slide for name in names}
    return {name: reliability(p[held], slid) for name, p in found.items() if p is not None}


def _refusal(result: Evaluation, name: str) -> dict[str, list[float]]:
    """The error of stable cases that is left where a model refuses what it is least sure of."""
    held, length_m = np.flatnonzero(result.data.samples["stable"] > 0), result.data.hand.length_m
    p = result.predictions[name].take(held)
    return refusal_curve(pose_error(p.dx, result.data.samples["dx_ht"][held], length_m), p.doubt(length_m))


def run_report(
    result: Evaluation,
    checkpoints: list[Checkpoint],
    differences: dict,
    data: Path,
    out: Path,
    reports: Path | None = None,
) -> None:
    """Write the report page of an evaluation to `out`; `differences` is what `run_verify` returned, or empty.

    The page lists the figures of all reports in folder `reports`. `data` is where the evaluated data are.
    """
    from aminn.pages.provenance import provenance
    from aminn.pages.report import ReportInputs, read_reports, write_report

    s = result.data.samples
    held = s["stable"] > 0
    learned = names_of(checkpoints)
    probabilities = {name: p for name in learned if (p := result.predictions[name].p_stable) is not None}

    counted = {name: (result.predictions[name].dx, result.predictions[name].stable) for name in learned}
    counted["label"] = (s["dx_ht"], held)

    def work(full: bool) -> dict[str, NDArray[np.float64]]:
        return {name: signed_work(s["w_e"], dx, full)[where] for name, (dx, where) in counted.items()}

    inputs = ReportInputs(
        title="AMINN: grasp stability and in-hand displacement",
        rows=[{"model": name} | figures for name, figures in result.table.items()]
        + [{"model": "label"} | truth(result)],
        signed_work=work(full=True),
        signed_work_translational=work(full=False),
        true_dx=s["dx_ht"][held],
        predicted_dx={name: result.predictions[name].dx[held] for name in (*learned, "analytical")},
        histories={name: c.meta["history"] for name, c in zip(learned, checkpoints, strict=True)},
        operating={n: (c.meta["operating_curve"], c.meta["tau"]) for n, c in zip(learned, checkpoints, strict=True)},
        reliability={name: reliability(p, held) for name, p in probabilities.items()},
        slide_reliability=_slide_reliability(result, learned),
        refusal={name: _refusal(result, name) for name in learned},
        grasp=_example_grasp(result),
        verification=differences,
        reports=read_reports(reports, out) if reports else {},
        notes=result.notes,
        provenance=provenance(checkpoints, data) | {"load cases": len(result.data), "split": result.split},
        dataset=_report_data(result.labels, result.data.manifest),
    )
    write_report(inputs, out)
