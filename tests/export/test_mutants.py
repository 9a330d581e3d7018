"""Nothing that is wrong passes: each number of models, results and vectors is changed, one at a time.

A changed model is a valid one, with the right CRC-32 and a known answer of its own: only its numbers are not those of
the reference. Changes are looked for in the first, the middle and the last sample.
"""

from __future__ import annotations

import json
import struct
import subprocess
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mutant_plan import PLACE, plan_of
from numpy.typing import NDArray
from runtime_models import random_inputs, random_model

from aminn_export.export import write_model_files
from aminn_export.files.bin_model import BinModel, model_crc, read_bin_model, write_bin_model
from aminn_export.files.layout import Widths, layout_of, tensor_name
from aminn_export.files.packing import room
from aminn_export.files.tables import Exported, dims_of
from aminn_export.judge.compare import compare_files
from aminn_export.judge.identity import misfits
from aminn_export.judge.verdict import compare_bits, compare_within
from aminn_export.judge.verify import check_golden
from aminn_export.replay.runtime_place import find_in
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.reference import Reference
from aminn_export.samples.vectors import (
    Results,
    Vectors,
    read_results,
    read_vectors,
    unpack,
    write_results,
    write_vectors,
)
from aminn_rt.blob import output_words

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
SAME_BITS, OTHER_BITS, BEYOND_LIMITS, REFUSED = range(4)
N_SMALL = 36
"""Samples of the small model: medians are judged, and there are few enough for every change of it."""
CONTENT = 20
"""Where the blob's content begins: behind the CRC-32s."""
ONE = np.float32(1)
HAND = dims_of(random_model(0))
Trust = dict[str, float | int | str | bool]


# --- parts ----------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def program(build_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """tests/runtime/mutants.c with the comparison that aminn_compare makes."""
    out, tools = tmp_path_factory.mktemp("mutants") / "mutants", ROOT / "runtime" / "tools"
    sources = [ROOT / "tests" / "runtime" / "mutants.c", tools / "comparison.c", tools / "host_file.c"]
    command = ["cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{tools}", f"-I{ROOT / 'runtime/include'}"]
    library = find_in(build_dir, "libaminn_rt.a")
    subprocess.run([*command, *map(str, sources), str(library), "-lm", "-o", str(out)], check=True)
    return out


@pytest.fixture(scope="module")
def judge(build_dir: Path) -> Callable[..., int]:
    """Exit code of the C program aminn_compare."""
    found = next(p for p in build_dir.rglob("aminn_compare") if p.is_file())

    def run(*words: str | Path) -> int:
        return subprocess.run([found, "--show", "0", *words], capture_output=True).returncode

    return run


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory, build_dir: Path) -> Path:
    """A folder with a small model, its vectors and its results."""
    folder, model = tmp_path_factory.mktemp("small"), random_model(5, widths=Widths(4, 7, 6, 5))
    write_model_files(model, folder, "aminn_model")
    drawn = random_inputs(4 * N_SMALL, 8)
    # limits of a tool that swings are wide, and of contacts that use all of their friction many times over
    held = drawn["contacts"][..., 0].all(1) & (Reference(model)(drawn)["friction_use"].max(1) < 10)
    held = np.flatnonzero(held)[:N_SMALL]
    assert len(held) == N_SMALL
    x = {name: value[held] for name, value in drawn.items()}
    write_vectors(
        folder / "golden.bin", x, run_onnx(single_thread_session(folder / "aminn.onnx"), x), None, model_crc(model)
    )
    replay = find_in(build_dir, "aminn_replay")
    files = [folder / name for name in ("aminn_model.bin", "golden.bin", "results.bin")]
    subprocess.run([replay, *files], check=True, capture_output=True)
    return folder


def outcomes(program: Path, model: Path, vectors: Path, plan: NDArray, work: Path, rows: Path | None = None) -> NDArray:
    """What becomes of each change of a plan."""
    plan.astype("<u4").tofile(work / "plan.bin")
    command = [program, model, vectors, work / "plan.bin", work / "outcomes.bin", *([rows] if rows else [])]
    subprocess.run(command, check=True)
    return np.fromfile(work / "outcomes.bin", np.uint8)


