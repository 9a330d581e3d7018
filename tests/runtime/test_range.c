/* range.cpp: the field that is out of range, and its name */
#include "aminn_model.h"
#include "support.h"
#include "tiny_model.h"

static aminn_t ctx;
static aminn_output_t out;
static golden_t golden;

void setUp(void)
{
    golden = load_golden(GOLDEN_DIR "/golden.bin");
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, 0));
}

void tearDown(void)
{
    free_golden(&golden);
}

/* what the note says of a state, and what the function says */
static void assert_agrees(const aminn_model_t *model, const aminn_state_t *state)
{
    const int first = aminn_first_out_of_range(model, state);
    const aminn_status_t status = aminn_predict_state(&ctx, state, &out);
    const float *numbers = (const float *)state;
    if (status == AMINN_OK) {
        TEST_ASSERT_EQUAL_INT((out.notes & AMINN_NOTE_OUT_OF_RANGE) != 0, first >= 0);
    }
    if (first >= 0) {
        TEST_ASSERT_TRUE(numbers[first] < model->range_min[first] || numbers[first] > model->range_max[first]);
        TEST_ASSERT_NOT_EQUAL(0, strcmp("none", aminn_field_name(first)));
    }
}

static void nothing_of_the_known_answer_is_out_of_range(void)
{
    TEST_ASSERT_EQUAL_INT(-1, aminn_first_out_of_range(&aminn_model, &aminn_model.known_answer->state));
    TEST_ASSERT_EQUAL_INT(-1, aminn_first_out_of_range(NULL, &aminn_model.known_answer->state));
    TEST_ASSERT_EQUAL_INT(-1, aminn_first_out_of_range(&aminn_model, NULL));
}

/* each number moved beyond either end, at the end itself, and far: 200 x 44 x 5 states */
static void it_agrees_with_the_note_for_every_field(void)
{
    uint32_t i;
    int field, noted = 0;
    for (i = 0; i < golden.n; ++i) {
        for (field = 0; field < AMINN_N_STATE; ++field) {
            const float low = aminn_model.range_min[field], high = aminn_model.range_max[field];
            const float values[] = {nextafterf(low, -INFINITY), low, high, nextafterf(high, INFINITY), 2.0F * high};
            size_t k;
            for (k = 0; k < sizeof values / sizeof values[0]; ++k) {
                aminn_state_t state = state_of(&golden.inputs[i]);
                ((float *)&state)[field] = values[k];
                assert_agrees(&aminn_model, &state);
                noted += (out.notes & AMINN_NOTE_OUT_OF_RANGE) != 0;
            }
        }
    }
    TEST_ASSERT_TRUE(noted > 1000);
}

static void a_branch_out_of_contact_counts_by_its_flag_alone(void)
{
    golden_t tiny = load_golden(GOLDEN_DIR "/tiny_golden.bin");
    uint32_t i;
    int open = 0;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &tiny_model, 0));
    for (i = 0; i < tiny.n; ++i) {
        aminn_state_t state = state_of(&tiny.inputs[i]);
        int b;
        for (b = 0; b < AMINN_N_BRANCH; ++b) {
            if (state.contacts[b][0] == 0.0F) {
                state.contacts[b][7] = 1e9F;
                ++open;
            }
        }
        assert_agrees(&tiny_model, &state);
    }
    TEST_ASSERT_TRUE(open > 3);
    free_golden(&tiny);
}

static void fields_have_names_with_units(void)
{
    int i, j;
    TEST_ASSERT_EQUAL_STRING("q.finger1_roll_rad", aminn_field_name(0));
    TEST_ASSERT_EQUAL_STRING("q.thumb_distal_rad", aminn_field_name(7));
    TEST_ASSERT_EQUAL_STRING("x_ht.position_x_m", aminn_field_name(8));
    TEST_ASSERT_EQUAL_STRING("w_e.moment_z_Nm", aminn_field_name(19));
    TEST_ASSERT_EQUAL_STRING("contacts[0].in_contact", aminn_field_name(20));
    TEST_ASSERT_EQUAL_STRING("contacts[2].normal_force_N", aminn_field_name(43));
    TEST_ASSERT_EQUAL_STRING("none", aminn_field_name(-1));
    TEST_ASSERT_EQUAL_STRING("none", aminn_field_name(44));
    TEST_ASSERT_EQUAL_STRING("none", aminn_field_name(-2147483647 - 1));
    for (i = 0; i < AMINN_N_STATE; ++i) {
        for (j = 0; j < i; ++j) {
            TEST_ASSERT_NOT_EQUAL(0, strcmp(aminn_field_name(i), aminn_field_name(j)));
        }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(nothing_of_the_known_answer_is_out_of_range);
    RUN_TEST(it_agrees_with_the_note_for_every_field);
    RUN_TEST(a_branch_out_of_contact_counts_by_its_flag_alone);
    RUN_TEST(fields_have_names_with_units);
    return UNITY_END();
}
