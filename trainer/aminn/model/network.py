"""The AMINN cascade: a network that predicts springs and tendons, and the mechanics layer that turns them into motion.

One `Backbone` per stage: contact summary and global state give a feature f, a linear head the numbers of each branch.
These are corrections to the nominal springs and tendons of the hand, so that an untrained model is the analytical one.
Mechanics parameters theta (`aminn_hand.theta`) change what is nominal for a sample; a told model's networks see them.
Optional sensors (`aminn_hand.sensors`) are seen by the networks of a model that has them.
Everything between SI inputs and SI outputs is inside, normalisation too. The shape of each tensor stands on its line.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from aminn_base.errors import AminnError
from aminn_hand import Dims, Hand
from aminn_hand.hand import LEAST_MOTION_M, N_GATE, N_WRENCH, OUTPUTS
from aminn_hand.sensors import FRICTION, FRICTION_SPREAD, NOMINAL_FRICTION, faults
from aminn_hand.theta import Theta

from ..hand.nominal import Nominal, nominal_of, stiffness_terms
from .batched import batch_first, batch_last, packed_cholesky, product
from .config import ModelConfig
from .mechanics import NO_EXTRAS, Constants, Extras, Response, Springs, length_scaling, two_pass
from .normaliser import Normaliser
from .sliding import AXES, preload_of_weight
from .sure import Sure


def slog(v: Tensor, scale: Tensor | float) -> Tensor:
    """Signed logarithm sign(v) log(1 + |v| / scale)."""
    return torch.sign(v) * torch.log(1 + v.abs() / scale)


# Least spread that an input is scaled by. What hardly varies over the training data (the normals of a flat tool, say)
# would otherwise reach tens of standard deviations on the first tool of another kind.
_LENGTH, _NORMAL, _KNOWN = 0.005, 0.25, 0.25  # m, 1, 1


def contact_spread(dims: Dims) -> tuple[float, ...]:
    """Of `contact_input`."""
    contact = (1.0, *(_LENGTH,) * 3, *(_NORMAL,) * 3, 0.5)
    return (contact + (_LENGTH,) * (AXES * dims.coordinates)) * dims.branches


def global_spread(dims: Dims) -> tuple[float, ...]:
    """Of `global_input`."""
    pose, wrench = (_LENGTH,) * 3 + (0.05,) * 3, (0.1,) * 3 + (0.005,) * 3
    sensed = (_KNOWN, 0.1, _KNOWN, *(0.1,) * AXES, _KNOWN, *(0.5,) * dims.tendons)[: dims.sensing]
    return (0.05,) * dims.joints + pose + wrench + (0.1,) * N_WRENCH + (0.1,) * dims.factors + sensed


def contact_input(contacts: Tensor, j_q: Tensor) -> Tensor:
    """What the contact summary sees: (N, B (8 + 3C)). All of a branch out of contact is zero."""
    c = contacts[..., :1]  # (N, B, 1)
    u = torch.cat([c, c * contacts[..., 1:], c * j_q.flatten(-2)], -1)  # (N, B, 8 + 3C)
    return u.flatten(1)


def _friction(x: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """How much is known of friction, and how far it moves the logarithm of the coefficient from nominal: (N) each."""
    if FRICTION not in x:
        none = torch.zeros_like(x["q"][:, 0])
        return none, none
    known, coefficient, deviation = x[FRICTION].unbind(-1)
    is_known = known > 0
    coefficient = torch.where(is_known, coefficient, NOMINAL_FRICTION)
    deviation = torch.where(is_known, deviation, 0.0)
    trust = known / (1 + (deviation / (FRICTION_SPREAD * coefficient)) ** 2)
    return trust, trust * torch.log(coefficient / NOMINAL_FRICTION)


def told_friction(x: dict[str, Tensor]) -> Tensor:
    """Friction coefficient (N) that the layer starts from: the nominal one as far as nothing is known."""
    return NOMINAL_FRICTION * torch.exp(_friction(x)[1])


def sensed_input(x: dict[str, Tensor], dims: Dims) -> Tensor:
    """What networks see of optional sensors: (N, `Dims.sensed`). What is not known is 0."""
    parts = [torch.stack(_friction(x), -1)]
    for name, (size,) in dims.sensors.items():
        if name == FRICTION:
            continue
        value = x[name] if name in x else x["q"].new_zeros(len(x["q"]), size)
        known = value[:, :1]
        parts += [known, torch.where(known > 0, value[:, 1:], 0.0)]
    return torch.cat(parts, -1)


def global_input(x: dict[str, Tensor], wrench_log_scale: Tensor, dims: Dims) -> Tensor:
    """Global state, theta's factors in a told model, sensors in one that has them: (N, `Dims.global_input`)."""
    q, w_e = x["q"], x["w_e"]
    state = [q, x["x_ht"], w_e, slog(w_e, wrench_log_scale)]
    if dims.factors:
        state.append(x["theta"][:, : dims.factors] if "theta" in x else q.new_zeros(len(q), dims.factors))
    if dims.sensing:
        state.append(sensed_input(x, dims))
    return torch.cat(state, -1)


