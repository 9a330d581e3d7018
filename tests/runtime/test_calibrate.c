/* calibrate.cpp, theta_name.cpp: theta makes the tables that it should, contexts use them, nominal is as without one */
#include "aminn_model.h"
#include "byte_model.h"
#include "half_model.h"
#include "support.h"
#include "tiny_model.h"

enum { FIRST_ZERO = AMINN_N_FACTOR, RADIUS = AMINN_N_THETA - 1 };

static aminn_t ctx;
static aminn_model_t model;
static aminn_calibration_t cal;
static float theta[AMINN_N_THETA];

void setUp(void)
{
    int i;
    model = aminn_model;
    for (i = 0; i < AMINN_N_THETA; ++i) {
        theta[i] = i < FIRST_ZERO ? 0.25F * (float)(i % 7 - 3) : i < RADIUS ? 0.01F * (float)(i % 5 - 2) : 0.001F;
    }
    scribble(&cal, sizeof cal);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
}

void tearDown(void)
{
}

#define SET(values) TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibration_set(&cal, &model, values))
#define USE(calibration) TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate(&ctx, calibration))

static aminn_output_t predicted(const aminn_input_t *in)
{
    aminn_output_t out;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, in, &out));
    return out;
}

static void nominal_is_as_without_a_calibration(void)
{
    static const aminn_model_t *const models[] = {&aminn_model, &half_model, &byte_model, &tiny_model};
    static const float zeros[AMINN_N_THETA];
    const aminn_input_t in = good_input();
    size_t k;
    int how, i;
    for (k = 0; k < sizeof models / sizeof models[0]; ++k) {
        for (how = 0; how < 2; ++how) {
            aminn_output_t without, with;
            model = *models[k];
            TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
            without = predicted(&in);
            SET(how == 0 ? NULL : zeros);
            TEST_ASSERT_EQUAL_MEMORY(zeros, cal.theta, sizeof zeros);
            TEST_ASSERT_EQUAL_MEMORY(model.nominal.chol, cal.chol, sizeof cal.chol);
            TEST_ASSERT_EQUAL_MEMORY(model.nominal.tendon_gain, cal.tendon_gain, sizeof cal.tendon_gain);
            for (i = 0; i < AMINN_N_STAGE; ++i) {
                TEST_ASSERT_EQUAL_MEMORY(model.nominal.eps_m[i], cal.eps_m[i], sizeof cal.eps_m[i]);
            }
            USE(&cal);
            with = predicted(&in);
            assert_same_output(&without, &with);
        }
    }
}

/* entry of L L^T of a packed factor, in double */
static double spring(const float *chol, int row, int column)
{
    double lower[AMINN_N_COORD][AMINN_N_COORD] = {{0}}, sum = 0.0;
    int r, c, at = AMINN_N_COORD;
    for (r = 0; r < AMINN_N_COORD; ++r) {
        lower[r][r] = (double)chol[r];
        for (c = 0; c < r; ++c) {
            lower[r][c] = (double)chol[at++];
        }
    }
    for (c = 0; c < AMINN_N_COORD; ++c) {
        sum += lower[row][c] * lower[column][c];
    }
    return sum;
}

static void springs_and_gains_are_nominal_and_what_theta_adds(void)
{
    double worst = 0.0;
    int b, p, r, c;
    SET(theta);
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        int at = AMINN_N_COORD;
        for (r = 0; r < AMINN_N_COORD; ++r) {
            for (c = 0; c <= r; ++c) {
                const int entry = c == r ? r : at++;
                double want = 0.0;
                for (p = 0; p <= AMINN_N_STIFF; ++p) {
                    const double factor = p == 0 ? 1.0 : exp((double)theta[p - 1]);
                    want += factor * (double)model.theta_terms[(p * AMINN_N_BRANCH + b) * AMINN_N_TERM + entry];
                }
                worst = fmax(worst, fabs(spring(cal.chol[b], r, c) - want) / (0.1 + fabs(want)));
            }
        }
        {
            double want = 0.0;
            for (p = 0; p < AMINN_N_STIFF; ++p) {
                want += exp((double)theta[p]) *
                        (double)model.theta_terms[((p + 1) * AMINN_N_BRANCH + b) * AMINN_N_TERM + AMINN_N_CHOLESKY];
            }
            TEST_ASSERT_FLOAT_WITHIN(1e-6F * (float)want, (float)want, cal.tendon_gain[b]);
            TEST_ASSERT_TRUE(cal.tendon_gain[b] != model.nominal.tendon_gain[b]);
        }
    }
    printf("springs: %.2g of their size from what they should be\n", worst);
    TEST_ASSERT_TRUE(worst < 1e-6);
}

