"""Give every reader of files wrong ones: a clear error or a valid result, no traceback, no hang, no memory, no code.

fuzz_files.py --seconds 60 --work build/faults/fuzz --report build/reports/reliability/fuzz_files.json [--only NAME]

Each case has a number; the same number gives the same file. Where a file has a checksum, half of the cases have it made
right again, so that what stands behind it is reached. Cases run in a process of their own with a limit of memory and
time; one that is killed by a case is begun again behind it. A case counts as broken where anything but AminnError
leaves the reader, where its text is no line that names the file, and where a program was started, a connection opened,
a pickle read or a file written elsewhere.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import struct
import sys
import time
import traceback
import warnings
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from forks import ROOT, forked
from mutate import Mutator, changed_hdf5, changed_json, changed_tensors, changed_xml, flipped, reworded

CASE_S, MEMORY = 20, 3 << 30
BATCH_S = 3.0
NO_NUMBER = re.compile(r"\b(nan|inf)\b")
FORBIDDEN = (
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "socket.connect",
    "pickle.find_class",
)


@dataclass(frozen=True)
class Target:
    """A reader and right files for it."""

    name: str
    seeds: Callable[[Path], Sequence[Path]]
    """Makes right files in a folder, whatever else they need beside them; the first case's files are these."""
    read: Callable[[Path], object]
    """Reads a file. Raises AminnError."""
    mutators: tuple[Mutator, ...]
    mend: Callable[[bytes], bytes] = lambda content: content
    """Makes the checksum right."""
    after: Callable[[Path, bytes], None] | None = None
    """Makes right what another file says of this one."""


@dataclass
class Found:
    """Counts of one target, and what broke."""

    cases: int = 0
    taken: int = 0
    refused: int = 0
    broken: list[str] = field(default_factory=list)
    seconds: float = 0.0


def _watched(event: str, values: tuple[Any, ...]) -> None:
    if _WATCH and (event in FORBIDDEN or (event == "open" and _writes(values))):
        _SEEN.append(f"{event} {str(values)[:120]}")


_WATCH: list[str] = []
_SEEN: list[str] = []


def _writes(values: tuple[Any, ...]) -> bool:
    name, _, flags = values
    changes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
    return bool(changes) and not str(name).startswith((*_WATCH, "/dev/null"))


def one_case(target: Target, files: Sequence[Path], wholes: Sequence[bytes], number: int) -> tuple[str, str]:
    """("taken", ""), ("refused", message) or ("broken", why) of a case."""
    rng = random.Random(f"{target.name} {number}")
    pick = rng.randrange(len(files))
    file, whole = files[pick], wholes[pick]
    mutator = rng.choice(target.mutators)
    try:
        content = mutator(rng, whole)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, OverflowError, MemoryError):  # not so
        content = flipped(rng, whole)
    if rng.random() < 0.5:
        try:
            content = target.mend(content)
        except (ValueError, KeyError, AttributeError, TypeError):
            pass
    file.write_bytes(content)
    if target.after and rng.random() < 0.9:
        target.after(file, content)
    _SEEN.clear()
    signal.setitimer(signal.ITIMER_REAL, CASE_S)
    _WATCH[:] = [str(file.parent), str(file.parent.parent)]
    try:
        target.read(file)
        outcome = ("taken", "")
    except AminnError as error:
        text = str(error)
        clear = len(text) < 5000 and (file.name in text or file.parent.name in text)
        outcome = ("refused", text) if clear else ("broken", f"does not name the file: {text[:200]}")
    except _TooLong:
        outcome = ("broken", f"no end after {CASE_S} s")
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        ours = [
            f for f in traceback.extract_tb(error.__traceback__) if "aminn" in f.filename and "faults" not in f.filename
        ]
        where = ours[-1] if ours else last
        outcome = (
            "broken",
            f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {str(error)[:160]}",
        )
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        _WATCH.clear()
        file.write_bytes(whole)
        if target.after:
            target.after(file, whole)
    if _SEEN:
        return "broken", f"not only read: {_SEEN[0]}"
    return outcome


class _TooLong(BaseException):
    pass


def _give_up(number: int, frame: object) -> None:
    raise _TooLong