def sensing_columns(dims: Dims, start: int = 0) -> slice:
    """Where sensors stand in the global input that begins at `start`: at its end."""
    stop = start + dims.global_input
    return slice(stop - dims.sensing, stop)


PRELOAD_N = 1.0
"""Unit of the preload that the head gives."""


def _near_zero(layer: nn.Linear) -> nn.Linear:
    """The layer with outputs that start close to zero."""
    nn.init.zeros_(layer.bias)
    layer.weight.data.mul_(0.1)
    return layer


def _uniform(nominal: Nominal) -> Nominal:
    """The same hand with nothing known of its stiffness: all of it 0.3 N.m/rad, no preferred direction."""
    branches, coordinates = nominal.coord_mask.shape
    diagonal = np.arange(nominal.chol.shape[1]) < coordinates
    chol = np.where(diagonal, math.sqrt(0.3), 0.0) * np.ones((branches, 1))
    gain = np.where(nominal.tendon_gain > 0, 0.3, 0.0)
    return replace(nominal, chol=chol, tendon_dir=np.zeros_like(nominal.tendon_dir), tendon_gain=gain)


def theta_terms(config: ModelConfig, hand: Hand) -> NDArray[np.float64]:
    """`stiffness_terms`; for free heads, which know nothing of the hand's stiffness, theta changes none of it."""
    terms = stiffness_terms(hand)
    if config.heads == "free":
        start = _uniform(nominal_of(hand))
        terms[:] = 0
        terms[0, :, :-1], terms[0, :, -1] = start.chol**2, start.tendon_gain  # the factor is diagonal
    return terms


