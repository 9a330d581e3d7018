"""What a wrongly filled state costs: `aminn_rt.h` misread in one place, beside the simulator's truth.

Of each misreading: the error of the displacement, how many decisions change, and how many states the runtime refuses or
notes as out of range. docs/runtime.md has the table:

python -m aminn_export.judge.misreadings --model tests/golden/aminn_model.bin --data build/demo/data
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import Dataset, load_dataset
from aminn.evaluation.evaluate import align_columns
from aminn.pages.grasp_picture import branch_points
from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.hand import STATE, rotation, times
from aminn_rt.compiled import runtime

from .verify import scaled_norm

Array = NDArray[np.float64]
State = dict[str, Array]
TIP_RADIUS_M, FRAME_OFFSET_M, CHAIN_LIMIT_M = 0.010, 0.030, 0.002
STABLE_WORD, NOTES_WORD, OUT_OF_RANGE = -2, -1, 1
"""The last words of `aminn_output_t`, and AMINN_NOTE_OUT_OF_RANGE."""


def _after(first: Array, second: Array) -> Array:
    """Rotation vector (n, 3) of `first`, then `second`, in the same axes."""

    def quaternion(rotation: Array) -> tuple[Array, Array]:
        half = np.linalg.norm(rotation, axis=1, keepdims=True) / 2
        return np.cos(half), rotation / 2 * np.sinc(half / np.pi)

    (w1, v1), (w2, v2) = quaternion(first), quaternion(second)
    w, v = w1 * w2 - (v1 * v2).sum(1, keepdims=True), w1 * v2 + w2 * v1 + np.cross(v2, v1)
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return v / np.maximum(length, 1e-30) * 2 * np.arctan2(length, w)


def _load_sign(s: State) -> None:
    s["w_e"] *= -1


def _fingertip_centre(s: State) -> None:
    s["contacts"][..., 1:4] -= TIP_RADIUS_M * s["contacts"][..., 4:7]


def _fingers_exchanged(s: State) -> None:
    s["contacts"] = s["contacts"][:, [1, 0, 2]]
    s["q"] = s["q"][:, [3, 4, 5, 0, 1, 2, 6, 7]]


def _tool_frame(s: State) -> None:
    """The tool's frame 30 mm along its axis: pose, moment and motion are of that point."""
    arm = times(rotation(s["x_ht"][:, 3:]), np.array([FRAME_OFFSET_M, 0, 0]))
    s["x_ht"][:, :3] += arm
    s["w_e"][:, 3:] -= np.cross(arm, s["w_e"][:, :3])
    s["dx_ht"][:, :3] += times(rotation(s["dx_ht"][:, 3:]), arm) - arm


def _normals_out(s: State) -> None:
    s["contacts"][..., 4:7] *= -1


def _roll_signs(s: State) -> None:
    s["q"][:, [0, 3]] *= -1


def _degrees(s: State) -> None:
    s["q"] = np.degrees(s["q"])


def _millimetres(s: State) -> None:
    s["contacts"][..., 1:4] *= 1e3
    s["x_ht"][:, :3] *= 1e3


def _state_under_load(s: State) -> None:
    """As sensors show it after the load has come; contacts go with the tool."""
    centre, turn = s["x_ht"][:, None, :3].copy(), s["dx_ht"][:, None, 3:]
    s["contacts"][..., 1:4] = centre + s["dx_ht"][:, None, :3] + times(rotation(turn), s["contacts"][..., 1:4] - centre)
    s["contacts"][..., 4:7] = times(rotation(turn), s["contacts"][..., 4:7])
    s["x_ht"][:, :3] += s["dx_ht"][:, :3]
    s["x_ht"][:, 3:] = _after(s["x_ht"][:, 3:], turn[:, 0])
    s["q"] = s["q_after"]


def _moment_about_palm(s: State) -> None:
    s["w_e"][:, 3:] += np.cross(s["x_ht"][:, :3], s["w_e"][:, :3])


def _force_and_moment_exchanged(s: State) -> None:
    s["w_e"] = s["w_e"][:, [3, 4, 5, 0, 1, 2]]


def _quaternion_vector(s: State) -> None:
    angle = np.linalg.norm(s["x_ht"][:, 3:], axis=1, keepdims=True)
    s["x_ht"][:, 3:] *= np.sinc(angle / 2 / np.pi) / 2


def _weight_in_load(s: State) -> None:
    s["w_e"][:, :3] += s["weight_N"]


