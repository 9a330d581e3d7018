/* The firmware's limiter on pushes.bin: ten pushes of a hand with other stiffnesses make it better on that hand's loads. */
#include "aminn_model.h"
#include "support.h"
#include "trial.h"

enum { PUSHES = 10 };

static limiter_t limiter;
static golden_t file;

void setUp(void)
{
    const aminn_load_limits_t limits = {1e-3F, 3.0F, 0.0F, 0.0F, 1.0F, 1.0F}; /* 1 mm */
    file = load_golden(GOLDEN_DIR "/pushes.bin");
    TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_init(&limiter, &aminn_model, &limits));
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
    verdict_t verdict = {0};
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

/* A rule that halves what it permits, or lets a load through, has nothing at hand in the tick in which it finds out. */
static void what_is_not_permitted_as_a_whole_is_in_part(void)
{
    const verdict_t verdict = judged();
    const float loads = (float)(file.n - PUSHES), whole = (float)verdict.whole;
    TEST_ASSERT_TRUE(whole < 0.9F * loads);
    TEST_ASSERT_TRUE(verdict.share > whole + 0.15F * (loads - whole));
    printf("of %u loads %u are permitted as a whole, of the others %.0f %%\n", (unsigned)(file.n - PUSHES),
           (unsigned)verdict.whole, (double)(100.0F * (verdict.share - whole) / (loads - whole)));
}

static void as_much_as_is_admissible_is_applied_at_once(void)
{
    trial_t t = trial(0);
    aminn_output_t out;
    memset(t.before.w_e, 0, sizeof t.before.w_e);
    t.before.w_e[2] = -0.1F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_step(&limiter, &t.before));
    TEST_ASSERT_EQUAL_FLOAT(-0.1F, t.before.w_e[2]);
    t.before.w_e[2] = -100.0F; /* no grasp bears that */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, limiter_step(&limiter, &t.before));
    TEST_ASSERT_TRUE(t.before.w_e[2] < -0.2F && t.before.w_e[2] > -20.0F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&limiter.aminn, &t.before, &out));
    TEST_ASSERT_TRUE(out.stable == 1 && out.notes == 0 && -out.dx_ht[2] <= 1e-3F);
    t.before.contacts[0][0] = t.before.contacts[1][0] = t.before.contacts[2][0] = 0.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NO_CONTACT, limiter_step(&limiter, &t.before));
    TEST_ASSERT_EQUAL_FLOAT(0.0F, t.before.w_e[2]);
}

static void nothing_is_learned_from_a_bad_push(void)
{
    const trial_t t = trial(0);
    float dx[AMINN_N_WRENCH] = {NAN, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F};
    const verdict_t none = {0};
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, limiter_learn(&limiter, &t.before, dx));
    TEST_ASSERT_EQUAL_UINT32(0, limiter.calibrator.pushes);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, mean_error(&none));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(ten_pushes_make_it_better);
    RUN_TEST(what_is_not_permitted_as_a_whole_is_in_part);
    RUN_TEST(as_much_as_is_admissible_is_applied_at_once);
    RUN_TEST(nothing_is_learned_from_a_bad_push);
    return UNITY_END();
}