def batch(
    target: Target, files: Sequence[Path], wholes: Sequence[bytes], first: int, seconds: float, note: Path
) -> dict:
    """Cases from `first` on for so long; what they came to. `note` gets the number of each before it is tried."""
    signal.signal(signal.SIGALRM, _give_up)
    warnings.simplefilter("ignore")
    sys.addaudithook(_watched)
    until, number, counts, broken = time.monotonic() + seconds, first, {"taken": 0, "refused": 0}, []
    with note.open("w") as said:
        while time.monotonic() < until:
            said.seek(0)
            said.write(f"{number:12d}")
            said.flush()
            kind, why = one_case(target, files, wholes, number)
            if kind == "broken":
                broken.append(f"{target.name} {number}: {why}")
            else:
                counts[kind] += 1
            number += 1
            if len(broken) >= 20:
                break
    return counts | {"next": number, "broken": broken}


def fuzz(target: Target, work: Path, seconds: float, first: int = 0) -> Found:
    """A target for so long."""
    found, folder = Found(), work / target.name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    made = forked(lambda: [str(p) for p in target.seeds(folder)], 300)
    assert made.status == 0, made.value
    files = [Path(str(p)) for p in made.value]  # type: ignore[attr-defined]
    wholes = [p.read_bytes() for p in files]
    for file in files:  # right files are taken; what reads them is loaded once, in this process
        target.read(file)
    number, started, note = first, time.monotonic(), work / f"{target.name}.case"
    while (left := seconds - (time.monotonic() - started)) > 0:
        span = min(BATCH_S, left)
        done = forked(partial(batch, target, files, wholes, number, span, note), span + 2 * CASE_S, MEMORY)
        if done.status == 0 and isinstance(done.value, dict):
            found.taken += done.value["taken"]
            found.refused += done.value["refused"]
            found.broken += done.value["broken"]
            found.cases += done.value["next"] - number
            number = done.value["next"]
        else:
            at = int(note.read_text()) if note.is_file() and note.read_text().strip() else number
            found.broken.append(f"{target.name} {at}: the process ended with {done.status}: {str(done.value)[-200:]}")
            found.cases += at + 1 - number
            number = at + 1
            for file, whole in zip(files, wholes, strict=True):
                file.write_bytes(whole)
        if len(found.broken) > 60:
            break
    found.seconds = time.monotonic() - started
    return found


# --- targets --------------------------------------------------------------------------------------------------------
def _resealed(content: bytes) -> bytes:
    value = json.loads(content)
    value.pop(JSON_KEY, None)
    return json.dumps(sealed(value)).encode()


def _in_manifest(shard: Path, content: bytes) -> None:
    file = shard.with_name("manifest.json")
    manifest = json.loads(file.read_text())
    manifest["shards"][0]["sha256"] = hashlib.sha256(content).hexdigest()
    file.write_bytes(_resealed(json.dumps(manifest).encode()))


def _dataset(folder: Path, name: str) -> list[Path]:
    write_dataset(folder / "data", grasps=4, cases=3, vary=0.2)
    (folder / "data" / "manifest.json").write_bytes(_resealed((folder / "data" / "manifest.json").read_bytes()))
    return [folder / "data" / name]


def _checkpoint(folder: Path, name: str) -> list[Path]:
    torch.manual_seed(0)
    model = build_model("aminn", ModelConfig(told=True, width=8), HANDS["reference"])
    save_checkpoint(folder / "run", model, {"tau": 0.5, "data_config_sha256": ""})
    return [folder / "run" / name]


def _unfinished(folder: Path) -> list[Path]:
    state = RunState({"model.a": torch.zeros(3, 2), "rng": torch.zeros(8, dtype=torch.uint8)}, {"stage": 0, "epoch": 1})
    (folder / "run").mkdir()
    save_run(folder / "run", {"config": {"seed": 0}}, state)
    return [folder / "run" / UNFINISHED]


def _hands(folder: Path, end: str) -> list[Path]:
    for file in [*(ROOT / "sim/models/hands").iterdir()]:
        if file.stem in ("gripper", "leap_like", "barrett_like"):
            shutil.copy(file, folder)
    return sorted(folder.glob(f"*{end}"))


def _newer(folder: Path) -> list[Path]:
    """Models for `aminn hand convert` in the dialect of the current MuJoCo."""
    files = [folder / f"newer_{k}.xml" for k in range(len(ACCEPTED))]
    for file, text in zip(files, ACCEPTED.values(), strict=True):
        file.write_text(f'<?xml version="1.0" encoding="utf-8"?>\n{text}')
    return files


