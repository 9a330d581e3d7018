"""What learning from a push costs on the device, and whether its bits are the same everywhere: for `make calibrate`."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..files.bin_model import read_bin_model
from ..replay.firmware import BOARDS, CORTEX_M
from ..replay.targets import DISPATCHED, HOSTED, replay_all

Figures = dict[str, float | int | str | bool]
PUSH_PREDICTIONS_AIM, PUSH_RAM_AIM_BYTES = 2.0, 2048
"""At most so many predictions' instructions a push, and so much RAM beyond the calibration."""


def available() -> tuple[str, ...]:
    """The targets whose compiler and emulator are on this machine."""

    def there(*programs: str) -> bool:
        return all(shutil.which(program) for program in programs)

    hosted = [n for n, t in HOSTED.items() if there(t.compiler, t.cxx, *([t.emulator] if t.emulator else []))]
    dispatched = [n for n, emulator in DISPATCHED.items() if there("cmake", *emulator.split()[:1])]
    return (*hosted, *dispatched, *(BOARDS if there(CORTEX_M.compiler, CORTEX_M.emulator) else ()))


def push_figures(
    model_dir: Path,
    vectors: Path,
    work: Path,
    prefix: str = "aminn_model",
    targets: tuple[str, ...] = (),
    jobs: int = 1,
) -> Figures:
    """Flat keys `device_...` of a replay on `targets` (empty: those that there are here), with what is missed.

    The replay learns from the first samples of `vectors`. Of boards: instructions of a push and of a prediction, bytes
    of the calibrator and of the stack. Raises AminnError where something does not compile or run.
    """
    names = targets or available()
    read_bin_model(model_dir / f"{prefix}.bin")  # says what is wrong with it
    told = {name: figures for name, (_, figures) in replay_all(names, model_dir, prefix, vectors, work, jobs).items()}
    bits = {figures["calibration_crc"] for figures in told.values()}
    out: Figures = {
        "device_targets": len(told),
        "device_targets_by_name": " ".join(told),
        "device_pushes": min(figures["pushes"] for figures in told.values()),
        "device_different_calibrations": len(bits),
    }
    wrong = [] if len(bits) == 1 else ["device: the targets learn other bits of theta"]
    for name in BOARDS:
        if name not in told:
            continue
        f = told[name]
        ram = f["calibrator_bytes"] - f["calibration_bytes"] + f["stack_push_bytes"] - f["stack_predict_bytes"]
        share = f["instructions_per_push"] / f["instructions_per_prediction"]
        out |= {
            f"device_{name}_push_instructions": f["instructions_per_push"],
            f"device_{name}_push_instructions_worst": f["instructions_push_worst"],
            f"device_{name}_push_predictions": round(share, 3),
            f"device_{name}_push_ram_bytes": ram,
            f"device_{name}_calibration_bytes": f["calibration_bytes"],
        }
        if not share < PUSH_PREDICTIONS_AIM:
            wrong.append(f"device: a push takes {share:.2f} predictions on {name}")
        if not ram < PUSH_RAM_AIM_BYTES:
            wrong.append(f"device: learning takes {ram} bytes on {name}")
    return out | {"device_aims_missed": "; ".join(wrong)}
