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

// With vector registers a whole number of them is computed at once; what is beyond the factors is not used.
constexpr int kComputed = AMINN_LANES ? (kFactors * kBranch + 7) / 8 * 8 : kFactors * kBranch;
static_assert(kComputed <= kBounded * kBranch, "they are all bounded");

// The first fields of out, but in the place of the springs K = L L^T the entries of L up to its diagonal. head is
// overwritten.
static void springs_from_head(const aminn_model_t &model, float *head, aminn_stage_debug_t &out)
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
        float *l = out.k_spring[b][0];
        Branches v[3];
        for (int i = 0; i < 3; ++i) {
            scatter(mask[i] != 0.0F ? nominal[i] * scaling(kDiag + i) : nominal[i], l + 4 * i, 9);
            const int row = i == 0 ? 1 : 2; // of the i-th entry below the diagonal
            const int column = i / 2;
            const Branches size = root(nominal[row] * nominal[column]);
            scatter((nominal[3 + i] + size * raw(kOff + i)) * (mask[row] * mask[column]), l + 3 * row + column, 9);
            v[i] = (gather(model.tendon_dir_nom + 3 * b + i, 3) + raw(kDir + i)) * mask[i];
        }
        const Branches inv_norm = 1.0F / root(dot(v, v) + 1e-12F);
        for (int i = 0; i < 3; ++i) {
            scatter(v[i] * inv_norm, &out.tendon_dir[b][i], 3);
        }
        const float *gate = model.gate_nom;
        scatter(gather(model.tendon_gain_nom + b, 1) * scaling(kGain), out.tendon_gain + b, 1);
        scatter(gate[0] * scaling(kAlpha), &out.gate_params[b][0], 3);
        scatter(gate[1] * raw(kBeta), &out.gate_params[b][1], 3);
        scatter(gate[2] + raw(kRho), &out.gate_params[b][2], 3);
    }
}

// K in the place of L, from the end: an entry needs nothing of L behind it.
static void square_springs(aminn_stage_debug_t &out)
{
    for (auto &k : out.k_spring) {
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
