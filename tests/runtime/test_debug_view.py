"""Every intermediate of both stages in the compiled runtime (aminn_debug) against the float64 definition."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from runtime_models import DIMS, random_inputs, random_model

from aminn_export.files.bin_model import bin_model_bytes
from aminn_export.files.layout import Widths
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import pack, unpack

ROOT = Path(__file__).resolve().parents[2]
HOST_ARCHIVE = ROOT / "build" / "host" / "runtime" / "libaminn_rt.a"
N_DEBUG = sum(int(np.prod(shape)) for shape in DIMS.debug.values())

SHIM = """
#include "aminn_rt.h"
#include <string.h>

int shim_predict(const void *blob, size_t size, const float *in, float *out, float *debug, int n)
{
    static aminn_t ctx;
    aminn_model_t model;
    int i, k, status = aminn_model_from_blob(blob, size, &model);
    if (status == AMINN_OK) {
        status = aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG);
    }
    for (i = 0; i < n && status == AMINN_OK; ++i) {
        aminn_input_t input;
        aminn_output_t output;
        memcpy(&input, in + 125 * i, sizeof input);
        status = aminn_predict(&ctx, &input, &output);
        memcpy(out + 51 * i, &output, 51 * sizeof(float));
        for (k = 0; k < AMINN_N_STAGE && status == AMINN_OK; ++k) {
            memcpy(debug, aminn_debug(&ctx, k), sizeof(aminn_stage_debug_t));
            debug += sizeof(aminn_stage_debug_t) / sizeof(float);
        }
    }
    return status;
}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> ctypes.CDLL:
    """The runtime as a shared library."""
    folder = tmp_path_factory.mktemp("runtime")
    archive = HOST_ARCHIVE
    if not archive.is_file():
        cmake = shutil.which("cmake")
        command = [cmake, "-S", ROOT / "runtime", "-B", folder, "-DAMINN_RT_TOOLS=OFF"]
        subprocess.run(command, check=True, capture_output=True)
        subprocess.run([cmake, "--build", folder], check=True, capture_output=True)
        archive = folder / "libaminn_rt.a"
    shim = folder / "shim.c"
    shim.write_text(SHIM)
    out = folder / "shim.so"
    command = [
        "cc",
        "-std=c99",
        "-shared",
        "-fPIC",
        f"-I{ROOT / 'runtime' / 'include'}",
        shim,
        archive,
        "-lm",
        "-o",
        out,
    ]
    subprocess.run(command, check=True, capture_output=True)
    return ctypes.CDLL(str(out))


def predict(library: ctypes.CDLL, blob: bytes, inputs: dict[str, NDArray]) -> dict[str, NDArray]:
    """Outputs of the runtime by the names of `aminn_debug.onnx`."""
    rows = np.ascontiguousarray(pack(inputs, DIMS.inputs, "<f4"))
    n = len(rows)
    out, debug = np.zeros((n, 51), np.float32), np.zeros((n, 2, N_DEBUG), np.float32)
    floats = ctypes.POINTER(ctypes.c_float)
    pointers = [a.ctypes.data_as(floats) for a in (rows, out, debug)]
    library.shim_predict.argtypes = [ctypes.c_char_p, ctypes.c_size_t, floats, floats, floats, ctypes.c_int]
    assert library.shim_predict(blob, len(blob), *pointers, n) == 0
    named = unpack(out, DIMS.outputs)
    for i, stage in enumerate(("s1_", "s2_")):
        named |= {stage + name: value for name, value in unpack(debug[:, i], DIMS.debug).items()}
    return named


COMPLIANCE = 1e-3
"""A fingertip's own compliance, m/N: that of sliding is (c + s) v - c, with an error in c's digits near zero."""


def largest(got: NDArray, want: NDArray, least: float = 0.0) -> float:
    """Largest difference over the size of the sample's values, or over the least size."""
    axes = tuple(range(1, want.ndim))
    size = np.maximum(np.abs(want).max(axes) if axes else np.abs(want), least)
    difference = np.abs(got - want)
    return float((difference.max(axes) if axes else difference).__truediv__(size + 1e-9).max())


@pytest.mark.parametrize("fade", [False, True])
@pytest.mark.parametrize("dq0", ["statics", "inverse"])
def test_every_intermediate_agrees(library: ctypes.CDLL, dq0: str, fade: bool) -> None:
    model, inputs = random_model(4, widths=Widths(16, 24, 24, 12), dq0=dq0), random_inputs(600, 9, fade)
    # with fewer contacts the tool swings nearly free, and joint deflections are small differences of large motions
    held = (inputs["contacts"][..., 0] > 0).all(1)
    inputs = {name: value[held] for name, value in inputs.items()}
    got, want = predict(library, bin_model_bytes(model), inputs), Reference(model)(inputs)
    assert set(got) == set(want)
    least = {"s1_slide": COMPLIANCE, "s2_slide": COMPLIANCE}
    differences = {name: largest(got[name], want[name], least.get(name, 0.0)) for name in want}
    print("\n".join(f"{dq0} {name}: {value:.1e}" for name, value in differences.items()))
    for name, value in differences.items():
        # the inverse form divides by j_q, which is near singular when a finger is straight;
        # sliding, and K_x with it, adds up what three steps have from the forces, whose use of friction has 2e-5 itself
        steps = 3 if name.endswith(("slide", "k_x")) else 1
        assert value < (1e-3 if dq0 == "inverse" else 2e-5 * steps), name
