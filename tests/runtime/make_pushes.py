"""Write tests/golden/pushes.bin: what a hand with other stiffnesses does, as a controller would measure it.

`make golden` runs it. A vector file of the reference hand's states whose reference outputs are the simulated truth:
p_stable 1 or 0, dx_ht; all else zero. First ten pushes that held, five of each of two grasps; then every load of the
hand's other grasps.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from aminn.data.dataset import Dataset, load_dataset
from aminn_export.samples.vectors import write_vectors
from aminn_hand.hand import INPUTS
from aminn_sim import SimulationConfig
from aminn_sim.simulate import simulate

GOLDEN = Path(__file__).resolve().parent.parent / "golden"
PUSHES, A_GRASP = 10, 5
GRASPS, CASES, SEED, VARIED = 16, 8, 17, 0.5


def order(data: Dataset) -> np.ndarray:
    """Rows of the pushes, then of the loads of other grasps."""
    ids, held = data.samples["grasp_id"], data.samples["stable"] > 0
    enough = [g for g in np.unique(ids) if held[ids == g].sum() >= A_GRASP][: PUSHES // A_GRASP]
    pushes = [np.flatnonzero((ids == g) & held)[:A_GRASP] for g in enough]
    return np.concatenate([*pushes, np.flatnonzero(~np.isin(ids, enough))])


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=GOLDEN / "pushes.bin", help="file (default: in tests/golden)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        config = SimulationConfig(grasps=GRASPS, cases=CASES, seed=SEED, vary_mechanics=VARIED, grasps_per_hand=GRASPS)
        simulate(config, Path(folder) / "data")
        data = load_dataset(Path(folder) / "data")
    rows = order(data)
    dims, n = data.hand.dims, len(rows)
    outputs = {name: np.zeros((n, *shape)) for name, shape in dims.outputs.items()}
    outputs |= {"p_stable": data.samples["stable"][rows].astype(float), "dx_ht": data.samples["dx_ht"][rows]}
    write_vectors(args.out, {name: data.samples[name][rows] for name in INPUTS}, outputs)
    print(f"{n} samples in {args.out}")


if __name__ == "__main__":
    main()
