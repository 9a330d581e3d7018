/* sense.cpp: what sensors know, in a model that sees them; absent is not zero */
#include "aminn_model.h"
#include "support.h"

enum { CONTACT_WIDTH = 32, WIDTH = 64 };

static aminn_t ctx;
static aminn_input_t in;
static aminn_output_t out, untold;
static aminn_model_t model;
static aminn_sensors_t sensors;

/* the reference model, or where that sees no sensors one that does: rows more in the first layer of the trunk */
static void make_sensing(void)
{
    static float mean[2][AMINN_N_TOLD_INPUT], inv_std[2][AMINN_N_TOLD_INPUT];
    static float rows[2][(CONTACT_WIDTH + AMINN_N_TOLD_INPUT) * WIDTH];
    int stage, i;
    model = aminn_model;
    if (model.n_sensed != 0) {
        return;
    }
    TEST_ASSERT_EQUAL_UINT32(0, model.n_told);
    TEST_ASSERT_EQUAL_UINT32(CONTACT_WIDTH, model.contact_width);
    TEST_ASSERT_EQUAL_UINT32(WIDTH, model.width[0]);
    TEST_ASSERT_EQUAL_UINT32(WIDTH, model.width[1]);
    model.n_sensed = AMINN_N_SENSED;
    for (stage = 0; stage < 2; ++stage) {
        aminn_stage_model_t *s = &model.stage[stage];
        const int known = (CONTACT_WIDTH + AMINN_N_GLOBAL_INPUT) * WIDTH;
        memcpy(mean[stage], s->global_mean, AMINN_N_GLOBAL_INPUT * sizeof(float));
        memcpy(inv_std[stage], s->global_inv_std, AMINN_N_GLOBAL_INPUT * sizeof(float));
        memcpy(rows[stage], s->trunk1_w, (size_t)known * sizeof(float));
        for (i = 0; i < AMINN_N_SENSED; ++i) {
            mean[stage][AMINN_N_GLOBAL_INPUT + i] = 0.1F;
            inv_std[stage][AMINN_N_GLOBAL_INPUT + i] = 2.0F;
        }
        for (i = 0; i < AMINN_N_SENSED * WIDTH; ++i) {
            rows[stage][known + i] = (float)(i % 7 - 3) * 0.02F;
        }
        s->global_mean = mean[stage];
        s->global_inv_std = inv_std[stage];
        s->trunk1_w = rows[stage];
    }
}

void setUp(void)
{
    in = good_input();
    make_sensing();
    memset(&sensors, 0, sizeof sensors);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &untold));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, &sensors));
}

void tearDown(void)
{
}

static aminn_output_t told(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    return out;
}

static int differ(const aminn_output_t *a, const aminn_output_t *b)
{
    return memcmp(a, b, sizeof *a) != 0;
}

static void a_context_and_a_model_that_sees_are_needed(void)
{
    static aminn_t zero;
    aminn_model_t blind = model;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_sense(NULL, &sensors));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_sense(&zero, &sensors));
    blind.n_sensed = 0; /* its tables have rows more than it needs */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &blind, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, aminn_sense(&ctx, &sensors));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, NULL));
    sensors.friction[0] = 7.0F; /* not in use */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
}

static void nothing_told_is_nothing_known(void)
{
    told();
    assert_same_output(&untold, &out);
    sensors.friction[1] = 0.4F; /* behind a flag that is 0 */
    sensors.friction[2] = -3.0F;
    sensors.tool_weight[3] = -2.0F;
#if AMINN_N_TENDON > 0
    sensors.tendon_tension[AMINN_N_TENDON] = 5.0F;
#endif
    told();
    assert_same_output(&untold, &out);
    sensors.friction[0] = 1.0F; /* known, and as good as unknown */
    sensors.friction[2] = 1e30F;
    told();
    assert_same_output(&untold, &out);
}

static void absent_is_not_zero(void)
{
    aminn_output_t before = untold;
    sensors.tool_weight[0] = 1.0F;
    told();
    TEST_ASSERT_TRUE(differ(&before, &out));
    before = out;
    sensors.tool_weight[3] = -1.0F;
    told();
    TEST_ASSERT_TRUE(differ(&before, &out));
    before = out;
#if AMINN_N_TENDON > 0
    sensors.tendon_tension[0] = 1.0F;
    told();
    TEST_ASSERT_TRUE(differ(&before, &out));
    before = out;
    sensors.tendon_tension[AMINN_N_TENDON] = 2.0F;
    told();
    TEST_ASSERT_TRUE(differ(&before, &out));
#endif
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, NULL));
    told();
    assert_same_output(&untold, &out);
}