class Backbone(nn.Module):
    """One stage: feature f and the two-pass response."""

    precision: torch.dtype = torch.float64
    """Arithmetic of the mechanics layer; training steps set float32."""
    eps_m_start: Tensor
    twist_start: Tensor
    theta_terms: Tensor
    wrench_log_scale: Tensor
    chol_nom: Tensor
    tendon_dir_nom: Tensor
    tendon_gain_nom: Tensor
    gate_nom: Tensor
    coord_mask: Tensor
    twist_head: nn.Linear | None

    def __init__(self, config: ModelConfig, stage: int, hand: Hand) -> None:
        super().__init__()
        mechanics, width = config.mechanics[stage], config.width[stage]
        self.config, self.mechanics, self.dims, nominal = config, mechanics, config.dims(hand), nominal_of(hand)
        dims = self.dims
        if mechanics.dq0 == "inverse" and dims.coordinates != AXES:
            raise AminnError(
                f'mechanics.dq0 = "inverse" inverts J_q, which is square for {AXES} joints a branch; hand {hand.name} '
                f'has up to {dims.coordinates}: take "statics"'
            )
        self.contact_norm = Normaliser(dims.contact_input)
        self.global_norm = Normaliser(dims.global_input)
        self.contact = nn.Linear(dims.contact_input, config.contact_width)
        self.trunk1 = nn.Linear(config.contact_width + dims.global_input, width)
        self.trunk2 = nn.Linear(width, width)
        self.head = _near_zero(nn.Linear(width, dims.head))  # start close to the nominal hand
        self.twist_head = _near_zero(nn.Linear(width, dims.branches)) if config.twists(hand) else None
        if mechanics.learn_eps_m:
            self.eps_m_change = nn.Parameter(torch.zeros(()))  # logarithm: weight decay draws to the constant
        eps_m = nominal.eps_m if mechanics.eps_m is None else np.full(dims.branches, mechanics.eps_m)
        eps_m_start = torch.tensor(eps_m if np.ptp(eps_m) > 0 else eps_m[0], dtype=torch.float64)  # (B) or ()
        self.gated = tuple(bool(gain > 0) for gain in nominal.tendon_gain)
        self.length_m = hand.length_m
        self.register_buffer("eps_m_start", eps_m_start, persistent=False)
        self.register_buffer("twist_start", torch.tensor(nominal.twist, dtype=torch.float32), persistent=False)
        terms = torch.tensor(theta_terms(config, hand))  # (1 + S, B, C(C+1)/2 + 1)
        self.register_buffer("theta_terms", terms, persistent=False)
        self.stiff = slice(0, len(self.theta_terms) - 1)
        self.contacts = slice(self.stiff.stop, self.stiff.stop + dims.branches)
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
        self.contact_norm.fit(contact_input(x["contacts"], x["j_q"]), contact_spread(self.dims))
        seen = global_input(x, self.wrench_log_scale, self.dims)
        self.global_norm.fit(seen, global_spread(self.dims), sensing_columns(self.dims))

    def features(self, x: dict[str, Tensor]) -> Tensor:
        """f (N, width): contact summary fused with the global state."""
        touch = self.contact_norm(contact_input(x["contacts"], x["j_q"]))  # (N, B (8 + 3C))
        summary = torch.relu(self.contact(touch))  # (N, HC)
        state = self.global_norm(global_input(x, self.wrench_log_scale, self.dims))  # (N, Dims.global_input)
        hidden = torch.relu(self.trunk1(torch.cat([summary, state], -1)))  # (N, H)
        return torch.relu(self.trunk2(hidden))  # (N, H)

    def nominal(self, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Packed Cholesky factors (C(C+1)/2, B, N) and gains (B, N) of the hand with theta (N, P).

        Without theta they are tables of the hand's own, with 1 for N.
        """
        if theta is None:
            return self.chol_nom.mT[..., None], self.tendon_gain_nom[:, None]
        terms = self.theta_terms.to(self.precision).movedim(0, -1).transpose(0, 1)  # (C(C+1)/2 + 1, B, 1 + S)
        factor = theta[:, self.stiff].mT.to(self.precision).exp()  # (S, N)
        k = terms[..., :1] + (terms[..., 1:].flatten(0, 1) @ factor).unflatten(0, terms.shape[:2])
        like = self.chol_nom.dtype
        return packed_cholesky(k[:-1], self.dims.cholesky_entries).to(like), k[-1].to(like)

    def parts(self, y: Tensor) -> dict[str, Tensor]:
        """Raw head outputs y (N, `Dims.head`) by `Dims.head_parts`, each (numbers, B, N): the batch stands last."""
        dims = self.dims
        y = y.mT.unflatten(0, (dims.branches, dims.branch_head)).transpose(0, 1).contiguous()
        return dict(zip(dims.head_parts, y.split([p.stop - p.start for p in dims.head_parts.values()]), strict=True))

    def springs_from_head(self, y: Tensor, theta: Tensor | None = None) -> Springs:
        """Springs and tendons from raw head outputs y (N, `Dims.head`); zeros: those of the hand, with theta (N, P)."""
        dims, count, part = self.dims, self.dims.coordinates, self.parts(y)
        ld, lo = part["diagonal"], part["below"]
        mask, r = self.coord_mask.mT[..., None], self.config.log_range  # (C, B, 1)
        nominal, gain = self.nominal(theta)
        rows, cols = ([entry[k] for entry in dims.cholesky_entries[count:]] for k in (0, 1))
        diag = nominal[:count] * torch.exp(r * torch.tanh(ld) * mask)  # (C, B, N)
        size = (nominal[rows] * nominal[cols]).sqrt()
        off = (nominal[count:] + size * torch.tanh(lo)) * (mask[rows] * mask[cols])  # (C(C-1)/2, B, N)
        entries = dict(zip(dims.cholesky_entries, (*diag, *off), strict=True))
        zero = torch.zeros_like(entries[0, 0])
        square = [entries.get((i, j), zero) for i in range(count) for j in range(count)]
        lower = torch.stack(square).unflatten(0, (count, count))  # (C, C, B, N)
        tendons = self._tendons(part, mask, gain) if dims.gates else self._no_tendons(diag)
        return Springs(*map(batch_first, (product(lower, lower.transpose(0, 1)), *tendons)))

    def _tendons(self, part: dict[str, Tensor], mask: Tensor, nominal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Direction (C, B, N), gain (B, N) and gate parameters (3, B, N) from head outputs and nominal gains (B, N)."""
        d, k, al, be, rh = (part[name] for name in ("direction", "gain", "alpha", "beta", "rho"))
        if not all(self.gated):
            mask = mask * mask.new_tensor(self.gated)[:, None]  # no direction where there is no tendon
        r = self.config.log_range
        v = (self.tendon_dir_nom.mT[..., None] + d) * mask  # (C, B, N)
        direction = v / torch.sqrt((v * v).sum(0) + 1e-12)
        gain = nominal * torch.exp(r * torch.tanh(k[0]))  # (B, N)
        alpha = self.gate_nom[0] * torch.exp(r * torch.tanh(al))  # (1, B, N)
        return direction, gain, torch.cat([alpha, self.gate_nom[1] * be, self.gate_nom[2] + rh])  # (3, B, N)

    def _no_tendons(self, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        zero = torch.zeros_like(like)  # (C, B, N)
        return zero, zero[0], zero[:1].expand(N_GATE, -1, -1)

    @property
    def eps_m(self) -> list[float]:
        """Contact compliance of each branch (B) in this stage, m/N."""
        change = math.exp(self.eps_m_change.item()) if self.mechanics.learn_eps_m else 1.0
        return (self.eps_m_start.expand(self.dims.branches) * change).tolist()

    def extras(self, f: Tensor, y: Tensor, x: dict[str, Tensor]) -> Extras:
        """The terms beyond the paper's layer that this configuration has, from f (N, width) and y (N, `Dims.head`)."""
        eps_m = self._compliance(x)
        if self.mechanics.learn_eps_m:
            change = self.eps_m_change.exp()
            eps_m = (self.eps_m_start if eps_m is None else eps_m).to(change.dtype) * change
        extras = Extras(eps_m, normal=x["contacts"][..., 4:7], normal_force=x["contacts"][..., 7])
        if self.twist_head is not None:
            factor = torch.exp(2 * self.config.log_range * torch.tanh(self.twist_head(f)))  # (N, B)
            extras = extras._replace(twist=self._twist(x) * factor)
        return self._with_friction(extras, y, x)

    def _with_friction(self, extras: Extras, y: Tensor, x: dict[str, Tensor]) -> Extras:
        """Friction and preload of the contacts, if they may slide, from raw head outputs y (N, `Dims.head`)."""
        if not self.dims.slides:
            return extras
        part = self.parts(y)
        told = told_friction(x if self.dims.sensing else {"q": x["q"]})[:, None]
        friction = told * torch.exp(torch.tanh(batch_first(part["friction"])[..., 0]))  # (N, B)
        preload = PRELOAD_N * batch_first(part["preload"])  # (N, B, 3)
        if self.dims.sensing and "tool_weight" in x:
            preload = preload + self._preload_of_weight(x).to(preload.dtype)
        contacts = x["contacts"]
        force = torch.where(contacts[..., 0] > 0, contacts[..., 7], 0.0)  # of what is no contact nothing counts
        return extras._replace(friction=friction, preload=preload, normal_force=force)

    def _preload_of_weight(self, x: dict[str, Tensor]) -> Tensor:
        """`preload_of_weight` (N, B, 3) where the tool's weight is known, else 0."""
        known, weight = x["tool_weight"].to(self.precision).split([1, AXES], -1)
        contacts = batch_last(x["contacts"]).to(self.precision)  # (8, B, N)
        scale = length_scaling(contacts, self.length_m)[:, None, None]
        a = batch_last(x["j_x"]).to(self.precision) * scale
        found = preload_of_weight(weight.mT, contacts[0], a, contacts[4:7], contacts[7], self.length_m)
        return known[..., None] * batch_first(found)

    def _compliance(self, x: dict[str, Tensor]) -> Tensor | None:
        """Contact compliances (N, B) with theta, if there is one, before what is learned of them."""
        if "theta" not in x:
            return None
        factor = x["theta"][:, self.contacts].exp()
        return self.eps_m_start.to(factor.dtype) * factor

    def _twist(self, x: dict[str, Tensor]) -> Tensor:
        """Nominal stiffness of contacts about their normals, (B) or with theta (N, B)."""
        twist = self.twist_start.to(x["q"].dtype)
        return twist / x["theta"][:, self.contacts].exp() if "theta" in x else twist

    def respond(self, springs: Springs, x: dict[str, Tensor], extras: Extras = NO_EXTRAS) -> Response:
        """The two-pass layer on this stage's constants."""
        contact = x["contacts"][..., 0]
        limits = self.config.motion_limits if self.dims.slides else None
        constants = Constants(self.mechanics, self.coord_mask, self.eps_m_start, self.gated, self.length_m, limits)
        return two_pass(springs, x["w_e"], contact, x["j_x"], x["j_q"], constants, extras, self.precision)

    def forward(self, x: dict[str, Tensor]) -> tuple[Tensor, Springs, Response]:
        f = self.features(x)
        seen = f if self.config.heads_see_wrench else self.features(x | {"w_e": torch.zeros_like(x["w_e"])})
        y = self.head(seen)
        springs = self.springs_from_head(y, x.get("theta"))
        return f, springs, self.respond(springs, x, self.extras(seen, y, x))

    def nominal_response(self, x: dict[str, Tensor]) -> Response:
        """The analytical model: nominal springs, tendons taut, nothing learned. Raw head outputs are all zero."""
        n = len(x["q"])
        y, extras = x["q"].new_zeros(n, self.dims.head), Extras(self._compliance(x))
        contacts = x["contacts"]
        extras = extras._replace(normal=contacts[..., 4:7], normal_force=contacts[..., 7])
        if self.twist_head is not None:
            extras = extras._replace(twist=self._twist(x).expand(n, -1))
        extras = self._with_friction(extras, y, x)
        return self.respond(self.springs_from_head(y, x.get("theta")), x, extras)


def motion_size(r: Response) -> Tensor:
    """Size of the motion with rotations times L (N, 1), m."""
    return torch.linalg.vector_norm(r.x_scaled, dim=-1, keepdim=True).clamp_min(LEAST_MOTION_M)


def log_motion(size: Tensor, config: ModelConfig) -> Tensor:
    """Logarithm of 1 + the size of a motion (N, 1), m, in the unit of the configuration."""
    return torch.log(1 + size / config.displacement_log_scale)


def contact_statics(r: Response) -> Tensor:
    """What the friction of the contacts says (N, 3 B), in logarithm: use, how much they give by sliding, force."""
    return torch.log(1 + torch.cat([r.friction_use, r.slide_share, r.pressed], -1))


class Stage1(nn.Module):
    """Does the grasp hold? A classifier on f and on what the statics say."""

    def __init__(self, config: ModelConfig, hand: Hand) -> None:
        super().__init__()
        self.config, self.dims = config, config.dims(hand)
        self.backbone = Backbone(config, 0, hand)
        self.aux_norm = Normaliser(self.dims.aux)
        self.cls1 = nn.Linear(config.width[0] + self.dims.aux, config.classifier_width)
        self.cls2 = nn.Linear(config.classifier_width, 1)

    def fit_normalisers(self, x: dict[str, Tensor]) -> None:
        self.backbone.fit_normalisers(x)
        with torch.no_grad():
            # Centred on the nominal hand. Logarithms keep their scale: a stiffness that hardly varies over the data
            # would be magnified, and its rounding error with it. Gates are scaled by their range.
            self.aux_norm.mean.copy_(self._statics(self.backbone.nominal_response(x)).mean(0))
            gates = slice(2 * N_WRENCH, 2 * N_WRENCH + (self.dims.branches if self.dims.gates else 0))
            self.aux_norm.mean[gates] = 0.5
            self.aux_norm.inv_std[gates] = 2.0

    def _statics(self, r: Response) -> Tensor:
        """What the statics say (N, `Dims.aux`): motion, its size in logarithm; log diag(K_x); gates; contacts."""
        size = motion_size(r)
        log_size = log_motion(size, self.config)
        diag = torch.log(torch.diagonal(r.k_scaled, dim1=-2, dim2=-1))  # (N, 6)
        gates = (r.gate,) if self.dims.gates else ()
        contacts = (contact_statics(r),) if self.dims.slides else ()
        return torch.cat([r.x_scaled * (log_size / size), diag, *gates, *contacts], -1)

    def _aux(self, r: Response) -> Tensor:
        """The same normalised. K_x and gates count the less, the further beyond L the linear statics move the tool."""
        motion, stiffness = self.aux_norm(self._statics(r)).split([N_WRENCH, self.dims.aux - N_WRENCH], -1)
        return torch.cat([motion, stiffness * (self.backbone.length_m / motion_size(r)).clamp_max(1)], -1)

    def forward(self, x: dict[str, Tensor]) -> tuple[Tensor, Springs, Response]:
        """Logit (N), springs, response."""
        f, springs, r = self.backbone(x)
        hidden = torch.relu(self.cls1(torch.cat([f, self._aux(r)], -1)))  # (N, HD)
        return self.cls2(hidden).squeeze(-1), springs, r


class Stage2(nn.Module):
    """How far does the tool move, if the grasp holds?"""

    def __init__(self, config: ModelConfig, hand: Hand) -> None:
        super().__init__()
        self.backbone = Backbone(config, 1, hand)

    def fit_normalisers(self, x: dict[str, Tensor]) -> None:
        self.backbone.fit_normalisers(x)

    def forward(self, x: dict[str, Tensor]) -> tuple[Tensor, Springs, Response]:
        _, springs, r = self.backbone(x)
        return r.dx, springs, r


def _of_each(name: str, value: Tensor, q: Tensor, size: int, what: str) -> Tensor:
    """What is told of all states (size) or of each (N, size) as (N, size). Raises AminnError for another shape."""
    if tuple(value.shape) not in ((size,), (len(q), size)):
        raise AminnError(f"{name} has shape {tuple(value.shape)}, expected ({size},) or ({len(q)}, {size}): {what}")
    return value.to(q.dtype).expand(len(q), size)


class Cascade(nn.Module, ABC):
    """A model of a hand: SI in, SI out; both stages are always computed, the caller applies tau."""

    hand: Hand
    config: ModelConfig
    sure: Sure

    def inputs(
        self,
        q: Tensor,
        x_ht: Tensor,
        w_e: Tensor,
        contacts: Tensor,
        j_x: Tensor,
        j_q: Tensor,
        theta: Tensor | None = None,
        friction: Tensor | None = None,
        tool_weight: Tensor | None = None,
        tendon_tension: Tensor | None = None,
    ) -> dict[str, Tensor]:
        """What `forward` takes, by name; shapes in `Dims.inputs`.

        theta (P) or (N, P) are mechanics parameters; none are zeros. Its joint zeros and tip radius have no effect
        here: the state is that of the hand as it is (`Theta.corrected`).
        friction, tool_weight, tendon_tension: optional sensors in the form of `aminn_hand.sensors`, a row or one for
        each state; none are zeros, which is not known. They have no effect on a model without them. Raises AminnError
        where one of these has another shape, or says what cannot be.
        """
        x = dict(q=q, x_ht=x_ht, w_e=w_e, contacts=contacts, j_x=j_x, j_q=j_q)
        hand, dims = self.hand.name, self.config.dims(self.hand)
        if theta is not None:
            size = len(Theta(self.hand))
            what = f"a number for each of the {size} parameters of hand {hand}, in the order of Theta(hand).names"
            x["theta"] = _of_each("theta", theta, q, size, what)
        given = {"friction": friction, "tool_weight": tool_weight, "tendon_tension": tendon_tension}
        for name, value in given.items():
            if value is None:
                continue
            if name not in dims.sensors:
                raise AminnError(f"{name} is given, but hand {hand} has no tendons; leave it out")
            (size,) = dims.sensors[name]
            sensor = _of_each(name, value, q, size, "whether it is known, 0 or 1, then its values")
            for rows, fault in faults(name, sensor.detach().double().numpy()):
                if rows.any():
                    raise AminnError(f"{fault} in row {int(rows.argmax())} ({int(rows.sum())} such rows)")
            if dims.sensing:
                x[name] = sensor
        return x

    def forward(self, *given: Tensor, **named: Tensor) -> dict[str, Tensor]:
        """Outputs of what `inputs` takes."""
        return self.outputs(self.inputs(*given, **named))

    @abstractmethod
    def outputs(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        """Of inputs by name."""

    @abstractmethod
    def seen_by_sure(self, x: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """What `sure` takes of inputs by name, feature and statics, and the motion (N, 6) that it judges."""


class Aminn(Cascade):
    """The cascade with the mechanics layer."""

    kind = "aminn"

    def __init__(self, config: ModelConfig, hand: Hand) -> None:
        super().__init__()
        self.config, self.hand = config, hand
        self.stage1 = Stage1(config, hand)
        self.stage2 = Stage2(config, hand)
        self.sure = Sure(config.width[1], config.dims(hand).sure)

    def outputs(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        """p_stable (N), dx_ht (N, 6), k_x (N, 6, 6), gate (N, B), p_slide (N), bound_95 (N), friction_use (N, B)."""
        out = self._whole(x)
        return {name: out[name] for name in OUTPUTS}

    def seen_by_sure(self, x: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        f, _, r = self.stage2.backbone(x)
        return f, self._statics(r), r.dx

    def _statics(self, r: Response) -> Tensor:
        """What stage 2's statics say of how sure its motion is, in logarithm (N, 1 or 1 + 3 B)."""
        size = log_motion(motion_size(r), self.config)
        return torch.cat([size, contact_statics(r)], -1) if self.stage1.dims.slides else size

    def debug(self, *given: Tensor, **named: Tensor) -> dict[str, Tensor]:
        """The same and every intermediate of both stages (`Dims.debug`, s1_ and s2_ before the name)."""
        return self._whole(self.inputs(*given, **named))

    def _whole(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        logit, springs1, r1 = self.stage1(x)
        f2, springs2, r2 = self.stage2.backbone(x)
        p_slide, bound = self.sure(f2, self._statics(r2))
        out = {"p_stable": torch.sigmoid(logit), "dx_ht": r2.dx, "k_x": r2.k_x, "gate": r2.gate}
        out |= {"p_slide": p_slide, "bound_95": bound, "friction_use": r1.friction_use}
        for prefix, springs, r in (("s1_", springs1, r1), ("s2_", springs2, r2)):
            found = springs._asdict() | r._asdict()
            out |= {prefix + name: found[name] for name in self.hand.dims.debug}
        return out


def scaled_pose(dx: Tensor, length_m: float) -> Tensor:
    """Displacement with rotations times L: (..., 6) in m."""
    return dx / length_scaling(dx, length_m)
