// The public entry points of a prediction: context, checks, the cascade.
#include <cstring>

#include "parts.hpp"

namespace aminn {
namespace {

constexpr uint32_t kTag = 0x414D4E43u; // "AMNC"
constexpr uint32_t kKnownFlags = AMINN_FLAG_ALWAYS_STAGE2;

static_assert(sizeof(aminn_input_t) == 125 * sizeof(float), "aminn_input_t is 125 floats without gaps");
static_assert(offsetof(aminn_input_t, j_x) == sizeof(aminn_state_t), "aminn_input_t begins as aminn_state_t does");

void set_nan(aminn_output_t &out)
{
    Vec6Map(out.dx_ht).setConstant(NAN);
    Mat6Map(&out.k_x[0][0]).setConstant(NAN);
    Vec3Map(out.gate).setConstant(NAN);
}

// what the outputs hold after an error: "does not hold", and no number
aminn_status_t fail(aminn_status_t status, aminn_output_t *out)
{
    if (out != nullptr) {
        set_nan(*out);
        out->p_stable = 0.0F;
        out->stable = 0;
    }
    return status;
}

StaticsSummary run_stage(aminn_t &ctx, int i, const Scene &scene, const aminn_input_t &in)
{
    const aminn_model_t &model = *ctx.model;
    run_backbone(model, model.stage[i], ctx);
    const Springs springs = springs_from_head(model, ctx.head);
    store_springs(springs, ctx.stage[i]);
    const StaticsSummary summary = two_pass(model, model.stage[i], springs, scene, in, ctx.stage[i]);
    ctx.stages_done |= 1u << i;
    return summary;
}

void store_response(const aminn_stage_debug_t &stage, aminn_output_t &out)
{
    std::memcpy(out.dx_ht, stage.dx, sizeof out.dx_ht);
    std::memcpy(out.k_x, stage.k_x, sizeof out.k_x);
    std::memcpy(out.gate, stage.gate, sizeof out.gate);
}

// Nothing overflowed, and the load gives its energy to the grasp (w.dx >= 0). The statics ensure the latter unless the
// stiffnesses lie further apart than float32 can tell, with a tool 1e8 m away for instance: then dx is noise.
bool sound(const aminn_input_t &in, const aminn_stage_debug_t &stage)
{
    return all_finite(stage.dx, AMINN_N_WRENCH) && all_finite(&stage.k_x[0][0], AMINN_N_WRENCH * AMINN_N_WRENCH) &&
           all_finite(stage.gate, AMINN_N_BRANCH) && ConstVec6Map(in.w_e).dot(ConstVec6Map(stage.dx)) >= 0.0F;
}

// the cascade on a checked input; false if a stage's results are not sound
bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out)
{
    const aminn_model_t &model = *ctx.model;
    make_network_input(model, in, ctx);
    const Scene scene = make_scene(model, in);
    const StaticsSummary summary = run_stage(ctx, 0, scene, in);
    out.p_stable = classify(model, summary, ctx.stage[0].gate, ctx);
    if (!std::isfinite(out.p_stable) || !sound(in, ctx.stage[0])) {
        return false;
    }
    out.stable = out.p_stable >= model.tau ? 1 : 0;
    if (out.stable == 0 && (ctx.flags & AMINN_FLAG_ALWAYS_STAGE2) == 0) {
        set_nan(out);
        return true;
    }
    run_stage(ctx, 1, scene, in);
    store_response(ctx.stage[1], out);
    return sound(in, ctx.stage[1]);
}

aminn_status_t predict_checked(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out)
{
    if (run_cascade(ctx, in, out)) {
        return AMINN_OK;
    }
    ctx.stages_done = 0;
    return fail(AMINN_E_NUMERIC, &out);
}

bool initialised(const aminn_t &ctx)
{
    return ctx.tag == kTag && ctx.model != nullptr;
}

// common to both predict functions; leaves the context without valid stages
aminn_status_t begin(aminn_t *ctx, const void *in, const aminn_output_t *out)
{
    if (ctx == nullptr) {
        return AMINN_E_NULL;
    }
    if (!initialised(*ctx)) {
        return in == nullptr || out == nullptr ? AMINN_E_NULL : AMINN_E_NOT_INITIALISED;
    }
    ctx->stages_done = 0;
    return in == nullptr || out == nullptr ? AMINN_E_NULL : AMINN_OK;
}

aminn_status_t check_numbers(const float *in, size_t bytes)
{
    return all_finite(in, static_cast<int>(bytes / sizeof(float))) ? AMINN_OK : AMINN_E_NONFINITE;
}

} // namespace
} // namespace aminn

using namespace aminn;

aminn_status_t aminn_init_sized(aminn_t *ctx, size_t ctx_size, const aminn_model_t *model, uint32_t flags)
{
    if (ctx == nullptr) {
        return AMINN_E_NULL;
    }
    if (ctx_size != sizeof(aminn_t)) { // not ours to write to: it may be smaller than we think
        return AMINN_E_CONTEXT_SIZE;
    }
    *ctx = aminn_t{};
    if ((flags & ~kKnownFlags) != 0) {
        return AMINN_E_FLAGS;
    }
    const aminn_status_t status = aminn_model_check(model);
    if (status == AMINN_OK) {
        ctx->model = model;
        ctx->flags = flags;
        ctx->tag = kTag;
    }
    return status;
}

aminn_status_t aminn_predict(aminn_t *ctx, const aminn_input_t *in, aminn_output_t *out)
{
    aminn_status_t status = begin(ctx, in, out);
    if (status == AMINN_OK) {
        status = check_numbers(in->q, sizeof *in);
    }
    if (status == AMINN_OK) {
        status = check_state(in->x_ht, in->contacts);
    }
    return status == AMINN_OK ? predict_checked(*ctx, *in, *out) : fail(status, out);
}

aminn_status_t aminn_predict_state(aminn_t *ctx, const aminn_state_t *state, aminn_output_t *out)
{
    aminn_status_t status = begin(ctx, state, out);
    if (status == AMINN_OK) {
        status = check_numbers(state->q, sizeof *state);
    }
    if (status == AMINN_OK) {
        status = check_state(state->x_ht, state->contacts);
    }
    if (status != AMINN_OK) {
        return fail(status, out);
    }
    aminn_input_t &in = ctx->input;
    std::memcpy(&in, state, sizeof *state);
    closure(*ctx->model, in.q, in.x_ht, in.contacts, in.j_x, in.j_q);
    return predict_checked(*ctx, in, *out);
}

const aminn_stage_debug_t *aminn_debug(const aminn_t *ctx, int stage)
{
    if (ctx == nullptr || !initialised(*ctx) || stage < 0 || stage >= AMINN_N_STAGE) {
        return nullptr;
    }
    return (ctx->stages_done & (1u << stage)) != 0 ? &ctx->stage[stage] : nullptr;
}
