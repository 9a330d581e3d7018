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
// Tendons add s d d^T to the joint springs. Their compliance is L^-T (I + s u u^T)^-1 L^-1 with u = L^-1 d, so pass 2 only
// divides the part of G along u by r,  r^2 = 1 + s |u|^2.
//
// All on lengths divided by length_scale (S = diag(1, 1, 1, 1/L, 1/L, 1/L)).
#include "parts.hpp"

namespace aminn {
inline namespace AMINN_CORE {
namespace {

constexpr int kGroups = kBranch / kSideBySide; // of branches that are computed side by side
constexpr int kStacked = 3 * kBranch;

// Joints of a group of branches: indices are [coordinate] and [dimension].
struct Joints {
    Branches inv_diag[3]; // of L
    Branches below[3];    // l10, l20, l21
    Branches g[3][3];     // G
    Branches u[3];        // L^-1 d
    Branches p[3][3];     // upper rows of P
    Branches weight[3];   // sqrt(c / D)
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

AMINN_INLINE Branches dot(const Branches a[3], const Branches b[3])
{
    return add_product(add_product(a[0] * b[0], a[1], b[1]), a[2], b[2]);
}

AMINN_INLINE Branches column_dot(const Branches m[3][3], int i, int j)
{
    return add_product(add_product(m[0][i] * m[0][j], m[1][i], m[1][j]), m[2][i], m[2][j]);
}

[[gnu::noinline]] void read_joints(const Springs &springs, const aminn_input_t &in, int b, Joints &j)
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
            j.g[c][d] = column[c];
        }
    }
}

// Joints and contact compliance in series, seen from the contact: the branch's rows of V, and what the way back needs.
[[gnu::noinline]] void factor_contact(Joints &j, Branches eps_m, Branches contact, const Row a[], Row v[])
{
    for (int c = 0; c < 3; ++c) {
        for (int d = 0; d < 3; ++d) {
            j.p[c][d] = j.g[c][d];
        }
    }
    const Branches one = broadcast(1.0F);
    const Branches d0 = column_dot(j.p, 0, 0) + eps_m;
    const Branches inv0 = one / d0;
    const Branches f01 = column_dot(j.p, 0, 1) * inv0;
    const Branches f02 = column_dot(j.p, 0, 2) * inv0;
    for (int c = 0; c < 3; ++c) {
        j.p[c][1] = subtract_product(j.p[c][1], f01, j.p[c][0]);
        j.p[c][2] = subtract_product(j.p[c][2], f02, j.p[c][0]);
    }
    const Branches d1 = column_dot(j.p, 1, 1) + (eps_m + eps_m * (f01 * f01));
    const Branches inv1 = one / d1;
    const Branches f12 = (column_dot(j.p, 1, 2) + eps_m * (f01 * f02)) * inv1;
    for (int c = 0; c < 3; ++c) {
        j.p[c][2] = subtract_product(j.p[c][2], f12, j.p[c][1]);
    }
    const Branches u02 = f12 * f01 - f02; // of U^-1; u01 = -f01, u12 = -f12
    const Branches d2 = column_dot(j.p, 2, 2) + (eps_m + eps_m * (f12 * f12 + u02 * u02));
    j.weight[0] = root(contact * inv0);
    j.weight[1] = root(contact * inv1);
    j.weight[2] = root(contact / d2);

    float weight[3][kBranch];
    float u[3][kBranch];
    for (int i = 0; i < 3; ++i) {
        scatter(j.weight[i], weight[i], 1);
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
    }
}

// One column of V after the other; V becomes Q. e2: squares of the rows below V.
[[gnu::noinline]] void factorise(Row v[kStacked], const float e2[kMotion], Factor &f)
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
[[gnu::noinline]] void solve_half(const Factor &f, const float w[kMotion], Row &y)
{
    scale(y, w[0], f.inverse[0]);
    for (int i = 1; i < kMotion; ++i) {
        add_scaled(y, w[i], f.inverse[i]);
    }
    multiply(y, f.inv_d);
}

// U^-1 z, scaled and in SI
[[gnu::noinline]] void displacement(const Factor &f, const Row &z, const float to_si[kMotion], float x_s[kMotion],
                                    float dx[kMotion])
{
    for (int i = 0; i < kMotion; ++i) {
        x_s[i] = dot(f.inverse[i], z);
        dx[i] = to_si[i] * x_s[i];
    }
}

// trace(K_x) trace(K_x^-1), K_x scaled
float condition_bound(const Factor &f)
{
    float inverse_trace = 0.0F;
    for (const Row &inverse : f.inverse) {
        Row square = inverse;
        multiply(square, inverse);
        inverse_trace = inverse_trace + dot(square, f.inv_d);
    }
    return sum(f.diagonal) * inverse_trace;
}

// K_x = U^T D U in SI, symmetric to the last bit
void store_stiffness(const Factor &f, const float inv_scale[kMotion], float k_x[kMotion][kMotion])
{
    for (int i = 0; i < kMotion; ++i) {
        Row row;
        scale(row, f.scaled[0][i], f.upper[0]);
        for (int j = 1; j <= i; ++j) {
            add_scaled(row, f.scaled[j][i], f.upper[j]);
        }
        for (int k = i; k < kMotion; ++k) {
            k_x[i][k] = k_x[k][i] = (row[k] * inv_scale[i]) * inv_scale[k];
        }
    }
}

// G with a tendon of stiffness s along u: its part along u divided by r. What is left of that part in the rest after
// rounding is taken out once more, because the tendon may be much stiffer than the springs.
[[gnu::noinline]] void shorten(Joints &j, Branches s)
{
    const Branches square = dot(j.u, j.u);
    const Branches inv_square = broadcast(1.0F) / square;
    const Branches inv_r = broadcast(1.0F) / root(add_product(broadcast(1.0F), s, square));
    for (int d = 0; d < 3; ++d) {
        Branches g[3] = {j.g[0][d], j.g[1][d], j.g[2][d]};
        const Branches along = dot(j.u, g) * inv_square;
        for (int c = 0; c < 3; ++c) {
            g[c] = subtract_product(g[c], along, j.u[c]);
        }
        const Branches left = dot(j.u, g) * inv_square;
        const Branches shortened = subtract_product((along + left) * inv_r, left, broadcast(1.0F));
        for (int c = 0; c < 3; ++c) {
            j.g[c][d] = add_product(g[c], shortened, j.u[c]);
        }
    }
}

// deflection of the branches' coordinates with springs alone
[[gnu::noinline]] void deflection(Joints &j, const float strain[][3], Branches dq[3])
{
    Branches share[3];
    for (int i = 0; i < 3; ++i) {
        share[i] = j.weight[i] * gather(&strain[0][i], 3);
    }
    for (int c = 0; c < 3; ++c) {
        dq[c] = dot(j.p[c], share);
    }
    solve_backward(j, dq);
}

// the same as the paper writes it, from the regularised inverse of j_q (by cofactors), for one branch
void deflection_by_inverse(const aminn_input_t &in, int b, const float dx0[kMotion], float eps_jq, float dq[3])
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
              const aminn_input_t &in, aminn_stage_debug_t &out, StaticsSummary &summary)
{
    Row v[kStacked];
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
        factor_contact(joints[g], eps_m, gather(in.contacts[b], AMINN_N_CONTACT_FEATURE), scene.a_s + 3 * b, v + 3 * b);
    }
    factorise(v, e2, f);
    Row z;
    solve_half(f, scene.w_s, z);
    displacement(f, z, scene.scale, summary.x_s, out.dx0);

    // how far each tendon would be stretched decides how much it engages; then the joints with engaged tendons
    float strain[kBranch][3];
    for (int r = 0; r < kStacked; ++r) {
        strain[r / 3][r % 3] = dot(v[r], z);
    }
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        Joints &j = joints[g];
        Branches dq[3];
        if (model.dq0 == AMINN_DQ0_STATICS) {
            deflection(j, strain + b, dq);
        } else {
            float by_inverse[kSideBySide][3];
            for (int k = 0; k < kSideBySide; ++k) {
                deflection_by_inverse(in, b + k, out.dx0, stage.eps_jq, by_inverse[k]);
            }
            for (int c = 0; c < 3; ++c) {
                dq[c] = gather(&by_inverse[0][c], 3);
            }
        }
        Branches d[3];
        for (int c = 0; c < 3; ++c) {
            dq[c] = dq[c] * gather(model.coord_mask + 3 * b + c, 3);
            d[c] = gather(&springs.tendon_dir[c][b], 1);
            scatter(dq[c], &out.dq0[b][c], 3);
        }
        const Branches alpha = gather(&springs.gate_params[0][b], 1);
        const Branches beta = gather(&springs.gate_params[1][b], 1);
        const Branches rho = gather(&springs.gate_params[2][b], 1);
        const Branches gate = sigmoid(alpha * (dot(dq, d) - beta) + rho);
        scatter(gate, out.gate + b, 1);

        shorten(j, gather(&springs.tendon_gain[b], 1) * gate);
        factor_contact(j, eps_m, gather(in.contacts[b], AMINN_N_CONTACT_FEATURE), scene.a_s + 3 * b, v + 3 * b);
    }

    // pass 2
    factorise(v, e2, f);
    solve_half(f, scene.w_s, z);
    displacement(f, z, scene.scale, summary.x_s, out.dx);
    store_stiffness(f, scene.inv_scale, out.k_x);
    for (int i = 0; i < kMotion; ++i) {
        summary.diag_k_s[i] = f.diagonal[i];
    }
    summary.condition = condition_bound(f);
}

} // namespace AMINN_CORE
} // namespace aminn
