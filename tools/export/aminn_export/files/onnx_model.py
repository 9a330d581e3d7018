"""Writes `aminn.onnx` and `aminn_debug.onnx` from an exported model's tables.

The graph is built by hand, of standard operators only. Both stages have the same architecture, so they run as one
graph with a leading stage dimension of 2: half the nodes, and at batch 1 the number of nodes is what ONNX Runtime's
time depends on. ONNX has no factorisation and no solve. As in the C runtime, no stiffness matrix is formed before it is
solved with: K_x = V^T V with V the branches' contributions stacked, and Gram-Schmidt on V keeps the accuracy of float32
that an elimination of K_x would square away. Shapes stand on their lines; S is the stage dimension (2), N the batch, B
the branches, C the coordinates of the longest one, J the joints. A hand without gates has no second pass.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from aminn.prediction.onnx_session import FILE_HASH, HASH_MARK
from aminn_base.errors import AminnError
from aminn_base.files import write_atomically
from aminn_base.read import AnyPath, read_bytes
from aminn_base.seal import DIGITS, sealed_bytes
from aminn_hand.hand import LEAST_MOTION_M, MAX_LOG_BOUND, N_CONTACT_FEATURE, N_WRENCH
from aminn_hand.sensors import FRICTION_CLASSES, FRICTION_SPREAD

from .head import EXP, TANH, head_order, sizes
from .layout import widths_of
from .onnx_graph import GraphBuilder
from .onnx_slide import Grip, Rows, Slid, SlideGraph
from .tables import HAND, STAGES, Exported, by_branch, dims_of, pair_of, shortest

ONNX_FILE, DEBUG_FILE = "aminn.onnx", "aminn_debug.onnx"
OPSET = 18
IR_VERSION = 8
# The adjugate of a lower triangular 3x3 L as signed products of packed entries: (left, right, sign, row, column).
CHOL_ADJUGATE = (
    (1, 2, 1, 0, 0),
    (3, 2, -1, 1, 0),
    (0, 2, 1, 1, 1),
    (3, 5, 1, 2, 0),
    (4, 1, -1, 2, 0),
    (0, 5, -1, 2, 1),
    (0, 1, 1, 2, 2),
)
POSITIVE_NAMES = {"diagonal": "chol_diag", "gain": "tendon_gain_col", "alpha": "alpha", "twist": "twist"}
LOOSE_NAMES = {"direction": "head_dir", "beta": "head_beta", "rho": "head_rho", "preload": "head_preload"}
SQUASHED_NAMES = {"below": "squashed_off", "friction": "squashed_friction"}
PRELOAD_N, FORCE_N, MOMENT_NM = 0.7, 0.3, 0.008
"""Standard deviations of the forces that carry the tool's weight across the normals, and of what they leave of it."""
UNITS = {
    "q": "rad",
    "x_ht": "m, rad (rotation vector)",
    "w_e": "N, N.m",
    "contacts": "1, m (3), 1 (3), N",
    "j_x": "1, m",
    "j_q": "m/rad",
    "theta": "1 (logarithms of factors), rad, m",
    "friction": "1 (known, coefficient, its standard deviation)",
    "tool_weight": "1 (known), N",
    "tendon_tension": "1 (known), N",
    "p_stable": "1",
    "dx_ht": "m, rad (rotation vector)",
    "k_x": "N/m, N/rad, N.m/rad",
    "gate": "1",
    "p_slide": "1",
    "bound_95": "1 (translation over length_scale_m, rad)",
    "friction_use": "1",
    "eps_m": "m/N",
    "eps_kx": "N/m (translation), N.m/rad (rotation)",
    "eps_jq": "m/rad",
}

HAND_KEYS = {
    "joint_order": "joints",
    "branch_order": "branches",
    "hand": HAND,
    "theta_names": "theta_names",
    "theta_units": "theta_units",
}
"""Metadata that names the hand, and what the exporter calls it."""

Array = NDArray[np.float32]


def _flat(value: object) -> float | list[float]:
    """The metadata form of such a constant: a pair where the stages differ, else a number."""
    first, second = pair_of(value)
    return first if first == second else [first, second]


def onnx_metadata(meta: dict) -> dict[str, str]:
    """Metadata of the model file: every value is JSON, floats in their shortest exact form."""
    values = {
        "format_version": meta["format_version"],
        "checkpoint_sha256": meta["checkpoint_sha256"],
        "units": UNITS,
        "tau": meta["tau"],
        "eps_m": shortest(by_branch(meta["eps_m"], len(meta["branch_joints"]))),
        "eps_kx": _flat(meta["eps_kx"]),
        "eps_jq": _flat(meta["eps_jq"]),
        "dq0": meta["dq0"],
        "length_scale_m": meta["length_scale"],
        "log_range": meta["log_range"],
        "told": bool(meta.get("told", False)),
        "friction": "secant" if meta.get("slides") else "none",
        "sensors": bool(meta.get("sensing", False)),
        "motion_limits": [meta["max_translation"], meta["max_rotation"]] if meta.get("slides") else None,
        "friction_classes": {name: list(values) for name, values in FRICTION_CLASSES.items()},
        "branch_joints": [list(row) for row in meta["branch_joints"]],
    }
    # a binary model does not hold them
    values |= {key: meta[own] for key, own in HAND_KEYS.items() if own in meta}
    return {key: json.dumps(value, sort_keys=True) for key, value in values.items()}


def read_metadata(path: AnyPath) -> dict:
    """The metadata of an ONNX file, decoded. Raises AminnError where it is none, or they are no JSON."""
    return {key: json.loads(value) for key, value in metadata_in(path, parsed(path, read_bytes(path))).items()}


def parsed(path: AnyPath, content: bytes) -> onnx.ModelProto:
    """The model in the content of a file. Raises AminnError where it is none."""
    try:
        return onnx.load_model_from_string(content)
    except Exception as error:  # protobuf's own, which has no common base
        raise AminnError(f"{path}: not an ONNX model ({error})") from error


def metadata_in(path: AnyPath, model: onnx.ModelProto) -> dict[str, str]:
    """JSON texts of a model's metadata. Raises AminnError where they are none."""
    try:
        texts = {p.key: p.value for p in model.metadata_props}
        if not all(isinstance(text, str) for pair in texts.items() for text in pair):
            raise ValueError("not UTF-8")  # what protobuf gives as bytes
        for text in texts.values():
            json.loads(text)
    except (ValueError, RecursionError) as error:  # also of bytes that are not UTF-8
        raise AminnError(f"{path}: its metadata are no JSON texts ({error}); export the model again") from error
    return texts


def _adjugate_tables() -> tuple[list[int], Array]:
    """Picks and signs that turn a flat 3x3 matrix m into its adjugate.

    The picks are 18 left factors, 18 right factors and the first column (for the determinant); the (18, 9) matrix adds
    the products with their signs. Row i of the adjugate is the cross product of the columns i+1 and i+2.
    """
    left: list[int] = []
    right: list[int] = []
    signs = np.zeros((18, 9), np.float32)
    for i in range(3):
        b, c = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            y, z = (j + 1) % 3, (j + 2) % 3
            for sign, p, r in ((1, y, z), (-1, z, y)):
                signs[len(left), 3 * i + j] = sign
                left.append(3 * p + b)
                right.append(3 * r + c)
    return [*left, *right, 0, 3, 6], signs


_OF_TRUNK = {"trunk1_w": (0,), "trunk1_b": (0,), "trunk2_w": (0, 1), "trunk2_b": (0,), "head_w": (1,)}
"""Axes of a stage's tables that are as long as its trunk is wide."""


def _evenly_wide(exported: Exported) -> dict[str, NDArray[Any]]:
    """The tables of both stages as wide as the wider one's, so that they stack: what is added is zero."""
    widths, tensors = widths_of(exported.meta), dict(exported.tensors)
    wide = max(widths.trunks)
    for stage, width, last in zip(STAGES, widths.trunks, ("cls1_w", "sure_w"), strict=True):
        for field, axes in (_OF_TRUNK | {last: (1,)}).items():
            for axis in axes:
                name = f"{stage}.{field}"
                tensors[name] = np.insert(tensors[name], [width] * (wide - width), 0, axis)
    return tensors


