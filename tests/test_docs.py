"""Links of README and docs lead to files and headings that are there, and every page is in the site's lists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
    """Of a page's headings, as forges make them: lower case, without signs, blanks as hyphens."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    for link in LINK.findall(text):
        file, _, anchor = link.partition("#")
        if re.match(r"\w+:", file):
            continue
        target = page.parent / file if file else page
        assert target.exists(), f"{link}: no such file"
        if anchor:
            assert target.suffix == ".md" and anchor in anchors(target), f"{link}: no such heading"


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    shown = {file.partition("#")[0] for file in LINK.findall(index)}
    listed = {f"{name}.md" for block in re.findall(r"```{toctree}\n(.*?)```", index, re.DOTALL)
              for name in block.split() if not name.startswith(":")}  # fmt: skip
    there = {str(page.relative_to(ROOT / "docs")) for page in PAGES if page.parent != ROOT} - {"index.md"}
    assert there <= shown
    assert there <= listed


def test_each_thing_that_users_expect_has_a_page_or_a_command() -> None:
    rows = [line.split("|") for line in (ROOT / "docs" / "expected.md").read_text().splitlines() if line[:2] == "| "][
        1:
    ]
    assert len(rows) > 20
    assert [row[1] for row in rows if not LINK.search(row[3]) and "`" not in row[3]] == []
