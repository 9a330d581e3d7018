"""Checkpoints: `model.safetensors` (weights and normalisation) beside `model.json` (everything else). Never pickle."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from aminn_base.errors import AminnError, OutdatedError
from aminn_base.files import write_atomically, write_json

from .baseline import Mlp
from .config import ModelConfig, build_config
from .model import Aminn
from .nominal import Nominal

FORMAT_VERSION = 3
WEIGHTS, META = "model.safetensors", "model.json"
KINDS = {"aminn": Aminn, "mlp": Mlp}


@dataclass(frozen=True)
class Checkpoint:
    """A trained cascade in evaluation mode."""

    model: Aminn | Mlp
    meta: dict
    """kind, tau, data set, seed, training history and whatever else training recorded."""
    path: Path
    sha256: str
    """Of the weights file followed by the metadata file."""


def build_model(kind: str, config: ModelConfig, nominal: Nominal) -> Aminn | Mlp:
    """A new cascade of one of `KINDS`."""
    if kind not in KINDS:
        raise AminnError(f"model kind {kind!r} is unknown; there are {', '.join(KINDS)}")
    return KINDS[kind](config, nominal)


def save_checkpoint(path: Path, model: Aminn | Mlp, meta: dict) -> None:
    """Write `model` and `meta` into folder `path`."""
    write_atomically(path / WEIGHTS, save({k: v.contiguous() for k, v in model.state_dict().items()}))
    nominal = {k: v.tolist() for k, v in asdict(model.nominal).items()}
    fixed = {
        "format_version": FORMAT_VERSION,
        "kind": model.kind,
        "model": asdict(model.config),
        "nominal": nominal,
    }
    write_json(path / META, meta | fixed)


def load_weights(module: nn.Module, tensors: dict[str, Tensor], source: str) -> None:
    """Load weights. Raises OutdatedError that names the first tensor that does not fit the architecture."""
    expected = module.state_dict()
    for name, value in expected.items():
        if name not in tensors:
            raise OutdatedError(f"{source}: tensor {name} is missing; the weights are of another architecture")
        if tensors[name].shape != value.shape:
            raise OutdatedError(
                f"{source}: tensor {name} has shape {tuple(tensors[name].shape)}, the configuration asks for "
                f"{tuple(value.shape)}; the weights are of another architecture"
            )
    surplus = sorted(tensors.keys() - expected.keys())
    if surplus:
        raise OutdatedError(f"{source}: tensor {surplus[0]} is unknown; the weights are of another architecture")
    module.load_state_dict(tensors)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read the checkpoint in folder `path`. Raises OutdatedError with what is wrong with it."""
    weights, meta_file = path / WEIGHTS, path / META
    for file in (weights, meta_file):
        if not file.is_file():
            raise OutdatedError(f"{path}: {file.name} is missing; a checkpoint is a folder that `aminn train` wrote")
    try:
        meta = json.loads(meta_file.read_text())
        if meta["format_version"] != FORMAT_VERSION:
            raise OutdatedError(
                f"{meta_file}: format_version {meta['format_version']}, this program reads {FORMAT_VERSION}"
            )
        nominal = Nominal(**{k: np.asarray(v) for k, v in meta["nominal"].items()})
        config = build_config(ModelConfig, meta["model"], str(meta_file))
        model = build_model(meta["kind"], config, nominal)
        tensors = load_file(weights)
    except (json.JSONDecodeError, KeyError, TypeError, SafetensorError) as error:
        raise OutdatedError(f"{path}: not a usable checkpoint ({type(error).__name__}: {error})") from error
    load_weights(model, tensors, str(weights))
    sha256 = hashlib.sha256(weights.read_bytes() + meta_file.read_bytes()).hexdigest()
    return Checkpoint(model.eval(), meta, path, sha256)
