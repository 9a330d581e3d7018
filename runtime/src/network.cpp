// The networks: their inputs, the backbone of a stage, stage 1's classifier.
#include "parts.hpp"

namespace aminn {
namespace {

using Array = Eigen::Map<Eigen::ArrayXf>;
using ConstArray = Eigen::Map<const Eigen::ArrayXf>;

constexpr int kBranchFeature = AMINN_N_BRANCH_FEATURE;

float signed_log(float v, float scale)
{
    return std::copysign(std::log(1.0F + std::fabs(v) / scale), v);
}

// out = (v - mean) * inv_std
void normalise(const float *v, const float *mean, const float *inv_std, int n, float *out)
{
    Array(out, n) = (ConstArray(v, n) - ConstArray(mean, n)) * ConstArray(inv_std, n);
}

// y = W x + b, W stored [input][output], so that y is a sum of contiguous columns:
//
//      y      b       w_0        w_1
//     | | =  | |  +  |   | x0 + |   | x1 + ...
//
// four columns a round, to load and store y less often. y must not overlap x.
void dense(const float *w, const float *b, const float *x, int n_in, int n_out, float *y)
{
    Array out(y, n_out);
    out = ConstArray(b, n_out);
    int i = 0;
    for (; i + 4 <= n_in; i += 4, w += 4 * n_out) {
        out += (ConstArray(w, n_out) * x[i] + ConstArray(w + n_out, n_out) * x[i + 1]) +
               (ConstArray(w + 2 * n_out, n_out) * x[i + 2] + ConstArray(w + 3 * n_out, n_out) * x[i + 3]);
    }
    for (; i < n_in; ++i, w += n_out) {
        out += ConstArray(w, n_out) * x[i];
    }
}

// max(y, 0); NaN stays NaN, so that an overflow is found in the end
void relu(float *y, int n)
{
    for (int i = 0; i < n; ++i) {
        y[i] = y[i] < 0.0F ? 0.0F : y[i];
    }
}

} // namespace

float sigmoid(float x)
{
    return 1.0F / (1.0F + std::exp(-x));
}

// contact_input: per branch [c, c * contact features, c * j_q]; global_input: [q, x_ht, w_e, slog(w_e)]
void make_network_input(const aminn_model_t &model, const aminn_input_t &in, aminn_t &ctx)
{
    for (int b = 0; b < kBranch; ++b) {
        float *u = ctx.contact_input + b * kBranchFeature;
        const float c = in.contacts[b][0];
        u[0] = c;
        for (int i = 1; i < AMINN_N_CONTACT_FEATURE; ++i) {
            u[i] = c * in.contacts[b][i];
        }
        for (int i = 0; i < 3 * AMINN_N_COORD; ++i) {
            u[AMINN_N_CONTACT_FEATURE + i] = c * in.j_q[b][i / AMINN_N_COORD][i % AMINN_N_COORD];
        }
    }
    float *g = ctx.global_input;
    for (int i = 0; i < AMINN_N_JOINT; ++i) {
        g[i] = in.q[i];
    }
    g += AMINN_N_JOINT;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        g[i] = in.x_ht[i];
        g[AMINN_N_WRENCH + i] = in.w_e[i];
        g[2 * AMINN_N_WRENCH + i] = signed_log(in.w_e[i], model.wrench_log_scale[i]);
    }
}

// ctx.feature = f, ctx.head = mechanics head of f
void run_backbone(const aminn_model_t &model, const aminn_stage_model_t &stage, aminn_t &ctx)
{
    const int hc = static_cast<int>(model.contact_width);
    const int h = static_cast<int>(model.width);
    normalise(ctx.contact_input, stage.contact_mean, stage.contact_inv_std, AMINN_N_CONTACT_INPUT, ctx.layer_in);
    dense(stage.contact_w, stage.contact_b, ctx.layer_in, AMINN_N_CONTACT_INPUT, hc, ctx.layer_out);
    relu(ctx.layer_out, hc);

    Array(ctx.layer_in, hc) = ConstArray(ctx.layer_out, hc);
    normalise(ctx.global_input, stage.global_mean, stage.global_inv_std, AMINN_N_GLOBAL_INPUT, ctx.layer_in + hc);
    dense(stage.trunk1_w, stage.trunk1_b, ctx.layer_in, hc + AMINN_N_GLOBAL_INPUT, h, ctx.layer_out);
    relu(ctx.layer_out, h);

    dense(stage.trunk2_w, stage.trunk2_b, ctx.layer_out, h, h, ctx.feature);
    relu(ctx.feature, h);
    dense(stage.head_w, stage.head_b, ctx.feature, h, AMINN_N_HEAD, ctx.head);
}

// p_stable from ctx.feature and what the statics of stage 1 gave
float classify(const aminn_model_t &model, const StaticsSummary &summary, const float *gate, aminn_t &ctx)
{
    const int h = static_cast<int>(model.width);
    const int hd = static_cast<int>(model.classifier_width);
    float aux[AMINN_N_AUX];
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        aux[i] = signed_log(summary.x_s(i), model.displacement_log_scale);
        aux[AMINN_N_WRENCH + i] = std::log(summary.diag_k_s(i));
    }
    for (int b = 0; b < kBranch; ++b) {
        aux[2 * AMINN_N_WRENCH + b] = gate[b];
    }
    Array(ctx.layer_in, h) = ConstArray(ctx.feature, h);
    normalise(aux, model.aux_mean, model.aux_inv_std, AMINN_N_AUX, ctx.layer_in + h);
    dense(model.cls1_w, model.cls1_b, ctx.layer_in, h + AMINN_N_AUX, hd, ctx.layer_out);
    relu(ctx.layer_out, hd);
    const float logit = (ConstArray(model.cls2_w, hd) * ConstArray(ctx.layer_out, hd)).sum() + model.cls2_b[0];
    return sigmoid(logit);
}

} // namespace aminn
