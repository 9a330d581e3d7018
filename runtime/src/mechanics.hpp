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

#include "friction.hpp"

namespace aminn {
inline namespace AMINN_CORE {

// What stage 1's classifier sees of pass 2, and how far apart the stiffnesses lie.
struct StaticsSummary {
    float x_s[kMotion]; // scaled displacement, m
    Row diag_k_s;       // diagonal of the scaled stiffness, N/m
    float condition;    // trace(K) trace(K0^-1), scaled; K0 has no tendons
#if AMINN_N_SLIDE
    Friction friction;
#endif
};

enum Wanted : unsigned { kWantStiffness = 1, kWantDeflection = 2 }; // of k_x and dq0, which nothing else depends on

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
[[gnu::noinline]] static void deflection(const Joints &joints, const Row q[], const float *weight, const Row &z, int g,
                                         float *dq)
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
        result[c] = joints.row_weight[c] * dot_of<3>(joints.q[c], share);
        for (int r = c + 1; r < kCoord; ++r) {
            result[c] = result[c] + joints.lower[below(r, c)] * result[r];
        }
        scatter(result[c], dq + c, kCoord, n);
    }
}

#if AMINN_N_COORD == 3 // only a square j_q has an inverse
// dq0 of a branch as the paper writes it, from the regularised inverse of j_q, and how far it stretches the tendon
[[gnu::noinline]] static float stretch_by_inverse(const aminn_model_t &model, const aminn_input_t &in,
                                                  const float *scale, const float *x_s, float eps_jq,
                                                  const Branches *springs, int b, float dq[3])
{
    Row rows[3 + 3]; // j_q and the motion of the contact; minus the solution falls out below the latter
    Row u[3];
    Row x;
    float unused[2][3];
    load_row(x, x_s);
    for (int i = 0; i < 3; ++i) {
        const float *j = in.j_q[b][i];
        Row a;
        scaled_rows(in, scale, 3 * b + i, 1, &a);
        float values[kMotion] = {j[0], j[1], j[2], dot(a, x), 0.0F, 0.0F};
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

// Row i of the scaled K_x in SI, symmetric to the last bit
AMINN_INLINE void store_in_si(Row &row, const float inv_scale[kMotion], int i, float k_x[kMotion][kMotion])
{
    Row to_si;
    load_row(to_si, inv_scale);
    scale(row, inv_scale[i], row);
    multiply(row, to_si);
    for (int k = i; k < kMotion; ++k) {
        k_x[i][k] = k_x[k][i] = row[k];
    }
}

#if AMINN_N_SLIDE
// Motions beyond the bounds of what is called stable are cut to these as a whole; what float32 cannot tell the size of
// becomes no number.
static void cut_motion(const aminn_model_t &model, float dx[kMotion])
{
    const float size = root(dot3(dx, dx));
    const float angle = root(dot3(dx + 3, dx + 3));
    float share = 1.0F;
    if (size > model.max_translation) {
        share = model.max_translation / size;
    }
    if (angle * share > model.max_rotation) {
        share = model.max_rotation / angle;
    }
    share = share > 0.0F ? share : __builtin_nanf("");
    for (int i = 0; i < kMotion; ++i) {
        dx[i] = share * dx[i];
    }
}
#endif

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

// Both passes, into what out has behind the springs. room: AMINN_N_ROOM floats to work with.
static void two_pass(const aminn_model_t &model, const aminn_stage_model_t &stage, const float *eps_m,
                     const Scene &scene, const aminn_input_t &in, const Branches *springs, unsigned wanted, float *room,
                     aminn_stage_debug_t &out, StaticsSummary &summary)
{
    // pass 1: springs alone
    Grasp grasp;
#if AMINN_LANES
    static_cast<void>(room);
    Joints joints[kGroups];
#else
    static_assert(sizeof(Joints[kGroups]) <= AMINN_N_ROOM * sizeof(float), "there is room");
    auto *joints = reinterpret_cast<Joints *>(room);
#endif
    factor_grasp(springs, in, scene, stage, eps_m, joints, grasp);
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
                stretch[k] = stretch_by_inverse(model, in, scene.scale, summary.x_s, stage.eps_jq, springs, b + k,
                                                out.dq0[b + k]);
            }
            eta = gather(stretch, 1, n);
#endif
        } else if (deflections) {
            deflection(joints[g], grasp.rows + 3 * b, grasp.weight + 3 * b, z, g, out.dq0[b]);
        }
        if constexpr (kGated) {
            engage(springs, g, eta, contact.rest_square, grasp, out.gate + b);
        }
    }

    // pass 2: the tendons' share of the load
#if AMINN_N_SLIDE
    Tendons tendons;
    Footing footings[kGroups];
#if AMINN_LANES
    Slides slides;
#else
    static_assert(sizeof(Slides) <= AMINN_N_ROOM * sizeof(float), "there is room");
    Slides &slides = *reinterpret_cast<Slides *>(room); // in the place of joints
#endif
    if constexpr (kGated) {
        TendonRow u[kBranch];
        transpose(h, y, tendons.rows);
        orthogonalise(tendons.rows, kMotion, kBranch, grasp.inv_d, u, tendons.d, tendons.inv_d);
        take_last(tendons.rows, z);
        multiply(z, inv_d);
    }
    slide(springs, in, grasp, tendons, y, (wanted & kWantDeflection) != 0, slides, footings, z, out, summary.friction);
#else
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
#endif
    displacement(grasp, z, scene.scale, summary.x_s, out.dx);

    Row ones;
    Row inverse_square;
    load_row(ones, kOnes);
    sum_of_squares(summary.diag_k_s, grasp.stiffness, kStiffness, grasp.d);
    sum_of_squares(inverse_square, inverse, kMotion, kOnes);
    summary.condition = dot(summary.diag_k_s, ones) * dot(inverse_square, inv_d);
#if AMINN_N_SLIDE
    cut_motion(model, out.dx);
    if ((wanted & kWantStiffness) != 0) {
#if AMINN_LANES
        Row k_s[kMotion];
#else
        auto *k_s = reinterpret_cast<Row *>(room); // slides have done their work
        static_assert(sizeof(Row[kMotion]) <= sizeof(Slides), "there is room");
#endif
        soften_stiffness(in, scene, footings, grasp, k_s);
        for (int i = 0; i < kMotion; ++i) {
            store_in_si(k_s[i], scene.inv_scale, i, out.k_x);
            out.k_x[i][i] = out.k_x[i][i] + stage.eps_kx;
        }
    }
#else
    if ((wanted & kWantStiffness) != 0) {
        const WeightedRows<kStiffness> weighted(grasp.stiffness, grasp.d);
        for (int i = 0; i < kMotion; ++i) {
            Row row;
            weighted.products_of(i, row);
            store_in_si(row, scene.inv_scale, i, out.k_x);
        }
    }
#endif
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
