"""Does a description tell the hand that is simulated? A few light grasps of a ball, small loads, theory against engine.

A ball is put between the fingertips, constant joint torques press the contacts in balance, and small loads move it.
The statics of the description (docs/mechanics.md), with the contact forces and without, says how far. A right
description is off by a few per cent at most, a wrong one by tens (docs/your-hand.md has figures).
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from aminn_base.errors import AminnError
from aminn_hand.hand import Hand

from . import _core, mjcf_tree
from .scene import TIMESTEP_S, set_options, tool_geom
from .statics import Contact, displacement, skew, surface_curvature, tangential
from .understand import Understood

Array = NDArray[np.float64]
ARM_M = 0.1
"""A rotation of 1 rad counts as this many metres."""
SCALE = np.array([1.0, 1.0, 1.0, ARM_M, ARM_M, ARM_M])
TOOL_MASS_KG = 0.05
FRICTION = 1.0
CONE_SHARE = 0.6
"""Of the friction cone that the contacts' forces may use before a load."""
BASE_TENSION_N = 5.0
"""Of cables, so that none slackens under a small load."""
LEVER_M = 0.03
"""Of a joint about which a tool moves, for damping."""
SETTLE_STEPS, MOST_SETTLES = 100, 20
DRIFT_M_S = 2e-6
LOAD_N, LOADS = 0.05, 12
LOAD_SHARE = 0.1
"""A load has LOAD_N or this share of the pinch force, whichever is less."""
MOST_HOLDING = 3
NEAR_M = 0.05
NEAR_CONTACTS_A_JOINT = 50
"""All that is so near to the ball is listed."""


@dataclass(frozen=True)
class Trial:
    """One load of one grasp."""

    simulated: Array
    """(6) displacement, m and rad."""
    formula: Array
    """(6) of the statics alone."""
    preloaded: Array
    """(6) of the statics with the contact forces."""
    branch_share: Array
    """(B) how much of the load each branch carries."""


@dataclass(frozen=True)
class Acceptance:
    """What the check found."""

    trials: tuple[Trial, ...]
    hand: Hand
    """The description with each branch's contact compliance as the engine has it."""
    grasps: int
    tried: int
    lost: int
    """Loads under which a contact was lost or the tool did not come to rest."""
    reasons: tuple[str, ...]
    """Why grasps were not made."""

    def errors(self, which: str) -> Array:
        """Relative errors (n): "formula" or "preloaded"."""
        simulated = np.array([t.simulated * SCALE for t in self.trials]).reshape(-1, 6)
        predicted = np.array([getattr(t, which) * SCALE for t in self.trials]).reshape(-1, 6)
        return np.linalg.norm(predicted - simulated, axis=1) / np.linalg.norm(simulated, axis=1)

    def by_branch(self) -> Array:
        """(B) mean error of the preloaded statics over loads, weighted by what each branch carries."""
        shares = np.array([t.branch_share for t in self.trials])
        return (self.errors("preloaded")[:, None] * shares).sum(0) / np.maximum(shares.sum(0), 1e-30)


def _scene(understood: Understood, radius_m: float, friction: float) -> tuple[str, str]:
    """The hand with a ball, the palm standing still, without gravity: the text, and what the ball is called."""
    root = copy.deepcopy(understood.root)
    set_options(root, gravity="0 0 0", contacts_a_joint=NEAR_CONTACTS_A_JOINT)
    _damp(root, understood.hand, understood.assets)
    ball = f"{understood.parts.prefix}ball"
    body = ET.SubElement(mjcf_tree.section(root, "worldbody"), "body", name=ball, pos="0 0 0")
    ET.SubElement(body, "freejoint", name=ball)
    inertia = f"{0.4 * TOOL_MASS_KG * radius_m**2:.9g}"
    ET.SubElement(body, "inertial", pos="0 0 0", mass=str(TOOL_MASS_KG), diaginertia=" ".join([inertia] * 3))
    geom = tool_geom(body, ball, f"{radius_m:.9g}", str(friction), str(TOOL_MASS_KG))
    for key in ("margin", "gap"):
        geom.set(key, str(NEAR_M))
    return mjcf_tree.text_of(root), ball


