"""Every hand that comes with the project through `aminn hand check`: build/reports/hands.json.

python -m aminn_sim.hands --out build/reports/hands.json
"""

from __future__ import annotations

from pathlib import Path

import click
from tqdm import tqdm

from aminn_base.errors import AminnError
from aminn_base.files import write_json

from .hand_check import Figures, check
from .open_hand import shipped_hands


def figures(pinch_N: float, grasps: int, progress: tqdm) -> Figures:
    """Flat figures, `HAND_KEY`; "aims_missed" names the hands that are not accepted."""
    out: Figures = {}
    missed = []
    for file in shipped_hands():
        done = check(file, pinch_N, grasps, echo=progress.write)
        name = done.understood.hand.name
        out |= {f"{name}_{key}": value for key, value in done.figures().items() if key != "hand"}
        if done.problem:
            missed.append(f"{name}: {done.problem}")
        progress.update()
    return out | {"aims_missed": "; ".join(missed)}


@click.command()
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Report to write (JSON).")
@click.option("--pinch", default=0.5, show_default=True, help="Mean force of a contact, N.")
@click.option("--grasps", default=16, show_default=True, help="Grasps a hand.")
def main(out: Path, pinch: float, grasps: int) -> None:
    """Check the description of every hand that comes with the project."""
    try:
        with tqdm(total=len(shipped_hands()), unit="hand", disable=None) as progress:
            found = figures(pinch, grasps, progress)
    except AminnError as error:
        raise click.ClickException(str(error)) from error
    write_json(out, found)
    if found["aims_missed"]:
        click.echo(f"aims missed: {found['aims_missed']}")


if __name__ == "__main__":
    main()
