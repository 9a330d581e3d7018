/* aminn_admissible_load() with the reference model: what it finds is what predictions say; limits, edges, errors. */
#include <float.h>

#include "aminn_model.h"
#include "support.h"

static const float none[AMINN_N_WRENCH];
static const aminn_load_limits_t usual = {2e-3F, 0.1F, 0.0F, 0.9F, 1.0F, 1.0F};

static aminn_t ctx;
static aminn_state_t state; /* unloaded */
static float load[AMINN_N_WRENCH];
static aminn_load_limits_t limits;
static aminn_admissible_t found;

void setUp(void)
{
    const aminn_input_t in = good_input();
    state = state_of(&in);
    memcpy(load, state.w_e, sizeof load);
    memset(state.w_e, 0, sizeof state.w_e);
    limits = usual;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, 0));
}

void tearDown(void)
{
}

static aminn_status_t find(void)
{
    scribble(&found, sizeof found);
    return aminn_admissible_load(&ctx, &state, load, &limits, &found);
}

/* predicts with a scale of `load` on top of w_e */
static aminn_output_t with_scale(float scale)
{
    aminn_state_t loaded = state;
    aminn_output_t out;
    int i;
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        loaded.w_e[i] += scale * load[i];
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &loaded, &out));
    return out;
}

static float size_of(const float *v)
{
    return sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static void aim(float size)
{
    int i;
    const float was = size_of(load);
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        load[i] *= size / was;
    }
}

static void what_is_found_is_what_is_predicted(void)
{
    aminn_output_t larger, at;
    aim(10.0F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_INT32(1, found.admissible);
    TEST_ASSERT_TRUE(found.scale > 0.02F && found.scale < 1.0F);
    at = with_scale(found.scale);
    assert_same_output(&at, &found.at);
    TEST_ASSERT_TRUE(at.stable == 1 && at.p_stable >= 0.9F && size_of(at.dx_ht) <= 2e-3F &&
                     size_of(at.dx_ht + 3) <= 0.1F);
    larger = with_scale(1.2F * found.scale);
    TEST_ASSERT_TRUE(larger.p_stable < 0.9F || !(size_of(larger.dx_ht) < 2e-3F) || !(size_of(larger.dx_ht + 3) < 0.1F));
}

static void each_limit_limits(void)
{
    float by_hold;
    limits.max_translation = limits.max_rotation = INFINITY;
    aim(15.0F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_HOLD, found.limited_by);
    by_hold = found.scale;
    limits.p_stable = 0.0F; /* tau */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_HOLD, found.limited_by);
    TEST_ASSERT_TRUE(found.scale > by_hold && found.at.p_stable >= aminn_model.tau);

    limits.p_slide = 0.5F * with_scale(0.0F).p_slide;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_SLIDE, found.limited_by);
    TEST_ASSERT_EQUAL_INT32(0, found.admissible);
    limits.p_slide = 1.0F;

    limits.max_translation = 5e-4F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_TRANSLATION, found.limited_by);
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 5e-4F, size_of(found.at.dx_ht));
    limits.max_translation = INFINITY;
    limits.max_rotation = 2e-3F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_ROTATION, found.limited_by);
    TEST_ASSERT_FLOAT_WITHIN(4e-4F, 2e-3F, size_of(found.at.dx_ht + 3));
}

static void the_bound_of_the_error_is_added(void)
{
    float plain;
    limits.max_translation = 5e-4F;
    aim(10.0F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    plain = found.scale;
    limits.margin = 1e-4F / (aminn_model.length_scale * with_scale(0.0F).bound_95);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_TRANSLATION, found.limited_by);
    TEST_ASSERT_TRUE(found.scale > 0.0F && found.scale < plain);
    TEST_ASSERT_TRUE(size_of(found.at.dx_ht) + limits.margin * aminn_model.length_scale * found.at.bound_95 <=
                     5.001e-4F);
}

static void all_that_is_asked_for_may_be_admissible(void)
{
    aim(0.1F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_NOT, found.limited_by);
    TEST_ASSERT_EQUAL_FLOAT(limits.max_scale, found.scale);
    memset(load, 0, sizeof load);
    limits.max_scale = FLT_MAX;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_FLOAT(FLT_MAX, found.scale);
}

static void what_the_model_does_not_know_is_not_admissible(void)
{
    aminn_model_t model = aminn_model;
    float low[AMINN_N_STATE], high[AMINN_N_STATE];
    memcpy(low, aminn_model.range_min, sizeof low);
    memcpy(high, aminn_model.range_max, sizeof high);
    model.range_min = low;
    model.range_max = high;
    low[14] = low[15] = -0.2F; /* w_e */
    high[14] = high[15] = 0.1F;
    memset(load, 0, sizeof load);
    load[0] = -1.0F;
    load[1] = -4.0F;
    limits.max_scale = FLT_MAX;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_RANGE, found.limited_by);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.05F, found.scale); /* all of the range */
    TEST_ASSERT_EQUAL_HEX32(0, found.at.notes);
    load[0] = 1.0F;
    load[1] = 0.0F;
    state.w_e[0] = -0.1F; /* there anyway */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.2F, found.scale);
    state.w_e[0] = 0.2F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_INT32(0, found.admissible);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_RANGE, found.limited_by);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, found.scale);
}

