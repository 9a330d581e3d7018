"""The hand file: 15 to 30 lines of TOML beside an unedited MJCF, for what the model does not say.

Only `name` and `model` must be there; everything else is derived from the model unless it is told here.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

from aminn_base.errors import AminnError
from aminn_base.read import complaint, is_file, read_toml

Vector3 = Annotated[tuple[float, float, float], Field()]
Posture = dict[str, float]
"""Joint name to angle, rad; joints that are left out stand at 0."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class BranchTable(_Table):
    """One finger or thumb."""

    name: str
    tip: str
    """Body that touches the tool."""
    point: Vector3 | None = None
    """Pad point in the tip body's frame, m."""
    geoms: tuple[str, ...] = ()
    """Geoms that are the fingertip; default: every colliding geom of the tip body and of what is fixed to it."""
    group: str | None = None
    """Branches of one group face those of the others."""


class ClosingTable(_Table):
    """How the hand closes."""

    open: Posture
    closed: Posture


class StiffnessTable(_Table):
    """What the model does not say of its springs."""

    servo_Nm_rad: dict[str, PositiveFloat] = {}
    """Position stiffness of joints that torque motors drive, by joint name, or `default` for all of them."""
    pull_only: tuple[str, ...] = ()
    """Tendons that are cables; * stands for any text."""
    friction: Literal["keep", "drop"] | None = None
    """Dry friction of joints and tendons: simulated as it is, or left out. A stiffness model does not know it."""


class CouplingTable(_Table):
    """A coupling that firmware or a linkage makes and the model lacks: angle of `joint` = ratio times that of `of`."""

    joint: str
    of: str
    ratio: float = 1.0


Compliance = Annotated[float, Field(gt=0, le=0.01)]
"""m/N; 10 mm give way under 1 N is more than any fingertip does."""


class ContactTable(_Table):
    """How the fingertips touch."""

    model: Literal["point", "soft_finger"] = "point"
    """`point`: a contact passes on a force. `soft_finger`: and a moment about its normal."""
    torsional_friction_m: Annotated[float, Field(gt=0, le=0.1)] = 0.003
    """Of soft fingers: greatest moment over normal force."""
    compliance_m_N: Compliance | dict[str, Compliance] | None = None
    """Nominal give of a contact along its normal, of all branches or by branch; default: the engine's own."""


class SynergyAxisTable(_Table):
    """One axis of the synergy space."""

    name: str
    column: tuple[float, ...]
    """Of A, a number for each joint in the order of the branches."""
    delta: PositiveFloat
    """1/rad."""
    range: tuple[float, float]
    """Of psi that is sampled."""


class SynergyTable(_Table):
    """Synergy space psi = ((q - o) A) * delta that postures are drawn from; default: from [closing]."""

    neutral_rad: tuple[float, ...]
    """o, a number for each joint in the order of the branches."""
    axes: Annotated[tuple[SynergyAxisTable, ...], Field(min_length=1, max_length=3)]


class MirrorTable(_Table):
    """A plane through the palm frame's origin that carries the hand onto itself; default: found, if there is one."""

    normal: Vector3


class HandFile(_Table):
    """A checked hand file."""

    name: str
    model: str
    """MJCF, relative to the hand file, or `package:NAME/PATH` within an installed Python package."""
    palm: str | None = None
    """Body whose frame is H; default: the deepest body that all moving branches share."""
    palm_normal: Vector3 | None = None
    """Which way the palm faces, in its frame; default: from the palm to the middle of the fingertips."""
    locked: tuple[str, ...] = ()
    """Joints that do not move. Those above the palm never do."""
    branch: tuple[BranchTable, ...] = ()
    """Default: every chain that ends in a colliding geom."""
    closing: ClosingTable | None = None
    stiffness: StiffnessTable = StiffnessTable()
    coupling: tuple[CouplingTable, ...] = ()
    tool_axis: Vector3 | None = None
    """Which way the long axis of a tool lies, in the palm's frame; default: along the wider group of fingertips."""
    length_m: Annotated[float, Field(ge=0.005, le=2)] = 0.1
    """Characteristic length: what a rotation of 1 rad counts as."""
    contact: ContactTable = ContactTable()
    synergy: SynergyTable | None = None
    mirror: MirrorTable | None = None


def read_hand_file(path: Path | str, content: bytes | None = None) -> HandFile:
    """Read and check a hand file, or what its `content` was. Raises AminnError with file and field."""
    path = Path(path)
    try:
        table = read_toml(path, content)
    except AminnError as error:
        raise AminnError(f"{error}: a hand file is a TOML file beside its model") from error
    try:
        return HandFile.model_validate(table)
    except ValidationError as error:
        raise AminnError(f"{path}: {complaint(error.errors()[0], HandFile.model_fields, 'a hand file')}") from error


def model_path(file: HandFile, path: Path | str) -> Path:
    """Where the model of a hand file at `path` is. Raises AminnError where it is not."""
    if file.model.startswith("package:"):
        package, _, inside = file.model.removeprefix("package:").partition("/")
        try:
            found = importlib.util.find_spec(package) if package.isidentifier() else None  # "a.b" would import a
        except (ImportError, ValueError):
            found = None
        if found is None or not found.submodule_search_locations:
            raise AminnError(
                f"{path}: model {file.model}: no installed Python package with files is called {package!r}"
            )
        model = Path(next(iter(found.submodule_search_locations))) / inside
    else:
        model = Path(path).parent / file.model
    if not is_file(model):
        raise AminnError(f"{path}: model names {model}, which is no file")
    return model.resolve()
