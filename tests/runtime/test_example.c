/* The example at the top of aminn_rt.h, compiled and run as it stands there. */
#include "support.h"

#include "aminn_model.h"

static aminn_t ctx;         /* working memory, .bss */
static aminn_state_t state; /* filled from encoders, hand pose and contact sensors */
static aminn_output_t out;

static int controller_start(void)
{
    aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
    return status != AMINN_OK ? status : aminn_self_test(&ctx);
}

/* 1: the grasp holds and the tool will move by out.dx_ht; 0: it will not hold, or the model does not know such states;
 * negative: status code */
static int controller_step(void)
{
    aminn_status_t status = aminn_predict_state(&ctx, &state, &out);
    return status != AMINN_OK ? (int)status : out.stable && out.notes == 0;
}

void setUp(void)
{
}

void tearDown(void)
{
}

static void the_example_works(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, controller_start());
    TEST_ASSERT_EQUAL_INT(AMINN_E_NO_CONTACT, controller_step()); /* nothing measured yet */
    state = aminn_model.known_answer->state;
    TEST_ASSERT_EQUAL_INT(1, controller_step());
    state.contacts[0][7] = 100.0F; /* a finger that presses with 100 N: no such grasp was trained */
    TEST_ASSERT_EQUAL_INT(0, controller_step());
    TEST_ASSERT_EQUAL_STRING("contacts[0].normal_force_N",
                             aminn_field_name(aminn_first_out_of_range(&aminn_model, &state)));
    state.q[0] = NAN;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, controller_step());
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(the_example_works);
    return UNITY_END();
}
