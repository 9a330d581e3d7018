// How aminn_admissible_load() looks for the end of the admissible loads: on predictions that are made up, as functions of the load.
#include "parts.hpp"

#include <cfloat>
#include <cmath>
#include <cstring>

#include "unity.h"

namespace {

constexpr float kNan = NAN;

// What is predicted with a load of `load` along the first axis.
struct Made {
    float p_stable = 1.0F, dx[AMINN_N_WRENCH] = {}, bound = 0.0F, p_slide = 0.0F;
    uint32_t notes = 0;
    aminn_status_t status = AMINN_OK;
};
Made (*law)(float load);
int predictions;

aminn_t ctx;
aminn_model_t model;
float low[AMINN_N_STATE], high[AMINN_N_STATE];
aminn_state_t state;
aminn_load_limits_t limits;
aminn_admissible_t found;

aminn_status_t find(float length = 1.0F)
{
    const float direction[AMINN_N_WRENCH] = {length};
    predictions = 0;
    return aminn_admissible_load(&ctx, &state, direction, &limits, &found);
}

template <int percent>
Made holds_up_to(float load)
{
    Made made;
    made.p_stable = load * 100.0F <= static_cast<float>(percent) ? 1.0F : 0.0F;
    return made;
}

Made holds(float)
{
    return Made();
}

} // namespace

// What the search needs of the library.
namespace aminn {
aminn_status_t context_status(const aminn_t *)
{
    return AMINN_OK;
}
aminn_status_t fail(aminn_status_t status, aminn_output_t *out)
{
    out->p_stable = kNan;
    return status;
}
bool all_finite(const float *, int)
{
    return true;
}
} // namespace aminn

aminn_status_t aminn_predict_state(aminn_t *, const aminn_state_t *loaded, aminn_output_t *out)
{
    const Made made = law(loaded->w_e[0]);
    ++predictions;
    *out = aminn_output_t{};
    out->p_stable = made.p_stable;
    out->stable = made.p_stable >= 0.5F;
    out->notes = made.notes;
    out->p_slide = made.p_slide;
    out->bound_95 = made.bound;
    std::memcpy(out->dx_ht, made.dx, sizeof made.dx);
    return made.status;
}

void setUp()
{
    for (int i = 0; i < AMINN_N_STATE; ++i) {
        low[i] = -100.0F;
        high[i] = 100.0F;
    }
    model.range_min = low;
    model.range_max = high;
    model.length_scale = 0.1F;
    ctx.model = &model;
    state = aminn_state_t{};
    limits = {1.0F, 1.0F, 1.0F, 0.5F, 0.5F, 1.0F};
}

void tearDown()
{
    TEST_ASSERT_TRUE(predictions <= AMINN_LOAD_PREDICTIONS);
}

namespace {

void near(float end)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_INT32(1, found.admissible);
    TEST_ASSERT_TRUE(found.scale <= end && found.scale >= 0.9F * end);
}

void ends_are_found_over_two_decades()
{
    law = holds_up_to<2>;
    near(0.02F);
    law = holds_up_to<7>;
    near(0.07F);
    law = holds_up_to<50>;
    near(0.5F);
    law = holds_up_to<99>;
    near(0.99F);
    TEST_ASSERT_EQUAL_INT(AMINN_LOAD_PREDICTIONS, predictions);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_HOLD, found.limited_by);
    law = holds;
    near(1.0F);
    TEST_ASSERT_EQUAL_FLOAT(1.0F, found.scale);
    TEST_ASSERT_EQUAL_INT(9, predictions);
    law = holds_up_to<-1>;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_INT32(0, found.admissible);
    TEST_ASSERT_EQUAL_INT(1, predictions);
}

void what_lies_behind_a_gap_does_not_count()
{
    law = [](float load) {
        Made made;
        made.p_stable = load < 0.3F || load > 0.5F ? 1.0F : 0.0F;
        return made;
    };
    near(0.3F);
}

void the_reason_is_that_of_the_end()
{
    law = [](float load) { // further out another one
        Made made;
        made.dx[1] = 4.0F * load;
        made.p_stable = load > 0.8F ? 0.0F : 1.0F;
        return made;
    };
    near(0.25F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_TRANSLATION, found.limited_by);
    law = [](float load) {
        Made made;
        made.dx[5] = -5.0F * load;
        return made;
    };
    near(0.2F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_ROTATION, found.limited_by);
    law = [](float load) { // with what the error may be, m and rad
        Made made;
        made.dx[5] = 0.5F * load;
        made.bound = 2.0F * load;
        return made;
    };
    near(0.4F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_ROTATION, found.limited_by);
    limits.max_translation = 0.1F;
    near(0.4F);
    limits.margin = 2.0F;
    near(0.2222F);
    limits.max_translation = 0.05F;
    near(0.125F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_TRANSLATION, found.limited_by);
    law = [](float load) {
        Made made;
        made.p_slide = load;
        return made;
    };
    near(0.5F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_SLIDE, found.limited_by);
    law = [](float load) {
        Made made;
        made.notes = load > 0.6F ? AMINN_NOTE_ILL_CONDITIONED : 0u;
        return made;
    };
    near(0.6F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_RANGE, found.limited_by);
    law = [](float load) {
        Made made;
        made.dx[0] = load > 0.4F ? kNan : 0.0F;
        return made;
    };
    near(0.4F);
}

void the_scan_is_of_the_range_that_the_model_knows()
{
    limits.max_scale = FLT_MAX;
    high[offsetof(aminn_state_t, w_e) / sizeof(float)] = 0.5F;
    law = holds;
    near(0.5F);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_RANGE, found.limited_by);
    law = holds_up_to<20>;
    near(0.2F);
    low[offsetof(aminn_state_t, w_e) / sizeof(float)] = -0.1F;
    law = holds;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find(-2.0F));
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.05F, found.scale);
}

void an_error_on_the_way_is_passed_on()
{
    law = [](float load) {
        Made made;
        made.status = load > 0.5F ? AMINN_E_NUMERIC : AMINN_OK;
        return made;
    };
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, find());
    TEST_ASSERT_TRUE(found.scale == 0.0F && found.admissible == 0 && found.at.p_stable != found.at.p_stable);
    law = [](float load) { // met by a halving
        Made made = holds_up_to<60>(load);
        made.status = load > 0.5700F && load < 0.7F ? AMINN_E_NUMERIC : AMINN_OK;
        return made;
    };
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, find());
    TEST_ASSERT_TRUE(found.scale == 0.0F && found.admissible == 0);
}

} // namespace

int main()
{
    UNITY_BEGIN();
    RUN_TEST(ends_are_found_over_two_decades);
    RUN_TEST(what_lies_behind_a_gap_does_not_count);
    RUN_TEST(the_reason_is_that_of_the_end);
    RUN_TEST(the_scan_is_of_the_range_that_the_model_knows);
    RUN_TEST(an_error_on_the_way_is_passed_on);
    return UNITY_END();
}