def _damp(root: ET.Element, hand: Hand, assets: dict[str, bytes]) -> None:
    """Damp every joint critically. Where it comes to rest does not depend on damping, when it does so does."""
    engine = _core.Engine(mjcf_tree.text_of(root), assets)
    numbers, inertia = engine.names("joint"), engine.model("dof_M0")[engine.model("jnt_dofadr")]
    joints = {e.get("name"): e for body in root.iter("body") for e in body if e.tag == "joint"}
    for branch in hand.branches:
        softest = np.linalg.eigvalsh(branch.stiffness())[
            0
        ]  # a coupled joint's own way may creep where others are stiff
        for coordinate in branch.coordinates:
            moved = inertia[numbers.index(coordinate.joint)] + TOOL_MASS_KG * LEVER_M**2
            joints[coordinate.joint].set("damping", repr(2 * float(np.sqrt(softest * moved))))
    for element in root.iter():
        bias = element.get("biasprm", "").split()
        if len(bias) > 2:
            element.set("biasprm", " ".join([*bias[:2], "0", *bias[3:]]))
        if element.tag in ("fixed", "spatial", "tendon"):
            element.attrib.pop("damping", None)


class _Bench:
    """The hand and a ball in the engine, H being the palm's frame."""

    def __init__(self, understood: Understood, radius_m: float) -> None:
        self.hand, self.radius = understood.hand, radius_m
        try:
            text, ball = _scene(understood, radius_m, FRICTION)
            self.engine = _core.Engine(text, understood.assets)
        except _core.MujocoError as error:
            raise AminnError(f"the hand cannot be simulated with a ball: {error}") from error
        names = {kind: self.engine.names(kind) for kind in ("body", "joint", "geom", "tendon", "actuator")}
        self.names = names
        array = self.engine.model
        address, dof = array("jnt_qposadr"), array("jnt_dofadr")
        numbers = [names["joint"].index(j) for j in self.hand.joints]
        self.qpos, self.dof = address[numbers], dof[numbers]
        tool = names["joint"].index(ball)
        self.tool_qpos, self.tool_dof = int(address[tool]), int(dof[tool])
        self.tool_body, self.palm = names["body"].index(ball), names["body"].index(understood.palm)
        self.branch_of = [next((b for b, t in enumerate(understood.tips) if g in t), -1) for g in names["geom"]]
        self.tool_geom = names["geom"].index(ball)
        self.nq, self.nv = len(array("qpos0")), len(array("dof_bodyid"))
        self.geom_type, self.geom_size = array("geom_type"), array("geom_size")
        self.servo = self._servos()
        self.engine.reset()
        self.engine.forward()
        self.palm_R = self.engine.data("xmat")[self.palm].reshape(3, 3)
        self.palm_p = self.engine.data("xpos")[self.palm]

    def _servos(self) -> list[tuple[int, int, float]]:
        """(actuator, kind of what it drives, gain) of everything with a position gain."""
        array = self.engine.model
        out = []
        for a in range(len(self.names["actuator"])):
            gain = -float(array("actuator_biasprm")[a][1]) if int(array("actuator_biastype")[a]) == 1 else 0.0
            out.append((a, int(array("actuator_trntype")[a]), gain))
        return out

    # --- frames
    def to_world(self, x: Array) -> Array:
        return self.palm_p + self.palm_R @ x

    def to_palm(self, x: Array) -> Array:
        return (x - self.palm_p) @ self.palm_R

    def tool_pose(self) -> tuple[Array, Array]:
        """Position and rotation matrix of the ball in H."""
        R = self.engine.data("xmat")[self.tool_body].reshape(3, 3)
        return self.to_palm(self.engine.data("xpos")[self.tool_body]), self.palm_R.T @ R

    def q(self) -> Array:
        return np.asarray(self.engine.data("qpos")[self.qpos])

    def pose(self, q: Array, centre: Array) -> None:
        """Put the hand into a posture with the ball at `centre` (H), at rest, commands where they hold it."""
        e = self.engine
        e.reset()
        qpos = np.zeros(self.nq)
        qpos[self.qpos] = q
        qpos[self.tool_qpos : self.tool_qpos + 3] = self.to_world(centre)
        qpos[self.tool_qpos + 3] = 1.0
        e.set("qpos", qpos)
        e.forward()
        length, gear = e.data("actuator_length"), e.model("actuator_gear")[:, 0]
        ranges = e.model("actuator_forcerange")
        limited = e.model("actuator_forcelimited")
        ctrl = np.zeros(len(self.servo))
        for a, kind, gain in self.servo:
            if gain <= 0:
                continue
            cable = kind == 3 and limited[a] and ranges[a][1] <= 0
            # force = gain (ctrl - length) as written by <position>; a cable is set to pull a little
            ctrl[a] = length[a] - (BASE_TENSION_N / gain if cable else 0.0) * np.sign(gear[a])
        ranges, limited = e.model("actuator_ctrlrange"), e.model("actuator_ctrllimited")
        ctrl = np.where(limited > 0, np.clip(ctrl, ranges[:, 0], ranges[:, 1]), ctrl)
        e.set("ctrl", ctrl)
        e.forward()

    def other_part(self) -> str:
        """Body of the hand that the ball runs into beside the fingertips, or ""."""
        e = self.engine
        for c in e.contacts(True):
            other = [g for g in c["geoms"] if g != self.tool_geom]
            if len(other) == 1 and self.branch_of[other[0]] < 0 and c["distance_m"] < 0:
                return self.names["body"][int(e.model("geom_bodyid")[other[0]])]
        return ""

    def own_contact(self) -> str:
        """Two bodies of the hand that touch each other, or ""."""
        bodies = self.engine.model("geom_bodyid")
        for c in self.engine.contacts():
            if self.tool_geom not in c["geoms"]:
                return " touches ".join(self.names["body"][int(bodies[g])] for g in c["geoms"])
        return ""

    def near(self) -> list[tuple[int, float, Array, Array]]:
        """(branch, gap m, point H, normal into the tool H) of every geom near the ball; branch -1: no tip."""
        out = []
        for c in self.engine.contacts(True):
            first, second = c["geoms"]
            if self.tool_geom not in (first, second):
                continue
            other = second if first == self.tool_geom else first
            normal = c["frame"][0] * (1.0 if second == self.tool_geom else -1.0)
            out.append((self.branch_of[other], float(c["distance_m"]), self.to_palm(c["point"]), normal @ self.palm_R))
        return out

    def closest(self) -> list[tuple[float, Array, Array] | None]:
        """Of each branch the nearest point: (gap, point, normal)."""
        best: list[tuple[float, Array, Array] | None] = [None] * len(self.hand.branches)
        for b, gap, point, normal in self.near():
            if b >= 0 and (best[b] is None or gap < best[b][0]):  # type: ignore[index]
                best[b] = (gap, point, normal)
        return best


