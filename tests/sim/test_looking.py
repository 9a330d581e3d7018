"""The gallery and the data card: what they draw, that they say what is missing, and that they simulate nothing anew."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from page_checks import faults, watch_labels
from PIL import Image

from aminn_app.cli import main
from aminn_base.seal import JSON_KEY
from aminn_sim import SimulationConfig, SimulationError, simulate
from aminn_sim.build import in_words, simulator_build
from aminn_sim.card import data_card
from aminn_sim.gallery import CONTACT_RGBA, LOAD_RGBA, PIXELS, choose, gallery, offscreen
from aminn_sim.read import read_data
from aminn_sim.schema import groups_of

pytest.importorskip("mujoco", reason="the extra mujoco is not installed")


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enough grasps for cases that hold and cases that do not."""
    folder = tmp_path_factory.mktemp("looking") / "data"
    config = SimulationConfig(grasps=8, cases=6, seed=2, shard_grasps=4, noise_share=0.3)
    simulate(config, folder, threads=2, progress=False)
    return folder


@pytest.fixture(scope="module")
def gallery_folder(data_folder: Path) -> Path:
    return gallery(data_folder, 4).parent


def pixels(file: Path) -> np.ndarray:
    return np.asarray(Image.open(file)).astype(float)


def coloured(picture: np.ndarray, rgba: tuple[float, ...]) -> int:
    """Pixels of about the hue of a colour, bright or in shade."""
    wanted = np.array(rgba[:3]) / np.linalg.norm(rgba[:3])
    length = np.linalg.norm(picture, axis=-1)
    return int(((picture @ wanted > 0.97 * length) & (length > 90)).sum())


def test_chosen_cases_hold_and_fail(data_folder: Path) -> None:
    data = read_data(data_folder)
    rows = choose(data, 8)
    assert len(set(data.grasp_row[rows])) == 8  # a grasp once
    families = data.grasps["tool_family"][data.grasp_row[rows]]
    assert len(set(families[:2])) == 2
    assert 0 < data.samples["stable"][rows].sum() < 8


def test_pictures_show_the_forces(gallery_folder: Path) -> None:
    """Contact forces in both pictures, the load in the second alone; tool and hand on a light ground."""
    pairs = sorted(gallery_folder.glob("*-before.png"))
    assert len(pairs) == 4
    loads = []
    for before in pairs:
        first, second = pixels(before), pixels(before.with_name(before.name.replace("before", "after")))
        assert first.shape == second.shape == (PIXELS, PIXELS, 3)
        assert 0.05 < (np.abs(first - first[0, 0]).max(-1) > 20).mean() < 0.7
        assert coloured(first, CONTACT_RGBA) > 100 and coloured(first, LOAD_RGBA) == 0
        loads.append(coloured(second, LOAD_RGBA))
    assert max(loads) > 300


def test_page_shows_every_picture_and_its_numbers(data_folder: Path, gallery_folder: Path) -> None:
    assert faults(gallery_folder / "index.html") == []
    page = (gallery_folder / "index.html").read_text()
    shown = set(re.findall(r'<img src="([^"]+)"', page))
    assert shown == {p.name for p in gallery_folder.glob("*.png")} and len(shown) == 8
    data = read_data(data_folder)
    for row in choose(data, 4):
        moved = 1e3 * np.linalg.norm(data.samples["dx_ht"][row, :3])
        assert f"moved {moved:.2f} mm" in page
        assert f"Grasp {data.samples['grasp_id'][row]}:" in page
    assert "thumb distal flexor" in page


def test_pictures_repeat(data_folder: Path, gallery_folder: Path) -> None:
    first = {p.name: p.read_bytes() for p in gallery_folder.iterdir()}
    gallery(data_folder, 4)
    assert {p.name: p.read_bytes() for p in gallery_folder.iterdir()} == first


