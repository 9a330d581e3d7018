"""`make wheels`: sdist and wheel built and used outside the tree, with the simulation, on every Python that we name.

Torch is some hundred megabytes a Python: the environment of constraints.txt lends its packages to its own Python; on
the others what needs no torch is tried, with the other requirements at the same versions. Every environment is new.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import click
from wheelhouse import GOLDEN, ROOT, borrowing, build, checked, install

from aminn_base.files import write_json

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OWN = f"{sys.version_info.major}.{sys.version_info.minor}"
PYTHONS = [c.rpartition(" :: ")[2] for c in PROJECT["classifiers"] if re.search(r":: Python :: 3\.\d+$", c)]
NEEDS_TORCH = {"onnx", "onnxruntime", "onnxscript", "safetensors", "tensorboard", "torch"}
"""Requirements of parts that compute with torch."""
SIMULATED = ["--grasps", "48", "--cases", "4", "--seed", "3"]
GATED = "import aminn_table, aminn_hand, aminn_sim, sys; assert 'torch' not in sys.modules"
RUNTIME = """
from pathlib import Path
from aminn_hand.hand import Hand
from aminn_rt.compiled import runtime, runtime_for
from aminn_sim.open_hand import open_hand, shipped_hands
assert runtime().self_test(Path("golden/aminn_model.bin").read_bytes()) == 0
other = next(open_hand(file).hand.dims for file in shipped_hands() if file.stem == "gripper")
assert runtime_for(other).dims == other
"""
WITHOUT_TORCH: dict[str, list[str]] = {
    "imports": ["python", "-c", GATED],
    "version": ["aminn", "--version"],
    "simulate": ["aminn", "simulate", "--out", "data", *SIMULATED],
    "card": ["aminn", "card", "--data", "data"],
    "gallery": ["aminn", "gallery", "--data", "data", "--count", "2"],
    "runtime_of_another_hand": ["python", "-c", RUNTIME],
}
WITH_TORCH: dict[str, list[str]] = {
    "hand_columns": ["aminn", "hand", "columns", "data", "--out", "pushes.csv"],
    "train": ["aminn", "train", "--data", "data", "--out", "run", "--epochs", "2", "--no-tensorboard"],
    "evaluate": ["aminn", "evaluate", "--data", "data", "--run", "run"],
    "report": ["aminn", "report", "--data", "data", "--run", "run", "--out", "report.html"],
    "predict": ["aminn", "predict", "--run", "run", "data", "--out", "predictions.csv"],
    "export": ["aminn", "export", "--run", "run", "--data", "data", "--out", "export"],
    "verify": ["aminn", "verify", "--export", "export", "--data", "data"],
    "firmware": ["aminn", "verify", "--export", "export", "--data", "data", "--samples", "20", "--firmware"],
}


def find_python(version: str) -> str | None:
    """A Python of this version, `pyenv`'s included."""
    kept = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    places = [sys.executable if version == OWN else None, shutil.which(f"python{version}"), *map(str, kept)]
    for python in filter(None, places):
        said = subprocess.run([python, "-c", "import sys; print(sys.version)"], capture_output=True, text=True)
        if said.stdout.startswith(f"{version}."):
            return python
    return None


def fresh(folder: Path, python: str) -> Path:
    """A new environment with the requirements of what needs no torch, at the versions of constraints.txt."""
    checked([python, "-m", "venv", folder], folder.parent)
    wanted = [r for r in PROJECT["dependencies"] if re.split("[<>=]", r)[0] not in NEEDS_TORCH]
    wanted += PROJECT["optional-dependencies"]["mujoco"]
    new = folder / "bin" / "python"
    pip = [new, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    checked([*pip, "install", "-c", ROOT / "constraints.txt", *wanted], folder.parent)
    return new


def wheel_for(sdist: Path, python: Path, out: Path) -> Path:
    """The wheel that pip builds from the sdist in an environment of its own, with the simulation."""
    pip = [python, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    settings = ["AMINN_SIM=ON", f"AMINN_MUJOCO={ROOT / 'build' / 'mujoco'}"]
    options = [f"--config-settings=cmake.define.{setting}" for setting in settings]
    checked([*pip, "wheel", "--no-deps", "--wheel-dir", out, *options, sdist], out.parent)
    return next(out.glob("*.whl"))


def content(folder: Path) -> str:
    """SHA-256 of the shards of a data set."""
    digest = hashlib.sha256()
    for file in sorted(folder.glob("*.h5")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def tour(version: str, python: str, sdist: Path, work: Path) -> dict[str, object]:
    """Build, install and use on one Python; figures, and what failed with what it said."""
    own = version == OWN
    new = borrowing(work / "env") if own else fresh(work / "env", python)
    start = time.monotonic()
    wheel = wheel_for(sdist, Path(sys.executable) if own else new, work / "dist")
    figures: dict[str, object] = {"wheel_s": time.monotonic() - start, "wheel_bytes": wheel.stat().st_size}
    aminn = install(wheel, new)
    shutil.copytree(GOLDEN, work / "golden")
    failed = {}
    for name, words in (WITHOUT_TORCH | (WITH_TORCH if own else {})).items():
        click.echo(f"Python {version}: {name}")
        try:
            said = checked([aminn.with_name(words[0]), *words[1:]], work, work / "home")
            if name == "version":
                figures["simulates_on"] = said.splitlines()[-1]
        except AssertionError as error:
            failed[name] = str(error)
            click.echo(str(error), err=True)
    return figures | {
        "steps": len(WITHOUT_TORCH) + own * len(WITH_TORCH),
        "failed": " ".join(failed),
        "data_sha256": content(work / "data"),
    }


@click.command()
@click.option("--json", "report_file", type=click.Path(path_type=Path), required=True)
@click.option("--python", "versions", multiple=True, type=click.Choice(PYTHONS), default=PYTHONS, help="These alone.")
def main(report_file: Path, versions: tuple[str, ...]) -> None:
    """Write the figures of every Python that is here; fail where a step failed."""
    report: dict[str, object] = {"machine_built_for": "x86_64", "machine_described_only": "aarch64"}
    missed, shards = [], {}
    with tempfile.TemporaryDirectory(prefix="aminn-wheels-") as folder:
        (Path(folder) / "dist").mkdir()
        sdist, _ = build(Path(folder) / "dist", "AMINN_SIM=OFF")
        report["sdist_bytes"] = sdist.stat().st_size
        for version in versions:
            name = f"python_{version.replace('.', '_')}"
            python = find_python(version)
            if python is None:
                report[f"{name}_tried"] = False
                missed.append(f"no Python {version} here")
                continue
            work = Path(folder) / name
            work.mkdir()
            figures = tour(version, python, sdist, work)
            shards[version] = figures["data_sha256"]
            missed += [f"Python {version}: {step}" for step in str(figures["failed"]).split()]
            report |= {
                f"{name}_{key}": value
                for key, value in ({"tried": True, "with_torch": version == OWN} | figures).items()
            }
    report["data_same_bytes"] = len(set(shards.values())) == 1
    report["aims_missed"] = "; ".join(missed)
    write_json(report_file, report)
    click.echo(json.dumps(report, indent=2))
    if missed or not report["data_same_bytes"]:
        raise click.ClickException("not all of it works")


if __name__ == "__main__":
    main()
