// The two-pass statics layer.
//
//   K_x = sum_b c_b A_b^T M_b^-1 A_b + eps_kx I,   M_b = B_b K_b^-1 B_b^T + eps_m I
//
// in square-root form: no stiffness is formed before it is solved with, which would lose half of float32's digits (its
// stiffest direction is 1/eps_m, its softest the springs'). One factorisation does it, three times: stacked rows R with
// weights W become Q U, with Q^T W Q = D diagonal and ones on the diagonal of U, by modified Gram-Schmidt without square
// roots. Below the rows stands an identity with weights of its own, which becomes U^-1. K_b = L Delta L^T, L with ones on
// its diagonal, are the joint springs, d the tendon's direction:
//
//              rows                  their weights   below       gives
//   contact    L^-1 [ B^T | d ]      Delta^-1        eps_m       M = U^T D U; t, the column of U for d; rho^2, what is left of d
//   tool       V_b = U_b^-T A_b      c_b / D_b       eps_kx      K_x = U^T D U; y = U^-T w
//   tendons    [ H | y ]             D^-1            1 / gamma   what the tendons leave of y
//
// A branch's contact has a row for each of its coordinates, and columns for the 3 dimensions of space and d.
//
// Rows that are weighted, not scaled, keep the digits of B and A. The displacement is x = U^-1 D^-1 y, the strain of the
// stacked springs V x = Q D^-1 y, from which the deflection of the joints follows without cancellation.
//
// Pass 2 adds a tendon s d d^T to the springs of each branch. It makes K_x stiffer by one direction,
//
//   K_x + sum_b gamma_b m_b m_b^T,   1 / gamma = 1 / s + rho^2,   m = sqrt(c) V_b^T t
//
// The load that stretches the tendon is felt through m as well: <dq, d> = sqrt(c) m.x. Nothing of the tool is factorised
// again: with H = U^-T m = sqrt(c) Q_b^T t, K_x = U^T (D + H gamma H^T) U.
//
// A hand without tendons has neither d nor H, and no pass 2: its motion is that of pass 1. A branch without one adds nothing
// to any sum: its d is zero.
//
// A soft fingertip also resists twisting about the contact's normal n. That is a row (0, n) more among the tool's, of weight c_b k_b.
//
// All on lengths divided by length_scale (S = diag(1, 1, 1, 1/L, 1/L, 1/L)).
#ifndef AMINN_SRC_MECHANICS_HPP
#define AMINN_SRC_MECHANICS_HPP

#include "springs.hpp"

