"""Calibrations on disk: JSON for the host, a C table for the device. And what is known of a model's errors."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from aminn_base.errors import AminnError, OutdatedError
from aminn_base.files import sync_folder, write_atomically, write_json
from aminn_base.read import AnyPath, read_json, require
from aminn_base.seal import JSON_KEY, check_seal, sealed
from aminn_hand import Hand
from aminn_hand.theta import Theta, theta_bounds

from ..data.dataset import Dataset
from ..data.origin import check_hand, same_configuration
from ..evaluation.evaluate import align_columns
from ..evaluation.predict import true_states
from ..model.checkpoint import Checkpoint
from .calibrate import Calibration
from .fit import Errors, estimate_errors
from .pushes import Array, predictor, pushes_of

FORMAT_VERSION = 1
KEYS: dict[str, type | tuple[type, ...]] = {"format_version": int, "hand": str, "hand_sha256": str, "theta": dict}
ANEW = "run `aminn calibrate` again"
SYMBOL = "aminn_calibration_theta"
KEPT = "joint zeros and tip radius stay as described: the pushes do not ask for another value"
LEAST_GRASPS = 5
"""Of a hand, for the bias of a model to show."""
ERRORS = "errors.json"
"""Beside a checkpoint: `Errors` of it, and its hash."""


def errors_of(checkpoint: Checkpoint) -> Errors:
    """What is known of the model's errors; a told model's usual ones where nothing is."""
    file = checkpoint.path / ERRORS
    if not file.is_file():
        return Errors()
    content = read_json(file, "a model's errors")
    check_seal(file, content, "remove it")
    content.pop(JSON_KEY, None)
    if content.pop("checkpoint_sha256", None) != checkpoint.sha256:
        return Errors()
    kinds = {name: dict if name == "bias" else float for name in asdict(Errors())}
    require(file, content, kinds, "remove it")
    return Errors(**{name: content[name] for name in kinds})


def learn_errors(checkpoint: Checkpoint, data: Dataset) -> Errors:
    """The model's errors from data whose theta is known; of its training's configuration only validation grasps count.

    Raises AminnError where the data tell no theta, or are of another hand.
    """
    check_hand(checkpoint, data)
    if not data.has_theta:
        raise AminnError("the data set tells no theta; simulate one with --vary mechanics=0.5")
    part = data.split("validation") if same_configuration(checkpoint, data) else data
    held = part.take(part.samples["stable"] > 0)
    hands = held.grasps["hand_id"][held.grasp_rows()] if "hand_id" in held.grasps else held.samples["grasp_id"]
    many = len(np.unique(held.samples["grasp_id"])) >= LEAST_GRASPS * len(np.unique(hands))
    return estimate_errors(predictor(checkpoint.model), pushes_of(part), held.samples["theta"], hands if many else None)


def write_errors(checkpoint: Checkpoint, errors: Errors) -> Path:
    """Keep a model's errors beside it; returns the file."""
    file = checkpoint.path / ERRORS
    write_json(file, sealed(asdict(errors) | {"checkpoint_sha256": checkpoint.sha256}))
    return file


def _figures(errors: Array) -> dict[str, float]:
    return {
        "relative_error_median": float(np.median(errors)),
        "relative_error_p90": float(np.quantile(errors, 0.9)),
    }


def as_json(found: Calibration, run_sha256: str) -> dict[str, Any]:
    """Everything that was found."""
    names, hand = found.space.names, found.pushes.hand
    prior = found.prior.sd(found.space)
    by_name = {"theta": found.theta, "mean": found.fit.mean, "sd": found.fit.sd, "prior_sd": prior}
    return {
        "format_version": FORMAT_VERSION,
        "hand": hand.name,
        "hand_sha256": hand.sha256,
        "run_sha256": run_sha256,
        **{key: dict(zip(names, map(float, values), strict=True)) for key, values in by_name.items()},
        "units": {p.name: p.unit for p in found.space.parameters},
        "undetermined": found.undetermined,
        "pushes": len(found.pushes),
        "grasps": len(np.unique(found.pushes.grasp_id)),
        "held_out_by": found.held_out.by,
        "blend": found.held_out.blend,
        "before": _figures(found.held_out.before),
        "after": _figures(found.held_out.after),
        "noise": found.noise,
        "slips": int(found.slipped.sum()),
        "mistakes": [{"name": m.mistake.name, "detail": m.mistake.detail, "gain": m.gain} for m in found.mistakes],
    }


