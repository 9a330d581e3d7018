"""The model card: what a trained model is, from what, how good on validation data, where not to trust it."""

from __future__ import annotations

import numpy as np

from aminn_base.files import write_atomically
from aminn_hand.sensors import UNITS
from aminn_hand.theta import Theta

from ..model.checkpoint import CARD, CARD_HASH, WEIGHTS, Checkpoint
from ..model.config import SensorDraws, TrainConfig, as_toml, build_config

KINDS = {
    "aminn": "AMINN, a network that predicts springs and tendons, and a statics layer that turns them into motion",
    "mlp": "a cascade of two MLPs, the black box that AMINN is compared with",
}
CONTACTS = {"point": "point contacts", "soft_finger": "soft fingertips"}
# Figure of the validation split -> how the card names it.
FIGURES = (
    ("f1", "F1 of stable", "{:.3f}"),
    ("precision", "precision", "{:.3f}"),
    ("recall", "recall", "{:.3f}"),
    ("auroc", "AUROC of p_stable", "{:.3f}"),
    ("ece", "expected calibration error of p_stable", "{:.3f}"),
    ("rmse_pose_all", "RMSE_pose, all stable", "{:.4f}"),
    ("rmse_mm_all", "RMSE, mm", "{:.2f}"),
    ("rmse_deg_all", "RMSE, degrees", "{:.2f}"),
    ("relative_error_median_all", "relative error, median", "{:.3f}"),
    ("relative_error_p90_all", "relative error, 90th percentile", "{:.3f}"),
    ("passivity_violation_full", "share with w.dx < 0", "{:.2%}"),
    ("slide_auroc", "AUROC of p_slide, over stable cases", "{:.3f}"),
    ("bound_coverage", "stable cases within bound_95", "{:.1%}"),
    ("bound_coverage_slid", "stable cases that slid, within bound_95", "{:.1%}"),
    ("bound_width", "bound_95 as a share of the motion, median", "{:.3f}"),
    ("rmse_pose_refused_5pc", "RMSE_pose, without the 5 % of the largest bound_95", "{:.4f}"),
    ("rmse_pose", "RMSE_pose, stable and predicted stable", "{:.4f}"),
)


def write_card(checkpoint: Checkpoint) -> None:
    """Write card.md beside the checkpoint. A run's folder may move, so the card names no place."""
    write_atomically(checkpoint.path / CARD, _card(checkpoint).encode())


def _told(checkpoint: Checkpoint) -> str:
    """Whether networks see theta."""
    if not checkpoint.model.config.told:
        return "no" if checkpoint.model.kind == "mlp" else "no; its layer follows them"
    names = Theta(checkpoint.model.hand).names[: Theta(checkpoint.model.hand).factors]
    return f"yes: {', '.join(names)}"


def _sensors(checkpoint: Checkpoint, draws: SensorDraws) -> str:
    """What the networks see where it is known, and of which share of the samples training knew it."""
    if not checkpoint.model.config.sensors:
        return "none"
    shares = dict(zip(UNITS, (draws.friction, draws.weight, draws.tension), strict=True))
    return ", ".join(f"{name} (known of {shares[name]:.0%})" for name in checkpoint.model.hand.dims.sensors)


_SLIDES = {
    "learned": "is learned from the simulated load cases",
    "kept": "is that of the model it was fine-tuned from: measured data do not tell what slid",
    "unknown": "says nothing (0.5): measured data do not tell what slid",
}
"""Where p_slide is from."""


def _card(checkpoint: Checkpoint) -> str:
    meta, data = checkpoint.meta, checkpoint.meta["data"]
    figures = meta["validation"]
    rows = [f"| {text} | {form.format(figures[k])} |" for k, text, form in FIGURES if figures.get(k) is not None]
    epochs = {stage: len(curves["validation"]) for stage, curves in meta["history"].items()}
    best = {stage: 1 + int(np.argmin(curves["validation"])) for stage, curves in meta["history"].items()}
    for stage, least in meta.get("finetuned", {}).get("validation", {}).items():
        best[stage] *= min(meta["history"][stage]["validation"]) < least  # none: the weights it started from
    config = build_config(TrainConfig, meta["identity"]["config"])
    hand = checkpoint.model.hand
    sensing = checkpoint.model.config.sensors
    unknown = "Where friction is not told, and" if sensing else "Friction is not an input. Where"
    friction = f"- {unknown} a contact slides, the motion is a guess around the training data's."
    branches = ", ".join(f"{b.name} of {len(b.coordinates)}" for b in hand.branches) + " joints"
    return "\n".join(
        [
            f"# Model card: {meta['kind']}",
            "",
            f"{KINDS[meta['kind']]}. Given joint angles, tool pose, wrench, contacts and closure, it says whether the "
            "grasp holds (`p_stable` against `tau`), how far the tool moves in the hand (`dx_ht`), and how sure it is "
            "of that (`p_slide`, `bound_95`).",
            "",
            "| | |",
            "|---|---|",
            f"| parameters | {meta['n_parameters']} |",
            f"| threshold tau | {meta['tau']:.4f}, chosen on validation data |",
            f"| weights | `{WEIGHTS}`, {CARD_HASH}: {checkpoint.sha256} |",
            f"| hand | {hand.name}: {branches} |",
            f"| simulator | {data['simulator']} |",
            f"| data set | {meta['identity']['data_sha256']} |",
            f"| told mechanics parameters | {_told(checkpoint)} |",
            f"| optional sensors | {_sensors(checkpoint, config.sensing)} |",
            *(
                f"| fine-tuned from | checkpoint {start['sha256']}, trained on data set {start['data_sha256']} |"
                for start in [meta.get("finetuned")]
                if start
            ),
            f"| trained on | {data['train_samples']} load cases of {data['train_grasps']} grasps |",
            *(f"| best epoch of {stage} | {best[stage]} of {n} |" for stage, n in epochs.items()),
            "",
            f"## Figures on validation data ({data['validation_samples']} load cases of {data['validation_grasps']} "
            "grasps)",
            "",
            "These chose the best epochs, tau and what corrects `bound_95`; test figures come from `aminn evaluate`.",
            "",
            "| figure | value |",
            "|---|---|",
            *rows,
            "",
            "## Limits",
            "",
            f"- `p_slide` {_SLIDES[meta['sure']['p_slide']]}. `bound_95` was corrected on the validation data: it "
            "holds for grasps, tools and loads like theirs, over all of them and not for each.",
            f"- One hand, simulated, quasi-static loads, {CONTACTS[hand.contact.kind]}: for ranges see the manifest.",
            friction,
            "- Displacements are trained on stable cases: where `p_stable` is below tau, `dx_ht` means nothing.",
            "",
            "## Configuration",
            "",
            "```toml",
            as_toml(config).rstrip(),
            "```",
            "",
        ]
    )
