"""`aminn_calibrate_push()` beside its float64 oracle, and the oracle's slopes beside differences."""

from __future__ import annotations

import ctypes
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hands import random_model, random_states
from numpy.typing import NDArray
from runtime_models import random_sensors

from aminn_export.files.bin_model import bin_model_bytes
from aminn_export.files.hand_header import write_hand_header
from aminn_export.samples.recursion import DOUBTED, LEARNED, Recursion, Settings
from aminn_export.samples.reference import Reference
from aminn_hand.theta import Theta
from aminn_rt.compiled import runtime
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

RUNTIME = Path(__file__).resolve().parents[2] / "runtime"
HAND = understand(default_hand_file()).hand
F, P = Theta(HAND).factors, len(Theta(HAND))
STATE = HAND.dims.state
MEASURED = ("q", "x_ht", "w_e", "contacts")
SHIM = """
#include "aminn_rt.h"
#include <string.h>

/* of each push: status, outcome, theta, standard deviations; friction with what its sensor says */
int learn(const void *blob, size_t size, const float *first, const float *pushes, const float *sensors, float prior,
          int n, int *said, float *found, float *friction)
{
    static aminn_t ctx;
    static aminn_calibrator_t calibrator;
    static aminn_sensors_t known;
    aminn_calibrator_settings_t settings = aminn_calibrator_defaults;
    aminn_model_t model;
    int i, k, status = aminn_model_from_blob(blob, size, &model);
    settings.prior = prior;
    status = status == AMINN_OK ? aminn_init(&ctx, &model, 0) : status;
    status = status == AMINN_OK ? aminn_calibrator_init(&calibrator, &model, first, &settings) : status;
    status = status == AMINN_OK && sensors != NULL ? aminn_sense(&ctx, &known) : status;
    for (i = 0; i < n && status == AMINN_OK; ++i) {
        aminn_state_t state;
        memcpy(&state, pushes, sizeof state);
        memcpy(&known, sensors != NULL ? sensors + AMINN_N_SENSOR * i : (const float *)&known, sizeof known);
        said[2 * i] = aminn_calibrate_push(&ctx, &calibrator, &state, pushes + AMINN_N_STATE);
        said[2 * i + 1] = (int)calibrator.outcome;
        status = aminn_calibrator_friction(&calibrator, &state, known.friction, friction + 3 * i);
        memcpy(found, calibrator.calibration.theta, sizeof calibrator.calibration.theta);
        found += AMINN_N_THETA;
        for (k = 0; k < AMINN_N_FACTOR; ++k) {
            *found++ = aminn_calibrator_sd(&calibrator, k);
        }
        pushes += AMINN_N_STATE + AMINN_N_WRENCH;
    }
    return status;
}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The runtime of models whose contacts stick: the oracle's slopes are exact of these."""
    return compiled(tmp_path_factory.mktemp("sticking"), slides=False)


@pytest.fixture(scope="module")
def sliding_library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return compiled(tmp_path_factory.mktemp("sliding"), slides=True)


def compiled(folder: Path, slides: bool) -> ctypes.CDLL:
    """The runtime of models whose contacts slide, or stick."""
    (folder / "shim.c").write_text(SHIM)
    header = write_hand_header(random_model(HAND, slides=slides, sensing=slides), folder)
    flags = [f'-DAMINN_HAND_HEADER="{header}"', f"-I{RUNTIME / 'include'}", "-fPIC", "-O1", "-ffp-contract=off"]
    shim = ["cc", "-std=c99", *flags, "-c", "shim.c"]
    sources = map(str, sorted((RUNTIME / "src").glob("*.cpp")))
    alone = ["-shared", "-fno-gnu-unique", "-Wl,-Bsymbolic"]  # beside each other
    whole = ["c++", "-std=c++17", *flags, *alone, "shim.o", *sources, "-o", "shim.so"]
    for command in (shim, whole):
        subprocess.run(command, check=True, capture_output=True, cwd=folder)
    return ctypes.CDLL(str(folder / "shim.so"))


