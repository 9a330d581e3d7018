"""What the engines' scripts share: read inputs, run one engine alone and in a batch, time it, write what it said.

An engine's script runs in an environment of its own, which has that engine, NumPy and nothing of this project:
`python ENGINE.py MODEL INPUTS.npz OUTPUTS.npz`. It says how its engine makes a function of a model file; here that
function is called. OUTPUTS.npz has `alone/NAME` (one sample per call), `batch/NAME` (all at once), and `seconds`, the
least time of a call of one sample.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

Arrays = dict[str, np.ndarray]
Run = Callable[[Arrays], Arrays]

TIMED_CALLS = 300
TIMED_S = 5.0


def least_time(run: Run, samples: list[Arrays]) -> float:
    """Least time (s) of a call, of TIMED_CALLS or as many as fit in TIMED_S."""
    times: list[float] = []
    while len(times) < TIMED_CALLS and sum(times) < TIMED_S:
        start = time.perf_counter()
        run(samples[len(times) % len(samples)])
        times.append(time.perf_counter() - start)
    return min(times)


def main(load: Callable[[str], Run], alone: int | None = None) -> None:
    """Run what `load(model file)` gives on all inputs in a batch and on the first `alone` one by one (default: all)."""
    model, inputs_file, outputs_file = sys.argv[1:4]
    with np.load(inputs_file) as file:
        inputs = {name: file[name] for name in file.files}
    rows = range(alone or len(inputs["q"]))
    samples = [{name: np.ascontiguousarray(v[i : i + 1]) for name, v in inputs.items()} for i in rows]
    run = load(model)
    single = [run(sample) for sample in samples]
    found = {f"alone/{name}": np.concatenate([np.asarray(out[name]) for out in single]) for name in single[0]}
    found |= {f"batch/{name}": np.asarray(value) for name, value in run(inputs).items()}
    np.savez(outputs_file, seconds=np.array(least_time(run, samples)), **found)
