"""An unfinished training run on disk: one safetensors file that holds all that a run needs to end in the same bytes.

Tensors: weights of the whole model, the best weights of the stage so far, AdamW's moments, the generator's state.
JSON in the file's metadata: identity of the run, learning-rate schedule, epochs done, history. One file, replaced
atomically: a kill at any moment leaves the state of the last finished epoch or of the one before.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from aminn_base.errors import OutdatedError
from aminn_base.files import write_atomically
from aminn_base.read import json_object

FILE, SHA256 = "unfinished.safetensors", "sha256"


@dataclass(frozen=True)
class RunState:
    """State after an epoch."""

    tensors: dict[str, Tensor]
    """"model.*", "best.*", "adam.<parameter>.<moment>" and "rng"."""
    progress: dict
    """stage, epoch (done), history, schedule: what JSON can hold."""

    def part(self, prefix: str) -> dict[str, Tensor]:
        """The tensors whose names begin with `prefix` and a point, without it."""
        start = prefix + "."
        return {k.removeprefix(start): v for k, v in self.tensors.items() if k.startswith(start)}


def named(prefix: str, state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Tensors with `prefix` and a point before their names."""
    return {f"{prefix}.{k}": v for k, v in state.items()}


def optimiser_tensors(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """AdamW's moments and step counts by parameter number."""
    states = optimiser.state_dict()["state"]
    return {f"adam.{i}.{name}": value for i, state in states.items() for name, value in state.items()}


def restore_optimiser(optimiser: torch.optim.Optimizer, state: RunState) -> None:
    """Put back what `optimiser_tensors` gave."""
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in state.part("adam").items():
        index, name = key.split(".")
        moments.setdefault(int(index), {})[name] = value
    optimiser.load_state_dict(optimiser.state_dict() | {"state": moments})


def save_run(folder: Path, identity: dict, state: RunState) -> None:
    """Write the state of the run `identity` into `folder`."""
    metadata = {"identity": json.dumps(identity, sort_keys=True), "progress": json.dumps(state.progress)}
    tensors = {k: v.detach().contiguous() for k, v in state.tensors.items()}
    write_atomically(folder / FILE, save(tensors, metadata | {SHA256: _sha256(metadata, tensors)}))


def _sha256(metadata: dict[str, str], tensors: dict[str, Tensor]) -> str:
    """Of everything that a run goes on from."""
    found = hashlib.sha256(f"{metadata['identity']}\n{metadata['progress']}".encode())
    for name in sorted(tensors):
        found.update(f"\n{name} {tensors[name].dtype} {tuple(tensors[name].shape)}\n".encode())
        found.update(tensors[name].numpy().tobytes())
    return found.hexdigest()


def load_run(folder: Path, identity: dict) -> RunState | None:
    """The unfinished run in `folder`, if there is one. Raises OutdatedError if it is damaged or of another run."""
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            found, progress = (json_object(metadata[name]) for name in ("identity", "progress"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        if metadata.get(SHA256) != _sha256(metadata, tensors):
            raise ValueError("its SHA-256 is of other content")
    except (SafetensorError, KeyError, ValueError, OSError) as error:
        raise damaged(folder, error) from error
    if found != json.loads(json.dumps(identity)):
        raise OutdatedError(
            f"{folder}: holds an unfinished run that differs in {', '.join(differences(found, identity))}; "
            "remove the folder or give another one"
        )
    return RunState(tensors, progress)


def damaged(folder: Path, error: Exception) -> OutdatedError:
    """What to say of the unfinished run in `folder` where it cannot be continued."""
    text = f"{type(error).__name__}: {error}" if isinstance(error, KeyError | AttributeError) else str(error)
    return OutdatedError(f"{folder / FILE}: the unfinished run there is damaged ({text}); remove the folder")


def clear_run(folder: Path) -> None:
    """Remove the unfinished run, if there is one."""
    (folder / FILE).unlink(missing_ok=True)


def flat_settings(value: object, prefix: str = "") -> dict[str, object]:
    """Settings by dotted key; those in tables of a list go by its index, a list of numbers is one setting."""
    if isinstance(value, list | tuple) and any(isinstance(part, dict) for part in value):
        value = dict(enumerate(value))
    if not isinstance(value, dict):
        return {prefix: list(value) if isinstance(value, tuple) else value}
    inner = ((f"{prefix}.{name}".strip("."), part) for name, part in value.items())
    return {k: v for name, part in inner for k, v in flat_settings(part, name).items()}


def differences(found: dict, wanted: dict) -> list[str]:
    """Dotted keys at which two identities differ."""
    a, b = flat_settings(found), flat_settings(wanted)
    return sorted(key for key in a.keys() | b.keys() if a.get(key) != b.get(key))
