/* Two models with different prefixes in one program, used in turn by two contexts. */
#include "aminn_model.h"
#include "support.h"
#include "tiny_model.h"

void setUp(void)
{
}

void tearDown(void)
{
}

static void they_do_not_disturb_each_other(void)
{
    static aminn_t first, second;
    const aminn_input_t in = good_input();
    aminn_output_t a, b, again;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&first, &aminn_model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&second, &tiny_model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&first, &in, &a));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&second, &in, &b));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&first, &in, &again));
    assert_same_output(&a, &again);
    TEST_ASSERT_TRUE(a.p_stable != b.p_stable);
}

static void they_come_from_different_checkpoints(void)
{
    TEST_ASSERT_TRUE(memcmp(aminn_model.checkpoint_sha256, tiny_model.checkpoint_sha256, 32) != 0);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(they_do_not_disturb_each_other);
    RUN_TEST(they_come_from_different_checkpoints);
    return UNITY_END();
}