def part_of(vectors: Vectors, rows: NDArray, file: Path) -> Path:
    """Some samples of a vector file."""
    inputs, reference = ({k: v[rows] for k, v in d.items()} for d in (vectors.inputs, vectors.reference))
    write_vectors(file, inputs, reference)
    return file


def with_element_changed(model: Exported, name: str, i: int) -> BinModel:
    """The model with one number of a tensor times 1.5."""
    value = model.tensors[name].copy()
    value.flat[i] = value.flat[i] * 1.5 if value.flat[i] else 0.5
    return BinModel(model.meta, model.tensors | {name: value})


# --- models ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("model", "golden_file", "what"),
    [
        ("aminn_model.bin", "golden.bin", "reference"),
        ("half_blob.bin", "half_golden.bin", "float16"),
        ("byte_blob.bin", "byte_golden.bin", "int8"),
    ],
)
def test_every_number_of_a_model(
    program: Path, tmp_path: Path, trust: Trust, model: str, golden_file: str, what: str
) -> None:
    """By replaying: almost all are seen on a few golden samples; who has no influence at all is left to the files."""
    file = GOLDEN / model
    plan, names = plan_of(read_bin_model(file))
    golden = read_vectors(GOLDEN / golden_file)
    found = np.full(len(plan), SAME_BITS, np.uint8)
    n = len(golden.inputs["q"])
    for rows, again in ((np.arange(0, n, 50), OTHER_BITS), (np.arange(0, n, 6), OTHER_BITS), (np.arange(n), SAME_BITS)):
        left = found <= again
        vectors = part_of(golden, rows, tmp_path / "part.bin")
        found[left] = np.maximum(found[left], outcomes(program, file, vectors, plan[left], tmp_path))
    weights = np.char.endswith(names, "_w") | np.char.endswith(names, "_b")
    idle = [i for i in np.flatnonzero(found == SAME_BITS) if _same_content(file.read_bytes(), int(plan[i]))]
    trust[f"mutants_{what}_numbers_total"] = len(plan)
    trust[f"mutants_{what}_numbers_caught"] = len(plan) - len(idle)
    trust[f"mutants_{what}_numbers_caught_within_limits"] = int((found >= BEYOND_LIMITS).sum())
    trust[f"mutants_{what}_numbers_caught_by_bits"] = int((found == OTHER_BITS).sum())
    trust[f"mutants_{what}_numbers_caught_by_content_crc"] = int((found == SAME_BITS).sum()) - len(idle)
    assert not idle
    used = found[weights & (found != SAME_BITS)]
    # what has an influence is seen within the limits, not by bits alone; how contacts slide has one in few samples
    assert (used >= BEYOND_LIMITS).mean() > (0.93 if HAND.slides else 0.95)


def _same_content(blob: bytes, place: int) -> bool:
    """Whether the content's CRC-32 stays when the number at a place of the plan is changed."""
    at, changed = place & PLACE, bytearray(blob)
    changed[at + 1] ^= 0x40
    return zlib.crc32(changed[CONTENT:]) == zlib.crc32(blob[CONTENT:])


def test_every_number_of_a_small_model_by_both_judges(program: Path, small: Path, tmp_path: Path, trust: Trust) -> None:
    """C and Python come to the same verdict on each, as they see the same results."""
    file, model = small / "aminn_model.bin", read_bin_model(small / "aminn_model.bin")
    plan, _ = plan_of(model)
    found = outcomes(program, file, small / "golden.bin", plan, tmp_path, tmp_path / "rows.bin")
    reference, base = read_vectors(small / "golden.bin").reference, read_results(small / "results.bin")
    for i, (outcome, results) in enumerate(zip(found, _rows(tmp_path / "rows.bin", N_SMALL), strict=True)):
        if outcome == OTHER_BITS or (outcome != REFUSED and i % 8 == 0):
            within = compare_within(results, reference, model.meta["tau"], model.meta["length_scale"])
            bits = compare_bits(results, base)
            assert bool(within.failures) == (outcome == BEYOND_LIMITS)
            assert bool(bits.failures) == (outcome != SAME_BITS)
    caught = (found != SAME_BITS).sum()
    trust["mutants_small_numbers_total"] = len(plan)
    trust["mutants_small_seen_by_replay"] = int(caught)
    assert caught > 0.75 * len(plan)


