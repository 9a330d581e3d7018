/* mechanics.hpp and springs.hpp, seen through the debug view: what statics demands of every prediction */
#include "aminn_model.h"
#include "support.h"

static aminn_t ctx;
static aminn_output_t out;
static golden_t golden;

void setUp(void)
{
    golden = load_golden(GOLDEN_DIR "/golden.bin");
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
}

void tearDown(void)
{
    free_golden(&golden);
}

/* smallest pivot of a Cholesky factorisation over the largest diagonal element, in double; <= 0: not SPD */
static double smallest_pivot(const float *k, int n)
{
    double l[6][6] = {{0}}, smallest = 1e300, largest = 0;
    int i, j, m;
    for (i = 0; i < n; ++i) {
        for (j = 0; j <= i; ++j) {
            double s = (double)k[i * n + j];
            for (m = 0; m < j; ++m) {
                s -= l[i][m] * l[j][m];
            }
            if (i == j) {
                smallest = fmin(smallest, s);
                largest = fmax(largest, (double)k[i * n + i]);
                l[i][i] = sqrt(fmax(s, 1e-300));
            } else {
                l[i][j] = s / l[j][j];
            }
        }
    }
    return smallest / largest;
}

/* for every golden sample and both stages */
static void for_each_stage(void (*check)(const aminn_input_t *in, const aminn_stage_debug_t *stage))
{
    uint32_t i;
    int k;
    for (i = 0; i < golden.n; ++i) {
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &golden.inputs[i], &out));
        for (k = 0; k < AMINN_N_STAGE; ++k) {
            check(&golden.inputs[i], aminn_debug(&ctx, k));
        }
    }
}

static void check_springs(const aminn_input_t *in, const aminn_stage_debug_t *stage)
{
    int b, i;
    (void)in;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        float length = 0;
        TEST_ASSERT_TRUE(smallest_pivot(&stage->k_spring[b][0][0], 3) > 0);
        TEST_ASSERT_TRUE(stage->tendon_gain[b] > 0);
        TEST_ASSERT_TRUE(stage->gate_params[b][0] > 0);
        TEST_ASSERT_TRUE(stage->gate[b] >= 0 && stage->gate[b] <= 1);
        for (i = 0; i < AMINN_N_COORD; ++i) {
            length += stage->tendon_dir[b][i] * stage->tendon_dir[b][i];
        }
        TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.0F, length);
    }
    TEST_ASSERT_EQUAL_FLOAT(0.0F, stage->tendon_dir[2][0]); /* the thumb has no roll */
    TEST_ASSERT_EQUAL_FLOAT(0.0F, stage->dq0[2][0]);
}

static void springs_are_spd_and_directions_unit(void)
{
    for_each_stage(check_springs);
}

static void check_stiffness(const aminn_input_t *in, const aminn_stage_debug_t *stage)
{
    double work = 0, size = 0;
    int i, j;
    for (i = 0; i < 6; ++i) {
        for (j = 0; j < 6; ++j) {
            TEST_ASSERT_EQUAL_FLOAT(stage->k_x[j][i], stage->k_x[i][j]);
        }
        work += (double)in->w_e[i] * (double)stage->dx[i];
        size += (double)in->w_e[i] * (double)in->w_e[i];
    }
    TEST_ASSERT_TRUE(size == 0 || work > 0);
}

static void stiffness_is_symmetric_and_work_positive(void)
{
    for_each_stage(check_stiffness);
}

/* residual of K_x dx = share w, relative to the sizes of the terms; share: 1, or what the limits of motion leave of it */
static double worst_residual;
static int cut;

static double size_of(const float v[3])
{
    return sqrt((double)v[0] * (double)v[0] + (double)v[1] * (double)v[1] + (double)v[2] * (double)v[2]);
}

