// The mechanics head: 39 raw numbers become corrections to the nominal springs, tendons and gates.
#ifndef AMINN_SRC_SPRINGS_HPP
#define AMINN_SRC_SPRINGS_HPP

#include "lanes.hpp"

namespace aminn {
inline namespace AMINN_CORE {

// The head's outputs, in this order, each for the three branches. What tanh bounds stands first, what exp of that makes
// a factor before the rest of it: so both run over whole arrays.
enum Head {
    kDiag = 0,  // 3: the Cholesky factor's diagonal
    kGain = 3,  // the tendon's
    kAlpha = 4, // the gate's
    kFactors = 5,
    kOff = 5, // 3: entries 10, 20, 21
    kBounded = 8,
    kDir = 8, // 3: direction of the tendon
    kBeta = 11,
    kRho = 12,
    kEnd = 13
};
static_assert(kEnd * kBranch == AMINN_N_HEAD, "head layout");

// What becomes of the head's outputs, the "springs" of a stage: in the same order, and of the joint springs K = L L^T the
// entries of L up to its diagonal. Without vector registers they take the place of the head's numbers. With them they are
// an array of vectors: one that is loaded from what several stores have just written waits for all of them to retire.
constexpr int at(int output, int group)
{
    return output * kGroups + group;
}
AMINN_INLINE float of_branch(const Branches *springs, int output, int b)
{
#if AMINN_LANES
    return springs[output][b];
#else
    return springs[at(output, b)];
#endif
}

// With vector registers a whole number of them is computed at once; what is beyond the factors is not used.
constexpr int kComputed = AMINN_LANES ? (kFactors * kBranch + 7) / 8 * 8 : kFactors * kBranch;
static_assert(kComputed <= kBounded * kBranch, "they are all bounded");

// head is overwritten, and may be springs.
static void springs_from_head(const aminn_model_t &model, float *head, Branches *springs)
{
    for (int i = 0; i < kBounded * kBranch; ++i) {
        head[i] = hyperbolic_tangent(head[i]);
    }
    float factor[kComputed];
    for (int i = 0; i < kComputed; ++i) {
        factor[i] = exponential(model.log_range * head[i]);
    }
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        const auto raw = [&](int output) { return gather(head + output * kBranch + b, 1); };
        // cppcheck-suppress uninitvar ; the loop above fills all of it
        const auto scaling = [&](int output) { return gather(factor + output * kBranch + b, 1); };
        Branches nominal[6];
        Branches mask[3];
        for (int i = 0; i < 6; ++i) {
            nominal[i] = gather(model.chol_nom + 6 * b + i, 6);
        }
        for (int i = 0; i < 3; ++i) {
            mask[i] = gather(model.coord_mask + 3 * b + i, 3);
        }
        Branches v[3];
        for (int i = 0; i < 3; ++i) {
            springs[at(kDiag + i, g)] = mask[i] != 0.0F ? nominal[i] * scaling(kDiag + i) : nominal[i];
            const int row = i == 0 ? 1 : 2; // of the i-th entry below the diagonal
            const int column = i / 2;
            const Branches size = root(nominal[row] * nominal[column]);
            springs[at(kOff + i, g)] = (nominal[3 + i] + size * raw(kOff + i)) * (mask[row] * mask[column]);
            v[i] = (gather(model.tendon_dir_nom + 3 * b + i, 3) + raw(kDir + i)) * mask[i];
        }
        const Branches inv_norm = 1.0F / root(dot(v, v) + 1e-12F);
        for (int i = 0; i < 3; ++i) {
            springs[at(kDir + i, g)] = v[i] * inv_norm;
        }
        const float *gate = model.gate_nom;
        springs[at(kGain, g)] = gather(model.tendon_gain_nom + b, 1) * scaling(kGain);
        springs[at(kAlpha, g)] = gate[0] * scaling(kAlpha);
        springs[at(kBeta, g)] = gate[1] * raw(kBeta);
        springs[at(kRho, g)] = gate[2] + raw(kRho);
    }
}

// Where an output stands in aminn_stage_debug_t, and how far apart its branches are there, in floats.
struct Place {
    uint8_t first;
    uint8_t stride;
};
constexpr Place place(size_t field, int i, int stride)
{
    return {static_cast<uint8_t>(static_cast<int>(field / sizeof(float)) + i), static_cast<uint8_t>(stride)};
}
constexpr Place in_spring(int row, int column)
{
    return place(offsetof(aminn_stage_debug_t, k_spring), AMINN_N_COORD * row + column, AMINN_N_COORD * AMINN_N_COORD);
}
constexpr Place in_dir(int i)
{
    return place(offsetof(aminn_stage_debug_t, tendon_dir), i, AMINN_N_COORD);
}
constexpr Place in_gate(int i)
{
    return place(offsetof(aminn_stage_debug_t, gate_params), i, 3);
}
constexpr Place kPlaces[kEnd] = {
    in_spring(0, 0), // kDiag
    in_spring(1, 1), // 1
    in_spring(2, 2), // 2
    place(offsetof(aminn_stage_debug_t, tendon_gain), 0, 1),
    in_gate(0),      // kAlpha
    in_spring(1, 0), // kOff
    in_spring(2, 0), // 1
    in_spring(2, 1), // 2
    in_dir(0),       // kDir
    in_dir(1),       // 1
    in_dir(2),       // 2
    in_gate(1),      // kBeta
    in_gate(2),      // kRho
};

// The first fields of out.
static void store_springs(const Branches *springs, aminn_stage_debug_t &out)
{
    float *first = reinterpret_cast<float *>(&out);
    for (int output = 0; output < kEnd; ++output) {
        for (int b = 0; b < kBranch; ++b) {
            first[kPlaces[output].first + b * kPlaces[output].stride] = of_branch(springs, output, b);
        }
    }
    for (auto &k : out.k_spring) { // K in the place of L, from the end: an entry needs nothing of L behind it
        for (int i = 2; i >= 0; --i) {
            for (int j = i; j >= 0; --j) {
                float sum = 0.0F;
                for (int m = 0; m <= j; ++m) {
                    sum = add_product(sum, k[i][m], k[j][m]);
                }
                k[i][j] = k[j][i] = sum;
            }
        }
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
