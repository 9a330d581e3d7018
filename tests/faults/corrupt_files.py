"""Damage files that programs wrote: refused by name, or the result is the same. A sample; binary models: corrupt.c.

corrupt_files.py --count 400 --work build/faults/corrupt --report build/reports/reliability/corrupt_files.json

A damage is one byte, a cut, a block of zeros or of other bytes, two blocks exchanged. Then each check that finds them
is taken out, and damages must get through: a check that is not needed would prove nothing.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from forks import forked

BLOCK = 512
SEED_COUNT = 300


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    name: str
    make: Callable[[Path], list[Path]]
    read: Callable[[Path], object]
    """What a program gets of it. Raises AminnError."""
    check: str
    """What finds a damage: a function that is replaced by one that finds nothing."""
    without: Callable[..., object]
    """That one."""


def damaged(rng: random.Random, whole: bytes) -> bytes:
    """One damage."""
    at, how = rng.randrange(len(whole)), rng.randrange(6)
    block = slice(at // BLOCK * BLOCK, min(len(whole), at // BLOCK * BLOCK + BLOCK))
    if how < 2:
        return whole[:at] + bytes([whole[at] ^ rng.choice((1, 0x80, 0xFF, 1 << rng.randrange(8)))]) + whole[at + 1 :]
    if how == 2:
        return whole[:at]
    if how == 3:
        return whole[: block.start] + bytes(block.stop - block.start) + whole[block.stop :]
    if how == 4:
        return whole[: block.start] + rng.randbytes(block.stop - block.start) + whole[block.stop :]
    other = rng.randrange(len(whole)) // BLOCK * BLOCK
    first, second = sorted((block.start, other))
    a, b = (whole[i : i + BLOCK] for i in (first, second))
    return whole[:first] + b + whole[first + BLOCK : second] + a + whole[second + BLOCK :] if second > first else b""


@dataclass
class Tried:
    """What came of damages."""

    tried: int = 0
    refused: int = 0
    same: int = 0
    silent: int = 0
    """Taken, and something else than the whole file says."""
    broken: int = 0

    def figures(self, name: str) -> dict[str, int]:
        """By name."""
        return {f"corrupt_files_{name}_{key}": value for key, value in vars(self).items()}


def attempt(kind: Kind, folder: Path, count: int, seed: str) -> Tried:
    """So many damages of each file of a kind."""
    rng, out = random.Random(f"{kind.name} {seed}"), Tried()
    for file in kind.make(folder):
        whole = file.read_bytes()
        wanted = kind.read(file)
        for content in _different(rng, whole, count):
            file.write_bytes(content)
            out.tried += 1
            try:
                found = kind.read(file)
            except AminnError as error:
                named = file.name in str(error) or str(file.parent) in str(error)
                out.refused, out.broken = out.refused + named, out.broken + (not named)
            except Exception as error:
                print(f"{kind.name}: {type(error).__name__}: {error}")
                out.broken += 1
            else:
                out.same, out.silent = out.same + (found == wanted), out.silent + (found != wanted)
        file.write_bytes(whole)
    return out


def _different(rng: random.Random, whole: bytes, count: int) -> Iterator[bytes]:
    while count:
        content = damaged(rng, whole)
        if content != whole:
            count -= 1
            yield content


def _new(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


# --- kinds ----------------------------------------------------------------------------------------------------------
def _arrays(groups: list[dict]) -> str:
    digest = hashlib.sha256()
    for group in groups:
        for name in sorted(group):
            digest.update(name.encode() + np.ascontiguousarray(group[name]).tobytes())
    return digest.hexdigest()


def _read_data(file: Path) -> object:
    data = load_dataset(file.parent)
    known = (
        "config_sha256",
        "shards",
        "hand",
        "n_samples",
        "n_grasps",
        "tool_families",
        "theta_names",
        "schema_version",
    )
    return _arrays([data.samples, data.grasps, data.noise]), {k: data.manifest.get(k) for k in known}


def _read_run(file: Path) -> object:
    found = load_checkpoint(file.parent)
    return _arrays([{k: v.numpy() for k, v in found.model.state_dict().items()}]), dict(found.meta)


def _read_unfinished(file: Path) -> object:
    state = load_run(file.parent, {"config": {"seed": 0}})
    assert state is not None
    return _arrays([{k: v.numpy() for k, v in state.tensors.items()}]), state.progress


def _read_onnx(file: Path) -> object:
    engine = open_engine(file)
    x = dict(zip(("q", "x_ht", "w_e", "contacts"), golden_states(), strict=True))
    out = engine.run(x, 1)
    return engine.tau, engine.hand.sha256, _arrays([{"dx": out.dx_ht, "p": out.p_stable, "k": out.k_x}])


def golden_states() -> list[np.ndarray]:
    """A few states of the reference model."""
    inputs = read_vectors(GOLDEN / "golden.bin").inputs
    return [np.asarray(inputs[name][:4], float) for name in ("q", "x_ht", "w_e", "contacts")]


def _run_with_card(folder: Path, name: str) -> list[Path]:
    file = targets_of_fuzz._checkpoint(folder, name)[0]
    (file.parent / CARD).write_text(f"{CARD_HASH}: {load_checkpoint(file.parent).sha256}\n")
    return [file]


def _onnx(folder: Path) -> list[Path]:
    model = onnx.load(GOLDEN / "aminn.onnx")
    others = [p for p in model.metadata_props if p.key != FILE_HASH]
    del model.metadata_props[:]
    model.metadata_props.extend(others)
    write_sealed(model, folder / "aminn.onnx")
    return [folder / "aminn.onnx"]


def nothing(*arguments: object) -> None:
    """Finds nothing."""


def kinds() -> list[Kind]:
    """All of them."""
    hand, f = HANDS["reference"], targets_of_fuzz
    zero = mock.Mock()
    zero.sha256.return_value.hexdigest.return_value = _EveryHash()
    seal, card = "aminn.data.dataset.check_seal", "aminn.model.checkpoint._hold_against_card"
    run_hash, theta_seal = "aminn.training.run_state._sha256", "aminn.calibration.store.check_seal"
    return [
        Kind("shard", lambda p: f._dataset(p, "shard-00000.h5"), _read_data, "aminn.data.dataset.hashlib", zero),
        Kind("manifest", lambda p: f._dataset(p, "manifest.json"), _read_data, seal, nothing),
        Kind("weights", lambda p: _run_with_card(p, WEIGHTS), _read_run, card, nothing),
        Kind("model_json", lambda p: _run_with_card(p, META), _read_run, card, nothing),
        Kind("unfinished", f._unfinished, _read_unfinished, run_hash, lambda *a: _EveryHash()),
        Kind("calibration", f._calibration, lambda p: read_calibration(p, hand).tolist(), theta_seal, nothing),
        Kind("onnx", _onnx, _read_onnx, "aminn.prediction.onnx_session.check_onnx", nothing),
    ]  # fmt: skip


class _EveryHash(str):
    """Equal to whatever it is compared with."""

    def __eq__(self, other: object) -> bool:
        return True

    def __ne__(self, other: object) -> bool:
        return False

    __hash__ = str.__hash__


def _in_fork(kind: Kind, work: Path, count: int, planted: bool) -> Tried:
    def work_() -> dict[str, int]:
        if planted:
            with mock.patch(kind.check, kind.without):
                return vars(attempt(kind, _new(work / kind.name), count, "planted"))
        return vars(attempt(kind, _new(work / kind.name), count, "whole"))

    done = forked(work_, 3000)
    assert done.status == 0 and isinstance(done.value, dict), done.value
    return Tried(**done.value)


def main() -> int:
    """Damage, count, report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, required=True, help="damages of each file")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--report", type=Path)
    parser.add_argument("--only", action="append")
    args = parser.parse_args()
    report: dict[str, float] = {}
    chosen = [k for k in kinds() if not args.only or k.name in args.only]
    every, found = Tried(), 0
    for kind in chosen:
        tried = _in_fork(kind, args.work.resolve(), args.count, False)
        seed = _in_fork(kind, args.work.resolve(), SEED_COUNT, True)
        found += seed.silent > 0
        report |= tried.figures(kind.name) | {f"corrupt_files_without_check_{kind.name}_got_through": seed.silent}
        every = Tried(*(a + b for a, b in zip(vars(every).values(), vars(tried).values(), strict=True)))
        print(f"{kind.name}: {vars(tried)}; without its check {seed.silent} of {seed.tried} get through", flush=True)
    report |= {f"corrupt_files_{name}": value for name, value in vars(every).items()}
    report |= {"corrupt_files_seeds": len(chosen), "corrupt_files_seeds_found": found}
    if args.report:
        write_json(args.report, report)
    return every.silent + every.broken + len(chosen) - found


import fuzz_files as targets_of_fuzz  # noqa: E402
import numpy as np  # noqa: E402
import onnx  # noqa: E402
from synthetic import HANDS  # noqa: E402

from aminn.calibration.store import read_calibration  # noqa: E402
from aminn.data.dataset import load_dataset  # noqa: E402
from aminn.model.checkpoint import CARD, CARD_HASH, META, WEIGHTS, load_checkpoint  # noqa: E402
from aminn.prediction.engines import open_engine  # noqa: E402
from aminn.prediction.onnx_session import FILE_HASH  # noqa: E402
from aminn.training.run_state import load_run  # noqa: E402
from aminn_base.errors import AminnError  # noqa: E402
from aminn_base.files import write_json  # noqa: E402
from aminn_export.files.onnx_model import write_sealed  # noqa: E402
from aminn_export.samples.vectors import read_vectors  # noqa: E402

GOLDEN = targets_of_fuzz.ROOT / "tests" / "golden"

if __name__ == "__main__":
    sys.exit(main())
