"""Theta in the exported forms: the float64 model is that of another hand; ONNX and the C runtime follow it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import onnx
import pytest
from hands import HANDS, Model, random_model, random_states
from numpy.typing import NDArray
from onnxruntime.capi.onnxruntime_pybind11_state import Fail, InvalidArgument

from aminn.hand.nominal import nominal_of
from aminn_base.errors import AminnError
from aminn_export.export import write_model_files
from aminn_export.files.bin_model import read_bin_model, write_bin_model
from aminn_export.files.onnx_model import ONNX_FILE, build_onnx, read_metadata
from aminn_export.judge.verify import load_samples, verify
from aminn_export.replay.runtime_place import find_in
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import Results, read_results, read_vectors, write_vectors
from aminn_hand import Hand
from aminn_hand.theta import Theta
from aminn_rt.compiled import runtime
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

ALL: dict[str, Callable[[], Hand]] = {"reference": cache(lambda: understand(default_hand_file()).hand), **HANDS}
N = 40
NEEDED = ("arm-none-eabi-gcc", "qemu-system-arm", "cmake")
E_CALIBRATION = -24


def thetas(hand: Hand, n: int, seed: int = 0) -> NDArray[np.float32]:
    """(n, P): factors of a half to twice, joint zeros and a radius, which models do not look at."""
    theta = np.random.default_rng(seed).uniform(-0.7, 0.7, (n, len(Theta(hand))))
    theta[:, Theta(hand).factors :] *= 0.05
    return theta.astype(np.float32)


def rebuilt(model: Model, hand: Hand) -> Model:
    """The model with the nominal mechanics of another hand in its tables."""
    nominal = nominal_of(hand)
    own = {"chol_nom": nominal.chol, "tendon_gain_nom": nominal.tendon_gain, "twist_nom": nominal.twist}
    eps_m = [[branch.eps_m * factor for branch in hand.branches] for factor in (1.0, 0.8)]
    tensors = model.tensors | {k: np.asarray(v, np.float32) for k, v in own.items() if k in model.tensors}
    tensors |= {f"s{i}.eps_m": np.array(values, np.float32) for i, values in enumerate(eps_m, 1)}
    return replace(model, meta=model.meta | {"eps_m": eps_m}, tensors=tensors)


def relative(found: NDArray, wanted: NDArray) -> float:
    """Largest difference over the sample's size."""
    axes = tuple(range(1, np.ndim(wanted)))
    return float((np.abs(found - wanted).max(axes) / np.abs(wanted).max(axes)).max())


@pytest.mark.parametrize("name", ALL)
def test_theta_is_another_hand(name: str) -> None:
    hand = ALL[name]()
    model, x = random_model(hand), random_states(hand, N, 2)
    theta = thetas(hand, 1)[0]
    other = rebuilt(model, Theta(hand).varied(theta))
    found = Reference(model)(x | {"theta": np.tile(theta, (N, 1))})
    wanted, nominal = Reference(other)(x), Reference(model)(x)
    assert relative(found["dx_ht"], wanted["dx_ht"]) < 1e-5  # float32 tables
    assert relative(found["k_x"], wanted["k_x"]) < 1e-5
    assert relative(nominal["k_x"], wanted["k_x"]) > 0.05


STICK = [(name, False, 2e-5) for name in ALL]


@pytest.mark.parametrize(("name", "slides", "most"), [*STICK, ("reference", True, 2e-4)])
def test_the_graph_follows_theta(name: str, slides: bool, most: float) -> None:
    hand = ALL[name]()
    model, x, theta = random_model(hand, told=True, slides=slides), random_states(hand, N, 2), thetas(hand, N)
    graph = build_onnx(model, debug=True)
    onnx.checker.check_model(graph, full_check=True)
    assert {node.domain for node in graph.graph.node} == {""}
    session, exact = single_thread_session(graph.SerializeToString()), Reference(model)
    names = [output.name for output in session.get_outputs()]
    for given in (x | {"theta": theta}, x, x | {"theta": theta[:1]}):
        found, wanted = dict(zip(names, session.run(names, given), strict=True)), exact(given)
        for output in ("dx_ht", "k_x", "s1_k_spring", "s2_k_spring"):
            assert relative(found[output], wanted[output]) < most, output
        assert np.abs(found["p_stable"] - wanted["p_stable"]).max() < 1e-5
    zeros = session.run(names, x | {"theta": 0 * theta})
    nominal = session.run(names, x)
    assert all(np.array_equal(a, b) for a, b in zip(zeros, nominal, strict=True))


def test_a_theta_of_another_batch_is_refused() -> None:
    hand = ALL["reference"]()
    session = single_thread_session(build_onnx(random_model(hand, told=True)).SerializeToString())
    x, theta = random_states(hand, N, 2), thetas(hand, N)
    for inputs in (x | {"theta": theta[:7]}, {k: v[:1] for k, v in x.items()} | {"theta": theta}):
        with pytest.raises((Fail, InvalidArgument)):
            session.run(None, inputs)


def test_what_is_not_told_has_the_graph_that_it_had() -> None:
    hand = ALL["reference"]()
    untold, told = (build_onnx(random_model(hand, told=flag)) for flag in (False, True))
    assert [i.name for i in untold.graph.input] == ["q", "x_ht", "w_e", "contacts", "j_x", "j_q"]
    assert not any("theta" in text for node in untold.graph.node for text in (node.name, *node.input))
    assert [i.name for i in told.graph.input][-1] == "theta"
    (default,) = [i for i in told.graph.initializer if i.name == "theta"]
    assert default.dims == [1, 22] and not onnx.numpy_helper.to_array(default).any()