def learned(
    library: ctypes.CDLL,
    model,
    theta: NDArray,
    states: dict,
    dx: NDArray,
    sensors: dict | None = None,
    prior: float = Settings().prior,
) -> tuple[NDArray, NDArray, NDArray]:
    """Status and outcome (n, 2), theta and standard deviations (n, P + F), friction (n, 3) of the compiled runtime."""
    n, blob = len(dx), bin_model_bytes(model)
    rows = np.concatenate([*(states[k].reshape(n, -1) for k in MEASURED), dx], 1).astype(np.float32)
    assert rows.shape[1] == STATE + 6
    told = None if sensors is None else np.concatenate([sensors[k] for k in HAND.dims.sensors], 1).astype(np.float32)
    first, said = theta.astype(np.float32), np.zeros((n, 2), np.int32)
    found, friction = np.zeros((n, P + F), np.float32), np.zeros((n, 3), np.float32)
    given, out = ([None if a is None else a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
                  for arrays in ((first, rows, told), (said, found, friction)))  # fmt: skip
    status = library.learn(blob, ctypes.c_size_t(len(blob)), *given, ctypes.c_float(prior), n, *out)
    assert status == 0, runtime().status_name(status)
    return said, found, friction


def pushes(model, n: int, theta: NDArray) -> tuple[dict[str, NDArray], NDArray]:
    """Measured states, some of one grasp, and what a hand of theta does."""
    drawn = random_states(HAND, 3 * n, 5)
    held = np.flatnonzero((drawn["contacts"][..., 0] > 0).all(1))[:n]  # with fewer a tool swings
    x = {k: np.asarray(v, np.float32).astype(float)[held] for k, v in drawn.items()}
    assert len(held) == n
    for name in ("q", "x_ht", "contacts"):
        x[name][1::3] = x[name][::3][: len(x[name][1::3])]  # every second push of three is of the grasp before
    reading = Recursion(model, theta)
    corrected = [reading.corrected({k: x[k][i] for k in MEASURED}) for i in range(n)]
    dx = Reference(model)(
        {k: np.concatenate([c[k] for c in corrected]) for k in corrected[0]} | {"theta": np.tile(theta, (n, 1))}
    )["dx_ht"]
    return x, np.asarray(dx, np.float32).astype(float)


@pytest.mark.parametrize("told", [False, True])
def test_the_runtime_learns_what_the_oracle_learns(library: ctypes.CDLL, told: bool, trust: dict) -> None:
    model, rng = random_model(HAND, told=told, slides=False), np.random.default_rng(3)
    start, truth = np.zeros(P), np.zeros(P)
    start[F:] = rng.uniform(-1, 1, P - F) * ([0.02] * (P - F - 1) + [0.001])
    truth[:F], truth[F:] = rng.uniform(-0.4, 0.4, F), start[F:]
    start, truth = start.astype(np.float32).astype(float), truth.astype(np.float32).astype(float)
    states, dx = pushes(model, 24, truth)
    dx *= 1 + 0.1 * rng.normal(size=dx.shape)  # so that nothing hangs on the last digit
    oracle = Recursion(model, start)
    wanted, outcomes = [], []
    for i in range(len(dx)):
        outcomes.append(oracle.push({k: states[k][i] for k in MEASURED}, dx[i]))
        wanted.append(np.concatenate([oracle.theta, oracle.sd]))
    said, found, friction = learned(library, model, start, states, dx)
    assert not friction.any()
    assert said[:, 0].tolist() == [0] * len(dx)
    assert said[:, 1].tolist() == outcomes
    off = np.abs(found - np.array(wanted)).max()
    trust[f"recursion_{'told' if told else 'untold'}_off"] = float(off)
    assert off < 1e-4, f"theta or its uncertainty is off by {off:.2g}"
    assert set(outcomes) & {LEARNED, DOUBTED} and np.abs(np.array(wanted)[-1, :F]).max() > 0.05


def test_the_runtime_narrows_friction_as_the_oracle_does(sliding_library: ctypes.CDLL, trust: dict) -> None:
    """Any of the sensors known, contacts that stick and that slide, grasps that change; theta hardly moves."""
    model, rng, n, prior = random_model(HAND, slides=True, sensing=True), np.random.default_rng(6), 36, 1e-6
    states, dx = pushes(model, n, np.zeros(P))
    dx = dx * np.where(np.arange(n) % 4 == 3, 3.0, 1.0)[:, None] * (1 + 0.1 * rng.normal(size=dx.shape))
    sensors = {k: np.asarray(v, np.float32).astype(float) for k, v in random_sensors(HAND.dims, n, 7).items()}
    oracle = Recursion(model, settings=Settings(prior=prior))
    told = []
    for i in range(n):
        known = {k: v[i] for k, v in sensors.items()}
        oracle.push({k: states[k][i] for k in MEASURED}, dx[i], known)
        told.append(oracle.friction(known["friction"]))
    said, _, friction = learned(sliding_library, model, np.zeros(P), states, dx, sensors, prior)
    assert not said[:, 0].any()
    off = np.abs(friction - np.array(told)).max()
    trust["recursion_friction_off"] = float(off)
    assert off < 2e-3, f"friction is off by {off:.2g}"
    alone = np.array(told)[sensors["friction"][:, 0] == 0]
    assert (alone[:, 0] == 1).any() and np.ptp(alone[:, 1]) > 0.1


@pytest.mark.parametrize(("corrected", "median", "most"), [(False, 0.02, 0.2), (True, 0.2, 1.0)])
def test_slopes_are_those_of_the_statics(corrected: bool, median: float, most: float) -> None:
    """Without a correction by the head they leave out the gates' own change alone; a random one is larger than any."""
    model = random_model(HAND, slides=False)
    if not corrected:
        zeros = {k: np.zeros_like(v) for k, v in model.tensors.items() if k.startswith("s2.head")}
        model = replace(model, tensors=model.tensors | zeros)
    states, _ = pushes(model, 12, np.zeros(P))
    off, oracle, h = [], Recursion(model), 1e-4
    for i in range(12):
        x = oracle.corrected({k: states[k][i] for k in MEASURED})
        slopes = oracle.slopes(x)
        by_difference = np.empty_like(slopes)
        for p in range(F):
            ahead, behind = (np.eye(P)[p] * sign * h for sign in (1, -1))
            moved = oracle.motion(x, ahead)["s2_dx"] - oracle.motion(x, behind)["s2_dx"]
            by_difference[:, p] = moved / oracle.model.s / (2 * h)
        off.append(np.linalg.norm(slopes - by_difference) / np.linalg.norm(by_difference))
    assert np.median(off) < median and max(off) < most, np.round(off, 3)


def test_pushes_bring_the_oracle_to_the_truth() -> None:
    model, truth = random_model(HAND, slides=False), np.zeros(P)
    truth[:F] = np.random.default_rng(4).uniform(-0.4, 0.4, F)
    states, dx = pushes(model, 60, truth)
    oracle = Recursion(model, settings=Settings(noise_m=1e-6, model_share=0.01))

    def error(theta: NDArray) -> float:
        found = [
            oracle.motion(oracle.corrected({k: states[k][i] for k in MEASURED}), theta)["s2_dx"] for i in range(60)
        ]
        return float(np.median(np.linalg.norm((found - dx) / oracle.model.s, axis=1)))

    before = error(oracle.theta)
    for i in range(60):
        oracle.push({k: states[k][i] for k in MEASURED}, dx[i])
    assert error(oracle.theta) < 0.1 * before
