"""Train a cascade: stage 1 on every sample, stage 2 on the stable ones, then how sure it is of its motion, and tau.

Bytes depend on data, configuration and seed alone: arithmetic runs on one thread, and the order of the samples comes
from a generator whose state is part of the run's state (`run_state`). An interrupted or killed run continues from its
last finished epoch and ends in the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from aminn_base.errors import AminnError, OutdatedError, WriteError
from aminn_base.lock import locked_folder
from aminn_base.progress import progress_bar
from aminn_base.read import AnyPath
from aminn_hand import Hand
from aminn_hand.hand import N_WRENCH
from aminn_hand.theta import Theta

from ..data.dataset import MEASURED, Dataset
from ..data.origin import check_hand
from ..data.sensors import SEED, draw, drawn, tells_all, truth, with_sensors
from ..evaluation.evaluate import figures_of, predicted
from ..evaluation.metrics import choose_tau, f1_score, operating_curve, pose_error, rms
from ..evaluation.predict import predict
from ..hand.symmetry import Reflection
from ..model.baseline import Mlp, MlpStage, n_parameters
from ..model.checkpoint import CARD, META, Checkpoint, build_model, load_checkpoint, save_checkpoint
from ..model.config import LossWeights, ModelConfig, TrainConfig
from ..model.losses import pose_terms, structural_terms
from ..model.network import Aminn, Backbone, Stage1, Stage2
from .card import write_card
from .device import CPU, described, device_of
from .run_state import (
    FILE,
    RunState,
    clear_run,
    damaged,
    differences,
    flat_settings,
    load_run,
    named,
    optimiser_tensors,
    restore_optimiser,
    save_run,
)
from .sure import fit_sure

# To be raised with every change of the trainer that changes what a run results in.
TRAINING_VERSION = 6
BOARD = "tensorboard"
BOARD_FIGURES = ("f1", "rmse_pose_all", "relative_error_median_all")
"""On validation data, beside a run's settings."""
SCALAR = (bool, int, float, str)
"""What TensorBoard takes as a setting."""
LEAST_GRASPS = {"train": 5, "validation": 2}
Inputs = dict[str, Tensor]
Terms = dict[str, Tensor]


@dataclass(frozen=True)
class _Stage:
    """What the loop needs to know of a stage: `terms(inputs, targets)` are the loss's parts, averaged over a batch."""

    name: str
    module: nn.Module
    length_m: float
    terms: Callable[[Inputs, Tensor], Terms]
    train: tuple[Inputs, Tensor]
    validation: tuple[Inputs, Tensor]

    def on(self, device: torch.device) -> _Stage:
        """The stage with its data on a device, where its module moves to."""
        self.module.to(device)
        train, validation = ((_on(x, device), y.to(device)) for x, y in (self.train, self.validation))
        return replace(self, train=train, validation=validation)


def _on(x: Inputs, device: torch.device) -> Inputs:
    return {k: v.to(device) for k, v in x.items()}


def _stage1_terms(module: Stage1 | MlpStage) -> Callable[[Inputs, Tensor], Terms]:
    def terms(x: Inputs, stable: Tensor) -> Terms:
        logit = module(x)[0] if isinstance(module, Stage1) else module(x).squeeze(-1)
        return {"cross-entropy": nn.functional.binary_cross_entropy_with_logits(logit, stable)}

    return terms


def _stage2_terms(
    module: Stage2 | MlpStage, weights: LossWeights, length_m: float
) -> Callable[[Inputs, Tensor], Terms]:
    def terms(x: Inputs, y: Tensor) -> Terms:
        dx, taut = y[..., :N_WRENCH], y[..., N_WRENCH:]
        if not isinstance(module, Stage2):
            return pose_terms(module(x), dx, weights, length_m)
        pred, springs, response = module(x)
        pose = pose_terms(pred, dx, weights, length_m)
        return pose | structural_terms(springs, response, taut, weights, module.backbone.gated)

    return terms


def _select(x: Inputs, index: Tensor) -> Inputs:
    return {k: v[index] for k, v in x.items()}


def _stage_data(part: Dataset) -> tuple[Inputs, Tensor, Tensor]:
    """Inputs, stability (n), and what stage 2 is compared with: motion and, where known, taut tendons (n, 6 + B)."""
    taut = part.taut()
    motion = part.samples["dx_ht"] if taut is None else np.hstack([part.samples["dx_ht"], taut])
    stable = torch.as_tensor(part.samples["stable"] > 0)
    return part.inputs(), stable, torch.as_tensor(motion, dtype=torch.float32)


