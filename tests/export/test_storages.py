"""Types of weights side by side; `make weights` has the figures of the reference model."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from make_golden import write_golden
from runtime_models import RandomModel

from aminn_export.export import write_model_files
from aminn_export.files.bin_model import read_bin_model
from aminn_export.judge import storages
from aminn_export.samples.golden import GOLDEN_FILE
from aminn_export.samples.vectors import read_vectors


def test_types_of_weights_are_compared_and_other_bits_are_told(
    exported: RandomModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of replays that are made up: one target gives other bytes for int8 weights."""
    model_dir = tmp_path / "model"
    model_dir.mkdir()
    write_model_files(exported, model_dir, "aminn_model")
    write_golden(exported, model_dir / GOLDEN_FILE, 48, 5)
    seen = {}

    def replay_all(names, folder, prefix, vectors, work, jobs):
        model = read_bin_model(folder / f"{prefix}.bin")
        assert model.meta["weights"] == folder.name and read_vectors(vectors).reference_f64 is not None
        seen[folder.name] = (folder / f"{prefix}.c").read_text().count("static const int8_t")
        done = {}
        for name in names:
            out = work / f"{name}.bin"
            out.write_bytes(name.encode() if folder.name == "int8" else b"same")
            done[name] = (out, {"instructions_per_prediction": 1000 + len(seen)})
        return done

    monkeypatch.setattr(storages, "replay_all", replay_all)
    report = tmp_path / "weights.json"
    words = ["--model", str(model_dir), "--work", str(tmp_path), "--targets", "cortex_m7,x86_64_library", "--json"]
    result = CliRunner().invoke(storages.main, [*words, str(report)])
    figures = json.loads(report.read_text())
    assert result.exit_code == 1 and "the targets' bit patterns differ" in result.output
    assert figures["int8_different_results"] == 2 and figures["float32_different_results"] == 1
    assert figures["float16_cortex_m7_instructions"] == 1002
    assert figures["int8_bin_bytes"] < 0.6 * figures["float16_bin_bytes"] < 0.4 * figures["float32_bin_bytes"]
    assert 0 < figures["float16_dx_relative_median"] < 0.1 * figures["int8_dx_relative_median"] < 1e-3
    assert seen["float32"] == 0 and seen["int8"] == 11
