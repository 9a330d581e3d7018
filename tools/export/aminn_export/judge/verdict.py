"""Results of a replay judged: against a reference within `tolerances`, or against other results bit by bit.

`runtime/tools/comparison.c` does the same for those who have no Python; a test holds the two together. A number that is
not finite where it must be is a failure whatever stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aminn.evaluation.metrics import holds
from aminn_base.errors import AminnError
from aminn_hand.hand import OUTPUTS

from ..samples.vectors import Results
from .tolerances import CONDITION_MAX, MEDIAN_MIN_SAMPLES, TOLERANCES

Array = NDArray[np.float64]
Figures = dict[str, float | int | bool | str]


@dataclass(frozen=True)
class Failure:
    """One number that is not what it must be."""

    target: str
    """Whose results these are."""
    output: str
    """With its component: "dx_ht[3]", "k_x[2][4]"."""
    sample: int | None
    """None: it is of all samples (a median, their number)."""
    got: float
    want: float
    limit: float
    """How far apart they may be; 0 where the bits have to be the same."""
    share: float
    """The difference over the limit; infinite for NaN and for other bits."""
    where: str = ""
    """What the sample is called."""
    exact: bool = False
    """Bits were compared."""

    @property
    def kind(self) -> str:
        """The output without its component."""
        return self.output.split("[")[0]

    def record(self) -> dict[str, object]:
        """For JSON; what is no number there is text."""
        values = {"got": self.got, "want": self.want, "limit": self.limit}
        numbers: dict[str, object] = {k: v if np.isfinite(v) else str(v) for k, v in values.items()}
        named: dict[str, object] = {"target": self.target, "output": self.output}
        named |= {"sample": self.sample, "where": self.where}
        return named | numbers | {"exact": self.exact}

    def __str__(self) -> str:
        if self.output == "samples":
            return f"samples: got {self.got:.0f}, want {self.want:.0f}"
        if self.output == "model":
            return f"model: the reference is of content_crc {int(self.want):08x}, this model has {int(self.got):08x}"
        if self.sample is None:
            return f"{self.output}: median of difference over limit {self.got:.3g}, limit {self.limit:.3g}"
        limit = "bits differ" if self.exact else f"limit {self.limit:.3g}"
        place = self.where or f"sample {self.sample}"
        return f"{self.output} of {place}: got {self.got:.9g}, want {self.want:.9g}, {limit}"


@dataclass(frozen=True)
class Verdict:
    """What a comparison found."""

    figures: Figures
    failures: list[Failure]
    """Worst first."""
    judged: tuple[str, ...]
    """Kinds of output that were judged."""


Names = Callable[[int], str]


@dataclass(frozen=True)
class Bins:
    """Of p_slide, and the factor that bound_95 has in each."""

    edges: tuple[float, ...] = ()
    factors: tuple[float, ...] = (1.0,)

    @staticmethod
    def of(meta: Mapping[str, Any]) -> Bins:
        """Of an exported model."""
        return Bins(tuple(meta["bound_edge"]), tuple(meta["bound_factor"]))

    def factor(self, p_slide: NDArray) -> Array:
        """Of each p_slide (n)."""
        place = np.searchsorted(np.array(self.edges, np.float32), np.asarray(p_slide, np.float32), "right")
        return np.array(self.factors, np.float64)[place]


def component_name(output: str, component: int, shape: tuple[int, ...]) -> str:
    """Of a component, row-major: "k_x[2][4]"."""
    return output + "".join(f"[{i}]" for i in np.unravel_index(component, shape)) if shape else output


def worst_first(failures: Iterable[Failure]) -> list[Failure]:
    """By how far beyond their limits they are; equally bad ones by sample."""
    return sorted(failures, key=lambda f: (-f.share, -1 if f.sample is None else f.sample))


def _sound(difference: Array) -> Array:
    """Infinite where it is no number: NaN is larger than every limit, and stays so."""
    return np.where(np.isnan(difference), np.inf, difference)


def _share(difference: Array, limit: Array | float) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference == 0, 0.0, _sound(_sound(difference) / limit))


def known_condition(k_x: NDArray, length: float) -> Array:
    """Condition number (n) of stiffness matrices with lengths divided by `length`, as far as it is known."""
    scale = np.array([1.0] * 3 + [1 / length] * 3)
    scaled = np.asarray(k_x, np.float64) * scale[:, None] * scale
    finite = np.isfinite(scaled).all((1, 2))
    eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], scaled, np.eye(6)))
    low, high = eigenvalues[:, 0], eigenvalues[:, -1]
    known = finite & (low * CONDITION_MAX > high)
    return np.where(known, high / np.where(known, low, 1.0), CONDITION_MAX)


class _Within:
    """One comparison with a reference: limits, differences, and what is beyond."""

    def __init__(
        self,
        got: Results,
        want: dict[str, NDArray[np.float32]],
        tau: float,
        length: float,
        target: str,
        names: Names,
        bins: Bins,
    ) -> None:
        self.tau, self.target, self.names = np.float32(tau), target, names
        self.rows = np.flatnonzero(got.status == 0)
        n = len(self.rows)
        self.shapes = {k: np.shape(want[k])[1:] for k in OUTPUTS}
        self.got = {k: np.asarray(got.outputs[k][self.rows], np.float64).reshape(n, -1) for k in OUTPUTS}
        self.want = {k: np.asarray(want[k][self.rows], np.float64).reshape(n, -1) for k in OUTPUTS}
        self.stable = got.decision[self.rows]
        motion = np.array([1.0] * 3 + [length] * 3)
        self.scale = {
            "p_stable": np.ones(1),
            "dx_ht": motion,
            "k_x": (1 / motion[:, None] / motion).ravel(),
            "gate": np.ones(self.shapes["gate"]),
            "p_slide": np.ones(1),
            "bound_95": np.ones(1),
            "friction_use": np.ones(self.shapes["friction_use"]),
        }
        self.factor = [bins.factor(of["p_slide"][:, 0])[:, None] for of in (self.got, self.want)]
        self.size = np.linalg.norm(self.want["dx_ht"] * motion, axis=1)
        self.use = self.want["friction_use"].max(1, initial=0.0)
        self.condition = known_condition(self.want["k_x"].reshape(n, 6, 6), length)
        self.failures: list[Failure] = []
        self.shares: dict[str, Array] = {}

    def limit(self, output: str, of: Array) -> Array:
        """The limit of scaled differences, `of` (n) or (n, components) being what it is a share of."""
        t = TOLERANCES[output]
        relative = t.share + t.per_condition * self.condition + t.per_m * self.size + t.per_use * self.use
        return t.floor + of * (relative[:, None] if of.ndim == 2 else relative)

    def difference(self, output: str) -> Array:
        """Scaled (n, components); bounds over the factor of the bin that their own p_slide lies in."""
        got, want = self.got[output], self.want[output]
        if output == "bound_95":
            got, want = (v / factor for v, factor in zip((got, want), self.factor, strict=True))
        return _sound(np.abs(got - want) * self.scale[output])

    def fail(
        self, row: int | np.signedinteger, output: str, component: int, want: float, limit: float, share: float
    ) -> None:
        """Note that a component of one of the accepted samples is beyond its limit."""
        sample, got = int(self.rows[row]), self.got[output][row, component] if output in self.got else self.stable[row]
        name = component_name(output, component, self.shapes.get(output, ()))
        self.failures.append(
            Failure(self.target, name, sample, float(got), want, float(limit), float(share), self.names(sample))
        )

    def words(self, output: str, of: Array) -> Array:
        """Judge each component by itself; returns the scaled differences."""
        difference, limit = self.difference(output), self.limit(output, of)
        limit = np.broadcast_to(limit if limit.ndim == 2 else limit[:, None], difference.shape)
        share = _share(difference, limit)
        self.shares[output] = share.max(1)
        for row, c in np.argwhere(~(share <= 1)):
            want = float(self.want[output][row, c])
            self.fail(row, output, c, want, limit[row, c] / self.scale[output][c], share[row, c])
        return difference

    def motion(self) -> Array:
        """Judge dx_ht as a whole; returns relative differences. A failure names the component that is furthest off."""
        difference, limit = self.difference("dx_ht"), self.limit("dx_ht", self.size)
        total = np.sqrt((difference**2).sum(1))
        self.shares["dx_ht"] = _share(total, limit)
        for row in np.flatnonzero(~(self.shares["dx_ht"] <= 1)):
            c = int(np.argmax(difference[row]))
            scale, share = self.scale["dx_ht"][c], self.shares["dx_ht"][row]
            self.fail(row, "dx_ht", c, float(self.want["dx_ht"][row, c]), limit[row] / scale, share)
        return _share(total, self.size + TOLERANCES["dx_ht"].floor)

    def symmetry(self) -> None:
        """The runtime writes one triangle of K_x twice: both sides have the same bits."""
        k_x = self.got["k_x"].reshape(-1, 6, 6)
        same = (k_x == k_x.swapaxes(1, 2)) & (np.signbit(k_x) == np.signbit(k_x.swapaxes(1, 2)))
        for row, i, j in np.argwhere(np.triu(~(same | (np.isnan(k_x) & np.isnan(k_x.swapaxes(1, 2)))))):
            self.fail(row, "k_x", 6 * i + j, float(k_x[row, j, i]), 0.0, np.inf)

    def decision(self, limit: Array) -> int:
        """Judge `stable`; returns how many differ from the reference's.

        It is the reference's, except so close to tau that p_stable may lie on either side: then it is that of the
        result's own p_stable.
        """
        p, own = self.want["p_stable"][:, 0], self.got["p_stable"][:, 0]
        distance = np.abs(p - self.tau)
        close = distance <= limit
        want = np.where(close, holds(own, self.tau), holds(p, self.tau)).astype(float)
        for row in np.flatnonzero(~(self.stable == want)):
            share = np.inf if close[row] else float(_share(distance[row], limit[row]))
            self.fail(row, "stable", 0, want[row], 0.0, share)
        return int((~(self.stable == holds(p, self.tau))).sum())

    def medians(self) -> None:
        """Judge the medians, where there are enough samples."""
        for output, share in self.shares.items():
            limit = TOLERANCES[output].median
            if len(share) >= MEDIAN_MIN_SAMPLES and not (median := float(np.median(share))) <= limit:
                self.failures.append(Failure(self.target, output, None, median, 0.0, limit, median / limit))


def _largest(values: Array) -> float:
    return float(values.max(initial=0.0))


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _other_number(target: str, got: Results, want: int) -> Verdict | None:
    """The verdict on results that are not of as many samples."""
    if len(got.status) == want:
        return None
    failure = Failure(target, "samples", None, len(got.status), want, 0.0, np.inf)
    return Verdict({"samples": len(got.status)}, [failure], ("samples",))


def _check_hand(got: Mapping[str, NDArray], want: Mapping[str, NDArray]) -> None:
    """Raises AminnError where results are of a hand of another number of branches."""
    found, wanted = (np.shape(values["gate"])[1] for values in (got, want))
    if found != wanted:
        raise AminnError(f"compare: results of a hand of {found} branches, and a reference of one of {wanted}")


def compare_within(
    got: Results,
    want: dict[str, NDArray[np.float32]],
    tau: float,
    length: float,
    target: str = "",
    names: Names = lambda i: f"sample {i}",
    symmetric: bool = True,
    bins: Bins = Bins(),
) -> Verdict:
    """Judge results by a reference (arrays by name): every number of every sample, none before another.

    `tau`, `length` (length_scale, m) and `bins` are the model's. Samples that the runtime refused fail by their status.
    `symmetric`: k_x must be so to the bit, as the runtime promises and ONNX Runtime does not.
    """
    _check_hand(got.outputs, want)
    other = _other_number(target, got, len(want["p_stable"]))
    if other:
        return other
    w = _Within(got, want, tau, length, target, names, bins)
    steepness = {name: np.maximum(w.want[name] * (1 - w.want[name]), 0) for name in ("p_stable", "gate", "p_slide")}
    p_difference = w.words("p_stable", steepness["p_stable"][:, 0])
    decisions = w.decision(w.limit("p_stable", steepness["p_stable"][:, 0]))
    relative = w.motion()
    entry = np.abs(w.want["k_x"] * w.scale["k_x"]).max(1, initial=0.0)
    k_x = w.words("k_x", entry)
    if symmetric:
        w.symmetry()
    gate = w.words("gate", steepness["gate"])
    p_slide = w.words("p_slide", steepness["p_slide"])
    bound = np.maximum(w.want["bound_95"] / w.factor[1], 0)
    bound_difference = w.words("bound_95", bound)
    use = w.words("friction_use", np.maximum(w.want["friction_use"], 0))
    w.medians()
    for i in np.flatnonzero(got.status != 0):
        w.failures.append(Failure(target, "status", int(i), float(got.status[i]), 0.0, 0.0, np.inf, names(int(i))))
    figures: Figures = {
        "samples": len(got.status),
        "refused": int((got.status != 0).sum()),
        "dx_relative_max": _largest(relative),
        "dx_relative_p99": float(np.quantile(relative, 0.99, method="higher")) if len(relative) else 0.0,
        "dx_relative_median": _median(relative),
        "p_stable_abs_max": _largest(p_difference),
        "k_x_relative_max": _largest(_share(k_x, entry[:, None])),
        "gate_abs_max": _largest(gate),
        "p_slide_abs_max": _largest(p_slide),
        "bound_95_relative_max": _largest(_share(bound_difference, bound)),
        "friction_use_abs_max": _largest(use),
        "decisions_different": decisions,
    }
    for output, share in w.shares.items():
        name = output.removesuffix("_ht")
        figures |= {f"{name}_share_of_limit_max": _largest(share), f"{name}_share_of_limit_median": _median(share)}
    return Verdict(figures, worst_first(w.failures), ("status", "stable", *TOLERANCES))


def compare_bits(got: Results, want: Results, target: str = "", names: Names = lambda i: f"sample {i}") -> Verdict:
    """Judge results by others whose bits they must have."""
    _check_hand(got.outputs, want.outputs)
    other = _other_number(target, got, len(want.status))
    if other:
        return other
    n, failures, words = len(got.status), [], 0
    for output in (*OUTPUTS, "stable"):
        a, b = ((r.decision if output == "stable" else r.outputs[output]).reshape(n, -1) for r in (got, want))
        for i, c in np.argwhere(a.view(np.uint32) != b.view(np.uint32)):
            words += 1
            name = component_name(output, c, got.outputs[output].shape[1:] if output in got.outputs else ())
            values = (float(a[i, c]), float(b[i, c]))
            failures.append(Failure(target, name, int(i), *values, 0.0, np.inf, names(int(i)), exact=True))
    for i in np.flatnonzero(got.status != want.status):
        values = (float(got.status[i]), float(want.status[i]))
        failures.append(Failure(target, "status", int(i), *values, 0.0, np.inf, names(int(i)), exact=True))
    figures: Figures = {"samples": n, "refused": int((got.status != 0).sum()), "different_words": words}
    return Verdict(figures, worst_first(failures), ("status", "stable", *OUTPUTS))
