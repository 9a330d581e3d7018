// The mechanics head: 39 raw numbers become corrections to the nominal springs, tendons and gates.
#include "parts.hpp"

namespace aminn {
inline namespace AMINN_CORE {
namespace {

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

constexpr int kRow[3] = {1, 2, 2}; // of the entries below the diagonal
constexpr int kCol[3] = {0, 0, 1};

} // namespace

void springs_from_head(const aminn_model_t &model, float *head, Springs &out)
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
        for (int i = 0; i < 3; ++i) {
            scatter(mask[i] != 0.0F ? nominal[i] * scaling(kDiag + i) : nominal[i], out.chol[i] + b, 1);
        }
        for (int e = 0; e < 3; ++e) {
            const int i = kRow[e];
            const int j = kCol[e];
            const Branches size = root(nominal[i] * nominal[j]);
            scatter((nominal[3 + e] + size * raw(kOff + e)) * (mask[i] * mask[j]), out.chol[3 + e] + b, 1);
        }
        Branches v[3];
        for (int i = 0; i < 3; ++i) {
            v[i] = (gather(model.tendon_dir_nom + 3 * b + i, 3) + raw(kDir + i)) * mask[i];
        }
        const Branches inv_norm = broadcast(1.0F) / root(dot(v, v) + broadcast(1e-12F));
        for (int i = 0; i < 3; ++i) {
            scatter(v[i] * inv_norm, out.tendon_dir[i] + b, 1);
        }
        scatter(gather(model.tendon_gain_nom + b, 1) * scaling(kGain), out.tendon_gain + b, 1);
        const float *gate = model.gate_nom;
        scatter(gate[0] * scaling(kAlpha), out.gate_params[0] + b, 1);
        scatter(gate[1] * raw(kBeta), out.gate_params[1] + b, 1);
        scatter(gate[2] + raw(kRho), out.gate_params[2] + b, 1);
    }
}

void store_springs(const Springs &springs, aminn_stage_debug_t &out)
{
    for (int b = 0; b < kBranch; ++b) {
        const float l[3][3] = {{springs.chol[0][b], 0.0F, 0.0F},
                               {springs.chol[3][b], springs.chol[1][b], 0.0F},
                               {springs.chol[4][b], springs.chol[5][b], springs.chol[2][b]}};
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                out.k_spring[b][i][j] = (l[i][0] * l[j][0] + l[i][1] * l[j][1]) + l[i][2] * l[j][2];
            }
            out.tendon_dir[b][i] = springs.tendon_dir[i][b];
            out.gate_params[b][i] = springs.gate_params[i][b];
        }
        out.tendon_gain[b] = springs.tendon_gain[b];
    }
}

} // namespace AMINN_CORE
} // namespace aminn
