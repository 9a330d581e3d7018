/* input.cpp: each bad input has its status code, and the outputs cannot be taken for a prediction */
#include "aminn_model.h"
#include "support.h"

static aminn_t ctx;
static aminn_input_t in;
static aminn_output_t out;

void setUp(void)
{
    in = good_input();
    scribble(&out, sizeof out);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2));
}

void tearDown(void)
{
}

/* both predict functions refuse the input, leave defined outputs, and work again afterwards */
static void assert_refused(aminn_status_t status)
{
    const aminn_input_t good = good_input();
    const aminn_state_t state = state_of(&in);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &good, &out));
    TEST_ASSERT_EQUAL_INT(status, aminn_predict(&ctx, &in, &out));
    assert_failed_output(&out);
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_NULL(aminn_debug(&ctx, 1));
    scribble(&out, sizeof out);
    TEST_ASSERT_EQUAL_INT(status, aminn_predict_state(&ctx, &state, &out));
    assert_failed_output(&out);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &good, &out));
}

static void every_number_must_be_finite(void)
{
    static const float bad[] = {NAN, INFINITY, -INFINITY};
    float *numbers = (float *)&in;
    size_t i;
    for (i = 0; i < sizeof in / sizeof(float); ++i) {
        const float kept = numbers[i];
        numbers[i] = bad[i % 3];
        scribble(&out, sizeof out);
        TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, aminn_predict(&ctx, &in, &out));
        assert_failed_output(&out);
        if (i < sizeof(aminn_state_t) / sizeof(float)) {
            assert_refused(AMINN_E_NONFINITE);
        }
        numbers[i] = kept;
    }
}

static void a_contact_flag_lies_in_0_1(void)
{
    int b;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        in = good_input();
        in.contacts[b][0] = -0.01F;
        assert_refused(AMINN_E_CONTACT_FLAG);
        in.contacts[b][0] = 1.01F;
        assert_refused(AMINN_E_CONTACT_FLAG);
        in.contacts[b][0] = 0.5F;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    }
}

static void a_normal_is_a_unit_vector_while_in_contact(void)
{
    int b, i;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        in = good_input();
        for (i = 4; i < 7; ++i) {
            in.contacts[b][i] *= 1.01F;
        }
        assert_refused(AMINN_E_NORMAL);
        memset(&in.contacts[b][4], 0, 3 * sizeof(float));
        assert_refused(AMINN_E_NORMAL);
        in.contacts[b][4] = 1e30F; /* its square overflows */
        assert_refused(AMINN_E_NORMAL);
        in.contacts[b][0] = 0.0F; /* out of contact, the row does not matter */
        in.contacts[b][4] = 3.0F;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    }
}

static void a_rotation_vector_is_at_most_pi_long(void)
{
    in.x_ht[3] = 3.2F;
    in.x_ht[4] = in.x_ht[5] = 0.0F;
    assert_refused(AMINN_E_ROTATION);
    in.x_ht[3] = -3.14159F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    in.x_ht[3] = in.x_ht[4] = in.x_ht[5] = 2.5F;
    assert_refused(AMINN_E_ROTATION);
}

static void a_grasp_needs_a_contact(void)
{
    memset(in.contacts, 0, sizeof in.contacts);
    assert_refused(AMINN_E_NO_CONTACT);
}

static void the_first_of_several_errors_is_the_documented_one(void)
{
    memset(in.contacts, 0, sizeof in.contacts);
    in.x_ht[3] = 4.0F;
    assert_refused(AMINN_E_ROTATION);
    in.contacts[2][0] = 1.0F;
    assert_refused(AMINN_E_NORMAL);
    in.contacts[0][0] = 2.0F;
    assert_refused(AMINN_E_CONTACT_FLAG);
    in.q[0] = NAN;
    assert_refused(AMINN_E_NONFINITE);
}

static void overflow_is_an_error_not_a_prediction(void)
{
    int i;
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        in.w_e[i] = 3e38F;
    }
    assert_refused(AMINN_E_NUMERIC);
}

/* small generator, the same on every machine */
static uint32_t next_random(void)
{
    static uint32_t x = 2463534242u;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    return x;
}

static void assert_good_output(void)
{
    const float *numbers = &out.p_stable;
    size_t i;
    for (i = 0; i < 46; ++i) {
        TEST_ASSERT_TRUE(isfinite(numbers[i]));
    }
    TEST_ASSERT_TRUE(out.p_stable >= 0 && out.p_stable <= 1);
    TEST_ASSERT_TRUE(out.stable == 0 || out.stable == 1);
}

/* any bits in one place, or in many: either a prediction in numbers, or an error with the outputs of an error */
static void whatever_the_bits_the_outputs_are_defined(void)
{
    const aminn_input_t good = good_input();
    const uint32_t n = sizeof in / sizeof(float);
    uint32_t round, predicted = 0;
    for (round = 0; round < 20000; ++round) {
        uint32_t changes = round % 4 == 3 ? n : 1 + next_random() % 3;
        float *numbers = (float *)&in;
        aminn_status_t status;
        in = good;
        while (changes-- > 0) {
            const uint32_t bits = next_random();
            memcpy(&numbers[next_random() % n], &bits, sizeof bits);
        }
        scribble(&out, sizeof out);
        status = aminn_predict(&ctx, &in, &out);
        if (status == AMINN_OK) {
            assert_good_output();
            ++predicted;
        } else {
            assert_failed_output(&out);
        }
    }
    printf("random bits: %u of 20000 predicted, the others refused\n", (unsigned)predicted);
    TEST_ASSERT_TRUE(predicted > 0 && predicted < 20000);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(every_number_must_be_finite);
    RUN_TEST(a_contact_flag_lies_in_0_1);
    RUN_TEST(a_normal_is_a_unit_vector_while_in_contact);
    RUN_TEST(a_rotation_vector_is_at_most_pi_long);
    RUN_TEST(a_grasp_needs_a_contact);
    RUN_TEST(the_first_of_several_errors_is_the_documented_one);
    RUN_TEST(overflow_is_an_error_not_a_prediction);
    RUN_TEST(whatever_the_bits_the_outputs_are_defined);
    return UNITY_END();
}
