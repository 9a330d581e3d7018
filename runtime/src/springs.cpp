// The mechanics head: 13 raw numbers a branch become corrections to the nominal springs, tendon and gate.
#include <cstring>

#include "parts.hpp"

namespace aminn {
namespace {

// raw outputs of one branch, in this order
struct RawBranch {
    float diag[3]; // log corrections of the Cholesky factor's diagonal
    float off[3];  // entries 10, 20, 21
    float dir[3];
    float gain;
    float alpha;
    float beta;
    float rho;
};
static_assert(sizeof(RawBranch) * kBranch == AMINN_N_HEAD * sizeof(float), "head layout");

// exp(range * tanh(x)): between exp(-range) and exp(range), 1 at 0
float bounded_factor(float x, float range)
{
    return std::exp(range * std::tanh(x));
}

Mat3 cholesky_factor(const RawBranch &raw, const float *nominal, const float *mask, float range)
{
    constexpr int kRow[3] = {1, 2, 2};
    constexpr int kCol[3] = {0, 0, 1};
    Mat3 l = Mat3::Zero();
    for (int i = 0; i < 3; ++i) {
        l(i, i) = nominal[i] * std::exp(range * std::tanh(raw.diag[i]) * mask[i]);
    }
    for (int e = 0; e < 3; ++e) {
        const int i = kRow[e];
        const int j = kCol[e];
        const float size = std::sqrt(nominal[i] * nominal[j]);
        l(i, j) = (nominal[3 + e] + size * std::tanh(raw.off[e])) * mask[i] * mask[j];
    }
    return l;
}

} // namespace

Springs springs_from_head(const aminn_model_t &model, const float *head)
{
    Springs out;
    const float range = model.log_range;
    const float *gate = model.gate_nom;
    for (int b = 0; b < kBranch; ++b) {
        RawBranch raw;
        std::memcpy(&raw, head + b * (AMINN_N_HEAD / kBranch), sizeof raw);
        const float *mask = model.coord_mask + 3 * b;
        out.chol[b] = cholesky_factor(raw, model.chol_nom + 6 * b, mask, range);
        const Vec3 v =
            (ConstVec3Map(model.tendon_dir_nom + 3 * b) + ConstVec3Map(raw.dir)).cwiseProduct(ConstVec3Map(mask));
        out.tendon_dir[b] = v / std::sqrt(v.squaredNorm() + 1e-12F);
        out.tendon_gain[b] = model.tendon_gain_nom[b] * bounded_factor(raw.gain, range);
        out.gate_params[b] << gate[0] * bounded_factor(raw.alpha, range), gate[1] * raw.beta, gate[2] + raw.rho;
    }
    return out;
}

void store_springs(const Springs &springs, aminn_stage_debug_t &out)
{
    for (int b = 0; b < kBranch; ++b) {
        Mat3Map(&out.k_spring[b][0][0]) = springs.chol[b].lazyProduct(springs.chol[b].transpose());
        Vec3Map(out.tendon_dir[b]) = springs.tendon_dir[b];
        out.tendon_gain[b] = springs.tendon_gain[b];
        Vec3Map(out.gate_params[b]) = springs.gate_params[b];
    }
}

} // namespace aminn