namespace aminn {
inline namespace AMINN_CORE {

// What the statics need of an input, the same for both stages. "Scaled": lengths divided by length_scale.
struct Scene {
    Row a_s[3 * kBranch]; // rows of j_x S
    float w_s[kMotion];   // S w_e
    float scale[kMotion]; // S
    float inv_scale[kMotion];
};

// What stage 1's classifier sees of pass 2, and how far apart the stiffnesses lie.
struct StaticsSummary {
    float x_s[kMotion]; // scaled displacement, m
    Row diag_k_s;       // diagonal of the scaled stiffness, N/m
    float condition;    // trace(K) trace(K0^-1), scaled; K0 has no tendons
};

enum Wanted : unsigned { kWantStiffness = 1, kWantDeflection = 2 }; // of k_x and dq0, which nothing else depends on

constexpr int kStacked = 3 * kBranch;
constexpr int kHeld = kTwisted ? kStacked + kBranch : kStacked; // rows of the tool above the identity
constexpr int kTendons = kGated ? kBranch : 0;
constexpr int kStiffness = kMotion + kTendons; // rows of the factor U, and m of the tendons
constexpr float kSlack = 1e30F; // compliance of a tendon that does not engage at all, which nothing can show

// Joints and contact compliance of the branches of a group, in series, seen from the contact.
struct Contact {
    ContactRow rows[kCoord + 3]; // a row for each coordinate: Q, and in column 3 what is left of d; U^-1 below
    Branches row_weight[kCoord + 3];
    Branches lower[kCoord > 1 ? kBelow : 1]; // of L, with the other sign: 10, 20, 21 ..
    Branches t[3];                           // sqrt(c) t
    Branches rest_square;                    // rho^2
    Branches root_contact;                   // sqrt(c)
};

// The grasp with springs alone, and its tendons.
struct Grasp {
    Contact contact[kGroups];
    Row rows[kHeld + kMotion];     // V, then Q; U^-1 below
    float weight[kHeld + kMotion]; // of the rows
    Row stiffness[kStiffness];     // U; m of the tendons
    float d[kStiffness];           // D; gamma
    float inv_d[kStiffness];       // D^-1; 1 / gamma
};

// The first columns of rows with an identity as wide below, which this writes: rows becomes Q, and D and U come out.
template <class AnyRow, class Number>
AMINN_FUNCTION void orthogonalise(AnyRow *rows, int above, int columns, const Number *weight, AnyRow *u, Number *d,
                                  Number *inv_d)
{
    AMINN_UNROLL_ROWS
    for (int j = 0; j < columns; ++j) {
        const int n = above + j + 1; // further down, column j is zero
        clear(rows[above + j]);
        set_component(rows[above + j], j, 1.0F);
        inner_products(u[j], rows, n, weight, j);
        d[j] = u[j][j];
        inv_d[j] = scale_by_component(u[j], j);
        clear_up_to(u[j], j);
        if (j < kMotion - 1) { // behind the last there is nothing
            eliminate(rows, n, j, u[j]);
        }
        set_component(u[j], j, 1.0F);
    }
}

// T^-1 of n rows, T lower triangular with ones on its diagonal; its other entries (10, 20, 21 ..) with the other sign
template <int n, class AnyRow, class Number>
AMINN_FUNCTION void substitute(AnyRow *rows, const Number *minus_t)
{
    for (int r = 1; r < n; ++r) {
        for (int c = 0; c < r; ++c) {
            add_scaled(rows[r], minus_t[below(r, c)], rows[c]);
        }
    }
}

// v: the branches' rows of A, which become those of V, with these weights
AMINN_FUNCTION void factor_contact(const Branches *springs, const aminn_input_t &in, int g, const float *eps_m,
                                   Contact &contact, Row *v, float *weight)
{
    const int b = g * kSideBySide;
    const int n = in_group(g);
    ContactRow *rows = contact.rows;
    Branches inv_diag[kCoord];
    const Branches compliance = gather(eps_m + b, 1, n);
    for (int c = 0; c < kCoord; ++c) {
        const Branches values[kMotion] = {
            -gather(&in.j_q[b][0][c], 3 * kCoord, n), -gather(&in.j_q[b][1][c], 3 * kCoord, n),
            -gather(&in.j_q[b][2][c], 3 * kCoord, n), kGated ? springs[at(kDir + c, g)] : Branches{}};
        load_row(rows[c], values);
        inv_diag[c] = 1.0F / springs[at(kDiag + c, g)];
        contact.row_weight[c] = inv_diag[c] * inv_diag[c];
        if (kCoord <= 3 || c < 3) { // a row for each dimension of space, below
            contact.row_weight[kCoord + c] = compliance;
        }
    }
    if constexpr (kCoord < 3) {
        for (int i = kCoord; i < 3; ++i) {
            contact.row_weight[kCoord + i] = compliance;
        }
    }
    for (int r = 1; r < kCoord; ++r) {
        for (int c = 0; c < r; ++c) {
            contact.lower[below(r, c)] = -(springs[at(kOff + below(r, c), g)] * inv_diag[c]);
        }
    }
    substitute<kCoord>(rows, contact.lower);
    ContactRow u[3];
    Branches d[3];
    Branches inv_d[3];
    orthogonalise(rows, kCoord, 3, contact.row_weight, u, d, inv_d);
    if constexpr (kGated) {
        ContactRow rest;
        inner_products(rest, rows, kCoord + 3, contact.row_weight, 3);
        contact.rest_square = rest[3];
    }
    const Branches c = gather(in.contacts[b], AMINN_N_CONTACT_FEATURE, n);
    if constexpr (kGated) {
        contact.root_contact = root(c);
    }
    float minus_u[kSideBySide][3];
    scatter(-u[0][1], &minus_u[0][0], 3, n);
    scatter(-u[0][2], &minus_u[0][1], 3, n);
    scatter(-u[1][2], &minus_u[0][2], 3, n);
    for (int i = 0; i < 3; ++i) {
        if constexpr (kGated) {
            contact.t[i] = contact.root_contact * u[i][3];
        }
        scatter(c * inv_d[i], weight + i, 3, n);
    }
    for (int k = 0; k < n; ++k) {
        substitute<3>(v + 3 * k, minus_u[k]);
    }
}

// to[k] = the 3 rows of branch k of a group, summed with its coefficients
AMINN_FUNCTION static void combine_branches(Row to[], const Row rows[], const Branches coefficient[3], int g)
{
    const int n = in_group(g);
    float c[3][kSideBySide];
    for (int i = 0; i < 3; ++i) {
        scatter(coefficient[i], c[i], 1, n);
    }
    for (int k = 0; k < n; ++k) {
        const float own[3] = {c[0][k], c[1][k], c[2][k]};
        combine(to[k], rows + 3 * k, 3, own);
    }
}

static void factor_grasp(const Branches *springs, const aminn_input_t &in, const Scene &scene,
                         const aminn_stage_model_t &stage, const float *eps_m, Grasp &grasp)
{
    std::memcpy(grasp.rows, scene.a_s, sizeof scene.a_s);
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        Row *v = grasp.rows + 3 * b;
        factor_contact(springs, in, g, eps_m, grasp.contact[g], v, grasp.weight + 3 * b);
        if constexpr (kGated) {
            combine_branches(grasp.stiffness + kMotion + b, v, grasp.contact[g].t, g);
        }
    }
    if constexpr (kTwisted) {
        for (int b = 0; b < kBranch; ++b) {
            const float *contact = in.contacts[b];
            const float *scale = scene.scale + 3;
            const float about[kMotion] = {
                0.0F, 0.0F, 0.0F, contact[4] * scale[0], contact[5] * scale[1], contact[6] * scale[2]};
            load_row(grasp.rows[kStacked + b], about);
            grasp.weight[kStacked + b] = contact[0] * of_branch(springs, kTwist, b);
        }
    }
    for (int i = 0; i < kMotion; ++i) {
        grasp.weight[kHeld + i] = (stage.eps_kx * scene.scale[i]) * scene.scale[i];
    }
    orthogonalise(grasp.rows, kHeld, kMotion, grasp.weight, grasp.stiffness, grasp.d, grasp.inv_d);
}

// U^-1 z, scaled and in SI
AMINN_FUNCTION void displacement(const Grasp &grasp, const Row &z, const float to_si[kMotion], float x_s[kMotion],
                                 float dx[kMotion])
{
    dots(grasp.rows + kHeld, kMotion, z, x_s);
    for (int i = 0; i < kMotion; ++i) {
        dx[i] = to_si[i] * x_s[i];
    }
}

// dq0 of the branches of a group, from their rows of Q
[[gnu::noinline]] static void deflection(const Contact &contact, const Row q[], const float *weight, const Row &z,
                                         int g, float *dq)
{
    const int n = in_group(g);
    Branches share[3];
    Branches result[kCoord];
    for (int i = 0; i < 3; ++i) {
        float strain[kSideBySide] = {};
        for (int k = 0; k < n; ++k) {
            strain[k] = dot(q[3 * k + i], z);
        }
        share[i] = gather(weight + i, 3, n) * gather(strain, 1, n);
    }
    for (int c = kCoord - 1; c >= 0; --c) {
        result[c] = contact.row_weight[c] * dot_of<3>(contact.rows[c].v, share);
        for (int r = c + 1; r < kCoord; ++r) {
            result[c] = result[c] + contact.lower[below(r, c)] * result[r];
        }
        scatter(result[c], dq + c, kCoord, n);
    }
}

#if AMINN_N_COORD == 3 // only a square j_q has an inverse
// dq0 of a branch as the paper writes it, from the regularised inverse of j_q, and how far it stretches the tendon
[[gnu::noinline]] static float stretch_by_inverse(const aminn_model_t &model, const aminn_input_t &in, const Row a[3],
                                                  const float *x_s, float eps_jq, const Branches *springs, int b,
                                                  float dq[3])
{
    Row rows[3 + 3]; // j_q and the motion of the contact; minus the solution falls out below the latter
    Row u[3];
    Row x;
    float unused[2][3];
    load_row(x, x_s);
    for (int i = 0; i < 3; ++i) {
        const float *j = in.j_q[b][i];
        float values[kMotion] = {j[0], j[1], j[2], dot(a[i], x), 0.0F, 0.0F};
        values[i] = values[i] + eps_jq;
        load_row(rows[i], values);
    }
    orthogonalise(rows, 3, 3, kThreeOnes, u, unused[0], unused[1]);
    float stretch = 0.0F;
    for (int c = 0; c < 3; ++c) {
        dq[c] = (model.coord_mask[3 * b + c] * in.contacts[b][0]) * rows[3 + c][3];
        if constexpr (kGated) {
            stretch = add_product(stretch, dq[c], of_branch(springs, kDir + c, b));
        }
    }
    return stretch;
}
#endif

// K_x in SI, symmetric to the last bit
static void store_stiffness(const Grasp &grasp, const float inv_scale[kMotion], float k_x[kMotion][kMotion])
{
    Row to_si;
    load_row(to_si, inv_scale);
    const WeightedRows<kStiffness> weighted(grasp.stiffness, grasp.d);
    for (int i = 0; i < kMotion; ++i) {
        Row row;
        weighted.products_of(i, row);
        scale(row, inv_scale[i], row);
        multiply(row, to_si);
        for (int k = i; k < kMotion; ++k) {
            k_x[i][k] = k_x[k][i] = row[k];
        }
    }
}

AMINN_INLINE void make_scene(const aminn_model_t &model, const aminn_input_t &in, Scene &scene)
{
    const float inv_length = 1.0F / model.length_scale;
    for (int i = 0; i < 3; ++i) {
        scene.scale[i] = 1.0F;
        scene.inv_scale[i] = 1.0F;
        scene.w_s[i] = in.w_e[i];
        scene.scale[3 + i] = inv_length;
        scene.inv_scale[3 + i] = model.length_scale;
        scene.w_s[3 + i] = in.w_e[3 + i] * inv_length;
    }
    Row to_scaled;
    load_row(to_scaled, scene.scale);
    const auto *j_x = reinterpret_cast<const float *>(in.j_x);
    for (int r = 0; r < 3 * kBranch; ++r) {
        load_row(scene.a_s[r], j_x + kMotion * r);
        multiply(scene.a_s[r], to_scaled);
    }
}

// The gates of a group, and how stiff its tendons are with them.
AMINN_INLINE void engage(const Branches *springs, int g, Branches eta, Branches rest_square, Grasp &grasp, float *gate)
{
    const int place = kMotion + g * kSideBySide;
    const int n = in_group(g);
    // a sigmoid, of whose inverse the tendon's compliance is made
    const Branches inv_gate =
        1.0F + exponential(springs[at(kAlpha, g)] * (springs[at(kBeta, g)] - eta) - springs[at(kRho, g)]);
    Branches gain = springs[at(kGain, g)];
    Branches engaged = 1.0F / inv_gate;
    if constexpr (kSomeLack) {
        engaged = where_not_zero(gain, engaged);
        gain = gain != 0.0F ? gain : broadcast(1.0F); // of no direction
    }
    scatter(engaged, gate, 1, n);
    const Branches inv_gamma = least(broadcast(kSlack), inv_gate / gain + rest_square);
    scatter(inv_gamma, grasp.inv_d + place, 1, n);
    scatter(1.0F / inv_gamma, grasp.d + place, 1, n);
}

// Both passes, into what out has behind the springs.
static void two_pass(const aminn_model_t &model, const aminn_stage_model_t &stage, const float *eps_m,
                     const Scene &scene, const aminn_input_t &in, const Branches *springs, unsigned wanted,
                     aminn_stage_debug_t &out, StaticsSummary &summary)
{
    // pass 1: springs alone
    Grasp grasp;
    factor_grasp(springs, in, scene, stage, eps_m, grasp);
    const Row *inverse = grasp.rows + kHeld;
    Row inv_d;
    load_row(inv_d, grasp.inv_d);
    Row y;
    combine(y, inverse, kMotion, scene.w_s);
    Row z = y;
    multiply(z, inv_d);

    // how far each tendon would be stretched decides how much it engages
    const bool by_inverse = kCoord == 3 && model.dq0 == AMINN_DQ0_INVERSE;
    const bool deflections = by_inverse || (wanted & kWantDeflection) != 0;
    if (deflections) {
        displacement(grasp, z, scene.scale, summary.x_s, out.dx0);
    }
    Row h[kBranch];
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        const int n = in_group(g);
        const Contact &contact = grasp.contact[g];
        float stretch[kSideBySide] = {};
        Branches eta;
        if constexpr (kGated) {
            combine_branches(h + b, grasp.rows + 3 * b, contact.t, g);
            dots(h + b, n, z, stretch);
            eta = contact.root_contact * gather(stretch, 1, n);
        }
        if (by_inverse) {
#if AMINN_N_COORD == 3
            for (int k = 0; k < n; ++k) {
                const Row *a = scene.a_s + 3 * (b + k);
                stretch[k] =
                    stretch_by_inverse(model, in, a, summary.x_s, stage.eps_jq, springs, b + k, out.dq0[b + k]);
            }
            eta = gather(stretch, 1, n);
#endif
        } else if (deflections) {
            deflection(contact, grasp.rows + 3 * b, grasp.weight + 3 * b, z, g, out.dq0[b]);
        }
        if constexpr (kGated) {
            engage(springs, g, eta, contact.rest_square, grasp, out.gate + b);
        }
    }

    // pass 2: the tendons' share of the load
    if constexpr (kGated) {
#if AMINN_LANES || AMINN_N_BRANCH < 3
        TendonRow rows[kMotion + kBranch];
        TendonRow u[kBranch];
#else
        static_assert(kMotion + kBranch <= kStacked, "there is room for the tendons' rows before U^-1");
        TendonRow *rows = grasp.rows; // Q has done its work
        TendonRow *u = h;
#endif
        float unused[2][kBranch];
        transpose(h, y, rows);
        orthogonalise(rows, kMotion, kBranch, grasp.inv_d, u, unused[0], unused[1]);
        take_last(rows, z);
        multiply(z, inv_d);
    }
    displacement(grasp, z, scene.scale, summary.x_s, out.dx);

    if ((wanted & kWantStiffness) != 0) {
        store_stiffness(grasp, scene.inv_scale, out.k_x);
    }
    Row ones;
    Row inverse_square;
    load_row(ones, kOnes);
    sum_of_squares(summary.diag_k_s, grasp.stiffness, kStiffness, grasp.d);
    sum_of_squares(inverse_square, inverse, kMotion, kOnes);
    summary.condition = dot(summary.diag_k_s, ones) * dot(inverse_square, inv_d);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
