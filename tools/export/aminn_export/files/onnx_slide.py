"""The part of the ONNX graph in which contacts slide, once the load has used up their friction.

As in the C runtime everything happens among the 2 B tangential numbers of the contacts, and no stiffness is a
difference of large ones: rows E of the slides in the space of V, V^T V = K_x with tendons, are orthogonalised against
the columns of V, and what Gram-Schmidt leaves, G, gives the stiffness G G^T that slides meet when the tool is free to
follow. Its columns of V's regularisation hold how a slide moves the tool. docs/mechanics.md has the formulas.
Shapes as in `onnx_model.py`; R rows of V: 3 B, B of soft fingertips, 6 of the regularisation, B of gated tendons.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aminn_hand.hand import N_WRENCH, Dims

from .onnx_graph import GraphBuilder

SLIDE_STEPS = 3
MOST_COMPLIANCE, LEAST_PRESSURE, LEAST_RESERVE, MOST_USE = 5e-3, 0.01, 0.1, 100.0


class Grip(NamedTuple):
    """Contacts before the load."""

    flag: str  # (N, B, 1)
    normal: str  # (N, B, 3)
    force: str  # (N, B, 1)
    friction: str  # (S, N, B, 1)
    preload: str  # (S, N, B, 3), tangential


class Rows(NamedTuple):
    """V by branch, and what makes rows of it of a direction at a contact."""

    g_t: str  # (S, N, B, 3, C): with it the fingertip's compliance is g_t g_t^T + soft I, of springs alone
    soft: str  # (S, 1 or N, 1 or B, 1) m/N
    y: str  # (S, N, B, 3, 6) of contacts
    n: str | None  # (S, N, B, 6) of tendons, if there are gates
    r_mt: str  # (S, N, B, 3, 3)
    root_flag: str  # (N, B, 1)
    tendon: str | None  # (S, N, B, 1, 3): a tendon's row of a direction is sqrt(c) times its product with this
    v_t: str  # (S, N, 6, R) all of V, transposed


class Slid(NamedTuple):
    """What sliding makes of a grasp."""

    x_scaled: str  # (S, N, 6)
    k_scaled: str  # (S, N, 6, 6)
    slide: str  # (S, N, B) m/N
    use: str  # (S, N, B)
    logs: str  # (S, N, 3 B) logarithm of one plus use, slide over what the contact gives, normal force


class SlideGraph:
    """Adds the nodes of the sliding step of both stages."""

    def __init__(self, g: GraphBuilder, dims: Dims, root_eps: np.ndarray, scale: np.ndarray) -> None:
        """root_eps (2, 1, 1, 1): of the stiffness that is added to K_x; scale (6) of lengths."""
        self.g, self.dims, self.root_eps, self.scale = g, dims, root_eps, scale

    def constant(self, name: str, value: float) -> str:
        """A number."""
        return self.g.constant(name, value)

    def tangents(self, normal: str) -> str:
        """Two unit vectors across each unit normal (N, B, 3): (N, B, 2, 3), without a singular direction."""
        g, op = self.g, self.g.op
        x, y, z = g.split(normal, [1, 1, 1], 2, ["n_x", "n_y", "n_z"])
        below = op("Less", z, self.constant("zero", 0.0), name="n_below")
        sign = op("Where", below, self.constant("minus_one", -1.0), self.constant("one", 1.0), name="n_sign")
        a = op("Div", self.constant("minus_one", -1.0), op("Add", sign, z, name="n_far"), name="n_a")
        sx, xa, ya = (op("Mul", u, v, name=name) for u, v, name in ((sign, x, "n_sx"), (x, a, "n_xa"), (y, a, "n_ya")))
        xya = op("Mul", xa, y, name="n_xya")
        first = [
            op("Add", op("Mul", sx, xa, name="n_sxxa"), self.constant("one", 1.0), name="t1_x"),
            op("Mul", sign, xya, name="t1_y"),
            op("Neg", sx, name="t1_z"),
        ]
        second = [xya, op("Add", op("Mul", ya, y, name="n_yya"), sign, name="t2_y"), op("Neg", y, name="t2_z")]
        flat = op("Concat", *first, *second, name="tangents_flat", axis=2)
        return g.reshape(flat, [0, 0, 2, 3], "tangents")

    def local(self, rows: Rows, directions: str, name: str) -> tuple[str, str | None]:
        """Rows of V's space of directions (N, B, d, 3) at contacts: (S, N, B, d, 3), and of tendons (S, N, B, d, 1)."""
        g = self.g
        held = g.op("Mul", directions, g.unsqueeze(rows.root_flag, [3], f"{name}_flag"), name=f"{name}_held")
        turned = g.op("Transpose", rows.r_mt, name=f"{name}_r_t", perm=[0, 1, 2, 4, 3])
        own = g.op("MatMul", held, turned, name=f"{name}_own")  # (S, N, B, d, 3)
        if rows.tendon is None:
            return own, None
        column = g.op("Transpose", rows.tendon, name=f"{name}_tendon_t", perm=[0, 1, 2, 4, 3])
        return own, g.op("MatMul", held, column, name=f"{name}_tendon")  # (S, N, B, d, 1)

    def spread(self, own: str, tendon: str | None, n: int, name: str) -> str:
        """The same as whole rows of V's space, (S, N, B n, R): zero but for their branch's."""
        g, b = self.g, self.dims.branches
        eye = np.eye(b)[:, None, :, None]  # (B, 1, B, 1)
        block = g.op("Mul", g.unsqueeze(own, [4], f"{name}_4"), g.constant("branch_eye", eye), name=f"{name}_block")
        flat = g.reshape(block, [0, 0, b * n, 3 * b], f"{name}_rows")  # (S, N, B, n, B, 3)
        between = N_WRENCH + (b if self.dims.twist else 0)
        pads = g.index("pads", [0] * 7 + [between])
        padded = g.op("Pad", flat, pads, name=f"{name}_padded")
        if tendon is None:
            return padded
        taut = g.op("Mul", tendon, g.constant("branch_eye_row", np.eye(b)[:, None, :]), name=f"{name}_taut")
        tail = g.reshape(taut, [0, 0, b * n, b], f"{name}_taut_rows")  # (S, N, B, n, B)
        return g.op("Concat", padded, tail, name=f"{name}_whole", axis=3)

    def eliminated(self, rows: str, n: int) -> tuple[str, str]:
        """Gram-Schmidt of the first 6 of 6 + n rows (S, N, ., R): these, orthogonal, and what is left of the others."""
        g, done = self.g, []
        for left in range(N_WRENCH - 1 + n, n - 1, -1):
            row, rest = g.split(rows, [1, left], 2, ["slide_row", "slide_rest"])
            terms = g.op("Mul", rows, row, name="slide_terms")
            along = g.reduce_sum(terms, 3, "slide_along")
            square, dots = g.split(along, [1, left], 2, ["slide_square", "slide_dots"])
            part = g.op("Mul", g.op("Div", dots, square, name="slide_factor"), row, name="slide_part")
            rows = g.op("Sub", rest, part, name="slide_left")
            done.append(row)
        return g.op("Concat", *done, name="slide_rows", axis=2), rows

    def tail(self, rows: str, name: str) -> str:
        """The columns of the regularisation (S, N, ., 6), as coefficients of V's columns."""
        g, b = self.g, self.dims.branches
        at = 3 * b + (b if self.dims.twist else 0)
        picked = g.gather(rows, range(at, at + N_WRENCH), 3, f"{name}_tail")
        scale = 1 / (self.root_eps * self.scale)
        return g.op("Mul", picked, g.constant("v_tail_scale", scale), name=f"{name}_moves")

    def solved(self, e: str, root: str, held: str, name: str) -> str:
        """zeta (S, N, 2 B, 1) of (I + R E R) zeta = R t0, R = diag(root), by elimination: no pivot is below 1."""
        g, n = self.g, 2 * self.dims.branches
        across = g.op("Transpose", root, name=f"{name}_root_t", perm=[0, 1, 3, 2])
        inner = g.op("Mul", g.op("Mul", root, e, name=f"{name}_re"), across, name=f"{name}_rer")
        system = g.op("Add", inner, g.constant("slide_eye", np.eye(n)), name=f"{name}_system")
        v = g.op("Concat", system, g.op("Mul", root, held, name=f"{name}_rhs"), name=f"{name}_0", axis=3)
        for k in range(n):
            row = g.gather(v, [k], 2, f"{name}_row")
            pivot = g.gather(row, [k], 3, f"{name}_pivot")
            scaled = g.op("Div", row, pivot, name=f"{name}_scaled")
            one = g.constant(f"unit_{k}", np.eye(n)[:, k : k + 1])
            column = g.op("Sub", g.gather(v, [k], 3, f"{name}_column"), one, name=f"{name}_others")
            v = g.op("Sub", v, g.op("Mul", column, scaled, name=f"{name}_part"), name=f"{name}_left")
        return g.gather(v, [n], 3, f"{name}_zeta")

    def norm(self, v: str, name: str) -> str:
        """Of vectors along the last of four axes, (S, N, B, 1)."""
        return self.g.op("ReduceL2", v, self.g.index("axes", [3]), name=name, keepdims=1)

    def dot(self, a: str, b: str, name: str) -> str:
        """Of such vectors."""
        return self.g.reduce_sum(self.g.op("Mul", a, b, name=f"{name}_terms"), 3, name)

    def pressed(self, force: str, normal: str, name: str) -> str:
        """Normal force N under load (S, N, B, 1)."""
        left = self.g.op("Sub", force, normal, name=f"{name}_less")
        return self.g.op("Max", left, self.constant("least_pressure", LEAST_PRESSURE), name=name)

    def softened(self, friction: str, before: str, used: str, t: str, normal: str, give: str, s: str, name: str) -> str:
        """A step: s (S, N, B, 1) of tangential forces before the load and by it (S, N, B, 2), normal forces, and s."""
        op = self.g.op
        most = op("Mul", friction, normal, name=f"{name}_most")
        limit = op("Mul", most, most, name=f"{name}_limit")
        least = op("Mul", limit, self.constant("least_reserve", LEAST_RESERVE**2), name=f"{name}_least")
        reserve = op("Max", op("Sub", limit, used, name=f"{name}_free"), least, name=f"{name}_reserve")
        aligned, square = self.dot(before, t, f"{name}_aligned"), self.dot(t, t, f"{name}_square")
        inside = op("Mul", aligned, aligned, name=f"{name}_aligned2")
        total = op("Add", inside, op("Mul", square, reserve, name=f"{name}_sr"), name=f"{name}_total")
        size = op("Sqrt", total, name=f"{name}_size")
        against = op("Greater", aligned, self.constant("zero", 0.0), name=f"{name}_against")
        both = op("Add", size, aligned, name=f"{name}_both")
        top = op("Where", against, square, op("Sub", size, aligned, name=f"{name}_apart"), name=f"{name}_top")
        over = op("Div", top, op("Where", against, both, reserve, name=f"{name}_bottom"), name=f"{name}_over")
        gives = op("Mul", op("Add", give, s, name=f"{name}_gives"), over, name=f"{name}_needed")
        more = op("Max", op("Sub", gives, give, name=f"{name}_more"), self.constant("zero", 0.0), name=f"{name}_held")
        return op("Min", more, self.constant("most_compliance", MOST_COMPLIANCE), name=f"{name}_s")

    def roots(self, s: str, name: str) -> str:
        """sqrt(s) of each tangent (S, N, 2 B, 1) from s (S, N, B, 1)."""
        g = self.g
        root = g.op("Sqrt", s, name=f"{name}_root")
        twice = g.op("Concat", root, root, name=f"{name}_root2", axis=3)
        return g.reshape(twice, [0, 0, 2 * self.dims.branches, 1], f"{name}_roots")

    def stiffness(self, rows: Rows, own: str, tendon: str | None, s: str) -> str:
        """K_x (S, N, 6, 6) with slides, scaled: a sum of squares of rows.

        Of a branch the rows V_b become F2 F1 V_b, F = I - b b^T / (1 + q + sqrt(1 + q)), q = b.b: square roots of
        (I + b b^T)^-1 of the slides b = sqrt(s) e in turn.
        """
        g, dims = self.g, self.dims
        n_rows = 3 if tendon is None else 4
        v = rows.y if rows.n is None else g.op(
            "Concat", rows.y, g.unsqueeze(rows.n, [3], "n_row"), name="branch_rows", axis=3
        )  # fmt: skip
        e = own if tendon is None else g.op("Concat", own, tendon, name="slide_local", axis=4)  # (S, N, B, 2, n)
        root = g.unsqueeze(g.op("Sqrt", s, name="root_slide"), [4], "root_slide_col")
        e = g.op("Transpose", g.op("Mul", e, root, name="slide_b"), name="slide_b_t", perm=[0, 1, 2, 4, 3])
        v = g.op("Concat", v, e, name="branch_rows_slides", axis=4)  # (S, N, B, n, 8)
        one = self.constant("one", 1.0)
        for k in (1, 2):
            v, b = g.split(v, [N_WRENCH + 2 - k, 1], 4, [f"slide_v{k}", f"slide_b{k}"])
            q = g.op("ReduceSumSquare", b, g.index("axes", [3]), name=f"slide_q{k}", keepdims=1)
            q1 = g.op("Add", q, one, name=f"slide_q{k}_plus1")
            below = g.op("Add", q1, g.op("Sqrt", q1, name=f"slide_root{k}"), name=f"slide_below{k}")
            row = g.op(
                "MatMul", g.op("Transpose", b, name=f"slide_b{k}_t", perm=[0, 1, 2, 4, 3]), v, name=f"slide_bv{k}"
            )
            part = g.op("Mul", b, g.op("Div", row, below, name=f"slide_share{k}"), name=f"slide_part{k}")
            v = g.op("Sub", v, part, name=f"slide_kept{k}")
        whole = g.reshape(v, [0, 0, n_rows * dims.branches, N_WRENCH], "slid_rows")
        at = 3 * dims.branches
        rest = range(at, at + N_WRENCH + (dims.branches if dims.twist else 0))
        others = g.op("Transpose", g.gather(rows.v_t, rest, 3, "v_others"), name="v_others_t", perm=[0, 1, 3, 2])
        stacked = g.op("Concat", whole, others, name="slid_v", axis=2)
        transposed = g.op("Transpose", stacked, name="slid_v_t", perm=[0, 1, 3, 2])
        return g.op("MatMul", transposed, stacked, name="k_slid")

    def slide(self, grip: Grip, rows: Rows, w_s: str) -> Slid:
        """Both stages."""
        g, b = self.g, self.dims.branches
        tangents = self.tangents(grip.normal)
        own, tendon = self.local(rows, tangents, "tangent")
        e = self.spread(own, tendon, 2, "tangent")  # (S, N, 2 B, R)
        across = self.local(rows, g.unsqueeze(grip.normal, [2], "normal_direction"), "normal")
        e_n = self.spread(*across, 1, "normal")  # (S, N, B, R)
        v, left = self.eliminated(g.op("Concat", rows.v_t, e, name="v_slides", axis=2), 2 * b)
        unit = self.tail(v, "slide_v")  # (S, N, 6, 6)
        axes = g.index("axes", [3])
        squares = g.op("ReduceSumSquare", v, axes, name="slide_v_squares", keepdims=1)
        share = g.op(
            "Div", g.op("MatMul", unit, w_s, name="slide_forward"), squares, name="slide_share"
        )  # (S, N, 6, 1)
        strain = g.op("MatMul", g.op("Transpose", v, name="slide_v_t", perm=[0, 1, 3, 2]), share, name="strain")
        x2 = g.op("MatMul", g.op("Transpose", unit, name="slide_unit_t", perm=[0, 1, 3, 2]), share, name="x_stuck")
        t0, n0 = (g.op("MatMul", m, strain, name=name) for m, name in ((e, "t_stuck"), (e_n, "n_stuck")))
        left_t = g.op("Transpose", left, name="slide_left_t", perm=[0, 1, 3, 2])
        met = g.op("MatMul", left, left_t, name="slide_met")  # (S, N, 2 B, 2 B)
        pulled = g.op("MatMul", e_n, left_t, name="slide_pulled")  # (S, N, B, 2 B)
        moves = g.op("Neg", self.tail(left, "slide_left"), name="slide_moves")  # (S, N, 2 B, 6)
        bent = g.op("MatMul", tangents, rows.g_t, name="tangent_g")  # (S, N, B, 2, C)
        square = g.op("ReduceSumSquare", bent, g.index("axes", [3, 4]), name="tangent_g2", keepdims=0)
        half = g.op(
            "Mul", g.unsqueeze(square, [3], "tangent_g2_col"), self.constant("half", 0.5), name="give_by_springs"
        )
        give = g.op("Add", half, rows.soft, name="give")

        before_row = g.unsqueeze(grip.preload, [3], "preload_row")  # (S, N, B, 1, 3)
        turned = g.op("Transpose", tangents, name="tangents_t", perm=[0, 1, 3, 2])
        before = g.reshape(g.op("MatMul", before_row, turned, name="before_row"), [0, 0, b, 2], "before")
        used = self.dot(before, before, "used")
        t = g.reshape(t0, [0, 0, b, 2], "t_by_branch")
        first = normal = self.pressed(grip.force, n0, "pressed_stuck")
        use = self.friction_use(grip, before, t, first)
        s = self.softened(grip.friction, before, used, t, normal, give, g.constant("zero", 0.0), "step1")
        for step in range(2, SLIDE_STEPS + 1):
            root = self.roots(s, f"step{step}")
            zeta = self.solved(met, root, t0, f"step{step}")
            sigma = g.op("Mul", root, zeta, name=f"sigma{step}")
            fallen = g.op("MatMul", pulled, sigma, name=f"n_fallen{step}")
            normal = self.pressed(grip.force, g.op("Sub", n0, fallen, name=f"n_left{step}"), f"pressed{step}")
            flat = self.borne(met, root, zeta, sigma, t0, f"t{step}")
            t = g.reshape(flat, [0, 0, b, 2], f"t_rows{step}")
            s = self.softened(grip.friction, before, used, t, normal, give, s, f"step{step}")
        root = self.roots(s, "last")
        sigma = g.op("Mul", root, self.solved(met, root, t0, "last"), name="sigma")
        moved = g.op("MatMul", g.op("Transpose", moves, name="slide_moves_t", perm=[0, 1, 3, 2]), sigma, name="x_moved")
        x = g.reshape(g.op("Add", x2, moved, name="x_slid"), [0, 0, N_WRENCH], "x_slid_scaled")
        share = g.op("Div", s, give, name="slide_over_give")
        seen = g.op("Concat", use, share, first, name="contacts_seen", axis=2)  # (S, N, 3 B, 1)
        logs = g.op("Log", g.op("Add", seen, self.constant("one", 1.0), name="contacts_plus1"), name="contacts_log")
        return Slid(
            x,
            self.stiffness(rows, own, tendon, s),
            g.reshape(s, [0, 0, b], "slide_both"),
            g.reshape(use, [0, 0, b], "use_both"),
            g.reshape(logs, [0, 0, 3 * b], "contact_logs"),
        )

    def borne(self, met: str, root: str, zeta: str, sigma: str, t0: str, name: str) -> str:
        """Tangential forces (S, N, 2 B, 1) with slides: zeta / root, which loses no digit, where there are any."""
        g = self.g
        held = g.op("Max", root, self.constant("least_root", 1e-30), name=f"{name}_root_held")
        given = g.op("Div", zeta, held, name=f"{name}_given")
        left = g.op("Sub", t0, g.op("MatMul", met, sigma, name=f"{name}_met"), name=f"{name}_left")
        slides = g.op("Greater", root, self.constant("zero", 0.0), name=f"{name}_slides")
        return g.op("Where", slides, given, left, name=name)

    def friction_use(self, grip: Grip, before: str, t: str, pressed: str) -> str:
        """Share of its friction that each contact uses if none slides (S, N, B, 1)."""
        g = self.g
        borne = self.norm(g.op("Sub", before, t, name="borne"), "borne_size")
        most = g.op("Mul", grip.friction, pressed, name="most_borne")
        use = g.op("Mul", g.op("Div", borne, most, name="use_raw"), grip.flag, name="use_counts")
        return g.op("Min", use, self.constant("most_use", MOST_USE), name="use")
