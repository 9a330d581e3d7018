/* The firmware's limiter on pushes.bin: ten pushes of a hand with other stiffnesses make it better on that hand's loads. */
#include "aminn_model.h"
#include "support.h"
#include "trial.h"

enum { PUSHES = 10 };

static limiter_t limiter;
static golden_t file;

void setUp(void)
{
    const limits_t limits = {1e-3F, 0.5F, 0.05F};
    file = load_golden(GOLDEN_DIR "/pushes.bin");
    TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_init(&limiter, &aminn_model, limits));
}

void tearDown(void)
{
    free_golden(&file);
}

static trial_t trial(uint32_t i)
{
    const float *measured = file.reference + (size_t)i * VECTOR_N_OUT;
    trial_t t;
    t.before = state_of(&file.inputs[i]);
    t.held = measured[0];
    memcpy(t.dx_ht, measured + 1, sizeof t.dx_ht);
    return t;
}

static verdict_t judged(void)
{
    verdict_t verdict = {0, 0, 0, 0, 0.0F};
    uint32_t i;
    for (i = PUSHES; i < file.n; ++i) {
        trial_t t = trial(i);
        judge(&limiter, aminn_model.length_scale, &t, &verdict);
    }
    printf("of %u loads, %u good: %u let through wrongly, %u refused needlessly, error of the motion %.3f\n",
           (unsigned)(file.n - PUSHES), (unsigned)verdict.good, (unsigned)verdict.wrong, (unsigned)verdict.needless,
           (double)mean_error(&verdict));
    return verdict;
}

static void ten_pushes_make_it_better(void)
{
    const verdict_t nominal = judged();
    verdict_t learned;
    uint32_t i;
    for (i = 0; i < PUSHES; ++i) {
        const trial_t t = trial(i);
        TEST_ASSERT_EQUAL_FLOAT(1.0F, t.held);
        TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_learn(&limiter, &t.before, t.dx_ht));
    }
    learned = judged();
    TEST_ASSERT_TRUE(is_better(&learned, &nominal));
    TEST_ASSERT_TRUE(learned.wrong < nominal.wrong && mean_error(&learned) < 0.7F * mean_error(&nominal));
    TEST_ASSERT_FALSE(is_better(&nominal, &learned));
}

static void a_share_of_the_load_is_permitted_again_step_by_step(void)
{
    trial_t t = trial(0);
    memset(t.before.w_e, 0, sizeof t.before.w_e);
    t.before.w_e[2] = -0.1F;
    limiter.share = 0.5F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_step(&limiter, &t.before));
    TEST_ASSERT_EQUAL_FLOAT(0.55F, limiter.share);
    TEST_ASSERT_EQUAL_FLOAT(-0.05F, t.before.w_e[2]);
    t.before.w_e[2] = -100.0F; /* no grasp holds that */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_step(&limiter, &t.before));
    TEST_ASSERT_EQUAL_FLOAT(0.275F, limiter.share);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, t.before.w_e[2]);
}

static void nothing_is_learned_from_a_bad_push(void)
{
    const trial_t t = trial(0);
    float dx[AMINN_N_WRENCH] = {NAN, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F};
    const verdict_t none = {0, 0, 0, 0, 0.0F};
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, limiter_learn(&limiter, &t.before, dx));
    TEST_ASSERT_EQUAL_UINT32(0, limiter.calibrator.pushes);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, mean_error(&none));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(ten_pushes_make_it_better);
    RUN_TEST(a_share_of_the_load_is_permitted_again_step_by_step);
    RUN_TEST(nothing_is_learned_from_a_bad_push);
    return UNITY_END();
}