static void a_softer_contact_is_so_in_both_stages(void)
{
    int b, i;
    SET(theta);
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        for (i = 0; i < AMINN_N_STAGE; ++i) {
            const float want = model.nominal.eps_m[i][b] * expf(theta[AMINN_N_STIFF + b]);
            TEST_ASSERT_FLOAT_WITHIN(1e-6F * want, want, cal.eps_m[i][b]);
        }
    }
}

/* a stiff hand moves less, and nothing but the layer's tables changes */
static void a_stiffer_hand_moves_less(void)
{
    const aminn_input_t in = good_input();
    const aminn_output_t nominal = predicted(&in);
    aminn_output_t out;
    float before = 0.0F, after = 0.0F;
    int i;
    for (i = 0; i < AMINN_N_THETA; ++i) {
        theta[i] = i < AMINN_N_STIFF ? 0.5F : i < FIRST_ZERO ? -0.5F : 0.0F;
    }
    SET(theta);
    USE(&cal);
    out = predicted(&in);
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        before += in.w_e[i] * nominal.dx_ht[i];
        after += in.w_e[i] * out.dx_ht[i];
    }
    TEST_ASSERT_TRUE(after > 0.4F * before && after < 0.8F * before);
    USE(NULL);
    out = predicted(&in);
    assert_same_output(&nominal, &out);
}

/* what a calibration is set to later counts at once */
static void a_calibration_is_used_by_reference(void)
{
    const aminn_input_t in = good_input();
    aminn_output_t first, second;
    SET(NULL);
    USE(&cal);
    first = predicted(&in);
    SET(theta);
    second = predicted(&in);
    TEST_ASSERT_TRUE(memcmp(&first, &second, sizeof first) != 0);
    SET(NULL);
    second = predicted(&in);
    assert_same_output(&first, &second);
}

static void measured_states_are_corrected(void)
{
    const aminn_input_t in = good_input();
    const aminn_state_t measured = state_of(&in);
    aminn_state_t truth = measured;
    aminn_input_t corrected;
    aminn_output_t by_state, by_input;
    int i, b, k;
    SET(theta);
    USE(&cal);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_correct(&cal, &truth));
    for (i = 0; i < AMINN_N_JOINT; ++i) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6F, measured.q[i] + theta[FIRST_ZERO + i], truth.q[i]);
    }
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        for (k = 0; k < AMINN_N_CONTACT_FEATURE; ++k) {
            const float moved = k >= 1 && k <= 3 ? theta[RADIUS] * measured.contacts[b][k + 3] : 0.0F;
            TEST_ASSERT_FLOAT_WITHIN(1e-7F, measured.contacts[b][k] + moved, truth.contacts[b][k]);
        }
    }
    TEST_ASSERT_EQUAL_MEMORY(measured.x_ht, truth.x_ht, sizeof truth.x_ht);
    TEST_ASSERT_EQUAL_MEMORY(measured.w_e, truth.w_e, sizeof truth.w_e);
    memcpy(&corrected, &truth, sizeof truth);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_closure(&model, truth.q, truth.x_ht,
                                                  (const float (*)[AMINN_N_CONTACT_FEATURE])truth.contacts,
                                                  corrected.j_x, corrected.j_q));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &measured, &by_state));
    by_input = predicted(&corrected);
    assert_same_output(&by_state, &by_input);
}

/* A model that is told factors: aminn_model without what it sees of sensors, which are none here; its networks see in
 * addition what the last argument weighs. */
static struct {
    float mean[AMINN_N_STAGE][AMINN_N_TOLD_INPUT], inv_std[AMINN_N_STAGE][AMINN_N_TOLD_INPUT], zeros[AMINN_N_FACTOR];
    float trunk1_w[AMINN_N_STAGE][(64 + AMINN_N_TOLD_INPUT) * 64];
} told;

