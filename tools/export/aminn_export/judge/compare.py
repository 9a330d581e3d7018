"""`aminn compare`: results of replays that are there already. `aminn_compare` does the same without Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath
from aminn_rt.blob import MAGIC as MODEL_MAGIC

from ..files.bin_model import model_crc, read_bin_model
from ..files.tables import dims_of
from ..samples.vectors import RESULT_MAGIC, VECTOR_MAGIC, Results, magic_of, read_results, read_vectors
from .verdict import Bins, Failure, Verdict, compare_bits, compare_within

KINDS = {MODEL_MAGIC: "model", VECTOR_MAGIC: "vector file", RESULT_MAGIC: "result file"}


def _results(path: Path) -> Results:
    results = read_results(path)
    if not len(results.status):
        raise AminnError(f"{path}: holds no sample: there is nothing to compare")
    return results


def _by_kind(files: Sequence[Path]) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {kind: [] for kind in KINDS.values()}
    for file in files:
        kind = KINDS.get(magic_of(file))
        if kind is None:
            raise AminnError(
                f"{file}: neither a model, a vector file nor a result file: damaged, or its replay did not end"
            )
        found[kind].append(file)
    return found


def _with_reference(model_file: Path, vector_file: Path, result_file: Path) -> Verdict:
    model = read_bin_model(model_file)
    vectors = read_vectors(vector_file, dims_of(model))
    if not len(vectors.reference["p_stable"]):
        raise AminnError(f"{vector_file}: holds no sample: there is nothing to compare")
    results = _results(result_file)
    meta = model.meta
    verdict = compare_within(results, vectors.reference, meta["tau"], meta["length_scale"], bins=Bins.of(meta))
    crc = model_crc(model)
    if vectors.model in (0, crc):
        return verdict
    other = Failure("", "model", None, crc, vectors.model, 0.0, np.inf)
    return replace(verdict, failures=[other, *verdict.failures])


def compare_files(files: Sequence[AnyPath]) -> Verdict:
    """Two result files, bit by bit, or a model, a vector file and its results within `tolerances`.

    The kinds are read from the files; of two result files the first is the reference. Raises AminnError for files that
    do not go together or are damaged.
    """
    found = _by_kind([Path(file) for file in files])
    counts = [len(found[kind]) for kind in KINDS.values()]
    if counts == [0, 0, 2]:
        want, got = found["result file"]
        return compare_bits(_results(got), _results(want))
    if counts == [1, 1, 1]:
        return _with_reference(*(found[kind][0] for kind in KINDS.values()))
    given = ", ".join(f"{n} {kind}" for n, kind in zip(counts, KINDS.values(), strict=True))
    needed = "two result files, or a model, a vector file and a result file"
    raise AminnError(f"compare: {needed} are needed; given: {given}")
