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

constexpr int kRow[3] = {1, 2, 2}; // of the entries below the diagonal
constexpr int kCol[3] = {0, 0, 1};

} // namespace

void springs_from_head(const aminn_model_t &model, float *head, Springs &out)
{
    const float range = model.log_range;
    for (int i = 0; i < kBounded * kBranch; ++i) {
        head[i] = hyperbolic_tangent(head[i]);
    }
    float factor[kFactors * kBranch];
    for (int i = 0; i < kFactors * kBranch; ++i) {
        factor[i] = exponential(range * head[i]);
    }
    const float *gate = model.gate_nom;
    for (int b = 0; b < kBranch; ++b) {
        const float *nominal = model.chol_nom + 6 * b;
        const float *mask = model.coord_mask + 3 * b;
        for (int i = 0; i < 3; ++i) {
            // cppcheck-suppress uninitvar ; the loop above fills all of it
            out.chol[i][b] = mask[i] != 0.0F ? nominal[i] * factor[(kDiag + i) * kBranch + b] : nominal[i];
        }
        for (int e = 0; e < 3; ++e) {
            const int i = kRow[e];
            const int j = kCol[e];
            const float size = root(nominal[i] * nominal[j]);
            out.chol[3 + e][b] = (nominal[3 + e] + size * head[(kOff + e) * kBranch + b]) * (mask[i] * mask[j]);
        }
        const float *dir_nom = model.tendon_dir_nom + 3 * b;
        float v[3];
        for (int i = 0; i < 3; ++i) {
            v[i] = (dir_nom[i] + head[(kDir + i) * kBranch + b]) * mask[i];
        }
        const float inv_norm = 1.0F / root(((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2]) + 1e-12F);
        for (int i = 0; i < 3; ++i) {
            out.tendon_dir[i][b] = v[i] * inv_norm;
        }
        out.tendon_gain[b] = model.tendon_gain_nom[b] * factor[kGain * kBranch + b];
        out.gate_params[0][b] = gate[0] * factor[kAlpha * kBranch + b];
        out.gate_params[1][b] = gate[1] * head[kBeta * kBranch + b];
        out.gate_params[2][b] = gate[2] + head[kRho * kBranch + b];
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
