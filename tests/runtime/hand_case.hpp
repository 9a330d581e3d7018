/* A model and inputs of the hand that this is compiled for: random, of physical sizes, the same bits on every machine. */
#ifndef HAND_CASE_HPP
#define HAND_CASE_HPP

#include <cmath>
#include <cstdint>
#include <cstring>

#include "aminn_rt.h"

namespace hand_case {

constexpr int B = AMINN_N_BRANCH, C = AMINN_N_COORD, G = AMINN_N_GATED;
constexpr int kPacked = AMINN_N_CHOLESKY, kContactWidth = 9, kClassifier = 7;
constexpr int kWidths[] = {11, 16}, kWidth = kWidths[1]; // of stage 1 and 2, the wider one
/* networks of some hands see the factors of theta, of some sensors, of some both */
constexpr int kTold = C != 3 ? AMINN_N_FACTOR : 0, kSensed = AMINN_N_SLIDE > 0 ? AMINN_N_SENSED : 0;
constexpr int kGlobal = AMINN_N_GLOBAL_INPUT + kTold + kSensed;
constexpr int kTrunkInput = kContactWidth + kGlobal, kClassifierInput = kWidths[0] + AMINN_N_AUX;
constexpr int kSureInput = kWidth + AMINN_N_SURE;
static_assert(AMINN_N_STIFF == AMINN_N_JOINT, "a stiffness for each joint");
/* where a tendon's numbers stand in the head, in rows of B (aminn_rt.h has the order) */
constexpr bool kSoft = AMINN_N_TWIST > 0;
constexpr int kGainRow = C, kAlphaRow = C + 1, kTwistRow = G > 0 ? C + 2 : C, kOffRow = kTwistRow + (kSoft ? 1 : 0);
constexpr bool kSlides = AMINN_N_SLIDE > 0;
constexpr int kFrictionRow = kOffRow + C * (C - 1) / 2, kDirectionRow = kFrictionRow + (kSlides ? 1 : 0);
constexpr int kBetaRow = kDirectionRow + C, kRhoRow = kBetaRow + 1, kPreloadRow = G > 0 ? kRhoRow + 1 : kDirectionRow;

class Random {
  public:
    explicit Random(uint32_t seed) : state_(seed)
    {
    }
    float within(float low, float high)
    {
        state_ = state_ * 1664525u + 1013904223u;
        const float unit = static_cast<float>(state_ >> 8) * 0x1p-24F;
        return low + (high - low) * unit;
    }
    void fill(float *values, int n, float low, float high)
    {
        for (int i = 0; i < n; ++i) {
            values[i] = within(low, high);
        }
    }