static void a_grasp_that_does_not_hold_bears_nothing(void)
{
    aminn_output_t out;
    state.w_e[2] = 0.9F * aminn_model.range_min[16]; /* w_e[2] */
    limits.p_stable = 1.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_EQUAL_INT32(0, found.admissible);
    TEST_ASSERT_EQUAL_UINT32(AMINN_LIMITED_BY_HOLD, found.limited_by);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, found.scale);
    out = with_scale(0.0F);
    assert_same_output(&out, &found.at); /* which says why */
}

static void a_calibrated_hand_bears_what_it_is_predicted_to(void)
{
    static aminn_calibration_t soft;
    float theta[AMINN_N_THETA] = {0}, stiff;
    int i;
    for (i = 0; i < AMINN_N_STIFF; ++i) {
        theta[i] = -1.0F;
    }
    limits.max_translation = 5e-4F;
    aim(10.0F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    stiff = found.scale;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibration_set(&soft, &aminn_model, theta));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate(&ctx, &soft));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_TRUE(found.scale > 0.0F && found.scale < 0.7F * stiff);
}

static void assert_refused(aminn_status_t status)
{
    TEST_ASSERT_EQUAL_INT(status, find());
    TEST_ASSERT_TRUE(found.scale == 0.0F && found.admissible == 0);
    assert_failed_output(&found.at);
}

static void limits_that_are_none_are_refused(void)
{
    static const float bad[] = {0.0F, -1.0F, NAN};
    size_t i;
    for (i = 0; i < sizeof bad / sizeof *bad; ++i) {
        float *positive[] = {&limits.max_translation, &limits.max_rotation, &limits.max_scale};
        float *any[] = {&limits.margin, &limits.p_stable, &limits.p_slide};
        size_t k;
        for (k = 0; k < 3; ++k) {
            *positive[k] = bad[i];
            assert_refused(AMINN_E_LIMITS);
            limits = usual;
        }
        for (k = 0; k < 3 && i > 0; ++k) {
            *any[k] = bad[i];
            assert_refused(AMINN_E_LIMITS);
            limits = usual;
        }
    }
    limits.p_stable = 1.5F;
    assert_refused(AMINN_E_LIMITS);
    limits = usual;
    limits.p_slide = 1.5F;
    assert_refused(AMINN_E_LIMITS);
    limits = usual;
    limits.margin = INFINITY;
    assert_refused(AMINN_E_LIMITS);
    limits = usual;
    limits.max_scale = INFINITY;
    assert_refused(AMINN_E_LIMITS);
}

/* found by make fuzz: it was still shown */
static void limits_that_are_none_hide_the_last_prediction(void)
{
    aminn_output_t out;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &state, &out));
    limits.margin = -1.0F;
    assert_refused(AMINN_E_LIMITS);
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
}

static void bad_arguments_are_refused(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_load(&ctx, &state, load, &limits, NULL));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_load(NULL, &state, load, &limits, &found));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_load(&ctx, NULL, load, &limits, &found));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_load(&ctx, &state, NULL, &limits, &found));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_load(&ctx, &state, load, NULL, &found));
    assert_failed_output(&found.at);
    load[3] = NAN;
    assert_refused(AMINN_E_NONFINITE);
    memcpy(load, none, sizeof load);
    state.contacts[1][4] = 3.0F;
    assert_refused(AMINN_E_NORMAL); /* as a prediction does */
    memset(&ctx, 0, sizeof ctx);
    assert_refused(AMINN_E_NOT_INITIALISED);
}

static void what_debug_showed_is_gone(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, find());
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
    with_scale(0.0F);
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 0));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(what_is_found_is_what_is_predicted);
    RUN_TEST(each_limit_limits);
    RUN_TEST(the_bound_of_the_error_is_added);
    RUN_TEST(all_that_is_asked_for_may_be_admissible);
    RUN_TEST(what_the_model_does_not_know_is_not_admissible);
    RUN_TEST(a_grasp_that_does_not_hold_bears_nothing);
    RUN_TEST(a_calibrated_hand_bears_what_it_is_predicted_to);
    RUN_TEST(limits_that_are_none_are_refused);
    RUN_TEST(limits_that_are_none_hide_the_last_prediction);
    RUN_TEST(bad_arguments_are_refused);
    RUN_TEST(what_debug_showed_is_gone);
    return UNITY_END();
}
