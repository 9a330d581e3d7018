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

constexpr int kSeen = kGated ? 4 : 3; // dimensions of space, and d

// Joints and contact compliance of the branches of a group, in series, seen from the contact: the joints, of which nothing
// is left to know behind pass 1,
struct Joints {
    Branches q[kCoord][kSeen]; // a row for each coordinate: Q, and what is left of d
    Branches row_weight[kCoord];
    Branches lower[kCoord > 1 ? kBelow : 1]; // of L, with the other sign: 10, 20, 21 ..
};
// and the contacts.
struct Contact {
    Branches minus_u[3];   // of U, with the other sign: 01, 02, 12
    Branches d[3];         // D
    Branches t[3];         // sqrt(c) t
    Branches rest_square;  // rho^2
    Branches root_contact; // sqrt(c)
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

// The rows of a group's contacts, which become Q, and their weights are orthogonalised as orthogonalise() does it, written
// out: below them the identity is known, and so are the zeros of U^-1.
AMINN_INLINE void orthogonalise_contact(Joints &joints, Contact &contact, Branches compliance, Branches u[3][kSeen],
                                        Branches inv_d[3])
{
    Branches q[kCoord + 3][kSeen];
    AMINN_UNROLL
    for (int c = 0; c < kCoord; ++c) {
        AMINN_UNROLL
        for (int k = 0; k < kSeen; ++k) {
            q[c][k] = joints.q[c][k];
        }
    }
    Branches sum[2][kSeen]; // over even rows and over odd ones
    const auto add = [&](int r, int j, int from) AMINN_ALWAYS {
        const Branches share = (r < kCoord ? joints.row_weight[r] : compliance) * q[r][j];
        AMINN_UNROLL
        for (int k = from; k < kSeen; ++k) {
            sum[r % 2][k] = r < 2 ? share * q[r][k] : add_product(sum[r % 2][k], share, q[r][k]);
        }
    };
    AMINN_UNROLL
    for (int j = 0; j < 3; ++j) {
        const int n = kCoord + j;
        AMINN_UNROLL
        for (int r = 0; r < n; ++r) {
            add(r, j, j);
        }
        sum[n % 2][j] = kCoord < 2 && n < 2 ? compliance : sum[n % 2][j] + compliance;
        contact.d[j] = sum[0][j] + sum[1][j];
        inv_d[j] = 1.0F / contact.d[j];
        AMINN_UNROLL
        for (int k = j + 1; k < kSeen; ++k) {
            u[j][k] = inv_d[j] * (kCoord < 2 && n < 2 ? sum[0][k] : sum[0][k] + sum[1][k]);
            AMINN_UNROLL
            for (int r = 0; r < n; ++r) {
                q[r][k] = subtract_product(q[r][k], q[r][j], u[j][k]);
            }
            q[n][k] = -u[j][k];
        }
    }
    if constexpr (kGated) {
        AMINN_UNROLL
        for (int r = 0; r < kCoord + 3; ++r) {
            add(r, 3, 3);
        }
        contact.rest_square = sum[0][3] + sum[1][3];
    }
    AMINN_UNROLL
    for (int c = 0; c < kCoord; ++c) {
        AMINN_UNROLL
        for (int k = 0; k < 3; ++k) {
            joints.q[c][k] = q[c][k];
        }
    }
}

// v: the branches' rows of A, which become those of V, with these weights
AMINN_FUNCTION void factor_contact(const Branches *springs, const aminn_input_t &in, int g, const float *eps_m,
                                   Joints &joints, Contact &contact, Row *v, float *weight)
{
    const int b = g * kSideBySide;
    const int n = in_group(g);
    Branches inv_diag[kCoord];
    for (int c = 0; c < kCoord; ++c) {
        for (int i = 0; i < 3; ++i) {
            joints.q[c][i] = -gather(&in.j_q[b][i][c], 3 * kCoord, n);
        }
        if constexpr (kGated) {
            joints.q[c][3] = springs[at(kDir + c, g)];
        }
        inv_diag[c] = 1.0F / springs[at(kDiag + c, g)];
        joints.row_weight[c] = inv_diag[c] * inv_diag[c];
        for (int r = 0; r < c; ++r) { // L^-1
            const Branches minus_l = -(springs[at(kOff + below(c, r), g)] * inv_diag[r]);
            joints.lower[below(c, r)] = minus_l;
            for (int i = 0; i < kSeen; ++i) {
                joints.q[c][i] = add_product(joints.q[c][i], minus_l, joints.q[r][i]);
            }
        }
    }
    Branches u[3][kSeen];
    Branches inv_d[3];
    orthogonalise_contact(joints, contact, gather(eps_m + b, 1, n), u, inv_d);
    const Branches c = gather(in.contacts[b], AMINN_N_CONTACT_FEATURE, n);
    if constexpr (kGated) {
        contact.root_contact = root(c);
    }
    contact.minus_u[0] = -u[0][1];
    contact.minus_u[1] = -u[0][2];
    contact.minus_u[2] = -u[1][2];
    for (int i = 0; i < 3; ++i) {
        if constexpr (kGated) {
            contact.t[i] = contact.root_contact * u[i][3];
        }
        scatter(c * inv_d[i], weight + i, 3, n);
    }
    for (int k = 0; k < n; ++k) {
        float room[3];
        substitute<3>(v + 3 * k, three_of(contact.minus_u, k, room));
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
                         const aminn_stage_model_t &stage, const float *eps_m, Joints joints[kGroups], Grasp &grasp)
{
    take_rows(in, scene, grasp.rows);
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        Row *v = grasp.rows + 3 * b;
        factor_contact(springs, in, g, eps_m, joints[g], grasp.contact[g], v, grasp.weight + 3 * b);
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
