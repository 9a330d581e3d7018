// The public entry points of a prediction: context, checks, which core runs.
#include "parts.hpp"

namespace aminn {
namespace {

constexpr uint32_t kTag = 0x414D4E43u; // "AMNC"
constexpr uint32_t kKnownFlags = AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG;

static_assert(sizeof(aminn_input_t) == AMINN_N_INPUT * sizeof(float), "aminn_input_t is floats without gaps");
static_assert(offsetof(aminn_calibration_t, varied) == 0, "a calibration begins with the tables in use");
static_assert(offsetof(aminn_input_t, j_x) == sizeof(aminn_state_t), "aminn_input_t begins as aminn_state_t does");

// "does not hold", and no number
void clear(aminn_output_t &out)
{
    // cppcheck-suppress memsetClassFloat ; a float is binary32, whose NaN this is
    __builtin_memset(&out, 0xFF, offsetof(aminn_output_t, stable)); // the numbers stand first
    out.p_stable = 0.0F;
    out.stable = 0;
    out.notes = 0;
}

aminn_status_t predict_checked(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out)
{
    const aminn_status_t status = take_sensors(ctx, in);
    if (status != AMINN_OK) {
        return fail(status, &out);
    }
    clear(out);
    if (!AMINN_ON_BEST_CORE(run_cascade(ctx, in, out))) {
        ctx.stages_done = 0;
        return fail(AMINN_E_NUMERIC, &out);
    }
    out.notes = in_training_range(*ctx.model, in.q) ? 0u : AMINN_NOTE_OUT_OF_RANGE;
    if (out.condition > AMINN_ILL_CONDITIONED) {
        out.notes |= AMINN_NOTE_ILL_CONDITIONED;
    }
    return AMINN_OK;
}

// Of both predict functions: the context, the pointers, and the n numbers of the input, which begins as aminn_state_t
// does. Leaves the context without valid stages.
AMINN_FUNCTION aminn_status_t check(aminn_t *ctx, const void *in, size_t size, const aminn_output_t *out)
{
    const aminn_status_t status = in != nullptr && out != nullptr ? context_status(ctx) : AMINN_E_NULL;
    if (status != AMINN_OK) {
        return status;
    }
    ctx->stages_done = 0;
    return check_input(static_cast<const float *>(in), static_cast<int>(size / sizeof(float)));
}

} // namespace

aminn_status_t fail(aminn_status_t status, aminn_output_t *out)
{
    if (out != nullptr) {
        clear(*out);
        out->notes = status == AMINN_E_NO_CONTACT ? AMINN_NOTE_NO_CONTACT : 0u;
    }
    return status;
}

aminn_status_t context_status(const aminn_t *ctx)
{
    if (ctx == nullptr) {
        return AMINN_E_NULL;
    }
    return ctx->tag == kTag ? AMINN_OK : AMINN_E_NOT_INITIALISED;
}

void forget_sensors(aminn_t &ctx)
{
    for (float &number : ctx.sensed) {
        number = 0.0F;
    }
#if AMINN_N_SLIDE
    ctx.friction = ctx.model->friction_nominal;
    for (auto &force : ctx.preload) {
        force[0] = force[1] = force[2] = 0.0F;
    }
#endif
}
} // namespace aminn

using namespace aminn;

// beside a function that every program needs: two libraries in one program then define it twice, and do not link
const char AMINN_LIBRARY[] = "";

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
        ctx->varied = &model->nominal;
        ctx->flags = flags;
        ctx->tag = kTag;
        forget_sensors(*ctx);
    }
    return status;
}

aminn_status_t aminn_predict(aminn_t *ctx, const aminn_input_t *in, aminn_output_t *out)
{
    const aminn_status_t status = check(ctx, in, sizeof *in, out);
    return status == AMINN_OK ? predict_checked(*ctx, *in, *out) : fail(status, out);
}

aminn_status_t aminn_predict_state(aminn_t *ctx, const aminn_state_t *state, aminn_output_t *out)
{
    aminn_status_t status = check(ctx, state, sizeof *state, out);
    if (status == AMINN_OK) {
        aminn_input_t &in = ctx->input;
        __builtin_memcpy(&in, state, sizeof *state);
        if (ctx->correct != nullptr) { // a calibration begins with the tables in use, an input as a state does
            ctx->correct(reinterpret_cast<const aminn_calibration_t *>(ctx->varied),
                         reinterpret_cast<aminn_state_t *>(&in));
        }
        if (closure(*ctx->model, in.q, in.x_ht, in.contacts, in.j_x, in.j_q)) {
            return predict_checked(*ctx, in, *out);
        }
        status = AMINN_E_NUMERIC;
    }
    return fail(status, out);
}

const aminn_stage_debug_t *aminn_debug(const aminn_t *ctx, int stage)
{
    if (context_status(ctx) != AMINN_OK || stage < 0 || stage >= AMINN_N_STAGE) {
        return nullptr;
    }
    return (ctx->stages_done & (1u << stage)) != 0 ? &ctx->stage[stage] : nullptr;
}
