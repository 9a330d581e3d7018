"""A trained AMINN as a flat list of named tables: what the ONNX graph and the C runtime are written from."""

from __future__ import annotations

import hashlib
import re
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aminn_base.errors import AminnError
from aminn_hand import Hand
from aminn_hand.sensors import NOMINAL_FRICTION
from aminn_hand.theta import Theta

from ..hand.nominal import nominal_of
from .checkpoint import Checkpoint
from .config import ModelConfig
from .network import Aminn, Backbone

FORMAT_VERSION = 1
# Table name -> name in the backbone's state.
_BACKBONE = {
    "contact_mean": "contact_norm.mean",
    "contact_inv_std": "contact_norm.inv_std",
    "global_mean": "global_norm.mean",
    "global_inv_std": "global_norm.inv_std",
} | {f"{layer}_{short}": f"{layer}.{long}" for layer in ("contact", "trunk1", "trunk2")
     for short, long in (("w", "weight"), ("b", "bias"))}  # fmt: skip
_HEAD = {"w": "weight", "b": "bias"}
_CLASSIFIER = {
    "aux_mean": "aux_norm.mean",
    "aux_inv_std": "aux_norm.inv_std",
    "cls1_w": "cls1.weight",
    "cls1_b": "cls1.bias",
    "cls2_w": "cls2.weight",
    "cls2_b": "cls2.bias",
}
_CONSTANTS = ("wrench_log_scale", "chol_nom", "tendon_dir_nom", "tendon_gain_nom", "gate_nom", "coord_mask")
_TENDONS = ("tendon_dir_nom", "tendon_gain_nom", "gate_nom")
"""Which a model of a hand without gates lacks."""
_SURE = {"sure_mean": "norm.mean", "sure_inv_std": "norm.inv_std", "sure_w": "out.weight", "sure_b": "out.bias"}
HAND_TABLES = ("chol_nom", "tendon_dir_nom", "tendon_gain_nom", "coord_mask", "geom_axis", "geom_anchor")
"""What a hand is, for a model."""


@dataclass(frozen=True)
class ExportedModel:
    """Everything that inference needs."""

    meta: dict
    """Scalars and names; floats are exact."""
    tensors: dict[str, NDArray[np.float32]]
    """Tables; weights are [out][in]. Names with "s1." or "s2." before them belong to a stage."""


def _stage_tables(prefix: str, backbone: Backbone) -> dict[str, NDArray]:
    state = backbone.state_dict()
    tables = {prefix + name: state[key].numpy() for name, key in _BACKBONE.items()}
    return tables | {prefix + f"head_{short}": _whole_head(backbone, long).numpy() for short, long in _HEAD.items()}


def _whole_head(backbone: Backbone, part: str) -> Tensor:
    """Weight or bias of the mechanics head, with the twist head's where `Dims.head_parts` has them if there is one."""
    head, dims = getattr(backbone.head, part).detach(), backbone.dims
    if backbone.twist_head is None:
        return head
    rows = head.unflatten(0, (dims.branches, -1))
    twist = getattr(backbone.twist_head, part).detach().unsqueeze(1)
    at = replace(dims, twist=True).head_parts["twist"].start
    return torch.cat([rows[:, :at], twist, rows[:, at:]], 1).flatten(0, 1)


def _check_exportable(checkpoint: Checkpoint, config: ModelConfig) -> None:
    """Raises AminnError for options that the exported forms do not have."""
    if not config.heads_see_wrench:
        raise AminnError(
            f"{checkpoint.path}: heads_see_wrench = false is an option of the trainer alone; train without it"
        )


def _identity(checkpoint: Checkpoint, tensors: dict[str, NDArray[np.float32]]) -> dict[str, str]:
    """Which hand and data set the model is of, where its training recorded them."""
    hand = re.sub(r'[^ -~]|["\\?]', "-", str(checkpoint.meta.get("data", {}).get("hand", "hand")))[:46]
    constants = b"".join(tensors[name].astype("<f4").tobytes() for name in HAND_TABLES if name in tensors)
    identity = {"hand": f"{hand} {hashlib.sha256(constants).hexdigest()[:8]}"}
    if "data_config_sha256" in checkpoint.meta:
        identity["data_sha256"] = checkpoint.meta["data_config_sha256"]
    return identity


