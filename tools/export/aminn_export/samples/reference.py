"""The model in float64 NumPy, written from its definition: the oracle that golden vectors and `verify` compare with.

It shares no code with the trainer, the ONNX graph or the runtime, and solves K_x the plain way, so that a mistake in
one of them shows as a difference. Shapes stand on their lines; N is the batch, B the branches, C the coordinates of
the longest one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import MAX_LOG_BOUND

from ..files.tables import STAGES, Exported, by_branch, pair_of

Array = NDArray[np.float64]

FRICTION_SPREAD = 0.3
SLIDE_STEPS = 3
MOST_COMPLIANCE, LEAST_PRESSURE, LEAST_RESERVE, MOST_USE = 5e-3, 0.01, 0.1, 100.0
PRELOAD_N, FORCE_N, MOMENT_NM = 0.7, 0.3, 0.008
"""Standard deviations of the preload that carries the tool's weight, and of what is left of force and moment."""


class Statics(NamedTuple):
    """What a load does to a grasp whose joints and contacts have some stiffness."""

    k_x: Array  # (N, 6, 6)
    dx: Array  # (N, 6)
    dq: Array  # (N, B, C) by statics
    force: Array  # (N, B, 3) on each fingertip, N
    give: Array  # (N, B) compliance of each fingertip across its normal, m/N