def _chosen_sets(hand: Hand) -> list[tuple[int, ...]]:
    """Which branches hold the ball, grasp by grasp: all, and of more than three also three at a time."""
    numbers = range(len(hand.branches))
    groups = len({b.group for b in hand.branches})
    few = [s for s in combinations(numbers, MOST_HOLDING) if len({hand.branches[b].group for b in s}) == groups]
    return [tuple(numbers), *(few if len(hand.branches) > MOST_HOLDING else [])]


def _centre(hand: Hand, points: list[Array], chosen: tuple[int, ...]) -> Array:
    """Point as far from all chosen pads as it can be near the middle of the groups' middles (Gauss-Newton)."""
    points, branches = [points[b] for b in chosen], [hand.branches[b] for b in chosen]
    groups = list(dict.fromkeys(b.group for b in branches))
    means = [np.mean([p for p, b in zip(points, branches, strict=True) if b.group == g], axis=0) for g in groups]
    start = centre = np.mean(means, axis=0)
    for _ in range(20):
        ways = centre - np.array(points)
        distances = np.linalg.norm(ways, axis=1)
        rows = ways / np.maximum(distances, 1e-6)[:, None]
        rows = rows - rows.mean(0)
        spread = distances - distances.mean()
        matrix = rows.T @ rows + 0.05 * np.eye(3)
        centre = centre - np.linalg.solve(matrix, rows.T @ spread + 0.05 * (centre - start))
    return np.asarray(centre)


