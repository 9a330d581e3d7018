"""The model in float64 NumPy, written from its definition: the oracle that golden vectors and `verify` compare with.

It shares no code with the trainer, the ONNX graph or the runtime, and solves K_x the plain way, so that a mistake in
one of them shows as a difference. Shapes stand on their lines; N is the batch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aminn.hand.dims import N_BRANCH, N_BRANCH_HEAD, N_CONTACT_FEATURE

from ..files.tables import STAGES, Exported, pair_of

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

    def features(self, stage: str, x: dict[str, Array]) -> Array:
        """f (N, H)."""
        t = {k.removeprefix(stage + "."): v for k, v in self.t.items() if k.startswith(stage + ".")}
        c = x["contacts"][..., :1]  # (N, 3, 1)
        u = np.concatenate([c, c * x["contacts"][..., 1:], c * x["j_q"].reshape(-1, N_BRANCH, 9)], -1)  # (N, 3, 17)
        z_c = (u.reshape(-1, N_BRANCH * (N_CONTACT_FEATURE + 9)) - t["contact_mean"]) * t["contact_inv_std"]  # (N, 51)
        w_log = _slog(x["w_e"], self.t["wrench_log_scale"])
        z_g = np.concatenate([x["q"], x["x_ht"], x["w_e"], w_log], -1)  # (N, 26)
        z_g = (z_g - t["global_mean"]) * t["global_inv_std"]
        h1 = _relu(z_c @ t["contact_w"].T + t["contact_b"])  # (N, HC)
        h2 = _relu(np.concatenate([h1, z_g], -1) @ t["trunk1_w"].T + t["trunk1_b"])  # (N, H)
        return _relu(h2 @ t["trunk2_w"].T + t["trunk2_b"])  # (N, H)

    def springs(self, stage: str, f: Array) -> dict[str, Array]:
        """k_spring (N, 3, 3, 3), tendon_dir (N, 3, 3), tendon_gain (N, 3), gate_params (N, 3, 3)."""
        t, r = self.t, float(self.meta["log_range"])
        y = (f @ t[f"{stage}.head_w"].T + t[f"{stage}.head_b"]).reshape(-1, N_BRANCH, N_BRANCH_HEAD)
        nom, mask, gate_nom = t["chol_nom"], t["coord_mask"], t["gate_nom"]
        chol = np.zeros((len(y), N_BRANCH, 3, 3))
        for i in range(3):
            chol[..., i, i] = nom[:, i] * np.exp(r * np.tanh(y[..., i]) * mask[:, i])
        for n, (i, j) in enumerate(((1, 0), (2, 0), (2, 1))):
            size = np.sqrt(nom[:, i] * nom[:, j])
            chol[..., i, j] = (nom[:, 3 + n] + size * np.tanh(y[..., 3 + n])) * mask[:, i] * mask[:, j]
        v = (t["tendon_dir_nom"] + y[..., 6:9]) * mask
        direction = v / np.sqrt((v * v).sum(-1, keepdims=True) + 1e-12)
        gain = t["tendon_gain_nom"] * np.exp(r * np.tanh(y[..., 9]))
        alpha = gate_nom[0] * np.exp(r * np.tanh(y[..., 10]))
        gate_params = np.stack([alpha, gate_nom[1] * y[..., 11], gate_nom[2] + y[..., 12]], -1)
        k_spring = chol @ np.swapaxes(chol, -1, -2)
        return dict(k_spring=k_spring, tendon_dir=direction, tendon_gain=gain, gate_params=gate_params)

    def _pass(self, stage: int, k_q: Array, x: dict[str, Array]) -> tuple[Array, Array, Array]:
        """(K_x (N, 6, 6), dx (N, 6), dq by statics (N, 3, 3)) for joint stiffness k_q (N, 3, 3, 3)."""
        eps_m, eps_kx = pair_of(self.meta["eps_m"])[stage], pair_of(self.meta["eps_kx"])[stage]
        b, contact = -x["j_q"], x["contacts"][..., 0]
        c_bt = np.linalg.solve(k_q, np.swapaxes(b, -1, -2))  # (N, 3, 3, 3)
        wa = np.linalg.solve(b @ c_bt + eps_m * np.eye(3), x["j_x"] * contact[..., None, None])  # (N, 3, 3, 6)
        k_x = (np.swapaxes(x["j_x"], -1, -2) @ wa).sum(1) + eps_kx * np.eye(6)  # (N, 6, 6)
        s = self.s
        x_s = np.linalg.solve(k_x * s[:, None] * s, (x["w_e"] * s)[..., None])[..., 0]  # (N, 6)
        dx = x_s * s
        dq = c_bt @ (wa @ dx[:, None, :, None])
        return k_x, dx, dq[..., 0]

    def mechanics(self, stage: int, springs: dict[str, Array], x: dict[str, Array]) -> dict[str, Array]:
        """Both passes of a stage."""
        _, dx0, dq0 = self._pass(stage, springs["k_spring"], x)
        if self.meta["dq0"] == "inverse":
            regular = x["j_q"] + pair_of(self.meta["eps_jq"])[stage] * np.eye(3)
            motion = x["j_x"] @ dx0[:, None, :, None]  # (N, 3, 3, 1)
            dq0 = np.asarray(-np.linalg.solve(regular, motion)[..., 0], np.float64) * x["contacts"][..., :1]
        dq0 = dq0 * self.t["coord_mask"]
        d = springs["tendon_dir"]
        alpha, beta, rho = np.moveaxis(springs["gate_params"], -1, 0)
        gate = _sigmoid(alpha * ((dq0 * d).sum(-1) - beta) + rho)  # (N, 3)
        k_tendon = (springs["tendon_gain"] * gate)[..., None, None] * d[..., :, None] * d[..., None, :]
        k_x, dx, _ = self._pass(stage, springs["k_spring"] + k_tendon, x)
        return dict(dx0=dx0, dq0=dq0, gate=gate, k_x=k_x, dx=dx)

    def logit(self, f: Array, response: dict[str, Array]) -> Array:
        """Stage 1's logit (N)."""
        t, s = self.t, self.s
        diagonal = np.diagonal(response["k_x"], axis1=-2, axis2=-1) * s * s
        x_s = response["dx"] / s
        size = np.maximum(np.linalg.norm(x_s, axis=-1, keepdims=True), 1e-12)  # (N, 1)
        motion = x_s * np.log(1 + size / float(self.meta["displacement_log_scale"])) / size
        aux = np.concatenate([motion, np.log(diagonal), response["gate"]], -1)  # (N, 15)
        aux = (aux - t["s1.aux_mean"]) * t["s1.aux_inv_std"]
        aux[:, 6:] *= np.minimum(1, float(self.meta["length_scale"]) / size)
        hidden = _relu(np.concatenate([f, aux], -1) @ t["s1.cls1_w"].T + t["s1.cls1_b"])  # (N, HD)
        return (hidden @ t["s1.cls2_w"].T + t["s1.cls2_b"])[:, 0]

    def __call__(self, inputs: dict[str, NDArray]) -> dict[str, Array]:
        """All outputs of `aminn_debug.onnx`, float64."""
        x = {name: np.asarray(value, np.float64) for name, value in inputs.items()}
        out: dict[str, Array] = {}
        for i, stage in enumerate(STAGES):
            f = self.features(stage, x)
            springs = self.springs(stage, f)
            response = self.mechanics(i, springs, x)
            if stage == "s1":
                out["p_stable"] = _sigmoid(self.logit(f, response))
            out |= {f"{stage}_{name}": value for name, value in (springs | response).items()}
        return out | {"dx_ht": out["s2_dx"], "k_x": out["s2_k_x"], "gate": out["s2_gate"]}