def _stages(
    model: Aminn | Mlp, config: TrainConfig, train: Dataset, validation: Dataset, new: bool = True
) -> list[_Stage]:
    """Both stages with their data; fits the normalisation of a new model.

    Sensors of `train` are all that is known of them, which each step draws from; those of `validation` are as they are.
    """
    (x, stable, motion), (xv, stable_v, motion_v) = map(_stage_data, (train, validation))
    held, held_v = torch.nonzero(stable).squeeze(1), torch.nonzero(stable_v).squeeze(1)
    stable_x = _select(x, held)
    if new:
        typical = draw(x, config.sensing, torch.Generator().manual_seed(SEED))
        model.stage1.fit_normalisers(typical)
        model.stage2.fit_normalisers(_select(typical, held))
    if new and isinstance(model, Mlp):
        model.stage2.out_scale.copy_(motion[held, :N_WRENCH].std(0))
    stage1 = _stage1_terms(model.stage1)
    length_m = train.hand.length_m
    stage2 = _stage2_terms(model.stage2, config.loss, length_m)
    return [
        _Stage("stage1", model.stage1, length_m, stage1, (x, stable.float()), (xv, stable_v.float())),
        _Stage(
            "stage2", model.stage2, length_m, stage2, (stable_x, motion[held]), (_select(xv, held_v), motion_v[held_v])
        ),
    ]


def identity_of(config: TrainConfig, data_sha256: str, start: Checkpoint | None = None) -> dict:
    """What a run's result follows from, as JSON has it: trainer, configuration, data, and what it starts from."""
    identity = {
        "training_version": TRAINING_VERSION,
        "config": json.loads(json.dumps(asdict(config))),
        "data_sha256": data_sha256,
    }
    return identity | ({"finetune": start.sha256} if start else {})


def continued(config: TrainConfig, start: Checkpoint, data: Dataset) -> TrainConfig:
    """The settings of a run that starts from the weights of `start`: its model's, where they are left at the defaults.

    Raises AminnError for data of another hand, and for other settings of the model than those of `start`.
    """
    check_hand(start, data)
    mine = start.model.config
    if config.kind != start.model.kind:
        raise AminnError(
            f"{start.path}: is an {start.model.kind}, and cannot be fine-tuned as an {config.kind}; "
            f"give --model {start.model.kind}"
        )
    of_data = {name: getattr(mine, name) for name in ("told", "sensors") if getattr(config.model, name) is None}
    wanted = replace(config.model, **of_data)
    if config.model != ModelConfig() and wanted != mine:
        keys = ", ".join(f"model.{key}" for key in differences(asdict(mine), asdict(wanted)))
        raise AminnError(
            f"{start.path}: was trained with another {keys}; leave the settings of the model out, or train again"
        )
    return replace(config, model=mine)


def _rate(progress: float) -> float:
    """Share of the peak learning rate: linear warm-up over the first 5 %, then a cosine to zero; progress in [0, 1]."""
    warm_up = 0.05
    if progress < warm_up:
        return progress / warm_up
    return 0.5 * (1 + float(np.cos(np.pi * (progress - warm_up) / (1 - warm_up))))


@contextmanager
def _precision(module: nn.Module, dtype: torch.dtype) -> Iterator[None]:
    """The mechanics layers of `module` compute in `dtype` within."""
    layers = [m for m in module.modules() if isinstance(m, Backbone)]
    for layer in layers:
        layer.precision = dtype
    try:
        yield
    finally:
        for layer in layers:
            layer.precision = torch.float64


def model_config(config: ModelConfig, data: Dataset) -> ModelConfig:
    """The settings with what follows from the training data: whether networks are told theta, and see sensors.

    Raises AminnError where they are to be told what the data do not vary, or to see what the data do not tell.
    """
    factors = data.samples["theta"][:, : Theta(data.hand).factors] if data.has_theta else np.zeros((1, 0))
    varied = bool((factors != factors[:1]).any())
    if config.told and not varied:
        raise AminnError(
            "model.told = true, but the mechanics parameters of all grasps of the training data are the same, and a "
            'network learns nothing from them; leave it at "data", or simulate with --vary mechanics=0.5'
        )
    if config.sensors and not truth(data):
        raise AminnError(
            f"model.sensors = true, but the training data tell none of {', '.join(data.hand.dims.sensors)}, and a "
            'network learns nothing of them; leave it at "data", or start from a run that has them (--finetune)'
        )
    told = varied if config.told is None else config.told
    return replace(config, told=told, sensors=tells_all(data) if config.sensors is None else config.sensors)


