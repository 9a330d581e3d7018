"""Adversarial states, the float64 truth, and equal bits of several compilers; the figures are `make fidelity`'s."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from runtime_models import RandomModel, closure, random_inputs

from aminn_base.errors import AminnError
from aminn_export.export import write_model_files
from aminn_export.files.ranges import state_ranges
from aminn_export.files.tables import dims_of
from aminn_export.judge.fidelity import SquareRootReference, error_figures, failures, missed
from aminn_export.replay.runtime_place import find_in
from aminn_export.replay.targets import DISPATCHED, HOSTED, replay, replay_all, run
from aminn_export.samples.adversarial import KINDS, adversarial_states
from aminn_export.samples.adversarial import closure as own_closure
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import read_results, read_vectors, write_vectors
from aminn_hand.hand import OUTPUTS
from aminn_rt.ranges import within_ranges

GOLDEN = Path(__file__).parents[1] / "golden"
FEW = 40


def test_both_float64_forms_agree(exported: RandomModel) -> None:
    x = {name: np.asarray(value, np.float64) for name, value in random_inputs(200, 3).items()}
    # the forms cut off normals by P and by P P: the same only of what has length one in float64
    x["contacts"][..., 4:7] /= np.linalg.norm(x["contacts"][..., 4:7], axis=-1, keepdims=True) + 1e-300
    plain, root = Reference(exported)(x), SquareRootReference(exported)(x)
    for name in OUTPUTS:  # motions are cut, but have the digits of what they were before: each to its sample's largest
        size = np.abs(plain[name]).reshape(200, -1).max(1)
        difference = np.abs(root[name] - plain[name]).reshape(200, -1).max(1)
        assert (difference <= 1e-7 * size).all(), name


def test_the_closure_is_the_definitions(exported: RandomModel) -> None:
    x = {k: np.asarray(v, np.float64) for k, v in random_inputs(50, 4).items()}
    j_x, j_q = own_closure(x["q"], x["x_ht"], x["contacts"], exported)
    closed = (x["contacts"][..., 0] > 0)[..., None, None]
    other_x, other_q = closure(x["q"], x["x_ht"], x["contacts"], exported.tensors)
    np.testing.assert_allclose(j_x, other_x * closed, atol=1e-14)
    np.testing.assert_allclose(j_q, other_q * closed, atol=1e-14)


def test_adversarial_states_are_what_they_are_called(exported: RandomModel) -> None:
    simulated = random_inputs(300, 5)
    x, kind = adversarial_states(simulated, exported, 80 * len(KINDS), seed=1)
    assert all(np.isfinite(v).all() for v in x.values())
    assert {k: v.shape[1:] for k, v in x.items()} == dims_of(exported).inputs
    rows = {name: kind == k for k, name in enumerate(KINDS)}
    flags = (x["contacts"][..., 0] > 0).sum(1)
    assert (flags[rows["one_contact"]] <= 1).all()
    assert (flags[rows["two_contacts"]] <= 2).all()
    for name in ("straight_fingers", "near_singular_j_q"):
        s = np.linalg.svd(x["j_q"][rows[name]].astype(float), compute_uv=False)
        assert np.median(s[..., 2] / s[..., 0].max()) < 0.05
    assert np.abs(x["w_e"][rows["large_wrench"]]).max() > 100 * np.abs(simulated["w_e"]).mean()
    again, _ = adversarial_states(simulated, exported, 80 * len(KINDS), seed=1)
    assert all(np.array_equal(x[k], again[k]) for k in x)


def test_compilers_give_the_same_bits(tmp_path: Path, exported: RandomModel) -> None:
    names = tuple(
        n
        for n in (
            "x86_64_gcc_O0",
            "x86_64_gcc_O3_avx2_fma",
            "x86_64_gcc_O3_scalar",
            "aarch64_gcc_O2",
            "powerpc_gcc_O2",
            "x86_64_clang_O2",
        )
        if shutil.which(HOSTED[n].compiler) and (not HOSTED[n].emulator or shutil.which(HOSTED[n].emulator))
    )
    names += tuple(n for n, emulator in DISPATCHED.items() if not emulator or shutil.which(emulator.split()[0]))
    x, _ = adversarial_states(random_inputs(100, 6), exported, 160)
    tau = float(np.median(Reference(exported)(x)["p_stable"]))  # half of them hold: only those teach
    folder = tmp_path / "model"
    write_model_files(replace(exported, meta=exported.meta | {"tau": tau}), folder, "aminn_model")
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(folder / "aminn.onnx"), x))
    replays = replay_all(names, folder, "aminn_model", tmp_path / "v.bin", tmp_path, 2)
    contents = {out.read_bytes() for out, _ in replays.values()}
    assert len(contents) == 1
    held = (x["contacts"][..., 0] > 0).any(1)
    assert held.sum() > 100 and (read_results(replays[names[0]][0]).status[held] == 0).all()
    learned = {(told["pushes"], told["calibration_crc"]) for _, told in replays.values()}
    assert len(learned) == 1 and min(learned)[0] > 10, "theta that pushes teach has the same bits too"
    loads = {told["loads_crc"] for _, told in replays.values()}
    assert len(loads) == 1, "and so have the largest admissible loads"


def test_a_core_without_an_fpu_learns_the_same_theta(build_dir: Path, tmp_path: Path) -> None:
    """gcc 12 made wrong code of what learns, and of that alone (compiler.hpp)."""
    golden = read_vectors(GOLDEN / "golden.bin")
    few = tmp_path / "few.bin"
    write_vectors(few, *({k: v[:FEW] for k, v in x.items()} for x in (golden.inputs, golden.reference)))
    out, told = replay("cortex_m3", GOLDEN, "aminn_model", few, tmp_path / "m3")
    host = tmp_path / "host.bin"
    program = find_in(build_dir, "aminn_replay")
    said = run([str(program), str(GOLDEN / "aminn_model.bin"), str(few), str(host)], "aminn_replay")
    assert out.read_bytes() == host.read_bytes() and told["pushes"] > 3
    assert f"calibration_crc {told['calibration_crc']}" in said and f"loads_crc {told['loads_crc']}" in said


def test_an_unknown_target_is_named(export_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(AminnError, match="no target 'z80'"):
        replay("z80", export_dir, "aminn_model", tmp_path / "v.bin", tmp_path)


def test_broken_claims_and_missed_aims_are_told_apart() -> None:
    """Different bits end the target; being less close than ONNX Runtime on some state is stated."""
    close = {"median": 1e-3, "max": 0.05}
    figures = {
        "different_hashes": 1,
        "different_calibrations": 1,
        "different_admissible_loads": 1,
        "refused_simulated": 0,
        "contacts_slide": False,
        "simulated_runtime_p_stable_max": 1e-6,
        "adversarial_in_range_p_stable_max": 1e-6,
    }
    for name in ("simulated", "adversarial"):
        for who in ("runtime", "onnx"):
            figures |= {f"{name}_{who}_dx_over_condition_{q}": value for q, value in close.items()}
            figures[f"{name}_{who}_p_stable_max"] = 1e-6
            figures |= {f"{name}_{who}_{key}_p99": 1e-6 for key in ("k_x", "p_slide", "bound_95", "friction_use")}
    assert failures(figures) == [] and missed(figures) == []
    worse = figures | {"simulated_runtime_dx_over_condition_max": 0.06}
    assert failures(worse) == [] and "of the runtime 0.06, of ONNX Runtime 0.05" in missed(worse)[0]
    further = figures | {"adversarial_runtime_k_x_p99": 2e-6}
    assert failures(further) == [] and missed(further)[0].startswith("adversarial: k_x, 99 of 100")
    broken = figures | {"different_hashes": 2, "refused_simulated": 3}
    broken |= {"simulated_runtime_p_stable_max": 1e-5, "adversarial_in_range_p_stable_max": float("nan")}
    assert [text.split()[0] for text in failures(broken)] == ["the", "3", "simulated:", "adversarial,"]
    other = figures | {"different_calibrations": 2}
    assert failures(other) == ["the targets learn other bits of theta"]
    assert failures(figures | {"different_admissible_loads": 3}) == ["the targets find other admissible loads"]
    far = figures | {"adversarial_runtime_p_stable_max": 3e-6}
    assert failures(far) == ["adversarial: p_stable off by 3e-06"]
    assert missed(far) == ["adversarial: p_stable of the runtime is off by 3e-06, of ONNX Runtime by 1e-06"]
    further = far | {"adversarial_onnx_p_stable_max": 4e-6}
    assert failures(further) == failures(far) and failures(further | {"contacts_slide": True}) == []
    assert failures(far | {"contacts_slide": True}) == failures(far)


def test_states_beyond_the_training_range_are_told_apart() -> None:
    seen = random_inputs(50, 8)
    seen["contacts"][0, 0, 0] = 0.0
    ranges = state_ranges(seen)
    assert within_ranges(seen, ranges).all()
    for name, field, i in (("q", 1, 1), ("x_ht", 2, 8 + 2), ("w_e", 5, 8 + 6 + 5)):
        moved = {k: v.copy() for k, v in seen.items()}
        moved[name][3, field] = ranges["range_max"][i] + 1e-3
        assert np.flatnonzero(~within_ranges(moved, ranges)).tolist() == [3]
    seen["contacts"][:2, 0, 1] = 1e3
    seen["contacts"][:2, 0, 0] = [0.0, 1.0]
    assert np.flatnonzero(~within_ranges(seen, ranges)).tolist() == [1], "out of contact, only the flag counts"
    ranges["range_min"][20] = 0.5
    assert not within_ranges(seen, ranges)[0], "the flag does"


def test_a_bound_that_underflows_in_both_is_no_error() -> None:
    """A load thousands of times that of training: its logarithm is beyond float64."""
    shapes = {
        "dx_ht": (2, 6),
        "p_stable": (2,),
        "gate": (2, 3),
        "p_slide": (2,),
        "friction_use": (2, 3),
        "k_x": (2, 6, 6),
    }
    truth = {name: np.ones(shape) for name, shape in shapes.items()} | {"bound_95": np.array([0.0, 1e-3])}
    found = error_figures(truth | {"bound_95": np.array([0.0, 1.001e-3])}, truth, np.ones(2))
    assert found["bound_95_max"] == pytest.approx(1e-3)
