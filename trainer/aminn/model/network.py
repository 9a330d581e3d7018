"""The AMINN cascade: a network that predicts springs and tendons, and the mechanics layer that turns them into motion.

One `Backbone` per stage: contact summary and global state give a feature f, a linear head gives 13 numbers a branch.
These are corrections to the nominal springs and tendons of the hand, so that an untrained model is the analytical one.
Everything between SI inputs and SI outputs is inside, normalisation too. The shape of each tensor stands on its line.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from ..hand.dims import (
    LEAST_MOTION_M,
    LENGTH_SCALE_M,
    N_AUX,
    N_BRANCH,
    N_BRANCH_HEAD,
    N_CONTACT_INPUT,
    N_COORD,
    N_GLOBAL_INPUT,
    N_HEAD,
    N_JOINT,
    N_WRENCH,
)
from ..hand.nominal import CHOL_COLS, CHOL_ROWS, Nominal
from .config import MechanicsConfig, ModelConfig
from .mechanics import NO_EXTRAS, Extras, Response, Springs, batch_first, length_scaling, product, two_pass


def slog(v: Tensor, scale: Tensor | float) -> Tensor:
    """Signed logarithm sign(v) log(1 + |v| / scale)."""
    return torch.sign(v) * torch.log(1 + v.abs() / scale)


# Least spread that an input is scaled by. What hardly varies over the training data (the normals of a flat tool, say)
# would otherwise reach tens of standard deviations on the first tool of another kind.
_LENGTH, _NORMAL = 0.005, 0.25  # m, 1
CONTACT_SPREAD = ((1.0,) + (_LENGTH,) * 3 + (_NORMAL,) * 3 + (0.5,) + (_LENGTH,) * 9) * N_BRANCH
GLOBAL_SPREAD = (0.05,) * N_JOINT + ((_LENGTH,) * 3 + (0.05,) * 3) + ((0.1,) * 3 + (0.005,) * 3) + (0.1,) * N_WRENCH


class Normaliser(nn.Module):
    """(v - mean) / std with constants that live in the model."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("inv_std", torch.ones(size))

    def fit(self, v: Tensor, least_spread: tuple[float, ...]) -> None:
        """Take the constants from data (n, size); no column is scaled by less than its `least_spread`."""
        self.mean.copy_(v.mean(0))
        self.inv_std.copy_(1 / torch.maximum(v.std(0), torch.tensor(least_spread)))

    def forward(self, v: Tensor) -> Tensor:
        return (v - self.mean) * self.inv_std


def contact_input(contacts: Tensor, j_q: Tensor) -> Tensor:
    """What the contact summary sees: (N, 51). All of a branch out of contact is zero."""
    c = contacts[..., :1]  # (N, 3, 1)
    u = torch.cat([c, c * contacts[..., 1:], c * j_q.flatten(-2)], -1)  # (N, 3, 17)
    return u.flatten(1)


def global_input(q: Tensor, x_ht: Tensor, w_e: Tensor, wrench_log_scale: Tensor) -> Tensor:
    """Global state: (N, 26)."""
    return torch.cat([q, x_ht, w_e, slog(w_e, wrench_log_scale)], -1)


# Centres of what the optional heads predict.
TWIST_NOMINAL = 1e-3  # N.m/rad
SLIP_NOMINAL = (0.75, 1e-3)  # 1, m/N


def _near_zero(layer: nn.Linear) -> nn.Linear:
    """The layer with outputs that start close to zero."""
    nn.init.zeros_(layer.bias)
    layer.weight.data.mul_(0.1)
    return layer


def _uniform(nominal: Nominal) -> Nominal:
    """The same hand with nothing known of its stiffness: all of it 0.3 N.m/rad, no preferred direction."""
    chol = np.where(np.arange(len(CHOL_ROWS)) < N_COORD, math.sqrt(0.3), 0.0) * np.ones((N_BRANCH, 1))
    gain = np.full(N_BRANCH, 0.3)
    return replace(nominal, chol=chol, tendon_dir=np.zeros_like(nominal.tendon_dir), tendon_gain=gain)


