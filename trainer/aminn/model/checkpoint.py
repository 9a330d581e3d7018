"""Checkpoints: `model.safetensors` (weights and normalisation) beside `model.json` (everything else). Never pickle."""

from __future__ import annotations

import hashlib
import re
from dataclasses import asdict, dataclass
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from aminn_base.errors import AminnError, OutdatedError
from aminn_base.files import write_atomically, write_json
from aminn_base.read import AnyPath, read_json, read_text, require
from aminn_hand import Hand

from .baseline import Mlp
from .config import ModelConfig, build_config
from .network import Aminn

FORMAT_VERSION = 6
WEIGHTS, META, CARD = "model.safetensors", "model.json", "card.md"
CARD_HASH = f"SHA-256 of weights and `{META}`"
"""What stands before the hash in the model card."""
KINDS: dict[str, type[Aminn | Mlp]] = {"aminn": Aminn, "mlp": Mlp}
ANEW = "train again"
META_KEYS: dict[str, type | tuple[type, ...]] = {
    "kind": str,
    "tau": (int, float),
    "model": dict,
    "hand": dict,
}
TRAINED_KEYS: dict[str, type | tuple[type, ...]] = {
    "identity": dict,
    "data": dict,
    "data_config_sha256": str,
    "history": dict,
    "operating_curve": dict,
    "validation": dict,
    "n_parameters": int,
    "finetuned": dict,
    "sure": dict,
}
"""Of model.json where `aminn train` wrote it; a checkpoint without them can be run, and no more."""


@dataclass(frozen=True)
class Checkpoint:
    """A trained cascade in evaluation mode."""

    model: Aminn | Mlp
    meta: dict
    """kind, tau, data set, seed, training history and whatever else training recorded."""
    path: Path
    sha256: str
    """Of the weights file followed by the metadata file."""


def build_model(kind: str, config: ModelConfig, hand: Hand) -> Aminn | Mlp:
    """A new cascade of one of `KINDS`."""
    if kind not in KINDS:
        raise AminnError(f"model kind {kind!r} is unknown; there are {', '.join(KINDS)}")
    return KINDS[kind](config, hand)


def save_checkpoint(path: AnyPath, model: Aminn | Mlp, meta: dict) -> None:
    """Write `model` and `meta` into folder `path`."""
    path = Path(path)
    write_atomically(path / WEIGHTS, save({k: v.contiguous() for k, v in model.state_dict().items()}))
    fixed = {
        "format_version": FORMAT_VERSION,
        "kind": model.kind,
        "model": asdict(model.config),
        "hand": model.hand.as_dict(),
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


class _Meta(dict):
    """What model.json holds; a key that is not there is the file's fault, and named."""

    def __init__(self, file: Path, content: dict) -> None:
        super().__init__(content)
        self._file = file

    def __missing__(self, key: str) -> object:
        raise OutdatedError(f"{self._file}: {key} is missing; {ANEW}")


def _read_meta(file: Path) -> _Meta:
    """The checked content of model.json. Raises OutdatedError with the key that is wrong."""
    meta = _Meta(file, read_json(file, "a usable checkpoint"))
    if meta["format_version"] != FORMAT_VERSION:
        found = meta["format_version"]
        raise OutdatedError(f"{file}: format_version {found}, this program reads {FORMAT_VERSION}; {ANEW}")
    require(file, meta, META_KEYS | {k: kind for k, kind in TRAINED_KEYS.items() if k in meta}, ANEW)
    if meta["kind"] not in KINDS:
        raise OutdatedError(f"{file}: kind is {meta['kind']!r}, expected {' or '.join(KINDS)}; {ANEW}")
    if not 0 <= meta["tau"] <= 1:
        raise OutdatedError(f"{file}: tau is {meta['tau']}, expected 0 to 1; {ANEW}")
    if "identity" in meta:
        require(f"{file}: identity", meta["identity"], {"config": dict, "data_sha256": str}, ANEW)
    for stage, curves in meta.get("history", {}).items():
        numbers = isinstance(curves, dict) and all(_are_numbers(curves.get(k)) for k in ("train", "validation"))
        if not numbers:
            raise OutdatedError(f"{file}: history.{stage} is not two lists of numbers, train and validation; {ANEW}")
    curve = meta.get("operating_curve", {})
    if curve and not all(_are_numbers(curve.get(k)) for k in ("tau", "f1", "rmse_pose", "passed")):
        raise OutdatedError(f"{file}: operating_curve is not lists of tau, f1, rmse_pose and passed; {ANEW}")
    return meta


def _are_numbers(values: object) -> bool:
    return isinstance(values, list) and all(isinstance(v, int | float) for v in values)


def _hand(file: Path, value: dict) -> Hand:
    try:
        return Hand.from_dict(value)
    except AminnError as error:
        raise OutdatedError(f"{file}: {error}; {ANEW}") from error


def _hold_against_card(card: Path, sha256: str) -> None:
    """The card beside the files, if it is there, names their hash: zeros in the weights are weights as well."""
    said = re.search(rf"{re.escape(CARD_HASH)}: ([0-9a-f]{{64}})", read_text(card)) if card.is_file() else None
    if said and said[1] != sha256:
        raise OutdatedError(
            f"{card.parent}: {WEIGHTS} or {META} is not what {card.name} was written for: damaged, or changed by hand; "
            f"{ANEW}, or remove {card.name} if you changed it"
        )


def load_checkpoint(path: AnyPath) -> Checkpoint:
    """Read the checkpoint in folder `path`. Raises OutdatedError with what is wrong with it."""
    path = Path(path)
    weights, meta_file = path / WEIGHTS, path / META
    for file in (weights, meta_file):
        if not file.is_file():
            raise OutdatedError(f"{path}: {file.name} is missing; a checkpoint is a folder that `aminn train` wrote")
    meta = _read_meta(meta_file)
    try:
        config = build_config(ModelConfig, meta["model"], str(meta_file))
        model = build_model(meta["kind"], config, _hand(meta_file, meta["hand"]))
        tensors = load_file(weights)
    except (KeyError, TypeError, ValueError, OSError, SafetensorError) as error:
        raise OutdatedError(f"{path}: not a usable checkpoint ({type(error).__name__}: {error}); {ANEW}") from error
    load_weights(model, tensors, str(weights))
    for name, value in tensors.items():
        if not value.isfinite().all():
            raise AminnError(f"{weights}: tensor {name} holds NaN or infinity; {ANEW}")
    sha256 = hashlib.sha256(weights.read_bytes() + meta_file.read_bytes()).hexdigest()
    _hold_against_card(path / CARD, sha256)
    return Checkpoint(model.eval(), meta, path, sha256)
