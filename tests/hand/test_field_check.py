"""What the assets of a model are that no mesh is: height fields are checked, skins and textures left out."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import pytest

from aminn_base.errors import AminnError
from aminn_sim import _core
from aminn_sim.field_check import MAX_POINTS
from aminn_sim.mjcf_tree import read_mjcf, text_of
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

BODY = '<worldbody><body><joint/><geom size="0.1"/></body>{}</worldbody>'
GROUND = '<geom type="hfield" hfield="ground" pos="0 0 -1"/>'
HANDS = default_hand_file().parent / "hands"


def points(rows: int, columns: int, heights: int | None = None, last: float = 1.0) -> bytes:
    """A height field that says it has so many points, and has `heights`."""
    n = rows * columns if heights is None else heights
    return struct.pack("<2i", rows, columns) + struct.pack("<f", 0.5) * (n - 1) + struct.pack("<f", last) * (n > 0)


def png(rows: int, columns: int, packed: bytes | None = None, colour: int = 0) -> bytes:
    """A picture of 8 bits a number."""
    row = b"\0" + bytes(range(columns)) * {0: 1, 2: 3, 6: 4}[colour]
    head, data = struct.pack(">2I5B", columns, rows, 8, colour, 0, 0, 0), zlib.compress(row * rows)
    out = b"\x89PNG\r\n\x1a\n"
    for kind, content in ((b"IHDR", head), (b"IDAT", data if packed is None else packed), (b"IEND", b"")):
        out += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return out


def field(folder: Path, name: str, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    asset = f'<asset><hfield name="ground" file="{name}" size="1 1 0.1 0.1"/></asset>'
    (folder / "x.xml").write_text(f"<mujoco>{asset}{BODY.format(GROUND)}</mujoco>")
    return folder / "x.xml"


LARGE = struct.pack(">2I", 4, 3), struct.pack(">2I", 40000, 40000)
BOMB = zlib.compress(bytes(10000))
WRONG = {
    "nothing": ("hf", b"", "it is cut short"),
    "half a head": ("hf", b"\1\0\0\0\1", "it is cut short"),
    "half its points": ("hf", points(3, 4, 6), "it has 32 bytes, 3 rows of 4 points have 56"),
    "more points": ("hf", points(3, 4, 13), "it has 60 bytes, 3 rows of 4 points have 56"),
    "no rows": ("hf", points(0, 4), "it has 0 rows of 4 points; 2 or more of each are taken"),
    "rows before none": ("hf", points(-2, -2, 4), "it has -2 rows of -2 points"),
    "one row": ("hf", points(1, 4), "it has 1 rows of 4 points"),
    "too many": (
        "hf",
        points(2048, 2049, 3),
        "it has 2048 rows of 2049 points; 2 or more of each are taken, and 4194304 points",
    ),
    "far too many": ("hf", points(65536, 65536, 0), "it has 65536 rows of 65536 points"),
    "a height that is none": ("hf", points(2, 2, last=float("nan")), "a height is no finite number"),
    "no picture": ("png", points(2, 2), "it is no PNG picture"),
    "a picture without its head": ("PNG", png(3, 4)[:20], "it is no PNG picture"),
    "a picture of one row": ("png", png(1, 4), "it has 1 rows of 4 points"),
    "a large picture": ("png", png(3, 4).replace(LARGE[0], LARGE[1]), "it has 40000 rows of 40000 points"),
    "a picture that unpacks to more": ("png", png(3, 4, BOMB), "more is packed in it than 3 rows of 4 points"),
    "a picture of other bytes": ("png", png(3, 4, b"abcdefgh"), "its points cannot be unpacked"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_height_field_is_as_large_as_it_says(name: str, tmp_path: Path) -> None:
    """MuJoCo 2.2.2 takes some of these, and ends the process on others."""
    end, content, message = WRONG[name]
    line = rf"ground\.{end}: not a height field that the engine can read: {re.escape(message)}"
    with pytest.raises(AminnError, match=line):
        read_mjcf(field(tmp_path, f"ground.{end}", content))


GOOD = {
    "points": ("hf", points(3, 4), (3, 4)),
    "another end": ("bin", points(2, 2), (2, 2)),
    "grey": ("png", png(3, 4), (3, 4)),
    "colours": ("png", png(5, 2, colour=2), (5, 2)),
    "with opacity": ("PNG", png(2, 2, colour=6), (2, 2)),
}


@pytest.mark.parametrize("name", GOOD)
def test_good_height_fields_are_taken(name: str, tmp_path: Path) -> None:
    end, content, (rows, columns) = GOOD[name]
    model = read_mjcf(field(tmp_path, f"ground.{end}", content))
    engine = _core.Engine(text_of(model.root), model.assets)
    assert (engine.model("hfield_nrow")[0], engine.model("hfield_ncol")[0]) == (rows, columns)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ('nrow="60000" ncol="60000"', "it has 60000 rows of 60000 points; 2 or more of each are taken, and 4194304"),
        ('nrow="1" ncol="9"', "it has 1 rows of 9 points"),
        ('nrow="9999999999999999999999" ncol="2"', "nrow is '9999999999999999999999', no whole number"),
        ('nrow="3"', "ncol is '', no whole number; a height field has a file, or nrow and ncol"),
    ],
)
def test_a_height_field_in_the_model_has_a_size(size: str, message: str, tmp_path: Path) -> None:
    asset = f'<asset><hfield name="ground" size="1 1 1 1" {size}/></asset>'
    (tmp_path / "x.xml").write_text(f"<mujoco>{asset}{BODY.format(GROUND)}</mujoco>")
    with pytest.raises(AminnError, match=rf"x\.xml: <hfield> 'ground': {re.escape(message)}"):
        read_mjcf(tmp_path / "x.xml")


def test_the_largest_height_field_in_the_model(tmp_path: Path) -> None:
    asset = '<asset><hfield name="ground" size="1 1 1 1" nrow="2048" ncol="2048"/></asset>'
    (tmp_path / "x.xml").write_text(f"<mujoco>{asset}{BODY.format(GROUND)}</mujoco>")
    model = read_mjcf(tmp_path / "x.xml")
    assert len(_core.Engine(text_of(model.root), model.assets).model("hfield_data")) == MAX_POINTS


LOOKS = (
    '<asset><texture name="wood" type="2d" file="wood.bin"/><texture type="skybox" builtin="flat" width="60000"/>'
    '<skin name="glove" file="glove.skn" material="brown"/>'
    '<material name="brown" texture="wood" rgba="0.4 0.2 0.1 1"/></asset>'
    '<custom><tuple name="pictures"><element objtype="texture" objname="wood"/>'
    '<element objtype="material" objname="brown"/></tuple></custom>'
)


def test_skins_and_textures_are_left_out(tmp_path: Path) -> None:
    """Whatever is in them; they are of no effect on what is understood, and part of what a data set was made from."""
    hands = []
    for name, more in (("plain", ""), ("shown", LOOKS)):
        (tmp_path / name).mkdir()
        text = (HANDS / "gripper.xml").read_text().replace("</mujoco>", f"{more}</mujoco>")
        (tmp_path / name / "gripper.xml").write_text(text)
        (tmp_path / name / "gripper.toml").write_bytes((HANDS / "gripper.toml").read_bytes())
        for file in ("wood.bin", "glove.skn"):
            (tmp_path / name / file).write_bytes(b"no texture, no skin")
        hands.append(understand(tmp_path / name / "gripper.toml"))
    plain, shown = hands
    assert shown.hand == plain.hand and not shown.assets
    assert {path.name for path in shown.files} == {"gripper.xml", "wood.bin", "glove.skn"}
    assert _core.Engine(shown.scene, shown.assets).model("mat_rgba")[0].tolist() == pytest.approx([0.4, 0.2, 0.1, 1])
    (tmp_path / "shown" / "wood.bin").unlink()
    with pytest.raises(AminnError, match=r"<texture> names the file wood\.bin, which is not there"):
        understand(tmp_path / "shown" / "gripper.toml")
