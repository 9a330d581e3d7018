"""What a simulated data set is made of. The same configuration gives the same bytes, on any number of threads."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from . import _core
from .errors import SimulationError

TOOL_FAMILIES: tuple[str, ...] = _core.TOOL_FAMILIES


@dataclass(frozen=True)
class SimulationConfig:
    """Every number that decides what is simulated. Raises SimulationError where one is out of range."""

    grasps: int = 320
    """Grasps in the data set. Raising it later keeps the shards that are already there."""
    cases: int = 16
    """Load cases a grasp."""
    seed: int = 0
    """Seed of the whole data set, 0 to 2^64 - 1; each grasp draws from its own stream of (seed, shard, grasp)."""
    shard_grasps: int = 32
    """Grasps a shard file; the last shard may hold fewer."""
    families: tuple[str, ...] = TOOL_FAMILIES
    """Tool families to draw from: handle (capsule), block (box), ball (sphere)."""

    mass_min_kg: float = 0.02
    """Lightest tool; log-uniform up to `mass_max_kg`."""
    mass_max_kg: float = 0.2
    """Heaviest tool."""
    friction_min: float = 0.4
    """Least Coulomb friction between tool and fingertip; uniform up to `friction_max`."""
    friction_max: float = 1.0
    """Greatest Coulomb friction."""
    pinch_force_min_N: float = 3.0
    """Least force of the thumb on the tool; log-uniform up to `pinch_force_max_N`. The fingers share the reaction."""
    pinch_force_max_N: float = 9.0
    """Greatest force of the thumb."""

    close_s: float = 0.30
    """Time in which the tendons reach their tension while the tool is held."""
    dwell_s: float = 0.10
    """Time at full tension before the tool is let go."""
    release_s: float = 0.15
    """Time in which the hold on the tool fades; the tendons' commands stand still from here on."""
    grasp_settle_max_s: float = 1.0
    """Longest time a released grasp may take to come to rest."""
    grasp_drift_max_m_s: float = 2e-5
    """Speed of the tool in the hand (rotation times 0.1 m added) below which a grasp is at rest."""
    grasp_shift_max_m: float = 0.012
    """Grasps whose tool moved further than this from where it was put are drawn again."""
    grasp_tilt_max_rad: float = 0.35
    """The same for rotation."""
    contact_force_min_N: float = 0.5
    """Grasps with a weaker contact are drawn again."""
    grasp_attempts: int = 200
    """Draws for one grasp before the simulation gives up."""

    force_max_N: float = 18.0
    """Greatest load force."""
    moment_max_Nm: float = 0.35
    """Greatest load moment."""
    load_decades: float = 2.0
    """Force and moment are log-uniform over this many decades below their greatest value."""
    share_force_only: float = 0.35
    """Share of load cases without a moment."""
    share_moment_only: float = 0.20
    """Share of load cases without a force; the rest have both."""

    ramp_s: float = 0.20
    """Time in which the load rises."""
    hold_s: float = 0.25
    """Time at full load before the tool's speed is judged."""
    hold_extra_s: float = 0.40
    """Further time for a tool that is still moving then."""
    drift_window_s: float = 0.05
    """Time over which a speed is taken."""
    drift_max_m_s: float = 1e-4
    """Speed of the tool (rotation times 0.1 m added) below which a load case has settled."""
    lost_contact_s: float = 0.02
    """A contact that is open for longer is lost."""
    translation_max_m: float = 0.010
    """Bound on the tool's translation in the hand at any time."""
    rotation_max_rad: float = 0.35
    """Bound on the tool's rotation in the hand at any time."""
    stop_factor: float = 2.0
    """A case stops where it passes a bound by this factor; up to there a bound can be raised without simulating."""
    tool_left_m: float = 0.05
    """A tool that moved further, or that no fingertip touches any more, has left the hand."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "families", tuple(self.families))
        self._check_numbers()
        self._check_ranges()

    def _check_numbers(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "families":
                continue
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise SimulationError(f"configuration: {field.name} is {value!r}, expected a finite number")
            if field.type == "int" and not isinstance(value, int):
                raise SimulationError(f"configuration: {field.name} is {value!r}, expected an integer")
            if field.name == "seed" and not 0 <= value < 2**64:
                raise SimulationError(f"configuration: seed is {value}, expected 0 to 2^64 - 1")
            if field.name not in ("seed", "share_force_only", "share_moment_only") and value <= 0:
                raise SimulationError(f"configuration: {field.name} is {value}, expected more than 0")

    def _check_ranges(self) -> None:
        unknown = [f for f in self.families if f not in TOOL_FAMILIES]
        if unknown or not self.families:
            raise SimulationError(
                f"configuration: families are {list(self.families)}, expected some of {', '.join(TOOL_FAMILIES)}"
            )
        if len(set(self.families)) != len(self.families):
            raise SimulationError(f"configuration: families {list(self.families)} names one twice")
        for low, high in (
            ("mass_min_kg", "mass_max_kg"),
            ("friction_min", "friction_max"),
            ("pinch_force_min_N", "pinch_force_max_N"),
        ):
            if getattr(self, low) > getattr(self, high):
                raise SimulationError(
                    f"configuration: {low} {getattr(self, low)} is above {high} {getattr(self, high)}"
                )
        shares = (self.share_force_only, self.share_moment_only)
        if min(shares) < 0 or sum(shares) > 1:
            raise SimulationError(
                f"configuration: share_force_only {shares[0]} and share_moment_only {shares[1]} must be 0 or more "
                "and at most 1 together"
            )
        if self.drift_window_s > self.hold_s:
            raise SimulationError(
                f"configuration: drift_window_s {self.drift_window_s} is longer than hold_s {self.hold_s}"
            )
        if self.stop_factor < 1:
            raise SimulationError(f"configuration: stop_factor is {self.stop_factor}, expected 1 or more")

    def options(self) -> _core.Options:
        """The compiled part's view of this configuration."""
        options = _core.Options()
        for name in _core.OPTION_NAMES:
            setattr(options, name, getattr(self, name))
        return options

    def family_indices(self) -> list[int]:
        """Indices of `families` in `TOOL_FAMILIES`, in the order given."""
        return [TOOL_FAMILIES.index(name) for name in self.families]
