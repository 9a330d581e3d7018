"""`aminn verify` passes on what was exported, and fails on each kind of tampering with the sample's name."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from runtime_models import RandomModel, random_inputs

from aminn.data.dataset import load_dataset, split_of
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_export.export import export
from aminn_export.files.bin_model import read_bin_model, write_bin_model
from aminn_export.files.c_model import write_c_model
from aminn_export.judge.verify import check_golden, run_verification, samples_of_dataset, verify
from aminn_export.replay.engines import ENGINES
from aminn_export.replay.runtime_place import find_in
from aminn_export.samples.golden import run_onnx, single_thread_session
from aminn_export.samples.vectors import read_results, read_vectors, write_results, write_vectors
from aminn_hand.hand import OUTPUTS


@pytest.fixture(scope="module")
def vectors(export_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("vectors") / "vectors.bin"
    x = random_inputs(400, 12)
    write_vectors(file, x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    return file


@pytest.fixture
def copy(export_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(export_dir, tmp_path / "copy"))


def test_golden_vectors_and_debug_model_are_held_against_the_model(
    export_dir: Path, copy: Path, vectors: Path, build_dir: Path
) -> None:
    x = random_inputs(20, 3)
    write_vectors(copy / "golden.bin", x, run_onnx(single_thread_session(copy / "aminn.onnx"), x))
    model = read_bin_model(copy / "aminn_model.bin")
    assert check_golden(copy, model) == []
    other = random_inputs(20, 4)
    write_vectors(copy / "golden.bin", x, run_onnx(single_thread_session(copy / "aminn.onnx"), other))
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert not report["ok"] and "golden.bin is not what aminn.onnx gives" in report["failures"]
    assert "golden.bin is not what aminn_debug.onnx gives" in report["failures"]
    data = bytearray((copy / "golden.bin").read_bytes())
    data[-1] ^= 1
    (copy / "golden.bin").write_bytes(data)
    with pytest.raises(AminnError, match=r"golden.bin"):
        verify(copy, vectors, build_dir, echo=lambda _: None)


def _tampered(model: RandomModel, name: str, factor: float) -> RandomModel:
    return replace(model, tensors=model.tensors | {name: model.tensors[name] * np.float32(factor)})


def test_exported_model_passes(export_dir: Path, vectors: Path, build_dir: Path) -> None:
    lines: list[str] = []
    report = verify(export_dir, vectors, build_dir, echo=lines.append)
    print("\n".join(lines))
    assert report["ok"] is True
    assert report["failures"] == ""
    assert report["samples"] == 400
    for target in ("host_bin", "host_c"):
        assert 0 < report[f"{target}_dx_relative_median"] < 2e-6
        assert report[f"{target}_dx_share_of_limit_max"] < 1
        assert report[f"{target}_decisions_different"] == report[f"{target}_refused"] == 0


def test_another_engine_stands_in_for_onnx_runtime(
    export_dir: Path, vectors: Path, build_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice = next(p for p in main.commands["verify"].params if p.name == "engine").type
    assert isinstance(choice, click.Choice) and set(choice.choices) == set(ENGINES)
    words = ["verify", "--export", str(export_dir), "--data", str(vectors), "--build", str(build_dir), "--onnx"]
    done = CliRunner().invoke(main, [*words, "reference"])
    assert done.exit_code == 0, done.output
    monkeypatch.setitem(sys.modules, "openvino", None)
    done = CliRunner().invoke(main, [*words, "openvino"])
    assert done.exit_code != 0 and "pip install openvino" in done.output


@pytest.mark.skipif(
    not all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm", "cmake"))), reason="no cross compiler or no qemu"
)
def test_cortex_m7_repeats_onnx(export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    x = random_inputs(60, 14)
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = verify(export_dir, tmp_path / "v.bin", build_dir, on_targets=("cortex_m7",), echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert 0 < report["cortex_m7_dx_relative_median"] < 2e-6
    assert report["cortex_m7_different_words"] == 0
    assert 2000 < report["cortex_m7_stack_predict_bytes"] <= 3000  # docs/runtime.md: the call graph's worst case


def test_data_set_is_replayed_test_split_first(
    checkpoint_dir: Path, data_dir: Path, build_dir: Path, tmp_path: Path
) -> None:
    export(checkpoint_dir, tmp_path / "out", "my_model", data_dir)
    report = verify(tmp_path / "out", data_dir, build_dir, min_samples=150, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert report["samples"] == 150
    dataset = load_dataset(data_dir)
    n_test = int((split_of(dataset.samples["grasp_id"]) == 2).sum())
    samples = samples_of_dataset(dataset, 1)
    assert len(samples.inputs["q"]) == n_test
    with pytest.raises(AminnError, match="simulate more"):
        samples_of_dataset(dataset, 10**6)
    assert len(samples_of_dataset(dataset).inputs["q"]) == len(dataset)  # 320 are there, and nobody asked for more


def test_few_samples_are_said_and_none_are_refused(
    export_dir: Path, vectors: Path, build_dir: Path, tmp_path: Path
) -> None:
    lines: list[str] = []
    few = {name: value[:9] for name, value in read_vectors(vectors).inputs.items()}
    write_vectors(tmp_path / "few.bin", few, run_onnx(single_thread_session(export_dir / "aminn.onnx"), few))
    assert verify(export_dir, tmp_path / "few.bin", build_dir, echo=lines.append)["ok"]
    assert lines[0].startswith("warning: 9 samples alone")
    none = {name: value[:0] for name, value in few.items()}
    write_vectors(tmp_path / "none.bin", none, run_onnx(single_thread_session(export_dir / "aminn.onnx"), none))
    with pytest.raises(AminnError, match=r"none\.bin: holds no sample"):
        verify(export_dir, tmp_path / "none.bin", build_dir, echo=lines.append)


def test_installed_runtime_is_enough(export_dir: Path, vectors: Path, installed: Path, tmp_path: Path) -> None:
    report = verify(export_dir, vectors, installed, echo=lambda _: None)
    assert report["ok"], report["failures"]
    assert report["host_c_different_words"] == 0
    with pytest.raises(AminnError, match=r"no CMakeCache\.txt.*no bin/aminn_replay"):
        verify(export_dir, vectors, tmp_path, echo=lambda _: None)
    shutil.copytree(installed, tmp_path / "part")
    (tmp_path / "part" / "share" / "aminn_rt" / "replay" / "host_file.c").unlink()
    with pytest.raises(AminnError, match=r"host_file\.c is missing there"):
        verify(export_dir, vectors, tmp_path / "part", echo=lambda _: None)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        ("rows[0, 3] = float('nan')", "host, .bin: dx_ht[2] of sample 0 of vectors.bin: got nan"),
        ("rows[-1, 51] = 1 - rows[-1, 51]", "host, .bin: stable of sample 399 of vectors.bin"),
        ("status[200] = -9", "host, .bin: status of sample 200 of vectors.bin: got -9, want 0"),
        ("rows, status = rows[:-1], status[:-1]", "host, .bin: samples: got 399, want 400"),
        ("rows[200, 30] = np.nextafter(rows[200, 30], 9)", "host, .c: k_x[3][5] of sample 200 of vectors.bin"),
    ],
)
def test_replay_that_lies_is_found_out(
    export_dir: Path, vectors: Path, installed: Path, tmp_path: Path, spoil: str, told: str
) -> None:
    """By ONNX Runtime's results, or by the other form of the model, whose bits it does not have."""
    shutil.copytree(installed, tmp_path / "prefix")
    program = tmp_path / "prefix" / "bin" / "aminn_replay"
    program.rename(program.with_name("true_replay"))
    program.write_text(f"""#!{sys.executable}
import subprocess, sys
import numpy as np
from aminn_hand.hand import OUTPUTS
from aminn_export.samples.vectors import read_results, write_results
subprocess.run([{str(program.with_name("true_replay"))!r}, *sys.argv[1:]], check=True)
r = read_results(sys.argv[3])
n = len(r.status)
rows = np.concatenate([r.outputs[k].reshape(n, -1) for k in OUTPUTS] + [r.decision[:, None]], 1)
status = r.status.copy()
{spoil}
write_results(sys.argv[3], rows, status)
""")
    program.chmod(0o755)
    done = run_verification(export_dir, vectors, tmp_path / "prefix")
    assert not done.report["ok"] and told in done.report["failures"]