@pytest.fixture(scope="module")
def told_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("told")
    write_model_files(random_model(ALL["reference"](), told=True), folder, "aminn_model")
    return folder


def test_the_runtime_repeats_onnx(told_dir: Path, build_dir: Path, tmp_path: Path, trust: dict) -> None:
    """From both forms of the model, and on the emulated Cortex-M7: within limits, the same bits."""
    hand, vectors = ALL["reference"](), tmp_path / "vectors.bin"
    x = random_states(hand, 200, 5) | {"theta": thetas(hand, 200)}
    write_vectors(vectors, x, run_onnx(single_thread_session(told_dir / ONNX_FILE), x))
    targets = ("cortex_m7",) if all(map(shutil.which, NEEDED)) else ()
    report = verify(told_dir, vectors, build_dir, on_targets=targets, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert 0 < report["host_bin_dx_relative_median"] < 2e-6 and report["host_bin_refused"] == 0
    assert [report[f"{target}_different_words"] for target in ("host_c", *targets)] == [0] * (1 + len(targets))
    trust["theta_dx_share_of_limit_max"] = report["host_bin_dx_share_of_limit_max"]


def replayed(build_dir: Path, model: Path, vectors: Path, out: Path) -> Results:
    command = [find_in(build_dir, "aminn_replay"), model, vectors, out]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    return read_results(out)


@pytest.mark.parametrize(("friction", "most"), [(1e6, 1e-5), (0.75, 3e-5)])
def test_theta_in_c_is_another_hand(friction: float, most: float, build_dir: Path, tmp_path: Path) -> None:
    """Also of a model that is not told: its layer follows. A theta beyond the bounds spoils its own sample alone."""
    hand = ALL["reference"]()
    model, x, theta = random_model(hand), random_states(hand, N, 2), thetas(hand, 1)
    model.meta["friction_nominal"] = friction  # with much of it nothing slides
    exact = Reference(model)(x | {"theta": np.tile(theta, (N, 1))})
    rows = np.tile(theta, (N, 1))
    rows[5, 0] = 3.5
    write_vectors(tmp_path / "theta.bin", x | {"theta": rows}, exact)
    write_vectors(tmp_path / "plain.bin", x, exact)
    write_bin_model(model, tmp_path / "model.bin")
    write_bin_model(rebuilt(model, Theta(hand).varied(theta[0])), tmp_path / "other.bin")
    found = replayed(build_dir, tmp_path / "model.bin", tmp_path / "theta.bin", tmp_path / "a.bin")
    other = replayed(build_dir, tmp_path / "other.bin", tmp_path / "plain.bin", tmp_path / "b.bin")
    good = np.arange(N) != 5
    assert found.status.tolist() == [E_CALIBRATION * (i == 5) for i in range(N)]
    assert runtime().status_name(E_CALIBRATION) == "AMINN_E_CALIBRATION"
    assert np.isnan(found.outputs["dx_ht"][5]).all() and found.outputs["p_stable"][5] == 0
    assert relative(found.outputs["dx_ht"][good], exact["dx_ht"][good]) < most
    assert relative(found.outputs["dx_ht"][good], other.outputs["dx_ht"][good]) < most


def test_the_files_say_what_a_model_is_told(told_dir: Path) -> None:
    hand, metadata = ALL["reference"](), read_metadata(told_dir / ONNX_FILE)
    assert metadata["told"] is True and metadata["theta_names"] == list(Theta(hand).names)
    assert metadata["theta_units"][-2:] == ["rad", "m"] and "theta" in metadata["units"]
    header = (told_dir / "aminn_hand.h").read_text()
    assert 'X("tendon_thumb_distal_flexor")' in header and "#define AMINN_N_STIFF 10" in header
    model = read_bin_model(told_dir / "aminn_model.bin")
    assert model.meta["told"] is True and model.tensors["theta_terms"].shape == (11, 3, 7)


def test_vectors_keep_theta(tmp_path: Path) -> None:
    hand = ALL["reference"]()
    x = random_states(hand, N, 2) | {"theta": thetas(hand, N)}
    exact = Reference(random_model(hand))(x)
    outputs = {name: exact[name] for name in hand.dims.outputs}
    write_vectors(tmp_path / "v.bin", x, outputs, outputs)
    again = read_vectors(tmp_path / "v.bin")
    assert all(np.array_equal(again.inputs[name], value) for name, value in x.items())
    assert again.reference_f64 is not None and np.array_equal(again.reference_f64["dx_ht"], exact["dx_ht"])
    with pytest.raises(AminnError, match="22 numbers of theta a sample, which are not those of the hand"):
        read_vectors(tmp_path / "v.bin", replace(hand.dims, stiff=9))
    with pytest.raises(AminnError, match=r"theta has shape \(40,\)"):
        write_vectors(tmp_path / "w.bin", x | {"theta": x["theta"][:, 0]}, outputs)


def test_a_model_that_is_not_told_takes_no_theta(export_dir: Path, tmp_path: Path) -> None:
    hand = ALL["reference"]()
    x = random_states(hand, N, 2) | {"theta": thetas(hand, N)}
    write_vectors(tmp_path / "v.bin", x, Reference(random_model(hand))(x))
    with pytest.raises(AminnError, match="has a theta for each sample, which the model is not told"):
        load_samples(tmp_path / "v.bin", model=read_bin_model(export_dir / "aminn_model.bin"))
