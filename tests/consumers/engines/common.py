"""What the engines' scripts share: read inputs, run one engine alone and in a batch, time it, write what it said.

An engine's script runs in an environment of its own, which has that engine, NumPy and nothing of this project:
`python ENGINE.py MODEL INPUTS.npz OUTPUTS.npz`. It says how its engine makes a function of a model file; here that
function is called. OUTPUTS.npz has `alone/NAME` (one sample per call), `batch/NAME` (all at once), and `seconds`, the
least time of a call of one sample; where an engine can say, `seconds_inside`, its time of a sample without Python.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

Arrays = dict[str, np.ndarray]
Run = Callable[[Arrays], Arrays]
Inside = Callable[[list[Arrays]], float]
"""Seconds that a sample takes within the engine, over these samples."""

TIMED_CALLS = 300
TIMED_S = 5.0


def least_time(run: Callable[[Arrays], object], samples: list[Arrays]) -> float:
    """Least time (s) of a call, of TIMED_CALLS or as many as fit in TIMED_S."""
    run(samples[0])  # which may compile
    times: list[float] = []
    while len(times) < TIMED_CALLS and sum(times) < TIMED_S:
        start = time.perf_counter()
        run(samples[len(times) % len(samples)])
        times.append(time.perf_counter() - start)
    return min(times)


def main(load: Callable[[str], Run | tuple[Run, Inside]], alone: int | None = None) -> None:
    """Run what `load(model file)` gives on all inputs in a batch and on the first `alone` one by one (default: all)."""
    model, inputs_file, outputs_file = sys.argv[1:4]
    with np.load(inputs_file) as file:
        inputs = {name: file[name] for name in file.files}
    rows = range(alone or len(inputs["q"]))
    samples = [{name: np.ascontiguousarray(v[i : i + 1]) for name, v in inputs.items()} for i in rows]
    loaded = load(model)
    run, inside = loaded if isinstance(loaded, tuple) else (loaded, None)
    single = [run(sample) for sample in samples]
    found = {f"alone/{name}": np.concatenate([np.asarray(out[name]) for out in single]) for name in single[0]}
    found |= {f"batch/{name}": np.asarray(value) for name, value in run(inputs).items()}
    found["seconds"] = np.array(least_time(run, samples))
    if inside is not None:
        found["seconds_inside"] = np.array(inside(samples))
    np.savez(outputs_file, **found)