def _rows(file: Path, n: int) -> Iterator[Results]:
    """The results that the program wrote."""
    words = np.fromfile(file, "<f4").reshape(-1, n * (HAND.output + 2))
    for line in words:
        rows, status = np.split(line, [n * (HAND.output + 1)])
        rows = rows.reshape(n, -1)
        yield Results(unpack(rows[:, :-1], HAND.outputs), np.ascontiguousarray(rows[:, -1]), status.view("<i4"))


def test_every_table_by_the_files(small: Path, judge: Callable[..., int], tmp_path: Path, trust: Trust) -> None:
    """A model with any other number is told from its C form, its ONNX form and its reference, influence or not."""
    model = read_bin_model(small / "aminn_model.bin")
    names = [tensor_name(t.owner, t.field) for t in layout_of(model).tables]
    mutants = caught_c = caught_python = 0
    for name in names:
        size = model.tensors[name].size
        for i in {0, size // 2, size - 1}:
            changed = with_element_changed(model, name, i)
            try:
                write_bin_model(changed, tmp_path / "mutant.bin")
            except Exception as error:  # a constant out of its range cannot even be written
                assert "refuses" in str(error) or "model:" in str(error)
                continue
            mutants += 1
            caught_c += judge(tmp_path / "mutant.bin", small / "golden.bin", small / "results.bin") == 1
            failures = compare_files([tmp_path / "mutant.bin", small / "golden.bin", small / "results.bin"]).failures
            assert failures[0].output == "model"
            caught_python += model_crc(changed) != model_crc(model)
    trust["mutants_tables_total"] = mutants
    trust["mutants_tables_caught_by_aminn_compare"] = caught_c
    trust["mutants_tables_caught_by_python"] = caught_python
    assert mutants > 80 and caught_c == caught_python == mutants


@pytest.mark.parametrize("form", ["bin", "c", "onnx", "debug", "golden"])
def test_one_other_number_in_one_file(small: Path, tmp_path: Path, form: str) -> None:
    """A weight without influence too: `verify` names the file, and where it can the table."""
    for file in small.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    model = read_bin_model(small / "aminn_model.bin")
    assert misfits(tmp_path, "aminn_model", model) == []
    other = tmp_path / "other"
    other.mkdir()
    name, places = "range_max", {"c": ["aminn_model.c"], "onnx": ["aminn.onnx"], "debug": ["aminn_debug.onnx"]}
    changed = with_element_changed(model, "s2.head_w" if form in ("onnx", "debug") else name, 3)
    write_model_files(changed, other, "aminn_model")
    if form == "bin":
        (tmp_path / "aminn_model.bin").write_bytes((other / "aminn_model.bin").read_bytes())
        lines = misfits(tmp_path, "aminn_model", changed)
        assert any(line.startswith("aminn_model.c is not aminn_model.bin: aminn_model_range_max") for line in lines)
        assert any(line.startswith("golden.bin is of another model") for line in lines)
    elif form == "golden":
        vectors = read_vectors(small / "golden.bin")
        write_vectors(tmp_path / "golden.bin", vectors.inputs, vectors.reference, None, model_crc(changed))
        assert misfits(tmp_path, "aminn_model", model)[0].startswith("golden.bin is of another model")
    else:
        (file,) = places[form]
        (tmp_path / file).write_bytes((other / file).read_bytes())
        (line,) = misfits(tmp_path, "aminn_model", model)
        assert line.startswith(f"{file} is not aminn_model.bin")


def test_a_blob_changed_by_hand(small: Path, judge: Callable[..., int], tmp_path: Path, trust: Trust) -> None:
    """Its CRC-32 alone is made right again: its content or its known answer gives it away, or it is refused."""
    blob, model = (small / "aminn_model.bin").read_bytes(), read_bin_model(small / "aminn_model.bin")
    plan, _ = plan_of(model)
    dims = dims_of(model)
    answer_size = 4 * (dims.state + output_words(dims))
    answer = len(blob) - room(answer_size)
    words = [*range(16, 176, 4), *map(int, plan[:: len(plan) // 200])]
    words += range(answer, answer + answer_size, 8)
    caught = 0
    for at in words:
        mutant = bytearray(blob)
        mutant[at + 1] ^= 0x55
        mutant[12:16] = struct.pack("<I", zlib.crc32(mutant[16:]))
        (tmp_path / "mutant.bin").write_bytes(mutant)
        caught += judge(tmp_path / "mutant.bin", small / "golden.bin", small / "results.bin") in (1, 3)
    trust["mutants_blob_words_total"], trust["mutants_blob_words_caught"] = len(words), caught
    assert caught == len(words)


# --- results --------------------------------------------------------------------------------------------------------
CHANGES: dict[str, Callable[[np.float32], np.float32]] = {
    "nan": lambda v: np.float32(np.nan),
    "sign": lambda v: -v if v else ONE,
    "half as much again": lambda v: v * np.float32(1.5) if v else ONE,
    "one step": lambda v: np.nextafter(v, np.float32(np.inf), dtype=np.float32),
}


def _raw(results: Path) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    r = read_results(results)
    n = len(r.status)
    rows = np.concatenate([np.asarray(r.outputs[k]).reshape(n, -1) for k in HAND.outputs] + [r.decision[:, None]], 1)
    return np.ascontiguousarray(rows, np.float32), r.status.copy()


@pytest.mark.parametrize("sample", [0, N_SMALL // 2, N_SMALL - 1])
def test_every_word_of_a_result(
    small: Path, judge: Callable[..., int], tmp_path: Path, sample: int, trust: Trust
) -> None:
    """Bit by bit all are caught; within the limits all that are no rounding. C and Python say the same."""
    rows, status = _raw(small / "results.bin")
    model, reference = read_bin_model(small / "aminn_model.bin"), read_vectors(small / "golden.bin").reference
    base, mutant = read_results(small / "results.bin"), tmp_path / "mutant.bin"
    caught = {"bits": 0, "limits": 0}
    total = 0
    for word in range(HAND.output + 1):
        for name, change in CHANGES.items():
            changed = rows.copy()
            changed[sample, word] = change(rows[sample, word])
            write_results(mutant, changed, status)
            results = read_results(mutant)
            within = compare_within(results, reference, model.meta["tau"], model.meta["length_scale"])
            bits = compare_bits(results, base)
            assert [f.sample for f in bits.failures] == [sample], (word, name)
            code = judge(small / "aminn_model.bin", small / "golden.bin", mutant)
            assert code == int(bool(within.failures)), (word, name)
            if name == "nan":
                assert within.failures and within.failures[0].sample == sample, (word, name)
            total += 1
            caught["bits"] += 1
            caught["limits"] += bool(within.failures)
        assert judge(small / "results.bin", mutant) == 1
        assert judge("--exact", small / "aminn_model.bin", small / "golden.bin", mutant) == 1
    for key, value in (("total", total), *((f"caught_by_{k}", v) for k, v in caught.items())):
        trust[f"mutants_result_words_{key}"] = int(trust.get(f"mutants_result_words_{key}", 0)) + value


def test_a_nan_hides_nothing(small: Path, judge: Callable[..., int], tmp_path: Path, build_dir: Path) -> None:
    rows, status = _raw(small / "results.bin")
    rows[3, 1] += 1  # a metre
    rows[17, 1] = rows[18, 20] = np.nan
    rows[:, 7 + 14] = 1234.5
    write_results(tmp_path / "r.bin", rows, status)
    program = next(p for p in build_dir.rglob("aminn_compare") if p.is_file())
    command = [
        program,
        "--json",
        tmp_path / "r.json",
        small / "aminn_model.bin",
        small / "golden.bin",
        tmp_path / "r.bin",
    ]
    assert subprocess.run(command, capture_output=True).returncode == 1
    found = json.loads((tmp_path / "r.json").read_text())
    told = {(f["output"], f["sample"]) for f in found["failures"]}
    own = compare_files([small / "aminn_model.bin", small / "golden.bin", tmp_path / "r.bin"]).failures
    assert told == {(f.output, f.sample) for f in own}
    assert {("dx_ht[0]", 3), ("dx_ht[0]", 17), ("k_x[2][1]", 18)} <= told
    assert {("k_x[2][2]", i) for i in range(N_SMALL)} <= told
    assert found["numbers_beyond_limit"] == len(found["failures"]) == len(own)
    lost = [f for f in found["failures"] if f["sample"] == 17 and f["output"] == "dx_ht[0]"]
    assert [f["got"] for f in lost] == ["nan"]
    by_c = [(f["output"], f["sample"], *map(float, (f["got"], f["want"], f["limit"]))) for f in found["failures"]]
    by_python = [(f.output, f.sample, f.got, f.want, f.limit) for f in own]
    for c, python in zip(sorted(by_c, key=str), sorted(by_python, key=str), strict=True):
        assert c[:2] == python[:2]
        np.testing.assert_allclose(c[2:], python[2:], rtol=1e-3)


def test_every_status(small: Path, judge: Callable[..., int], tmp_path: Path, trust: Trust) -> None:
    rows, status = _raw(small / "results.bin")
    model = read_bin_model(small / "aminn_model.bin")
    total = caught = 0
    for sample in (0, N_SMALL // 2, N_SMALL - 1):
        for code in (-1, -9, 1, 2**31 - 1, -(2**31)):
            changed = status.copy()
            changed[sample] = code
            write_results(tmp_path / "r.bin", rows, changed)
            results, reference = read_results(tmp_path / "r.bin"), read_vectors(small / "golden.bin").reference
            failures = compare_within(results, reference, model.meta["tau"], 0.1).failures
            bits = compare_bits(results, read_results(small / "results.bin")).failures
            assert [(f.output, f.sample, f.got) for f in failures] == [("status", sample, code)]
            assert [(f.output, f.sample, f.got) for f in bits] == [("status", sample, code)]
            total += 1
            caught += judge(small / "aminn_model.bin", small / "golden.bin", tmp_path / "r.bin") == 1
            assert judge(small / "results.bin", tmp_path / "r.bin") == 1
    trust["mutants_statuses_total"], trust["mutants_statuses_caught"] = total, caught
    assert caught == total


# --- vectors, counts ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sample", [0, N_SMALL // 2, N_SMALL - 1])
def test_every_word_of_a_reference(
    small: Path, judge: Callable[..., int], tmp_path: Path, sample: int, trust: Trust
) -> None:
    """What is wrong in the reference is a difference, for the replay and for `verify`'s look at golden.bin."""
    for file in small.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    vectors, model = read_vectors(small / "golden.bin"), read_bin_model(small / "aminn_model.bin")
    sizes = [int(np.prod(shape)) for shape in HAND.outputs.values()]
    rows = np.concatenate(
        [vectors.reference[k].reshape(N_SMALL, s) for k, s in zip(HAND.outputs, sizes, strict=True)], 1
    )
    total = caught = 0
    for word in range(HAND.output):
        changed = rows.copy()
        largest = np.abs(rows[sample, 7:43]).max() if 7 <= word < 43 else ONE
        changed[sample, word] = changed[sample, word] * np.float32(-1.5) + np.float32(0.1) * largest
        write_vectors(tmp_path / "golden.bin", vectors.inputs, unpack(changed, HAND.outputs), None, vectors.model)
        total += 1
        caught += judge(tmp_path / "aminn_model.bin", tmp_path / "golden.bin", small / "results.bin") == 1
        if word % 5 == 0:
            assert check_golden(tmp_path, model), word
    name = "mutants_reference_words"
    trust[f"{name}_total"] = int(trust.get(f"{name}_total", 0)) + total
    trust[f"{name}_caught"] = int(trust.get(f"{name}_caught", 0)) + caught
    assert caught == total


@pytest.mark.parametrize("name", ["golden.bin", "results.bin", "aminn_model.bin"])
def test_every_count_of_a_header(
    small: Path, judge: Callable[..., int], tmp_path: Path, name: str, trust: Trust
) -> None:
    """Magic, version, numbers of samples and of words, lengths, widths: one more, one less, zero, huge."""
    blob = (small / name).read_bytes()
    words = range(0, 24, 4) if name != "aminn_model.bin" else [0, 4, 8, *range(20, 60, 4)]
    files = {n: small / n for n in ("aminn_model.bin", "golden.bin", "results.bin")}
    total = caught = 0
    for at in words:
        (value,) = struct.unpack_from("<I", blob, at)
        for other in {value + 1, value - 1 if value else 7, 0 if value else 2, 2**31} - {value}:
            mutant = bytearray(blob)
            struct.pack_into("<I", mutant, at, other % 2**32)
            if name == "aminn_model.bin":
                mutant[12:16] = struct.pack("<I", zlib.crc32(mutant[16:]))
            (tmp_path / name).write_bytes(mutant)
            total += 1
            caught += judge(*(files | {name: tmp_path / name}).values()) in (1, 2, 3)
    trust["mutants_counts_total"] = int(trust.get("mutants_counts_total", 0)) + total
    trust["mutants_counts_caught"] = int(trust.get("mutants_counts_caught", 0)) + caught
    assert caught == total


@pytest.mark.parametrize("sample", [0, N_SMALL // 2, N_SMALL - 1])
def test_a_lost_and_a_doubled_sample(small: Path, judge: Callable[..., int], tmp_path: Path, sample: int) -> None:
    rows, status = _raw(small / "results.bin")
    for keep in (np.delete(np.arange(N_SMALL), sample), np.insert(np.arange(N_SMALL), sample, sample)):
        write_results(tmp_path / "r.bin", rows[keep], status[keep])
        files = [small / "aminn_model.bin", small / "golden.bin", tmp_path / "r.bin"]
        assert judge(*files) == 1 and judge(small / "results.bin", tmp_path / "r.bin") == 1
        (failure,) = compare_files(files).failures
        assert (failure.output, failure.got, failure.want) == ("samples", len(keep), N_SMALL)
    rows[[sample, (sample + 1) % N_SMALL]] = rows[[(sample + 1) % N_SMALL, sample]]
    write_results(tmp_path / "r.bin", rows, status)
    assert judge(small / "aminn_model.bin", small / "golden.bin", tmp_path / "r.bin") == 1


def test_a_decision_at_the_threshold(small: Path) -> None:
    """It may be either where p_stable lies within its limit of tau, but must be that of its own p_stable."""
    model, vectors = read_bin_model(small / "aminn_model.bin"), read_vectors(small / "golden.bin")
    results = read_results(small / "results.bin")
    sample = int(np.argmin(np.abs(vectors.reference["p_stable"] - 0.5)))
    p = np.float32(vectors.reference["p_stable"][sample])
    own = results.outputs["p_stable"].copy()
    own[sample] = np.nextafter(p, np.float32(0))
    near = replace(results, outputs=results.outputs | {"p_stable": own})
    for decision, failing in ((0.0, False), (1.0, True), (np.nan, True), (0.5, True)):
        stable = (vectors.reference["p_stable"] >= p).astype(np.float32)
        stable[sample] = decision
        found = compare_within(replace(near, decision=stable), vectors.reference, float(p), model.meta["length_scale"])
        assert bool(found.failures) == failing, decision
