"""The report on the simulation: what `make sim` measures, on a small scale."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from aminn_base.seal import JSON_KEY
from aminn_sim import SimulationConfig, _core, simulate
from aminn_sim.errors import SimulationError
from aminn_sim.figures import speed_figures, synergy_figures
from aminn_sim.open_hand import open_hand
from aminn_sim.read import MANIFEST_KEYS, read_data


def test_synergy_round_trip(simulator: _core.Simulator, dataset_dir: Path) -> None:
    figures = synergy_figures(simulator, read_data(dataset_dir))
    assert figures["synergy_round_trip_psi_max"] < 1e-12 and figures["synergy_round_trip_q_rad_max"] < 1e-12
    assert 0 < figures["synergy_cells_filled_share"] < 0.1


def test_placements_fill_the_range_more_evenly_than_chance(simulator: _core.Simulator) -> None:
    """First attempts of consecutive grasps, by their Sobol' points: every cell of a 4 x 4 x 4 grid is met."""
    points = np.stack([_core.sobol_point(i)[:3] for i in range(64)])
    assert len(np.unique((points * 4).astype(int), axis=0)) == 64


def test_speed_counts_the_same_steps_for_both(simulator: _core.Simulator) -> None:
    figures = speed_figures(open_hand(), simulator, SimulationConfig(), grasps=1, cases=2, rounds=1)
    assert figures["speed_steps"] > 2 * 350 and figures["speed_of_bare_engine_share"] > 0


def test_report_of_a_run(tmp_path: Path) -> None:
    config = SimulationConfig(grasps=2, cases=2, shard_grasps=1)
    simulate(config, tmp_path / "data", progress=False, report=tmp_path / "reports" / "dataset.json")
    report = json.loads((tmp_path / "reports" / "dataset.json").read_text())
    assert report["dataset_cases"] == 4 and report["dataset_engine_steps"] > 4 * 350
    (tmp_path / "reports" / "dataset.json").unlink()
    simulate(config, tmp_path / "data", progress=False, report=tmp_path / "reports" / "dataset.json")
    assert not (tmp_path / "reports" / "dataset.json").exists()  # nothing was left to do


@pytest.mark.parametrize("key", MANIFEST_KEYS)
def test_a_manifest_without_a_key_is_named(key: str, dataset_dir: Path, tmp_path: Path) -> None:
    manifest = json.loads((dataset_dir / "manifest.json").read_text())
    del manifest[key], manifest[JSON_KEY]
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(SimulationError, match=f"manifest.json: {key} missing; simulate"):
        read_data(tmp_path)
