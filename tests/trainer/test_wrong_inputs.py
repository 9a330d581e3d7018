"""Commands times wrong inputs: each ends with exit code 1 or 2 and one line: what is wrong, where, what to do."""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import pytest
from click.testing import CliRunner
from safetensors import safe_open
from safetensors.torch import save_file
from synthetic import write_dataset

from aminn.data.dataset import SPLITS, load_dataset, split_of
from aminn.model.checkpoint import CARD, META, WEIGHTS
from aminn.model.config import TrainConfig
from aminn.training.run_state import FILE as UNFINISHED
from aminn.training.train import _Loop as Loop
from aminn.training.train import train
from aminn_app.cli import main

PATIENCE_S = 60  # no case takes a tenth of it; one that hangs must not hang the tests


@dataclass
class Places:
    """A data set, two runs on it, and a folder for what the commands write; all to be broken."""

    root: Path

    def __getattr__(self, name: str) -> Path:
        return self.root / name


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("originals")
    write_dataset(root / "data", grasps=40, cases=6)
    for kind in ("aminn", "mlp"):
        train(TrainConfig(kind=kind, epochs=1), load_dataset(root / "data"), root / kind)
    return root


@pytest.fixture
def places(originals: Path, tmp_path: Path) -> Places:
    shutil.copytree(originals, tmp_path, dirs_exist_ok=True)
    return Places(tmp_path)