static void tell(float weight)
{
    const uint32_t rows = model.contact_width + AMINN_N_GLOBAL_INPUT;
    uint32_t k, i;
    TEST_ASSERT_TRUE(model.contact_width <= 64 && model.width[0] <= 64 && model.width[1] <= 64 &&
                     model.weight_type == AMINN_WEIGHTS_FLOAT32);
    for (k = 0; k < AMINN_N_STAGE; ++k) {
        aminn_stage_model_t *stage = &model.stage[k];
        const uint32_t h = model.width[k];
        memcpy(told.mean[k], stage->global_mean, AMINN_N_GLOBAL_INPUT * sizeof(float));
        memcpy(told.inv_std[k], stage->global_inv_std, AMINN_N_GLOBAL_INPUT * sizeof(float));
        for (i = AMINN_N_GLOBAL_INPUT; i < AMINN_N_TOLD_INPUT; ++i) {
            told.mean[k][i] = 0.0F;
            told.inv_std[k][i] = 2.0F;
        }
        memcpy(told.trunk1_w[k], stage->trunk1_w, (size_t)rows * h * sizeof(float));
        for (i = 0; i < AMINN_N_FACTOR * h; ++i) {
            told.trunk1_w[k][rows * h + i] = i % 3 == 0 ? weight : 0.0F;
        }
        stage->trunk1_w = told.trunk1_w[k];
        stage->global_mean = told.mean[k];
        stage->global_inv_std = told.inv_std[k];
    }
    model.n_told = AMINN_N_FACTOR;
    model.n_sensed = 0;
    model.nominal.told = told.zeros;
}

static void networks_of_a_told_model_see_the_factors(void)
{
    const aminn_input_t in = good_input();
    aminn_output_t untold, calibrated, out;
    int i;
    model.n_sensed = 0; /* the rows for sensors are the last ones */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
    untold = predicted(&in);
    for (i = FIRST_ZERO; i < AMINN_N_THETA; ++i) {
        theta[i] = 0.0F;
    }
    SET(theta);
    USE(&cal);
    calibrated = predicted(&in);
    tell(0.0F); /* in vain */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
    out = predicted(&in);
    assert_same_output(&untold, &out);
    USE(&cal);
    out = predicted(&in);
    assert_same_output(&calibrated, &out);
    model = aminn_model;
    tell(0.5F);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
    out = predicted(&in); /* of zeros */
    assert_same_output(&untold, &out);
    USE(&cal);
    out = predicted(&in);
    TEST_ASSERT_TRUE(out.p_stable != calibrated.p_stable && out.dx_ht[0] != calibrated.dx_ht[0]);
    model.nominal.told = NULL;
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_model_check(&model));
}

static void what_is_wrong_with_theta_is_said(void)
{
    static const struct {
        int at;
        float value;
        aminn_status_t status;
    } wrong[] = {{0, NAN, AMINN_E_NONFINITE},
                 {RADIUS, INFINITY, AMINN_E_NONFINITE},
                 {0, 3.01F, AMINN_E_CALIBRATION},
                 {FIRST_ZERO - 1, -3.01F, AMINN_E_CALIBRATION},
                 {FIRST_ZERO, 1.01F, AMINN_E_CALIBRATION},
                 {RADIUS - 1, -1.01F, AMINN_E_CALIBRATION},
                 {RADIUS, 0.051F, AMINN_E_CALIBRATION},
                 {RADIUS, -0.051F, AMINN_E_CALIBRATION}};
    aminn_calibration_t kept;
    size_t i;
    int k;
    SET(theta);
    memcpy(&kept, &cal, sizeof cal);
    for (i = 0; i < sizeof wrong / sizeof wrong[0]; ++i) {
        const float before = theta[wrong[i].at];
        theta[wrong[i].at] = wrong[i].value;
        TEST_ASSERT_EQUAL_INT(wrong[i].status, aminn_calibration_set(&cal, &model, theta));
        TEST_ASSERT_EQUAL_MEMORY(&kept, &cal, sizeof cal);
        theta[wrong[i].at] = before;
    }
    for (k = 0; k < AMINN_N_THETA; ++k) { /* the bounds themselves are within, either way */
        theta[k] = k < FIRST_ZERO ? AMINN_MAX_LOG_FACTOR : k < RADIUS ? AMINN_MAX_ZERO : AMINN_MAX_RADIUS;
    }
    SET(theta);
    for (k = 0; k < AMINN_N_THETA; ++k) {
        theta[k] = -theta[k];
    }
    SET(theta);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_calibration_set(NULL, &model, theta));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_calibration_set(&cal, NULL, theta));
}