def test_reports_name_every_number(exported: RandomModel, copy: Path, vectors: Path, build_dir: Path) -> None:
    """Through the command: exit codes, JSON and JUnit."""
    words = ["verify", "--export", str(copy), "--data", str(vectors), "--build", str(build_dir)]
    files = ["--json", str(copy / "v.json"), "--junit", str(copy / "v.xml")]
    done = CliRunner().invoke(main, [*words, *files])
    assert done.exit_code == 0, done.output
    assert json.loads((copy / "v.json").read_text())["differences"] == []
    suite = ElementTree.parse(copy / "v.xml").getroot()[0]
    assert int(suite.attrib["tests"]) == len(suite) >= 20 and suite.attrib["failures"] == "0"
    write_bin_model(_tampered(exported, "s2.head_w", 1.01), copy / "aminn_model.bin")
    done = CliRunner().invoke(main, [*words, *files])
    assert done.exit_code == 1 and "host, .bin: dx_ht[" in done.output and "want" in done.output
    report = json.loads((copy / "v.json").read_text())
    assert len(report["differences"]) == min(report["numbers_different"], 10_000) > 400
    assert {"target", "output", "sample", "where", "got", "want", "limit", "exact"} == set(report["differences"][0])
    suite = ElementTree.parse(copy / "v.xml").getroot()[0]
    failed = {case.attrib["name"] for case in suite if len(case)}
    assert int(suite.attrib["failures"]) == len([case for case in suite if len(case)])
    assert {"one model in all files", "dx_ht, against ONNX Runtime", "dx_ht, bits of host, .bin"} <= failed
    (copy / "aminn_model.bin").write_bytes(b"AMNM")
    assert CliRunner().invoke(main, words).exit_code == 3