def _urdfs(folder: Path) -> list[Path]:
    _meshes(folder)
    pad = COLLISION.format(shape='<mesh filename="package://convert_urdf/pad.obj"/>')
    texts = {"bare": urdf(), "mimics": urdf(mimic='<mimic joint="{n}_1" multiplier="0.6"/>'), "meshes": urdf(pad)}
    for name, text in texts.items():
        (folder / f"{name}.urdf").write_text(text)
    return [folder / f"{name}.urdf" for name in texts]


def _sheets(folder: Path) -> list[Path]:
    (folder / "newer.xml").write_text(ACCEPTED["a filtered servo"])
    (folder / "bare.urdf").write_text(urdf())
    rest = '[stiffness]\nservo_Nm_rad = { default = 1.5 }\n[contact]\nmodel = "soft_finger"\n'
    return _written(
        folder, mjcf=f'name = "new"\nmodel = "newer.xml"\n{rest}', urdf=f'name = "new"\nmodel = "bare.urdf"\n{rest}'
    )


def _meshes(folder: Path) -> list[Path]:
    """A tetrahedron as OBJ and as STL, and hands that have it at their fingertips."""
    corners = [(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    lines = ["v {} {} {}".format(*c) for c in corners] + ["f {} {} {}".format(*(i + 1 for i in f)) for f in faces]
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *(x for i in f for x in corners[i]), 0) for f in faces)
    (folder / "pad.obj").write_text("\n".join(lines) + "\n")
    (folder / "pad.stl").write_bytes(bytes(80) + struct.pack("<I", len(faces)) + triangles)
    for end in ("obj", "stl"):
        asset = f'<asset><mesh name="pad" file="pad.{end}"/></asset>'
        tip = '<geom name="{n}_tip" type="mesh" mesh="pad" mass="0.01"/>'
        (folder / f"{end}.xml").write_text(newer_hand(tops=asset, tip=tip))
        _plain_hand(folder, end, asset)
    return [folder / "pad.obj", folder / "pad.stl"]


def _fields(folder: Path) -> list[Path]:
    """A height field as numbers and as a picture, and hands that stand above it."""
    (folder / "ground.hf").write_bytes(struct.pack("<2i12f", 3, 4, *range(12)))
    Image.frombytes("L", (4, 3), bytes(range(12))).save(folder / "ground.png")
    for end, told in (("hf", 'file="ground.hf"'), ("png", 'file="ground.png"')):
        asset = f'<asset><hfield name="ground" size="1 1 0.1 0.1" {told}/></asset>'
        ground = '<worldbody><geom type="hfield" hfield="ground" pos="0 0 -1"/></worldbody>'
        model, sheet = ((ROOT / "sim/models/hands/gripper").with_suffix(e).read_text() for e in (".xml", ".toml"))
        (folder / f"{end}_plain.xml").write_text(model.replace("</mujoco>", f"{asset}{ground}</mujoco>"))
        (folder / f"{end}.toml").write_text(sheet.replace("gripper.xml", f"{end}_plain.xml"))
    return [folder / "ground.hf", folder / "ground.png"]


def _plain_hand(folder: Path, name: str, asset: str) -> None:
    """A hand for the simulation's MuJoCo, with a mesh at both tips."""
    model, sheet = ((ROOT / "sim/models/hands/gripper").with_suffix(end).read_text() for end in (".xml", ".toml"))
    model = model.replace("<default>", f"{asset}<default>", 1).replace(
        '_tip" class', '_tip" type="mesh" mesh="pad" class'
    )
    (folder / f"{name}_plain.xml").write_text(model)
    (folder / f"{name}.toml").write_text(sheet.replace("gripper.xml", f"{name}_plain.xml"))


def _converted(file: Path) -> object:
    """A model for the simulation's MuJoCo, whose numbers are numbers."""
    new = convert_to(file, file.parent / "out")
    model = model_path(read_hand_file(new), new) if new.suffix == ".toml" else new
    for element in read_mjcf(model).root.iter():
        for key, value in element.items():
            assert key in NAMING or not NO_NUMBER.search(value), f"{element.tag} {key} {value}"
    return model


def _tables(folder: Path, ends: Sequence[str]) -> list[Path]:
    for end in ends:
        write_table(folder / f"pushes{end}", HANDS["reference"], made_up(HANDS["reference"]))
    return [folder / f"pushes{end}" for end in ends]