@contextmanager
def patience() -> Iterator[None]:
    def give_up(number: int, frame: object) -> None:
        raise TimeoutError(f"the command still runs after {PATIENCE_S} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(PATIENCE_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


COMMANDS: dict[str, str] = {
    "train": "train --data {data} --out {new} --epochs 1 --no-tensorboard",
    "evaluate": "evaluate --data {data} --run {aminn} --run {mlp}",
    "report": "report --data {data} --run {aminn} --out {new}/page.html --reports {new}",
    "explain": "explain --data {data} --run {aminn} --sample 1",
    "export": "export --data {data} --run {aminn} --out {new}",
}


def place_names(places: Places) -> dict[str, Path]:
    """What stands in braces in the commands of this file."""
    return {name: places.root / name for name in ("data", "aminn", "mlp", "new", "file")} | {"root": places.root}


def call(line: str, places: Places) -> tuple[int, str]:
    """Exit code and output of a command whose places stand in braces."""
    names = place_names(places)
    with patience():
        result = CliRunner().invoke(main, [part.format(**names) for part in line.split()])
    return result.exit_code, result.output


def refused(line: str, places: Places) -> str:
    """The message of a command that must not succeed."""
    code, output = call(line, places)
    cannot = 3 if line.startswith("verify") else 1
    assert code in (cannot, 2), f"{line}: exit code {code}\n{output}"
    assert "Traceback" not in output and "fault of AMINN" not in output, output
    errors = [text for text in output.splitlines() if text.startswith("Error: ")]
    assert len(errors) == 1 and output.splitlines()[-1] == errors[0], output
    assert not list(places.root.rglob("*.part*")), "something half written is left"
    return errors[0]


# --- files that are no longer what they were ------------------------------------------------------------------------
TEXTS: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda b: b"",
    "zeros": lambda b: bytes(len(b)),
    "half zeros": lambda b: b[: len(b) // 2] + bytes(len(b) - len(b) // 2),
    "first half zeros": lambda b: bytes(len(b) // 2) + b[len(b) // 2 :],
    "cut": lambda b: b[: len(b) // 2],
    "latin-1": lambda b: b.replace(b'"', b'"\xfc', 1),
    "utf-16": lambda b: b.decode().encode("utf-16"),
    "a list": lambda b: b"[" + b + b"]",
    "a number": lambda b: b"3",
    "a text": lambda b: b'"manifest"',
    "null": lambda b: b"null",
    "deep": lambda b: b"[" * 100_000,
    "no JSON": lambda b: b"<html></html>",
    "NaN": lambda b: b"NaN",
}
READ = {"manifest": "data/manifest.json", "model": f"aminn/{META}"}
WHO_READS = {"manifest": list(COMMANDS), "model": ["evaluate", "report", "explain", "export"]}


@pytest.mark.parametrize("damage", TEXTS)
@pytest.mark.parametrize("what", READ)
def test_a_damaged_text_is_named(places: Places, what: str, damage: str, trust: dict) -> None:
    file = places.root / READ[what]
    file.write_bytes(TEXTS[damage](file.read_bytes()))
    for command in WHO_READS[what]:
        assert str(file) in refused(COMMANDS[command], places)
        count(trust)


BINARIES = {name: TEXTS[name] for name in ("empty", "zeros", "half zeros", "first half zeros", "cut")}


@pytest.mark.parametrize("damage", BINARIES)
@pytest.mark.parametrize("what", ["data/shard-00000.h5", f"aminn/{WEIGHTS}"])
def test_a_damaged_binary_is_named(places: Places, what: str, damage: str, trust: dict) -> None:
    file = places.root / what
    file.write_bytes(BINARIES[damage](file.read_bytes()))
    for command in WHO_READS["manifest" if "shard" in what else "model"]:
        assert str(file.parent) in refused(COMMANDS[command], places)
        count(trust)


@pytest.mark.parametrize("damage", BINARIES)
def test_a_shard_that_was_damaged_before_its_hash_was_taken_is_named(places: Places, damage: str, trust: dict) -> None:
    file, manifest = places.root / "data" / "shard-00000.h5", places.root / "data" / "manifest.json"
    file.write_bytes(BINARIES[damage](file.read_bytes()))
    content = json.loads(manifest.read_text())
    content["shards"][0]["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
    manifest.write_text(json.dumps(content))
    for command in COMMANDS:
        assert str(file) in refused(COMMANDS[command], places)
        count(trust)


def count(trust: dict) -> None:
    trust["inputs_wrong_cases_tried"] = trust.get("inputs_wrong_cases_tried", 0) + 1
    trust["inputs_wrong_with_message"] = trust.get("inputs_wrong_with_message", 0) + 1


OTHER_VALUES = (None, "text", [[1]], {"a": -1})


def keys_of(value: object, depth: int) -> Iterator[tuple[object, ...]]:
    """Paths of the keys in a JSON value, the first item of lists alone."""
    inner = value.items() if isinstance(value, dict) else enumerate(value[:1]) if isinstance(value, list) else ()
    for key, item in inner:
        yield (key,)
        if depth > 1:
            yield from ((key, *rest) for rest in keys_of(item, depth - 1))


def changed(value: dict, path: tuple, new: object) -> dict:
    """A copy with another value at a path; `changed` itself as value: without the key."""
    copy = json.loads(json.dumps(value))
    holder = copy
    for key in path[:-1]:
        holder = holder[key]
    if new is changed:
        del holder[path[-1]]
    else:
        holder[path[-1]] = new
    return copy


@pytest.mark.parametrize(("what", "command"), [("manifest", "explain"), ("model", "explain"), ("model", "report")])
def test_a_missing_key_or_another_type_never_ends_in_a_traceback(
    places: Places, what: str, command: str, trust: dict
) -> None:
    """Not every key is read by every command: what counts is that a failure is a message that names the file."""
    file, depth = places.root / READ[what], 1 if command == "report" else 2
    (places.aminn / CARD).unlink()  # it would name every change of the model
    whole, silent = json.loads(file.read_text()), []
    for path in keys_of(whole, depth):
        if command == "report" and path[0] not in ("history", "operating_curve"):
            continue  # what the page alone reads
        for new in (changed, *OTHER_VALUES):
            file.write_text(json.dumps(changed(whole, path, new)))
            code, output = call(COMMANDS[command], places)
            good = code == 0 or (code == 1 and "fault of AMINN" not in output)
            trust["inputs_wrong_cases_tried"] = trust.get("inputs_wrong_cases_tried", 0) + 1
            trust["inputs_wrong_with_message"] = trust.get("inputs_wrong_with_message", 0) + int(good)
            if not good:
                silent.append(f"{command}: {'.'.join(map(str, path))} = {new!r}: {output[-250:]}")
    assert not silent, f"{len(silent)} of them:\n" + "\n".join(silent[:20])


# --- an unfinished run ----------------------------------------------------------------------------------------------
@pytest.fixture
def unfinished(places: Places, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that was interrupted after its first epoch."""
    settings, data = TrainConfig(epochs=2), load_dataset(places.data)

    run = places.root / "unfinished"
    epoch = Loop.epoch

    def stop_later(loop: Loop) -> None:
        if loop.history["validation"]:
            raise KeyboardInterrupt
        epoch(loop)

    with monkeypatch.context() as patched:
        patched.setattr(Loop, "epoch", stop_later)
        with pytest.raises(KeyboardInterrupt):
            train(settings, data, run)
    return run / UNFINISHED


def without(file: Path, tensor: str | None, progress: str | None, value: object = None) -> None:
    """Write the state of a run again without one of its tensors, or with another value in its progress."""
    with safe_open(file, "pt") as state:
        metadata = dict(state.metadata())
        tensors = {name: state.get_tensor(name) for name in state.keys() if name != tensor}
    if progress:
        content = json.loads(metadata["progress"])
        content[progress] = value
        metadata["progress"] = json.dumps(content)
    save_file(tensors, file, metadata)


@pytest.mark.parametrize("damage", [*BINARIES, "rng", "adam.0.step", "stage", "epoch", "history", "schedule"])
def test_a_damaged_unfinished_run_is_named(places: Places, unfinished: Path, damage: str, trust: dict) -> None:
    line = "train --data {data} --out {root}/unfinished --epochs 2 --no-tensorboard"
    if damage in BINARIES:
        unfinished.write_bytes(BINARIES[damage](unfinished.read_bytes()))
    elif damage in ("rng", "adam.0.step"):
        without(unfinished, damage, None)
    else:
        without(unfinished, None, damage, "text")
    assert f"{unfinished}: the unfinished run there is damaged" in refused(line, places)
    count(trust)


# --- options, places and data that cannot be ------------------------------------------------------------------------
DIGITS = "9" * 5000
WRONG: tuple[tuple[str, str], ...] = (
    ("simulate --out {new} --seed -1", "--seed"),
    ("simulate --out {new} --seed 18446744073709551616", "seed is 18446744073709551616, expected 0 to 2^64 - 1"),
    ("simulate --out {new} --seed one", "--seed"),
    ("simulate --out {new} --grasps 0", "--grasps"),
    ("simulate --out {new} --grasps 1000000000000", "grasps is 1000000000000"),
    ("simulate --out {new} --cases 1000000000000", "cases is 1000000000000"),
    ("simulate --out {new} --cases 1e12", "--cases"),
    ("simulate --out {new} --threads 0", "--threads"),
    ("simulate --out {new} --threads 1000000000", "threads is 1000000000, expected"),
    ("simulate --out {new} --shard-grasps 1000000000000", "shard_grasps is 1000000000000"),
    ("simulate --out {new} --family banana", "banana"),
    ("simulate --out {new} --family capsule --family capsule", "names one twice"),
    ("simulate --out {new} --engine spark", "--engine"),
    ("gallery --data {data} --count 0", "--count"),
    ("simulate --out {new} --set", "--set"),
    ("simulate --out {new} --set grasps=3", "give --grasps"),
    ("simulate --out {new} --set cases=3", "give --cases"),
    ("simulate --out {new} --set seed=3", "give --seed"),
    ("simulate --out {new} --set shard_grasps=3", "give --shard-grasps"),
    ("simulate --out {new} --set families=capsule", "give --family"),
    ("simulate --out {new} --set ramps_s=1", "did you mean ramp_s?"),
    ("simulate --out {new} --set =1", "expected NAME=VALUE"),
    ("simulate --out {new} --set ramp_s=", "'' is not a number"),
    ("simulate --out {new} --set ramp_s=inf", "ramp_s is inf"),
    ("simulate --out {new} --set ramp_s=nan", "ramp_s is nan"),
    ("simulate --out {new} --set ramp_s=" + DIGITS, "ramp_s is inf"),
    ("simulate --out {new} --set grasp_attempts=" + DIGITS, "is not an integer"),
    ("simulate --out {new} --set grasp_attempts=1e3", "is not an integer"),
    ("simulate --out {new} --set drift_window_s=0.0004", "drift_window_s is 0.0004"),
    ("simulate --out {new} --set stop_factor=-1", "stop_factor is -1"),
    ("simulate --out {file}", "--out"),
    ("simulate --out {file}/data", "{file}"),
    ("simulate --out {new} --hand {data}", "{data}: cannot be read"),
    ("simulate --out {new} --hand {file}", "{file}: not valid TOML"),
    ("simulate --out {new} --hand {aminn}/model.safetensors", "not UTF-8"),
    ("gallery --data {data} --count 2", "{data}: not a readable data set"),
    ("card --data {data}", "{data}: not a readable data set"),
    ("train --data {file} --out {new}", "--data"),
    ("train --data {new} --out {new}", "--data"),
    ("train --data {root} --out {new}", "no manifest.json"),
    ("train --data {data} --out {file}", "--out"),
    ("train --data {data} --out {mlp}", "config.kind"),
    ("train --data {data} --out {new} --model forest", "--model"),
    ("train --data {data} --out {new} --seed 18446744073709551616", "seed: input should be less than"),
    ("train --data {data} --out {new} --epochs 0", "--epochs"),
    ("train --data {data} --out {new} --epochs 1000000000000", "epochs: input should be less than"),
    ("train --data {data} --out {new} --set model.width=1000000000", "model.width: input should be less than"),
    ("train --data {data} --out {new} --set batch=0", "batch: input should be greater than 0"),
    ("train --data {data} --out {new} --set batch=" + DIGITS, "batch:"),
    ("train --data {data} --out {new} --set seed=1e400", "seed: input should be a finite number"),
    ("train --data {data} --out {new} --set loss=3", "loss: input should be a dictionary"),
    ("train --data {data} --out {new} --set model.mechanics=3", "model.mechanics: input should be a valid tuple"),
    ("train --data {data} --out {new} --set model.gate_nominal=[1,2]", "model.gate_nominal"),
    ("train --data {data} --out {new} --set loss.=3", "loss. is no setting"),
    ("train --data {data} --out {new} --set train_fraction=1e-9", "the train split has 0 grasps"),
    ("train --data {data} --out {new} --config {data}", "--config"),
    ("train --data {data} --out {new} --config {new}", "--config"),
    ("train --data {data} --out {new} --config {file}", "{file}: not valid TOML"),
    ("train --data {data} --out {new} --config {aminn}/model.safetensors", "not UTF-8"),
    ("evaluate --data {data} --run {data}", "model.safetensors is missing"),
    ("evaluate --data {data} --run {aminn} --run {aminn}", "given twice"),
    ("evaluate --data {data} --run {aminn} --split banana", "--split"),
    ("evaluate --data {data} --run {aminn} --json {data}", "--json"),
    ("evaluate --data {data} --run {aminn} --json {file}/x", "{file}"),
    ("report --data {data} --run {aminn} --verification {file}", "{file}: not a report of `aminn verify --json`"),
    ("report --data {data} --run {aminn} --verification {data}/manifest.json", "not a report of `aminn verify"),
    ("report --data {data} --run {aminn} --reports {root} --out {new}/x.html", "{root}/odd.json: not a report"),
    ("report --data {data} --run {aminn} --out {data}", "--out"),
    ("explain --data {data} --run {aminn} --sample -1", "--sample"),
    ("explain --data {data} --run {aminn} --sample 1000000000000000000000", "load cases 0 to"),
    ("explain --data {data} --run {mlp} --sample 1", "no mechanics to explain"),
    ("explain --data {data} --run {aminn} --sample 1 --out {new}.bmp", "written as .png"),
    ("export --data {data} --run {mlp} --out {new}", "no mechanics layer"),
    ("export --data {data} --run {aminn} --out {file}", "--out"),
    ("export --data {data} --run {aminn} --out {new} --weights float8", "--weights"),
    ("export --data {data} --run {aminn} --out {new} --prefix 1a", "1a"),
    ("verify --export {aminn} --data {data} --build {root}", "{aminn}"),
)


@pytest.mark.parametrize(("line", "message"), WRONG, ids=[line[:60] for line, _ in WRONG])
def test_wrong_options_and_places_are_named(places: Places, line: str, message: str, trust: dict) -> None:
    places.file.write_text("neither = = one")
    (places.root / "odd.json").write_text("[1]")
    assert message.format(**place_names(places)) in refused(line, places)
    assert not places.new.exists() or not list(places.new.iterdir())
    count(trust)


# --- data of one outcome --------------------------------------------------------------------------------------------
def with_labels(folder: Path, split: str, stable: int) -> None:
    """Give every load case of a split one label."""
    file, manifest = folder / "shard-00000.h5", json.loads((folder / "manifest.json").read_text())
    with h5py.File(file, "r+") as shard:
        labels, ids = shard["samples/stable"][()], shard["samples/grasp_id"][()]
        labels[split_of(ids) == SPLITS.index(split)] = stable
        shard["samples/stable"][...] = labels
    manifest["shards"][0]["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize("command", ["evaluate", "report"])
@pytest.mark.parametrize("split", ["test", "validation"])
def test_data_without_a_stable_case_are_refused_with_words(places: Places, command: str, split: str) -> None:
    with_labels(places.data, split, 0)
    assert f"load cases of the {split} split is stable, and figures are over stable ones" in refused(
        COMMANDS[command], places
    )


@pytest.mark.parametrize("command", ["evaluate", "report"])
def test_data_without_an_unstable_case_are_judged(places: Places, command: str) -> None:
    with_labels(places.data, "test", 1)
    code, output = call(COMMANDS[command], places)
    assert code == 0, output


def test_a_report_lists_whatever_other_reports_hold(places: Places) -> None:
    places.new.mkdir()
    odd = {"nested": {"b": [1, 2]}, "list": [1], "none": None, "huge": 1e400, "no": False, "text": "<b>"}
    (places.new / "odd.json").write_text(json.dumps(odd))
    (places.root / "checked.json").write_text(json.dumps(odd | {"ok": True, "failures": [1], "host_c_refused": "x"}))
    code, output = call(COMMANDS["report"] + " --verification {root}/checked.json", places)
    assert code == 0, output
    assert "&lt;b&gt;" in (places.new / "page.html").read_text()


@pytest.mark.parametrize("text", [b"\xef\xbb\xbfepochs = 1\r\nbatch = 64\r\n", b"epochs = 1\r\n\r\nbatch = 64"])
def test_settings_of_other_editors_are_read(places: Places, text: bytes) -> None:
    """With a byte-order mark, with CRLF."""
    places.file.write_bytes(text)
    code, output = call("train --data {data} --out {new} --no-tensorboard --config {file}", places)
    assert code == 0, output
    assert json.loads((places.new / META).read_text())["identity"]["config"]["batch"] == 64
