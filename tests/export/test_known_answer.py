"""The known answer and the identity that every model carries; the compiled runtime in the Python package."""

from __future__ import annotations

import dataclasses
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from runtime_models import RandomModel

from aminn.data.dataset import SPLITS, load_dataset, split_of
from aminn.model.checkpoint import load_checkpoint
from aminn.model.export_tables import export_tables
from aminn_base.errors import AminnError
from aminn_export.export import export
from aminn_export.files.bin_model import bin_model_bytes, read_bin_model
from aminn_export.files.known_answer import REFERENCE_GRASP, answered
from aminn_export.replay.runtime_place import find_in
from aminn_export.samples.vectors import read_results, read_vectors
from aminn_hand.hand import STATE
from aminn_rt.blob import FORMAT_VERSION
from aminn_rt.compiled import runtime

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


def status_of(blob: bytes) -> str:
    return runtime().status_name(runtime().self_test(blob))


def test_the_module_gives_the_bits_of_aminn_replay(build_dir: Path, tmp_path: Path) -> None:
    replay = find_in(build_dir, "aminn_replay")
    model, vectors, out = GOLDEN / "aminn_model.bin", GOLDEN / "golden.bin", tmp_path / "out.bin"
    subprocess.run([str(replay), str(model), str(vectors), str(out)], check=True, capture_output=True)
    inputs, results = read_vectors(vectors).inputs, read_results(out)
    n = len(inputs["q"])
    assert not any(inputs[name].any() for name in runtime().dims.sensors)  # rows have none
    rows = np.concatenate([inputs[name].reshape(n, -1) for name in runtime().dims.inputs], 1)
    outputs, stages, status = runtime().run(model.read_bytes(), rows)
    replayed = np.concatenate([v.reshape(n, -1) for v in results.outputs.values()], 1)
    np.testing.assert_array_equal(outputs[:, :51], replayed.view(np.uint32))
    np.testing.assert_array_equal(outputs[:, 52], results.stable)
    assert not status.any()
    assert stages.any(1).all()


def test_the_module_refuses_what_is_no_model_and_rows_of_another_length() -> None:
    state = np.zeros((1, 44), np.float32)
    with pytest.raises(ValueError, match="not an AMINN model"):
        runtime().run(bytes(1000), state)
    with pytest.raises(ValueError, match=r"44 \(a state\) or 125"):
        runtime().run((GOLDEN / "aminn_model.bin").read_bytes(), np.zeros((1, 43), np.float32))