class _AminnGraph:
    """Builds the graph of one exported model; each method adds the nodes of one step."""

    def __init__(self, exported: Exported) -> None:
        self.meta, self.tensors, self.g = exported.meta, _evenly_wide(exported), GraphBuilder()
        self.dims = dims_of(self)
        length = float(self.meta["length_scale"])
        self.scale = np.array([1.0] * 3 + [1.0 / length] * 3, np.float32)
        self.s = self.g.constant("length_scaling", self.scale)
        gain = self.tensors.get("tendon_gain_nom", np.zeros(self.dims.branches, np.float32))
        self.has_tendon = (gain > 0)[:, None].astype(np.float32)  # (B, 1)
        self.told: dict[str, str] = {}
        """Of a told model what theta makes of nominal tables: chol (N, B, K), tendon_gain, twist (N, B, 1), root_soft
        (N, B, 1, 1), and the factors that networks see (N, F)."""
        self.sensed: dict[str, str] = {}
        """Of a model that sees sensors: seen (N, E), log_friction (N, 1), how much it is known to differ from nominal,
        weight (N, 4)."""

    def both(self, name: str) -> Array:
        """A table of both stages, stacked: (2, ...)."""
        return np.stack([self.tensors[f"{stage}.{name}"] for stage in STAGES])

    def slog(self, v: str, scale: Array | np.float32, name: str) -> str:
        """sign(v) log(1 + |v| / scale)."""
        g = self.g
        log = self.log1p(g.op("Abs", v, name=f"{name}_abs"), scale, name)
        return g.op("Mul", g.op("Sign", v, name=f"{name}_sign"), log, name=name)

    def log1p(self, v: str, scale: Array | np.float32, name: str) -> str:
        """log(1 + v / scale)."""
        g = self.g
        ratio = g.op("Div", v, g.constant(f"{name}_scale", scale), name=f"{name}_ratio")
        return g.op("Log", g.op("Add", ratio, g.constant("one", 1.0), name=f"{name}_plus1"), name=f"{name}_log")

    def normalised(self, v: str, mean: Array, inv_std: Array, name: str) -> str:
        """(v - mean) * inv_std."""
        g = self.g
        centred = g.op("Sub", v, g.constant(f"{name}_mean", mean), name=f"{name}_centred")
        return g.op("Mul", centred, g.constant(f"{name}_inv_std", inv_std), name=name)

    def linear(self, v: str, weight: Array, bias: Array, name: str) -> str:
        """weight v + bias for weights [..., out, in]."""
        g = self.g
        product = g.op("MatMul", v, g.constant(f"{name}_w", np.swapaxes(weight, -1, -2)), name=f"{name}_product")
        return g.op("Add", product, g.constant(f"{name}_b", bias), name=name)

    def dense(self, v: str, weight: Array, bias: Array, name: str) -> str:
        """relu(weight v + bias)."""
        return self.g.op("Relu", self.linear(v, weight, bias, f"{name}_linear"), name=name)

    def contact_input(self) -> tuple[str, str]:
        """(contact flags (N, B, 1), input of the contact summary); A S (N, B, 18) is kept for the closure.

        j_x passes through the rows that contacts and j_q are joined in: Concat refuses a batch of another size, which
        every product with j_x would repeat in silence where it is 1.
        """
        g, n_q, n_x = self.g, 3 * self.dims.coordinates, 3 * N_WRENCH
        blocks = [g.reshape(name, [0, 0, size], f"{name}_rows") for name, size in (("j_q", n_q), ("j_x", n_x))]
        rows = g.op("Concat", "contacts", *blocks, name="contact_rows", axis=2)  # (N, B, 8 + 3 C + 18)
        pieces = [1, N_CONTACT_FEATURE - 1 + n_q, n_x]
        flag, self.contact_raw, a = g.split(rows, pieces, 2, ["contact", "contact_raw", "a_rows"])
        self.a_s_rows = g.op("Mul", a, g.constant("a_scaling", np.tile(self.scale, 3)), name="a_scaled")
        seen = g.op("Mul", flag, self.contact_raw, name="contact_seen")
        u = g.op("Concat", flag, seen, name="contact_features", axis=2)  # (N, B, 8 + 3 C)
        return flag, g.reshape(u, [0, self.dims.contact_input], "z_c")

    def features(self, z_c: str) -> str:
        """f of both stages (S, N, H)."""
        g, both = self.g, self.both
        log = self.slog("w_e", self.tensors["wrench_log_scale"], "w_log")  # (N, 6)
        seen = [self.told["factors"]] if self.told else []
        seen += [self.sensed["seen"]] if self.sensed else []
        z_g = g.op("Concat", "q", "x_ht", "w_e", log, *seen, name="z_g", axis=1)  # (N, G)
        row = (slice(None), None)
        c = self.normalised(z_c, both("contact_mean")[row], both("contact_inv_std")[row], "z_c_norm")  # (S, N, Z)
        z = self.normalised(z_g, both("global_mean")[row], both("global_inv_std")[row], "z_g_norm")  # (S, N, G)
        h1 = self.dense(c, both("contact_w"), both("contact_b")[row], "h1")  # (S, N, HC)
        joined = g.op("Concat", h1, z, name="h1_z_g", axis=2)  # (S, N, HC + G)
        h2 = self.dense(joined, both("trunk1_w"), both("trunk1_b")[row], "h2")  # (S, N, H)
        return self.dense(h2, both("trunk2_w"), both("trunk2_b")[row], "f")  # (S, N, H)

    def whitened_terms(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """W (S, B, K) = L^-1 T L^-T of what each stiffness adds to springs L L^T; the map (B, K, K) from M to L M."""
        t, dims = self.tensors, self.dims
        rows, cols = np.transpose(dims.cholesky_entries)
        shape = (dims.branches, dims.coordinates, dims.coordinates)
        lower, terms = np.zeros(shape), np.zeros((dims.stiff, *shape))
        lower[:, rows, cols] = t["chol_nom"]
        terms[..., rows, cols] = terms[..., cols, rows] = t["theta_terms"][1:, :, :-1]
        half = np.linalg.solve(lower, terms)
        white = np.linalg.solve(lower, np.swapaxes(half, -1, -2))
        product = np.zeros((dims.branches, dims.cholesky, dims.cholesky))
        for k, (row, col) in enumerate(dims.cholesky_entries):
            for out, (i, j) in enumerate(dims.cholesky_entries):
                product[:, k, out] = lower[:, i, row] if j == col else 0.0
        return np.asarray(white[..., rows, cols], float), product

    def cholesky(self, packed: str) -> str:
        """The packed Cholesky factor of packed matrices (N, B, K), written out."""
        g, entries = self.g, self.dims.cholesky_entries
        a = g.split(packed, [1] * len(entries), 2, [f"theta_a{i}{j}" for i, j in entries])
        known, m = dict(zip(entries, a, strict=True)), dict[tuple[int, int], str]()
        for i, j in sorted(entries):
            left = known[i, j]
            for k in range(j):
                product = g.op("Mul", m[i, k], m[j, k], name=f"theta_p{i}{j}{k}")
                left = g.op("Sub", left, product, name=f"theta_left{i}{j}{k}")
            name = f"theta_m{i}{j}"
            m[i, j] = g.op("Sqrt", left, name=name) if i == j else g.op("Div", left, m[j, j], name=name)
        return g.op("Concat", *(m[entry] for entry in entries), name="theta_m", axis=2) if len(m) > 1 else m[0, 0]

    def tell(self) -> None:
        """What theta makes of nominal tables, from the input theta, which is the same for all where it has one row."""
        g, t, dims = self.g, self.tensors, self.dims
        branches, n = dims.branches, dims.cholesky
        batch = g.op("Shape", "q", name="theta_batch", start=0, end=1)
        rows = g.op("Concat", batch, g.index("one_row", [1]), name="theta_rows", axis=0)
        every = g.op("Expand", "theta", rows, name="theta_of_each")  # (N, P)
        factors, _ = g.split(every, [dims.factors, dims.joints + 1], 1, ["theta_factors", "theta_reading"])
        stiff, soft = g.split(factors, [dims.stiff, branches], 1, ["theta_stiff", "theta_soft"])
        one = g.constant("one", 1.0)
        added = g.op("Sub", g.op("Exp", stiff, name="theta_factor"), one, name="theta_added")  # (N, S)
        white, product = self.whitened_terms()
        terms = np.concatenate([white, t["theta_terms"][1:, :, -1:]], -1).reshape(dims.stiff, branches * (n + 1))
        moved = g.op("MatMul", added, g.constant("theta_terms", terms), name="theta_sums")
        each = g.reshape(moved, [0, branches, n + 1], "theta_by_branch")
        springs, gain = g.split(each, [n, 1], 2, ["theta_springs", "theta_gain"])
        eye = np.array([float(i == j) for i, j in dims.cholesky_entries])
        m = self.cholesky(g.op("Add", springs, g.constant("theta_eye", eye), name="theta_a"))
        chol = g.op(
            "MatMul", g.unsqueeze(m, [2], "theta_m_row"), g.constant("theta_product", product), name="theta_chol_row"
        )
        softer = g.reshape(g.op("Exp", soft, name="theta_softer"), [0, branches, 1], "theta_softer_col")
        half = g.op("Mul", soft, g.constant("half", 0.5), name="theta_half_soft")
        root_soft = g.reshape(g.op("Exp", half, name="theta_root_soft"), [0, branches, 1, 1], "theta_root_soft_col")
        self.told = dict(factors=factors, chol=g.reshape(chol, [0, branches, n], "theta_chol"), root_soft=root_soft)
        if dims.gates:
            nominal = g.constant("tendon_gain_nom", t["tendon_gain_nom"][:, None])
            self.told["tendon_gain"] = g.op("Add", nominal, gain, name="theta_tendon_gain")
        if dims.twist:
            nominal = g.constant("twist_nom", t["twist_nom"][:, None])
            self.told["twist"] = g.op("Div", nominal, softer, name="theta_twist")

    def batch_checked(self, v: str, shape: tuple[int, ...], name: str) -> str:
        """v, of all inputs joined, as (S, N, *shape), N the smallest of their batches; fails if v has more.

        Concat refuses batches of different sizes, but need not refuse an empty one among others.
        """
        g = self.g
        sizes = [g.op("Shape", i, name=f"{i}_batch", start=0, end=1) for i in self.dims.inputs]
        smallest = g.op("Min", *sizes, name="batch")
        self.batch = smallest
        wanted = g.op("Concat", g.index("stages", [len(STAGES)]), smallest, g.index("row", shape), name="rows", axis=0)
        return g.op("Reshape", v, wanted, name=name, allowzero=1)

    def head(self, f: str) -> list[str]:
        """(S, N, B, .): what tanh has squashed, of the parts TANH; then each of the other parts there is."""
        g, dims = self.g, self.dims
        order = np.concatenate([dims.branch_head * b + head_order(dims) for b in range(dims.branches)])
        weight, bias = self.both("head_w")[:, order], self.both("head_b")[:, None, order]
        rows = (dims.branches, dims.branch_head)
        y = self.batch_checked(self.linear(f, weight, bias, "head"), rows, "head_rows")  # (S, N, B, n)
        loose = [part for part in ("direction", "beta", "rho", "preload") if part in dims.head_parts]
        if not loose:
            return [g.op("Tanh", y, name="squashed")]
        pieces = [sum(sizes(dims, TANH)), *sizes(dims, tuple(loose))]
        raw, *rest = g.split(y, pieces, 3, ["head_tanh", *(LOOSE_NAMES[part] for part in loose)])
        return [g.op("Tanh", raw, name="squashed"), *rest]

    def springs(self, f: str) -> dict[str, str]:
        """The packed Cholesky factor of the springs of both stages (S, N, B, .), and of tendons what there is.

        alpha, beta, rho, gain are (S, N, B, 1), tendon_dir is (S, N, B, C).
        """
        g, t, dims = self.g, self.tensors, self.dims
        squashed, *loose = self.head(f)
        mask, c = t["coord_mask"], dims.coordinates
        ones = np.ones((dims.branches, 1), np.float32)
        reach, nominal = [mask], [t["chol_nom"][:, :c]]
        if dims.gates:
            reach += [ones, ones]
            nominal += [t["tendon_gain_nom"][:, None], t["gate_nom"][0] * ones]
        if dims.twist:
            reach += [2 * ones]
            nominal += [t["twist_nom"][:, None]]
        in_exp, off, friction = squashed, "", ""
        others = [name for name, there in (("below", c > 1), ("friction", dims.slides)) if there]
        if others:
            pieces = [sum(sizes(dims, EXP)), *sizes(dims, tuple(others))]
            in_exp, *found_others = g.split(squashed, pieces, 3, ["squashed_exp", *(SQUASHED_NAMES[n] for n in others)])
            off, friction = (dict(zip(others, found_others, strict=True)).get(n, "") for n in ("below", "friction"))
        log_reach = np.float32(self.meta["log_range"]) * np.concatenate(reach, 1)  # (B, C + 3)
        factor = g.op("Exp", g.op("Mul", in_exp, g.constant("log_reach", log_reach), name="log_factor"), name="factor")
        if self.told:
            centre = self.told_positive()
        else:
            centre = g.constant("nominal_positive", np.concatenate(nominal, 1))
        positive = g.op("Mul", factor, centre, name="positive")  # (S, N, B, C + 3)
        diag, rest = positive, []
        if dims.gates or dims.twist:
            names = [POSITIVE_NAMES[part] for part in EXP if part in dims.head_parts]
            diag, *rest = g.split(positive, sizes(dims, EXP), 3, names)
        found = dict(chol=self.chol_packed(diag, off), diagonal=diag)
        if dims.slides:
            found |= self.grip(friction, loose.pop())
        if dims.twist:
            found["twist"] = rest.pop()
        if not dims.gates:
            return found
        d, be, rh = loose
        gain, alpha = rest
        direction = self.unit(
            g.op("Add", d, g.constant("tendon_dir_nom", t["tendon_dir_nom"]), name="dir_raw"), mask * self.has_tendon
        )
        beta = g.op("Mul", be, g.constant("beta_scale", t["gate_nom"][1]), name="beta")
        rho = g.op("Add", rh, g.constant("rho_nom", t["gate_nom"][2]), name="rho")
        return found | dict(tendon_dir=direction, gain=gain, alpha=alpha, beta=beta, rho=rho)

    def grip(self, squashed: str, raw: str) -> dict[str, str]:
        """Friction (S, N, B, 1) and tangential preload (S, N, B, 3), N, of the contacts."""
        g = self.g
        log = squashed
        if self.sensed:
            told = g.unsqueeze(self.sensed["log_friction"], [2], "told_log_friction")  # (N, 1, 1)
            log = g.op("Add", squashed, told, name="log_friction")
        nominal = g.constant("friction_nominal", self.meta["friction_nominal"])
        friction = g.op("Mul", g.op("Exp", log, name="friction_factor"), nominal, name="mu")
        force = raw
        if self.sensed:
            force = g.op("Add", raw, self.carried(), name="preload_both")
        along = g.reduce_sum(g.op("Mul", force, self.normal, name="preload_along_terms"), 3, "preload_along")
        across = g.op("Sub", force, g.op("Mul", along, self.normal, name="preload_along_normal"), name="preload_across")
        return dict(friction=friction, preload=g.op("Mul", across, self.flag, name="preload"))

    def carried(self) -> str:
        """Forces (N, B, 3) across normals that carry the tool's weight, if it is known, by least squares.

        The system is rows^T rows, of a row for each direction across a normal and of the ridge; Gram-Schmidt solves it.
        """
        g, branches = self.g, self.dims.branches
        outer = g.op("Mul", g.unsqueeze(self.normal, [3], "n_col"), g.unsqueeze(self.normal, [2], "n_row"), name="n_n")
        across = g.op("Sub", g.constant("eye3", np.eye(3)), outer, name="n_across")  # (N, B, 3, 3)
        rows = g.op("MatMul", across, self.a_s, name="weight_rows")  # (N, B, 3, 6) sqrt(c) P A S
        spread = np.repeat([FORCE_N, MOMENT_NM / float(self.meta["length_scale"])], 3) / PRELOAD_N
        flat_t = self.transposed(
            g.reshape(rows, [0, 3 * branches, N_WRENCH], "weight_flat"), "weight_t", 3
        )  # (N, 6, 3 B)
        v_t = self.beside(flat_t, 3 * branches, np.diag(spread)[None], "weight_v_t")
        last, done = self.gram_schmidt(v_t, N_WRENCH, 1, "weight_v")
        v = g.op("Concat", *done, last, name="weight_v", axis=1)
        squares = self.squares(v, 2, "weight_v")  # (N, 6, 1)
        _, tail = g.split(v, [3 * branches, N_WRENCH], 2, ["weight_head", "weight_tail"])
        unit = g.op("Mul", tail, g.constant("weight_scale", 1 / spread), name="weight_unit")  # (N, 6, 6)
        held = g.op("Mul", self.force, self.root_flag, name="weight_force")  # (N, B, 1) sqrt(c) N
        pressing = g.op("Mul", held, self.normal, name="weight_pressing")
        by_contact = g.op(
            "MatMul", g.unsqueeze(pressing, [2], "weight_pressing_row"), self.a_s, name="weight_pressing_moves"
        )  # (N, B, 1, 6)
        summed = g.reshape(g.reduce_sum(by_contact, 1, "weight_pressed"), [0, N_WRENCH, 1], "weight_pressed_col")
        known, weight = g.split(self.sensed["weight"], [1, 3], 1, ["weight_known", "weight_force3"])
        pads = g.index("pads", [0, 0, 0, 3])
        whole = g.unsqueeze(g.op("Pad", weight, pads, name="weight_wrench"), [2], "weight_wrench_col")
        rest = g.op("Neg", g.op("Add", summed, whole, name="weight_total"), name="weight_rest")  # (N, 6, 1)
        share = g.op("Div", g.op("MatMul", unit, rest, name="weight_forward"), squares, name="weight_share")
        y = g.op("MatMul", self.transposed(unit, "weight_unit_t", 3), share, name="weight_y")  # (N, 6, 1)
        force = g.op("MatMul", rows, g.unsqueeze(y, [1], "weight_y_block"), name="weight_t3")  # (N, B, 3, 1) / sqrt(c)
        flat = g.reshape(force, [0, branches, 3], "weight_forces")
        counts = g.op("Mul", self.root_flag, g.unsqueeze(known, [2], "weight_known_col"), name="weight_counts")
        return g.op("Mul", flat, counts, name="weight_carried")

    def sense(self) -> None:
        """What networks and layer see of sensors, each of which is the same for all where it has one row."""
        g = self.g
        batch = g.op("Shape", "q", name="sensor_batch", start=0, end=1)
        rows = g.op("Concat", batch, g.index("one_row", [1]), name="sensor_rows", axis=0)
        given = {name: g.op("Expand", name, rows, name=f"{name}_of_each") for name in self.dims.sensors}
        zero, one = g.constant("zero", 0.0), g.constant("one", 1.0)
        known, mu, deviation = g.split(given["friction"], [1, 1, 1], 1, ["mu_known", "mu_told", "mu_deviation"])
        is_known = g.op("Greater", known, zero, name="mu_is_known")
        nominal = g.constant("friction_nominal", self.meta["friction_nominal"])
        held = g.op("Where", is_known, mu, nominal, name="mu_held")
        spread = g.op("Mul", held, g.constant("friction_spread", FRICTION_SPREAD), name="mu_spread")
        share = g.op("Div", g.op("Where", is_known, deviation, zero, name="mu_deviation_held"), spread, name="mu_share")
        doubt = g.op("Add", g.op("Mul", share, share, name="mu_share2"), one, name="mu_doubt")
        trust = g.op("Div", known, doubt, name="mu_trust")
        log = g.op("Mul", trust, g.op("Log", g.op("Div", held, nominal, name="mu_ratio"), name="mu_log"), name="mu_far")
        seen = [trust, log]
        for name, (size,) in self.dims.sensors.items():
            if name == "friction":
                continue
            flag, values = g.split(given[name], [1, size - 1], 1, [f"{name}_known", f"{name}_values"])
            there = g.op("Greater", flag, zero, name=f"{name}_is_known")
            seen += [flag, g.op("Where", there, values, zero, name=f"{name}_held")]
        weight = g.op("Concat", *seen[2:4], name="weight_told", axis=1)
        self.sensed = dict(seen=g.op("Concat", *seen, name="sensed", axis=1), log_friction=log, weight=weight)

    def told_positive(self) -> str:
        """What the head's factors scale, of theta (N, B, .): springs' diagonal, gain, alpha, twist."""
        g, c = self.g, self.dims.coordinates
        parts = [g.gather(self.told["chol"], range(c), 2, "theta_chol_diag")]
        if self.dims.gates:
            gain = self.told["tendon_gain"]
            none = g.op("Sub", gain, gain, name="theta_zero_gain")
            parts += [gain, g.op("Add", none, g.constant("alpha_nom", self.tensors["gate_nom"][0]), name="theta_alpha")]
        if self.dims.twist:
            parts.append(self.told["twist"])
        return g.op("Concat", *parts, name="theta_positive", axis=2) if len(parts) > 1 else parts[0]

    def chol_packed(self, diag: str, off: str) -> str:
        """Packed L (S, N, B, .) from its diagonal (S, N, B, C) and the squashed corrections below it."""
        g, nom, mask, c = self.g, self.tensors["chol_nom"], self.tensors["coord_mask"], self.dims.coordinates
        if c == 1:
            return diag
        rows, cols = ([entry[i] for entry in self.dims.cholesky_entries[c:]] for i in (0, 1))
        live = mask[:, rows] * mask[:, cols]
        if self.told:
            chol, there = self.told["chol"], g.constant("chol_live", live)
            left, right = (g.gather(chol, picks, 2, f"theta_chol_{name}") for name, picks in (("i", rows), ("j", cols)))
            root = g.op("Sqrt", g.op("Mul", left, right, name="theta_chol_square"), name="theta_chol_size")
            size = g.op("Mul", root, there, name="theta_off_size")
            below = g.gather(chol, range(c, self.dims.cholesky), 2, "theta_chol_below")
            centre = g.op("Mul", below, there, name="theta_off_nom")
        else:
            size = g.constant("chol_off_size", np.sqrt(nom[:, rows] * nom[:, cols]) * live)
            centre = ""
        scaled = g.op("Mul", off, size, name="chol_off_scaled")
        lower = g.op("Add", scaled, centre or g.constant("chol_off_nom", nom[:, c:] * live), name="chol_off")
        return g.op("Concat", diag, lower, name="chol_packed", axis=3)

    def chol_inverse_t(self, springs: dict[str, str]) -> str:
        """L^-T (S, N, B, C, C), upper triangular."""
        if self.dims.coordinates == 3:
            return self.adjugate_over_determinant(springs["chol"])
        return self.substituted(springs["chol"], springs["diagonal"])

    def substituted(self, packed: str, diag: str) -> str:
        """L^-T by forward substitution: row i of Y = L^-1 is (e_i - sum of L_ij Y_j over j < i) / L_ii."""
        g, c = self.g, self.dims.coordinates
        inverse = g.op("Reciprocal", diag, name="chol_diag_inverse")
        column = g.unsqueeze(inverse, [4], "chol_diag_inverse_col")  # (S, N, B, C, 1)
        scaled = g.op("Mul", column, g.constant("eye", np.eye(c)), name="chol_diag_inverse_rows")  # (S, N, B, C, C)
        if c == 1:
            return scaled
        first, *rows = g.split(scaled, [1] * c, 3, [f"chol_e{i}" for i in range(c)])
        below = g.gather(packed, range(c, self.dims.cholesky), 3, "chol_below")
        by_row = g.gather(inverse, [row for row, _ in self.dims.cholesky_entries[c:]], 3, "chol_row_inverse")
        factors = g.op("Mul", below, by_row, name="chol_below_scaled")
        pieces = g.split(factors, list(range(1, c)), 3, [f"chol_n{i}" for i in range(1, c)])
        for i, (e, n) in enumerate(zip(rows, pieces, strict=True), 1):
            part = g.op("MatMul", g.unsqueeze(n, [3], f"chol_n{i}_row"), first, name=f"chol_p{i}")  # (S, N, B, 1, C)
            row = g.op("Sub", e, part, name=f"chol_y{i}")
            first = g.op("Concat", first, row, name=f"chol_y_to_{i}", axis=3)
        return self.transposed(first, "chol_inverse_t", 5)

    def adjugate_over_determinant(self, packed: str) -> str:
        """The same of 3 x 3 factors, in fewer nodes."""
        g, n = self.g, len(CHOL_ADJUGATE)
        place = np.zeros((n, 9), np.float32)
        for i, (_, _, sign, row, column) in enumerate(CHOL_ADJUGATE):
            place[i, 3 * column + row] = sign
        picked = g.gather(packed, [a[0] for a in CHOL_ADJUGATE] + [a[1] for a in CHOL_ADJUGATE] + [0], 3, "chol_picked")
        left, right, l00 = g.split(picked, [n, n, 1], 3, ["chol_left", "chol_right", "chol_l00"])
        products = g.op("Mul", left, right, name="chol_products")  # (S, N, 3, 7); the first is l11 l22
        det = g.op("Mul", l00, g.gather(products, [0], 3, "chol_l11_l22"), name="chol_det")  # (S, N, 3, 1)
        adjugate = g.op("MatMul", products, g.constant("chol_adjugate", place), name="chol_adjugate_t")
        return g.reshape(g.op("Div", adjugate, det, name="chol_inverse_flat"), [0, 0, 0, 3, 3], "chol_inverse_t")

    def spring_matrix(self, packed: str) -> str:
        """K = L L^T (S, N, B, C, C) from the packed L; only the debug outputs need it."""
        g, c, entries = self.g, self.dims.coordinates, self.dims.cholesky_entries
        place = np.zeros((len(entries), c * c), np.float32)
        place[range(len(entries)), [c * i + j for i, j in entries]] = 1
        flat = g.op("MatMul", packed, g.constant("chol_place", place), name="chol_flat")
        chol = g.reshape(flat, [0, 0, 0, c, c], "chol")
        return g.op("MatMul", chol, self.transposed(chol, "chol_t", 5), name="k_spring")

    def unit(self, v: str, mask: Array) -> str:
        """v * mask over its norm: (S, N, B, C)."""
        g = self.g
        live = g.op("Mul", v, g.constant("coord_mask", mask), name="dir_live")
        square = self.squares(live, 3, "dir")  # (S, N, B, 1)
        norm = g.op("Sqrt", g.op("Add", square, g.constant("dir_floor", 1e-12), name="dir_floored"), name="dir_norm")
        return g.op("Div", live, norm, name="tendon_dir")

    def transposed(self, m: str, name: str, rank: int) -> str:
        """Swap the last two of `rank` axes."""
        return self.g.op("Transpose", m, name=name, perm=[*range(rank - 2), rank - 1, rank - 2])

    def inverse_3x3(self, m: str, lead: int, name: str) -> str:
        """Inverse of 3x3 matrices (`lead` leading axes) by cofactors."""
        g = self.g
        picks, signs = _adjugate_tables()
        flat = g.reshape(m, [0] * lead + [9], f"{name}_flat")
        picked = g.gather(flat, picks, lead, f"{name}_picked")
        left, right, column = g.split(picked, [18, 18, 3], lead, [f"{name}_left", f"{name}_right", f"{name}_col0"])
        products = g.op("Mul", left, right, name=f"{name}_products")
        adjugate = g.op("MatMul", products, g.constant("adjugate_signs", signs), name=f"{name}_adj")  # (..., 9)
        row = g.gather(adjugate, [0, 1, 2], lead, f"{name}_adj_row0")
        det = g.reduce_sum(g.op("Mul", column, row, name=f"{name}_det_terms"), lead, f"{name}_det")
        quotient = g.op("Div", adjugate, det, name=f"{name}_inverse_flat")
        return g.reshape(quotient, [0] * lead + [3, 3], f"{name}_inverse")

    def gram_schmidt(self, v: str, n: int, axis: int, name: str, weight: str = "") -> tuple[str, list[str]]:
        """Modified Gram-Schmidt on the n rows (along `axis`) of v (..., n, m); inner products may have a weight.

        Returns the last row (..., 1, m), less its part along the others, and the others, orthogonal and not normalised.
        """
        g, done = self.g, []
        for left in range(n - 1, 0, -1):
            row, rest = g.split(v, [1, left], axis, [f"{name}_row", f"{name}_rest"])
            weighted = g.op("Mul", row, weight, name=f"{name}_weighted") if weight else row
            terms = g.op("Mul", v, weighted, name=f"{name}_terms")
            along = g.reduce_sum(terms, axis + 1, f"{name}_along")  # (..., left + 1, 1)
            square, dots = g.split(along, [1, left], axis, [f"{name}_square", f"{name}_dots"])
            part = g.op("Mul", g.op("Div", dots, square, name=f"{name}_factor"), row, name=f"{name}_part")
            v = g.op("Sub", rest, part, name=f"{name}_left")
            done.append(row)
        return v, done

    def squares(self, rows: str, axis: int, name: str) -> str:
        """Squares of the rows (..., m) along the last axis `axis`: (..., 1)."""
        axes = self.g.index("axes", [axis])
        return self.g.op("ReduceSumSquare", rows, axes, name=f"{name}_squares", keepdims=1)

    def beside(self, v: str, width: int, constant: NDArray[np.float64], name: str, scale: str = "") -> str:
        """[v | constant] along the last axis; v has `width` columns, all of the batch the same constant (S, ..., m).

        The constant may have a scale, of each sample its own.
        """
        g, rank = self.g, constant.ndim
        padded = g.op("Pad", v, g.index("pads", [0] * (2 * rank - 1) + [constant.shape[-1]]), name=f"{name}_padded")
        block = np.concatenate([np.zeros((*constant.shape[:-1], width)), constant], -1)
        tail = g.constant(f"{name}_tail", block)
        tail = g.op("Mul", tail, scale, name=f"{name}_scaled") if scale else tail
        return g.op("Add", padded, tail, name=f"{name}_full")

    def closure(self, flag: str) -> None:
        """What both passes share of the inputs."""
        g = self.g
        self.b = g.op("Neg", "j_q", name="b")  # (N, B, 3, C)
        self.root_flag = g.op("Sqrt", flag, name="root_contact")  # (N, B, 1)
        a_s = g.op("Mul", self.a_s_rows, self.root_flag, name="a_contact_rows")
        self.a_s = g.reshape(a_s, [0, 0, 3, N_WRENCH], "a_contact")  # (N, B, 3, 6) sqrt(c) A S
        w_s = g.op("Mul", "w_e", self.s, name="w_scaled")  # (N, 6)
        self.w_s = g.unsqueeze(w_s, [2], "w_scaled_col")  # (N, 6, 1)
        self.flag = flag
        if self.dims.slides:
            parts = [3, 3, 1, 3 * self.dims.coordinates]
            _, self.normal, force, _ = g.split(
                self.contact_raw, parts, 2, ["position", "contact_normal", "normal_force_row", "j_q_part"]
            )
            zero = g.constant("zero", 0.0)
            touches = g.op("Greater", flag, zero, name="touches")
            self.force = g.op("Where", touches, force, zero, name="normal_force")

    def constants_of(self, key: str) -> NDArray[np.float64]:
        """A regularisation constant of both stages (2)."""
        return np.array(pair_of(self.meta[key]))

    def root_eps_m(self) -> NDArray[np.float64]:
        """sqrt(eps_M) (S, 1, B, 1, 1); (S, 1, 1, 1, 1) where all branches have the same."""
        eps = by_branch(self.meta["eps_m"], self.dims.branches)
        if (eps == eps[:, :1]).all():
            eps = eps[:, :1]
        return np.sqrt(eps)[:, None, :, None, None]

    def by_softness(self, name: str, constant: NDArray[np.float64]) -> str:
        """A constant over the root of eps_M: of a told model over that of the softness too."""
        node = self.g.constant(name, constant)
        return self.g.op("Div", node, self.told["root_soft"], name=f"theta_{name}") if self.told else node

    def contact(self, g_t: str, u: str | None) -> dict[str, str]:
        """Joints and contact in series, from G^T = B L^-T (S, N, B, 3, C) and the tendons' u = L^-1 d (S, N, B, 1, C).

        Y (S, N, B, 3, 6): Y^T Y = c A_s^T M^-1 A_s. Of u: t (S, N, B, 1, 3) along the contact's orthonormal columns,
        and the square of what is left.
        """
        g, c = self.g, self.dims.coordinates
        root_m = self.root_eps_m()
        stacked = g_t if u is None else g.op("Concat", g_t, u, name="g_u_t", axis=3)  # (S, N, B, 4, C)
        n = 3 if u is None else 4
        full = self.beside(
            stacked, c, root_m * np.eye(n, 3), "g_t", self.told.get("root_soft", "")
        )  # (S, N, B, 4, C + 3), with its transpose: M
        rest, done = self.gram_schmidt(full, n, 3, "m")
        rows = g.op("Concat", *done, *([rest] if u is None else []), name="m_rows", axis=3)  # (S, N, B, 3, C + 3)
        norm = g.op("Sqrt", self.squares(rows, 4, "m"), name="m_norm")  # (S, N, B, 3, 1)
        unit = g.op("Div", rows, norm, name="m_unit")
        _, tail = g.split(unit, [c, 3], 4, ["m_head", "m_tail"])
        r_mt = g.op(
            "Mul", tail, self.by_softness("m_scale", 1 / root_m), name="r_m_inverse_t"
        )  # (S, N, B, 3, 3) R_M^-T
        y = g.op("MatMul", r_mt, self.a_s, name="y")  # (S, N, B, 3, 6)
        found = dict(g_t=g_t, r_mt=r_mt, y=y)
        if u is None:
            return found
        flat = [0, 0, self.dims.branches]
        rest_square = g.reshape(self.squares(rest, 4, "rest"), [*flat, 1], "rest_square")  # (S, N, B, 1)
        _, below = g.split(rest, [c, 3], 4, ["rest_head", "rest_tail"])  # (S, N, B, 1, 3)
        force = g.op("Mul", below, self.by_softness("rest_scale", -1 / root_m), name="tendon_force")
        m = g.reshape(g.op("MatMul", force, self.a_s, name="m_row"), [*flat, N_WRENCH], "m")  # (S, N, B, 6)
        return found | dict(m=m, rest_square=rest_square, force=force)

    def twist_rows(self, twist: str) -> str:
        """sqrt(c k) (0, n) S (S, N, B, 6): their squares are what soft fingertips add to the scaled K_x."""
        g = self.g
        normal = g.gather(self.contact_raw, [3, 4, 5], 2, "normal")  # (N, B, 3)
        turning = g.op("Pad", normal, g.index("pads", [0, 0, 3, 0, 0, 0]), name="normal_rows")  # (N, B, 6)
        scaled = g.op("Mul", turning, self.s, name="normal_scaled")
        root = g.op("Sqrt", twist, name="root_twist")  # (S, N, B, 1)
        held = g.op("Mul", root, self.root_flag, name="root_twist_contact")
        return g.op("Mul", held, scaled, name="twist_rows")

    def springs_alone(self, contact: dict[str, str], twist: str | None) -> dict[str, str]:
        """Pass 1: K_x = V^T V with V^T = [Y^T | sqrt(eps_Kx) S], and x = K_x^-1 w, in scaled lengths.

        Soft fingertips have rows of their own behind those of Y.
        """
        g, root, stacked = self.g, np.sqrt(self.constants_of("eps_kx"))[:, None, None, None], 3 * self.dims.branches
        scale = self.scale.astype(np.float64)
        y_rows = g.reshape(contact["y"], [0, 0, stacked, 6], "y_rows")
        if twist is not None:
            y_rows = g.op("Concat", y_rows, self.twist_rows(twist), name="y_twist_rows", axis=2)
            stacked += self.dims.branches
        y_t = self.transposed(y_rows, "y_t", 4)  # (S, N, 6, 3 B)
        v_t = self.beside(y_t, stacked, root * np.diag(scale), "v_t")  # (S, N, 6, 3 B + 6)
        last, done = self.gram_schmidt(v_t, N_WRENCH, 2, "v")
        rows = g.op("Concat", *done, last, name="v_rows", axis=2)
        squares = self.squares(rows, 3, "v")  # (S, N, 6, 1)
        _, tail = g.split(rows, [stacked, N_WRENCH], 3, ["v_head", "v_tail"])
        unit = g.op("Mul", tail, g.constant("v_tail_scale", 1 / (root * scale)), name="v_unit")  # (S, N, 6, 6) U
        forward = g.op("MatMul", unit, self.w_s, name="forward")  # (S, N, 6, 1)
        divided = g.op("Div", forward, squares, name="divided")
        unit_t = self.transposed(unit, "v_unit_t", 4)
        x = g.op("MatMul", unit_t, divided, name="x0_col")  # (S, N, 6, 1)
        return dict(v_t=v_t, squares=squares, unit=unit, unit_t=unit_t, forward=forward, x_col=x)

    def taut(self, contact: dict[str, str], stiffness: str) -> tuple[str, str]:
        """Each tendon of stiffness s (S, N, B, 1) adds n n^T to K_x, n = m sqrt(s / (1 + s rest^2)): that root, n."""
        g, one = self.g, self.g.constant("one", 1.0)
        s_rest = g.op("Mul", stiffness, contact["rest_square"], name="s_rest")
        gamma = g.op("Div", stiffness, g.op("Add", s_rest, one, name="s_rest_plus1"), name="gamma")
        root = g.op("Sqrt", gamma, name="root_gamma")  # (S, N, B, 1)
        return root, g.op("Mul", contact["m"], root, name="n")  # (S, N, B, 6)

    def with_tendons(self, contact: dict[str, str], first: dict[str, str], stiffness: str) -> dict[str, str]:
        """Pass 2: what tendons leave of the load is a residual of least squares, H tendons by pass 1's factors."""
        g, branches = self.g, self.dims.branches
        _, n = self.taut(contact, stiffness)
        h_t = g.op("MatMul", n, first["unit_t"], name="h_rows")  # (S, N, B, 6)
        load = g.reshape(first["forward"], [0, 0, 1, N_WRENCH], "load_row")
        inverse = g.reshape(
            g.op("Reciprocal", first["squares"], name="v_inverse"), [0, 0, 1, N_WRENCH], "v_inverse_row"
        )
        weight = self.beside(inverse, N_WRENCH, np.ones((1, 1, 1, branches)), "h_weight")  # (S, N, 1, 6 + B)
        rows = g.op("Concat", h_t, load, name="h_load", axis=2)  # (S, N, B + 1, 6)
        tail = np.eye(branches + 1, branches)[None, None]
        full = self.beside(rows, N_WRENCH, tail, "h_load")  # (S, N, B + 1, 6 + B)
        rest, _ = self.gram_schmidt(full, branches + 1, 2, "h", weight)
        left, _ = g.split(rest, [N_WRENCH, branches], 3, ["load_left", "load_taken"])  # (S, N, 1, 6)
        z = g.op("Mul", left, inverse, name="z_row")
        x = g.reshape(g.op("MatMul", z, first["unit"], name="x_scaled_row"), [0, 0, N_WRENCH], "x_scaled")
        return dict(n=n, x_scaled=x, dx=g.op("Mul", x, self.s, name="dx_both"))

    def without_tendons(self, first: dict[str, str]) -> dict[str, str]:
        """What pass 2 would give without them: pass 1."""
        g = self.g
        x = g.reshape(first["x_col"], [0, 0, N_WRENCH], "x_scaled")
        return dict(x_scaled=x, dx=g.op("Mul", x, self.s, name="dx_both"))

    def sliding(
        self, springs: dict[str, str], contact: dict[str, str], first: dict[str, str], tendons: str | None
    ) -> tuple[dict[str, str], Slid]:
        """What pass 2 gives, with contacts that slide."""
        g, n, along, v = self.g, None, None, first["v_t"]
        if tendons is not None:
            root, n = self.taut(contact, tendons)
            along = g.op("Mul", contact["force"], g.unsqueeze(root, [4], "root_gamma_col"), name="tendon_along")
            v = g.op("Concat", v, self.transposed(n, "n_t", 4), name="v_n_t", axis=3)  # (S, N, 6, 4 B + 6)
        grip = Grip(self.flag, self.normal, self.force, springs["friction"], springs["preload"])
        soft = g.constant("eps_m", self.root_eps_m()[..., 0] ** 2)  # (S, 1, B, 1)
        if self.told:
            root = g.reshape(self.told["root_soft"], [0, 0, 1], "theta_root_soft_row")
            soft = g.op("Mul", soft, g.op("Mul", root, root, name="theta_soft_factor"), name="theta_eps_m")
        rows = Rows(contact["g_t"], soft, contact["y"], n, contact["r_mt"], self.root_flag, along, v)
        root_eps = np.sqrt(self.constants_of("eps_kx"))[:, None, None, None]
        slid = SlideGraph(g, self.dims, root_eps, self.scale.astype(np.float64)).slide(grip, rows, self.w_s)
        dx = g.op("Mul", slid.x_scaled, self.s, name="dx_free")
        return dict(v=v, x_scaled=slid.x_scaled, dx=self.cut(dx)), slid

    def cut(self, dx: str) -> str:
        """Motions (S, N, 6), each shortened by one factor to the bounds of a grasp that holds."""
        g = self.g
        limits = np.array([self.meta["max_translation"], self.meta["max_rotation"]])
        pairs = g.reshape(dx, [0, 0, 2, 3], "dx_pairs")
        sizes = g.op("ReduceL2", pairs, g.index("axes", [3]), name="dx_sizes", keepdims=0)  # (S, N, 2)
        over = g.op("Div", sizes, g.constant("motion_limits", limits), name="dx_over")
        worst = g.op("ReduceMax", over, g.index("axes", [2]), name="dx_worst", keepdims=1)
        return g.op("Div", dx, g.op("Max", worst, g.constant("one", 1.0), name="dx_shorter"), name="dx_both")

    def stiffness(self, first: dict[str, str], second: dict[str, str]) -> str:
        """K_x (S, N, 6, 6), scaled, if no contact slides."""
        g, v = self.g, second.get("v", first["v_t"])
        if "n" in second:
            v = g.op("Concat", v, self.transposed(second["n"], "n_t", 4), name="v_n_t", axis=3)  # (S, N, 6, 4 B + 6)
        return g.op("MatMul", v, self.transposed(v, "v_n", 4), name="k_scaled")

    def in_si(self, k_scaled: str) -> str:
        """K_x (S, N, 6, 6) in SI."""
        scale = self.scale.astype(np.float64)
        return self.g.op("Mul", k_scaled, self.g.constant("k_unscale", 1 / np.outer(scale, scale)), name="k_x_both")

    def joint_deflection(self, contact: dict[str, str], first: dict[str, str], l_it: str) -> str:
        """dq0 (S, N, B, C) of pass 1, masked by coordinate and contact; l_it is L^-T (S, N, B, C, C)."""
        g = self.g
        x = g.reshape(first["x_col"], [0, 0, 1, N_WRENCH, 1], "x_block")
        if self.meta["dq0"] == "statics":
            stretch = g.op("MatMul", contact["y"], x, name="y_x")  # (S, N, B, 3, 1)
            force = g.op("MatMul", self.transposed(contact["r_mt"], "r_m_inverse", 5), stretch, name="force")
            moment = g.op("MatMul", self.transposed(contact["g_t"], "g", 5), force, name="g_force")
            raw = g.op("MatMul", l_it, moment, name="dq0_col")
        else:
            eps = self.constants_of("eps_jq")[:, None, None, None, None] * np.eye(3)
            regular = g.op("Add", "j_q", g.constant("eps_jq", eps), name="j_q_regular")  # (S, N, B, 3, 3)
            motion = g.op("MatMul", self.a_s, x, name="motion")  # (S, N, B, 3, 1) times sqrt(c)
            product = g.op("MatMul", self.inverse_3x3(regular, 3, "j_q"), motion, name="dq0_negative")
            raw = g.op("Neg", product, name="dq0_col")  # the other sqrt(c) follows
        mask = g.constant("coord_mask", self.tensors["coord_mask"])
        live = g.op("Mul", self.root_flag, mask, name="coord_live")  # (N, B, C)
        flat = [0, 0, self.dims.branches, self.dims.coordinates]
        return g.op("Mul", g.reshape(raw, flat, "dq0_raw"), live, name="dq0_both")

    def stretch(self, springs: dict[str, str], contact: dict[str, str], first: dict[str, str], dq0: str | None) -> str:
        """How far pass 1 stretches each tendon, eta = <dq0, d>: (S, N, B, 1); in the form "statics" sqrt(c) m.x."""
        g = self.g
        if self.meta["dq0"] == "statics":
            return g.op("Mul", g.op("MatMul", contact["m"], first["x_col"], name="m_x"), self.root_flag, name="eta")
        return g.reduce_sum(g.op("Mul", str(dq0), springs["tendon_dir"], name="eta_terms"), 3, "eta")

    def gates(self, springs: dict[str, str], eta: str) -> str:
        """Engagement of each tendon (S, N, B, 1); 0 of a branch that has none."""
        g = self.g
        slack = g.op("Sub", eta, springs["beta"], name="slack")
        stretch = g.op("Mul", springs["alpha"], slack, name="stretch")
        gate = g.op("Sigmoid", g.op("Add", stretch, springs["rho"], name="gate_logit"), name="gate_col")
        if self.has_tendon.all():
            return gate
        return g.op("Mul", gate, g.constant("has_tendon", self.has_tendon), name="gate_live")

    def fade(self, size: str) -> str:
        """What K_x and gates count for (N, A) when the tool moves by `size` (N, 1): less beyond L."""
        g = self.g
        share = g.op("Div", g.constant("length", self.meta["length_scale"]), size, name="length_by_size")
        motion = g.constant("aux_is_motion", np.repeat([1.0, 0.0], [N_WRENCH, self.dims.aux - N_WRENCH]))
        return g.op("Min", g.op("Max", share, motion, name="share_or_motion"), g.constant("one", 1.0), name="fade")

    def classifier(self, f: str, second: dict[str, str], k_scaled: str, gate: str | None, slid: Slid | None) -> None:
        """p_stable (N) from stage 1's feature and statics."""
        g, t = self.g, self.tensors
        f1, x1 = g.gather(f, 0, 0, "f_s1"), g.gather(second["x_scaled"], 0, 0, "x_scaled_s1")
        k1 = g.gather(k_scaled, 0, 0, "k_scaled_s1")
        gates = [] if gate is None else [g.gather(gate, 0, 0, "gate_classifier")]
        gates += [] if slid is None else [g.gather(slid.logs, 0, 0, "contacts_s1")]
        size = g.op("ReduceL2", x1, g.index("axes", [1]), name="x_norm", keepdims=1)
        size = g.op("Max", size, g.constant("least_motion", LEAST_MOTION_M), name="x_size")  # (N, 1)
        log = self.log1p(size, np.float32(self.meta["displacement_log_scale"]), "x_size")
        motion = g.op("Mul", x1, g.op("Div", log, size, name="x_log_by_size"), name="x_log")  # (N, 6)
        flat = g.reshape(k1, [0, N_WRENCH * N_WRENCH], "k_flat")
        diagonal = g.gather(flat, [(N_WRENCH + 1) * i for i in range(N_WRENCH)], 1, "k_diagonal")
        log_diagonal = g.op("Log", diagonal, name="k_diagonal_log")
        aux = g.op("Concat", motion, log_diagonal, *gates, name="aux", axis=1)  # (N, A)
        a = self.normalised(aux, t["s1.aux_mean"], t["s1.aux_inv_std"], "aux_norm")
        a = g.op("Mul", a, self.fade(size), name="aux_faded")
        joined = g.op("Concat", f1, a, name="f_aux", axis=1)  # (N, H + A)
        hidden = self.dense(joined, t["s1.cls1_w"], t["s1.cls1_b"], "cls_hidden")  # (N, HD)
        logit = self.linear(hidden, t["s1.cls2_w"], t["s1.cls2_b"], "logit")  # (N, 1)
        g.op("Squeeze", g.op("Sigmoid", logit, name="p_stable_col"), g.index("axes", [1]), name="p_stable")

    def sure(self, f: str, second: dict[str, str], slid: Slid | None) -> None:
        """p_slide (N) and bound_95 (N) from stage 2's feature and how far it moves the tool."""
        g, t = self.g, self.tensors
        f2, x2 = g.gather(f, 1, 0, "f_s2"), g.gather(second["x_scaled"], 1, 0, "x_scaled_s2")
        size = g.op("ReduceL2", x2, g.index("axes", [1]), name="x_norm_s2", keepdims=1)
        seen = self.log1p(size, np.float32(self.meta["displacement_log_scale"]), "x_size_s2")  # (N, 1)
        if slid is not None:
            seen = g.op("Concat", seen, g.gather(slid.logs, 1, 0, "contacts_s2"), name="sure_statics", axis=1)
        normal = self.normalised(seen, t["s2.sure_mean"], t["s2.sure_inv_std"], "sure_seen")
        joined = g.op("Concat", f2, normal, name="f_sure", axis=1)  # (N, H + A)
        found = self.linear(joined, t["s2.sure_w"], t["s2.sure_b"], "sure")  # (N, 2)
        logit, log_bound = g.split(found, [1, 1], 1, ["slide_logit", "bound_log"])
        p_slide = g.op("Sigmoid", logit, name="p_slide_col")
        edges = g.constant("bound_edge", [self.meta["bound_edge"]])
        passed = g.op("Cast", g.op("GreaterOrEqual", p_slide, edges, name="edges_reached"), name="edges_passed", to=1)
        factors = np.asarray(self.meta["bound_factor"], np.float32)
        before = g.op("Pad", passed, g.index("pads", [0, 1, 0, 0]), g.constant("one", 1.0), name="bins_begun")
        after = g.op("Pad", passed, g.index("pads", [0, 0, 0, 1]), name="bins_ended")
        chosen = g.op("Sub", before, after, name="bin_of")  # (N, 4): 1 in the bin that p_slide lies in
        factor = g.op("MatMul", chosen, g.constant("bound_factor", factors[:, None]), name="bound_factor_of")
        held = g.op("Min", log_bound, g.constant("max_log_bound", MAX_LOG_BOUND), name="bound_log_held")
        bound = g.op("Mul", g.op("Exp", held, name="bound_raw"), factor, name="bound_col")
        g.op("Squeeze", p_slide, g.index("axes", [1]), name="p_slide")
        g.op("Squeeze", bound, g.index("axes", [1]), name="bound_95")

    def build(self, debug: bool) -> onnx.ModelProto:
        """The whole graph."""
        g, dims = self.g, self.dims
        flag, z_c = self.contact_input()
        self.closure(flag)
        inputs = dict(dims.inputs)
        if dims.factors:
            inputs["theta"] = (dims.factors + dims.joints + 1,)
            g.default("theta", np.zeros((1, *inputs["theta"])))
            self.tell()
        if dims.sensing:
            inputs |= dims.sensors
            for name, shape in dims.sensors.items():
                g.default(name, np.zeros((1, *shape)))
            self.sense()
        f = self.features(z_c)
        springs = self.springs(f)
        l_it = self.chol_inverse_t(springs)
        g_t = g.op("MatMul", self.b, l_it, name="g_t")  # (S, N, B, 3, C)
        u = None
        if dims.gates:
            u = g.op("MatMul", g.unsqueeze(springs["tendon_dir"], [3], "dir_row"), l_it, name="u")  # (S, N, B, 1, C)
        contact = self.contact(g_t, u)
        first = self.springs_alone(contact, springs.get("twist"))
        needed = debug or (dims.gates and self.meta["dq0"] != "statics")
        dq0 = self.joint_deflection(contact, first, l_it) if needed else None
        gate, second, slid = self.passes(springs, contact, first, dq0)
        k_scaled = self.stiffness(first, second)
        k_x = self.in_si(k_scaled if slid is None else slid.k_scaled)
        self.classifier(f, second, k_scaled, gate, slid)
        for name, value in (("dx_ht", second["dx"]), ("k_x", k_x)):
            g.gather(value, 1, 0, name)
        if gate is not None:
            g.gather(gate, 1, 0, "gate")
        else:
            self.zeros("gate", dims.outputs["gate"])
        self.sure(f, second, slid)
        if slid is not None:
            g.gather(slid.use, 0, 0, "friction_use")
        else:
            self.zeros("friction_use", dims.outputs["friction_use"])
        outputs = dict(dims.outputs)
        if debug:
            x0 = g.reshape(first["x_col"], [0, 0, N_WRENCH], "x0")
            dx0 = g.op("Mul", x0, self.s, name="dx0_both")
            values = self.debug_values(springs) | dict(dx0=dx0, dq0=str(dq0), k_x=k_x, dx=second["dx"])
            values |= {} if gate is None else {"gate": gate}
            if slid is not None:
                friction = g.op("Squeeze", springs["friction"], g.index("axes", [3]), name="friction_both")
                values |= dict(friction=friction, preload=springs["preload"], slide=slid.slide)
            outputs |= self.debug_outputs(values)
        name = "aminn_debug" if debug else "aminn"
        return g.model(name, inputs, outputs, OPSET, IR_VERSION, onnx_metadata(self.meta))

    def passes(
        self, springs: dict[str, str], contact: dict[str, str], first: dict[str, str], dq0: str | None
    ) -> tuple[str | None, dict[str, str], Slid | None]:
        """(gates of both stages (S, N, B), none if the hand has none; what pass 2 gives; contacts that slide)."""
        g = self.g
        if not self.dims.gates:
            if self.dims.slides:
                return None, *self.sliding(springs, contact, first, None)
            return None, self.without_tendons(first), None
        gate_col = self.gates(springs, self.stretch(springs, contact, first, dq0))
        gate = g.op("Squeeze", gate_col, g.index("axes", [3]), name="gate_both")  # (S, N, B)
        tendons = g.op("Mul", springs["gain"], gate_col, name="tendon_stiffness")
        if self.dims.slides:
            return gate, *self.sliding(springs, contact, first, tendons)
        return gate, self.with_tendons(contact, first, tendons), None

    def zeros(self, name: str, shape: tuple[int, ...]) -> None:
        """An output (N, *shape) of zeros."""
        size = self.g.op("Concat", self.batch, self.g.index("row", shape), name=f"{name}_size", axis=0)
        self.g.op("ConstantOfShape", size, name=name)

    def debug_values(self, springs: dict[str, str]) -> dict[str, str]:
        """Spring and tendon intermediates of both stages by their output name."""
        g = self.g
        values = dict(k_spring=self.spring_matrix(springs["chol"]))
        if not self.dims.gates:
            return values
        names = ("alpha", "beta", "rho")
        return values | dict(
            tendon_dir=springs["tendon_dir"],
            tendon_gain=g.op("Squeeze", springs["gain"], g.index("axes", [3]), name="tendon_gain_both"),
            gate_params=g.op("Concat", *(springs[n] for n in names), name="gate_params_both", axis=3),
        )

    def debug_outputs(self, values: dict[str, str]) -> dict[str, tuple[int, ...]]:
        """Name every intermediate of each stage, zeros where the hand has no tendon; returns their shapes."""
        shapes = {}
        for i, stage in enumerate(STAGES):
            for name, shape in self.dims.debug.items():
                if name in values:
                    self.g.gather(values[name], i, 0, f"{stage}_{name}")
                else:
                    self.zeros(f"{stage}_{name}", shape)
                shapes[f"{stage}_{name}"] = shape
        return shapes


def build_onnx(exported: Exported, debug: bool = False) -> onnx.ModelProto:
    """The model of `exported`, checked; with `debug`, the intermediates of both stages are outputs too."""
    dims = dims_of(exported)
    for key in ("eps_m", "eps_kx"):
        if by_branch(exported.meta[key], dims.branches).min() <= 0:
            raise AminnError(f"export: {key} is {exported.meta[key]}; it must be positive")
    if exported.meta["dq0"] not in ("statics", "inverse"):
        raise AminnError(f"export: dq0 is {exported.meta['dq0']!r}, not 'statics' or 'inverse'")
    if exported.meta["dq0"] == "inverse" and dims.coordinates != 3:
        raise AminnError(
            f"export: dq0 is 'inverse', which takes the inverse of j_q; the branches of this hand have up to "
            f"{dims.coordinates} coordinates, not 3: train with 'statics'"
        )
    model = _AminnGraph(exported).build(debug)
    onnx.checker.check_model(model, full_check=True)
    return model


def write_onnx(exported: Exported, path: AnyPath, debug: bool = False) -> None:
    """Write `build_onnx` to `path`; the same tables give the same bytes."""
    write_sealed(build_onnx(exported, debug), path)


def write_sealed(model: onnx.ModelProto, path: AnyPath) -> None:
    """Write a model, with the checksum that readers hold the file against first among its metadata."""
    model.metadata_props.insert(0, onnx.StringStringEntryProto(key=FILE_HASH, value=json.dumps("0" * DIGITS)))
    write_atomically(path, sealed_bytes(model.SerializeToString(deterministic=True), HASH_MARK))