class Backbone(nn.Module):
    """One stage: feature f and the two-pass response."""

    precision: torch.dtype = torch.float64
    """Arithmetic of the mechanics layer; training steps set float32."""

    def __init__(self, config: ModelConfig, mechanics: MechanicsConfig, nominal: Nominal) -> None:
        super().__init__()
        self.config, self.mechanics = config, mechanics
        self.contact_norm = Normaliser(N_CONTACT_INPUT)
        self.global_norm = Normaliser(N_GLOBAL_INPUT)
        self.contact = nn.Linear(N_CONTACT_INPUT, config.contact_width)
        self.trunk1 = nn.Linear(config.contact_width + N_GLOBAL_INPUT, config.width)
        self.trunk2 = nn.Linear(config.width, config.width)
        self.head = _near_zero(nn.Linear(config.width, N_HEAD))  # start close to the nominal hand
        extra = {"slip_head": 2 * N_BRANCH if config.slip else 0, "twist_head": N_BRANCH if config.soft_finger else 0}
        for name, size in extra.items():
            setattr(self, name, _near_zero(nn.Linear(config.width, size)) if size else None)
        if mechanics.learn_eps_m:
            self.eps_m_change = nn.Parameter(torch.zeros(()))  # logarithm: weight decay draws to the constant
        start = nominal if config.heads == "correction" else _uniform(nominal)
        constants = {
            "wrench_log_scale": config.wrench_log_scale,
            "chol_nom": start.chol,
            "tendon_dir_nom": start.tendon_dir,
            "tendon_gain_nom": start.tendon_gain,
            "gate_nom": config.gate_nominal,
            "coord_mask": nominal.coord_mask,
        }
        for name, value in constants.items():
            self.register_buffer(name, torch.tensor(np.asarray(value), dtype=torch.float32))

    def fit_normalisers(self, x: dict[str, Tensor]) -> None:
        """Take the normalisation constants from training inputs."""
        self.contact_norm.fit(contact_input(x["contacts"], x["j_q"]), CONTACT_SPREAD)
        self.global_norm.fit(global_input(x["q"], x["x_ht"], x["w_e"], self.wrench_log_scale), GLOBAL_SPREAD)

    def features(self, x: dict[str, Tensor]) -> Tensor:
        """f (N, width): contact summary fused with the global state."""
        touch = self.contact_norm(contact_input(x["contacts"], x["j_q"]))  # (N, 51)
        summary = torch.relu(self.contact(touch))  # (N, HC)
        state = self.global_norm(global_input(x["q"], x["x_ht"], x["w_e"], self.wrench_log_scale))  # (N, 26)
        hidden = torch.relu(self.trunk1(torch.cat([summary, state], -1)))  # (N, H)
        return torch.relu(self.trunk2(hidden))  # (N, H)

    def springs(self, f: Tensor) -> Springs:
        """The mechanics head: corrections to the nominal hand from f (N, width)."""
        return self.springs_from_head(self.head(f))

    def springs_from_head(self, y: Tensor) -> Springs:
        """Springs and tendons from raw head outputs y (N, 39); zeros give the nominal hand."""
        y = y.mT.unflatten(0, (N_BRANCH, N_BRANCH_HEAD)).transpose(0, 1).contiguous()  # (13, 3, N): batch last
        ld, lo, d, k, al, be, rh = y.split([3, 3, 3, 1, 1, 1, 1])
        mask, r = self.coord_mask.mT[..., None], self.config.log_range  # (3, 3, 1)
        nominal = self.chol_nom.mT[..., None]  # (6, 3, 1)
        rows, cols = list(CHOL_ROWS[3:]), list(CHOL_COLS[3:])
        diag = nominal[:3] * torch.exp(r * torch.tanh(ld) * mask)  # (3, 3, N)
        size = (nominal[rows] * nominal[cols]).sqrt()
        off = (nominal[3:] + size * torch.tanh(lo)) * (mask[rows] * mask[cols])  # (3, 3, N)
        (l00, l11, l22), (l10, l20, l21) = diag, off
        zero = torch.zeros_like(l00)
        lower = torch.stack([l00, zero, zero, l10, l11, zero, l20, l21, l22]).unflatten(0, (3, 3))  # (3, 3, 3, N)
        v = (self.tendon_dir_nom.mT[..., None] + d) * mask  # (3, 3, N)
        direction = v / torch.sqrt((v * v).sum(0) + 1e-12)
        gain = self.tendon_gain_nom[:, None] * torch.exp(r * torch.tanh(k[0]))  # (3, N)
        alpha = self.gate_nom[0] * torch.exp(r * torch.tanh(al))  # (1, 3, N)
        gate_params = torch.cat([alpha, self.gate_nom[1] * be, self.gate_nom[2] + rh])  # (3, 3, N)
        return Springs(*map(batch_first, (product(lower, lower.transpose(0, 1)), direction, gain, gate_params)))

    @property
    def eps_m(self) -> float:
        """Contact compliance of this stage, m/N."""
        change = math.exp(self.eps_m_change.item()) if self.mechanics.learn_eps_m else 1.0
        return self.mechanics.eps_m * change

    def extras(self, f: Tensor, x: dict[str, Tensor]) -> Extras:
        """The terms beyond the paper's layer that this configuration has, from f (N, width)."""
        extras = Extras(normal=x["contacts"][..., 4:7], normal_force=x["contacts"][..., 7])
        if self.mechanics.learn_eps_m:
            extras = extras._replace(eps_m=self.mechanics.eps_m * self.eps_m_change.exp())
        if self.twist_head is not None:
            extras = extras._replace(twist=TWIST_NOMINAL * torch.exp(4 * torch.tanh(self.twist_head(f))))  # (N, 3)
        if self.slip_head is not None:
            friction, compliance = torch.tanh(self.slip_head(f)).unflatten(-1, (2, N_BRANCH)).unbind(-2)  # (N, 3) each
            nominal = (SLIP_NOMINAL[0] * torch.exp(friction), SLIP_NOMINAL[1] * torch.exp(4 * compliance))
            extras = extras._replace(slip=torch.stack(nominal, -1))
        return extras

    def respond(self, springs: Springs, x: dict[str, Tensor], extras: Extras = NO_EXTRAS) -> Response:
        """The two-pass layer on this stage's constants."""
        contact = x["contacts"][..., 0]
        return two_pass(
            springs, x["w_e"], contact, x["j_x"], x["j_q"], self.coord_mask, self.mechanics, extras, self.precision
        )

    def forward(self, x: dict[str, Tensor]) -> tuple[Tensor, Springs, Response]:
        f = self.features(x)
        seen = f if self.config.heads_see_wrench else self.features(x | {"w_e": torch.zeros_like(x["w_e"])})
        springs = self.springs(seen)
        return f, springs, self.respond(springs, x, self.extras(seen, x))

    def nominal_response(self, x: dict[str, Tensor]) -> Response:
        """The analytical model: nominal springs, tendons taut, nothing learned. Raw head outputs are all zero."""
        y = x["q"].new_zeros(x["q"].shape[0], N_HEAD)
        return self.respond(self.springs_from_head(y), x)


