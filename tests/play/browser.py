"""The page to play with in headless Chromium (`make play`).

python tests/play/browser.py build/play.html --model tests/golden --replay build/host/runtime/aminn_replay
    --shots build/play --report build/reports/play.json

Loads the page at two widths, goes through every grasp and control, moves the load by keyboard, mouse and finger, and
replays the golden vectors in the page's own module. Nothing may go to the console or to a network, nothing may be
wider than the window, and the bits have to be those of the C replay.
"""

from __future__ import annotations

import base64
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
from playwright.sync_api import Page, sync_playwright

from aminn_base.files import write_json

Figures = dict[str, float | int | str | bool]
WIDTHS = {"wide": (1280, 900), "phone": (390, 844)}
OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PROBE = Path(__file__).with_name("probe.js")
TIMEOUT_MS = 240_000
"""Software rendering on a busy machine takes its time."""
REFINED_MS = 400
"""After it the surface of largest loads is the fine one."""
POLL_MS = 20
DRAG = (30, -24)
KEYS = ("ArrowRight", "ArrowUp", "PageDown", "Shift+ArrowLeft")


class Trial:
    """The page at one width, and what goes wrong."""

    def __init__(self, page: Page, name: str, wrong: list[str]) -> None:
        self.page, self.name, self.wrong = page, name, wrong
        page.on("console", lambda message: self.check(False, f"console: {message.text}"))
        page.on("pageerror", lambda error: self.check(False, f"error: {error}"))
        page.on("request", lambda request: self.check(request.url.startswith(("file:", "data:")), request.url))

    def check(self, good: bool, text: str) -> None:
        if not good:
            self.wrong.append(f"{self.name}: {text}")
            click.echo(f"wrong: {self.wrong[-1]}", err=True)

    def open(self, file: Path) -> None:
        self.page.goto(file.resolve().as_uri(), wait_until="domcontentloaded")
        self.wait("Boolean(globalThis.aminnPlay?.shown())")
        self.page.add_script_tag(path=PROBE)

    def wait(self, what: str) -> None:
        """Until the expression is true; Playwright's own waiting evaluates text in the page, which the page forbids."""
        end = time.monotonic() + TIMEOUT_MS / 1000
        while not self.page.evaluate(what):
            if time.monotonic() > end:
                raise click.ClickException(f"{self.name}: no end of waiting for {what}")
            self.page.wait_for_timeout(POLL_MS)

    def ask(self, question: str, *given: str) -> list[str]:
        found: list[str] = self.page.evaluate(f"(given) => probe.{question}(...given)", given)
        return found

    def choose(self, control: str, value: str) -> None:
        self.ask("choose", control, value)
        self.wait("probe.settled()")

    def check_moved(self, how: Callable[[], object], text: str, far: bool = True) -> None:
        """By what `how` does the load and what its handles say have to change; if `far`, motion and sentence too."""
        before = self.ask("seen")
        how()
        self.wait("probe.settled()")
        changed = [a != b for a, b in zip(before, self.ask("seen"), strict=True)]
        self.check(all(changed if far else changed[:2]), f"{text} ({changed})")

    def check_width(self, when: str) -> int:
        width = int(self.page.evaluate("document.documentElement.scrollWidth"))
        self.check(width <= WIDTHS[self.name][0], f"{width} pixels wide {when}")
        return width

    def drag(self, selector: str) -> None:
        """With the mouse, or on the phone with a finger."""
        box = self.page.locator(selector).bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        way = [(x + share * DRAG[0], y + share * DRAG[1]) for share in (0.5, 1.0)]
        if self.name != "phone":
            self.page.mouse.move(x, y)
            self.page.mouse.down()
            for point in way:
                self.page.mouse.move(*point)
            self.page.mouse.up()
            return
        touch = self.page.context.new_cdp_session(self.page)
        steps = [("touchStart", (x, y)), *(("touchMove", point) for point in way), ("touchEnd", None)]
        for kind, at in steps:
            points = [{"x": at[0], "y": at[1]}] if at else []
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def move_load(self) -> None:
        """By handles, slider and button; then turn the view."""
        press = self.page.keyboard.press
        for what, unit in (("force", "N"), ("moment", "N·m")):
            handle = self.page.locator(f"#{what}")
            handle.scroll_into_view_if_needed()
            self.check_moved(lambda w=what: self.drag(f"#{w}"), f"the {what} does not follow")
            handle.focus()
            for key in KEYS:
                self.check_moved(lambda k=key: press(k), f"the {what} ignores {key}", far=False)
            told = handle.get_attribute("aria-valuetext") or ""
            self.check(f" {unit}: x " in told, f"the {what} says {told!r}")
        self.check_moved(self.page.locator("#no-load").click, "the load stays")
        self.page.locator("#sliders input").first.focus()
        self.check_moved(lambda: press("End"), "the slider ignores End")
        self.page.locator("#canvas").focus()
        view = self.ask("view")
        press("ArrowLeft")
        self.wait(f"probe.view() !== {view!r}")
        press("Home")

    def try_controls(self) -> int:
        """Every value of every control; returns the width in pixels with all that can be opened open."""
        boxes = self.page.locator("input[type=checkbox]")
        self.page.locator("summary").click()
        for control in ("surface", "compliance", "factor"):
            for value in reversed(self.ask("options", control)):  # ends with what it began with
                self.choose(control, value)
        for again in (False, True):
            for box in boxes.all():
                box.click()
            self.check(not again or not self.ask("unnamed"), f"without a name: {self.ask('unnamed')}")
        width = self.check_width("with everything open")
        self.page.locator("summary").click()
        return width

    def go_through(self, shots: Path) -> Figures:
        """Every grasp of every hand; a picture of each hand and tool."""
        page, found = self.page, {"grasps": 0, "motions_compared": 0, "motions_within_bound": 0}
        for hand in self.ask("options", "hand"):
            self.choose("hand", hand)
            for family in self.ask("options", "tool"):
                self.choose("tool", family)
                for grasp in self.ask("options", "grasp"):
                    self.choose("grasp", grasp)
                    note = str(page.evaluate("document.querySelector('#truth-body .note')?.textContent ?? ''"))
                    found["grasps"] += 1
                    found["motions_compared"] += "Off by" in note
                    found["motions_within_bound"] += ", within" in note
                    self.check(not self.ask("overlaps"), f"grasp {grasp}: names overlap: {self.ask('overlaps')}")
                page.wait_for_timeout(REFINED_MS)
                page.evaluate("scrollTo(0, 0)")
                shot = f"{self.name}-{hand}-{family.replace(' ', '-')}.png"
                page.screenshot(path=shots / shot, full_page=self.name == "phone")
            self.check_width(f"with hand {hand}")
        self.choose("hand", "0")
        return {f"{self.name}_{key}": value for key, value in found.items()}

    def same_bits(self, vectors: Path, expected: Path) -> bool:
        result = self.page.evaluate("(v) => probe.replay(v)", base64.b64encode(vectors.read_bytes()).decode())
        same = base64.b64decode(result) == expected.read_bytes()
        self.check(same, "the bits differ from those of the C replay")
        return same


