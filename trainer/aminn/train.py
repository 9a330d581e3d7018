"""Train a cascade: stage 1 on every sample, stage 2 on the stable ones, then the threshold tau on validation data.

Bytes depend on data, configuration and seed alone: arithmetic runs on one thread and each epoch's order comes from
(seed, stage, epoch). An interrupted run goes on from its last finished epoch and ends in the same bytes.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn
from tqdm import tqdm

from .checkpoint import META, Checkpoint, build_model, load_checkpoint, save_checkpoint, write_atomically, write_json
from .dataset import Dataset
from .errors import AminnError
from .losses import LossWeights, pose_loss, structural_loss
from .metrics import choose_tau, pose_error
from .model import ModelConfig
from .nominal import nominal_from_hand
from .predict import predict

# To be raised with every change of the trainer that changes what a run results in.
TRAINING_VERSION = 1
RESUME, RESUME_META = "resume.safetensors", "resume.json"
Inputs = dict[str, Tensor]


@dataclass(frozen=True)
class TrainConfig:
    """One training run."""

    kind: str = "aminn"
    """"aminn" or "mlp"."""
    seed: int = 0
    """Initial weights and order of the samples."""
    epochs: int = 40
    """Passes over the data, for each stage."""
    batch: int = 128
    """Samples per step."""
    learning_rate: float = 2e-3
    """Peak of the one-cycle cosine schedule."""
    weight_decay: float = 0.5
    """AdamW's; without it the typical error is a little larger (docs/evaluation.md)."""
    gradient_clip: float = 1.0
    """Largest norm of a step's gradient."""
    loss: LossWeights = field(default_factory=LossWeights)
    """Weights of the stage 2 loss."""
    model: ModelConfig = field(default_factory=ModelConfig)
    """Sizes and constants."""


@dataclass(frozen=True)
class _Stage:
    """What the loop needs to know of a stage: `loss(inputs, targets)` averages over a batch."""

    name: str
    module: nn.Module
    loss: Callable[[Inputs, Tensor], Tensor]
    train: tuple[Inputs, Tensor]
    validation: tuple[Inputs, Tensor]


def _stage1_loss(module: nn.Module, kind: str) -> Callable[[Inputs, Tensor], Tensor]:
    def loss(x: Inputs, stable: Tensor) -> Tensor:
        logit = module(x)[0] if kind == "aminn" else module(x).squeeze(-1)
        return nn.functional.binary_cross_entropy_with_logits(logit, stable)

    return loss


def _stage2_loss(module: nn.Module, kind: str, weights: LossWeights) -> Callable[[Inputs, Tensor], Tensor]:
    def loss(x: Inputs, dx: Tensor) -> Tensor:
        if kind != "aminn":
            return pose_loss(module(x), dx, weights)
        pred, _, response = module(x)
        return pose_loss(pred, dx, weights) + structural_loss(response, weights)

    return loss


def _select(x: Inputs, index: Tensor) -> Inputs:
    return {k: v[index] for k, v in x.items()}


def _stages(model: nn.Module, config: TrainConfig, train: Dataset, validation: Dataset) -> list[_Stage]:
    """Both stages with their data; fits the normalisation of a new model."""
    data = []
    for part in (train, validation):
        x, stable = part.inputs(), torch.as_tensor(part.samples["stable"] > 0)
        dx = torch.as_tensor(part.samples["dx_ht"], dtype=torch.float32)
        data.append((x, stable, dx))
    (x, stable, dx), (xv, stable_v, dx_v) = data
    held, held_v = torch.nonzero(stable).squeeze(1), torch.nonzero(stable_v).squeeze(1)
    stable_x = _select(x, held)
    model.stage1.fit_normalisers(x)
    model.stage2.fit_normalisers(stable_x)
    if config.kind == "mlp":
        model.stage2.out_scale.copy_(dx[held].std(0))
    return [
        _Stage(
            "stage1",
            model.stage1,
            _stage1_loss(model.stage1, config.kind),
            (x, stable.float()),
            (xv, stable_v.float()),
        ),
        _Stage(
            "stage2",
            model.stage2,
            _stage2_loss(model.stage2, config.kind, config.loss),
            (stable_x, dx[held]),
            (_select(xv, held_v), dx_v[held_v]),
        ),
    ]


