"""What `aminn_calibrate_push()` computes, in float64 and by plain algebra: the oracle of the runtime.

It forms and inverts K_x, where the runtime goes by square roots; the rest is the same recursion, step by step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aminn_hand.hand import STATE

from ..files.tables import Exported, pair_of
from .adversarial import closure
from .friction import NOTHING, UNKNOWN, Statics, combined, evidence, learned
from .reference import Array, Reference

LEARNED, DOUBTED, SLIPPED, WORSE = 1, 2, 3, 4
"""What became of a push: AMINN_PUSH_..."""
DOUBTFUL, SLIP = 12.0, 400.0
LEAST_VARIANCE = 1e-6
SAME_JOINT_RAD, SAME_TOOL_M = 0.02, 0.002


@dataclass(frozen=True)
class Settings:
    """As `aminn_calibrator_settings_t`; the defaults are those of `aminn_calibrator_defaults`."""

    prior: float = 0.5
    noise_m: float = 5e-5
    model_share: float = 0.08
    step: float = 0.5
    bound: float = 1.5
    memory: float = 1.0


class Recursion:
    """A calibrator of an exported model."""

    def __init__(self, exported: Exported, theta: NDArray | None = None, settings: Settings | None = None) -> None:
        self.exported, self.model = exported, Reference(exported)
        self.settings = settings or Settings()
        joints = int(self.model.t["coord_mask"].sum())
        self.theta = np.zeros(self.model.factors + joints + 1) if theta is None else np.array(theta, float)
        self.covariance = np.eye(self.model.factors) * self.settings.prior**2
        self.likelihoods = NOTHING
        """Of the friction of the present grasp."""
        self._grasp: Array | None = None
        self._in_grasp = 0

    @property
    def sd(self) -> Array:
        """(F) standard deviation of each logarithm."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def friction(self, sensor: NDArray = UNKNOWN) -> Array:
        """`friction` (3) of the present grasp with what a sensor says, as `aminn_calibrator_friction()`."""
        return combined(self.likelihoods, np.asarray(sensor, float))

    def corrected(self, state: Mapping[str, NDArray]) -> dict[str, Array]:
        """Inputs of the model (1, ...) of a measured state q (J), x_ht (6), w_e (6), contacts (B, 8)."""
        x = {name: np.asarray(state[name], float)[None] for name in STATE}
        x["q"] = x["q"] + self.theta[self.model.factors : -1]
        x["contacts"] = x["contacts"].copy()
        x["contacts"][..., 1:4] += self.theta[-1] * x["contacts"][..., 4:7]
        x["j_x"], x["j_q"] = closure(x["q"], x["x_ht"], x["contacts"], self.exported)
        return x

    def motion(self, x: dict[str, Array], theta: Array) -> dict[str, Array]:
        """What stage 2 predicts, without the batch: by the names of `aminn_debug.onnx`."""
        return {name: value[0] for name, value in self.model(x | {"theta": theta[None]}).items()}

    def slopes(self, x: dict[str, Array]) -> Array:
        """(6, F) how the scaled motion (m) changes with each logarithm, what the networks say being held."""
        m, s, out = self.model, self.model.s, self.motion(x, self.theta)
        varied = m.varied(x | {"theta": self.theta[None]})
        inverse = np.linalg.inv(out["s2_k_x"] * s[:, None] * s)
        dx, slopes = out["s2_dx"] / s, np.zeros((6, m.factors))
        rows = [*range(m.c), *(i for i in range(m.c) for _ in range(i))]
        cols = [*range(m.c), *(j for i in range(m.c) for j in range(i))]
        for b in range(m.b):
            flag, eps = x["contacts"][0, b, 0], m.eps_m[1][b] * varied["softer"][0, b]
            a, b_t = x["j_x"][0, b] * s, -x["j_q"][0, b].T
            d, taut = out["s2_tendon_dir"][b], out["s2_tendon_gain"][b] * out["s2_gate"][b]
            k = out["s2_k_spring"][b] + taut * np.outer(d, d)
            c_bt = np.linalg.solve(k, b_t)  # (C, 3)
            n = x["contacts"][0, b, 4:7]
            soft = b_t.T @ c_bt + eps * np.eye(3) + out["s2_slide"][b] * (np.eye(3) - np.outer(n, n))
            wa = np.linalg.solve(soft, a)  # (3, 6)
            force, out_by = wa @ dx, flag * inverse @ wa.T  # (3), (6, 3)
            slopes[:, m.stiff + b] = out_by @ (eps * force)
            nominal = np.zeros((m.c, m.c))
            nominal[rows, cols] = varied["chol"][0, b]
            change = np.linalg.cholesky(out["s2_k_spring"][b]) @ np.linalg.inv(nominal)
            for p, term in enumerate(m.t["theta_terms"][1:, b] * np.exp(self.theta[: m.stiff, None])):
                added = np.zeros((m.c, m.c))
                added[rows, cols] = added[cols, rows] = term[:-1]
                d_k = change @ added @ change.T
                if term[-1]:
                    d_k = d_k + taut * term[-1] / varied["tendon_gain"][0, b] * np.outer(d, d)
                slopes[:, p] -= out_by @ c_bt.T @ d_k @ c_bt @ force
            twist = self._twist(x)[b] * flag
            normal = np.concatenate([np.zeros(3), x["contacts"][0, b, 4:7]]) * s
            slopes[:, m.stiff + b] += twist * inverse @ normal * (normal @ dx)
        return slopes

    def _twist(self, x: dict[str, Array]) -> Array:
        """(B) stiffness of the contacts about their normals."""
        whole = self.model.whole(x | {"theta": self.theta[None]})
        return np.asarray(self.model.springs("s2", self.model.features("s2", whole), whole)["twist"][0])

    def _absorbed(self, slopes: Array, error: Array, variance: float) -> tuple[Array, Array, float]:
        """Covariance and change of the logarithms, and the sum of the normalised squares."""
        s = self.settings
        p = s.memory * self.covariance + (1 - s.memory) * s.prior**2 * np.eye(len(self.covariance))
        change, squares = np.zeros(len(p)), 0.0
        for h, e in zip(slopes, error, strict=True):
            spread = p @ h
            size, surprise = h @ spread + variance, e - h @ change
            squares += surprise**2 / size
            change = change + spread * surprise / size
            p = p - np.outer(spread, spread) / size
            p[np.diag_indices(len(p))] = np.maximum(np.diag(p), LEAST_VARIANCE)
        return p, change, squares

    def _count(self, state: Mapping[str, NDArray]) -> None:
        """How many pushes of the present grasp there were."""
        now = np.concatenate([np.asarray(state["q"], float), np.asarray(state["x_ht"], float) / self.model.s])
        most = np.array([SAME_JOINT_RAD] * (len(now) - 6) + [SAME_TOOL_M] * 6)
        new = self._grasp is None or bool((np.abs(now - self._grasp) > most).any())
        self._grasp, self._in_grasp = (now, 1) if new else (self._grasp, self._in_grasp + 1)

    def _narrow(self, x: dict[str, Array], dx_ht: Array) -> None:
        """Learn friction from what moved the tool by dx_ht (6)."""
        stage = {k.removeprefix("s2_"): v for k, v in self.motion(x, self.theta).items() if k.startswith("s2_")}
        meta, softer = self.model.meta, self.model.varied(x | {"theta": self.theta[None]})["softer"][0]
        limits = float(meta["max_translation"]), float(meta["max_rotation"])
        length_m, eps_kx = 1 / float(self.model.s[-1]), pair_of(meta["eps_kx"])[1]
        statics = Statics(self.model.eps_m[1] * softer, eps_kx, self._twist(x), length_m, limits)
        self.likelihoods = learned(self.likelihoods, evidence(stage, {k: v[0] for k, v in x.items()}, dx_ht, statics))

    def push(self, state: Mapping[str, NDArray], dx_ht: NDArray, sensors: Mapping[str, NDArray] | None = None) -> int:
        """Learn from a measured state and displacement (6), with what is known (`Dims.sensors`); what became of it.

        Friction is learned where `sensors` are given, and contacts can slide.
        """
        s, x = self.settings, self.corrected(state)
        x |= {name: np.asarray(value, float)[None] for name, value in (sensors or {}).items()}
        measured = np.asarray(dx_ht, float) / self.model.s
        self._count(state)
        if self._in_grasp == 1:
            self.likelihoods = NOTHING
        if sensors is not None and self.exported.meta["slides"]:
            self._narrow(x, np.asarray(dx_ht, float))
        error = measured - self.motion(x, self.theta)["s2_dx"] / self.model.s
        moved = min(measured @ measured, (measured - error) @ (measured - error))
        variance = self._in_grasp * (s.noise_m**2 + s.model_share**2 * moved)
        slopes = self.slopes(x)
        covariance, change, squares = self._absorbed(slopes, error, variance)
        if squares > SLIP:
            return SLIPPED
        if squares > DOUBTFUL:
            covariance, change, _ = self._absorbed(slopes, error, variance * squares / DOUBTFUL)
        share = min(1.0, s.step / max(float(np.abs(change).max()), 1e-30))
        theta = self.theta.copy()
        theta[: len(change)] = np.clip(theta[: len(change)] + share * change, -s.bound, s.bound)
        after = measured - self.motion(x, theta)["s2_dx"] / self.model.s
        if after @ after > error @ error:
            return WORSE
        self.theta = theta
        if share == 1.0:
            self.covariance = covariance
        return DOUBTED if squares > DOUBTFUL else LEARNED