/* tables that are not of one hand: what theta takes away is more than there is */
static void springs_that_do_not_hold_are_refused(void)
{
    static float terms[(1 + AMINN_N_STIFF) * AMINN_N_BRANCH * AMINN_N_TERM];
    const size_t row = (size_t)AMINN_N_BRANCH * AMINN_N_TERM;
    memcpy(terms, model.theta_terms, sizeof terms);
    model.theta_terms = terms;
    theta[1] = -1.0F;
    terms[2 * row + 1] = 100.0F; /* the second joint of the first branch, by the second stiffness */
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_calibration_set(&cal, &model, theta));
    memcpy(terms, aminn_model.theta_terms, sizeof terms);
    terms[2 * row + AMINN_N_CHOLESKY] = 100.0F; /* its gain */
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_calibration_set(&cal, &model, theta));
}

static void a_calibration_of_another_model_is_refused(void)
{
    const aminn_input_t in = good_input();
    aminn_output_t before, after;
    SET(theta);
    USE(&cal);
    before = predicted(&in);
    {
        aminn_calibration_t other;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibration_set(&other, &tiny_model, NULL));
        TEST_ASSERT_EQUAL_INT(AMINN_E_CALIBRATION, aminn_calibrate(&ctx, &other));
        other = cal; /* moved: it points to where it was */
        TEST_ASSERT_EQUAL_INT(AMINN_E_CALIBRATION, aminn_calibrate(&ctx, &other));
        memset(&other, 0, sizeof other); /* never set */
        TEST_ASSERT_EQUAL_INT(AMINN_E_CALIBRATION, aminn_calibrate(&ctx, &other));
    }
    after = predicted(&in);
    assert_same_output(&before, &after);
}

static void null_arguments_are_refused(void)
{
    aminn_state_t state;
    SET(theta);
    memset(&state, 0, sizeof state);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_calibrate(NULL, &cal));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_correct(NULL, &state));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_correct(&cal, NULL));
    memset(&ctx, 0, sizeof ctx);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_calibrate(&ctx, &cal));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_calibrate(&ctx, NULL));
}

/* a predictor that was tested is one that was not, and the test is of the nominal hand */
static void the_self_test_leaves_a_calibration_in_use(void)
{
    const aminn_input_t in = good_input();
    const aminn_state_t state = state_of(&in);
    aminn_output_t before, after;
    SET(theta);
    USE(&cal);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &state, &before));
    TEST_ASSERT_EQUAL_STRING("AMINN_OK", aminn_status_name(aminn_self_test(&ctx)));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &state, &after));
    assert_same_output(&before, &after);
}

static void numbers_of_theta_have_names(void)
{
    int i, j;
    TEST_ASSERT_EQUAL_STRING("spring_finger1_roll", aminn_theta_name(0));
    TEST_ASSERT_EQUAL_STRING("contact_finger1", aminn_theta_name(AMINN_N_STIFF));
    TEST_ASSERT_EQUAL_STRING("zero_finger1_roll", aminn_theta_name(FIRST_ZERO));
    TEST_ASSERT_EQUAL_STRING("radius_tips", aminn_theta_name(RADIUS));
    TEST_ASSERT_EQUAL_STRING("none", aminn_theta_name(-1));
    TEST_ASSERT_EQUAL_STRING("none", aminn_theta_name(AMINN_N_THETA));
    for (i = 0; i < AMINN_N_THETA; ++i) {
        for (j = 0; j < i; ++j) {
            TEST_ASSERT_NOT_EQUAL(0, strcmp(aminn_theta_name(i), aminn_theta_name(j)));
        }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(nominal_is_as_without_a_calibration);
    RUN_TEST(springs_and_gains_are_nominal_and_what_theta_adds);
    RUN_TEST(a_softer_contact_is_so_in_both_stages);
    RUN_TEST(a_stiffer_hand_moves_less);
    RUN_TEST(a_calibration_is_used_by_reference);
    RUN_TEST(measured_states_are_corrected);
    RUN_TEST(networks_of_a_told_model_see_the_factors);
    RUN_TEST(what_is_wrong_with_theta_is_said);
    RUN_TEST(springs_that_do_not_hold_are_refused);
    RUN_TEST(a_calibration_of_another_model_is_refused);
    RUN_TEST(null_arguments_are_refused);
    RUN_TEST(the_self_test_leaves_a_calibration_in_use);
    RUN_TEST(numbers_of_theta_have_names);
    return UNITY_END();
}