def _touch(bench: _Bench, q: Array, centre: Array, chosen: tuple[int, ...]) -> Array | None:
    """Angles at which the chosen tips just touch the ball at `centre`, from q; None where that is out of reach."""
    hand = bench.hand
    low, high = (
        np.array([getattr(c, n) for b in hand.branches for c in b.coordinates]) for n in ("low_rad", "high_rad")
    )
    for _ in range(60):
        bench.pose(q, centre)
        nearest = bench.closest()
        worst = 0.0
        for b in chosen:
            branch, at, found = hand.branches[b], hand.branch_joints[b], nearest[b]
            if found is None:  # too far for the engine to see: go towards the centre
                point = branch.moved(q[at], np.array(branch.tip_point_m))
                way = centre - point
                gap, normal = NEAR_M, way / max(float(np.linalg.norm(way)), 1e-9)
            else:
                gap, point, normal = found
            worst = max(worst, abs(gap))
            row = normal @ branch.jacobian(q[at], point)  # approach of the tip for unit rates
            soft = np.linalg.solve(branch.stiffness(), row)  # joints turn as they give way, so couplings hold
            step = soft * (gap / max(float(row @ soft), 1e-9))
            q[at] = q[at] + step * min(1.0, 0.15 / max(float(np.abs(step).max()), 1e-9))
        q = np.clip(q, low + 0.02, high - 0.02)
        if worst < 2e-6:
            return q
    return None


def _balance(contacts: list[tuple[float, Array, Array]], centre: Array, pinch_N: float) -> Array | None:
    """Contact forces (B, 3) on the tool in balance, near `pinch_N` along the normals; None where friction forbids."""
    n = len(contacts)
    maps = np.concatenate([np.concatenate([np.eye(3), skew(p - centre)]) for _, p, _ in contacts], 1)  # (6, 3B)
    wanted = np.concatenate([pinch_N * normal for _, _, normal in contacts])
    forces = wanted - np.linalg.pinv(maps, rcond=1e-9) @ (maps @ wanted)
    if np.abs(maps @ forces).max() > 1e-6 * pinch_N:
        return None
    rows = forces.reshape(n, 3)
    along = np.array([f @ normal for f, (_, _, normal) in zip(rows, contacts, strict=True)])
    across = np.linalg.norm(rows - along[:, None] * np.array([c[2] for c in contacts]), axis=1)
    if along.min() < 0.2 * pinch_N or (across > CONE_SHARE * FRICTION * along).any():
        return None
    return np.asarray(rows * (pinch_N / along.mean()))


def _press(bench: _Bench, forces: dict[int, Array], points: dict[int, Array]) -> None:
    """Constant joint torques with which tips press on the tool with `forces`, whatever springs and servos do there."""
    e, hand = bench.engine, bench.hand
    e.forward()
    given = e.data("qfrc_passive") + e.data("qfrc_actuator") + e.data("qfrc_constraint")  # the latter of couplings
    torque = np.zeros(bench.nv)
    for b, (branch, at) in enumerate(zip(hand.branches, hand.branch_joints, strict=True)):
        dof = bench.dof[at]
        body = bench.names["body"].index(branch.tip)
        jacobian = e.jacobian(body, bench.to_world(points.get(b, np.zeros(3))))[:, dof]
        torque[dof] = jacobian.T @ (bench.palm_R @ forces[b]) - given[dof] if b in forces else -given[dof]
    e.set("qfrc_applied", torque)


def _at_rest(bench: _Bench, w_e: Array) -> bool:
    """Step under a load (6, H) until the tool rests."""
    e = bench.engine
    xfrc = np.zeros((len(bench.names["body"]), 6))
    p, _ = bench.tool_pose()
    for k in range(MOST_SETTLES):
        share = min(1.0, (k + 1) / 2)
        xfrc[bench.tool_body] = np.concatenate([bench.palm_R @ w_e[:3], bench.palm_R @ w_e[3:]]) * share
        e.set("xfrc_applied", xfrc.ravel())
        if not e.step(SETTLE_STEPS):
            return False
        now, _ = bench.tool_pose()
        drift = float(np.linalg.norm(now - p)) / (SETTLE_STEPS * TIMESTEP_S)
        p = now
        if k >= 2 and drift < DRIFT_M_S:
            return True
    return False


def _contacts(bench: _Bench, chosen: tuple[int, ...]) -> dict[int, Contact] | None:
    """The settled contacts by branch; None unless each chosen branch has one and nothing else touches."""
    e = bench.engine
    out: dict[int, Contact] = {}
    e.forward()
    regulariser, kbip = e.data("efc_R"), e.data("efc_KBIP")
    for c in e.contacts():
        first, second = c["geoms"]
        if bench.tool_geom not in (first, second):
            return None
        other = second if first == bench.tool_geom else first
        b = bench.branch_of[other]
        if b not in chosen or b in out:
            return None
        sign = 1.0 if second == bench.tool_geom else -1.0
        frame = c["frame"] @ bench.palm_R  # rows: normal, two tangents, H
        at = c["efc_address"]
        eps = regulariser[at] / (kbip[at][0] * kbip[at][2])
        normal = frame[0] * sign
        out[b] = Contact(
            bench.to_palm(c["point"]),
            normal,
            sign * (c["force"] @ frame),
            float(eps),
            _curvature(bench, other, bench.to_palm(c["point"])) + tangential(normal) / bench.radius,
        )
    return {b: out[b] for b in chosen} if len(out) == len(chosen) else None