def as_text(found: Calibration) -> str:
    """What was found, for a terminal."""
    before, after = (_figures(e) for e in (found.held_out.before, found.held_out.after))
    rows, parts = [["parameter", "used", "90 % from", "to", "unit"]], ["parts"]
    for p, value, low, high in zip(found.space.parameters, found.theta, *found.intervals, strict=True):
        if p.name not in found.undetermined:
            shown = [math.exp(v) if p.unit == "1" else v for v in (value, low, high)]
            rows.append([p.name, *(f"{v:.4g}" for v in shown), "of nominal" if p.unit == "1" else p.unit])
            parts.append(", ".join(p.parts))
    return "\n".join(
        [
            *map("  ".join, zip(align_columns(rows), parts, strict=True)),
            f"not determined, the pushes say little of: {', '.join(found.undetermined) or 'none'}",
            *([] if found.free.all() else [KEPT]),
            *_slips(found),
            f"error of {len(found.pushes)} pushes, each {found.held_out.by} left out in turn: "
            f"{before['relative_error_median']:.1%} of the motion before, {after['relative_error_median']:.1%} after "
            f"(p90 {before['relative_error_p90']:.1%}, {after['relative_error_p90']:.1%})",
        ]
    )


def _slips(found: Calibration) -> list[str]:
    slipped, (before, after) = found.slipped, (found.held_out.before, found.held_out.after)
    if not slipped.any():
        return []
    grasps = ", ".join(map(str, np.unique(found.pushes.grasp_id[slipped])))
    count = f"{slipped.sum()} of {len(slipped)} pushes"
    line = f"{count} slipped or fit no hand, and count for hardly anything: of grasps {grasps}"
    if slipped.all():
        return [line]
    b, a = (float(np.median(errors[~slipped])) for errors in (before, after))
    return [f"{line}; the error of the others goes from {b:.1%} to {a:.1%}"]


def as_header(content: dict[str, Any]) -> str:
    """A C table of theta, for `aminn_calibration_set`."""
    rows = []
    for name, value in content["theta"].items():
        unit = content["units"][name].removesuffix("1")
        rows.append(f"    {float(np.float32(value)).hex()}f, /* {name}: {value:+.4f} {unit}".rstrip() + " */")
    return (
        "/* Generated by aminn calibrate, for aminn_calibration_set(): how a hand differs from its description.\n"
        f" * hand {content['hand_sha256'][:16]}, run {content['run_sha256'][:16]}, {content['pushes']} pushes. */\n"
        "#ifndef AMINN_CALIBRATION_H\n#define AMINN_CALIBRATION_H\n\n"
        f"#if defined AMINN_N_THETA && AMINN_N_THETA != {len(rows)}\n"
        f'#error "this calibration is of a hand of {len(rows)} parameters, AMINN_N_THETA says another"\n#endif\n\n'
        f"static const float {SYMBOL}[{len(rows)}] = {{\n" + "\n".join(rows) + "\n};\n\n#endif\n"
    )


def write_calibration(out: AnyPath, found: Calibration, run_sha256: str) -> list[Path]:
    """Write OUT.json and OUT.h; returns both. An old header goes before: no cut leaves two that are not of one fit."""
    out, content = Path(out), as_json(found, run_sha256)
    header = out.with_suffix(".h")
    if header.is_file() and not header.is_symlink():
        header.unlink()
        sync_folder(header.parent)
    write_json(out, sealed(content))
    write_atomically(header, as_header(content).encode())
    return [out, header]


def read_calibration(path: AnyPath, hand: Hand) -> Array:
    """theta (P) of a calibration of `hand`. Raises AminnError where it is of another hand, or no calibration,
    or one that no hand has."""
    content, space = read_json(path, "a calibration"), Theta(hand)
    if content.get("format_version") != FORMAT_VERSION:
        found = content.get("format_version", "none")
        raise OutdatedError(f"{path}: format_version is {found}, this program reads {FORMAT_VERSION}; {ANEW}")
    check_seal(path, content, ANEW)
    require(path, content, KEYS, ANEW)
    values = content["theta"]
    strange = [*(n for n in space.names if n not in values), *(n for n in values if n not in space.names)]
    if strange or content["hand_sha256"] != hand.sha256:
        why = f"{strange[0]} is not in both" if strange else "the descriptions differ"
        raise AminnError(f"{path}: of hand {content['hand']}, not of {hand.name} ({why}); {ANEW}")
    theta = [values[name] for name in space.names]
    for name, value, bound in zip(space.names, theta, theta_bounds(len(space), len(hand.joints)).tolist(), strict=True):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise OutdatedError(f"{path}: theta.{name} is no number; {ANEW}")
        if not abs(value) <= bound:  # nor where it is NaN
            raise OutdatedError(f"{path}: theta.{name} is not within +-{bound:g}; {ANEW}")
    return np.array(theta, float)


def calibrated(data: Dataset, theta: Array) -> Dataset:
    """Measured samples as a model with theta sees them: states corrected, closure computed again, theta as input."""
    s = data.samples
    true = true_states(data.hand, s["q"], s["x_ht"], s["w_e"], s["contacts"], theta)
    return replace(data, samples=s | true)