def _written(folder: Path, **texts: str) -> list[Path]:
    files = []
    for name, text in texts.items():
        files.append(folder / f"{name}.toml")
        files[-1].write_text(text)
    return files


def _copied(folder: Path, *names: str) -> list[Path]:
    return [Path(shutil.copy(ROOT / "tests" / "golden" / name, folder)) for name in names]


def _recrc(at: int, head: int) -> Callable[[bytes], bytes]:
    """Makes right the CRC-32 that stands at a byte, of what stands behind the header."""
    return lambda b: b[:at] + zlib.crc32(b[head:]).to_bytes(4, "little") + b[at + 4 :]


def _calibration(folder: Path) -> list[Path]:
    hand = HANDS["reference"]
    theta = dict.fromkeys(Theta(hand).names, 0.1)
    theta |= {name: 0.001 for name in Theta(hand).names if "zero" in name or "radius" in name}
    content = {"format_version": 1, "hand": hand.name, "hand_sha256": hand.sha256, "theta": theta}
    write_json(folder / "theta.json", sealed(content))
    return [folder / "theta.json"]


def _changed_onnx(rng: random.Random, content: bytes) -> bytes:
    """One text of the metadata says something else."""
    model = onnx.load_model_from_string(content)
    text = rng.choice(model.metadata_props)
    text.value = changed_json(rng, text.value.encode()).decode()
    return model.SerializeToString(deterministic=True)


def _resealed_onnx(content: bytes) -> bytes:
    head, mark, rest = content.partition(HASH_MARK)
    return sealed_bytes(head + mark + b"0" * DIGITS + rest[DIGITS:], HASH_MARK)


def _onnx(folder: Path) -> list[Path]:
    return _copied(folder, "aminn.onnx")


def _bag(folder: Path) -> list[Path]:
    hand = HANDS["reference"]
    record(folder / "bag", "MCAP", messages(hand, made_up(hand)))
    (folder / "map.toml").write_text(map_text(hand))
    return list((folder / "bag").glob("*.mcap"))


def _read_bag(bag: Path) -> object:
    return read_table(bag, HANDS["reference"], LABELLED, read_map(bag.parent.parent / "map.toml"))


def targets() -> list[Target]:
    """Every reader of files."""
    hand = HANDS["reference"]

    def table(file: Path) -> object:
        return read_table(file, hand, LABELLED, Map())

    def data(file: Path) -> object:
        return load_dataset(file.parent)

    json_ways, toml_ways = (changed_json, changed_json, reworded, flipped), (reworded, reworded, flipped)
    xml_ways = (changed_xml, changed_xml, changed_xml, reworded, flipped)
    tensor_ways = (changed_tensors, changed_tensors, flipped)
    config = as_toml(load_config())
    grid = 'epochs = 2\n[grid]\nseed = [0, 1]\nkind = ["aminn", "mlp"]\nmodel.width = [16, 32]\n'
    return [
        Target("manifest", lambda f: _dataset(f, "manifest.json"), data, json_ways, _resealed),
        Target("shard", lambda f: _dataset(f, "shard-00000.h5"), data,
               (changed_hdf5, changed_hdf5, flipped), after=_in_manifest),
        Target("model_json", lambda f: _checkpoint(f, META), lambda p: load_checkpoint(p.parent), json_ways),
        Target("weights", lambda f: _checkpoint(f, WEIGHTS), lambda p: load_checkpoint(p.parent), tensor_ways),
        Target("unfinished", _unfinished, lambda p: load_run(p.parent, {"config": {"seed": 0}}), tensor_ways),
        Target("hand_file", lambda f: _hands(f, ".toml"), understand, toml_ways),
        Target("mjcf", lambda f: _hands(f, ".xml"), lambda p: understand(p.with_suffix(".toml")), xml_ways),
        Target("mesh", _meshes, lambda p: understand(p.with_suffix(".toml").with_stem(p.suffix[1:])),
               (reworded, flipped, flipped)),
        Target("height_field", _fields, lambda p: understand(p.with_suffix(".toml").with_stem(p.suffix[1:])),
               (flipped,)),
        Target("convert_mjcf", _newer, _converted, xml_ways),
        Target("convert_urdf", _urdfs, _converted, xml_ways),
        Target("convert_hand_file", _sheets, _converted, toml_ways),
        Target("convert_mesh", _meshes, lambda p: _converted(p.with_name(f"{p.suffix[1:]}.xml")),
               (reworded, flipped, flipped)),
        Target("table_text", lambda f: _tables(f, (".csv", ".jsonl")), table, toml_ways),
        Target("table_hdf5", lambda f: _tables(f, (".h5",)), table,
               (changed_hdf5, changed_hdf5, flipped)),
        Target("table_parquet", lambda f: _tables(f, (".parquet",)), table, (flipped,)),
        Target("config", lambda f: _written(f, config=config), load_config, toml_ways),
        Target("grid", lambda f: _written(f, grid=grid), read_grid, toml_ways),
        Target("vectors", lambda f: _copied(f, "tiny_golden.bin"), read_vectors, (flipped,), _recrc(24, 32)),
        Target("calibration", _calibration, lambda p: read_calibration(p, hand), json_ways, _resealed),
        Target("binary_model", lambda f: _copied(f, "aminn_model.bin"), read_bin_model, (flipped,), _recrc(12, 16)),
        Target("bag", _bag, _read_bag, (flipped,)),
        Target("onnx", _onnx, open_engine, (flipped, _changed_onnx), _resealed_onnx),
    ]  # fmt: skip


