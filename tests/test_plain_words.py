"""README, header and pages in short sentences, and in words that a newcomer knows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *sorted(ROOT.glob("docs/*.md"))]
HEADERS = sorted((ROOT / "runtime" / "include").glob("*.h"))
MEAN_WORDS = 17
"""Of a sentence, at most."""
DENSE = {"evaluation.md": 20}
"""Pages of figures, whose sentences may be longer."""
PRIVATE = re.compile(r"\banew\b|\bgo(?:es|ne)? on with\b|\bheld against\b|\b(?:a|one) (?:row|line|value) an? \w+")


def prose(file: Path) -> str:
    """What is not code, table or heading; items of lists are paragraphs."""
    text = file.read_text()
    if file.suffix == ".h":
        comments = re.findall(r"/\*(.*?)\*/", text, re.DOTALL)
        text = "\n\n".join(re.sub(r"^ ?\* ?", "", comment, flags=re.MULTILINE) for comment in comments)
    text = re.sub(r"<!-- table.*?<!-- end of table -->|^```.*?^```", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^(?: {4}\S|\||#).*$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"^ *(?:[-*]|\d+\.) ", "\n\n", re.sub(r"`[^`]*`", "code", text), flags=re.MULTILINE)


def sentences(text: str) -> list[int]:
    """Words of each sentence; two words or one are none."""
    found = [
        len(re.findall(r"\w[\w'./-]*", sentence))
        for paragraph in re.split(r"\n\s*\n", text)
        for sentence in re.split(r"(?<=[.:;!?])[\s\"')*]+(?=[A-Z(*\"0-9]|code|$)", " ".join(paragraph.split()))
    ]
    return [words for words in found if words > 2]


@pytest.mark.parametrize("file", PAGES + HEADERS, ids=lambda file: file.name)
def test_sentences_are_short(file: Path) -> None:
    words = sentences(prose(file))
    assert sum(words) / len(words) < DENSE.get(file.name, MEAN_WORDS)


@pytest.mark.parametrize("file", [f for f in PAGES + HEADERS if f.name not in DENSE], ids=lambda file: file.name)
def test_words_are_those_of_the_field(file: Path) -> None:
    assert PRIVATE.findall(prose(file)) == []
