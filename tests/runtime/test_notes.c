/* The notes of a prediction: out of the training range, ill-conditioned, no contact; bad inputs one by one. */
#include "aminn_model.h"
#include "support.h"

static aminn_t ctx;
static aminn_input_t in;
static aminn_output_t out;

void setUp(void)
{
    in = good_input();
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2));
}

void tearDown(void)
{
    /* whatever happened, the next prediction from a good input works */
    const aminn_input_t good = good_input();
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &good, &out));
}

static void a_golden_state_is_within_the_range(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_HEX32(0, out.notes);
    TEST_ASSERT_TRUE(out.condition >= 36.0F * 0.999F);
}

static void each_field_out_of_its_range_is_noted(void)
{
    const aminn_input_t good = in;
    float *fields = in.q;
    int i;
    for (i = 0; i < AMINN_N_STATE; ++i) {
        const int feature = i - 20;
        float beyond = aminn_model.range_max[i] + 0.01F + 0.1F * fabsf(aminn_model.range_max[i]);
        if (feature >= 0 && feature % 8 == 0) {
            continue; /* a flag beyond 1 is an error, not a note */
        }
        if (feature >= 0 && feature % 8 >= 4 && feature % 8 <= 6) {
            continue; /* so is a normal that is not a unit vector */
        }
        if (i >= 11 && i < 14) {
            beyond = 3.1F; /* a rotation vector below pi */
            memset(&in.x_ht[3], 0, 3 * sizeof(float));
        }
        fields[i] = beyond;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
        TEST_ASSERT_TRUE_MESSAGE((out.notes & AMINN_NOTE_OUT_OF_RANGE) != 0, "range_max");
        in = good;
    }
    in.q[0] = aminn_model.range_min[0] - 0.1F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_TRUE((out.notes & AMINN_NOTE_OUT_OF_RANGE) != 0);
}

static void a_branch_out_of_contact_has_no_range_but_its_flag(void)
{
    aminn_model_t model = aminn_model;
    float low[AMINN_N_STATE];
    memcpy(low, aminn_model.range_min, sizeof low);
    low[20] = 0.0F; /* contacts may be open */
    model.range_min = low;
    in.contacts[0][0] = 0.0F;
    in.contacts[0][1] = 1e3F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_HEX32(AMINN_NOTE_OUT_OF_RANGE, out.notes & AMINN_NOTE_OUT_OF_RANGE);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_HEX32(0, out.notes & AMINN_NOTE_OUT_OF_RANGE);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2));
}

static void stiffnesses_far_apart_are_noted(void)
{
    int b, i, k;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        for (i = 0; i < 3; ++i) {
            for (k = 3; k < 6; ++k) {
                in.j_x[b][i][k] *= 1e5F; /* contacts kilometres away */
            }
        }
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_TRUE(out.condition > AMINN_ILL_CONDITIONED);
    TEST_ASSERT_TRUE((out.notes & AMINN_NOTE_ILL_CONDITIONED) != 0);
}

static void no_contact_is_an_error_with_a_note(void)
{
    int b;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        in.contacts[b][0] = 0.0F;
    }
    TEST_ASSERT_EQUAL_INT(AMINN_E_NO_CONTACT, aminn_predict(&ctx, &in, &out));
    assert_failed_output(&out);
    TEST_ASSERT_EQUAL_HEX32(AMINN_NOTE_NO_CONTACT, out.notes);
    TEST_ASSERT_FLOAT_IS_NAN(out.condition);
}

static void each_number_that_is_none_is_refused(void)
{
    const float bad[] = {NAN, INFINITY, -INFINITY};
    const aminn_input_t good = in;
    float *fields = in.q;
    size_t i, k;
    for (i = 0; i < sizeof in / sizeof(float); ++i) {
        for (k = 0; k < sizeof bad / sizeof bad[0]; ++k) {
            fields[i] = bad[k];
            TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, aminn_predict(&ctx, &in, &out));
            assert_failed_output(&out);
            TEST_ASSERT_EQUAL_HEX32(0, out.notes);
        }
        in = good;
    }
}

static void denormals_and_a_zero_wrench_are_fine(void)
{
    const float tiny = 1e-42F;
    int i;
    memset(in.w_e, 0, sizeof in.w_e);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        TEST_ASSERT_EQUAL_FLOAT(0.0F, out.dx_ht[i]);
        in.w_e[i] = tiny;
    }
    for (i = 0; i < AMINN_N_JOINT; ++i) {
        in.q[i] = -tiny;
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_TRUE(fabsf(out.dx_ht[0]) < 1e-35F);
}

static void a_joint_turned_thousands_of_times_is_refused_where_its_sine_is_needed(void)
{
    aminn_state_t state = state_of(&in);
    float j_x[3][3][6], j_q[3][3][3];
    state.q[3] = 1e5F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, aminn_predict_state(&ctx, &state, &out));
    assert_failed_output(&out);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, aminn_closure(&aminn_model, state.q, state.x_ht, state.contacts, j_x, j_q));
    TEST_ASSERT_FLOAT_IS_NAN(j_x[2][2][5]);
    TEST_ASSERT_FLOAT_IS_NAN(j_q[0][0][0]);
}

/* one contact holds a moment by next to nothing: the displacement is finite, the load's work is not */
static void work_beyond_float_is_refused(void)
{
    memset(in.w_e, 0, sizeof in.w_e);
    in.contacts[1][0] = in.contacts[2][0] = 0.0F;
    in.w_e[3] = 1e18F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, aminn_predict(&ctx, &in, &out));
    assert_failed_output(&out);
}

static void loads_beyond_float_are_refused(void)
{
    in.w_e[0] = 3e38F;
    in.w_e[1] = -3e38F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, aminn_predict(&ctx, &in, &out));
    assert_failed_output(&out);
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(a_golden_state_is_within_the_range);
    RUN_TEST(each_field_out_of_its_range_is_noted);
    RUN_TEST(a_branch_out_of_contact_has_no_range_but_its_flag);
    RUN_TEST(stiffnesses_far_apart_are_noted);
    RUN_TEST(no_contact_is_an_error_with_a_note);
    RUN_TEST(each_number_that_is_none_is_refused);
    RUN_TEST(denormals_and_a_zero_wrench_are_fine);
    RUN_TEST(a_joint_turned_thousands_of_times_is_refused_where_its_sine_is_needed);
    RUN_TEST(work_beyond_float_is_refused);
    RUN_TEST(loads_beyond_float_are_refused);
    return UNITY_END();
}
