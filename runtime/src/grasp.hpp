// A grasp before its tendons engage: joints and contact of each branch in series, seen from the contact, and the stack of all
// of them, seen from the tool. mechanics.hpp has the method.
#ifndef AMINN_SRC_GRASP_HPP
#define AMINN_SRC_GRASP_HPP

#include "scene.hpp"
#include "springs.hpp"

namespace aminn {
inline namespace AMINN_CORE {

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
    Branches minus_u[kSliding ? 3 : 1];      // of U, with the other sign: 01, 02, 12
    Branches d[kSliding ? 3 : 1];            // D
    Branches t[3];                           // sqrt(c) t
    Branches rest_square;                    // rho^2
    Branches root_contact;                   // sqrt(c)
};

// The grasp with springs alone, and its tendons.
struct Grasp {
    Contact contact[kGroups];
    Row rows[kHeld + kMotion];                                 // V, then Q; U^-1 below
    float weight[kHeld + kMotion + (kSliding ? kTendons : 0)]; // of the rows, and of the tendons' as slides see them
    Row stiffness[kStiffness];                                 // U; m of the tendons
    float d[kStiffness];                                       // D; gamma
    float inv_d[kStiffness];                                   // D^-1; 1 / gamma
};

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
        inner_products(rest, rows, kCoord + 3, contact.row_weight, rows, 3);
        contact.rest_square = rest[3];
    }
    const Branches c = gather(in.contacts[b], AMINN_N_CONTACT_FEATURE, n);
    if constexpr (kGated) {
        contact.root_contact = root(c);
    }
    const Branches minus_u[3] = {-u[0][1], -u[0][2], -u[1][2]};
    if constexpr (kSliding) {
        for (int i = 0; i < 3; ++i) {
            contact.minus_u[i] = minus_u[i];
            contact.d[i] = d[i];
        }
    }
    for (int i = 0; i < 3; ++i) {
        if constexpr (kGated) {
            contact.t[i] = contact.root_contact * u[i][3];
        }
        scatter(c * inv_d[i], weight + i, 3, n);
    }
    for (int k = 0; k < n; ++k) {
        float room[3];
        substitute<3>(v + 3 * k, three_of(minus_u, k, room));
    }
}

// to[k] = the 3 rows of branch k of a group, summed with its coefficients
template <class AnyRow>
AMINN_FUNCTION void combine_branches(AnyRow to[], const AnyRow rows[], const Branches coefficient[3], int g)
{
    const int n = in_group(g);
    for (int k = 0; k < n; ++k) {
        float room[3];
        combine(to[k], rows + 3 * k, 3, three_of(coefficient, k, room));
    }
}

// what soft fingertips resist: a row about each contact's normal
AMINN_INLINE void twist_rows(const aminn_input_t &in, const Scene &scene, Grasp &grasp)
{
    for (int b = 0; b < kBranch; ++b) {
        const float *contact = in.contacts[b];
        const float *scale = scene.scale + 3;
        const float about[kMotion] = {
            0.0F, 0.0F, 0.0F, contact[4] * scale[0], contact[5] * scale[1], contact[6] * scale[2]};
        load_row(grasp.rows[kStacked + b], about);
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
        twist_rows(in, scene, grasp);
        for (int b = 0; b < kBranch; ++b) {
            grasp.weight[kStacked + b] = in.contacts[b][0] * of_branch(springs, kTwist, b);
        }
    }
    for (int i = 0; i < kMotion; ++i) {
        grasp.weight[kHeld + i] = (stage.eps_kx * scene.scale[i]) * scene.scale[i];
    }
    orthogonalise(grasp.rows, kHeld, kMotion, grasp.weight, grasp.stiffness, grasp.d, grasp.inv_d);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
