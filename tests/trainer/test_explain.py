"""The explanation of a load case: numbers that belong together, a text, a picture."""

from __future__ import annotations

import json
import os
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aminn.data.dataset import Dataset
from aminn.model.checkpoint import Checkpoint, build_model, load_checkpoint, save_checkpoint
from aminn.model.config import ModelConfig
from aminn.pages.explain import RING_M, SHIFT_M, as_text, contact_in_words, draw, explain_sample, softest
from aminn.pages.grasp_picture import GraspPicture, draw_grasp, load_legend
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_hand.drawing import turning


def test_numbers_belong_together(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    s = np.repeat([1.0, 1.0 / dataset.hand.length_m], 3)
    shares = []
    for sample in range(7, 17):
        e = explain_sample(runs["aminn"], dataset, sample)
        compliances, directions = e.principal()
        whole = directions @ np.diag(compliances) @ directions.T  # of the scaled stiffness
        motion = s * (whole @ (s * e.row("w_e")))
        sizes = np.linalg.norm(motion.reshape(2, 3), axis=1)
        shares.append(min(1.0, *(runs["aminn"].model.config.motion_limits / sizes)))
        np.testing.assert_allclose(shares[-1] * motion, e.dx, rtol=1e-3, atol=1e-6)
        assert (np.diff(compliances) <= 0).all()
    assert min(shares) < 1 == max(shares)  # motions are cut at the bounds of a grasp that holds
    assert e.flat()["thumb_proximal_stiffness_Nm_rad"] == e.stiffness[2, 1, 1]
    assert "thumb_roll_stiffness_Nm_rad" not in e.flat()


def test_text_names_every_finger_and_the_verdict(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    text = as_text(e)
    for word in ("finger1", "finger2", "thumb", "engaged", "mm/N", "holds" if e.p_stable >= e.tau else "gives way"):
        assert word in text
    samples = dataset.samples | {"contacts": np.where(np.arange(3)[:, None] == 2, 0, dataset.samples["contacts"])}
    assert "out of contact" in as_text(explain_sample(runs["aminn"], replace(dataset, samples=samples), 7))


def sliding_run(folder: Path, dataset: Dataset) -> Checkpoint:
    """An untrained model whose contacts may slide."""
    model = build_model("aminn", ModelConfig(friction="secant"), dataset.hand)
    save_checkpoint(folder, model, {"tau": 0.5, "data_config_sha256": dataset.manifest["config_sha256"]})
    return load_checkpoint(folder)


def test_friction_of_each_contact_is_told(dataset: Dataset, tmp_path: Path) -> None:
    run, x = sliding_run(tmp_path / "run", dataset), dataset.samples
    loads = {f: explain_sample(run, replace(dataset, samples=x | {"w_e": f * x["w_e"]}), 7) for f in (1e-3, 1.0, 300.0)}
    small, large = loads[1e-3], loads[300.0]
    assert small.slides and not small.slide.any() and large.slide.any()
    assert (large.use > small.use).all() and (small.friction > 0).all()
    assert re.search(r"of its friction \(mu \d\.\d\d\): sticks", as_text(small))
    assert re.search(r"of its friction \(mu \d\.\d\d\): slides, \S+ mm/N", as_text(large))
    assert large.flat()["thumb_friction_use"] == large.use[2] and large.flat()["thumb_slide_m_N"] == large.slide[2]
    near = replace(small, use=np.full(3, 0.95))
    assert contact_in_words(near, 0) == "about to slide"
    draw(large, tmp_path / "e.svg")


def test_how_sure_it_is_stands_beside_the_motion(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    rows = np.flatnonzero(dataset.samples["stable"] > 0)[:2].tolist()
    e = explain_sample(runs["aminn"], dataset, rows[0])
    out = runs["aminn"].model(**dataset.take(np.array(rows)).inputs())
    assert e.bound == pytest.approx(float(out["bound_95"][0]), rel=1e-4)
    assert e.flat()["p_slide"] == e.p_slide == pytest.approx(float(out["p_slide"][0]), rel=1e-4)
    assert f"p_slide {e.p_slide:.3f}" in as_text(e) and "simulated: finger1 " in as_text(e)
    assert "within the bound" in as_text(replace(e, bound=9.0))
    assert "beyond the bound" in as_text(replace(e, bound=1e-9)) and e.slides
    near = replace(e, bound=0.0123)
    assert "pose error below 0.012 (1.2 mm, or 0.7 deg) in 95 of 100" in as_text(near)
    assert "not bounded: 5 is more than a grasp that holds can move (0.36)" in as_text(replace(e, bound=5.0))


def test_picture_is_written(runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    draw(e, tmp_path / "new" / "e.png")
    assert (tmp_path / "new" / "e.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(AminnError, match=r"written as \.png"):
        draw(e, tmp_path / "e.bmp")


def test_picture_into_a_fifo_and_through_a_link(runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path) -> None:
    e = explain_sample(runs["aminn"], dataset, 7)
    os.mkfifo(tmp_path / "fifo")
    with ThreadPoolExecutor(1) as pool:
        got = pool.submit((tmp_path / "fifo").read_bytes)
        draw(e, tmp_path / "fifo")
        assert got.result().startswith(b"\x89PNG") and (tmp_path / "fifo").is_fifo()
    (tmp_path / "e.svg").symlink_to("there.svg")
    draw(e, tmp_path / "e.svg")
    assert (tmp_path / "e.svg").is_symlink() and b"<svg" in (tmp_path / "there.svg").read_bytes()


def test_softest_motions_are_those_of_the_stiffness(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    """A stiffness whose principal motions are known: turns about y and about an oblique axis, then a shift along x."""
    oblique = np.array([0.6, 0, 0.8])
    motions = np.zeros((6, 6))
    motions[[4, 0, 1, 2], [0, 2, 3, 4]] = 1.0
    motions[3:, 1], motions[3:, 5] = oblique, np.cross(oblique, [0, 1.0, 0])
    compliances = np.array([9.0, 7.0, 5.0, 3.0, 2.0, 1.0]) * 1e-3
    s = np.repeat([1.0, 1.0 / dataset.hand.length_m], 3)
    k_x = motions @ np.diag(1 / compliances) @ motions.T / np.outer(s, s)
    e = replace(explain_sample(runs["aminn"], dataset, 7), k_x=k_x)
    found, origin = softest(e), e.row("x_ht")[:3]
    np.testing.assert_allclose([m.compliance for m in found], compliances[:3])
    for motion, wanted in zip(found, motions.T[:3], strict=True):
        have = np.concatenate([motion.shift, motion.turn])
        np.testing.assert_allclose(have * np.sign(have @ wanted), wanted, atol=1e-9)
    for turn in found[:2]:
        arc, _, axis = turn.lines
        np.testing.assert_allclose(np.linalg.norm(np.cross(arc - origin, turn.turn), axis=1), RING_M)
        np.testing.assert_allclose(np.cross(axis[1] - axis[0], turn.turn), 0, atol=1e-12)
        assert axis[1][2] <= origin[2] + 1e-12  # above the tool a line would leave the picture
    (line,) = found[2].lines
    np.testing.assert_allclose(np.abs(line - origin), [[SHIFT_M, 0, 0]] * 2, atol=1e-12)
    assert all(f"{1e3 * c:.4f} mm/N" in as_text(e) for c in compliances)


def picture_of(dataset: Dataset, w_e: list[float]) -> GraspPicture:
    s = {name: dataset.samples[name][7] for name in ("q", "q_after", "x_ht", "dx_ht", "contacts")}
    grasp = int(dataset.grasp_rows()[7])
    shape = {name: dataset.grasps[name][grasp] for name in ("tool_geoms", "tool_size_m")}
    return GraspPicture(hand=dataset.hand, tool_family="capsule", w_e=np.array(w_e), **s, **shape)


@pytest.mark.parametrize(
    ("w_e", "labels"),
    [
        ([0, 3.0, 0, 0, 0, 0], ["3.0 N"]),
        ([0, 0, 0, 0, 0.02, 0], ["0.020 N.m"]),
        ([0, 3.0, 0, 0.02, 0, 0], ["0.020 N.m", "3.0 N"]),
        ([0.0] * 6, []),
    ],
)
def test_picture_shows_force_and_moment_where_there_is_one(dataset: Dataset, w_e: list[float], labels: list) -> None:
    figures, caption = draw_grasp(picture_of(dataset, w_e))
    before, under = (figure.axes[0] for figure in figures)
    assert sorted(t.get_text() for t in under.texts) == labels and not before.texts
    assert len([line for line in under.lines if line.get_linestyle() == "-"]) == 2 * ("0.020 N.m" in labels)
    legend = load_legend(np.array(w_e))
    assert legend in caption
    assert [word in legend for word in ("force", "moment")] == [any(w_e[:3]), any(w_e[3:])]


def test_a_curved_arrow_turns_by_the_right_hand() -> None:
    for axis in np.vstack([np.eye(3), -np.eye(3), [[1.0, 2, -2]]]):
        arc, head = turning(axis, np.array([0.1, 0, 0]), 0.03)
        moved = np.cross(arc[:-1] - [0.1, 0, 0], np.diff(arc, axis=0)) @ axis
        assert (moved > 0).all()
        assert (np.cross(head[0] - [0.1, 0, 0], head[1] - head[0]) @ axis) > 0


def test_command(runs: dict[str, Checkpoint], data_dir: Path, tmp_path: Path) -> None:
    args = ["explain", "--data", str(data_dir), "--json", str(tmp_path / "e.json")]
    result = CliRunner().invoke(main, [*args, "--run", str(runs["aminn"].path), "--sample", "3"])
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "e.json").read_text())["sample"] == 3
    for run, sample, message in (("mlp", "3", "no mechanics to explain"), ("aminn", "99999", "load cases 0 to")):
        result = CliRunner().invoke(main, [*args, "--run", str(runs[run].path), "--sample", sample])
        assert result.exit_code == 1 and message in result.output and "Traceback" not in result.output
