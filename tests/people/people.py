"""Three minutes in each role, from a fresh clone, and in which forms people get the project (`make people`).

python tests/people/people.py --report build/reports/people.json

Follows each section of docs/start.md to the letter in a clone of its own, with what downloads leave: packages, but
nothing compiled. Then it takes the README's commands in their order, with fewer grasps and epochs. Tests have put
package forms, examples and snippets in the report before. Figures of other reports are copied where these are there.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
from followed import ROOT, blocks, follow, make_tree, roles, run
from wheelhouse import borrowing

from aminn.data.dataset import load_dataset
from aminn_base.files import write_json
from aminn_base.read import read_json
from aminn_table import write_table

Figures = dict[str, float | int | str | bool | None]
BUDGET_S = 180
DOWNLOADED = ("apt-*", "venv", "mujoco")
"""Stamps of what set-up downloads."""
SMALLER = (("--grasps 1000 --cases 16", "--grasps 96 --cases 8"), (" train ", " train --epochs 8 "))
"""The README's commands, at a size that takes minutes."""
GRID = 'epochs = 2\n[grid]\nkind = ["aminn", "mlp"]\n'
LAB = ".venv/bin/aminn simulate --out build/lab --grasps 4 --cases 6 --vary mechanics=0.4 --set grasps_per_hand=4"
FORMS = {
    "used": "built by its own tool outside the tree, and a program with it run",
    "compiled": "its tool is in no package registry: its sources are compiled as it lays them out",
    "checked": "its tool is in no package registry: its files are compared with the tree and the rules of the format",
}
"""What a package form's figure means."""
COPIED = {
    "wheels": ("sdist_bytes", "python_3_11_steps", "python_3_12_steps", "python_3_13_steps", "data_same_bytes"),
    "pages": ("pages", "widths", "failures"),
    "play": ("golden_vectors", "same_bits_as_c", "phone_pixels", "wide_pixels"),
}
"""Figures of other reports."""


def clone(folder: Path) -> Path:
    """A clone of what is committed here, with what downloads leave."""
    subprocess.run(["git", "clone", "--quiet", ROOT, folder], check=True)
    stamps = folder / "build" / "stamps"
    stamps.mkdir(parents=True)
    borrowing(folder / ".venv")
    (folder / "build" / "mujoco").symlink_to(ROOT / "build" / "mujoco")
    for pattern in DOWNLOADED:
        for stamp in (ROOT / "build" / "stamps").glob(pattern):
            (stamps / stamp.name).touch()
    return folder


def three_minutes(role: str, section: str, folder: Path) -> Figures:
    """Seconds of each step of a section, and the processor's in all."""
    figures: Figures = {}
    total, count, before = 0.0, 0, os.times()
    for step, seconds in follow(section, folder):
        total, count = total + seconds, count + 1
        figures[f"{role}_{count}_{step.name}_s"] = round(seconds, 1)
        click.echo(f"{role}: {seconds:6.1f} s  {step.command}")
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return figures | {f"{role}_s": round(total, 1), f"{role}_cpu_s": round(cpu, 1), f"{role}_commands": count}


def readme_commands(folder: Path) -> Figures:
    """How many of the README's commands were run, in their order."""
    lines = [line for block in blocks((ROOT / "README.md").read_text()) for line in block.splitlines()]
    lines = [line.split("  #")[0].strip() for line in lines if line.startswith(".venv/bin/aminn ")]
    tree = make_tree(folder)
    (tree / "grid.toml").write_text(GRID)
    run(LAB, tree)
    lab = load_dataset(tree / "build" / "lab")
    names = ("grasp_id", "q", "x_ht", "w_e", "contacts", "dx_ht", "stable")
    write_table(tree / "pushes.csv", lab.hand, {name: lab.samples[name] for name in names})
    for version in ("before", "after"):
        results = f"results_{version}.bin"
        run(f"build/host/runtime/aminn_replay tests/golden/aminn_model.bin tests/golden/golden.bin {results}", tree)
    for line in lines:
        start = time.monotonic()
        for whole, small in SMALLER:
            line = line.replace(whole, small)
        run(line, tree)
        click.echo(f"README: {time.monotonic() - start:6.1f} s  {line}")
    return {"readme_commands_run": len(lines)}


def installed_examples(work: Path) -> Figures:
    """The two that the C test of the install builds and runs."""
    given = {"BUILD": ROOT / "build" / "host", "SOURCE": ROOT, "WORK": work, "GENERATOR": "Ninja", "C_COMPILER": "cc"}
    script = ROOT / "tests" / "runtime" / "install_test.cmake"
    command = ["cmake", *(f"-D{name}={value}" for name, value in given.items()), "-P", script]
    subprocess.run(command, check=True, capture_output=True)
    return {"example_controller": True, "example_planner": True, "package_cmake": "used"}


def copied(reports: Path, missed: list[str]) -> Figures:
    """What other targets have measured."""
    figures: Figures = {}
    for name, keys in COPIED.items():
        file = reports / f"{name}.json"
        if not file.is_file():
            missed.append(f"no {file.name}: make {name}")
            continue
        report = read_json(file, "a report")
        figures |= {f"{name}_{key}": report.get(key) for key in keys}
        if report.get("aims_missed") or report.get("failures"):
            missed.append(f"{file.name}: {report['aims_missed'] or report['failures']}")
    return figures


@click.command()
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(report: Path) -> None:
    """Add these figures to the report; `aims_missed` names what took longer, or is not there."""
    figures: Figures = read_json(report, "a report") if report.is_file() else {}
    missed: list[str] = []
    figures |= {"budget_s": BUDGET_S, "load_average": round(os.getloadavg()[0], 1), "processors": os.cpu_count()}
    with tempfile.TemporaryDirectory(prefix="aminn-people-") as folder:
        for role, section in roles((ROOT / "docs" / "start.md").read_text()).items():
            figures |= three_minutes(role, section, clone(Path(folder) / role))
            if figures[f"{role}_s"] > BUDGET_S:
                missed.append(f"{role}: {figures[f'{role}_s']} s, {figures[f'{role}_cpu_s']} of them of the processor")
        (Path(folder) / "readme").mkdir()
        figures |= readme_commands(Path(folder) / "readme") | installed_examples(Path(folder) / "installed")
    figures |= copied(report.parent, missed)
    forms = [str(value) for key, value in figures.items() if re.fullmatch(r"package_\w+", key)]
    figures |= {f"packages_{how}": forms.count(how) for how in FORMS}
    figures["examples_run"] = sum(key.startswith("example_") for key in figures)
    figures["snippets_run"] = sum(int(value) for key, value in figures.items() if key.startswith("snippets_in_"))
    figures["aims_missed"] = "; ".join(missed)
    write_json(report, figures)
    click.echo(f"missed: {figures['aims_missed'] or 'nothing'}\nreport: {report}")


if __name__ == "__main__":
    sys.exit(main())