def identity_of(config: TrainConfig, data_sha256: str) -> dict:
    """What a run's result follows from, as JSON has it: trainer, configuration and data."""
    return {
        "training_version": TRAINING_VERSION,
        "config": json.loads(json.dumps(asdict(config))),
        "data_sha256": data_sha256,
    }


class _Run:
    """State of an unfinished stage on disk: weights, AdamW's moments, best weights so far, history."""

    def __init__(self, folder: Path, config: TrainConfig, data_sha256: str) -> None:
        self.folder = folder
        self.identity = identity_of(config, data_sha256)

    def save(self, state: dict[str, Tensor], progress: dict) -> None:
        write_atomically(self.folder / RESUME, save({k: v.contiguous() for k, v in state.items()}))
        write_json(self.folder / RESUME_META, self.identity | progress)

    def load(self) -> tuple[dict[str, Tensor], dict] | None:
        meta_file = self.folder / RESUME_META
        if not meta_file.is_file() or not (self.folder / RESUME).is_file():
            return None
        try:
            progress, state = json.loads(meta_file.read_text()), load_file(self.folder / RESUME)
        except (json.JSONDecodeError, SafetensorError) as error:
            raise AminnError(
                f"{self.folder}: the unfinished run there is damaged ({error}); remove the folder"
            ) from error
        if any(progress.get(k) != v for k, v in self.identity.items()):
            raise AminnError(
                f"{self.folder}: holds an unfinished run with another configuration or data set; "
                "remove the folder or give another one"
            )
        # The two files are written one after the other: a cut between them leaves a pair that does not belong together.
        return (state, progress) if int(state["epoch"]) == progress["total_epochs"] else None

    def clear(self) -> None:
        for name in (RESUME_META, RESUME):
            (self.folder / name).unlink(missing_ok=True)


def _optimiser_state(optimiser: torch.optim.AdamW) -> dict[str, Tensor]:
    states = optimiser.state_dict()["state"]
    return {f"adam.{i}.{name}": value for i, state in states.items() for name, value in state.items()}


def _restore_optimiser(optimiser: torch.optim.AdamW, state: dict[str, Tensor]) -> None:
    restored: dict[int, dict[str, Tensor]] = {}
    for key, value in state.items():
        if key.startswith("adam."):
            _, index, name = key.split(".")
            restored.setdefault(int(index), {})[name] = value
    optimiser.load_state_dict(optimiser.state_dict() | {"state": restored})


def _prefixed(prefix: str, state: dict[str, Tensor]) -> dict[str, Tensor]:
    return {prefix + k: v for k, v in state.items()}


def _unprefixed(prefix: str, state: dict[str, Tensor]) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}


def _learning_rate(config: TrainConfig, progress: float) -> float:
    """Linear warm-up over the first 5 %, then a cosine to zero; progress in [0, 1)."""
    warm_up = 0.05
    if progress < warm_up:
        return config.learning_rate * progress / warm_up
    return config.learning_rate * 0.5 * (1 + np.cos(np.pi * (progress - warm_up) / (1 - warm_up)))


def _epoch(stage: _Stage, stage_index: int, epoch: int, config: TrainConfig, optimiser: torch.optim.AdamW) -> float:
    """One pass over the training data; the mean loss."""
    x, y = stage.train
    seed = int(np.random.SeedSequence([config.seed, stage_index, epoch]).generate_state(1)[0])
    order = torch.randperm(len(y), generator=torch.Generator().manual_seed(seed))
    steps = order.split(config.batch)
    total = 0.0
    for k, index in enumerate(steps):
        for group in optimiser.param_groups:
            group["lr"] = _learning_rate(config, (epoch + k / len(steps)) / config.epochs)
        optimiser.zero_grad()
        loss = stage.loss(_select(x, index), y[index])
        loss.backward()
        nn.utils.clip_grad_norm_(stage.module.parameters(), config.gradient_clip)
        optimiser.step()
        total += loss.item() * len(index)
    return total / len(y)


def _progress_bar(title: str, done: int, epochs: int, position: int) -> tqdm:
    live = sys.stderr.isatty()  # a log gets few lines, and no cursor moves
    settings = {"mininterval": 0.5, "position": position} if live else {"mininterval": 10.0, "position": 0}
    return tqdm(range(done, epochs), initial=done, total=epochs, desc=title, unit="epoch", **settings)


