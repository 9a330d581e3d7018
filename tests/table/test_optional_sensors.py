"""Friction, weight and tensions: columns, classes, empty cells; absent is not zero, whatever the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from record import Message, header, messages, record, tool, wrench
from test_bags import as_map, map_text
from test_import import aminn

from aminn.data.dataset import load_dataset
from aminn.data.measured import KNOWN_SHARES
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import rotation
from aminn_hand.sensors import DEFAULT_DEVIATION, FRICTION_CLASSES
from aminn_hand.theta import Theta
from aminn_table import FORMATS, TableError, check, read_table, write_table
from aminn_table.columns import LABELLED, SENSORS, Arrays, tendons_of
from aminn_table.files import from_columns
from aminn_table.mapping import STANDARD_GRAVITY_M_S2, quaternion_of
from aminn_table.read import read_rough

Change = Callable[[Arrays], object]


@pytest.fixture
def sensed(lab_hand: Hand, pushes: Arrays) -> Arrays:
    """The pushes, with sensors that the first rows do not tell."""
    n, rng = len(pushes["q"]), np.random.default_rng(3)
    friction = np.stack([np.ones(n), rng.uniform(0.4, 1.1, n), np.full(n, 0.04)], 1)
    weight = np.concatenate([np.ones((n, 1)), rng.uniform(-1, 1, (n, 3))], 1)
    tension = np.concatenate([np.ones((n, 1)), rng.uniform(0, 30, (n, len(tendons_of(lab_hand))))], 1)
    sensors = {"friction": friction, "tool_weight": weight, "tendon_tension": tension}
    for k, values in enumerate(sensors.values()):
        values[: k + 2] = 0.0
    return pushes | sensors


def test_a_table_without_sensors_tells_none(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    write_table(tmp_path / "p.csv", lab_hand, pushes)
    assert not set(read_table(tmp_path / "p.csv", lab_hand)) & set(SENSORS)


@pytest.mark.parametrize("end", FORMATS)
def test_sensors_are_read_bit_by_bit(end: str, lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    file = tmp_path / f"pushes{end}"
    sensed["friction"][1, 1:] = 9.0  # behind a 0: nothing
    write_table(file, lab_hand, sensed)
    read = read_table(file, lab_hand, LABELLED)
    sensed["friction"][1, 1:] = 0.0
    for name in SENSORS:
        np.testing.assert_array_equal(read[name], sensed[name], err_msg=name)


def test_arrays_of_the_form_that_everything_takes(lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    """Without names of their numbers, in HDF5 and JSON; and the numbers alone."""
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for name, values in sensed.items():
            file[name] = values
    rows = [{name: values[k].tolist() for name, values in sensed.items()} for k in range(len(sensed["q"]))]
    (tmp_path / "p.jsonl").write_text("\n".join(json.dumps(row) for row in rows))
    for row in rows:
        friction = row.pop("friction")
        row |= {"friction": friction[1] if friction[0] else None, "friction_sd": friction[2] if friction[0] else None}
    (tmp_path / "alone.jsonl").write_text("\n".join(json.dumps(row) for row in rows))
    for file in ("p.h5", "p.jsonl", "alone.jsonl"):
        read = read_table(tmp_path / file, lab_hand, LABELLED)
        for name in SENSORS:
            np.testing.assert_array_equal(read[name], sensed[name], err_msg=f"{file} {name}")


def test_arrays_of_values_alone_are_known(lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    for name in SENSORS:
        sensed[name] = sensed[name][5:]
    arrays = {name: values if name in SENSORS else values[5:] for name, values in sensed.items()}
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for name, values in arrays.items():
            file[name] = values[:, 1:] if name in SENSORS else values
    read = read_table(tmp_path / "p.h5", lab_hand, LABELLED)
    for name in SENSORS:
        np.testing.assert_array_equal(read[name], arrays[name], err_msg=name)


def cells(hand: Hand, arrays: Arrays, file: Path, columns: dict[str, list[str]]) -> Path:
    """A CSV of the first pushes, with further columns."""
    n = len(next(iter(columns.values())))
    write_table(file, hand, {name: values[:n] for name, values in arrays.items()})
    lines = file.read_text().splitlines()[: n + 2]
    lines[1] += "," + ",".join(columns)
    for i in range(n):
        lines[i + 2] += "," + ",".join(values[i] for values in columns.values())
    file.write_text("\n".join(lines))
    return file


def test_classes_values_and_empty_cells(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    told = {
        "friction": ["0.6", "", "", "0.5", ""],
        "friction_sd": ["", "", "", "0", ""],
        "friction_class": ["", " Mid ", "", "", "high"],
    }
    read = read_table(cells(lab_hand, pushes, tmp_path / "p.csv", told), lab_hand)
    wanted = [
        [1, 0.6, DEFAULT_DEVIATION * 0.6],
        FRICTION_CLASSES["mid"],
        [0, 0, 0],
        [1, 0.5, 0],
        FRICTION_CLASSES["high"],
    ]
    np.testing.assert_array_equal(read["friction"], wanted)
    assert "friction_class" not in read and "tool_weight" not in read
    told = {"friction_class": ["low", "", "low"], "friction_known": ["1", "0", "0"]}
    read = read_table(cells(lab_hand, pushes, tmp_path / "p.csv", told), lab_hand)
    np.testing.assert_array_equal(read["friction"], [FRICTION_CLASSES["low"], [0, 0, 0], [0, 0, 0]])


def test_columns_that_are_empty_in_every_row_are_left_out(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    names = ["friction", "friction_class", *(f"tool_weight_{a}" for a in "xyz")]
    names += [f"theta_{p}" for p in Theta(lab_hand).names]
    read = read_table(cells(lab_hand, pushes, tmp_path / "p.csv", {n: [""] * 24 for n in names}), lab_hand)
    assert set(read) == set(pushes)


def test_how_programs_say_that_a_cell_is_empty(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    """Nulls of Parquet; NaN, None and the like in a data frame's columns of objects."""
    write_table(tmp_path / "p.parquet", lab_hand, pushes)
    table, n = pq.read_table(tmp_path / "p.parquet"), len(pushes["q"])
    table = table.append_column("friction", pa.nulls(n))
    table = table.append_column("friction_class", pa.array(["mid", None] * (n // 2)))
    pq.write_table(table, tmp_path / "p.parquet")
    wanted = np.where(np.arange(n)[:, None] % 2, 0.0, FRICTION_CLASSES["mid"])
    np.testing.assert_array_equal(read_table(tmp_path / "p.parquet", lab_hand, LABELLED)["friction"], wanted)
    columns = {name: column.to_numpy() for name, column in zip(table.column_names, table.columns, strict=True)}

    class NaType:
        """pandas.NA: neither a number nor equal to itself."""

        def __str__(self) -> str:
            return "<NA>"

        def __eq__(self, other: object) -> bool:
            raise TypeError("boolean value of NA is ambiguous")

    for empty in (None, float("nan"), np.nan, NaType()):
        columns["friction_class"] = np.array(["mid", empty] * (n // 2), object)
        columns["friction"] = np.array([empty] * n, object)
        columns["tool_weight_x"] = np.array([empty, 0.5] * (n // 2), object)
        columns |= {"tool_weight_y": columns["tool_weight_x"], "tool_weight_z": columns["tool_weight_x"]}
        rough = read_rough(from_columns("frame", columns), lab_hand)
        assert not rough.faults and not rough.bad.any()
        np.testing.assert_array_equal(rough.arrays["friction"], wanted)
        np.testing.assert_array_equal(rough.arrays["tool_weight"][:, 0], np.arange(n) % 2)


CELLS: dict[str, tuple[dict[str, list[str]], str]] = {
    "class and value": ({"friction": ["", "0.6"], "friction_class": ["low", "mid"]},
                        "line 4: friction_class is 'mid' beside a number of friction: tell the class or the number"),
    "class and deviation": ({"friction_sd": ["", "0.1"], "friction_class": ["low", "mid"]},
                            "line 4: friction_class is 'mid' beside a number"),
    "unknown class": ({"friction_class": ["", "slippery"]},
                      "line 4: friction_class is 'slippery', expected low, mid or high, or nothing"),
    "deviation alone": ({"friction": ["0.6", ""], "friction_sd": ["", "0.1"]},
                        "line 4: friction_sd is 0.1, and friction is empty"),
    "no number": ({"friction": ["0.6", "much"]}, "line 4: friction is 'much', expected a number"),
    "infinite": ({"friction": ["0.6", "inf"]}, "line 4: friction is infinite"),
    "flag": ({"friction": ["0.6", "0.6"], "friction_known": ["1", "0.5"]},
             "line 4: friction_known is 0.5, expected 0 or 1"),
    "known and empty": ({"friction": ["0.6", ""], "friction_known": ["1", "1"]},
                        "line 4: friction is empty, and friction_known is 1"),
    "part of a weight": ({"tool_weight_x": ["0", "0"], "tool_weight_y": ["0", ""], "tool_weight_z": ["-1", "-1"]},
                         "line 4: tool_weight_y is empty, and others of the row are not"),
    "column of a weight": ({"tool_weight_x": ["0"], "tool_weight_z": ["-1"]}, "tool_weight_y is missing"),
    "known weight": ({f"tool_weight_{a}": ["1", ""] for a in "xyz"} | {"tool_weight_known": ["1", "1"]},
                     "line 4: tool_weight_x is empty, and tool_weight_known is 1"),
    "tendon": ({"tendon_tension_f1": ["3"]}, "tendon_tension_f1 is no column of a table of hand synthetic"),
}  # fmt: skip


@pytest.mark.parametrize("name", CELLS)
def test_cells_that_contradict_each_other(name: str, lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    columns, text = CELLS[name]
    file = cells(lab_hand, pushes, tmp_path / "p.csv", columns)
    with pytest.raises(TableError) as error:
        read_table(file, lab_hand)
    assert text in str(error.value.faults[0]) or any(text in str(f) for f in error.value.faults)
    if "line" in text:  # the others can be used all the same
        rough = read_rough(file, lab_hand)
        assert any(text in str(fault) for fault in rough.faults), rough.faults
        assert len(rough.faults) == 1 and not rough.bad.any()


def put(name: str, at: object, value: object) -> Change:
    return lambda a: a[name].__setitem__(at, value)


FAULTS: dict[str, tuple[Change, str]] = {
    "negative": (put("friction", (5, 1), -0.3), "row 5: friction is -0.3, expected more than 0"),
    "zero": (put("friction", (5, 1), 0.0), "row 5: friction is 0, expected more than 0; leave it empty"),
    "percent": (put("friction", (5, 1), 60.0), "row 5: friction is 60: more than 5; is this percent?"),
    "negative deviation": (put("friction", (5, 2), -0.1), "row 5: friction_sd is -0.1, expected 0 or more"),
    "deviation in percent": (put("friction", (5, 2), 10.0), "row 5: friction_sd is 10, more than friction itself"),
    "flag": (put("friction", (5, 0), 0.5), "row 5: friction_known is 0.5, expected 0 or 1"),
    "NaN": (put("tool_weight", (6, 2), np.nan), "row 6: tool_weight_y is empty or NaN"),
    "grams": (put("tool_weight", (6, 3), -150.0), "row 6: tool_weight_z is -150 N: more than 50 N; are these grams"),
    "light tools in grams": (put("tool_weight", (6, 3), -49.0),
                             "row 6: tool_weight_x, y, z is 49"),
    "kilograms": (lambda a: a["tool_weight"].__setitem__((slice(None), slice(1, 4)), a["tool_weight"][:, 1:] / 30),
                  "rows that tell it: are these kilograms?"),
    "pushing tendon": (put("tendon_tension", (7, 1), -3.0), "row 7: tendon_tension_finger1_tendon0 is -3 N: a tendon"),
    "tension in grams": (put("tendon_tension", (7, 2), 2500.0), "tendon_tension_finger1_tendon1 is 2500 N: more than"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_units_and_signs_of_sensors(name: str, lab_hand: Hand, sensed: Arrays) -> None:
    change, text = FAULTS[name]
    assert check(lab_hand, sensed) == []
    change(sensed)
    found = [str(fault) for fault in check(lab_hand, sensed)]
    assert any(text in line for line in found), found
    if "row" in text.split(":")[0]:  # where nothing is known, nothing is looked at
        for name in SENSORS:
            sensed[name][:, 0] = 0.0
        assert check(lab_hand, sensed) == []


def test_a_map_turns_percent_and_kilograms(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    zero = ["0"] * 3
    columns = {"mu": ["60", "", "80"], "m": ["0.1", "0.2", ""], "tool_weight_x": [*zero[:2], ""]}
    file = cells(lab_hand, pushes, tmp_path / "p.csv", columns | {"tool_weight_y": [*zero[:2], ""]})
    text = '[columns]\nfriction = { column = "mu", unit = "%" }\n'
    text += 'tool_weight_z = { column = "m", unit = "kgf", sign = -1 }\n'
    read = read_table(file, lab_hand, by=as_map(tmp_path, text))
    np.testing.assert_allclose(read["friction"], [[1, 0.6, 0.06], [0, 0, 0], [1, 0.8, 0.08]])
    wanted = [[1, 0, 0, -0.1 * STANDARD_GRAVITY_M_S2], [1, 0, 0, -0.2 * STANDARD_GRAVITY_M_S2], [0, 0, 0, 0]]
    np.testing.assert_allclose(read["tool_weight"], wanted)


def test_weight_in_another_frame_is_turned(lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    turn = rotation(np.array([0.1, 0.9, -0.4]))
    other = sensed["tool_weight"].copy()
    other[:, 1:] = other[:, 1:] @ turn
    write_table(tmp_path / "p.csv", lab_hand, sensed | {"tool_weight": other})
    lines = (tmp_path / "p.csv").read_text().splitlines()[1:]
    (tmp_path / "p.csv").write_text("\n".join(["# frame.tool_weight = world", *lines]))
    by = as_map(tmp_path, "[frames.world]\nposition_m = [0.3, -0.1, 0.2]\nrotation_rad = [0.1, 0.9, -0.4]\n")
    read = read_table(tmp_path / "p.csv", lab_hand, LABELLED, by)
    np.testing.assert_allclose(read["tool_weight"], sensed["tool_weight"], atol=1e-12)
    with pytest.raises(TableError, match="tool_weight is stated in frame 'world'"):
        read_table(tmp_path / "p.csv", lab_hand, LABELLED)


# --- bags -------------------------------------------------------------------------------------------------------------

WORLD = rotation(np.array([0.4, -0.3, 0.2]))
"""Turns what stands in the palm's frame to that of the world."""


def told_by(hand: Hand, sensed: Arrays) -> Callable[[list[Message]], object]:
    """Further topics: friction, the weight as a sensor has it, the palm's pose, efforts of tendons."""
    from record import TYPES

    def change(every: list[Message]) -> None:
        for k, time in enumerate(sensed["time_s"]):
            t = round(time * 1e9)
            friction = TYPES["geometry_msgs/msg/PointStamped"](
                header(t - 10**8, ""), TYPES["geometry_msgs/msg/Point"](sensed["friction"][k, 1], 0.04, 0.0)
            )
            every.append(Message("/mu", t - 10**8, "geometry_msgs/msg/PointStamped", friction, t - 10**8))
            kind = "low" if k % 2 else ""
            text = TYPES["std_msgs/msg/String"](kind)
            every.append(Message("/class", t - 10**8, "std_msgs/msg/String", text, t - 10**8))
            weight = wrench(t, -1e-3 * np.array([*sensed["tool_weight"][k, 1:], 0, 0, 0]))
            every.append(Message("/weight", t, weight.kind, weight.value, t))
            names = [f"t_{tendon.name}" for tendon in reversed(tendons_of(hand))]
            none, effort = np.zeros(0), sensed["tendon_tension"][k, :0:-1].copy()
            effort[-1] *= -1
            state = TYPES["sensor_msgs/msg/JointState"](header(t, ""), names, none, none, effort)
            every.append(Message("/tendons", t, "sensor_msgs/msg/JointState", state, t))
            pose = tool(t, np.zeros(3), quaternion_of(np.array([0.4, -0.3, 0.2])), "world")
            every.append(Message("/palm", t, pose.kind, pose.value, t))

    return change


def test_a_bag_tells_sensors(lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    for name in SENSORS:
        sensed[name][:, 0] = 1.0
    sensed["friction"][:, 1] = np.maximum(sensed["friction"][:, 1], 0.5)
    sensed["friction"][:, 2] = 0.04
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, sensed), told_by(lab_hand, sensed))
    names = ", ".join(f'{t.name} = "t_{t.name}"' for t in tendons_of(lab_hand))
    text = map_text(lab_hand) + '[friction]\ntopic = "/mu"\nfield = "point.x"\ndeviation = "point.y"\n'
    text += '[tool_weight]\ntopic = "/weight"\nforce_unit = "kN"\nsign = -1\n'
    text += f'[tendon_tension]\ntopic = "/tendons"\nnames = {{ {names} }}\nsign = {{ finger1_tendon0 = -1 }}\n'
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, text))
    for name in SENSORS:
        np.testing.assert_allclose(read[name], sensed[name], atol=1e-12, err_msg=name)

    text = map_text(lab_hand) + '[friction]\ntopic = "/class"\n'
    text += '[tool_weight]\nmass_kg = 0.2\npalm = "/palm"\nframe = "world"\n'
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, text))
    low, none = FRICTION_CLASSES["low"], [0.0] * 3
    np.testing.assert_array_equal(read["friction"], [low if k % 2 else none for k in range(len(sensed["q"]))])
    down = WORLD.T @ [0, 0, -0.2 * STANDARD_GRAVITY_M_S2]
    np.testing.assert_allclose(read["tool_weight"], np.tile([1, *down], (len(sensed["q"]), 1)), atol=1e-12)
    assert "tendon_tension" not in read

    text = map_text(lab_hand) + '[friction]\nvalue = 0.6\n[tool_weight]\nmass_kg = 0.2\nframe = "bench"\n'
    text += "[frames.bench]\nrotation_rad = [-0.4, 0.3, -0.2]\n"
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, text))
    np.testing.assert_allclose(read["friction"], np.tile([1, 0.6, 0.06], (len(sensed["q"]), 1)))
    np.testing.assert_allclose(read["tool_weight"], np.tile([1, *down], (len(sensed["q"]), 1)), atol=1e-12)
    text = map_text(lab_hand) + '[friction]\nvalue = "high"\n'
    read = read_table(bag, lab_hand, LABELLED, as_map(tmp_path, text))
    np.testing.assert_array_equal(read["friction"], np.tile(FRICTION_CLASSES["high"], (len(sensed["q"]), 1)))


MAPS: dict[str, tuple[str, str]] = {
    "two weights": ('[tool_weight]\ntopic = "/weight"\nmass_kg = 0.1\n', "tool_weight: tell topic or mass_kg, one of"),
    "no friction": ("[friction]\ndeviation = 0.1\n", "friction: tell topic or value, one of them"),
    "field of nothing": ('[friction]\nvalue = 0.6\ndeviation = "sd"\n', "friction.deviation names a field"),
    "class": ('[friction]\nvalue = "wet"\n', "/push message 0: friction_class is 'wet', expected low, mid or high"),
    "class of a message": ('[friction]\ntopic = "/push"\n', "/push message 0: data is 'before', expected a number, or"),
    "no number": ('[friction]\ntopic = "/mu"\nfield = "point"\n', "/mu message 0: point is no number"),
    "tendon": (
        '[tendon_tension]\ntopic = "/tendons"\nnames = { f = "g" }\n',
        "the map has tendon f; hand synthetic",
    ),
    "effort": (
        '[tendon_tension]\ntopic = "/tendons"\n',
        "/tendons message 0: has no tendon 'finger1_tendon0'; did",
    ),
    "no effort": ('[tendon_tension]\ntopic = "/joint_states"\n', "/joint_states message 0: has no tendon"),
    "frame": ('[tool_weight]\nmass_kg = 0.1\nframe = "world"\n', "[tool_weight] is in frame 'world', which is not"),
    "palm": ('[tool_weight]\nmass_kg = 0.1\npalm = "/palm"\n', "/palm message 0: frame_id is 'world', the map expects"),
    "kilograms": ('[tool_weight]\ntopic = "/weight"\n', "are these kilograms?"),
}


@pytest.mark.parametrize("name", MAPS)
def test_maps_of_sensors_that_do_not_fit(name: str, lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    more, text = MAPS[name]
    bag = record(tmp_path / "bag", "MCAP", messages(lab_hand, sensed), told_by(lab_hand, sensed))
    with pytest.raises(AminnError) as error:
        read_table(bag, lab_hand, LABELLED, as_map(tmp_path, map_text(lab_hand) + more))
    said = [str(fault) for fault in error.value.faults] if isinstance(error.value, TableError) else [str(error.value)]
    assert any(text in line for line in said), said


def test_tendons_that_the_hand_does_not_have(pushes: Arrays, tmp_path: Path) -> None:
    from synthetic import HANDS

    bare = HANDS["gripper 2x2"]
    assert "tendon_tension" not in bare.dims.sensors
    (tmp_path / "bag.mcap").write_bytes(b"")
    by = as_map(tmp_path, map_text(bare) + '[tendon_tension]\ntopic = "/tendons"\n')
    with pytest.raises(AminnError, match=r"the map has \[tendon_tension\]; hand gripper has no tendons"):
        read_table(tmp_path / "bag.mcap", bare, LABELLED, by)


# --- data sets --------------------------------------------------------------------------------------------------------


def test_an_imported_data_set_keeps_what_is_known(lab_hand: Hand, sensed: Arrays, tmp_path: Path) -> None:
    """The same bytes from every format; a table that tells nothing of a sensor goes with one that does."""
    from synthetic import write_dataset

    write_dataset(tmp_path / "like", grasps=4, cases=2)
    data = []
    for end in (".csv", ".parquet", ".h5"):
        write_table(tmp_path / f"p{end}", lab_hand, sensed)
        said = aminn("import", tmp_path / f"p{end}", "--like", tmp_path / "like", "--out", tmp_path / end[1:]).stdout
        assert "known of the pushes: friction 92%, tool_weight 88%, tendon_tension 83%" in said
        data.append({f.name: f.read_bytes() for f in (tmp_path / end[1:]).iterdir()})
    assert data[0] == data[1] == data[2]
    read = load_dataset(tmp_path / "csv")
    for name in SENSORS:
        np.testing.assert_array_equal(read.samples[name], sensed[name], err_msg=name)
    assert read.manifest[KNOWN_SHARES]["friction"] == pytest.approx(22 / 24)

    first = sensed["grasp_id"] < 3
    plain = {name: values[~first] for name, values in sensed.items() if name != "friction"}
    write_table(tmp_path / "a.csv", lab_hand, {name: values[first] for name, values in sensed.items()})
    write_table(tmp_path / "b.csv", lab_hand, plain)
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for k, order in enumerate((files, files[::-1])):
        aminn("import", *order, "--like", tmp_path / "like", "--out", tmp_path / f"both{k}")
        read = load_dataset(tmp_path / f"both{k}")
        own = np.isin(read.samples["grasp_id"], (0, 1, 2))
        np.testing.assert_array_equal(read.samples["friction"][own], sensed["friction"][first])
        assert not read.samples["friction"][~own].any()


def test_data_that_know_nothing_have_no_sensors(lab_hand: Hand, pushes: Arrays, tmp_path: Path) -> None:
    from synthetic import write_dataset

    write_dataset(tmp_path / "like", grasps=4, cases=2)
    write_table(tmp_path / "p.csv", lab_hand, pushes)
    said = aminn("import", tmp_path / "p.csv", "--like", tmp_path / "like", "--out", tmp_path / "data").stdout
    assert "known of the pushes: friction 0%, tool_weight 0%, tendon_tension 0%" in said
    assert not set(load_dataset(tmp_path / "data").samples) & set(SENSORS)