def main() -> int:
    """Fuzz, judge, report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, required=True, help="over all targets")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--report", type=Path)
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each target")
    parser.add_argument("--only", action="append")
    args = parser.parse_args()
    chosen = [t for t in targets() if not args.only or t.name in args.only]
    report: dict[str, float] = {"fuzz_files_cases": 0, "fuzz_files_refused": 0, "fuzz_files_taken": 0}
    broken: list[str] = []
    for target in chosen:
        found = fuzz(target, args.work.resolve(), args.seconds / len(chosen), args.first)
        report[f"fuzz_files_{target.name}_cases"] = found.cases
        report["fuzz_files_cases"] += found.cases
        report["fuzz_files_refused"] += found.refused
        report["fuzz_files_taken"] += found.taken
        broken += found.broken
        print(f"{target.name}: {found.cases} cases, {found.refused} refused, {len(found.broken)} broken", flush=True)
    report |= {"fuzz_files_targets": len(chosen), "fuzz_files_broken": len(broken), "fuzz_files_seconds": args.seconds}
    if args.report:
        write_json(args.report, report)
    print("\n".join(broken[:80]))
    return bool(broken)


import hashlib  # noqa: E402

import onnx  # noqa: E402
import torch  # noqa: E402
from lab import made_up  # noqa: E402
from PIL import Image  # noqa: E402
from record import messages, record  # noqa: E402
from synthetic import HANDS, write_dataset  # noqa: E402
from test_bags import map_text  # noqa: E402
from test_convert import ACCEPTED, COLLISION, urdf  # noqa: E402
from test_convert import hand as newer_hand  # noqa: E402

from aminn.calibration.store import read_calibration  # noqa: E402
from aminn.data.dataset import load_dataset  # noqa: E402
from aminn.model.checkpoint import META, WEIGHTS, build_model, load_checkpoint, save_checkpoint  # noqa: E402
from aminn.model.config import ModelConfig, as_toml, load_config  # noqa: E402
from aminn.prediction.engines import open_engine  # noqa: E402
from aminn.prediction.onnx_session import HASH_MARK  # noqa: E402
from aminn.training.run_state import FILE as UNFINISHED  # noqa: E402
from aminn.training.run_state import RunState, load_run, save_run  # noqa: E402
from aminn_app.sweep import read_grid  # noqa: E402
from aminn_base.errors import AminnError  # noqa: E402
from aminn_base.files import write_json  # noqa: E402
from aminn_base.seal import DIGITS, JSON_KEY, sealed, sealed_bytes  # noqa: E402
from aminn_export.files.bin_model import read_bin_model  # noqa: E402
from aminn_export.samples.vectors import read_vectors  # noqa: E402
from aminn_hand.hand_file import model_path, read_hand_file  # noqa: E402
from aminn_hand.theta import Theta  # noqa: E402
from aminn_sim.convert import convert_to  # noqa: E402
from aminn_sim.current_source import NAMING  # noqa: E402
from aminn_sim.mjcf_tree import read_mjcf  # noqa: E402
from aminn_sim.understand import understand  # noqa: E402
from aminn_table import Map, read_map, read_table, write_table  # noqa: E402
from aminn_table.columns import LABELLED  # noqa: E402

if __name__ == "__main__":
    torch.set_num_threads(1)
    sys.exit(main())
