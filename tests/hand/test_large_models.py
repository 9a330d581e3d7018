"""A few digits of a model do not ask an engine for more than it survives."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from aminn_base.errors import AminnError
from aminn_sim.convert import convert
from aminn_sim.mjcf_tree import MAX_COPIES, MAX_KEPT, read_mjcf

BODY = '<body><joint/><geom size="0.1"/>{}</body>'
LARGE = {
    "numbers of bodies": (
        f'<size nuser_body="{MAX_KEPT + 1}"/>',
        "",
        f"<size nuser_body='{MAX_KEPT + 1}'>: more than {MAX_KEPT} are not taken",
    ),
    "keyframes": (f'<size nkey=" {MAX_KEPT + 1}"/>', "", "<size nkey="),
    "composite": ("", '<composite type="grid" count="10 10 11"/>', "<composite count='10 10 11'> makes 1100 copies"),
    "flexcomp": ("", '<flexcomp type="grid" count="32 32 1"/>', "<flexcomp count='32 32 1'> makes 1024 copies"),
    "upper case": ("", '<REPLICATE count="1001"/>', "<replicate count='1001'> makes 1001 copies"),
    "in each other": (
        "",
        '<replicate count="10">' * 4 + '<geom size="0.01"/>' + "</replicate>" * 4,
        f"<replicate count='10'> makes 10000 copies; {MAX_COPIES} are taken, with those of what it lies in",
    ),
    "height field": ('<asset><hfield name="g" nrow="4097" ncol="1024" size="1 1 1 1"/></asset>', "", "<hfield> 'g'"),
}


@pytest.mark.parametrize("read", [read_mjcf, convert])
@pytest.mark.parametrize("name", LARGE)
def test_a_model_that_is_too_large_is_refused(name: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    before, inside, message = LARGE[name]
    file = tmp_path / "hand.xml"
    file.write_text(f"<mujoco>{before}<worldbody>{BODY.format(inside)}</worldbody></mujoco>")
    with pytest.raises(AminnError, match=rf"^{re.escape(str(file))}: {re.escape(message)}"):
        read(file)


def test_what_is_large_may_lie_in_an_include(tmp_path: Path) -> None:
    (tmp_path / "more.xml").write_text(f'<mujoco><size nkey="{MAX_KEPT + 1}"/></mujoco>')
    file = tmp_path / "hand.xml"
    file.write_text('<mujoco><include file="more.xml"/></mujoco>')
    for read in (read_mjcf, convert):
        with pytest.raises(AminnError, match="<size nkey="):
            read(file)


def test_includes_do_not_multiply_without_end(tmp_path: Path) -> None:
    """Twelve files that each include the next one twice."""
    for k in range(12):
        twice = f'<include file="{k + 1}.xml"/>' * 2
        (tmp_path / f"{k}.xml").write_text(f"<mujoco>{twice}</mujoco>")
    (tmp_path / "12.xml").write_text("<mujoco/>")
    with pytest.raises(AminnError, match=r"\.xml: one more include; 1000 are taken, with those within each other"):
        read_mjcf(tmp_path / "0.xml")
    with pytest.raises(AminnError):  # it includes no file twice
        convert(tmp_path / "0.xml")
    assert len(read_mjcf(tmp_path / "6.xml").files) == 7


def test_the_largest_is_taken(tmp_path: Path) -> None:
    file = tmp_path / "hand.xml"
    inside = '<composite type="grid" count="10 10 10"/><replicate count="10"/><replicate count="x"/>'
    file.write_text(f'<mujoco><size nkey="{MAX_KEPT}"/><worldbody>{BODY.format(inside)}</worldbody></mujoco>')
    assert read_mjcf(file).files