def test_two_result_files_are_compared(export_dir: Path, vectors: Path, build_dir: Path, tmp_path: Path) -> None:
    replay = find_in(build_dir, "aminn_replay")
    model, first, second = export_dir / "aminn_model.bin", tmp_path / "first.bin", tmp_path / "second.bin"
    subprocess.run([replay, model, vectors, first], check=True, capture_output=True)
    second.write_bytes(first.read_bytes())

    def compare(*files: Path) -> tuple[int, str]:
        done = CliRunner().invoke(main, ["compare", *map(str, files)])
        return done.exit_code, done.output

    assert compare(first, second) == (0, "samples 400\nrefused 0\ndifferent_words 0\n")
    assert compare(model, vectors, first)[0] == 0
    other = read_results(first)
    rows = np.concatenate([other.outputs[k].reshape(400, -1) for k in OUTPUTS] + [other.decision[:, None]], 1)
    rows[5, 2] = np.nextafter(rows[5, 2], np.float32(1))
    write_results(second, rows, other.status)
    code, text = compare(first, second)
    assert code == 1 and "dx_ht[1] of sample 5: got" in text and "bits differ" in text
    assert compare(model, vectors, second)[0] == 0  # a step of the last place is rounding there
    second.write_bytes(first.read_bytes()[:-4])
    assert compare(first, second)[0] == 3
    assert compare(first)[0] == 3 and "two result files" in compare(first)[1]
    assert compare(export_dir / "aminn_model.c", first)[0] == 3


@pytest.mark.parametrize(
    ("tensor", "factor", "output"),
    [("s2.head_w", 1.01, "dx_ht"), ("s1.cls2_w", 1.001, "p_stable"), ("tendon_gain_nom", 1.001, "dx_ht")],
)
def test_tampered_binary_fails_alone(
    exported: RandomModel, copy: Path, vectors: Path, build_dir: Path, tensor: str, factor: float, output: str
) -> None:
    write_bin_model(_tampered(exported, tensor, factor), copy / "aminn_model.bin")
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert report["ok"] is False
    assert f"host, .bin: {output}" in report["failures"]
    assert "sample" in report["failures"]
    assert "aminn_model.c is not aminn_model.bin" in report["failures"]
    # the C model is right, but not the same
    assert report["host_c_dx_share_of_limit_max"] < 1 and report["host_c_different_words"] > 0


def test_tampered_c_model_fails_alone(exported: RandomModel, copy: Path, vectors: Path, build_dir: Path) -> None:
    write_c_model(_tampered(exported, "s2.trunk2_w", 1.01), copy)
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert report["ok"] is False
    assert "host, .c: dx_ht" in report["failures"]
    assert "files: aminn_model.c is not aminn_model.bin: aminn_model_s2_trunk2_w" in report["failures"]
    assert "host, .bin:" not in report["failures"]


def test_another_threshold_is_another_decision(
    exported: RandomModel, copy: Path, vectors: Path, build_dir: Path
) -> None:
    write_c_model(replace(exported, meta=exported.meta | {"tau": 0.9}), copy)
    report = verify(copy, vectors, build_dir, echo=lambda _: None)
    assert report["host_c_decisions_different"] > 0
    assert "host, .c: stable" in report["failures"]


def test_refused_sample_is_named(exported: RandomModel, export_dir: Path, build_dir: Path, tmp_path: Path) -> None:
    x = {k: v.copy() for k, v in random_inputs(30, 13).items()}
    x["contacts"][17, :, 4:7] *= 2  # normals of length 2
    write_vectors(tmp_path / "v.bin", x, run_onnx(single_thread_session(export_dir / "aminn.onnx"), x))
    report = verify(export_dir, tmp_path / "v.bin", build_dir, echo=lambda _: None)
    assert report["ok"] is False
    assert report["host_bin_refused"] == 1
    assert "host, .bin: status of sample 17 of v.bin: got -6, want 0" in report["failures"]
    assert "dx_ht" not in report["failures"]  # the others are compared all the same
    assert all(np.isfinite(v) for v in report.values() if isinstance(v, float))


def test_missing_parts_are_named(export_dir: Path, vectors: Path, build_dir: Path, copy: Path, tmp_path: Path) -> None:
    with pytest.raises(AminnError, match="aminn_replay"):
        verify(export_dir, vectors, tmp_path, echo=lambda _: None)
    (copy / "aminn.onnx").write_bytes(b"not a model")
    with pytest.raises(AminnError, match="cannot load"):
        verify(copy, vectors, build_dir, echo=lambda _: None)
    (copy / "aminn.onnx").unlink()
    with pytest.raises(AminnError, match=r"aminn\.onnx"):
        verify(copy, vectors, build_dir, echo=lambda _: None)
    (copy / "aminn_model.bin").write_bytes((export_dir / "aminn_model.bin").read_bytes()[:-4])
    with pytest.raises(AminnError, match="truncated"):
        verify(copy, vectors, build_dir, echo=lambda _: None)