MISREADINGS: dict[str, Callable[[State], None]] = {
    "none": lambda s: None,
    "load_sign": _load_sign,
    "fingertip_centre": _fingertip_centre,
    "fingers_exchanged": _fingers_exchanged,
    "tool_frame": _tool_frame,
    "normals_out": _normals_out,
    "roll_signs": _roll_signs,
    "degrees": _degrees,
    "millimetres": _millimetres,
    "state_under_load": _state_under_load,
    "moment_about_palm": _moment_about_palm,
    "force_and_moment_exchanged": _force_and_moment_exchanged,
    "quaternion_vector": _quaternion_vector,
    "weight_in_load": _weight_in_load,
}
"""Each changes states, and the truth where the misreader would measure another."""


@dataclass(frozen=True)
class Cost:
    """Of one misreading, over cases that hold in the simulation."""

    relative_median: float
    """Error of the displacement over its size, where a prediction was made."""
    decisions_changed_share: float
    noted_share: float
    """Predicted, and noted as out of range."""
    refused_share: float
    """An error status."""
    chain_open_share: float
    """A contact further than CHAIN_LIMIT_M from where joint angles and normal put the fingertip's surface."""


def _states(dataset: Dataset) -> State:
    held = dataset.take(dataset.samples["stable"] > 0)
    rows = held.grasp_rows()
    weight = held.grasps["tool_mass_kg"][rows, None] * held.grasps["gravity_m_s2"][rows]
    names = (*STATE, "dx_ht", "q_after")
    return {name: np.array(held.samples[name], np.float64) for name in names} | {"weight_N": weight}


def _outputs(blob: bytes, s: State) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
    rows = np.concatenate([s[name].reshape(len(s["q"]), -1) for name in STATE], 1).astype(np.float32)
    outputs, _, status = runtime().run(blob, np.ascontiguousarray(rows))
    return outputs, status


def chain_gap(hand: Hand, s: State) -> Array:
    """Largest distance (n), m, of a contact from where joint angles and normal put the fingertip's surface."""
    tips = np.array([[branch_points(hand, b, q)[-1] for b in range(len(hand.branches))] for q in s["q"]])
    gaps = tips + TIP_RADIUS_M * s["contacts"][..., 4:7] - s["contacts"][..., 1:4]
    return np.linalg.norm(gaps, axis=2).max(1)


def costs(model: Path, dataset: Dataset) -> dict[str, Cost]:
    """The cost of each misreading with the binary model in file `model`."""
    blob, right = model.read_bytes(), _states(dataset)
    decided, _ = _outputs(blob, right)
    found = {}
    for name, misread in MISREADINGS.items():
        s = {field: values.copy() for field, values in right.items()}
        misread(s)
        outputs, status = _outputs(blob, s)
        ok = status == 0
        dx = outputs[:, 1:7].copy().view(np.float32).astype(np.float64)
        error = scaled_norm(dx - s["dx_ht"])[ok] / scaled_norm(s["dx_ht"])[ok]
        found[name] = Cost(
            float(np.median(error)) if ok.any() else float("nan"),
            float((outputs[ok, STABLE_WORD] != decided[ok, STABLE_WORD]).mean()) if ok.any() else 0.0,
            float((ok & (outputs[:, NOTES_WORD] & OUT_OF_RANGE > 0)).mean()),
            float((~ok).mean()),
            float((chain_gap(dataset.hand, s) > CHAIN_LIMIT_M).mean()),
        )
    return found


@click.command()
@click.option("--model", required=True, type=click.Path(path_type=Path), help="A binary model.")
@click.option("--data", required=True, type=click.Path(path_type=Path), help="A simulated data set: its test grasps.")
def main(model: Path, data: Path) -> None:
    """Print what each misreading costs."""
    try:
        found = costs(model, load_dataset(data).split("test"))
    except (AminnError, OSError) as error:
        raise click.ClickException(str(error)) from error
    rows = [["misreading", "error of dx_ht, median", "other decisions", "noted", "refused", "chain open"]]
    for name, cost in found.items():
        shares = (cost.decisions_changed_share, cost.noted_share, cost.refused_share, cost.chain_open_share)
        rows.append([name, f"{cost.relative_median:.3f}", *(f"{share:.1%}" for share in shares)])
    click.echo("\n".join(align_columns(rows)))


if __name__ == "__main__":
    main()