  private:
    uint32_t state_;
};

struct StageTables {
    float eps_m[B];
    float contact_mean[AMINN_N_CONTACT_INPUT], contact_inv_std[AMINN_N_CONTACT_INPUT];
    float global_mean[kGlobal], global_inv_std[kGlobal];
    float contact_w[AMINN_N_CONTACT_INPUT * kContactWidth], contact_b[kContactWidth];
    float trunk1_w[kTrunkInput * kWidth], trunk1_b[kWidth], trunk2_w[kWidth * kWidth], trunk2_b[kWidth];
    float head_w[kWidth * AMINN_N_HEAD_STORED], head_b[AMINN_N_HEAD_STORED];
};

struct Tables {
    float wrench_log_scale[AMINN_N_WRENCH], chol_nom[B * kPacked], tendon_dir_nom[B * C], tendon_gain_nom[B],
        gate_nom[3], twist_nom[B], theta_terms[(1 + AMINN_N_STIFF) * B * AMINN_N_TERM];
    float coord_mask[B * C], aux_mean[AMINN_N_AUX], aux_inv_std[AMINN_N_AUX];
    float cls1_w[kClassifierInput * kClassifier], cls1_b[kClassifier], cls2_w[kClassifier], cls2_b[1];
    float sure_mean[AMINN_N_SURE], sure_inv_std[AMINN_N_SURE], sure_w[kSureInput * 2], sure_b[2];
    StageTables stage[AMINN_N_STAGE];
};

/* Coordinates that a branch lacks, next to the palm: the last branch lacks most. */
inline int lacking(int b)
{
    int left = B * C - AMINN_N_JOINT;
    for (int other = B - 1; other > b; --other) {
        left -= left < C - 1 ? left : C - 1;
    }
    return left < C - 1 ? left : C - 1;
}

inline bool has_tendon(int b)
{
    return b < G;
}

inline void make_stage(Random &random, StageTables &t, aminn_stage_model_t &stage, float eps_kx)
{
    random.fill(t.contact_mean, AMINN_N_CONTACT_INPUT, -0.1F, 0.1F);
    random.fill(t.contact_inv_std, AMINN_N_CONTACT_INPUT, 0.5F, 2.0F);
    random.fill(t.global_mean, kGlobal, -0.1F, 0.1F);
    random.fill(t.global_inv_std, kGlobal, 0.5F, 2.0F);
    random.fill(t.contact_w, AMINN_N_CONTACT_INPUT * kContactWidth, -0.2F, 0.2F);
    random.fill(t.contact_b, kContactWidth, -0.5F, 0.5F);
    random.fill(t.trunk1_w, kTrunkInput * kWidth, -0.3F, 0.3F);
    random.fill(t.trunk1_b, kWidth, -0.5F, 0.5F);
    random.fill(t.trunk2_w, kWidth * kWidth, -0.3F, 0.3F);
    random.fill(t.trunk2_b, kWidth, -0.5F, 0.5F);
    random.fill(t.head_w, kWidth * AMINN_N_HEAD_STORED, -0.15F, 0.15F);
    random.fill(t.head_b, AMINN_N_HEAD_STORED, -0.2F, 0.2F);
    for (int b = 0; b < B; ++b) {
        t.eps_m[b] = 1e-5F * static_cast<float>(b + 1);
    }
    stage.eps_kx = eps_kx;
    stage.eps_jq = 0.02F;
    stage.contact_mean = t.contact_mean;
    stage.contact_inv_std = t.contact_inv_std;
    stage.global_mean = t.global_mean;
    stage.global_inv_std = t.global_inv_std;
    stage.contact_w = t.contact_w;
    stage.contact_b = t.contact_b;
    stage.trunk1_w = t.trunk1_w;
    stage.trunk1_b = t.trunk1_b;
    stage.trunk2_w = t.trunk2_w;
    stage.trunk2_b = t.trunk2_b;
    stage.head_w = t.head_w;
    stage.head_b = t.head_b;
}

/* Entry of a packed triangle. */
inline int packed(int row, int column)
{
    return row == column ? row : C + row * (row - 1) / 2 + column;
}

/* Each joint's stiffness is a share of one column of the springs' Cholesky factor, so that they hold without it; the first of
 * a branch is its gated tendon's too. */
inline void make_terms(Tables &t)
{
    float *term = t.theta_terms + B * AMINN_N_TERM;
    for (int b = 0; b < B; ++b) {
        const float *l = t.chol_nom + kPacked * b;
        for (int k = lacking(b); k < C; ++k) {
            float *own = term + AMINN_N_TERM * b;
            for (int r = k; r < C; ++r) {
                for (int c = k; c <= r; ++c) {
                    own[packed(r, c)] = 0.7F * l[packed(r, k)] * l[packed(c, k)];
                }
            }
            own[kPacked] = k == lacking(b) ? 0.8F * t.tendon_gain_nom[b] : 0.0F;
            term += B * AMINN_N_TERM;
        }
    }
}

/* What a told model's networks see in these tests, no zeros. */
inline const float *told_factors()
{
    static float factors[AMINN_N_FACTOR];
    for (int i = 0; i < AMINN_N_FACTOR; ++i) {
        factors[i] = 0.3F * static_cast<float>(i % 5 - 2);
    }
    return factors;
}

inline void make_model(Tables &t, aminn_model_t &m)
{
    Random random(1);
    std::memset(&t, 0, sizeof t);
    m = aminn_model_t{};
    for (int b = 0; b < B; ++b) {
        float *chol = t.chol_nom + kPacked * b;
        for (int r = 0; r < C; ++r) {
            const bool here = r >= lacking(b);
            t.coord_mask[C * b + r] = here ? 1.0F : 0.0F;
            chol[r] = here ? random.within(0.3F, 0.6F) : 1.0F;
            for (int c = 0; c < r; ++c) {
                chol[C + r * (r - 1) / 2 + c] = c >= lacking(b) ? random.within(-0.15F, 0.15F) : 0.0F;
            }
            t.tendon_dir_nom[C * b + r] = here && has_tendon(b) ? random.within(0.3F, 1.0F) : 0.0F;
        }
        t.tendon_gain_nom[b] = has_tendon(b) ? random.within(0.2F, 0.6F) : 0.0F;
    }
    make_terms(t);
    random.fill(t.wrench_log_scale, AMINN_N_WRENCH, 0.05F, 0.2F);
    random.fill(t.aux_mean, AMINN_N_AUX, -0.1F, 0.1F);
    random.fill(t.aux_inv_std, AMINN_N_AUX, 0.1F, 0.2F);
    random.fill(t.cls1_w, kClassifierInput * kClassifier, -0.3F, 0.3F);
    random.fill(t.cls1_b, kClassifier, -0.5F, 0.5F);
    random.fill(t.cls2_w, kClassifier, -0.5F, 0.5F);
    random.fill(t.sure_mean, AMINN_N_SURE, -0.1F, 0.1F);
    random.fill(t.sure_inv_std, AMINN_N_SURE, 0.5F, 0.7F);
    random.fill(t.sure_w, kSureInput * 2, -0.3F, 0.3F);
    random.fill(t.sure_b, 2, -1.0F, 1.0F);
    t.gate_nom[0] = 40.0F;
    t.gate_nom[1] = 0.02F;
    t.gate_nom[2] = 0.3F;
    make_stage(random, t.stage[0], m.stage[0], 0.1F);
    make_stage(random, t.stage[1], m.stage[1], 0.05F);
    m.contact_width = kContactWidth;
    std::memcpy(m.width, kWidths, sizeof m.width);
    m.classifier_width = kClassifier;
    m.dq0 = AMINN_DQ0_STATICS;
    m.weight_type = AMINN_WEIGHTS_FLOAT32;
    m.length_scale = 0.1F;
    m.log_range = 0.7F;
    m.displacement_log_scale = 1e-3F;
    m.tau = 0.5F;
    m.friction_nominal = 0.75F;
    m.max_translation = 0.010F;
    m.max_rotation = 0.35F;
    for (int i = 0; i < 3; ++i) {
        m.bound_edge[i] = 0.25F * static_cast<float>(1 + i);
    }
    for (int i = 0; i < 4; ++i) {
        m.bound_factor[i] = 0.9F + 0.2F * static_cast<float>(i);
    }
    m.wrench_log_scale = t.wrench_log_scale;
    m.nominal.chol = t.chol_nom;
    m.tendon_dir_nom = t.tendon_dir_nom;
    m.nominal.tendon_gain = t.tendon_gain_nom;
    m.gate_nom = t.gate_nom;
    for (int b = 0; b < B; ++b) {
        t.twist_nom[b] = 0.05F * static_cast<float>(1 + b);
    }
    m.nominal.twist = t.twist_nom;
    m.nominal.eps_m[0] = t.stage[0].eps_m;
    m.nominal.eps_m[1] = t.stage[1].eps_m;
    m.n_told = kTold;
    m.n_sensed = kSensed;
    m.nominal.told = told_factors();
    m.theta_terms = t.theta_terms;
    m.coord_mask = t.coord_mask;
    m.aux_mean = t.aux_mean;
    m.aux_inv_std = t.aux_inv_std;
    m.cls1_w = t.cls1_w;
    m.cls1_b = t.cls1_b;
    m.cls2_w = t.cls2_w;
    m.cls2_b = t.cls2_b;
    m.sure_mean = t.sure_mean;
    m.sure_inv_std = t.sure_inv_std;
    m.sure_w = t.sure_w;
    m.sure_b = t.sure_b;
}

/* Every third input has a branch out of contact, where three and more are left, every fourth one that fades. */
inline void make_input(uint32_t seed, aminn_input_t &in)
{
    Random random(seed * 2654435761u + 7u);
    in = aminn_input_t{};
    random.fill(in.q, AMINN_N_JOINT, -1.0F, 1.0F);
    random.fill(in.x_ht, AMINN_N_WRENCH, -0.05F, 0.05F);
    random.fill(in.w_e, 3, -1.0F, 1.0F);
    random.fill(in.w_e + 3, 3, -0.03F, 0.03F);
    for (int b = 0; b < B; ++b) {
        const float flag = B > 2 && seed % 3 == 0 && b == static_cast<int>(seed / 3) % B ? 0.0F
                           : seed % 4 == 1 && b == static_cast<int>(seed / 4) % B        ? 0.5F
                                                                                         : 1.0F;
        float r[3];
        random.fill(r, 3, -0.05F, 0.05F);
        in.contacts[b][0] = flag;
        random.fill(in.contacts[b] + 1, 3, -0.1F, 0.1F);
        random.fill(in.contacts[b] + 4, 3, -1.0F, 1.0F);
        const float *normal = in.contacts[b] + 4;
        const float size = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
        for (int i = 4; i < 7; ++i) {
            in.contacts[b][i] /= size;
        }
        in.contacts[b][7] = random.within(0.2F, 2.0F); /* N: some contacts slide under the load */
        for (int i = 0; i < 3; ++i) {
            in.j_x[b][i][i] = 1.0F;
            in.j_x[b][i][3 + (i + 1) % 3] = r[(i + 2) % 3];
            in.j_x[b][i][3 + (i + 2) % 3] = -r[(i + 1) % 3];
            for (int c = 0; c < C; ++c) {
                const float velocity = random.within(-0.1F, 0.1F);
                in.j_q[b][i][c] = c >= lacking(b) ? velocity : 0.0F;
            }
        }
    }
}

} // namespace hand_case

#endif
