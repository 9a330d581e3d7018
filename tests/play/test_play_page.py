"""The page to play with: what stands in it, and the mechanics of its picture. `make play` tries it in a browser."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synthetic import HANDS, hand

from aminn_app.cli import main
from aminn_app.play.page import _words, inlined, scripts
from aminn_app.play.page import play as write_page
from aminn_base.errors import AminnError

CHECK = Path(__file__).with_name("check.mjs")


def given_in(page: Path) -> dict:
    found = re.search(r'id="given">\n(.*?)\n</script>', page.read_text(), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_one_file_without_a_network(page: Path) -> None:
    text = page.read_text()
    script = text[text.index('<script type="module">') :]
    addresses = set(re.findall(r"https?://[^\s\"'`]+", re.sub(r'id="given">.*?</script>', "", text, flags=re.DOTALL)))
    assert addresses == {"http://www.w3.org/2000/svg"}, "a name, that nothing is fetched from"
    assert "default-src 'none'" in text and not re.search(r"^(import|export)\b", script, re.MULTILINE)


def test_a_name_is_no_markup() -> None:
    assert _words("finger1_tip") == "finger 1 tip"
    assert _words('<img src="x" onerror=`f()`>&') == "img src=x onerror=f()"


def test_the_pictures_hand_moves_as_the_hand_does(page: Path, tmp_path: Path) -> None:
    """Chains of joints as `aminn_hand` has them; and what fingers bear is the load: force and moment balance."""
    done = subprocess.run(["node", str(CHECK), str(page)], check=True, capture_output=True, text=True)
    cases = json.loads(done.stdout)
    assert {len(case["q"]) for case in cases} == {8, 4}
    rest = []
    for case in cases:
        own = hand() if len(case["q"]) == 8 else HANDS["gripper 2x2"]
        for b, (branch, at) in enumerate(zip(own.branches, own.branch_joints, strict=True)):
            q = np.array(case["q"])[at]
            np.testing.assert_allclose(case["chains"][b][-1], branch.moved(q, np.array(branch.tip_point_m)), atol=1e-7)
            assert len(case["chains"][b]) == 3, "a roll is where the next joint is"
        if len(own.branches) < 3:
            continue  # about the line between two contacts the floor of K_x alone bears moments
        borne = np.zeros(6)
        for share in case["bears"]:
            arm = np.array(share["point"]) - np.array(case["x_ht"])[:3]
            borne += np.concatenate([share["share"], np.cross(arm, share["share"])])
        load, scale = np.array(case["w_e"]), np.array([1, 1, 1, 10, 10, 10])
        rest.append(np.linalg.norm((borne - load) * scale) / np.linalg.norm(load * scale))
    print(f"rest of force and moment beside the load: median {np.median(rest):.1e}, largest {max(rest):.1e}")
    assert np.median(rest) < 0.01 and max(rest) < 0.1  # the floor of K_x bears some


def test_grasps_loads_and_names(page: Path) -> None:
    shown, gripper = given_in(page)["hands"]
    assert [b["name"] for b in shown["branches"]] == ["finger 1", "finger 2", "thumb"]
    assert [c["short"] for c in shown["branches"][0]["coordinates"]] == ["roll", "proximal", "distal"]
    families = [g["tool"]["family"] for g in shown["grasps"]]
    assert len(set(families[:3])) == 3, "families come in turn"
    assert "not trained on the grasps shown" in shown["grasps_are"]
    assert [b["gated"] for b in shown["branches"] + gripper["branches"]] == [True] * 3 + [False] * 2
    assert {case["stable"] for g in shown["grasps"] for case in g["cases"]} == {True, False}


def test_scripts_are_joined_in_order(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"main.mjs: imports \['aminn.mjs'"):
        inlined([file for file in scripts() if file.name != "aminn.mjs"])
    (tmp_path / "other.mjs").write_text("export default 3;\n")
    with pytest.raises(ValueError, match=r"other.mjs: imports or exports in another form"):
        inlined([tmp_path / "other.mjs"])


def test_what_is_missing_is_said(page: Path, data_dir: Path, tmp_path: Path) -> None:
    run, out = page.parent / "run-0", tmp_path / "play.html"
    done = CliRunner().invoke(main, ["play", "--data", str(data_dir), "--out", str(out)])
    assert done.exit_code == 2 and "give a model: --run RUN or --export FOLDER" in done.output
    other = str(page.parent / "gripper")
    done = CliRunner().invoke(main, ["play", "--run", str(run), "--data", other, "--out", str(out)])
    assert done.exit_code == 1 and "is of hand synthetic, and no --data is" in done.output
    assert not out.exists()
    with pytest.raises(AminnError, match="which this command needs itself"):
        write_page(data_dir / "manifest.json", [run], [], [data_dir])