def motion_size(r: Response) -> Tensor:
    """Size of the motion with rotations times L (N, 1), m."""
    return torch.linalg.vector_norm(r.x_scaled, dim=-1, keepdim=True).clamp_min(LEAST_MOTION_M)


class Stage1(nn.Module):
    """Does the grasp hold? A classifier on f and on what the statics say."""

    def __init__(self, config: ModelConfig, nominal: Nominal) -> None:
        super().__init__()
        self.config = config
        self.backbone = Backbone(config, config.mechanics[0], nominal)
        self.aux_norm = Normaliser(N_AUX)
        self.cls1 = nn.Linear(config.width + N_AUX, config.classifier_width)
        self.cls2 = nn.Linear(config.classifier_width, 1)

    def fit_normalisers(self, x: dict[str, Tensor]) -> None:
        self.backbone.fit_normalisers(x)
        with torch.no_grad():
            # Centred on the nominal hand. Logarithms keep their scale: a stiffness that hardly varies over the data
            # would be magnified, and its rounding error with it. Gates are scaled by their range.
            self.aux_norm.mean.copy_(self._statics(self.backbone.nominal_response(x)).mean(0))
            self.aux_norm.mean[-N_BRANCH:] = 0.5
            self.aux_norm.inv_std[-N_BRANCH:] = 2.0

    def _statics(self, r: Response) -> Tensor:
        """What the statics say (N, 15): motion, its size in logarithm; log diag(K_x); gates."""
        size = motion_size(r)
        log_size = torch.log(1 + size / self.config.displacement_log_scale)
        diag = torch.log(torch.diagonal(r.k_scaled, dim1=-2, dim2=-1))  # (N, 6)
        return torch.cat([r.x_scaled * (log_size / size), diag, r.gate], -1)

    def _aux(self, r: Response) -> Tensor:
        """The same normalised. K_x and gates count the less, the further beyond L the linear statics move the tool."""
        motion, stiffness = self.aux_norm(self._statics(r)).split([N_WRENCH, N_AUX - N_WRENCH], -1)
        return torch.cat([motion, stiffness * (LENGTH_SCALE_M / motion_size(r)).clamp_max(1)], -1)

    def forward(self, x: dict[str, Tensor]) -> tuple[Tensor, Springs, Response]:
        """Logit (N), springs, response."""
        f, springs, r = self.backbone(x)
        hidden = torch.relu(self.cls1(torch.cat([f, self._aux(r)], -1)))  # (N, HD)
        return self.cls2(hidden).squeeze(-1), springs, r


