/* closure.cpp: the closure Jacobians from the hand's geometry */
#include "aminn_model.h"
#include "support.h"

typedef struct closure {
    float j_x[AMINN_N_BRANCH][3][AMINN_N_WRENCH];
    float j_q[AMINN_N_BRANCH][3][AMINN_N_COORD];
} closure_t;

static aminn_input_t in;
static closure_t got;

void setUp(void)
{
    in = good_input();
    scribble(&got, sizeof got);
}

void tearDown(void)
{
}

static aminn_status_t compute(const aminn_input_t *input)
{
    return aminn_closure(&aminn_model, input->q, input->x_ht, input->contacts, got.j_x, got.j_q);
}

static void it_agrees_with_the_golden_vectors(void)
{
    golden_t golden = load_golden(GOLDEN_DIR "/golden.bin");
    float worst_x = 0, worst_q = 0;
    uint32_t i;
    size_t k;
    for (i = 0; i < golden.n; ++i) {
        const float *j_x = &golden.inputs[i].j_x[0][0][0], *j_q = &golden.inputs[i].j_q[0][0][0];
        TEST_ASSERT_EQUAL_INT(AMINN_OK, compute(&golden.inputs[i]));
        for (k = 0; k < sizeof got.j_x / sizeof(float); ++k) {
            worst_x = fmaxf(worst_x, fabsf((&got.j_x[0][0][0])[k] - j_x[k]));
        }
        for (k = 0; k < sizeof got.j_q / sizeof(float); ++k) {
            worst_q = fmaxf(worst_q, fabsf((&got.j_q[0][0][0])[k] - j_q[k]));
        }
    }
    printf("closure against golden: j_x %.3g, j_q %.3g m (largest difference, %u samples)\n", (double)worst_x,
           (double)worst_q, (unsigned)golden.n);
    free_golden(&golden);
    TEST_ASSERT_TRUE(worst_x < 1e-6F);
    TEST_ASSERT_TRUE(worst_q < 1e-6F);
}

static void the_tool_side_moves_the_contact_with_the_tool(void)
{
    /* a turn about z through the tool's origin moves a contact at r by z x r */
    int b;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, compute(&in));
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        const float rx = in.contacts[b][1] - in.x_ht[0], ry = in.contacts[b][2] - in.x_ht[1];
        TEST_ASSERT_EQUAL_FLOAT(1.0F, got.j_x[b][0][0]);
        TEST_ASSERT_EQUAL_FLOAT(-ry, got.j_x[b][0][5]);
        TEST_ASSERT_EQUAL_FLOAT(rx, got.j_x[b][1][5]);
        TEST_ASSERT_EQUAL_FLOAT(0.0F, got.j_x[b][2][5]);
    }
}

static void a_branch_out_of_contact_has_zero_blocks(void)
{
    int i, k;
    in.contacts[1][0] = 0.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, compute(&in));
    for (i = 0; i < 3; ++i) {
        for (k = 0; k < AMINN_N_WRENCH; ++k) {
            TEST_ASSERT_EQUAL_FLOAT(0.0F, got.j_x[1][i][k]);
        }
        for (k = 0; k < AMINN_N_COORD; ++k) {
            TEST_ASSERT_EQUAL_FLOAT(0.0F, got.j_q[1][i][k]);
        }
        TEST_ASSERT_EQUAL_FLOAT(0.0F, got.j_q[2][i][0]); /* the thumb has no roll */
    }
    TEST_ASSERT_EQUAL_FLOAT(1.0F, got.j_x[0][0][0]);
}

static void assert_all_nan(const float *values, size_t n)
{
    while (n-- > 0) {
        TEST_ASSERT_FLOAT_IS_NAN(values[n]);
    }
}

static void errors_leave_nan(void)
{
    float *x = &got.j_x[0][0][0], *q = &got.j_q[0][0][0];
    const size_t nx = sizeof got.j_x / sizeof(float), nq = sizeof got.j_q / sizeof(float);
    in.q[3] = NAN;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, compute(&in));
    assert_all_nan(x, nx);
    assert_all_nan(q, nq);
    in = good_input();
    in.contacts[2][1] = INFINITY;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, compute(&in));
    in = good_input();
    in.x_ht[0] = NAN;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, compute(&in));
    in = good_input();
    scribble(&got, sizeof got);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_closure(NULL, in.q, in.x_ht, in.contacts, got.j_x, got.j_q));
    assert_all_nan(x, nx);
    assert_all_nan(q, nq);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_closure(&aminn_model, NULL, in.x_ht, in.contacts, got.j_x, got.j_q));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_closure(&aminn_model, in.q, NULL, in.contacts, got.j_x, got.j_q));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_closure(&aminn_model, in.q, in.x_ht, NULL, got.j_x, got.j_q));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_closure(&aminn_model, in.q, in.x_ht, in.contacts, NULL, got.j_q));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_closure(&aminn_model, in.q, in.x_ht, in.contacts, got.j_x, NULL));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(it_agrees_with_the_golden_vectors);
    RUN_TEST(the_tool_side_moves_the_contact_with_the_tool);
    RUN_TEST(a_branch_out_of_contact_has_zero_blocks);
    RUN_TEST(errors_leave_nan);
    return UNITY_END();
}
