// The two-pass statics layer.
//
//   K_x = sum_b c_b A_b^T M_b^-1 A_b + eps_kx I,   M_b = B_b K_b^-1 B_b^T + eps_m I
//
// in square-root form: no stiffness is formed before it is solved with, which would lose half of float32's digits (its
// stiffest direction is 1/eps_m, its softest the springs'). With L the Cholesky factor of the joint springs:
//
//   joints   G = L^-1 B^T                                    B K^-1 B^T = G^T G
//   contact  [ G ; sqrt(eps_m) I ] = P U                     M = U^T D U,  D = P^T P diagonal
//   tool     V = [ sqrt(c_b / D_b) U_b^-T A_b ; sqrt(eps_kx) I ] = Q U,  K_x = U^T D U
//
// Both factorisations are modified Gram-Schmidt without square roots: U has ones on its diagonal, and its inverse falls
// out, because the rows below G and V start as the identity. The displacement is x = U^-1 D^-1 U^-T w, the strain of the
// stacked springs V x = Q D^-1 U^-T w, from which the deflection of the joints follows without cancellation.
//
// Pass 2 adds a tendon s d d^T to the springs of each branch. It makes K_x stiffer by one direction,
//
//   K_x + sum_b gamma_b m_b m_b^T,   gamma = s / (1 + s rho^2)
//
// where u = L^-1 d is split into its part along P's columns, with coefficients t along the normalised ones, and a rest of
// length rho; m = V_b^T t. The load that stretches the tendon is felt through m as well: <dq, d> = sqrt(c) m.x. Nothing is
// factorised again: with H = U^-T m = Q_b^T t, K_x = U^T (D + H gamma H^T) U, and what the tendons leave of D^-1 U^-T w is
// the residual of the least squares problem [ D^-1/2 H gamma^1/2 ; I ] against it, by Gram-Schmidt once more.
//
// All on lengths divided by length_scale (S = diag(1, 1, 1, 1/L, 1/L, 1/L)).
#include "parts.hpp"