class Slid(NamedTuple):
    """What contacts do that can slide."""

    after: Statics  # with the compliance of their slides
    use: Array  # (N, B) of friction, before any slides
    slide: Array  # (N, B) m/N
    share: Array  # (N, B) of slide over what the fingertip gives with springs alone
    pressed: Array  # (N, B) normal force before any slides, N


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
        self.slides, self.sensing = bool(self.meta.get("slides")), bool(self.meta.get("sensing"))
        tendons = int(self.meta.get("tendons", 0))
        self.sensors = {"friction": 3, "tool_weight": 4} | ({"tendon_tension": 1 + tendons} if tendons else {})
        """Numbers of each sensor."""
        sensed = sum(self.sensors.values()) - 1 if self.sensing else 0
        self.told = self.t["s1.global_mean"].size > self.t["coord_mask"].sum() + 18 + sensed
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

    def sensed(self, x: dict[str, Array], n: int) -> dict[str, Array]:
        """What sensors say: seen (N, E) by networks; told (N), where friction starts; weight (N, 4)."""
        nominal = float(self.meta["friction_nominal"])
        given = {name: np.zeros((n, size)) for name, size in self.sensors.items()}
        if self.sensing:
            given = {name: np.broadcast_to(x.get(name, zeros), zeros.shape) for name, zeros in given.items()}
        friction = given.pop("friction")
        known = friction[:, 0] > 0
        mu, deviation = np.where(known, friction[:, 1], nominal), np.where(known, friction[:, 2], 0)
        trust = known / (1 + (deviation / (FRICTION_SPREAD * mu)) ** 2)
        log = trust * np.log(mu / nominal)
        seen = [trust[:, None], log[:, None]]
        for value in given.values():
            seen += [value[:, :1], np.where(value[:, :1] > 0, value[:, 1:], 0)]
        return dict(seen=np.concatenate(seen, 1), told=nominal * np.exp(log), weight=given["tool_weight"])

    def whole(self, x: dict[str, Array]) -> dict[str, Array]:
        """Inputs with what theta makes of tables, and with what sensors say."""
        told = self.sensed(x, len(x["q"]))
        return x | self.varied(x) | dict(seen=told["seen"], told_friction=told["told"], weight=told["weight"])

    def ridge(self, weight: Array, x: dict[str, Array]) -> Array:
        """Tangential forces (N, B, 3) that carry a known weight (N, 4) with the normal forces, by least squares."""
        contact, normal = x["contacts"][..., :1], x["contacts"][..., 4:7]
        across = np.eye(3) - normal[..., :, None] * normal[..., None, :]
        turned = np.swapaxes(x["j_x"], -1, -2)  # (N, B, 6, 3)
        pressing = (turned @ (contact * x["contacts"][..., 7:] * normal)[..., None]).sum(1)[..., 0]
        rest = -pressing
        rest[:, :3] -= weight[:, 1:]
        slack = np.diag((np.repeat([FORCE_N, MOMENT_NM], 3) / PRELOAD_N) ** 2)
        system = (turned @ across @ x["j_x"] * contact[..., None]).sum(1) + slack
        y = np.linalg.solve(system, rest[..., None])[:, None]
        return np.asarray((across @ x["j_x"] @ y)[..., 0] * contact * weight[:, None, :1])

    def features(self, stage: str, x: dict[str, Array]) -> Array:
        """f (N, H)."""
        t = {k.removeprefix(stage + "."): v for k, v in self.t.items() if k.startswith(stage + ".")}
        c = x["contacts"][..., :1]  # (N, B, 1)
        j_q = x["j_q"].reshape(-1, self.b, 3 * self.c)
        u = np.concatenate([c, c * x["contacts"][..., 1:], c * j_q], -1)  # (N, B, 8 + 3 C)
        z_c = (u.reshape(len(u), self.b * (8 + 3 * self.c)) - t["contact_mean"]) * t["contact_inv_std"]
        w_log = _slog(x["w_e"], self.t["wrench_log_scale"])
        told = [np.broadcast_to(x["told"], (len(u), self.factors))] if self.told else []
        seen = [x["seen"]] if self.sensing else []
        z_g = np.concatenate([x["q"], x["x_ht"], x["w_e"], w_log, *told, *seen], -1)  # (N, J + 18 + F + E)
        z_g = (z_g - t["global_mean"]) * t["global_inv_std"]
        h1 = _relu(z_c @ t["contact_w"].T + t["contact_b"])  # (N, HC)
        h2 = _relu(np.concatenate([h1, z_g], -1) @ t["trunk1_w"].T + t["trunk1_b"])  # (N, H)
        return _relu(h2 @ t["trunk2_w"].T + t["trunk2_b"])  # (N, H)

    def springs(self, stage: str, f: Array, x: dict[str, Array]) -> dict[str, Array]:
        """k_spring (N, B, C, C), tendon_dir (N, B, C), tendon_gain (N, B), gate_params (N, B, 3), twist (N, B).

        Also friction (N, B) and preload (N, B, 3), zeros where contacts cannot slide.
        """
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
        grip = dict(friction=np.zeros((len(y), n_b)), preload=np.zeros((len(y), n_b, 3)))
        if self.slides:  # the last four of a branch's numbers
            contact, normal = x["contacts"][..., :1], x["contacts"][..., 4:7]
            preload = contact * (self.ridge(x["weight"], x) + y[..., -3:])
            preload = preload - normal * (normal * preload).sum(-1, keepdims=True)
            grip = dict(friction=x["told_friction"][:, None] * np.exp(np.tanh(y[..., -4])), preload=preload)
            y = y[..., :-4]
        twist = np.zeros((len(y), n_b))
        if "twist_nom" in t:  # the last before them
            twist = x["twist"] * np.exp(2 * r * np.tanh(y[..., -1]))
            y = y[..., :-1]
        found = dict(k_spring=k_spring, twist=twist) | grip
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

    def _pass(self, stage: int, k_q: Array, twist: Array, x: dict[str, Array], slide: Array | None = None) -> Statics:
        """Statics for joint stiffness k_q (N, B, C, C), twist (N, B), contacts that slide with compliances (N, B)."""
        eps_m, eps_kx = (self.eps_m[stage] * x["softer"])[..., None, None], pair_of(self.meta["eps_kx"])[stage]
        b, contact = -x["j_q"], x["contacts"][..., 0]
        c_bt = np.linalg.solve(k_q, np.swapaxes(b, -1, -2))  # (N, B, C, 3)
        normal = x["contacts"][..., 4:7]
        across = np.eye(3) - normal[..., :, None] * normal[..., None, :]
        m = b @ c_bt + eps_m * np.eye(3)  # (N, B, 3, 3)
        if slide is not None:
            m = m + (contact * slide)[..., None, None] * across
        wa = np.linalg.solve(m, x["j_x"] * contact[..., None, None])  # (N, B, 3, 6)
        k_x = (np.swapaxes(x["j_x"], -1, -2) @ wa).sum(1) + eps_kx * np.eye(6)  # (N, 6, 6)
        k_x[:, 3:, 3:] += np.einsum("nb,nbi,nbj->nij", contact * twist, normal, normal)
        s = self.s
        x_s = np.linalg.solve(k_x * s[:, None] * s, (x["w_e"] * s)[..., None])[..., 0]  # (N, 6)
        dx = x_s * s
        force = wa @ dx[:, None, :, None]
        give = np.trace(across @ m, axis1=-2, axis2=-1) / 2
        return Statics(k_x, dx, (c_bt @ force)[..., 0], force[..., 0], give)

    def _slide(
        self, stage: int, k_q: Array, springs: dict[str, Array], x: dict[str, Array], stuck: Statics, give: Array
    ) -> Slid:
        """Solve, and give each contact that carries more than friction holds a compliance, SLIDE_STEPS times."""
        contact, normal = x["contacts"][..., 0], x["contacts"][..., 4:7]
        n0 = np.where(contact > 0, x["contacts"][..., 7], 0)
        mu, preload = springs["friction"], springs["preload"]

        def parts(force: Array) -> tuple[Array, Array]:
            along = (normal * force).sum(-1)
            return np.maximum(n0 - along, LEAST_PRESSURE), force - normal * along[..., None]

        pressed, t = parts(stuck.force)
        use = contact * np.sqrt(((preload - t) ** 2).sum(-1) + 1e-12) / (mu * pressed)
        s, now = np.zeros_like(mu), stuck
        for step in range(SLIDE_STEPS):
            if step:
                now = self._pass(stage, k_q, springs["twist"], x, s)
            n, t = parts(now.force)
            limit, used = (mu * n) ** 2, (preload**2).sum(-1)
            reserve = np.maximum(limit - used, LEAST_RESERVE**2 * limit)
            aligned, square = (preload * t).sum(-1), (t * t).sum(-1)
            over = (np.sqrt(aligned**2 + square * reserve + 1e-20) - aligned) / reserve
            s = np.clip((give + s) * over - give, 0, MOST_COMPLIANCE)
        after = self._pass(stage, k_q, springs["twist"], x, s)
        return Slid(after, np.minimum(use, MOST_USE), s, s / give, pressed)

    def _cut(self, dx: Array) -> Array:
        """A motion (N, 6) shortened to the bounds of a grasp that holds."""
        over = [np.linalg.norm(dx[:, :3], axis=1) / self.meta["max_translation"]]
        over += [np.linalg.norm(dx[:, 3:], axis=1) / self.meta["max_rotation"]]
        return np.asarray(dx / np.maximum(np.max(over, 0), 1)[:, None])

    def mechanics(self, stage: int, springs: dict[str, Array], x: dict[str, Array]) -> dict[str, Array]:
        """Both passes of a stage, and what contacts do that can slide.

        k_stuck and x_s are what networks see: K_x if no contact slides, and the motion (N, 6) before it is cut.
        """
        _, dx0, dq0, _, give = self._pass(stage, springs["k_spring"], springs["twist"], x)
        if self.meta["dq0"] == "inverse":
            regular = x["j_q"] + pair_of(self.meta["eps_jq"])[stage] * np.eye(3)
            motion = x["j_x"] @ dx0[:, None, :, None]  # (N, B, 3, 1)
            dq0 = np.asarray(-np.linalg.solve(regular, motion)[..., 0], np.float64) * x["contacts"][..., :1]
        dq0 = dq0 * self.t["coord_mask"]
        d = springs["tendon_dir"]
        alpha, beta, rho = np.moveaxis(springs["gate_params"], -1, 0)
        gate = _sigmoid(alpha * ((dq0 * d).sum(-1) - beta) + rho) * self.has_tendon  # (N, B)
        k_tendon = (springs["tendon_gain"] * gate)[..., None, None] * d[..., :, None] * d[..., None, :]
        k_q = springs["k_spring"] + k_tendon
        stuck = self._pass(stage, k_q, springs["twist"], x)
        found = dict(dx0=dx0, dq0=dq0, gate=gate, k_stuck=stuck.k_x)
        if not self.slides:
            none = np.zeros_like(gate)
            seen = dict(x_s=stuck.dx / self.s, slide=none, use=none)
            return found | seen | dict(k_x=stuck.k_x, dx=stuck.dx)
        slid = self._slide(stage, k_q, springs, x, stuck, give)
        logs = np.log(1 + np.concatenate([slid.use, slid.share, slid.pressed], -1))  # (N, 3 B)
        seen = dict(x_s=slid.after.dx / self.s, slide=slid.slide, use=slid.use, logs=logs)
        return found | seen | dict(k_x=slid.after.k_x, dx=self._cut(slid.after.dx))

    def logit(self, f: Array, response: dict[str, Array]) -> Array:
        """Stage 1's logit (N)."""
        t, s = self.t, self.s
        diagonal = np.diagonal(response["k_stuck"], axis1=-2, axis2=-1) * s * s
        x_s = response["x_s"]
        size = np.maximum(np.linalg.norm(x_s, axis=-1, keepdims=True), 1e-12)  # (N, 1)
        motion = x_s * np.log(1 + size / float(self.meta["displacement_log_scale"])) / size
        gates = [response["gate"]] if self.gated else []
        contacts = [response["logs"]] if self.slides else []
        aux = np.concatenate([motion, np.log(diagonal), *gates, *contacts], -1)  # (N, A)
        aux = (aux - t["s1.aux_mean"]) * t["s1.aux_inv_std"]
        aux[:, 6:] *= np.minimum(1, float(self.meta["length_scale"]) / size)
        hidden = _relu(np.concatenate([f, aux], -1) @ t["s1.cls1_w"].T + t["s1.cls1_b"])  # (N, HD)
        return (hidden @ t["s1.cls2_w"].T + t["s1.cls2_b"])[:, 0]

    def sure(self, f: Array, response: dict[str, Array]) -> dict[str, Array]:
        """p_slide (N) and bound_95 (N) of stage 2."""
        t = self.t
        size = np.linalg.norm(response["x_s"], axis=-1, keepdims=True)
        contacts = [response["logs"]] if self.slides else []
        seen = np.concatenate([np.log(1 + size / float(self.meta["displacement_log_scale"])), *contacts], -1)
        seen = (seen - t["s2.sure_mean"]) * t["s2.sure_inv_std"]
        found = np.concatenate([f, seen], -1) @ t["s2.sure_w"].T + t["s2.sure_b"]  # (N, 2)
        p_slide = _sigmoid(found[:, 0])
        passed = (p_slide[:, None] >= np.asarray(self.meta["bound_edge"])).sum(1)
        return dict(
            p_slide=p_slide,
            bound_95=np.exp(np.minimum(found[:, 1], MAX_LOG_BOUND)) * np.asarray(self.meta["bound_factor"])[passed],
        )

    def __call__(self, inputs: dict[str, NDArray]) -> dict[str, Array]:
        """All outputs of `aminn_debug.onnx`, float64; `inputs` may have theta (N, P) and sensors."""
        x = self.whole({name: np.asarray(value, np.float64) for name, value in inputs.items()})
        out: dict[str, Array] = {}
        for i, stage in enumerate(STAGES):
            f = self.features(stage, x)
            springs = self.springs(stage, f, x)
            response = self.mechanics(i, springs, x)
            springs.pop("twist")
            if stage == "s1":
                out |= dict(p_stable=_sigmoid(self.logit(f, response)), friction_use=response["use"])
            else:
                out |= self.sure(f, response)
            shown = {k: v for k, v in (springs | response).items() if k not in ("k_stuck", "x_s", "use", "logs")}
            out |= {f"{stage}_{name}": value for name, value in shown.items()}
        return out | {"dx_ht": out["s2_dx"], "k_x": out["s2_k_x"], "gate": out["s2_gate"]}
