"""Every page in headless Chromium at the width of a phone and of a desk (`make pages`).

python tests/pages/browser.py --work build/pages --report build/reports/pages.json

Makes small data sets, two models and all pages of them with the commands of `aminn`. Nothing may be wider than the
window but what scrolls in its box, and no text may lie on another. Screenshots are left beside the pages.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import click
from playwright.sync_api import sync_playwright

from aminn_base.files import write_json
from aminn_base.program import Messages

WIDTHS = {"phone": (390, 844), "desk": (1280, 900)}
PROBE = Path(__file__).with_name("browser.js").read_text()
TIMEOUT_MS = 240_000


def make_pages(work: Path) -> list[Path]:
    """The pages of small data sets; data that are there already stay."""

    def aminn(*words: object) -> None:
        subprocess.run([sys.executable, "-m", "aminn_app.cli", *map(str, words), "--quiet"], check=True)

    data, lab, runs = work / "data", work / "lab", [work / "aminn", work / "mlp"]
    aminn("simulate", "--out", data, "--grasps", 96, "--cases", 8, "--seed", 3)
    one_hand = ["--vary", "mechanics=0.4", "--set", "grasps_per_hand=4"]
    aminn("simulate", "--out", lab, "--grasps", 4, "--cases", 6, "--seed", 7, *one_hand)
    for run in runs:
        aminn("train", "--data", data, "--out", run, "--model", run.name, "--epochs", 8)
    both = [word for run in runs for word in ("--run", run)]
    aminn("card", "--data", data)
    aminn("gallery", "--data", data, "--count", 4)
    aminn("report", "--data", data, *both, "--reports", work.parent / "reports", "--out", work / "report.html")
    aminn("compare", *runs, "--page", work / "runs.html")
    aminn("explain", "--data", data, "--run", runs[0], "--sample", 5, "--out", work / "explain.png")
    calibration = work / "calibration.html"
    aminn("calibrate", "--run", runs[0], "--data", lab, "--out", work / "calibration.json", "--page", calibration)
    made = [work / "report.html", work / "runs.html", calibration]
    return [*made, data / "card.html", data / "gallery" / "index.html"]


@click.command(cls=Messages)
@click.option("--work", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the pages.")
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Figures, JSON.")
def main(work: Path, report: Path) -> None:
    """Make the pages and look at each."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise click.ClickException("chromium is not installed; on Debian: apt-get install chromium")
    pages, wrong = make_pages(work), []
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"], timeout=TIMEOUT_MS)
        for file in pages:
            for name, (width, height) in WIDTHS.items():
                page = browser.new_page(viewport={"width": width, "height": height})
                page.goto(file.resolve().as_uri(), timeout=TIMEOUT_MS)
                called = f"{file.parent.name}-{file.stem}" if file.stem == "index" else file.stem
                page.screenshot(path=work / f"{called}-{name}.png", full_page=True, timeout=TIMEOUT_MS)
                wrong += [f"{called}, {name}: {text}" for text in page.evaluate(PROBE)]
                page.close()
        browser.close()
    for text in wrong:
        click.echo(text, err=True)
    write_json(report, {"pages": len(pages), "widths": len(WIDTHS), "failures": "; ".join(wrong), "aims_missed": ""})
    click.echo(f"pages and screenshots: {work}\nreport: {report}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
