"""What the ten misreadings of the header cost, and which the runtime notices: the table of docs/runtime.md."""

from __future__ import annotations

from pathlib import Path

import pytest

from aminn.data.dataset import load_dataset
from aminn_export.judge.misreadings import MISREADINGS, Cost, costs
from aminn_sim import SimulationConfig, simulate

MODEL = Path(__file__).resolve().parents[1] / "golden" / "aminn_model.bin"
Figures = dict[str, float | int | str | bool]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cost]:
    folder = tmp_path_factory.mktemp("simulated") / "data"
    simulate(SimulationConfig(grasps=24, cases=10, seed=2026), folder, threads=2, progress=False)
    return costs(MODEL, load_dataset(folder))


def test_costs_of_misreadings(found: dict[str, Cost], trust: Figures) -> None:
    assert set(found) == set(MISREADINGS)
    for name, cost in found.items():
        trust[f"misreading_{name}_relative_median"] = cost.relative_median
        trust[f"misreading_{name}_decisions_changed_share"] = cost.decisions_changed_share
        trust[f"misreading_{name}_noted_share"] = cost.noted_share
        trust[f"misreading_{name}_refused_share"] = cost.refused_share
        trust[f"misreading_{name}_chain_open_share"] = cost.chain_open_share
    right = found["none"]
    assert (
        right.relative_median < 0.06 and right.noted_share < 0.15 and right.refused_share == right.chain_open_share == 0
    )


@pytest.mark.parametrize("name", ["fingers_exchanged", "normals_out", "degrees", "millimetres"])
def test_noticed_always(found: dict[str, Cost], name: str) -> None:
    assert found[name].noted_share + found[name].refused_share == 1


@pytest.mark.parametrize("name", ["load_sign", "moment_about_palm", "force_and_moment_exchanged", "weight_in_load"])
def test_wrong_and_not_noticed_from_one_state(found: dict[str, Cost], name: str) -> None:
    """Why the page has a check by two pushes."""
    assert found[name].relative_median > 0.3
    assert found[name].noted_share + found[name].refused_share < 0.7


@pytest.mark.parametrize("name", ["roll_signs", "tool_frame", "state_under_load", "fingertip_centre"])
def test_costs_something(found: dict[str, Cost], name: str) -> None:
    assert found[name].relative_median > 1.15 * found["none"].relative_median


@pytest.mark.parametrize(
    "name", ["fingertip_centre", "fingers_exchanged", "normals_out", "roll_signs", "degrees", "millimetres"]
)
def test_joint_angles_and_contacts_show_it(found: dict[str, Cost], name: str) -> None:
    assert found[name].chain_open_share > 0.8
