// The largest load along a direction that a grasp is predicted to bear. Nothing says that a prediction is monotonic in the load,
// so it is looked for from zero upwards: steps that widen, then halvings between the last one that is admissible and the next.
#include "parts.hpp"

namespace aminn {
namespace {

constexpr int kSteps = 8; // (1/8)^2, (2/8)^2 .. 1: loads, and what grasps bear, span decades
constexpr int kHalvings = 4;
static_assert(1 + kSteps + kHalvings == AMINN_LOAD_PREDICTIONS, "as documented");

constexpr int kLoad = offsetof(aminn_state_t, w_e) / sizeof(float); // in a state's numbers
constexpr float kWithin = 0.999999F;                                // so that rounding leaves a load in its range

bool are_limits(const aminn_load_limits_t &l)
{
    return l.max_translation > 0.0F && l.max_rotation > 0.0F && l.margin >= 0.0F && l.margin <= FLT_MAX &&
           l.p_stable >= 0.0F && l.p_stable <= 1.0F && l.p_slide >= 0.0F && l.p_slide <= 1.0F && l.max_scale > 0.0F &&
           l.max_scale <= FLT_MAX;
}

// The largest scale, at most max_scale, with which the load lies in the range that the model was trained on; not below zero.
float known_scale(const aminn_model_t &model, const float *w, const float *direction, float max_scale)
{
    float scale = max_scale;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const float d = direction[i];
        if (d != 0.0F) {
            const float end = d > 0.0F ? model.range_max[kLoad + i] : model.range_min[kLoad + i];
            const float most = kWithin * ((end - w[i]) / d);
            scale = most < scale ? most : scale;
        }
    }
    return scale > 0.0F ? scale : 0.0F;
}

AMINN_FUNCTION float length(const float *v)
{
    return root(dot3(v, v));
}

// What forbids a load by its prediction, AMINN_LIMITED_NOT if nothing does. NaN forbids.
uint32_t limit_of(const aminn_output_t &out, const aminn_load_limits_t &limits, float length_scale)
{
    if (out.notes != 0) {
        return AMINN_LIMITED_BY_RANGE;
    }
    if (out.stable == 0 || !(out.p_stable >= limits.p_stable)) {
        return AMINN_LIMITED_BY_HOLD;
    }
    if (!(out.p_slide <= limits.p_slide)) {
        return AMINN_LIMITED_BY_SLIDE;
    }
    const float doubt = limits.margin * out.bound_95;
    if (!(add_product(length(out.dx_ht), doubt, length_scale) <= limits.max_translation)) {
        return AMINN_LIMITED_BY_TRANSLATION;
    }
    return length(out.dx_ht + 3) + doubt <= limits.max_rotation ? AMINN_LIMITED_NOT : AMINN_LIMITED_BY_ROTATION;
}

// Of one call.
struct Search {
    aminn_t &ctx;
    const aminn_state_t &state;
    const float *direction;
    const aminn_load_limits_t &limits;
    aminn_admissible_t &found;
    aminn_state_t loaded;
    aminn_output_t out;
};

// Predict for a scale, and keep what that says: the scale if it is admissible, else what forbids it.
aminn_status_t look(Search &s, float scale)
{
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        s.loaded.w_e[i] = add_product(s.state.w_e[i], scale, s.direction[i]);
    }
    const aminn_status_t status = aminn_predict_state(&s.ctx, &s.loaded, &s.out);
    if (status != AMINN_OK) {
        return status;
    }
    const uint32_t limit = limit_of(s.out, s.limits, s.ctx.model->length_scale);
    if (limit == AMINN_LIMITED_NOT || scale == 0.0F) {
        s.found.scale = scale;
        s.found.at = s.out;
    }
    s.found.admissible = limit == AMINN_LIMITED_NOT;
    s.found.limited_by = s.found.admissible != 0 ? s.found.limited_by : limit;
    return AMINN_OK;
}

// From zero to `end`.
aminn_status_t look_for_end(Search &s, float end)
{
    aminn_status_t status = look(s, 0.0F);
    if (status != AMINN_OK || s.found.admissible == 0) {
        return status;
    }
    float beyond = end;
    for (int k = 1; k <= kSteps && s.found.admissible != 0; ++k) {
        beyond = end * (static_cast<float>(k * k) / static_cast<float>(kSteps * kSteps));
        status = look(s, beyond);
        if (status != AMINN_OK) {
            return status;
        }
    }
    for (int k = 0; k < kHalvings && s.found.limited_by != AMINN_LIMITED_NOT; ++k) {
        const float middle = 0.5F * (s.found.scale + beyond);
        status = look(s, middle);
        if (status != AMINN_OK) {
            return status;
        }
        beyond = s.found.admissible != 0 ? beyond : middle;
    }
    s.found.admissible = 1;
    if (s.found.limited_by == AMINN_LIMITED_NOT && end < s.limits.max_scale) {
        s.found.limited_by = AMINN_LIMITED_BY_RANGE;
    }
    return AMINN_OK;
}

aminn_status_t check_arguments(aminn_t *ctx, const void *state, const float *direction,
                               const aminn_load_limits_t *limits)
{
    if (state == nullptr || direction == nullptr || limits == nullptr) {
        return AMINN_E_NULL;
    }
    const aminn_status_t status = context_status(ctx);
    if (status != AMINN_OK) {
        return status;
    }
    ctx->stages_done = 0;
    if (!all_finite(direction, AMINN_N_WRENCH)) {
        return AMINN_E_NONFINITE;
    }
    return are_limits(*limits) ? AMINN_OK : AMINN_E_LIMITS;
}
} // namespace
} // namespace aminn

aminn_status_t aminn_admissible_load(aminn_t *ctx, const aminn_state_t *state, const float direction[AMINN_N_WRENCH],
                                     const aminn_load_limits_t *limits, aminn_admissible_t *found)
{
    using namespace aminn;
    if (found == nullptr) {
        return AMINN_E_NULL;
    }
    *found = aminn_admissible_t{};
    aminn_status_t status = check_arguments(ctx, state, direction, limits);
    if (status == AMINN_OK) {
        Search search = {*ctx, *state, direction, *limits, *found, *state, {}};
        status = look_for_end(search, known_scale(*ctx->model, state->w_e, direction, limits->max_scale));
        ctx->stages_done = 0; // of whichever load was looked at last
    }
    if (status != AMINN_OK) {
        found->scale = 0.0F;
        found->admissible = 0;
        fail(status, &found->at);
    }
    return status;
}