def _curvature(bench: _Bench, geom: int, point: Array) -> Array:
    """(3, 3) of a fingertip's surface at a point, H."""
    e = bench.engine
    R = bench.palm_R.T @ e.data("geom_xmat")[geom].reshape(3, 3)
    position = bench.to_palm(e.data("geom_xpos")[geom])
    return surface_curvature(int(bench.geom_type[geom]), bench.geom_size[geom], position, R, point)


def _displacement(before: tuple[Array, Array], after: tuple[Array, Array]) -> Array:
    (p, R), (p_after, R_after) = before, after
    D = R_after @ R.T
    angle = np.arccos(np.clip((np.trace(D) - 1) / 2, -1, 1))
    axis = np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]) / 2
    sine = float(np.linalg.norm(axis))
    return np.concatenate([p_after - p, axis * (angle / sine if sine > 0 else 1.0)])


def _held(contacts: Iterable[Contact], centre: Array) -> Array:
    """(6, 6) takes the motion that no contact resists out of a displacement: the spin of a ball between two points."""
    maps = np.concatenate([np.concatenate([np.eye(3), skew(c.point - centre) / ARM_M]) for c in contacts], 1)
    return np.asarray((maps @ np.linalg.pinv(maps, rcond=1e-6)) / SCALE[:, None] * SCALE)


def _draw_load(rng: np.random.Generator, contacts: Iterable[Contact], centre: Array, most_N: float) -> Array:
    """A small load (6) that point contacts can carry."""
    w = rng.normal(size=6) * np.array([1, 1, 1, 0.03, 0.03, 0.03])
    maps = np.concatenate([np.concatenate([np.eye(3), skew(c.point - centre) / ARM_M]) for c in contacts], 1)
    scaled = w / SCALE
    scaled = maps @ np.linalg.pinv(maps, rcond=1e-6) @ scaled
    w = scaled * SCALE
    return w * (most_N / max(float(np.linalg.norm(w[:3])), float(np.linalg.norm(w[3:])) / 0.03))


def _grasp(
    bench: _Bench, rng: np.random.Generator, understood: Understood, pinch_N: float, chosen: tuple[int, ...]
) -> str:
    """Hold a ball with the chosen branches; why that failed, or ""."""
    hand = bench.hand
    start, end = understood.postures
    q = hand.coupled(start + rng.uniform(0.3, 0.7) * (end - start))
    for b, at in enumerate(hand.branch_joints):
        if b not in chosen:
            q[at] = hand.coupled(start)[at]  # out of the way
    tips = list(hand.tips(q))
    centre = _centre(hand, tips, chosen) + rng.uniform(-0.15, 0.15, 3) * bench.radius
    found = _touch(bench, q, centre, chosen)
    if found is None:
        return "not every fingertip reaches the ball"
    bench.pose(found, centre)
    if part := bench.other_part():
        return f"the ball touches {part}"
    if pair := bench.own_contact():
        return pair
    nearest = {b: c for b, c in enumerate(bench.closest()) if b in chosen and c is not None}
    forces = _balance(list(nearest.values()), centre, pinch_N)
    if forces is None:
        return "the fingertips' forces cannot balance on the ball"
    _press(bench, dict(zip(nearest, forces, strict=True)), {b: c[1] for b, c in nearest.items()})
    return "" if _at_rest(bench, np.zeros(6)) else "the ball does not come to rest"