def test_a_gallery_is_on_the_disk_before_it_has_its_name(data_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each file and the names of all of them; then the folder's own name is made to last."""
    done: list[str] = []
    sync, rename = os.fsync, Path.rename

    def fsync(descriptor: int) -> None:
        sync(descriptor)
        done.append(os.readlink(f"/proc/self/fd/{descriptor}"))

    def renamed(self: Path, target: Path) -> Path:
        done.append("renamed")
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "rename", renamed)
    page = gallery(data_folder, 1)
    at = done.index("renamed")
    files = {name.removeprefix(".").removesuffix(".partial") for name in map(os.path.basename, done[:at])}
    assert {file.name for file in page.parent.iterdir()} | {"gallery.unfinished"} == files
    assert os.path.basename(done[at - 1]) == "gallery.unfinished" and done[at + 1 :] == [str(data_folder)]


def test_a_disk_that_fails_at_the_gallery_is_told(data_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(SimulationError, match=r"gallery: cannot be written \(Input/output error\)"):
        gallery(data_folder, 1)
    assert not list(data_folder.glob("gallery.unfinished"))


def test_data_of_another_version_are_refused(data_folder: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(data_folder, tmp_path / "data", ignore=shutil.ignore_patterns("gallery")))
    manifest = json.loads((copy / "manifest.json").read_text())
    del manifest[JSON_KEY]
    older = {"config": manifest["config"] | {"field_of_old": 1}}
    for change in ({"config_sha256": "0" * 64}, older):
        (copy / "manifest.json").write_text(json.dumps(manifest | change))
        with pytest.raises(SimulationError, match="another version or with another hand"):
            gallery(copy, 1)
    assert not list(copy.glob("gallery*"))


def test_missing_renderer_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco.osmesa", None)
    with pytest.raises(SimulationError, match=r"no off-screen OpenGL by OSMesa .*libosmesa6"), offscreen():
        pass


def test_unfinished_pictures_leave_nothing(data_folder: Path, tmp_path: Path, monkeypatch) -> None:
    copy = Path(shutil.copytree(data_folder, tmp_path / "data", ignore=shutil.ignore_patterns("gallery")))

    def full(file: Path, picture: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("aminn_sim.gallery._write_png", full)
    with pytest.raises(SimulationError, match=r"gallery: cannot be written \(No space left on device"):
        gallery(copy, 1)
    assert not list(copy.glob("gallery*"))


def test_card_shows_every_field_and_is_one_file(
    data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    overlaps = watch_labels(monkeypatch)
    report = tmp_path / "sim.json"
    report.write_text('{"theory_relative_error_median": 0.0625}')
    file = data_card(data_folder, report)
    assert faults(file) == [] and overlaps == []
    page = file.read_text()
    titles = re.findall(r"<h2>(.*?)</h2>", page)
    assert titles[:3] == ["Yield", "Stable share by load", "Quality of the labels"] and "Variables" in titles
    assert "Mechanics" not in titles  # every hand is as described
    assert set(re.findall(r'src="(.{10})', page)) == {"data:image"}
    assert in_words(simulator_build()) in page
    assert "0.0625" in page and "theory relative error median" in page
    for family in read_data(data_folder).manifest["tool_families"]:
        assert family in page


def test_card_draws_every_field(data_folder: Path) -> None:
    """Each field of the schema has its histogram, each part of one unit its own."""
    from aminn_sim.card import _parts

    data = read_data(data_folder)
    for group, fields in groups_of(data.hand).items():
        for name, field in fields.items():
            values = getattr(data, group)[name]
            parts = _parts(name, field, values)
            assert sum(part.size for _, _, part in parts) == values.size, name
            assert "," not in "".join(unit for _, unit, _ in parts), name


def test_a_finished_data_set_is_looked_at_as_it_is(data_folder: Path) -> None:
    times = {p.name: p.stat().st_mtime_ns for p in data_folder.glob("*.h5")}
    for command, said in ((["gallery", "--count", "1"], "pictures: "), (["card"], "data card: ")):
        result = CliRunner().invoke(main, [*command, "--data", str(data_folder)])
        assert result.exit_code == 0, result.output
        assert result.output.startswith(said) and "load cases" not in result.output
    assert times == {p.name: p.stat().st_mtime_ns for p in data_folder.glob("*.h5")}


def test_folder_without_data_is_named(tmp_path: Path) -> None:
    for look in (data_card, lambda folder: gallery(folder, 1)):
        with pytest.raises(SimulationError, match="not a readable data set"):
            look(tmp_path)
