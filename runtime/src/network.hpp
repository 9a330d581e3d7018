// The networks: their inputs, the backbone of a stage, stage 1's classifier.
#ifndef AMINN_SRC_NETWORK_HPP
#define AMINN_SRC_NETWORK_HPP

#include "dense.hpp"
#include "mechanics.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr int kBranchFeature = AMINN_N_BRANCH_FEATURE;
static_assert(AMINN_N_TOLD_INPUT <= AMINN_N_LAST_INPUT && AMINN_N_CONTACT_INPUT <= AMINN_N_LAST_INPUT,
              "behind the contact summary there is room for the global input");

// contact_input: per branch [c, c * contact features, c * j_q]; slog_w: w_e in signed logarithm
AMINN_INLINE void make_network_input(const aminn_model_t &model, const aminn_input_t &in, aminn_t &ctx)
{
    for (int b = 0; b < kBranch; ++b) {
        float *u = ctx.contact_input + b * kBranchFeature;
        const auto *j_q = reinterpret_cast<const float *>(in.j_q[b]);
        const float c = in.contacts[b][0];
        u[0] = c;
        for (int i = 1; i < AMINN_N_CONTACT_FEATURE; ++i) {
            u[i] = c * in.contacts[b][i];
        }
        for (int i = 0; i < 3 * AMINN_N_COORD; ++i) {
            u[AMINN_N_CONTACT_FEATURE + i] = c * j_q[i];
        }
    }
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        ctx.slog_w[i] = 1.0F + __builtin_fabsf(in.w_e[i]) / model.wrench_log_scale[i];
    }
    logarithms(ctx.slog_w, AMINN_N_WRENCH);
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        ctx.slog_w[i] = __builtin_copysignf(ctx.slog_w[i], in.w_e[i]);
    }
}

// ctx.feature = f, ctx.head = mechanics head of f
static void run_backbone(const aminn_model_t &model, int i, const aminn_input_t &in, aminn_t &ctx)
{
    const aminn_stage_model_t &stage = model.stage[i];
    const int hc = static_cast<int>(model.contact_width);
    const int h = static_cast<int>(model.width[i]);
    float *contact = ctx.layer_in + AMINN_MAX_WIDTH; // behind what the layer writes
    normalise(ctx.contact_input, stage.contact_mean, stage.contact_inv_std, AMINN_N_CONTACT_INPUT, contact);
    dense(model, stage.contact_w, stage.contact_b, contact, AMINN_N_CONTACT_INPUT, hc, kRectified, ctx.layer_in);
    const float *mean = stage.global_mean;
    const float *inv_std = stage.global_inv_std;
    float *global = ctx.layer_in + hc;
    normalise(reinterpret_cast<const float *>(&in), mean, inv_std, kContacts, global); // q, x_ht, w_e: it begins so
    mean += kContacts;
    inv_std += kContacts;
    global += kContacts;
    normalise(ctx.slog_w, mean, inv_std, AMINN_N_WRENCH, global);
    mean += AMINN_N_WRENCH;
    inv_std += AMINN_N_WRENCH;
    global += AMINN_N_WRENCH;
    const int told = static_cast<int>(model.n_told);
    const int sensed = static_cast<int>(model.n_sensed);
    normalise(ctx.varied->told, mean, inv_std, told, global);
    normalise(ctx.sensed, mean + told, inv_std + told, sensed, global + told);
    dense(model, stage.trunk1_w, stage.trunk1_b, ctx.layer_in, hc + AMINN_N_GLOBAL_INPUT + told + sensed, h, kRectified,
          ctx.layer_out);
    dense(model, stage.trunk2_w, stage.trunk2_b, ctx.layer_out, h, h, kRectified, ctx.feature);
    dense(model, stage.head_w, stage.head_b, ctx.feature, h, AMINN_N_HEAD_STORED, kLinear, ctx.head);
}

