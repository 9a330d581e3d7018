"""Every hand that comes with the project through everything: build/reports/hands.json (`make hands`).

Each description is compared with the engine; then the hand goes the whole path of `make demo` at a smaller scale. The
closure of its data is compared with finite differences of its kinematics, the compiled runtime with ONNX Runtime on
this machine and on the emulated Cortex-M7.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import Dataset
from aminn.evaluation.evaluate import format_table
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically, write_json
from aminn_base.program import Messages
from aminn_hand import Hand
from aminn_rt.sources import runtime_source

from .whole_path import Stopwatch, whole_path

Array = NDArray[np.float64]
GRASPS, CASES = 250, 16
STEP_RAD = 1e-5
CORE = "cortex_m7"
CLOSURE_LIMIT = 1e-6


def closure_error(dataset: Dataset, most: int = 200) -> float:
    """Largest error of j_q against central differences of the fingertips' ways, relative to the largest entry."""
    hand = Hand.from_dict(dataset.manifest["hand"])
    s, worst, size = dataset.samples, 0.0, 0.0
    for row in range(0, len(dataset), max(1, len(dataset) // most)):
        q, contacts, j_q = (s[name][row].astype(float) for name in ("q", "contacts", "j_q"))
        for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
            if contacts[b, 0] == 0:
                continue
            own = q[at]
            _, _, turn, origin = branch.pose(own)
            held = turn.T @ (contacts[b, 1:4] - origin)
            for c in range(len(own)):
                step = np.eye(len(own))[c] * STEP_RAD
                way = (branch.moved(own + step, held) - branch.moved(own - step, held)) / (2 * STEP_RAD)
                column = j_q[b, :, c - len(own)]
                worst, size = max(worst, float(np.abs(column + way).max())), max(size, float(np.abs(way).max()))
    return worst / size


def sizes(exported: Path, work: Path) -> dict[str, Any]:
    """What the runtime costs on the Cortex-M7 with this model, `cortex_m7_...`."""
    from aminn_export.replay.firmware import build_firmware, run_firmware

    image = build_firmware(exported, work / "firmware", target=CORE)
    run = run_firmware(image, exported / "golden.bin", work / "results.bin", CORE)
    kept, out = work / "firmware.json", work / "size.json"
    write_json(kept, run)
    command = [sys.executable, str(runtime_source() / "tools" / "size_report.py"), f"{CORE}={image.parent}:{kept}"]
    command += ["--model", str(exported / "aminn_model.c"), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise AminnError(f"size_report.py: {done.stderr.strip()}")
    figures = json.loads(out.read_text())
    return {k: v for k, v in figures.items() if k.startswith(f"{CORE}_")}


def one_hand(file: Path, build: Path, pinch_N: float, grasps: int, cases: int, watch: Stopwatch) -> dict[str, Any]:
    """All figures of one hand; "missed" says which aims it does not meet. One that is not accepted goes no further."""
    from aminn_sim.hand_check import check

    folder = build / "hands" / file.stem
    described = watch.run("check", f"{file.stem}: compare the description with the engine",
                          lambda: check(file, pinch_N, echo=click.echo))  # fmt: skip
    figures: dict[str, Any] = {k: v for k, v in described.figures().items() if k != "hand"}
    if described.problem:
        click.echo(f"{file.stem} goes no further: {described.problem}")
        return figures | {"missed": described.problem}
    missed = []
    done = whole_path(folder, grasps, cases, build / "host", watch, file)
    click.echo("\n".join(["", format_table(done.result), *done.lines]))
    figures |= done.figures() | watch.seconds | {"closure_relative_error": closure_error(done.dataset)}
    figures |= sizes(folder / "export", folder)
    if not done.replay["ok"]:
        missed.append("the runtime does not repeat ONNX Runtime")
    if figures["closure_relative_error"] > CLOSURE_LIMIT:
        missed.append("the closure differs from finite differences")
    for figure in ("relative_error_median", "rmse_pose_all"):
        if not figures[f"aminn_{figure}"] < figures[f"mlp_{figure}"]:
            missed.append(f"{figure} of AMINN is not below the MLP's")
    return figures | {"missed": "; ".join(missed)}


def table(found: dict[str, dict[str, Any]]) -> str:
    """Markdown: a row for each hand that went the whole path."""
    columns = {
        "joints": lambda f: str(f["joints"]),
        "formula on small loads": lambda f: f"{f['preloaded_median']:.1%} / {f['formula_median']:.1%}",
        "stable cases": lambda f: f"{f['stable_share']:.0%} of {f['n_samples']}",
        "F1, AMINN / MLP / analytical": lambda f: _three(f, "f1", "{:.3f}"),
        "relative error, median": lambda f: _three(f, "relative_error_median", "{:.3f}"),
        "RMSE_pose, all stable": lambda f: _three(f, "rmse_pose_all", "{:.4f}"),
        "closure": lambda f: f"{f['closure_relative_error']:.0e}",
        "runtime to ONNX": lambda f: f"{f[f'{CORE}_dx_relative_median']:.0e}",
        "Cortex-M7: instructions": lambda f: str(f[f"{CORE}_instructions_per_prediction"]),
        "library, B": lambda f: str(f[f"{CORE}_library_text_bytes"]),
        "context, B": lambda f: str(f[f"{CORE}_context_bytes"]),
    }
    rows = [["hand", *columns], ["---"] * (1 + len(columns))]
    rows += [[name, *(cell(f) for cell in columns.values())] for name, f in found.items() if "n_samples" in f]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _three(figures: dict[str, Any], name: str, form: str) -> str:
    return " / ".join(form.format(figures[f"{model}_{name}"]) for model in ("aminn", "mlp", "analytical"))


@click.command(cls=Messages)
@click.option("--build", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--pinch", default=0.5, show_default=True, help="Mean force of a contact in the acceptance test, N.")
@click.option("--grasps", type=click.IntRange(1), default=GRASPS, show_default=True, help="Grasps a hand.")
@click.option("--cases", type=click.IntRange(1), default=CASES, show_default=True, help="Loads a grasp.")
@click.option("--only", multiple=True, help="Names of hand files; default: all that come along.")
def main(build: Path, pinch: float, grasps: int, cases: int, only: tuple[str, ...]) -> None:
    """Take every hand that comes along from its description to a replayed C model."""
    from aminn_sim.open_hand import shipped_hands

    files = [file for file in shipped_hands() if not only or file.stem in only]
    if not files:
        there = ", ".join(f.stem for f in shipped_hands())
        raise AminnError(f"no hand file is called {', '.join(only)}; there are {there}")
    found: dict[str, dict[str, Any]] = {}
    for file in files:
        try:
            found[file.stem] = one_hand(file, build, pinch, grasps, cases, Stopwatch())
        except AminnError as error:
            found[file.stem] = {"missed": str(error)}
            click.echo(f"{file.stem}: {error}")
        flat = {f"{name}_{key}": value for name, f in found.items() for key, value in f.items() if key != "missed"}
        flat["aims_missed"] = "; ".join(f"{name}: {f['missed']}" for name, f in found.items() if f["missed"])
        write_json(build / "reports" / "hands.json", flat)
    text = table(found)
    write_atomically(build / "reports" / "hands.md", f"{text}\n".encode())
    click.echo(f"\n{text}\n\naims missed: {flat['aims_missed'] or 'none'}")


if __name__ == "__main__":
    main()
