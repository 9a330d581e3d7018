"""Configuration of a training run: dataclasses with one docstring per field, TOML files, and `key=value` overrides.

The field docstrings are the one description of a setting: `aminn train --print-config` prints them beside the values,
in a form that `--config` reads back. Values are checked where they are made: a wrong one is refused before any work.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, field, fields, is_dataclass, replace
from difflib import get_close_matches
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
)
from pydantic.dataclasses import dataclass as checked_dataclass

from aminn_base.errors import AminnError
from aminn_base.read import AnyPath, read_toml
from aminn_hand import Dims, Hand
from aminn_hand.hand import N_WRENCH
from aminn_hand.theta import Theta

Kind = Literal["aminn", "mlp"]
Width = Annotated[int, Field(gt=0, le=4096)]
Scale = Annotated[float, Field(gt=0, le=1e9)]
Weight = Annotated[float, Field(ge=0, le=1e9)]
Share = Annotated[float, Field(ge=0, le=1)]
OF_HAND = "hand"
"""How a file says that a setting is the hand's own; None in a configuration."""
OF_DATA = "data"
"""The same for one that follows from the training data."""
_own = BeforeValidator(lambda value: None if value == OF_HAND else value)
_of_data = BeforeValidator(lambda value: None if value == OF_DATA else value)
CHECKS = ConfigDict(extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


@checked_dataclass(frozen=True, config=CHECKS)
class MechanicsConfig:
    """Constants of the mechanics layer."""

    eps_m: Annotated[Scale | None, _own] = None
    """Isotropic contact compliance of every branch, m/N, or "hand": the hand's own, one value per branch. It also
    bounds the conditioning in float32."""
    learn_eps_m: bool = True
    """Take eps_m as a start and learn a factor on it, one a stage."""
    eps_kx: Scale = 1e-3
    """Stiffness added to the diagonal of K_x: N/m for translation, N.m/rad for rotation. It bounds the conditioning."""
    eps_jq: Scale = 1e-3
    """Regularisation of J_q in the "inverse" form of dq0, m/rad."""
    dq0: Literal["statics", "inverse"] = "statics"
    """How pass 1 finds the joint deflection: "statics" (K^-1 B^T force) or "inverse" (of J_q, as in the paper; for
    branches of three joints alone)."""


MECHANICS = (MechanicsConfig(eps_kx=1e-2), MechanicsConfig())
"""Of stage 1 and stage 2. Stage 1 asks whether the tool stays, not how far it turns about a contact that lets it."""


def _pair(value: object) -> object:
    """One set of constants stands for both stages, a list of two in it for each; what is missing is the stage's own."""
    if isinstance(value, MechanicsConfig):
        return (value, value)
    if isinstance(value, Mapping):
        value = [{k: _of_stage(v, i) for k, v in value.items()} for i in range(len(MECHANICS))]
    if isinstance(value, list) and len(value) == len(MECHANICS) and all(isinstance(v, Mapping) for v in value):
        return [asdict(stage) | v for stage, v in zip(MECHANICS, value, strict=True)]
    return value


def _both(value: object) -> object:
    return (value, value) if type(value) is int else value


def _of_stage(value: object, stage: int) -> object:
    return value[stage] if isinstance(value, list) and len(value) == len(MECHANICS) else value


def _wrench_scale(value: tuple[float, ...]) -> tuple[float, ...]:
    if len(value) != N_WRENCH or min(value) <= 0:
        raise ValueError(f"must be {N_WRENCH} positive numbers")
    return value


@checked_dataclass(frozen=True, config=CHECKS)
class ModelConfig:
    """Sizes and constants of a cascade."""

    contact_width: Width = 16
    """Width of the contact summary."""
    width: Annotated[tuple[Width, Width], BeforeValidator(_both)] = (16, 32)
    """Width of the trunk of stage 1 and of stage 2; one number stands for both."""
    classifier_width: Width = 16
    """Width of the hidden layer of stage 1's classifier."""
    heads: Literal["correction", "free"] = "correction"
    """Zero head outputs give the hand's nominal springs and tendons, or ("free") the same springs for every hand."""
    heads_see_wrench: bool = True
    """Springs and tendons may depend on the load, not on the grasp alone."""
    soft_finger: Annotated[bool | None, _own] = None
    """Contacts resist twisting about their normals, or "hand": where the hand has soft fingertips."""
    told: Annotated[bool | None, _of_data] = None
    """Networks see the factors of theta, or "data": where the training data vary them. The layer follows them."""
    sensors: Annotated[bool | None, _of_data] = None
    """Networks see friction, the tool's weight and tendon tensions where they are known, or "data": where the training
    data can tell all of them, as simulated ones do. One model is right with any of them, and with none."""
    friction: Literal["none", "secant"] = "secant"
    """Contacts hold whatever they carry ("none", the paper's layer), or slide where friction is used up ("secant")."""
    motion_limits: tuple[Scale, Scale] = (0.010, 0.35)
    """Motions are cut to these bounds where contacts slide, m and rad: those of a grasp that holds."""
    log_range: Annotated[float, Field(gt=0, le=20)] = 2.0
    """Cholesky diagonals, gains and alpha stay within exp(+-log_range) of their nominal values, twist within twice."""
    wrench_log_scale: Annotated[tuple[float, ...], AfterValidator(_wrench_scale)] = (0.1, 0.1, 0.1, 0.005, 0.005, 0.005)
    """Where the signed logarithm of the wrench turns from linear to logarithmic: N and N.m."""
    displacement_log_scale: Scale = 1e-3
    """The same for the displacement that stage 1's classifier sees, m (rotations times 0.1 m)."""
    gate_nominal: tuple[float, float, float] = (20.0, 0.05, 2.0)
    """alpha (1/rad), scale of beta (rad) and rho of an untrained gate: taut under pretension."""
    mechanics: Annotated[tuple[MechanicsConfig, MechanicsConfig], BeforeValidator(_pair)] = MECHANICS
    """The layer's constants for stage 1 and stage 2; one table stands for both, a list of two is one for each."""

    def twists(self, hand: Hand) -> bool:
        """Whether contacts of this hand resist twisting about their normals."""
        return hand.contact.kind == "soft_finger" if self.soft_finger is None else self.soft_finger

    def dims(self, hand: Hand) -> Dims:
        """Counts of a model of this hand: with the factors of theta and the sensors that its networks see."""
        factors, sensing = Theta(hand).factors if self.told else 0, hand.dims.sensed if self.sensors else 0
        return replace(hand.dims, factors=factors, sensing=sensing, slides=self.friction != "none")


@checked_dataclass(frozen=True, config=CHECKS)
class LossWeights:
    """Weights of the stage 2 loss."""

    translation: Weight = 1.0
    """On |dp error| / 0.1 m."""
    rotation: Weight = 1.0
    """On the geodesic angle, rad."""
    relative: Scale = 0.02
    """Pose size above which an error counts by its share of the motion rather than by its size; 1e9: never."""
    power: Annotated[float, Field(ge=1, le=2)] = 1.0
    """Exponent of the error: 1 trains on its norm, 2 on its square."""
    gate: Weight = 1e-4
    """On mean g (1 - g): gates that are open or shut."""
    engagement: Weight = 1e-3
    """On the cross-entropy between gates and the simulated tendons, taut or slack."""
    tendon: Weight = 1e-5
    """On mean K_tendon^2, (N.m/rad)^2: no more tendon stiffness than the data asks for."""


@checked_dataclass(frozen=True, config=CHECKS)
class SensorDraws:
    """What is known of a training sample in a model with sensors, drawn again each time that it is shown."""

    friction: Share = 0.6
    """Share of samples whose friction is told."""
    friction_class: Share = 0.5
    """Share of these that are told a class alone: low, mid or high."""
    friction_deviation: Share = 0.3
    """Largest standard deviation of the others, as a share of the coefficient; it is told too. Most have much less."""
    weight: Share = 0.5
    """Share of samples whose tool's weight is told."""
    weight_noise_N: Weight = 0.05
    """Largest standard deviation of each of its components."""
    tension: Share = 0.3
    """Share of samples whose tendon tensions are told."""
    tension_noise: Share = 0.02
    """Their standard deviation, as a share."""


@checked_dataclass(frozen=True, config=CHECKS)
class TrainConfig:
    """One training run."""

    kind: Kind = "aminn"
    """The model: the analytical-model-informed network or the black box of the same size."""
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    """Initial weights and order of the samples."""
    epochs: Annotated[int, Field(gt=0, le=1_000_000)] = 60
    """Passes over the data, for each stage."""
    batch: Annotated[int, Field(gt=0, le=2**31 - 1)] = 256
    """Samples a step."""
    learning_rate: Scale = 8e-3
    """Peak of the schedule: linear warm-up over the first 5 % of the steps, then a cosine to zero."""
    weight_decay: Weight = 0.1
    """AdamW's."""
    gradient_clip: Scale = 1.0
    """Largest norm of a step's gradient."""
    divergence: Annotated[float, Field(gt=1)] = 1e3
    """A step whose loss is so many times that of the stage's first step ends the run as diverged."""
    mirror: Annotated[bool | None, _own] = None
    """Show each training sample as its mirror image half of the time, or "hand": where the hand is symmetric."""
    train_fraction: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the training grasps to learn from, for learning curves; smaller shares are part of larger ones."""
    loss: LossWeights = field(default_factory=LossWeights)
    """Weights of the stage 2 loss."""
    sensing: SensorDraws = field(default_factory=SensorDraws)
    """What is known of training samples, in a model with sensors."""
    model: ModelConfig = field(default_factory=ModelConfig)
    """Sizes and constants of the network and its mechanics layer."""


def build_config(cls: type, values: Mapping[str, Any], source: str = "configuration") -> Any:
    """A configuration from plain values. Raises AminnError with the key, what is wrong, and what may stand there."""
    try:
        return TypeAdapter(cls).validate_python(values)
    except ValidationError as error:
        found = dict.fromkeys(map(_complaint, error.errors()))  # a pair of stages complains twice
        raise AminnError(f"{source}: " + "; ".join(found)) from None


def _complaint(error: Any) -> str:
    """One of pydantic's findings as a sentence; a pair of stages has one place in the name."""
    place = ".".join(str(part) for part in error["loc"] if not isinstance(part, int))
    if error["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        known = [key for key, *_ in _walk(TrainConfig())]
        near = get_close_matches(place, known, 1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
        return f"{place} is no setting; {hint}"
    return f"{place}: {error['msg'][0].lower()}{error['msg'][1:]}, not {error['input']!r}"


def put_setting(values: dict, key: str, value: object) -> None:
    """Put `value` at a dotted key of nested dictionaries. Raises AminnError where a table of it is a single value."""
    *tables, name = key.split(".")
    for table in tables:
        values = values.setdefault(table, {})
        if not isinstance(values, dict):
            raise AminnError(f"{key}: {table} is a single value, not a table")
    values[name] = value


def _parsed(text: str) -> object:
    """A value as TOML writes it; anything else is taken as a string, so that names need no quotes."""
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except ValueError:  # TOMLDecodeError is one, a number of too many digits another
        return text


def load_config(file: AnyPath | None = None, overrides: Sequence[str] = (), **given: object) -> TrainConfig:
    """Defaults, then the TOML `file`, then `given` fields that are not None, then "key=value" `overrides`."""
    values: dict = {}
    if file is not None:
        values = read_toml(file)
    values |= {key: value for key, value in given.items() if value is not None}
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals or not key:
            raise AminnError(f"--set {override}: expected key=value, as in loss.relative=0.05")
        put_setting(values, key.strip(), _parsed(text.strip()))
    return build_config(TrainConfig, values, str(file) if file and not overrides else "configuration")


def _walk(config: Any, prefix: str = "") -> Iterator[tuple[str, Any, str]]:
    """(dotted key, value, description) of every setting; where the stages differ, a list of both values."""
    described = type(config).__pydantic_fields__
    for f in fields(config):
        value = getattr(config, f.name)
        if f.name == "mechanics":
            for both in zip(*(_walk(stage, f"{prefix}{f.name}.") for stage in value), strict=True):
                (key, first, text), (_, second, _) = both
                yield key, first if first == second else [first, second], text
        elif is_dataclass(value):
            yield from _walk(value, f"{prefix}{f.name}.")
        else:
            yield prefix + f.name, value, described[f.name].description or ""


def _written(key: str, value: object) -> object:
    """A value as a file has it: TOML has no null."""
    if isinstance(value, list):
        return [_written(key, v) for v in value]
    return (OF_DATA if key in ("model.told", "model.sensors") else OF_HAND) if value is None else value


def as_toml(config: TrainConfig) -> str:
    """The configuration as a TOML file with each setting's description above it."""
    lines: list[str] = []
    table = ""
    for key, value, text in sorted(_walk(config), key=lambda item: item[0].count(".")):
        head, _, name = key.rpartition(".")
        if head != table:
            lines += [f"[{head}]"]
            table = head
        lines += [f"# {' '.join(text.split())}", f"{name} = {json.dumps(_written(key, value))}", ""]
    return "\n".join(lines)
