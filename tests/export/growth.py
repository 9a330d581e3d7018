"""What a prediction costs by the size of the hand and of the networks.

    growth.py --json build/reports/cost.json

Random models with contacts that slide and sensors: of hands of 2 to 5 branches, three joints and a cable each, and of
the widths of `make frontier`, on three such branches. Of each: instructions on a Cortex-M7 (qemu), memory, time on this
machine. How fast they grow: the slope of log(cost) over log(branches), and over log(width).
"""

from __future__ import annotations

import json
import statistics
import tempfile
from pathlib import Path

import click
import numpy as np
from hands import made_up, random_model, random_states

from aminn_app.study import BASE, WIDTHS
from aminn_base.files import write_atomically, write_json
from aminn_base.program import Messages
from aminn_export.export import write_model_files
from aminn_export.files.bin_model import model_crc
from aminn_export.files.layout import Widths
from aminn_export.judge.cost import ROOT, Subject, on_cortex_m7, time_of, timed_program
from aminn_export.samples.golden import GOLDEN_FILE
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import write_vectors
from aminn_hand.hand import OUTPUTS

BRANCHES = (2, 3, 4, 5)
USUAL_BRANCHES = 3
USUAL_WIDTHS = (*BASE.model.width, BASE.model.contact_width, BASE.model.classifier_width)
EVEN_WIDTHS = [widths for widths in WIDTHS if widths[0] == widths[1]]
SAMPLES, TURNS = 48, 7
COSTS = ("instructions", "us")
LIMITS = {"branches": 1.0, "width": 2.0}
"""Of the slopes."""
Figures = dict[str, float | int | str]


def subject(name: str, branches: int, widths: tuple[int, int, int, int], work: Path) -> Subject:
    """The files of a random model, with states to predict."""
    hand = made_up((3,) * branches, (1,) * branches, f"{branches}_branches")
    *trunks, contacts, classifier = widths
    model = random_model(hand, slides=True, sensing=True, widths=Widths(contacts, *trunks, classifier))
    inputs = random_states(hand, SAMPLES)
    folder = work / name
    folder.mkdir()
    write_model_files(model, folder, "aminn_model")
    found = Reference(model)(inputs)
    outputs = {output: found[output] for output in OUTPUTS}
    write_vectors(folder / GOLDEN_FILE, inputs, outputs, outputs, model_crc(model))
    rows = np.concatenate([value.reshape(SAMPLES, -1) for value in inputs.values()], 1)
    write_atomically(folder / "states.bin", rows.astype("<f4").tobytes())
    return Subject(name, ROOT, folder, folder / GOLDEN_FILE)


def slope(sizes: list[int], costs: list[float]) -> float:
    """Of log(cost) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def growth(work: Path) -> Figures:
    """Figures of every model, and the slopes."""
    wanted = {f"{b}_branches": (b, USUAL_WIDTHS) for b in BRANCHES}
    wanted |= {f"width_{widths[0]}": (USUAL_BRANCHES, widths) for widths in EVEN_WIDTHS}
    found = [subject(name, *size, work) for name, size in wanted.items()]
    figures: Figures = {}
    for one in found:
        click.echo(f"{one.name}: Cortex-M7")
        figures |= on_cortex_m7(one, work)
    programs = {one.name: timed_program(one, "avx512", work) for one in found}
    times: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(TURNS):
        for name, program in programs.items():
            times[name].append(time_of(program, work / name / "states.bin"))
    figures |= {f"{name}_us": statistics.median(values) for name, values in times.items()}
    for cost in COSTS:
        of_branches = [float(figures[f"{b}_branches_{cost}"]) for b in BRANCHES]
        figures[f"branches_{cost}_slope"] = slope(list(BRANCHES), of_branches)
        of_width = [float(figures[f"width_{w[0]}_{cost}"]) for w in EVEN_WIDTHS]
        figures[f"width_{cost}_slope"] = slope([w[0] for w in EVEN_WIDTHS], of_width)
    missed = [f"{of}_{cost}_slope" for of, most in LIMITS.items() for cost in COSTS
              if float(figures[f"{of}_{cost}_slope"]) > most]  # fmt: skip
    return {f"growth_{name}": value for name, value in figures.items()} | {"growth_aims_missed": ", ".join(missed)}


def table(figures: Figures) -> str:
    """The table of docs/runtime.md."""
    head = ("model", "multiply-accumulates", "instructions, Cortex-M7", "host, us", "context, B", "worst stack, B")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name in [f"{b}_branches" for b in BRANCHES] + [f"width_{w[0]}" for w in EVEN_WIDTHS]:
        cells = [figures[f"growth_{name}_{key}"] for key in ("multiply_accumulates", "instructions")]
        cells += [f"{figures[f'growth_{name}_us']:.2f}"]
        cells += [figures[f"growth_{name}_{key}"] for key in ("context_bytes", "stack_bytes")]
        lines.append(f"| {name.replace('_', ' ')} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


@click.command(cls=Messages)
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(json_file: Path) -> None:
    """Measure how cost grows; adds to the figures that are there."""
    with tempfile.TemporaryDirectory(prefix="aminn-growth-") as folder:
        figures = growth(Path(folder))
    before = json.loads(json_file.read_text()) if json_file.is_file() else {}
    write_json(json_file, before | figures)
    click.echo(table(figures))
    for name, value in figures.items():
        if name.endswith(("_slope", "_missed")):
            click.echo(f"{name} {value:.3f}" if isinstance(value, float) else f"{name} {value}")


if __name__ == "__main__":
    main()