def geometry_tables(hand: Hand) -> dict[str, NDArray]:
    """What the closure is computed from: axis and anchor of each coordinate at q = 0 (B, C, 3)."""
    nominal = nominal_of(hand)
    return {"geom_axis": nominal.axis, "geom_anchor": nominal.anchor}


def export_tables(checkpoint: Checkpoint) -> ExportedModel:
    """The tables of an AMINN checkpoint. Raises AminnError for another kind of model."""
    model = checkpoint.model
    if not isinstance(model, Aminn):
        raise AminnError(
            f"{checkpoint.path}: a {model.kind} has no mechanics layer to export; give an aminn checkpoint"
        )
    config = model.config
    _check_exportable(checkpoint, config)
    tensors = _stage_tables("s1.", model.stage1.backbone) | _stage_tables("s2.", model.stage2.backbone)
    classifier = model.stage1.state_dict()
    tensors |= {"s1." + name: classifier[key].numpy() for name, key in _CLASSIFIER.items()}
    sure = model.sure.state_dict()
    tensors |= {"s2." + name: sure[key].numpy() for name, key in _SURE.items()}
    constants = model.stage2.backbone.state_dict()
    tensors |= {name: constants[name].numpy() for name in _CONSTANTS if model.hand.dims.gates or name not in _TENDONS}
    tensors |= geometry_tables(model.hand)
    tensors["theta_terms"] = model.stage2.backbone.theta_terms.numpy()
    if config.twists(model.hand):
        tensors["twist_nom"] = nominal_of(model.hand).twist
    stages = [asdict(m) for m in config.mechanics]
    for stage, part in zip(stages, (model.stage1.backbone, model.stage2.backbone), strict=True):
        stage["eps_m"] = part.eps_m if np.ptp(part.eps_m) > 0 else part.eps_m[0]
    tensors |= {f"s{i}.eps_m": np.full(model.hand.dims.branches, s["eps_m"]) for i, s in enumerate(stages, 1)}
    if stages[0]["dq0"] != stages[1]["dq0"]:
        raise AminnError(f"{checkpoint.path}: the stages differ in dq0; an exported model has one form for both")
    tensors = {k: np.ascontiguousarray(v, np.float32) for k, v in tensors.items()}
    theta, dims = Theta(model.hand), config.dims(model.hand)
    meta = (
        _identity(checkpoint, tensors)
        | {
            "format_version": FORMAT_VERSION,
            "branches": [b.name for b in model.hand.branches],
            "joints": list(model.hand.joints),
            "hand_description": model.hand.as_dict(),
            "branch_joints": [list(row) for row in model.hand.coordinate_joints],
            "checkpoint_sha256": checkpoint.sha256,
            "tau": float(np.float32(checkpoint.meta["tau"])),
            "dq0": stages[0]["dq0"],
            "told": bool(config.told),
            "tendons": model.hand.dims.tendons,
            "slides": dims.slides,
            "sensing": dims.sensing > 0,
            "friction_nominal": NOMINAL_FRICTION,
            "max_translation": config.motion_limits[0],
            "max_rotation": config.motion_limits[1],
            "bound_edge": sure["edge"].tolist(),
            "bound_factor": sure["factor"].tolist(),
            "theta_names": list(theta.names),
            "theta_units": [p.unit for p in theta.parameters],
            "length_scale": model.hand.length_m,
            "log_range": config.log_range,
            "displacement_log_scale": config.displacement_log_scale,
            "contact_width": config.contact_width,
            "width": list(config.width),
            "classifier_width": config.classifier_width,
        }
        | {name: [stage[name] for stage in stages] for name in ("eps_m", "eps_kx", "eps_jq")}
    )
    return ExportedModel(meta, tensors)