def as_seen(part: Dataset, config: ModelConfig) -> Dataset:
    """A part of the data with all that a model with these settings may know of its samples' sensors."""
    return with_sensors(part, truth(part) if config.sensors else {})


def mirror_of(config: TrainConfig, hand: Hand) -> Reflection | None:
    """What the samples are shown in, if anything. Raises AminnError where it is asked for and the hand has none."""
    mirrored = hand.mirror is not None if config.mirror is None else config.mirror
    return Reflection(hand) if mirrored else None


def _with_mirror_images(x: Inputs, y: Tensor, mirror: Reflection) -> tuple[Inputs, Tensor]:
    """The samples, then their mirror images in the same order."""
    image = mirror.inputs(x)
    return {k: torch.cat([v, image[k]]) for k, v in x.items()}, torch.cat([y, mirror.targets(y)])


class _Loop:
    """The optimisation of one stage; its state is what `RunState` keeps."""

    def __init__(self, stage: _Stage, config: TrainConfig, mirror: Reflection | None, least: float = np.inf) -> None:
        """`least` is the validation loss that an epoch must get below for its weights to be kept."""
        self.least = least
        self.stage, self.config, self.mirror = stage, config, mirror
        self.samples = _with_mirror_images(*stage.train, mirror) if mirror else stage.train
        self.steps_an_epoch = -(-len(stage.train[1]) // config.batch)
        rate, decay = config.learning_rate, config.weight_decay
        self.optimiser = torch.optim.AdamW(stage.module.parameters(), lr=rate, weight_decay=decay, fused=True)
        total = config.epochs * self.steps_an_epoch
        self.schedule = torch.optim.lr_scheduler.LambdaLR(self.optimiser, lambda step: _rate(step / total))
        self.rng = torch.Generator()
        self.best = {k: v.clone() for k, v in stage.module.state_dict().items()}
        self.history: dict[str, list[float]] = {"train": [], "validation": []}
        self.first_loss: float | None = None

    def seed(self, index: int) -> None:
        """Start the order of the samples of stage number `index`."""
        self.rng.manual_seed(int(np.random.SeedSequence([self.config.seed, index]).generate_state(1)[0]))

    def restore(self, state: RunState) -> None:
        restore_optimiser(self.optimiser, state)
        self.best, progress = state.part("best"), state.progress
        self.schedule.load_state_dict(progress["schedule"])
        for group, rate in zip(self.optimiser.param_groups, self.schedule.get_last_lr(), strict=True):
            group["lr"] = rate
        self.rng.set_state(state.tensors["rng"])
        self.history = progress["history"][self.stage.name]
        self.first_loss = progress["first_loss"]

    def state(self, model: nn.Module, progress: dict) -> RunState:
        """Everything that `restore` needs; `progress` has what is not the loop's own."""
        schedule = {k: v for k, v in self.schedule.state_dict().items() if isinstance(v, int | float | bool | list)}
        tensors = named("model", model.state_dict()) | named("best", self.best) | optimiser_tensors(self.optimiser)
        return RunState(
            tensors | {"rng": self.rng.get_state()},
            progress | {"schedule": schedule, "first_loss": self.first_loss},
        )

    def epoch(self) -> None:
        """One pass over the training data, then the validation loss; keeps the best weights."""
        (x, y), n = self.samples, len(self.stage.train[1])
        order = torch.randperm(n, generator=self.rng)
        if self.mirror:
            order = order + n * torch.randint(2, (n,), generator=self.rng)
        total = 0.0
        self.stage.module.train()
        for index in order.to(y.device).split(self.config.batch):
            shown = draw(_select(x, index), self.config.sensing, self.rng)
            total += self._step(shown, y[index]) * len(index)
        self.history["train"].append(total / n)
        self.stage.module.eval()
        with torch.no_grad():
            loss = self._checked(_numbers(self.stage.terms(*self.stage.validation)), "validation")
        if loss < min([*self.history["validation"], self.least]):
            self.best = {k: v.clone() for k, v in self.stage.module.state_dict().items()}
        self.history["validation"].append(loss)

    def _step(self, x: Inputs, y: Tensor) -> float:
        """One step of the optimiser; the loss before it."""
        with _precision(self.stage.module, torch.float32):
            terms, norm = self._gradient(x, y)
        if not np.isfinite(norm):  # float32 can fail on a nearly singular branch where float64 does not
            terms, norm = self._gradient(x, y)
        loss = self._checked(terms, f"step {self.schedule.last_epoch + 1}", norm)
        self.optimiser.step()
        self.schedule.step()
        return loss

    def _gradient(self, x: Inputs, y: Tensor) -> tuple[dict[str, float], float]:
        """Loss terms and the norm of the gradient, which is left clipped in the parameters."""
        self.optimiser.zero_grad()
        terms = self.stage.terms(x, y)
        torch.stack(list(terms.values())).sum().backward()
        norm = nn.utils.clip_grad_norm_(self.stage.module.parameters(), self.config.gradient_clip)
        found = _numbers(terms | {"norm": norm})
        return found, found.pop("norm")

    def _checked(self, values: dict[str, float], where: str, norm: float = 0.0) -> float:
        """The loss. Raises AminnError if it diverges, naming step and term."""
        loss = sum(values.values())
        self.first_loss = loss if self.first_loss is None else self.first_loss
        limit = self.config.divergence * self.first_loss
        if np.isfinite(loss) and np.isfinite(norm) and loss <= limit:
            return loss
        bad = [name for name, value in values.items() if not np.isfinite(value)]
        name = bad[0] if bad else max(values, key=values.__getitem__)
        what = f"{name} is {values[name]:.3g}" if bad or loss > limit else f"the gradient of {name} is not finite"
        raise AminnError(
            f"{self.stage.name}, epoch {len(self.history['validation']) + 1}, {where}: the loss diverges, {what} "
            f"(the first step's loss was {self.first_loss:.3g}); lower learning_rate or gradient_clip"
        )


def _validation_figures(stage: _Stage) -> dict[str, float]:
    """F1 at even odds of stage 1, RMSE_pose of stage 2, on validation data: what the losses stand for."""
    x, y = stage.validation[0], stage.validation[1].cpu()
    with torch.no_grad():
        out = stage.module(x)
    found = (out[0] if isinstance(out, tuple) else out).double().cpu().numpy()
    if found.ndim == 1 or found.shape[-1] == 1:
        return {"f1": f1_score(found.reshape(-1) > 0, y.numpy() > 0)}
    return {"rmse_pose": rms(pose_error(found, y[:, :N_WRENCH].double().numpy(), stage.length_m))}


def _numbers(terms: Terms) -> dict[str, float]:
    """The terms' values, with one wait for the device."""
    return dict(zip(terms, torch.stack([term.detach() for term in terms.values()]).tolist(), strict=True))


class _Board:
    """TensorBoard curves of a run, or nothing."""

    def __init__(self, folder: Path | None, epochs_done: int) -> None:
        self.writer = None
        if folder is not None:
            from torch.utils.tensorboard import SummaryWriter

            with self._told(folder):
                self.writer = SummaryWriter(folder, purge_step=epochs_done or None)

    @contextmanager
    def _told(self, folder: Path) -> Iterator[None]:
        """Errors of the writer, which come whenever its thread has met them, name the folder."""
        try:
            yield
        except OSError as error:
            raise WriteError(folder, error.strerror or str(error)) from error

    def epoch(self, loop: _Loop, epoch: int) -> None:
        if self.writer is not None:
            shown = {part: values[-1] for part, values in loop.history.items()}
            shown |= {"learning_rate": float(loop.schedule.get_last_lr()[0])} | _validation_figures(loop.stage)
            with self._told(Path(self.writer.log_dir)):
                for name, value in shown.items():
                    self.writer.add_scalar(f"{loop.stage.name}/{name}", value, epoch)

    def result(self, config: TrainConfig, figures: Mapping[str, float]) -> None:
        """The settings beside the figures that they led to."""
        if self.writer is not None:
            settings = {k: v if isinstance(v, SCALAR) else str(v) for k, v in flat_settings(asdict(config)).items()}
            kept = {f"validation/{name}": figures[name] for name in BOARD_FIGURES}
            with self._told(Path(self.writer.log_dir)):
                self.writer.add_hparams(settings, kept, run_name=".")

    def close(self) -> None:
        if self.writer is not None:
            with self._told(Path(self.writer.log_dir)):
                self.writer.close()


def _check_parts(parts: dict[str, Dataset], finetune: Checkpoint | None) -> bool:
    """Whether the parts say when a grasp gives way. Raises AminnError where they are too few to learn from.

    Where every load case holds, a model that is fine-tuned keeps what it knows of that; another one cannot learn it.
    """
    decided = True
    for name, part in parts.items():
        make = "measure" if part.measured else "simulate"
        grasps, stable = len(np.unique(part.samples["grasp_id"])), int(part.samples["stable"].sum())
        if grasps < LEAST_GRASPS[name]:
            raise AminnError(
                f"the {name} split has {grasps} grasps, training needs {LEAST_GRASPS[name]} or more: {make} more"
            )
        if stable == 0 or (stable == len(part) and finetune is None):
            also = ", or give --finetune a run that knows them" if stable else ""
            raise AminnError(
                f"the {name} split has {stable} stable of {len(part)} samples; training needs both outcomes: "
                f"{make} more grasps{also}"
            )
        decided &= stable < len(part)
    return decided


def _finished(out: Path, identity: dict) -> Checkpoint | None:
    """The checkpoint in `out` if it is what this run would give. Raises AminnError if it is of another run."""
    if not (out / META).is_file():
        return None
    checkpoint = load_checkpoint(out)
    found = checkpoint.meta.get("identity", {})
    if found != identity:
        raise OutdatedError(
            f"{out}: holds a model of another configuration or data set (it differs in "
            f"{', '.join(differences(found, identity))}); remove the folder or give another one"
        )
    return checkpoint


def train(
    config: TrainConfig,
    dataset: Dataset,
    out: AnyPath,
    bar_position: int = 0,
    tensorboard: bool = False,
    finetune: Checkpoint | None = None,
    device: str = CPU,
) -> Checkpoint:
    """Train on `dataset` and write the checkpoint and its model card to folder `out`.

    `finetune` is what to start from: its weights, normalisation and model settings. Its weights stay where no epoch is
    better on validation data; where every load case holds, stage 1 and tau stay what they are.

    Goes on with an unfinished run found there; a finished one of the same configuration and data is returned as is.
    `bar_position` is the line of the progress bar, for runs side by side; `tensorboard` writes curves to
    out/tensorboard. One process works in a folder at a time: InUseError names the other one.

    Steps are computed on `device` (cpu, cuda or cuda:N), the rest on the CPU. It is no part of what makes a run the
    same, as little as the processor is; model.json says which it was.
    """
    out, chosen = Path(out), device_of(device)
    parts = {"train": dataset.split("train", config.train_fraction), "validation": dataset.split("validation")}
    decided = _check_parts(parts, finetune)
    if finetune is not None:
        config = continued(config, finetune, dataset)
    identity = identity_of(config, dataset.sha256, finetune)
    finished = _finished(out, identity)
    if finished is not None and not (out / FILE).is_file():
        return finished
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    mirror = mirror_of(config, dataset.hand)
    new = finetune is None
    model = build_model(config.kind, model_config(config.model, parts["train"]) if new else config.model, dataset.hand)
    if finetune is not None:
        model.load_state_dict(finetune.model.state_dict())
    seen = {name: as_seen(part, model.config) for name, part in parts.items()}
    parts = dict(seen)
    if model.config.sensors:
        parts["validation"] = drawn(seen["validation"], config.sensing)
    stages = _stages(model, config, parts["train"], parts["validation"], new)
    stages = stages if decided else stages[1:]
    least = {} if new else {stage.name: _validation_loss(stage) for stage in stages}
    with locked_folder(out):
        finished = _finished(out, identity)  # by another process meanwhile, or by one that was cut off behind it
        if finished is not None:
            return _completed(finished) if (out / FILE).is_file() else finished
        resumed = load_run(out, identity)
        with _whole_run(out):
            done = 0 if resumed is None else resumed.progress["stage"] * config.epochs + resumed.progress["epoch"]
        board = _Board(out / BOARD if tensorboard else None, done)
        history = _optimise(model, stages, config, mirror, out, identity, resumed, bar_position, board, least, chosen)
        sure = fit_sure(model, seen["train"], seen["validation"], config.sensing, started=not new)
        meta = _result(model, parts, dataset, None if decided else finetune)
        meta |= {"seed": config.seed, "identity": identity, "history": history, "sure": sure}
        meta["device"] = described(chosen)
        if finetune is not None:
            trained_on = finetune.meta.get("identity", {}).get("data_sha256", "")
            meta["finetuned"] = {"sha256": finetune.sha256, "data_sha256": trained_on, "validation": least}
        (out / CARD).unlink(missing_ok=True)  # it would be compared with the new files
        board.result(config, meta["validation"])
        board.close()
        save_checkpoint(out, model, meta)
        return _completed(load_checkpoint(out))


def _completed(checkpoint: Checkpoint) -> Checkpoint:
    """A run's last steps: its card, and then no unfinished run."""
    write_card(checkpoint)
    clear_run(checkpoint.path)
    return checkpoint


def _validation_loss(stage: _Stage) -> float:
    stage.module.eval()
    with torch.no_grad():
        return sum(term.item() for term in stage.terms(*stage.validation).values())


@contextmanager
def _whole_run(out: Path) -> Iterator[None]:
    """Raises AminnError where what is done with the unfinished run in `out` finds something missing in it."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise damaged(out, error) from error


def _optimise(
    model: Aminn | Mlp,
    stages: list[_Stage],
    config: TrainConfig,
    mirror: Reflection | None,
    out: Path,
    identity: dict,
    resumed: RunState | None,
    bar_position: int,
    board: _Board,
    least: dict[str, float],
    device: torch.device,
) -> dict:
    """Train the stages in turn on `device`, from `resumed` on; leaves each on the CPU with its best weights.

    Returns the history.

    `least` has the validation loss of a stage's first weights, where they are as good as any.
    """
    progress: dict = {"stage": 0, "epoch": 0, "history": {}}
    if resumed is not None:
        with _whole_run(out):
            model.load_state_dict(resumed.part("model"))
            progress = {k: resumed.progress[k] for k in progress}
            _ = range(len(stages))[progress["stage"]], range(progress["epoch"])
    for index in range(progress["stage"], len(stages)):
        loop = _Loop(stages[index].on(device), config, mirror, least.get(stages[index].name, np.inf))
        loop.seed(index)
        done = 0
        if resumed is not None and index == progress["stage"]:
            with _whole_run(out):
                loop.restore(resumed)
            done = progress["epoch"]
        progress["history"][loop.stage.name] = loop.history
        title, epochs = f"{config.kind} {loop.stage.name}", range(done, config.epochs)
        bar = progress_bar(title, config.epochs, "epoch", iterable=epochs, initial=done, position=bar_position)
        for epoch in bar:
            try:
                loop.epoch()
            except AminnError as error:
                kept = f"; the state before this epoch is kept in {out / FILE}" if (out / FILE).is_file() else ""
                raise AminnError(f"{error}{kept}") from error
            bar.set_postfix({k: f"{v[-1]:.5f}" for k, v in loop.history.items()}, refresh=False)
            board.epoch(loop, index * config.epochs + epoch)
            progress |= {"stage": index, "epoch": epoch + 1}
            save_run(out, identity, loop.state(model, progress))
        loop.stage.module.load_state_dict(loop.best)
        loop.stage.module.to(CPU).eval()
    return progress["history"]


def _result(model: Aminn | Mlp, parts: dict[str, Dataset], dataset: Dataset, start: Checkpoint | None) -> dict:
    """What is known of a trained model: its threshold, its figures on validation data, what it was trained on.

    The threshold is that of `start`, where it is given.
    """
    validation, manifest = parts["validation"], dataset.manifest
    s, out = validation.samples, predict(model, validation)
    stable, error = s["stable"] > 0, pose_error(out["dx_ht"], s["dx_ht"], dataset.hand.length_m)
    tau = choose_tau(out["p_stable"], stable, error) if start is None else float(start.meta["tau"])
    figures = figures_of(predicted("validation", out, tau), validation)
    return {
        "tau": tau,
        "operating_curve": (start.meta if start else {}).get("operating_curve")
        or operating_curve(out["p_stable"], stable, error),
        "validation": figures,
        "data": {
            "hand": dataset.hand.name,
            "simulator": MEASURED if dataset.measured else manifest.get("simulator", ""),
            **{f"{name}_samples": len(part) for name, part in parts.items()},
            **{f"{name}_grasps": len(np.unique(part.samples["grasp_id"])) for name, part in parts.items()},
        },
        "data_config_sha256": manifest["config_sha256"],
        "n_parameters": n_parameters(model),
    }