class Stage2(nn.Module):
    """How far does the tool move, if the grasp holds?"""

    def __init__(self, config: ModelConfig, nominal: Nominal) -> None:
        super().__init__()
        self.backbone = Backbone(config, config.mechanics[1], nominal)

    def fit_normalisers(self, x: dict[str, Tensor]) -> None:
        self.backbone.fit_normalisers(x)

    def forward(self, x: dict[str, Tensor]) -> tuple[Tensor, Springs, Response]:
        _, springs, r = self.backbone(x)
        return r.dx, springs, r


class Aminn(nn.Module):
    """The cascade. SI in, SI out; both stages are always computed here, the caller applies tau."""

    kind = "aminn"

    def __init__(self, config: ModelConfig, nominal: Nominal) -> None:
        super().__init__()
        self.config, self.nominal = config, nominal
        self.stage1 = Stage1(config, nominal)
        self.stage2 = Stage2(config, nominal)

    def forward(
        self, q: Tensor, x_ht: Tensor, w_e: Tensor, contacts: Tensor, j_x: Tensor, j_q: Tensor
    ) -> dict[str, Tensor]:
        """p_stable (N), dx_ht (N, 6), k_x (N, 6, 6), gate (N, 3); shapes of the inputs in `dims.INPUT_SHAPES`."""
        out = self.debug(q, x_ht, w_e, contacts, j_x, j_q)
        return {name: out[name] for name in ("p_stable", "dx_ht", "k_x", "gate")}

    def debug(
        self, q: Tensor, x_ht: Tensor, w_e: Tensor, contacts: Tensor, j_x: Tensor, j_q: Tensor
    ) -> dict[str, Tensor]:
        """The same and every intermediate of both stages (`dims.DEBUG_SHAPES`, s1_ and s2_ before the name)."""
        x = dict(q=q, x_ht=x_ht, w_e=w_e, contacts=contacts, j_x=j_x, j_q=j_q)
        logit, springs1, r1 = self.stage1(x)
        dx, springs2, r2 = self.stage2(x)
        out = {"p_stable": torch.sigmoid(logit), "dx_ht": dx, "k_x": r2.k_x, "gate": r2.gate}
        for prefix, springs, r in (("s1_", springs1, r1), ("s2_", springs2, r2)):
            out |= {prefix + name: value for name, value in springs._asdict().items()}
            out |= {prefix + name: getattr(r, name) for name in ("dx0", "dq0", "gate", "k_x", "dx")}
        return out


def scaled_pose(dx: Tensor) -> Tensor:
    """Displacement with rotations times L = 0.1 m: (..., 6) in m."""
    return dx / length_scaling(dx)