static double share_of(const aminn_input_t *in, const aminn_stage_debug_t *stage)
{
    const double most = fmax(size_of(stage->dx) / (double)aminn_model.max_translation,
                             size_of(stage->dx + 3) / (double)aminn_model.max_rotation);
    double borne = 0, load = 0;
    int i, j;
    TEST_ASSERT_TRUE(!AMINN_N_SLIDE || most < 1 + 1e-6);
    if (!AMINN_N_SLIDE || most < 1 - 1e-6) {
        return 1;
    }
    for (i = 0; i < 6; ++i) {
        for (j = 0; j < 6; ++j) {
            borne += (double)in->w_e[i] * (double)stage->k_x[i][j] * (double)stage->dx[j];
        }
        load += (double)in->w_e[i] * (double)in->w_e[i];
    }
    TEST_ASSERT_TRUE(borne <= load * (1 + 1e-5));
    ++cut;
    return borne / load;
}

static void check_equilibrium(const aminn_input_t *in, const aminn_stage_debug_t *stage)
{
    const double share = share_of(in, stage);
    int i, j;
    for (i = 0; i < 6; ++i) {
        double sum = -share * (double)in->w_e[i], size = fabs(sum) + 1e-12;
        for (j = 0; j < 6; ++j) {
            const double term = (double)stage->k_x[i][j] * (double)stage->dx[j];
            sum += term;
            size += fabs(term);
        }
        worst_residual = fmax(worst_residual, fabs(sum) / size);
    }
}

static void stiffness_times_displacement_is_the_load(void)
{
    worst_residual = cut = 0;
    for_each_stage(check_equilibrium);
    printf("K_x dx - w over its terms: %.3g (largest), %d motions were cut\n", worst_residual, cut);
    TEST_ASSERT_TRUE(worst_residual < (AMINN_N_SLIDE ? 3e-5 : 5e-6)); /* slides round in both, each in its own way */
}

static void no_load_moves_nothing(void)
{
    aminn_input_t in = golden.inputs[0];
    int i;
    memset(in.w_e, 0, sizeof in.w_e);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    for (i = 0; i < 6; ++i) {
        TEST_ASSERT_EQUAL_FLOAT(0.0F, out.dx_ht[i]);
    }
}

/* a branch out of contact drops out exactly: its Jacobians and its row do not matter */
static void a_lost_branch_leaves_the_sum_exactly(void)
{
    aminn_input_t in = good_input();
    aminn_output_t bare;
    int i;
    in.contacts[1][0] = 0.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    memset(in.contacts[1], 0, sizeof in.contacts[1]);
    memset(in.j_x[1], 0, sizeof in.j_x[1]);
    memset(in.j_q[1], 0, sizeof in.j_q[1]);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &bare));
    TEST_ASSERT_EQUAL_MEMORY(out.dx_ht, bare.dx_ht, sizeof out.dx_ht);
    TEST_ASSERT_EQUAL_MEMORY(out.k_x, bare.k_x, sizeof out.k_x);
    for (i = 0; i < AMINN_N_COORD; ++i) {
        TEST_ASSERT_EQUAL_FLOAT(0.0F, aminn_debug(&ctx, 0)->dq0[1][i]);
    }
}

/* and smoothly: a flag close to 0 gives nearly the same, with no jump */
static void a_branch_fades_out_smoothly(void)
{
    aminn_input_t in = good_input();
    aminn_output_t gone;
    double change = 0, size = 0;
    int i;
    in.contacts[1][0] = 0.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &gone));
    in.contacts[1][0] = 1e-6F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    for (i = 0; i < 6; ++i) {
        const double scale = i < 3 ? 1.0 : 0.1;
        change += pow(scale * ((double)out.dx_ht[i] - (double)gone.dx_ht[i]), 2);
        size += pow(scale * (double)gone.dx_ht[i], 2);
    }
    TEST_ASSERT_TRUE(sqrt(change) < 0.01 * sqrt(size));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(springs_are_spd_and_directions_unit);
    RUN_TEST(stiffness_is_symmetric_and_work_positive);
    RUN_TEST(stiffness_times_displacement_is_the_load);
    RUN_TEST(no_load_moves_nothing);
    RUN_TEST(a_lost_branch_leaves_the_sum_exactly);
    RUN_TEST(a_branch_fades_out_smoothly);
    return UNITY_END();
}
