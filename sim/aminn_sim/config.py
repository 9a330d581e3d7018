"""What a simulated data set is made of. The same configuration gives the same bytes, on any number of threads."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from . import _core
from .errors import SimulationError
from .scene import LEAST_CONTACT_LOG

TOOL_FAMILIES: tuple[str, ...] = _core.TOOL_FAMILIES
RANGES: dict[str, tuple[float, float]] = {
    "grasps": (1, 2**32),  # points of the Sobol' sequence that grasps are placed by
    "cases": (1, 1_000_000),
    "seed": (0, 2**64 - 1),
    "shard_grasps": (1, 1_000_000),
    "vary_mechanics": (0, -LEAST_CONTACT_LOG),
    "grasps_per_hand": (1, 2**32),
    **_core.OPTION_RANGES,
}
"""Least and greatest value of every number of the configuration."""
SHARD_CASES_MAX = 1_000_000
"""Load cases of one shard, which is made in memory: about a gigabyte."""
SHARDS_MAX = 100_000


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
    """Tool families to draw from: cylinder, capsule, ellipsoid, screwdriver (grip with a round butt, and shaft)."""
    vary_mechanics: float = 0.0
    """Half range of the logarithms of factors on springs, servos, tendons and contact compliances, uniform."""
    grasps_per_hand: int = 1
    """So many grasps in a row are one hand's, with the same factors."""
    mechanics: Mapping[str, float] = field(default_factory=dict)
    """Logarithms of factors by parameter of the hand, those that `vary_mechanics` draws around; 0 where not named."""

    radius_min_m: float = 0.008
    """Least radius (half thickness between the fingers) of a tool; which one it gets follows from the posture."""
    radius_max_m: float = 0.025
    """Greatest radius."""
    mass_min_kg: float = 0.02
    """Lightest tool; log-uniform up to `mass_max_kg`."""
    mass_max_kg: float = 0.3
    """Heaviest tool."""
    friction_min: float = 0.4
    """Least Coulomb friction between tool and fingertip; uniform up to `friction_max`."""
    friction_max: float = 1.1
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
    grasp_settle_max_s: float = 2.0
    """Longest time a released grasp may take to come to rest."""
    grasp_drift_max_m_s: float = 2e-6
    """Speed of the tool in the hand (rotation times 0.1 m added) below which a grasp is at rest."""
    grasp_shift_max_m: float = 0.012
    """Grasps whose tool moved further than this from where it was put are drawn again."""
    grasp_tilt_max_rad: float = 0.35
    """The same for rotation."""
    contact_force_min_N: float = 0.5
    """Grasps with a weaker contact are drawn again."""
    grasp_attempts: int = 500
    """Draws for one grasp before the simulation gives up."""

    force_min_N: float = 0.1
    """Least load force; log-uniform up to `force_max_N`, direction uniform on the sphere."""
    force_max_N: float = 20.0
    """Greatest load force."""
    moment_min_Nm: float = 0.0025
    """Least load moment; log-uniform up to `moment_max_Nm`, direction uniform on the sphere."""
    moment_max_Nm: float = 0.5
    """Greatest load moment, that of a force at a point included."""
    share_force: float = 0.25
    """Share of load cases with a force at the tool frame's origin."""
    share_moment: float = 0.20
    """Share of load cases with a moment alone."""
    share_point_force: float = 0.30
    """Share of load cases with a force at a random point of the tool's surface; the rest have force and moment."""

    ramp_s: float = 0.20
    """Time in which the load rises."""
    hold_s: float = 0.15
    """Least time at full load."""
    hold_max_s: float = 2.0
    """Longest time at full load, for a tool that has not come to rest."""
    drift_window_s: float = 0.05
    """Time over which a speed is taken."""
    drift_stop_m_s: float = 1e-6
    """A case ends where the tool's speed (rotation times 0.1 m added) falls below this after `hold_s`."""
    drift_max_m_s: float = 2e-5
    """A tool that is still faster than this at the end has not settled."""
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
    noise_share: float = 0.02
    """Share of load cases that are simulated again at half the time step and at ten times impratio."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "families", tuple(self.families))
        if not isinstance(self.mechanics, Mapping):
            raise SimulationError(f"configuration: mechanics is {self.mechanics!r}, expected numbers by parameter")
        object.__setattr__(self, "mechanics", dict(sorted(self.mechanics.items())))
        self._check_numbers()
        self._check_ranges()

    def _check_numbers(self) -> None:
        for name, value in self.mechanics.items():
            if not _is_number(value) or not math.isfinite(value):
                raise SimulationError(f"configuration: mechanics.{name} is {value!r}, expected a finite number")
        for own in dataclasses.fields(self):
            value = getattr(self, own.name)
            if own.name in ("families", "mechanics"):
                continue
            if not _is_number(value):
                raise SimulationError(f"configuration: {own.name} is {value!r}, expected a finite number")
            if own.type == "int" and not isinstance(value, int):
                raise SimulationError(f"configuration: {own.name} is {value!r}, expected an integer")
            low, high = RANGES[own.name]
            if not low <= value <= high:
                raise SimulationError(f"configuration: {own.name} is {value}, expected {low:g} to {_text(high)}")

    def _check_ranges(self) -> None:
        unknown = [f for f in self.families if f not in TOOL_FAMILIES]
        if unknown or not self.families:
            raise SimulationError(
                f"configuration: families are {list(self.families)}, expected some of {', '.join(TOOL_FAMILIES)}"
            )
        if len(set(self.families)) != len(self.families):
            raise SimulationError(f"configuration: families {list(self.families)} names one twice")
        for low, high in (
            ("radius_min_m", "radius_max_m"),
            ("mass_min_kg", "mass_max_kg"),
            ("friction_min", "friction_max"),
            ("pinch_force_min_N", "pinch_force_max_N"),
            ("force_min_N", "force_max_N"),
            ("moment_min_Nm", "moment_max_Nm"),
            ("drift_stop_m_s", "drift_max_m_s"),
            ("hold_s", "hold_max_s"),
        ):
            if getattr(self, low) > getattr(self, high):
                raise SimulationError(
                    f"configuration: {low} {getattr(self, low)} is above {high} {getattr(self, high)}"
                )
        shares = {name: getattr(self, name) for name in ("share_force", "share_moment", "share_point_force")}
        if min(shares.values()) < 0 or sum(shares.values()) > 1:
            text = ", ".join(f"{name} {value}" for name, value in shares.items())
            raise SimulationError(f"configuration: {text} must be 0 or more and at most 1 together")
        if self.drift_window_s > self.hold_s:
            raise SimulationError(
                f"configuration: drift_window_s {self.drift_window_s} is longer than hold_s {self.hold_s}"
            )
        in_shard = min(self.grasps, self.shard_grasps) * self.cases
        if in_shard > SHARD_CASES_MAX:
            raise SimulationError(
                f"configuration: {self.cases} cases a grasp make shards of {in_shard} cases, the most is "
                f"{SHARD_CASES_MAX}; choose fewer cases, or fewer grasps a shard than {self.shard_grasps}"
            )
        if self.grasps > SHARDS_MAX * self.shard_grasps:
            raise SimulationError(
                f"configuration: {self.grasps} grasps make more than {SHARDS_MAX} shards of {self.shard_grasps}; "
                "choose fewer grasps or more of them a shard (shard_grasps)"
            )

    def options(self) -> _core.Options:
        """The compiled part's view of this configuration."""
        options = _core.Options()
        for name in _core.OPTION_RANGES:
            setattr(options, name, getattr(self, name))
        return options

    def family_indices(self) -> list[int]:
        """Indices of `families` in `TOOL_FAMILIES`, in the order given."""
        return [TOOL_FAMILIES.index(name) for name in self.families]


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == value


def _text(bound: float) -> str:
    """A bound as one reads it."""
    return "2^64 - 1" if bound == 2**64 - 1 else f"{bound:,}".replace(",", " ") if bound >= 1000 else f"{bound:g}"