/* what stands in the row of a contact that is none carries nothing of the weight */
static void a_contact_that_is_none_carries_nothing(void)
{
    aminn_output_t before;
    sensors.tool_weight[0] = 1.0F;
    sensors.tool_weight[3] = -1.0F;
    in.contacts[0][0] = 0.0F;
    before = told();
    in.contacts[0][7] = 50.0F;
    told();
    assert_same_output(&before, &out);
}

static void friction_counts_as_far_as_it_is_known(void)
{
    static const float classes[][3] = {AMINN_FRICTION_LOW, AMINN_FRICTION_MID, AMINN_FRICTION_HIGH};
    float p[3];
    int i;
    for (i = 0; i < 3; ++i) {
        memcpy(sensors.friction, classes[i], sizeof sensors.friction);
        p[i] = told().p_stable;
        TEST_ASSERT_TRUE(i == 0 || classes[i][1] > classes[i - 1][1]);
    }
    TEST_ASSERT_TRUE(p[0] != p[1] && p[1] != p[2]);
    sensors.friction[1] = 0.4F;
    sensors.friction[2] = 0.0F;
    p[0] = told().p_stable;
    sensors.friction[2] = 0.12F; /* 0.3 of it: as much is known as is not */
    p[1] = told().p_stable;
    TEST_ASSERT_TRUE(p[0] != p[1] && p[1] != untold.p_stable);
}

static void assert_refused(void)
{
    scribble(&out, sizeof out);
    TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, aminn_predict(&ctx, &in, &out));
    assert_failed_output(&out);
    memset(&sensors, 0, sizeof sensors);
    told();
    assert_same_output(&untold, &out);
}

static void what_no_sensor_says_is_refused(void)
{
    static const float bad_flags[] = {-1.0F, 0.5F, 2.0F, INFINITY, NAN};
    size_t i;
    for (i = 0; i < sizeof bad_flags / sizeof *bad_flags; ++i) {
        sensors.friction[0] = bad_flags[i];
        sensors.friction[1] = 0.5F;
        assert_refused();
        sensors.tool_weight[0] = bad_flags[i];
        assert_refused();
#if AMINN_N_TENDON > 0
        sensors.tendon_tension[0] = bad_flags[i];
        assert_refused();
#endif
    }
    for (i = 0; i < AMINN_N_SENSOR; ++i) { /* known or not */
        ((float *)&sensors)[i] = i % 2 == 0 ? NAN : -INFINITY;
        assert_refused();
    }
    sensors.friction[0] = 1.0F; /* a coefficient of 0 */
    assert_refused();
    sensors.friction[0] = 1.0F;
    sensors.friction[1] = -0.5F;
    assert_refused();
    sensors.friction[0] = 1.0F;
    sensors.friction[1] = 0.5F;
    sensors.friction[2] = -0.1F;
    assert_refused();
}

static void a_bad_state_comes_first(void)
{
    sensors.friction[0] = 7.0F;
    in.q[0] = NAN;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, aminn_predict(&ctx, &in, &out));
}

static void the_self_test_tells_nothing_and_leaves_sensors_in_use(void)
{
    aminn_output_t before;
    sensors.tool_weight[0] = 1.0F;
    before = told();
    sensors.friction[0] = 7.0F; /* would fail a prediction */
    TEST_ASSERT_TRUE(aminn_self_test(&ctx) != AMINN_E_SENSORS);
    sensors.friction[0] = 0.0F;
    told();
    assert_same_output(&before, &out);
}

static void a_push_is_predicted_with_the_sensors(void)
{
    static aminn_calibrator_t calibrator;
    const aminn_state_t state = state_of(&in);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrator_init(&calibrator, &model, NULL, NULL));
    sensors.friction[0] = 7.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, aminn_calibrate_push(&ctx, &calibrator, &state, untold.dx_ht));
    TEST_ASSERT_EQUAL_UINT32(0, calibrator.pushes);
    sensors.friction[0] = 0.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, untold.dx_ht));
    TEST_ASSERT_EQUAL_UINT32(1, calibrator.pushes);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(a_context_and_a_model_that_sees_are_needed);
    RUN_TEST(nothing_told_is_nothing_known);
    RUN_TEST(absent_is_not_zero);
    RUN_TEST(a_contact_that_is_none_carries_nothing);
    RUN_TEST(friction_counts_as_far_as_it_is_known);
    RUN_TEST(what_no_sensor_says_is_refused);
    RUN_TEST(a_bad_state_comes_first);
    RUN_TEST(the_self_test_tells_nothing_and_leaves_sensors_in_use);
    RUN_TEST(a_push_is_predicted_with_the_sensors);
    return UNITY_END();
}