def accept(
    understood: Understood,
    pinch_N: float = 0.5,
    grasps: int = 16,
    seed: int = 0,
    attempts: int = 12,
    progress: Callable[[int], object] = lambda done: None,
) -> Acceptance:
    """Make `grasps` light grasps of a ball and load each `LOADS` times; `pinch_N` is the mean force of a contact, N.

    Raises AminnError where no grasp can be made.
    """
    rng = np.random.default_rng(seed)
    hand = understood.hand
    found = _Found([], [[] for _ in hand.branches])
    sets = _chosen_sets(hand)
    benches: dict[tuple[int, ...], _Bench] = {}
    made = tried = misses = 0
    while made < grasps and tried < attempts * grasps and len(sets) > 0:
        chosen = sets[tried % len(sets)]
        tried += 1
        if chosen not in benches:
            benches[chosen] = _Bench(understood, _radius(understood, chosen))
        bench = benches[chosen]
        why = _grasp(bench, rng, understood, pinch_N, chosen)
        contacts = _contacts(bench, chosen) if not why else None
        if contacts is None:
            found.reasons.append(why or "a fingertip lost the ball, or touched it twice")
            misses += 1
            if misses >= attempts * len(sets) and not made:
                break
            continue
        made += 1
        _load(bench, rng, contacts, pinch_N, found)
        progress(made)
    if not found.trials:
        often = max(set(found.reasons), key=found.reasons.count) if found.reasons else "every load lost a contact"
        raise AminnError(
            f"hand {hand.name}: no ball could be held at {pinch_N:g} N a contact in {tried} attempts (most "
            f"often: {often}); tell [closing] postures in which the fingertips face each other, pad points "
            "(branch.point) or a smaller --pinch"
        )
    branches = tuple(
        replace(b, eps_m=float(np.mean(e))) if e else b for b, e in zip(hand.branches, found.eps_m, strict=True)
    )
    return Acceptance(
        tuple(found.trials), replace(hand, branches=branches), made, tried, found.lost, tuple(found.reasons)
    )


@dataclass
class _Found:
    """What the grasps so far gave."""

    trials: list[Trial]
    eps_m: list[list[float]]
    lost: int = 0
    reasons: list[str] = field(default_factory=list)


def _load(bench: _Bench, rng: np.random.Generator, contacts: dict[int, Contact], pinch_N: float, found: _Found) -> None:
    """Load a settled grasp `LOADS` times, each time from the same state."""
    points = replace(bench.hand.contact, kind="point")  # as which the ball is held, however soft the fingertips are
    hand, q = replace(bench.hand, contact=points), bench.q()
    centre, R = bench.tool_pose()
    for b, c in contacts.items():
        found.eps_m[b].append(c.compliance_m_N)
    state = {name: bench.engine.data(name) for name in ("qpos", "qvel")}
    held = _held(contacts.values(), centre)
    for _ in range(LOADS):
        w_e = _draw_load(rng, contacts.values(), centre, min(LOAD_N, LOAD_SHARE * pinch_N))
        for name, value in state.items():
            bench.engine.set(name, value)
        if not _at_rest(bench, w_e) or _contacts(bench, tuple(contacts)) is None:
            found.lost += 1
            continue
        simulated = held @ _displacement((centre, R), bench.tool_pose())
        formula, preloaded = (held @ displacement(hand, q, centre, contacts, w_e, p) for p in (False, True))
        found.trials.append(Trial(simulated, formula, preloaded, _shares(hand, q, centre, contacts, w_e)))


def _shares(hand: Hand, q: Array, centre: Array, contacts: dict[int, Contact], w_e: Array) -> Array:
    """(B) share of each branch in the change of contact forces under a load."""
    size = np.zeros(len(hand.branches))
    dx = displacement(hand, q, centre, contacts, w_e, False)
    for b, c in contacts.items():
        branch = hand.branches[b]
        B = branch.jacobian(q[hand.branch_joints[b]], c.point)
        give = B @ np.linalg.solve(branch.stiffness(), B.T) + c.compliance_m_N * np.eye(3)
        A = np.concatenate([np.eye(3), -skew(c.point - centre)], 1)
        size[b] = np.linalg.norm(np.linalg.solve(give, A @ dx))
    return size / max(float(size.sum()), 1e-30)


def _radius(understood: Understood, chosen: tuple[int, ...]) -> float:
    """Of a ball that fits between the chosen fingertips half way of closing, with room for their thickness."""
    hand = understood.hand
    q = hand.coupled(0.5 * (understood.postures[0] + understood.postures[1]))
    tips = list(hand.tips(q))
    centre = _centre(hand, tips, chosen)
    return float(np.clip(0.75 * min(np.linalg.norm(tips[b] - centre) for b in chosen), 0.008, 0.05))
