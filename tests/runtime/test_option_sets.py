"""Whatever options of gcc and clang the library is compiled with: the same bits, refused, or found by the self-test."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from option_sets import FOUND, MISSING, OPTION_SETS, REFUSED, SAME, outcomes

pytestmark = pytest.mark.long

JOBS = 2


def test_every_set_of_options_gives_the_same_bits_or_is_refused_or_found(
    tmp_path: Path, trust: dict[str, float | int | str | bool]
) -> None:
    found = outcomes(tmp_path, JOBS)
    trust["options_sets"] = len(found)
    for outcome, key in ((SAME, "same_bits"), (REFUSED, "refused"), (FOUND, "found")):
        trust[f"options_{key}"] = sum(text.startswith(outcome) for text in found.values())
    trust.update({f"options_{options.name}": text for options, text in found.items()})
    tried = {options: text for options, text in found.items() if not text.startswith(MISSING)}
    wrong = {
        options.name: text
        for options, text in tried.items()
        if not re.fullmatch(f"{options.outcome}(: .*{options.why}.*)?", text)
    }
    assert not wrong
    if len(tried) < len(found):
        pytest.skip("; ".join(sorted(set(found.values()) - set(tried.values()))))


def test_the_list_is_long_and_names_each_set_once() -> None:
    names = [options.name for options in OPTION_SETS]
    assert len(set(names)) == len(names) >= 40
    kinds = {(options.target, options.compiler) for options in OPTION_SETS}
    assert {("x86_64", "gcc"), ("x86_64", "clang"), ("m7", "gcc"), ("m7", "clang")} <= kinds