namespace aminn {
inline namespace AMINN_CORE {
namespace {

constexpr int kStacked = 3 * kBranch;

// Joints of a group of branches: indices are [coordinate] and [dimension].
struct Joints {
    Branches inv_diag[3]; // of L
    Branches below[3];    // l10, l20, l21
    Branches p[3][3];     // G, then the upper rows of P
    Branches u[3];        // L^-1 d, then its part that no contact force reaches
    Branches weight[3];   // sqrt(c / D)
    Branches t[3];        // u along the normalised columns of P
    Branches rest_square; // rho^2
    Branches root_contact;
};

// U^-1, D and what K_x is put together from
struct Factor {
    Row inverse[kMotion]; // rows of U^-1
    Row upper[kMotion];   // rows of U
    Row scaled[kMotion];  // rows of D U
    Row inv_d;
    Row diagonal; // of K_x
};

// L^-1 (x0, x1, x2)
AMINN_INLINE void solve_forward(const Joints &j, Branches x[3])
{
    x[0] = x[0] * j.inv_diag[0];
    x[1] = subtract_product(x[1], j.below[0], x[0]) * j.inv_diag[1];
    x[2] = subtract_product(subtract_product(x[2], j.below[1], x[0]), j.below[2], x[1]) * j.inv_diag[2];
}

// L^-T (x0, x1, x2)
AMINN_INLINE void solve_backward(const Joints &j, Branches x[3])
{
    x[2] = x[2] * j.inv_diag[2];
    x[1] = subtract_product(x[1], j.below[2], x[2]) * j.inv_diag[1];
    x[0] = subtract_product(subtract_product(x[0], j.below[0], x[1]), j.below[1], x[2]) * j.inv_diag[0];
}

AMINN_INLINE Branches column_dot(const Branches m[3][3], int i, int j)
{
    return add_product(add_product(m[0][i] * m[0][j], m[1][i], m[1][j]), m[2][i], m[2][j]);
}

AMINN_INLINE Branches column_dot(const Branches m[3][3], int i, const Branches v[3])
{
    return add_product(add_product(m[0][i] * v[0], m[1][i], v[1]), m[2][i], v[2]);
}

AMINN_FUNCTION void read_joints(const Springs &springs, const aminn_input_t &in, int b, Joints &j)
{
    for (int c = 0; c < 3; ++c) {
        j.inv_diag[c] = broadcast(1.0F) / gather(&springs.chol[c][b], 1);
        j.below[c] = gather(&springs.chol[3 + c][b], 1);
        j.u[c] = gather(&springs.tendon_dir[c][b], 1);
    }
    solve_forward(j, j.u);
    for (int d = 0; d < 3; ++d) {
        Branches column[3];
        for (int c = 0; c < 3; ++c) {
            column[c] = -gather(&in.j_q[b][d][c], 9);
        }
        solve_forward(j, column);
        for (int c = 0; c < 3; ++c) {
            j.p[c][d] = column[c];
        }
    }
}

// to = t0 rows[0] + t1 rows[1] + t2 rows[2]
AMINN_INLINE void combine(Row &to, float t0, float t1, float t2, const Row rows[3])
{
    scale(to, t0, rows[0]);
    add_scaled(to, t1, rows[1]);
    add_scaled(to, t2, rows[2]);
}

// Joints and contact compliance in series, seen from the contact: the branch's rows of V and the tendon's m, and what the
// way back needs. u is the fourth column of the factorisation, with zeros below.
AMINN_FUNCTION void factor_contact(Joints &j, Branches eps_m, Branches contact, const Row a[], Row v[], Row m[])
{
    const Branches one = broadcast(1.0F);
    const Branches d0 = column_dot(j.p, 0, 0) + eps_m;
    const Branches inv0 = one / d0;
    const Branches f01 = column_dot(j.p, 0, 1) * inv0;
    const Branches f02 = column_dot(j.p, 0, 2) * inv0;
    const Branches e0 = column_dot(j.p, 0, j.u);
    const Branches f03 = e0 * inv0;
    for (int c = 0; c < 3; ++c) {
        j.p[c][1] = subtract_product(j.p[c][1], f01, j.p[c][0]);
        j.p[c][2] = subtract_product(j.p[c][2], f02, j.p[c][0]);
        j.u[c] = subtract_product(j.u[c], f03, j.p[c][0]);
    }
    const Branches d1 = column_dot(j.p, 1, 1) + (eps_m + eps_m * (f01 * f01));
    const Branches inv1 = one / d1;
    const Branches f12 = (column_dot(j.p, 1, 2) + eps_m * (f01 * f02)) * inv1;
    const Branches e1 = column_dot(j.p, 1, j.u) + eps_m * (f01 * f03);
    const Branches f13 = e1 * inv1;
    for (int c = 0; c < 3; ++c) {
        j.p[c][2] = subtract_product(j.p[c][2], f12, j.p[c][1]);
        j.u[c] = subtract_product(j.u[c], f13, j.p[c][1]);
    }
    const Branches u02 = f12 * f01 - f02; // of U^-1; u01 = -f01, u12 = -f12
    const Branches u03 = f13 * f01 - f03; // what stands below u
    const Branches d2 = column_dot(j.p, 2, 2) + (eps_m + eps_m * (f12 * f12 + u02 * u02));
    const Branches inv2 = one / d2;
    const Branches e2 = column_dot(j.p, 2, j.u) + eps_m * (f12 * f13 + u02 * u03);
    const Branches f23 = e2 * inv2;
    for (int c = 0; c < 3; ++c) {
        j.u[c] = subtract_product(j.u[c], f23, j.p[c][2]);
    }
    const Branches rest0 = u03 - f23 * u02;
    const Branches rest1 = f23 * f12 - f13;
    j.rest_square = dot(j.u, j.u) + eps_m * ((rest0 * rest0 + rest1 * rest1) + f23 * f23);
    const Branches root_inv[3] = {root(inv0), root(inv1), root(inv2)};
    j.root_contact = root(contact);
    j.t[0] = e0 * root_inv[0];
    j.t[1] = e1 * root_inv[1];
    j.t[2] = e2 * root_inv[2];
    for (int i = 0; i < 3; ++i) {
        j.weight[i] = j.root_contact * root_inv[i];
    }

    float weight[3][kBranch];
    float t[3][kBranch];
    float u[3][kBranch];
    for (int i = 0; i < 3; ++i) {
        scatter(j.weight[i], weight[i], 1);
        scatter(j.t[i], t[i], 1);
    }
    scatter(f01, u[0], 1);
    scatter(u02, u[1], 1);
    scatter(f12, u[2], 1);
    for (int b = 0; b < kSideBySide; ++b) {
        const Row *from = a + 3 * b;
        Row *to = v + 3 * b;
        scale(to[0], weight[0][b], from[0]);
        to[1] = from[1];
        subtract_scaled(to[1], u[0][b], from[0]);
        scale(to[1], weight[1][b], to[1]);
        to[2] = from[2];
        add_scaled(to[2], u[1][b], from[0]);
        subtract_scaled(to[2], u[2][b], from[1]);
        scale(to[2], weight[2][b], to[2]);
        combine(m[b], t[0][b], t[1][b], t[2][b], to);
    }
}

// One column of V after the other; V becomes Q. e2: squares of the rows below V.
AMINN_FUNCTION void factorise(Row v[kStacked], const float e2[kMotion], Factor &f)
{
    // cppcheck-suppress ctuuninitvar ; this function fills it
    Row *inverse = f.inverse;
    clear(f.diagonal);
    clear(f.inv_d);
    AMINN_UNROLL_ROWS
    for (int j = 0; j < kMotion; ++j) {
        clear(inverse[j]);
        set_component(inverse[j], j, 1.0F);
        Row part[kBranch + 1]; // of the inner products of column j and all columns: of the branches, and of the rest
        AMINN_UNROLL_ROWS
        for (int b = 0; b < kBranch; ++b) {
            const Row *r = v + 3 * b;
            scale(part[b], r[0][j], r[0]);
            add_scaled(part[b], r[1][j], r[1]);
            add_scaled(part[b], r[2][j], r[2]);
        }
        scale(part[kBranch], e2[0] * inverse[0][j], inverse[0]);
        AMINN_UNROLL_ROWS
        for (int i = 1; i <= j; ++i) {
            add_scaled(part[kBranch], e2[i] * inverse[i][j], inverse[i]);
        }
        add(part[0], part[1]);
        add(part[2], part[3]);
        add(part[0], part[2]);
        f.scaled[j] = part[0];
        const float inv = 1.0F / part[0][j];
        scale(f.upper[j], inv, part[0]);
        clear_up_to(f.upper[j], j);
        const Row factor = f.upper[j];
        AMINN_UNROLL_ROWS
        for (int r = 0; r < kStacked; ++r) {
            subtract_scaled(v[r], v[r][j], factor);
        }
        AMINN_UNROLL_ROWS
        for (int i = 0; i <= j; ++i) {
            subtract_scaled(inverse[i], inverse[i][j], factor);
        }
        set_component(f.upper[j], j, 1.0F);
        set_component(f.inv_d, j, inv);
        multiply(part[0], f.upper[j]);
        add(f.diagonal, part[0]);
    }
}

// D^-1 U^-T w
AMINN_FUNCTION void solve_half(const Factor &f, const float w[kMotion], Row &y)
{
    scale(y, w[0], f.inverse[0]);
    for (int i = 1; i < kMotion; ++i) {
        add_scaled(y, w[i], f.inverse[i]);
    }
    multiply(y, f.inv_d);
}

// U^-1 z, scaled and in SI
AMINN_FUNCTION void displacement(const Factor &f, const Row &z, const float to_si[kMotion], float x_s[kMotion],
                                 float dx[kMotion])
{
    for (int i = 0; i < kMotion; ++i) {
        x_s[i] = dot(f.inverse[i], z);
        dx[i] = to_si[i] * x_s[i];
    }
}

// trace(K_x^-1), K_x scaled, before the tendons
float inverse_trace(const Factor &f)
{
    float trace = 0.0F;
    for (const Row &inverse : f.inverse) {
        Row square = inverse;
        multiply(square, inverse);
        trace = trace + dot(square, f.inv_d);
    }
    return trace;
}

// K_x = U^T D U + sum_b n_b n_b^T in SI, symmetric to the last bit
void store_stiffness(const Factor &f, const Row n[kBranch], const float inv_scale[kMotion], float k_x[kMotion][kMotion])
{
    for (int i = 0; i < kMotion; ++i) {
        Row row;
        scale(row, f.scaled[0][i], f.upper[0]);
        for (int j = 1; j <= i; ++j) {
            add_scaled(row, f.scaled[j][i], f.upper[j]);
        }
        for (int b = 0; b < kBranch; ++b) {
            add_scaled(row, n[b][i], n[b]);
        }
        for (int k = i; k < kMotion; ++k) {
            k_x[i][k] = k_x[k][i] = (row[k] * inv_scale[i]) * inv_scale[k];
        }
    }
}

// What tendons h = sqrt(gamma) H leave of z = D^-1 U^-T w: (D + h h^T)^-1 U^-T w.
AMINN_FUNCTION void pull(Row h[kBranch], const Row &inv_d, Row &z)
{
    float below[kBranch + 1][kBranch] = {}; // of the columns of h and of z
    for (int b = 0; b < kBranch; ++b) {
        below[b][b] = 1.0F;
    }
    AMINN_UNROLL_ROWS
    for (int b = 0; b < kBranch; ++b) {
        Row hz = h[b];
        multiply(hz, inv_d);
        float square = dot(hz, h[b]);
        AMINN_UNROLL_ROWS
        for (int i = 0; i <= b; ++i) {
            square = square + below[b][i] * below[b][i];
        }
        const float inv = 1.0F / square;
        AMINN_UNROLL_ROWS
        for (int k = b + 1; k <= kBranch; ++k) {
            float part = k < kBranch ? dot(hz, h[k]) : dot(h[b], z);
            AMINN_UNROLL_ROWS
            for (int i = 0; i < b; ++i) {
                part = part + below[b][i] * below[k][i];
            }
            const float factor = part * inv;
            subtract_scaled(k < kBranch ? h[k] : z, factor, k < kBranch ? h[b] : hz);
            AMINN_UNROLL_ROWS
            for (int i = 0; i <= b; ++i) {
                below[k][i] = below[k][i] - factor * below[b][i];
            }
        }
    }
}

// deflection of the branches' coordinates with springs alone, from their rows of Q
[[gnu::noinline]] void deflection(const Joints &j, const Row q[], const Row &z, Branches dq[3])
{
    Branches share[3];
    for (int i = 0; i < 3; ++i) {
        float strain[kSideBySide];
        for (int k = 0; k < kSideBySide; ++k) {
            strain[k] = dot(q[3 * k + i], z);
        }
        share[i] = j.weight[i] * gather(strain, 1);
    }
    for (int c = 0; c < 3; ++c) {
        dq[c] = dot(j.p[c], share);
    }
    solve_backward(j, dq);
}

// the same as the paper writes it, from the regularised inverse of j_q (by cofactors), for one branch
void branch_by_inverse(const aminn_input_t &in, int b, const float dx0[kMotion], float eps_jq, float dq[3])
{
    float motion[3];
    float m[3][3];
    for (int i = 0; i < 3; ++i) {
        const float *a = in.j_x[b][i];
        motion[i] =
            ((a[0] * dx0[0] + a[1] * dx0[1]) + (a[2] * dx0[2] + a[3] * dx0[3])) + (a[4] * dx0[4] + a[5] * dx0[5]);
        for (int c = 0; c < 3; ++c) {
            m[i][c] = i == c ? in.j_q[b][i][c] + eps_jq : in.j_q[b][i][c];
        }
    }
    const auto cofactor = [&m](int i, int c) {
        const int i1 = (i + 1) % 3;
        const int i2 = (i + 2) % 3;
        const int c1 = (c + 1) % 3;
        const int c2 = (c + 2) % 3;
        return m[i1][c1] * m[i2][c2] - m[i1][c2] * m[i2][c1];
    };
    const float det = (m[0][0] * cofactor(0, 0) + m[0][1] * cofactor(0, 1)) + m[0][2] * cofactor(0, 2);
    for (int c = 0; c < 3; ++c) {
        const float part = (cofactor(0, c) * motion[0] + cofactor(1, c) * motion[1]) + cofactor(2, c) * motion[2];
        dq[c] = -in.contacts[b][0] * (part / det);
    }
}

void deflection_by_inverse(const aminn_input_t &in, int b, const float dx0[kMotion], float eps_jq, Branches dq[3])
{
    float each[kSideBySide][3];
    for (int k = 0; k < kSideBySide; ++k) {
        branch_by_inverse(in, b + k, dx0, eps_jq, each[k]);
    }
    for (int c = 0; c < 3; ++c) {
        dq[c] = gather(&each[0][c], 3);
    }
}

// <dq, d>
Branches along_tendon(const Springs &springs, int b, const Branches dq[3])
{
    Branches d[3];
    for (int c = 0; c < 3; ++c) {
        d[c] = gather(&springs.tendon_dir[c][b], 1);
    }
    return dot(dq, d);
}

} // namespace

void make_scene(const aminn_model_t &model, const aminn_input_t &in, Scene &scene)
{
    const float inv_length = 1.0F / model.length_scale;
    for (int i = 0; i < kMotion; ++i) {
        scene.scale[i] = i < 3 ? 1.0F : inv_length;
        scene.inv_scale[i] = i < 3 ? 1.0F : model.length_scale;
        scene.w_s[i] = in.w_e[i] * scene.scale[i];
    }
    Row to_scaled;
    load_row(to_scaled, scene.scale);
    for (int r = 0; r < kStacked; ++r) {
        load_row(scene.a_s[r], in.j_x[r / 3][r % 3]);
        multiply(scene.a_s[r], to_scaled);
    }
}

void two_pass(const aminn_model_t &model, const aminn_stage_model_t &stage, const Springs &springs, const Scene &scene,
              const aminn_input_t &in, unsigned wanted, aminn_stage_debug_t &out, StaticsSummary &summary)
{
    const bool by_inverse = model.dq0 == AMINN_DQ0_INVERSE;
    Row v[kStacked];
    Row n[kBranch];
    Joints joints[kGroups];
    Factor f;
    float e2[kMotion];
    for (int i = 0; i < kMotion; ++i) {
        e2[i] = (stage.eps_kx * scene.scale[i]) * scene.scale[i];
    }
    const Branches eps_m = broadcast(stage.eps_m);

    // pass 1: springs alone
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        read_joints(springs, in, b, joints[g]);
        factor_contact(joints[g], eps_m, gather(in.contacts[b], AMINN_N_CONTACT_FEATURE), scene.a_s + 3 * b, v + 3 * b,
                       n + b);
    }
    factorise(v, e2, f);
    Row z;
    solve_half(f, scene.w_s, z);
    displacement(f, z, scene.scale, summary.x_s, out.dx0);

    // how far each tendon would be stretched decides how much it engages
    Row h[kBranch];
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        const Joints &j = joints[g];
        float t[3][kBranch];
        float stretch[kSideBySide];
        for (int i = 0; i < 3; ++i) {
            scatter(j.t[i], t[i], 1);
        }
        for (int k = 0; k < kSideBySide; ++k) {
            combine(h[b + k], t[0][k], t[1][k], t[2][k], v + 3 * (b + k));
            stretch[k] = dot(h[b + k], z);
        }
        Branches eta = j.root_contact * gather(stretch, 1);
        if (by_inverse || (wanted & kDeflection) != 0) {
            Branches dq[3];
            if (by_inverse) {
                deflection_by_inverse(in, b, out.dx0, stage.eps_jq, dq);
                eta = along_tendon(springs, b, dq);
            } else {
                deflection(j, v + 3 * b, z, dq);
            }
            for (int c = 0; c < 3; ++c) {
                scatter(dq[c] * gather(model.coord_mask + 3 * b + c, 3), &out.dq0[b][c], 3);
            }
        }
        const Branches alpha = gather(&springs.gate_params[0][b], 1);
        const Branches beta = gather(&springs.gate_params[1][b], 1);
        const Branches rho = gather(&springs.gate_params[2][b], 1);
        const Branches gate = sigmoid(alpha * (eta - beta) + rho);
        scatter(gate, out.gate + b, 1);
        const Branches s = gather(&springs.tendon_gain[b], 1) * gate;
        float root_gamma[kSideBySide];
        scatter(root(s / add_product(broadcast(1.0F), s, j.rest_square)), root_gamma, 1);
        for (int k = 0; k < kSideBySide; ++k) {
            scale(h[b + k], root_gamma[k], h[b + k]);
            scale(n[b + k], root_gamma[k], n[b + k]);
        }
    }

    // pass 2: the tendons' share of the load
    pull(h, f.inv_d, z);
    displacement(f, z, scene.scale, summary.x_s, out.dx);
    if ((wanted & kStiffness) != 0) {
        store_stiffness(f, n, scene.inv_scale, out.k_x);
    }
    for (const Row &row : n) {
        Row square = row;
        multiply(square, row);
        add(f.diagonal, square);
    }
    for (int i = 0; i < kMotion; ++i) {
        summary.diag_k_s[i] = f.diagonal[i];
    }
    summary.condition = sum(f.diagonal) * inverse_trace(f);
}

} // namespace AMINN_CORE
} // namespace aminn
