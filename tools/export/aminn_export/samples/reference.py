"""The model in float64 NumPy, written from its definition: the oracle that golden vectors and `verify` compare with.

It shares no code with the trainer, the ONNX graph or the runtime, and solves K_x the plain way, so that a mistake in
one of them shows as a difference. Shapes stand on their lines; N is the batch, B the branches, C the coordinates of
the longest one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import MAX_LOG_BOUND

from ..files.tables import STAGES, Exported, by_branch, pair_of

Array = NDArray[np.float64]


def _slog(v: Array, scale: Array | float) -> Array:
    return np.sign(v) * np.log(1 + np.abs(v) / scale)


def _sigmoid(v: Array) -> Array:
    return 0.5 * (1 + np.tanh(0.5 * v))


def _relu(v: Array) -> Array:
    return np.maximum(v, 0)


class Reference:
    """Evaluates an exported model's tables in float64."""

    def __init__(self, exported: Exported) -> None:
        self.meta = exported.meta
        self.t = {name: np.asarray(value, np.float64) for name, value in exported.tensors.items()}
        length = float(self.meta["length_scale"])
        self.s = np.array([1.0] * 3 + [1.0 / length] * 3)
        self.b, self.c = self.t["coord_mask"].shape
        self.has_tendon = self.t.get("tendon_gain_nom", np.zeros(self.b)) > 0
        """(B) Which branches have a gated tendon."""
        self.gated = "tendon_gain_nom" in self.t
        """Whether the hand has gates at all."""
        self.eps_m = by_branch(self.meta["eps_m"], self.b)
        self.stiff = len(self.t["theta_terms"]) - 1
        self.factors = self.stiff + self.b
        self.told = self.t["s1.global_mean"].size > self.t["coord_mask"].sum() + 18
        """Whether networks see the factors."""
        if self.meta["dq0"] == "inverse" and self.c != 3:
            raise AminnError(f"model: dq0 'inverse' is for hands of 3 coordinates a branch, not {self.c}")

    def varied(self, x: dict[str, Array]) -> dict[str, Array]:
        """What theta (N, P), if x has it, makes of the tables that it changes, and what networks are told of it.

        chol (N, B, K), tendon_gain (N, B), twist (N, B), softer (N, B): factor on eps_m, told (N, F); without theta 1
        for N.
        """
        nominal, c = self.t["chol_nom"], self.c
        found = dict(chol=nominal[None], tendon_gain=self.t.get("tendon_gain_nom", np.zeros(self.b))[None])
        theta = x["theta"][:, : self.factors] if "theta" in x else np.zeros((1, self.factors))
        factor = np.exp(theta)
        softer = factor[:, self.stiff :]
        if "theta" in x:
            rows = [*range(c), *(i for i in range(c) for _ in range(i))]
            cols = [*range(c), *(j for i in range(c) for j in range(i))]
            lower, added = np.zeros((self.b, c, c)), np.zeros((len(theta), self.b, c, c))
            lower[:, rows, cols] = nominal
            terms = np.einsum("np,pbk->nbk", factor[:, : self.stiff] - 1, self.t["theta_terms"][1:])
            added[..., rows, cols] = added[..., cols, rows] = terms[..., :-1]
            k = lower @ np.swapaxes(lower, -1, -2) + added
            found = dict(
                chol=np.asarray(np.linalg.cholesky(k)[..., rows, cols], float),
                tendon_gain=found["tendon_gain"] + terms[..., -1],
            )
        return found | dict(twist=self.t.get("twist_nom", np.zeros(self.b)) / softer, softer=softer, told=theta)

    def features(self, stage: str, x: dict[str, Array]) -> Array:
        """f (N, H)."""
        t = {k.removeprefix(stage + "."): v for k, v in self.t.items() if k.startswith(stage + ".")}
        c = x["contacts"][..., :1]  # (N, B, 1)
        j_q = x["j_q"].reshape(-1, self.b, 3 * self.c)
        u = np.concatenate([c, c * x["contacts"][..., 1:], c * j_q], -1)  # (N, B, 8 + 3 C)
        z_c = (u.reshape(len(u), self.b * (8 + 3 * self.c)) - t["contact_mean"]) * t["contact_inv_std"]
        w_log = _slog(x["w_e"], self.t["wrench_log_scale"])
        told = [np.broadcast_to(x["told"], (len(u), self.factors))] if self.told else []
        z_g = np.concatenate([x["q"], x["x_ht"], x["w_e"], w_log, *told], -1)  # (N, J + 18), (N, J + 18 + F)
        z_g = (z_g - t["global_mean"]) * t["global_inv_std"]
        h1 = _relu(z_c @ t["contact_w"].T + t["contact_b"])  # (N, HC)
        h2 = _relu(np.concatenate([h1, z_g], -1) @ t["trunk1_w"].T + t["trunk1_b"])  # (N, H)
        return _relu(h2 @ t["trunk2_w"].T + t["trunk2_b"])  # (N, H)

    def springs(self, stage: str, f: Array, x: dict[str, Array]) -> dict[str, Array]:
        """k_spring (N, B, C, C), tendon_dir (N, B, C), tendon_gain (N, B), gate_params (N, B, 3), twist (N, B)."""
        t, r, n_b, n_c = self.t, float(self.meta["log_range"]), self.b, self.c
        y = f @ t[f"{stage}.head_w"].T + t[f"{stage}.head_b"]
        y = y.reshape(len(y), n_b, y.shape[1] // n_b)
        nom, mask = x["chol"], t["coord_mask"]
        chol = np.zeros((len(y), n_b, n_c, n_c))
        for i in range(n_c):
            chol[..., i, i] = nom[..., i] * np.exp(r * np.tanh(y[..., i]) * mask[:, i])
        at = n_c
        for i in range(n_c):
            for j in range(i):
                size = np.sqrt(nom[..., i] * nom[..., j])
                chol[..., i, j] = (nom[..., at] + size * np.tanh(y[..., at])) * mask[:, i] * mask[:, j]
                at += 1
        k_spring = chol @ np.swapaxes(chol, -1, -2)
        twist = np.zeros((len(y), n_b))
        if "twist_nom" in t:  # the last of a branch's numbers
            twist = x["twist"] * np.exp(2 * r * np.tanh(y[..., -1]))
            y = y[..., :-1]
        found = dict(k_spring=k_spring, twist=twist)
        if not self.gated:
            none = dict(tendon_dir=(n_c,), tendon_gain=(), gate_params=(3,))
            return found | {k: np.zeros((len(y), n_b, *shape)) for k, shape in none.items()}
        gate_nom = t["gate_nom"]
        v = (t["tendon_dir_nom"] + y[..., at : at + n_c]) * mask * self.has_tendon[:, None]
        gain, alpha, beta, rho = np.moveaxis(y[..., at + n_c :], -1, 0)
        direction = v / np.sqrt((v * v).sum(-1, keepdims=True) + 1e-12)
        gain = x["tendon_gain"] * np.exp(r * np.tanh(gain))
        alpha = gate_nom[0] * np.exp(r * np.tanh(alpha))
        gate_params = np.stack([alpha, gate_nom[1] * beta, gate_nom[2] + rho], -1)
        return found | dict(tendon_dir=direction, tendon_gain=gain, gate_params=gate_params)

    def _pass(self, stage: int, k_q: Array, twist: Array, x: dict[str, Array]) -> tuple[Array, Array, Array]:
        """(K_x (N, 6, 6), dx (N, 6), dq by statics (N, B, C)) for joint stiffness k_q (N, B, C, C), twist (N, B)."""
        eps_m, eps_kx = (self.eps_m[stage] * x["softer"])[..., None, None], pair_of(self.meta["eps_kx"])[stage]
        b, contact = -x["j_q"], x["contacts"][..., 0]
        c_bt = np.linalg.solve(k_q, np.swapaxes(b, -1, -2))  # (N, B, C, 3)
        wa = np.linalg.solve(b @ c_bt + eps_m * np.eye(3), x["j_x"] * contact[..., None, None])  # (N, B, 3, 6)
        k_x = (np.swapaxes(x["j_x"], -1, -2) @ wa).sum(1) + eps_kx * np.eye(6)  # (N, 6, 6)
        normal = x["contacts"][..., 4:7]
        k_x[:, 3:, 3:] += np.einsum("nb,nbi,nbj->nij", contact * twist, normal, normal)
        s = self.s
        x_s = np.linalg.solve(k_x * s[:, None] * s, (x["w_e"] * s)[..., None])[..., 0]  # (N, 6)
        dx = x_s * s
        dq = c_bt @ (wa @ dx[:, None, :, None])
        return k_x, dx, dq[..., 0]

    def mechanics(self, stage: int, springs: dict[str, Array], x: dict[str, Array]) -> dict[str, Array]:
        """Both passes of a stage."""
        _, dx0, dq0 = self._pass(stage, springs["k_spring"], springs["twist"], x)
        if self.meta["dq0"] == "inverse":
            regular = x["j_q"] + pair_of(self.meta["eps_jq"])[stage] * np.eye(3)
            motion = x["j_x"] @ dx0[:, None, :, None]  # (N, B, 3, 1)
            dq0 = np.asarray(-np.linalg.solve(regular, motion)[..., 0], np.float64) * x["contacts"][..., :1]
        dq0 = dq0 * self.t["coord_mask"]
        d = springs["tendon_dir"]
        alpha, beta, rho = np.moveaxis(springs["gate_params"], -1, 0)
        gate = _sigmoid(alpha * ((dq0 * d).sum(-1) - beta) + rho) * self.has_tendon  # (N, B)
        k_tendon = (springs["tendon_gain"] * gate)[..., None, None] * d[..., :, None] * d[..., None, :]
        k_x, dx, _ = self._pass(stage, springs["k_spring"] + k_tendon, springs["twist"], x)
        return dict(dx0=dx0, dq0=dq0, gate=gate, k_x=k_x, dx=dx)

    def logit(self, f: Array, response: dict[str, Array]) -> Array:
        """Stage 1's logit (N)."""
        t, s = self.t, self.s
        diagonal = np.diagonal(response["k_x"], axis1=-2, axis2=-1) * s * s
        x_s = response["dx"] / s
        size = np.maximum(np.linalg.norm(x_s, axis=-1, keepdims=True), 1e-12)  # (N, 1)
        motion = x_s * np.log(1 + size / float(self.meta["displacement_log_scale"])) / size
        gates = [response["gate"]] if self.gated else []
        aux = np.concatenate([motion, np.log(diagonal), *gates], -1)  # (N, 12 + B); 12 without gates
        aux = (aux - t["s1.aux_mean"]) * t["s1.aux_inv_std"]
        aux[:, 6:] *= np.minimum(1, float(self.meta["length_scale"]) / size)
        hidden = _relu(np.concatenate([f, aux], -1) @ t["s1.cls1_w"].T + t["s1.cls1_b"])  # (N, HD)
        return (hidden @ t["s1.cls2_w"].T + t["s1.cls2_b"])[:, 0]

    def sure(self, f: Array, response: dict[str, Array]) -> dict[str, Array]:
        """p_slide (N) and bound_95 (N) of stage 2."""
        t = self.t
        size = np.linalg.norm(response["dx"] / self.s, axis=-1, keepdims=True)
        seen = np.log(1 + size / float(self.meta["displacement_log_scale"]))
        seen = (seen - t["s2.sure_mean"]) * t["s2.sure_inv_std"]
        found = np.concatenate([f, seen], -1) @ t["s2.sure_w"].T + t["s2.sure_b"]  # (N, 2)
        p_slide = _sigmoid(found[:, 0])
        passed = (p_slide[:, None] >= np.asarray(self.meta["bound_edge"])).sum(1)
        return dict(
            p_slide=p_slide,
            bound_95=np.exp(np.minimum(found[:, 1], MAX_LOG_BOUND)) * np.asarray(self.meta["bound_factor"])[passed],
        )

    def __call__(self, inputs: dict[str, NDArray]) -> dict[str, Array]:
        """All outputs of `aminn_debug.onnx`, float64; `inputs` may have theta (N, P)."""
        x = {name: np.asarray(value, np.float64) for name, value in inputs.items()}
        x |= self.varied(x)
        out: dict[str, Array] = {}
        for i, stage in enumerate(STAGES):
            f = self.features(stage, x)
            springs = self.springs(stage, f, x)
            response = self.mechanics(i, springs, x)
            springs.pop("twist")
            n = len(f)
            springs |= dict(
                friction=np.zeros((n, self.b)), preload=np.zeros((n, self.b, 3)), slide=np.zeros((n, self.b))
            )
            if stage == "s1":
                out["p_stable"] = _sigmoid(self.logit(f, response))
            else:
                out |= self.sure(f, response)
            out |= {f"{stage}_{name}": value for name, value in (springs | response).items()}
        out |= {"dx_ht": out["s2_dx"], "k_x": out["s2_k_x"], "gate": out["s2_gate"]}
        return out | {"friction_use": np.zeros_like(out["gate"])}