FILE, FOLDER = click.Path(path_type=Path, exists=True, dir_okay=False), click.Path(path_type=Path)


@click.command()
@click.argument("page_file", type=FILE)
@click.option("--model", type=FOLDER, required=True, help="Folder of the page's first model.")
@click.option("--replay", type=FILE, required=True, help="aminn_replay of this machine.")
@click.option("--shots", type=FOLDER, required=True, help="Folder for screenshots.")
@click.option("--report", type=FOLDER, required=True, help="Figures, JSON.")
def main(page_file: Path, model: Path, replay: Path, shots: Path, report: Path) -> None:
    """Try the page out and write the report."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise click.ClickException("chromium is not installed; on Debian: apt-get install chromium")
    shots.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    start, vectors = time.monotonic(), model / "golden.bin"
    figures: Figures = {"page_bytes": page_file.stat().st_size}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as tools:
        expected = Path(folder) / "results.bin"
        subprocess.run([replay, model / "aminn_model.bin", vectors, expected], check=True, capture_output=True)
        browser = tools.chromium.launch(executable_path=chromium, args=OPTIONS, timeout=TIMEOUT_MS)
        figures["chromium"] = browser.version
        for name, (width, height) in WIDTHS.items():
            context = browser.new_context(viewport={"width": width, "height": height}, has_touch=name == "phone")
            context.set_default_timeout(TIMEOUT_MS)
            trial = Trial(context.new_page(), name, wrong)
            trial.open(page_file)
            figures |= trial.go_through(shots)
            trial.move_load()
            figures[f"{name}_pixels"] = trial.try_controls()
            if name == "wide":
                figures["golden_vectors"] = int.from_bytes(vectors.read_bytes()[8:12], "little")
                figures["same_bits_as_c"] = trial.same_bits(vectors, expected)
            context.close()
        browser.close()
    figures |= {"seconds": round(time.monotonic() - start, 1), "ok": not wrong, "failures": "; ".join(wrong)}
    write_json(report, figures | {"aims_missed": ""})
    click.echo(", ".join(f"{key} {value}" for key, value in figures.items() if value != ""))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