def test_every_exported_model_passes_its_self_test(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    for weights in ("float32", "float16", "int8"):
        for data in (None, data_dir):
            export(checkpoint_dir, tmp_path / f"{weights}{data is None}", data_dir=data, weights=weights)
            assert status_of((tmp_path / f"{weights}{data is None}" / "aminn_model.bin").read_bytes()) == "AMINN_OK"


def test_a_changed_byte_of_a_sealed_model_is_found(exported: RandomModel) -> None:
    """What the blob's own CRC-32 would tell is told by the content's where only that of the blob was made right."""
    blob = bytearray(bin_model_bytes(exported))
    for at in (
        104,
        144,
        148,
        211,
        224,
        384,
        len(blob) - 448,
    ):  # tau, factor, both SHA-256, eps_jq, table, answer
        changed = bytearray(blob)
        changed[at] ^= 1
        changed[12:16] = struct.pack("<I", zlib.crc32(changed[16:]))
        assert status_of(bytes(changed)) == "AMINN_E_CRC", at


def test_a_mask_that_is_none_is_refused_by_the_file_s_name(exported: RandomModel, tmp_path: Path) -> None:
    blob = bytearray(bin_model_bytes(exported))
    at = blob.index(np.asarray(exported.tensors["coord_mask"], "<f4").tobytes())
    blob[at : at + 4] = struct.pack("<f", 0.5)
    blob[12:16] = struct.pack("<I", zlib.crc32(blob[16:]))
    (tmp_path / "odd.bin").write_bytes(blob)
    with pytest.raises(AminnError, match=r"odd\.bin: model: coord_mask is \[\[0\.5"):
        read_bin_model(tmp_path / "odd.bin")


def test_the_known_state_is_a_stable_training_sample(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    export(checkpoint_dir, tmp_path / "out", data_dir=data_dir)
    model = read_bin_model(tmp_path / "out" / "aminn_model.bin")
    samples = load_dataset(data_dir).samples
    states = np.concatenate([samples[k].reshape(len(samples["q"]), -1) for k in STATE], 1).astype(np.float32)
    rows = np.flatnonzero((states == np.asarray(model.meta["known_state"], np.float32)).all(1))
    assert len(rows) >= 1
    assert (samples["stable"][rows] > 0).all()
    assert (split_of(samples["grasp_id"][rows]) == SPLITS.index("train")).all()
    _, answer = answered(model)
    assert 0 < answer.output.view(np.float32)[0] < 1
    assert answer.output[53] == 0  # nothing to note


def test_without_data_the_state_is_built_in(exported: RandomModel) -> None:
    assert read_state(bin_model_bytes(exported)) == list(np.float32(REFERENCE_GRASP))


def read_state(blob: bytes) -> list[float]:
    at = len(blob) - 448
    return list(np.frombuffer(blob, "<f4", 44, at))


def test_identity(checkpoint_dir: Path, data_dir: Path, tmp_path: Path) -> None:
    export(checkpoint_dir, tmp_path / "a", "left")
    export(checkpoint_dir, tmp_path / "b", "left", name="Left hand, version 2")
    first, second = (read_bin_model(tmp_path / folder / "left.bin").meta for folder in ("a", "b"))
    assert first["name"] == "left" and second["name"] == "Left hand, version 2"
    assert '.name = "Left hand, version 2"' in (tmp_path / "b" / "left.c").read_text()
    assert first["made_by"] == f"aminn {runtime().version()}"
    assert first["checkpoint_sha256"] == load_checkpoint(checkpoint_dir).sha256


def test_hand_and_data_are_those_of_the_training(checkpoint_dir: Path) -> None:
    checkpoint = load_checkpoint(checkpoint_dir)
    meta = checkpoint.meta | {"data": {"hand": 'grip"per'}, "data_config_sha256": "ab" * 32}
    known = export_tables(dataclasses.replace(checkpoint, meta=meta)).meta
    unknown = export_tables(dataclasses.replace(checkpoint, meta={"tau": 0.5})).meta
    assert known["hand"].startswith("grip-per ") and known["data_sha256"] == "ab" * 32
    assert known["hand"].split()[-1] == unknown["hand"].split()[-1]
    assert "data_sha256" not in unknown


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "x" * 56}, "at most 55"),
        ({"made_by": "x" * 40}, "at most 39"),
        ({"name": ""}, "printable ASCII"),
        ({"name": "hände"}, "printable ASCII"),
        ({"hand": 'a"b'}, "printable ASCII"),
        ({"data_sha256": "12"}, "data_sha256"),
        ({"known_state": [0.0] * 44}, "no prediction from the state"),
    ],
)
def test_what_a_model_cannot_carry_is_refused(exported: RandomModel, change: dict, message: str) -> None:
    with pytest.raises(AminnError, match=message):
        bin_model_bytes(dataclasses.replace(exported, meta=exported.meta | change))


def test_models_of_version_7_are_refused_by_number(build_dir: Path, tmp_path: Path) -> None:
    blob = bytearray((GOLDEN / "aminn_model.bin").read_bytes())
    blob[4] = 7
    (tmp_path / "old.bin").write_bytes(blob)
    with pytest.raises(AminnError, match=f"format version 7, this program reads {FORMAT_VERSION}; export it again"):
        read_bin_model(tmp_path / "old.bin")
    command = [str(find_in(build_dir, "aminn_replay")), "old.bin", str(GOLDEN / "golden.bin"), "out.bin"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "AMINN_E_VERSION" in done.stderr and "export it again" in done.stderr


def test_without_the_compiled_runtime_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    runtime.cache_clear()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(AminnError, match="install the package again"):
        runtime()
