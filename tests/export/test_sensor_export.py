"""Sensors and sliding contacts from exported files: the C runtime repeats ONNX, vector files carry what it is told."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hands import Model, random_model, random_states
from numpy.typing import NDArray
from runtime_models import SLIDES, UNCUT, random_sensors
from test_theta_export import ALL, NEEDED, N, relative, replayed, thetas

from aminn_base.errors import AminnError
from aminn_export.export import write_model_files
from aminn_export.files.bin_model import read_bin_model, write_bin_model
from aminn_export.files.onnx_model import ONNX_FILE, read_metadata
from aminn_export.judge.verify import load_samples, verify
from aminn_export.replay.targets import replay_all
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import read_vectors, write_vectors
from aminn_hand import Hand
from aminn_hand.hand import OUTPUTS
from aminn_hand.sensors import FRICTION_CLASSES

E_SENSORS = -25
Inputs = dict[str, NDArray[np.float32]]


def made(slides: bool, told: bool = True) -> tuple[Hand, Model]:
    hand = ALL["reference"]()
    return hand, random_model(hand, 3, told=told, slides=slides, sensing=True)


def exported(model: Model, folder: Path) -> Path:
    folder.mkdir()
    write_model_files(model, folder, "aminn_model")
    return folder


@pytest.mark.parametrize("slides", [False, True])
def test_the_runtime_repeats_onnx(slides: bool, build_dir: Path, tmp_path: Path, trust: dict) -> None:
    """From both forms of a model that sees sensors and theta, and on the emulated Cortex-M7: the same bits."""
    hand, model = made(slides)
    out, vectors = exported(model, tmp_path / "export"), tmp_path / "vectors.bin"
    x = random_states(hand, 200, 5) | {"theta": 0.2 * thetas(hand, 200)} | random_sensors(hand.dims, 200, 6)
    x["w_e"] *= np.float32(0.2)
    write_vectors(vectors, x, run_onnx(single_thread_session(out / ONNX_FILE), x))
    targets = ("cortex_m7",) if all(map(shutil.which, NEEDED)) else ()
    report = verify(out, vectors, build_dir, on_targets=targets, echo=lambda _: None)
    assert [report[f"{target}_different_words"] for target in ("host_c", *targets)] == [0] * (1 + len(targets))
    assert report["host_bin_refused"] == 0 and 0 < report["host_bin_dx_relative_median"] < 2e-6
    assert slides or report["ok"], report["failures"]
    trust[f"sensors_{'slide' if slides else 'stick'}_dx_share_of_limit_max"] = report["host_bin_dx_share_of_limit_max"]


@pytest.mark.skipif(not all(map(shutil.which, NEEDED)), reason="needs a compiler for the Cortex-M7, and its emulator")
def test_pushes_and_loads_have_the_same_bits_where_sensors_are_told(tmp_path: Path) -> None:
    """What a board and a host learn from samples with sensors, and the largest loads that they find."""
    hand, model = made(slides=True, told=False)
    out, vectors = exported(model, tmp_path / "export"), tmp_path / "vectors.bin"
    x = random_states(hand, 64, 5) | random_sensors(hand.dims, 64, 6)
    write_vectors(vectors, x, run_onnx(single_thread_session(out / ONNX_FILE), x))
    replays = replay_all(("x86_64_gcc_O0", "cortex_m7"), out, "aminn_model", vectors, tmp_path, 2)
    figures = {tuple(told[name] for name in ("pushes", "calibration_crc", "loads_crc")) for _, told in replays.values()}
    assert len(figures) == 1 and min(figures)[0] > 10


def test_what_is_told_changes_what_is_predicted_and_what_is_not_does_not(build_dir: Path, tmp_path: Path) -> None:
    """What stands behind a 0 has no influence; a flag that is none, or friction of 0, spoils its own sample alone."""
    hand, model = made(slides=SLIDES, told=False)
    x, told = random_states(hand, N, 2), random_sensors(hand.dims, N, 3)
    unknown = {name: np.zeros_like(value) for name, value in told.items()}
    nothing = {
        name: np.where(np.arange(value.shape[1]) > 0, 0.3, 0).repeat(N).reshape(-1, N).T for name, value in told.items()
    }
    told["friction"][5], told["tool_weight"][7, 0] = [1, 0, 0.1], 0.5
    write_bin_model(model, tmp_path / "model.bin")
    found = {}
    for name, sensors in {"told": told, "nothing": nothing, "unknown": unknown, "without": {}}.items():
        write_vectors(tmp_path / f"{name}.bin", x | sensors, Reference(model)(x))
        found[name] = replayed(build_dir, tmp_path / "model.bin", tmp_path / f"{name}.bin", tmp_path / "out.bin")
    assert found["told"].status.tolist() == [E_SENSORS * (i in (5, 7)) for i in range(N)]
    good = found["told"].status == 0
    told = {name: np.where(good[:, None], value, 0) for name, value in told.items()}
    exact = Reference(model)(x | told)
    assert relative(found["told"].outputs["dx_ht"][good], exact["dx_ht"][good]) < 1e-4
    assert relative(found["without"].outputs["dx_ht"][good], exact["dx_ht"][good]) > 1e-2
    for name in OUTPUTS:
        want = found["without"].outputs[name]
        assert np.array_equal(found["unknown"].outputs[name], want), name
        assert np.array_equal(found["nothing"].outputs[name], want), name


def test_vectors_keep_sensors(tmp_path: Path) -> None:
    hand, model = made(slides=False)
    x = random_states(hand, N, 2) | {"theta": thetas(hand, N)} | random_sensors(hand.dims, N)
    exact = Reference(model)(x)
    write_vectors(tmp_path / "v.bin", x, exact)
    again = read_vectors(tmp_path / "v.bin")
    assert again.inputs.keys() == x.keys()
    assert all(np.array_equal(again.inputs[name], value) for name, value in x.items())
    assert again.dims.tendons == hand.dims.tendons
    gripper = ALL["gripper"]().dims
    with pytest.raises(AminnError, match="of another hand"):
        read_vectors(tmp_path / "v.bin", gripper)
    with pytest.raises(AminnError, match="tool_weight is missing"):
        write_vectors(tmp_path / "w.bin", {k: v for k, v in x.items() if k != "tool_weight"}, exact)


def test_a_model_that_sees_no_sensors_takes_none(export_dir: Path, tmp_path: Path) -> None:
    hand = ALL["reference"]()
    x = random_states(hand, N, 2)
    write_vectors(tmp_path / "v.bin", x | random_sensors(hand.dims, N), Reference(random_model(hand))(x))
    with pytest.raises(AminnError, match="has sensors for each sample, which the model does not see"):
        load_samples(tmp_path / "v.bin", model=read_bin_model(export_dir / "aminn_model.bin"))


def test_the_files_say_what_a_model_sees(tmp_path: Path) -> None:
    _, model = made(slides=True)
    out = exported(model, tmp_path / "export")
    metadata = read_metadata(out / ONNX_FILE)
    assert metadata["sensors"] is True and metadata["friction"] == "secant"
    assert metadata["motion_limits"] == list(UNCUT)
    assert metadata["friction_classes"]["mid"] == pytest.approx(FRICTION_CLASSES["mid"])
    assert {"friction", "tool_weight", "tendon_tension", "bound_95"} <= metadata["units"].keys()
    header = (out / "aminn_hand.h").read_text()
    assert "#define AMINN_N_SLIDE 1" in header and "#define AMINN_N_TENDON 6" in header
    back = read_bin_model(out / "aminn_model.bin").meta
    assert (back["slides"], back["sensing"], back["told"], back["tendons"]) == (True, True, True, 6)