def _train_stage(
    stage: _Stage,
    stage_index: int,
    config: TrainConfig,
    model: nn.Module,
    run: _Run,
    progress: dict,
    state: dict[str, Tensor] | None,
    bar_position: int,
) -> None:
    """Train one stage and leave the weights of its best epoch in the module. `progress` gathers the history."""
    optimiser = torch.optim.AdamW(stage.module.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    history = progress["history"].setdefault(stage.name, {"train": [], "validation": []})
    best = stage.module.state_dict()
    if state is not None:
        _restore_optimiser(optimiser, state)
        best = _unprefixed("best.", state)
    bar = _progress_bar(f"{config.kind} {stage.name}", len(history["train"]), config.epochs, bar_position)
    for epoch in bar:
        history["train"].append(_epoch(stage, stage_index, epoch, config, optimiser))
        with torch.no_grad():
            loss = stage.loss(*stage.validation).item()
        if not np.isfinite(loss):
            raise AminnError(f"{stage.name}, epoch {epoch}: the validation loss is {loss}; lower the learning rate")
        if loss < min(history["validation"], default=np.inf):
            best = {k: v.clone() for k, v in stage.module.state_dict().items()}
        history["validation"].append(loss)
        bar.set_postfix(train=f"{history['train'][-1]:.5f}", validation=f"{loss:.5f}", refresh=False)
        progress["total_epochs"] = stage_index * config.epochs + epoch + 1
        tensors = _prefixed("model.", model.state_dict()) | _prefixed("best.", best) | _optimiser_state(optimiser)
        run.save(tensors | {"epoch": torch.tensor(progress["total_epochs"])}, progress)
    stage.module.load_state_dict(best)


def _check_parts(parts: dict[str, Dataset]) -> None:
    for name, part in parts.items():
        stable = int(part.samples["stable"].sum())
        if stable == 0 or stable == len(part):
            raise AminnError(
                f"the {name} split has {stable} stable of {len(part)} samples; training needs both outcomes: "
                "simulate more grasps"
            )


def _finished(out: Path, run: _Run) -> Checkpoint | None:
    """The checkpoint in `out` if it is what this run would give. Raises AminnError if it is of another run."""
    if not (out / META).is_file():
        return None
    checkpoint = load_checkpoint(out)
    if checkpoint.meta.get("identity") != run.identity:
        raise AminnError(
            f"{out}: holds a model of another configuration or data set; remove the folder or give another one"
        )
    return checkpoint


def train(config: TrainConfig, dataset: Dataset, out: Path, bar_position: int = 0) -> Checkpoint:
    """Train on `dataset` and write the checkpoint to folder `out`.

    Goes on with an unfinished run found there; a finished one of the same configuration and data is returned as is.
    `bar_position` is the line of the progress bar, for runs side by side.
    """
    parts = {name: dataset.split(name) for name in ("train", "validation")}
    _check_parts(parts)
    out.mkdir(parents=True, exist_ok=True)
    run = _Run(out, config, dataset.sha256)
    finished = _finished(out, run)
    if finished is not None:
        return finished
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    model = build_model(config.kind, config.model, nominal_from_hand(dataset.manifest["hand"]))
    stages = _stages(model, config, parts["train"], parts["validation"])
    progress: dict = {"history": {}, "total_epochs": 0}
    resumed = run.load()
    if resumed is not None:
        state, progress = resumed
        model.load_state_dict(_unprefixed("model.", state))
    at = max(progress["total_epochs"] - 1, 0) // config.epochs
    for index, stage in enumerate(stages[at:], start=at):
        state = resumed[0] if resumed is not None and index == at else None
        _train_stage(stage, index, config, model, run, progress, state, bar_position)
    model.eval()
    tau = _operating_point(model, parts["validation"])
    meta = {
        "tau": tau,
        "seed": config.seed,
        "identity": run.identity,
        "history": progress["history"],
        "data_config_sha256": dataset.manifest["config_sha256"],
        "n_parameters": sum(p.numel() for p in model.parameters()),
    }
    save_checkpoint(out, model, meta)
    run.clear()
    return load_checkpoint(out)


def _operating_point(model: nn.Module, validation: Dataset) -> float:
    out = predict(model, validation)
    error = pose_error(out["dx_ht"], validation.samples["dx_ht"])
    return choose_tau(out["p_stable"], validation.samples["stable"] > 0, error)