#if AMINN_N_SLIDE
// of each contact's friction, as networks see it
AMINN_FUNCTION void see_friction(const Friction &friction, float seen[AMINN_N_SLID])
{
    const auto *number = reinterpret_cast<const float *>(&friction);
    for (int i = 0; i < AMINN_N_SLID; ++i) {
        seen[i] = 1.0F + number[i];
    }
    logarithms(seen, AMINN_N_SLID);
}
#endif

constexpr float kMaxLogBound = 80.0F;  // more than any bound: its exponential stays a number
constexpr float kLeastMotion = 1e-12F; // m, so that no motion at all can be divided by

// p_stable from ctx.feature, which what the statics of stage 1 gave is appended to: the motion with its size in logarithm,
// log diag(K), gates, friction. All but the motion fade where that exceeds the length scale: statics are linear, and of a
// tool that turns many times round they say nothing, and rounding leaves little of that.
static float classify(const aminn_model_t &model, const StaticsSummary &summary, const float *gate, aminn_t &ctx)
{
    const int h = static_cast<int>(model.width[0]);
    const int hd = static_cast<int>(model.classifier_width);
    Row x;
    load_row(x, summary.x_s);
    const float size = root(dot(x, x)) + kLeastMotion;
    const float inv_size = 1.0F / size;
    const float log_by_size = logarithm(1.0F + size / model.displacement_log_scale) * inv_size;
    float aux[AMINN_N_AUX];
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        aux[i] = summary.x_s[i] * log_by_size;
        aux[AMINN_N_WRENCH + i] = summary.diag_k_s[i];
    }
    logarithms(aux + AMINN_N_WRENCH, AMINN_N_WRENCH);
    if constexpr (kGated) {
        __builtin_memcpy(aux + 2 * AMINN_N_WRENCH, gate, kBranch * sizeof *gate);
    }
#if AMINN_N_SLIDE
    see_friction(summary.friction, aux + AMINN_N_AUX - AMINN_N_SLID);
#endif
    float *in = ctx.feature + h;
    normalise(aux, model.aux_mean, model.aux_inv_std, AMINN_N_AUX, in);
    const float fade = model.length_scale * inv_size;
    if (fade < 1.0F) {
        for (int i = AMINN_N_WRENCH; i < AMINN_N_AUX; ++i) {
            in[i] = in[i] * fade;
        }
    }
    dense(model, model.cls1_w, model.cls1_b, ctx.feature, h + AMINN_N_AUX, hd, kRectified, ctx.layer_out);
    float logit = 0.0F;
    dense(model, model.cls2_w, model.cls2_b, ctx.layer_out, hd, 1, kLinear, &logit);
    return sigmoid(logit);
}

// p_slide and bound_95 from stage 2's ctx.feature, which what its statics gave is appended to: the size of the motion in
// logarithm. The bound is a multiple, of each bin of p_slide its own. False if they are no numbers.
static bool doubt(const aminn_model_t &model, const StaticsSummary &summary, aminn_t &ctx, aminn_output_t &out)
{
    const int h = static_cast<int>(model.width[1]);
    Row x;
    load_row(x, summary.x_s);
    float aux[AMINN_N_SURE] = {logarithm(1.0F + root(dot(x, x)) / model.displacement_log_scale)};
#if AMINN_N_SLIDE
    see_friction(summary.friction, aux + 1);
#endif
    normalise(aux, model.sure_mean, model.sure_inv_std, AMINN_N_SURE, ctx.feature + h);
    float found[2];
    dense(model, model.sure_w, model.sure_b, ctx.feature, h + AMINN_N_SURE, 2, kLinear, found);
    out.p_slide = sigmoid(found[0]);
    const float *factor = model.bound_factor;
    for (const float edge : model.bound_edge) {
        factor += out.p_slide >= edge ? 1 : 0;
    }
    out.bound_95 = exponential(found[1] > kMaxLogBound ? kMaxLogBound : found[1]) * *factor;
    return within(out.bound_95, 0, kLargestBits) & (out.p_slide >= 0.0F);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
