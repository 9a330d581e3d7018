"""Tables of pushes: every format gives the same numbers, and every fault is named by its column and row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import rotation
from aminn_table import FORMATS, Map, TableError, check, columns_of, complete, read_map, read_table, write_table
from aminn_table.columns import LABELLED, PUSH, Arrays, shapes_of
from aminn_table.fallbacks import NO_FORCES, NO_NORMALS, NO_POINTS, NO_SHAPE, PINCH_N
from aminn_table.mapping import Pose, product, quaternion_of, rotation_vector

Change = Callable[[Arrays], object]


def test_columns_cover_every_number_once(lab_hand: Hand) -> None:
    columns = columns_of(lab_hand)
    assert len({c.name for c in columns}) == len(columns) == len({(c.array, c.at) for c in columns})
    for name, shape in shapes_of(lab_hand).items():
        assert sorted(c.at for c in columns if c.array == name) == list(np.ndindex(shape))


@pytest.mark.parametrize("end", FORMATS)
def test_written_tables_are_read_bit_by_bit(end: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    n = len(pushes["q"])
    results = {
        "p_stable": np.linspace(0, 1, n),
        "holds": np.ones(n, np.uint8),
        "pred_dx_ht": pushes["dx_ht"] / 3,
        "notes": np.array(["q out of range"] + [""] * (n - 1), object),
    }
    file = tmp_path / f"pushes{end}"
    write_table(file, lab_hand, pushes | results)
    first = file.read_bytes()
    write_table(file, lab_hand, pushes | results)
    assert file.read_bytes() == first
    read = read_table(file, lab_hand, LABELLED)
    assert set(read) == set(pushes) | set(results)
    for name, values in (pushes | results).items():
        np.testing.assert_array_equal(read[name], values, err_msg=name)


def test_hdf5_arrays_without_names_are_found_by_their_place(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "pushes.h5", "w") as file:
        for name, values in pushes.items():
            file[name] = values
    read = read_table(tmp_path / "pushes.h5", lab_hand, LABELLED)
    assert all(np.array_equal(read[name], values) for name, values in pushes.items())


def test_texts_in_two_dimensions_of_hdf5_are_named(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "pushes.h5", "w") as file:
        for name, values in pushes.items():
            file[name] = values
        file["notes"] = np.array([["a", "b"]] * len(pushes["q"]), "S1")
    with pytest.raises(AminnError, match="notes holds texts in 2 dimensions, expected one text per row"):
        read_table(tmp_path / "pushes.h5", lab_hand, LABELLED)


def test_spreadsheets_of_other_countries_and_programs(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """Byte-order mark, semicolons, CRLF, empty last lines, True and False."""
    file = tmp_path / "pushes.csv"
    write_table(file, lab_hand, pushes)
    lines = file.read_text().splitlines()[1:]
    at = lines[0].split(",").index("stable")
    rows = [line.split(",") for line in lines]
    for row in rows[1:]:
        row[at] = "True"
    file.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([*(";".join(row) for row in rows), "", ""]).encode())
    read = read_table(file, lab_hand, LABELLED)
    assert all(np.array_equal(read[name], values) for name, values in pushes.items())


def test_rows_are_numbered_as_in_the_file(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    pushes["q"][3, 1] = 40.0
    for end, place in ((".csv", "line 6: "), (".parquet", "row 3: "), (".h5", "row 3: ")):
        file = tmp_path / f"pushes{end}"
        write_table(file, lab_hand, pushes)
        with pytest.raises(TableError, match=f"{place}q_finger1_proximal is 40 rad.*degrees"):
            read_table(file, lab_hand)


def put(name: str, at: object, value: object) -> Change:
    """A change that sets numbers of an array."""
    return lambda a: a[name].__setitem__(at, value)


def scale(name: str, at: object, factor: float) -> Change:
    """A change that multiplies numbers of an array."""
    return lambda a: a[name].__setitem__(at, a[name][at] * factor)


def twice(a: Arrays) -> None:
    for name, values in a.items():
        if name != "time_s":
            values[9] = values[8]


FAULTS: dict[str, tuple[Change, str]] = {
    "NaN": (put("w_e", (4, 2), np.nan), "row 4: w_e_fz is empty or NaN"),
    "infinity": (put("x_ht", (5, 0), np.inf), "row 5: x_ht_x is infinite"),
    "hole in an optional column": (put("contacts", (2, 1, 7), np.nan), "row 2: contact_finger2_force is empty or NaN"),
    "hole in a displacement": (put("dx_ht", (7, 3), np.nan), "row 7: dx_ht_rx is empty or NaN"),
    "unsorted time": (put("time_s", 6, 1000.0), "row 6: time_s is 80 s before the row above"),
    "time twice": (put("time_s", 6, 1080.0), "row 6: time_s is that of the row above"),
    "clock jump": (lambda a: a["time_s"].__setitem__(slice(6, None), a["time_s"][6:] + 1e5),
                   "row 6: time_s jumps by 100010 s within grasp 1"),
    "nanoseconds": (scale("time_s", slice(None), 1e9), "row 0: time_s is 1e+12 s: more than 1e+11 s; are these milli"),
    "no pause": (lambda a: a["time_s"].__setitem__(slice(4, None), a["time_s"][4:] - 39.9),
                 "row 4: grasp_id changes to 1 only 0.1 s after"),
    "grasp again": (put("grasp_id", 23, 0), "row 23: grasp_id is 0 again after another grasp"),
    "degrees": (scale("q", slice(None), 57.3), "degrees"),
    "small degrees": (put("q", (3, 1), 3.0), "row 3: q_finger1_proximal is 3 rad, the joint's range is"),
    "millimetres": (scale("x_ht", (slice(None), slice(0, 3)), 1e3), "are these millimetres"),
    "tool turned in degrees": (put("x_ht", (8, 4), 30.0), "row 8: x_ht_ry is 30 rad"),
    "grams": (put("w_e", (1, 0), 510.0), "row 1: w_e_fx is 510 N: more than 200 N; are these grams"),
    "N.mm": (put("w_e", (1, 5), -150.0), "row 1: w_e_mz is -150 N.m"),
    "normals out of the tool": (scale("contacts", (..., slice(4, 7)), -1.0), "contact_thumb_nx, ny, nz points out of"),
    "kilonewtons": (scale("w_e", slice(None), 1e-3), "are these kilonewtons?"),
    "no motion": (scale("dx_ht", slice(None), 0.0), "dx_ht is 0 in all 24 pushes that held: the tool never"),
    "no load": (scale("w_e", slice(None), 0.0), "w_e is 0 in all 24 pushes that held: nothing pushed"),
    "reaction": (scale("w_e", slice(None), -1.0), "w_e points against the motion in 100% of the pushes"),
    "motion in millimetres": (scale("dx_ht", (slice(None), slice(0, 3)), 1e3), "are these millimetres"),
    "motion in degrees": (scale("dx_ht", (slice(None), slice(3, 6)), 57.3), "are these degrees"),
    "contacts in millimetres": (scale("contacts", (..., slice(1, 4)), 1e3), "row 0: contact_finger1_x, y, z is"),
    "contacts in the tool's frame": (lambda a: a["contacts"].__setitem__(
        (..., slice(1, 4)), a["contacts"][..., 1:4] - a["x_ht"][:, None, :3]), "another frame"),
    "normal too long": (scale("contacts", (2, 1, slice(4, 7)), 1.1), "contact_finger2_nx, ny, nz has length 1.1"),
    "pull": (put("contacts", (2, 1, 7), -1.0), "row 2: contact_finger2_force is -1 N"),
    "flag": (put("contacts", (2, 1, 0), 2.0), "row 2: contact_finger2_on is 2, expected 0 or 1"),
    "label": (put("stable", 3, 7), "row 3: stable is 7, expected 0 or 1"),
    "row twice": (twice, "row 9: the row repeats row 8"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_by_column_and_row(name: str, lab_hand: Hand, pushes: Arrays) -> None:
    change, text = FAULTS[name]
    assert check(lab_hand, pushes) == []
    change(pushes)
    found = [str(fault) for fault in check(lab_hand, pushes)]
    assert any(text in line for line in found), found


def test_kinds_of_faults_are_counted_once(lab_hand: Hand, pushes: Arrays) -> None:
    pushes["q"][:, 1] = 40.0
    (fault,) = (f for f in check(lab_hand, pushes) if f.column == "q_finger1_proximal")
    assert str(fault).endswith(f"(and {len(pushes['q']) - 1} more rows)")


def csv_of(hand: Hand, arrays: Arrays, file: Path, edit: Callable[[list[str]], list[str]]) -> Path:
    """A CSV whose lines were edited."""
    write_table(file, hand, arrays)
    file.write_text("\n".join(edit(file.read_text().splitlines())))
    return file


def named(old: str, new: str) -> Callable[[list[str]], list[str]]:
    """An edit that calls a column otherwise."""
    return lambda lines: [line.replace(old, new) for line in lines]


EDITS: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "near miss": (named("w_e_fx", "W_e.Fx"), "w_e_fx is missing; did you mean it with 'W_e.Fx'"),
    "missing": (named("w_e_fx", "load_x"), "w_e_fx is missing; and 1 other fault"),
    "extra": (lambda t: [t[0], t[1] + ",operator", *(line + ",7" for line in t[2:])], "operator is no column of"),
    "twice": (named("w_e_fx", "w_e_fy"), "line 2: two columns are called 'w_e_fy'"),
    "ragged": (lambda t: [*t[:4], t[4] + ",1", *t[5:]], "line 5: has"),
    "text": (lambda t: [*t[:4], "x" + t[4], *t[5:]], "line 5: time_s is 'x1020.0', expected a number"),
    "decimal comma": (lambda t: [t[0], *(line.replace(",", ";").replace(".", ",") for line in t[1:])],
                      "line 3: time_s is '1000,0', expected a number with a decimal point"),
    "frame": (lambda t: ["# frame.w_e = tool", *t], "w_e is stated in frame 'tool', expected the palm's"),
    "no rows": (lambda t: t[:2], "the table has no rows"),
    "half a group": (named("contact_thumb_nx", "theta_radius_tips"), "contact_thumb_nx is missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_files_that_are_no_table_are_refused_by_name(name: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    edit, text = EDITS[name]
    file = csv_of(lab_hand, pushes, tmp_path / "pushes.csv", edit)
    with pytest.raises(AminnError) as error:
        read_table(file, lab_hand, PUSH)
    assert text in str(error.value) and "\n" not in str(error.value)


def test_other_columns_are_left_out_on_demand(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    edit, _ = EDITS["extra"]
    file = csv_of(lab_hand, pushes, tmp_path / "pushes.csv", edit)
    assert set(read_table(file, lab_hand, by=Map(ignore=("oper*",)))) == set(pushes)


@pytest.mark.parametrize(
    "content", [b"", b"PAR1 cut short", b"\x89HDF\r\n\x1a\nbroken", b"\0\1\2", b"a,b\n1,\xff\n", b'a\n"b']
)
def test_damaged_files_are_refused(content: bytes, lab_hand: Hand, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(AminnError, match="file: "):
        read_table(tmp_path / "file", lab_hand)


def test_parquet_of_another_kind_is_refused(lab_hand: Hand, tmp_path: Path) -> None:
    pq.write_table(pa.table({"q_finger1_roll": [[1.0, 2.0]]}), tmp_path / "lists.parquet")
    with pytest.raises(AminnError, match="q_finger1_roll holds list<"):
        read_table(tmp_path / "lists.parquet", lab_hand)


def test_what_is_not_told_of_an_open_finger_is_nothing(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    pushes["contacts"][3, 2] = [0.0, *[np.nan] * 7]
    pushes["stable"][4] = 0
    pushes["dx_ht"][4] = np.nan
    write_table(tmp_path / "p.csv", lab_hand, pushes)
    read = read_table(tmp_path / "p.csv", lab_hand, LABELLED)
    assert not read["contacts"][3, 2].any() and not read["dx_ht"][4].any()


def test_rotation_vectors_take_the_short_way(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    long = pushes["x_ht"][:, 3:].copy()
    angle = np.linalg.norm(long, axis=1, keepdims=True)
    pushes["x_ht"][:, 3:] = long * (1 - 2 * np.pi / angle)
    write_table(tmp_path / "p.h5", lab_hand, pushes)
    np.testing.assert_allclose(read_table(tmp_path / "p.h5", lab_hand)["x_ht"][:, 3:], long, atol=1e-12)


def test_missing_sensors_are_filled_in_and_noted(lab_hand: Hand, pushes: Arrays) -> None:
    full, notes = complete(lab_hand, pushes)
    assert notes == () and np.array_equal(full["contacts"], pushes["contacts"])
    blind = pushes["contacts"].copy()
    blind[..., 1:] = np.nan
    full, notes = complete(lab_hand, pushes | {"contacts": blind})
    assert notes == (NO_SHAPE, NO_POINTS, NO_FORCES.format(PINCH_N))
    assert check(lab_hand, full) == []
    tips = np.stack([lab_hand.tips(q) for q in pushes["q"]])
    radius = np.array([b.tip_radius_m for b in lab_hand.branches])
    normal = full["contacts"][..., 4:7]
    np.testing.assert_allclose(full["contacts"][..., 1:4], tips + radius[:, None] * normal, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, atol=1e-12)
    assert (normal[:, :2, 1] < 0).all() and (normal[:, 2, 1] > 0).all()  # fingers and thumb press towards each other
    np.testing.assert_array_equal(
        full["contacts"][..., 7], np.tile([PINCH_N / 2, PINCH_N / 2, PINCH_N], (len(normal), 1))
    )
    full, _ = complete(lab_hand, pushes | {"contacts": blind}, force_N=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(full["contacts"][0, :, 7], [1, 2, 3])


def test_normals_follow_from_round_fingertips(lab_hand: Hand, pushes: Arrays) -> None:
    contacts = pushes["contacts"]
    without = contacts.copy()
    without[..., 4:7] = np.nan
    full, notes = complete(lab_hand, pushes | {"contacts": without})
    assert notes == (NO_NORMALS,)
    np.testing.assert_allclose(full["contacts"], contacts, atol=1e-9)


def mapped(folder: Path, text: str) -> Map:
    (folder / "map.toml").write_text(text)
    return read_map(folder / "map.toml")


def test_a_map_gives_other_names_units_and_signs(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    edit = lambda lines: [lines[0], lines[1].replace("w_e_fx", "Fx").replace(",x_ht_x", ",px"), *lines[2:]]  # noqa: E731
    other = {name: values.copy() for name, values in pushes.items()}
    other["w_e"][:, 0] *= -1e-3
    other["x_ht"][:, 0] *= 1e3
    file = csv_of(lab_hand, other, tmp_path / "pushes.csv", edit)
    by = '[columns]\nw_e_fx = { column = "Fx", unit = "kN", sign = -1 }\nx_ht_x = { column = "px", unit = "mm" }\n'
    read = read_table(file, lab_hand, LABELLED, mapped(tmp_path, by))
    for name, values in pushes.items():
        np.testing.assert_allclose(read[name], values, rtol=1e-12, err_msg=name)


MAP_FAULTS = {
    "column": ('[columns]\nw_e_fx = "Fx"\n', "Fx is missing, which is to be w_e_fx"),
    "target": (
        '[columns]\nw_e_f = "w_e_fx"\n',
        "the map has columns.w_e_f, which is no column of a table of hand synthetic",
    ),
    "unit": ('[columns]\nw_e_fx = { column = "w_e_fx", unit = "mm" }\n', "the map has w_e_fx in mm, and its unit is N"),
    "unknown unit": (
        '[columns]\nw_e_fx = { column = "w_e_fx", unit = "lbf" }\n',
        "columns.w_e_fx.unit is 'lbf'; there are",
    ),
}


@pytest.mark.parametrize("name", MAP_FAULTS)
def test_maps_that_do_not_fit_a_table_are_refused(name: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    by, text = MAP_FAULTS[name]
    write_table(tmp_path / "pushes.h5", lab_hand, pushes)
    with pytest.raises(AminnError) as error:
        read_table(tmp_path / "pushes.h5", lab_hand, LABELLED, mapped(tmp_path, by))
    assert text in str(error.value)


def test_frames_that_a_file_names_are_turned_by_the_map(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """A wrench in the tool's axes, the rest in those of a table that the hand stands beside."""
    bench = Pose(rotation(np.array([0.1, 0.9, -0.4])), np.array([0.3, -0.1, 0.2]))
    other = {name: values.copy() for name, values in pushes.items()}
    turn = np.array([-0.1, -0.9, 0.4])
    for k, x in enumerate(pushes["x_ht"]):
        own = rotation(x[3:])
        other["w_e"][k] = np.concatenate([own.T @ pushes["w_e"][k, :3], own.T @ pushes["w_e"][k, 3:]])
        other["dx_ht"][k] = np.concatenate([bench.turn.T @ pushes["dx_ht"][k, i : i + 3] for i in (0, 3)])
        rest = rotation_vector(product(quaternion_of(turn), quaternion_of(x[3:])))
        other["x_ht"][k] = np.concatenate([bench.turn.T @ (x[:3] - bench.origin), rest])
        for c in other["contacts"][k]:
            c[1:4], c[4:7] = bench.turn.T @ (c[1:4] - bench.origin), bench.turn.T @ c[4:7]
    write_table(tmp_path / "pushes.csv", lab_hand, other)
    lines = (tmp_path / "pushes.csv").read_text().splitlines()[1:]
    (tmp_path / "pushes.csv").write_text("\n".join(["# frame = bench", "# frame.w_e = grip", *lines]))
    text = "[frames.bench]\nposition_m = [0.3, -0.1, 0.2]\nrotation_rad = [0.1, 0.9, -0.4]\n"
    text += '[frames.grip]\nparent = "tool"\n'
    read = read_table(tmp_path / "pushes.csv", lab_hand, LABELLED, mapped(tmp_path, text))
    for name, values in pushes.items():
        np.testing.assert_allclose(read[name], values, atol=1e-12, err_msg=name)
    with pytest.raises(TableError, match="w_e is stated in frame 'grip'"):
        read_table(tmp_path / "pushes.csv", lab_hand, LABELLED, mapped(tmp_path, text.split("[frames.grip]")[0]))
