"""Write small models for tests of the runtime (random weights, other widths, "inverse", float16, int8) to tests/golden.

`make golden` runs it, and puts the trained reference model beside them.
Its reference outputs are the float64 oracle's. Deterministic: running it again changes nothing.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from runtime_models import STABLE, random_inputs, random_model

from aminn_export.files.bin_model import model_crc, write_bin_model
from aminn_export.files.c_model import write_c_model
from aminn_export.files.layout import Widths
from aminn_export.files.tables import Exported
from aminn_export.judge.weights import ROUNDED
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import write_vectors
from aminn_hand.hand import OUTPUTS

GOLDEN = Path(__file__).resolve().parent.parent / "golden"


def write_golden(model: Exported, path: Path, n: int, seed: int) -> None:
    """Vector file of n random states with the oracle's outputs."""
    inputs = random_inputs(n, seed)
    out = Reference(model)(inputs)
    reference = {name: out[name] for name in OUTPUTS}
    write_vectors(path, inputs, reference, reference, model_crc(model))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=GOLDEN, help="folder (default: tests/golden)")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    tiny = random_model(7, widths=Widths(5, 8, 9, 7), dq0="inverse", motion_limits=STABLE)
    write_c_model(tiny, args.out, "tiny_model")
    write_golden(tiny, args.out / "tiny_golden.bin", 48, 11)
    for name, weights, seed, widths in (
        ("half", "float16", 3, Widths(28, 31, 33, 17)),
        ("byte", "int8", 4, Widths(11, 13, 18, 7)),
    ):
        rounded = ROUNDED[weights](random_model(seed, widths=widths, motion_limits=STABLE))
        rounded.meta["name"] = f"{name}_model"
        write_c_model(rounded, args.out, f"{name}_model")
        write_bin_model(rounded, args.out / f"{name}_blob.bin")
        write_golden(rounded, args.out / f"{name}_golden.bin", 48, 9 + seed)
    print(f"Written to {args.out}")


if __name__ == "__main__":
    main()
