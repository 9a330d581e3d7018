// Fuzz target: any bytes as state, direction and limits of a search for the largest load. What it finds is what a prediction
// says of that load.
#include <cstring>

#include "aminn_model.h"
#include "bytes.hpp"
#include "checks.hpp"
#include "tiny_model.h"

using namespace fuzz;

namespace {

struct Whole {
    uint8_t choices[4];
    aminn_load_limits_t limits;
    float direction[AMINN_N_WRENCH];
    aminn_state_t state;
};

enum Choice : uint8_t { kReference = 1, kRepair = 2, kUnloaded = 4 };

Whole whole()
{
    Whole w = {};
    w.choices[0] = kReference | kRepair | kUnloaded;
    w.limits = {2e-3F, 0.1F, 0.0F, 0.7F, 1.0F, 10.0F};
    w.direction[0] = 1.0F;
    std::memcpy(&w.state, &golden_input(), sizeof w.state);
    return w;
}

aminn_t ctx;
aminn_admissible_t found;
aminn_output_t out;

float length(const float *v)
{
    return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

bool are_limits(const aminn_load_limits_t &l)
{
    const auto is_share = [](float v) { return v >= 0.0F && v <= 1.0F; };
    return l.max_translation > 0.0F && l.max_rotation > 0.0F && l.margin >= 0.0F && std::isfinite(l.margin) &&
           is_share(l.p_stable) && is_share(l.p_slide) && l.max_scale > 0.0F && std::isfinite(l.max_scale);
}

bool is_admissible(const aminn_output_t &o, const aminn_load_limits_t &l, float length_scale)
{
    constexpr float kRounding = 1.0001F;
    return o.notes == 0 && o.stable == 1 && o.p_stable >= l.p_stable && o.p_slide <= l.p_slide &&
           length(o.dx_ht) + l.margin * o.bound_95 * length_scale <= kRounding * l.max_translation &&
           length(o.dx_ht + 3) + l.margin * o.bound_95 <= kRounding * l.max_rotation;
}

void check_found(const aminn_model_t &model, const Whole &w)
{
    FUZZ_CHECK(found.scale >= 0.0F && found.scale <= w.limits.max_scale);
    FUZZ_CHECK(found.admissible == 0 || found.admissible == 1);
    FUZZ_CHECK(found.admissible == 1 || found.scale == 0.0F);
    FUZZ_CHECK(found.limited_by <= AMINN_LIMITED_BY_RANGE);
    FUZZ_CHECK(found.limited_by != AMINN_LIMITED_NOT || found.admissible == 1);
    aminn_state_t loaded = w.state;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const float added = found.scale * w.direction[i]; // rounded, then added
        loaded.w_e[i] = loaded.w_e[i] + added;
    }
    scribble(&out, sizeof out);
    FUZZ_CHECK(aminn_predict_state(&ctx, &loaded, &out) == AMINN_OK);
    FUZZ_CHECK(std::memcmp(&out, &found.at, sizeof out) == 0);
    FUZZ_CHECK(found.admissible == 0 || is_admissible(out, w.limits, model.length_scale));
}

int try_one(Whole &w)
{
    const uint8_t chosen = w.choices[0];
    if ((chosen & kRepair) != 0) {
        repair(w.state);
    }
    if ((chosen & kUnloaded) != 0) {
        std::memset(w.state.w_e, 0, sizeof w.state.w_e);
    }
    const aminn_model_t &model = (chosen & kReference) != 0 ? aminn_model : tiny_model;
    FUZZ_CHECK(aminn_init(&ctx, &model, AMINN_FLAG_DEBUG) == AMINN_OK);
    scribble(&found, sizeof found);
    aminn_predict_state(&ctx, &w.state, &out); // leaves something to be seen, where it is predicted
    const aminn_status_t status = aminn_admissible_load(&ctx, &w.state, w.direction, &w.limits, &found);
    FUZZ_CHECK(aminn_debug(&ctx, 0) == nullptr && aminn_debug(&ctx, 1) == nullptr);
    const bool finite =
        std::all_of(w.direction, w.direction + AMINN_N_WRENCH, [](float v) { return std::isfinite(v); });
    FUZZ_CHECK(finite ? (status == AMINN_E_LIMITS) == !are_limits(w.limits) : status == AMINN_E_NONFINITE);
    if (status == AMINN_OK) {
        check_found(model, w);
    } else {
        FUZZ_CHECK(found.scale == 0.0F && found.admissible == 0 && found.at.stable == 0 && found.at.p_stable == 0.0F &&
                   std::isnan(found.at.dx_ht[0]));
    }
    return 0;
}

} // namespace

#include "numbers_target.hpp" // last
