/* predict.cpp: context, the two predict functions, the cascade, the debug view */
#include "aminn_model.h"
#include "byte_model.h"
#include "support.h"

static aminn_t ctx;
static aminn_input_t in;
static aminn_output_t out;

void setUp(void)
{
    in = good_input();
    scribble(&out, sizeof out);
    scribble(&ctx, sizeof ctx);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, 0));
}

void tearDown(void)
{
}

/* a copy of the model that calls every grasp stable, or none */
static aminn_model_t model_with_tau(float tau)
{
    aminn_model_t model = aminn_model;
    model.tau = tau;
    return model;
}

static void init_refuses_bad_arguments(void)
{
    aminn_model_t model = aminn_model;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_init(NULL, &aminn_model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_init(&ctx, NULL, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_INT(AMINN_E_FLAGS, aminn_init(&ctx, &aminn_model, 4));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_predict(&ctx, &in, &out));
    model.format_version = 99;
    TEST_ASSERT_EQUAL_INT(AMINN_E_VERSION, aminn_init(&ctx, &model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_predict(&ctx, &in, &out));
    model = aminn_model;
    model.width[1] = AMINN_MAX_WIDTH + 1;
    TEST_ASSERT_EQUAL_INT(AMINN_E_DIMS, aminn_init(&ctx, &model, 0));
    model = aminn_model;
    model.cls2_b = NULL;
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_init(&ctx, &model, 0));
}

static void init_finds_a_context_of_another_size(void)
{
    aminn_t before;
    memcpy(&before, &ctx, sizeof ctx);
    TEST_ASSERT_EQUAL_INT(AMINN_E_CONTEXT_SIZE, aminn_init_sized(&ctx, sizeof ctx - 12, &aminn_model, 0));
    TEST_ASSERT_EQUAL_MEMORY(&before, &ctx, sizeof ctx);
}

static void a_context_must_be_initialised(void)
{
    static aminn_t zero;
    const aminn_state_t state = state_of(&in);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_predict(&zero, &in, &out));
    assert_failed_output(&out);
    scribble(&out, sizeof out);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_predict_state(&zero, &state, &out));
    assert_failed_output(&out);
    TEST_ASSERT_NULL(aminn_debug(&zero, 0));
}

static void null_arguments_are_refused(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict(NULL, &in, &out));
    assert_failed_output(&out);
    scribble(&out, sizeof out);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict(&ctx, NULL, &out));
    assert_failed_output(&out);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict(&ctx, &in, NULL));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_state(NULL, NULL, &out));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_state(&ctx, NULL, &out));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_state(&ctx, NULL, NULL));
    TEST_ASSERT_NULL(aminn_debug(NULL, 0));
}

static void stage_2_is_skipped_when_the_grasp_does_not_hold(void)
{
    const aminn_model_t never = model_with_tau(1.0F);
    int i;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &never, AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_INT32(0, out.stable);
    TEST_ASSERT_TRUE(out.p_stable > 0.0F && out.p_stable < 1.0F);
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        TEST_ASSERT_FLOAT_IS_NAN(out.dx_ht[i]);
    }
    TEST_ASSERT_FLOAT_IS_NAN(out.k_x[5][5]);
    TEST_ASSERT_FLOAT_IS_NAN(out.gate[2]);
    TEST_ASSERT_FLOAT_IS_NAN(out.p_slide);
    TEST_ASSERT_FLOAT_IS_NAN(out.bound_95);
    TEST_ASSERT_TRUE(out.friction_use[2] >= 0.0F && out.friction_use[2] <= 100.0F); /* stage 1's */
    TEST_ASSERT_TRUE((out.friction_use[2] > 0.0F) == (AMINN_N_SLIDE != 0));
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_NULL(aminn_debug(&ctx, 1));
}

static void a_flag_runs_stage_2_always(void)
{
    const aminn_model_t never = model_with_tau(1.0F), always = model_with_tau(0.0F);
    aminn_output_t held;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &always, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &held));
    TEST_ASSERT_EQUAL_INT32(1, held.stable);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &never, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_INT32(0, out.stable);
    out.stable = 1;
    assert_same_output(&held, &out);
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 1));
}

/* The bound has the factor of the bin that p_slide lies in: an edge belongs to the bin above it. */
static void the_bound_follows_the_bin_of_p_slide(void)
{
    static const float at[] = {-2.0F, -0.2F, 0.0F, 0.2F, 2.0F}; /* logits */
    static const int bin[] = {0, 1, 2, 2, 3};
    static const float edge[] = {0.2F, 0.5F, 0.8F};
    static const float none[2 * (64 + AMINN_N_SURE)];
    aminn_model_t model = model_with_tau(0.0F);
    float bias[2] = {0.0F, 0.0F};
    size_t i;
    TEST_ASSERT_TRUE(model.width[1] <= 64);
    model.sure_w = none;
    model.sure_b = bias;
    memcpy(model.bound_edge, edge, sizeof edge);
    for (i = 0; i < 4; ++i) {
        model.bound_factor[i] = 1.0F + (float)i;
    }
    for (i = 0; i < sizeof at / sizeof *at; ++i) {
        bias[0] = at[i];
        bias[1] = -7.0F;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, 0));
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
        TEST_ASSERT_FLOAT_WITHIN(1e-6F, 1.0F / (1.0F + expf(-at[i])), out.p_slide);
        TEST_ASSERT_FLOAT_WITHIN(1e-9F, expf(-7.0F) * (float)(1 + bin[i]), out.bound_95);
    }
}

static void a_bound_beyond_all_measure_is_still_a_number(void)
{
    static const float bias[2] = {0.0F, 90.0F};
    aminn_model_t model = model_with_tau(0.0F);
    model.sure_b = bias;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_TRUE(isfinite(out.bound_95) && out.bound_95 > 1e30F);
}

static void intermediates_are_kept_on_request(void)
{
    const aminn_model_t always = model_with_tau(0.0F);
    aminn_output_t kept;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &always, AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &kept));
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 1));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &always, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_NULL(aminn_debug(&ctx, 1));
    assert_same_output(&kept, &out);
}

static void the_threshold_belongs_to_stable(void)
{
    aminn_model_t exact = aminn_model;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    exact.tau = out.p_stable;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &exact, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_INT32(1, out.stable);
}

static void closure_given_or_computed_gives_the_same(void)
{
    const aminn_state_t state = state_of(&in);
    aminn_output_t computed;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_closure(&aminn_model, in.q, in.x_ht, state.contacts, in.j_x, in.j_q));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &state, &computed));
    assert_same_output(&out, &computed);
}

static void a_prediction_depends_on_its_input_alone(void)
{
    golden_t golden = load_golden(GOLDEN_DIR "/golden.bin");
    static aminn_t other;
    aminn_output_t again;
    uint32_t i;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    for (i = 0; i < 8 && i < golden.n; ++i) {
        aminn_output_t unused;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &golden.inputs[i], &unused));
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &again));
    assert_same_output(&out, &again);
    memcpy(&other, &ctx, sizeof ctx); /* a context may be moved */
    memset(&ctx, 0, sizeof ctx);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&other, &in, &again));
    assert_same_output(&out, &again);
    free_golden(&golden);
}

static void the_model_and_the_input_are_not_written(void)
{
    const aminn_input_t kept = in;
    const aminn_model_t model = aminn_model;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    TEST_ASSERT_EQUAL_MEMORY(&kept, &in, sizeof in);
    TEST_ASSERT_EQUAL_MEMORY(&model, &aminn_model, sizeof model);
}

static void the_debug_view_shows_stage_2s_outputs(void)
{
    const aminn_stage_debug_t *view;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    view = aminn_debug(&ctx, 1);
    TEST_ASSERT_NOT_NULL(view);
    TEST_ASSERT_EQUAL_MEMORY(out.dx_ht, view->dx, sizeof out.dx_ht);
    TEST_ASSERT_EQUAL_MEMORY(out.k_x, view->k_x, sizeof out.k_x);
    TEST_ASSERT_EQUAL_MEMORY(out.gate, view->gate, sizeof out.gate);
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_NULL(aminn_debug(&ctx, 2));
    TEST_ASSERT_NULL(aminn_debug(&ctx, -1));
}

/* 1: both stages' results are numbers, and the load gives its energy to the grasp */
static int stages_are_sound(void)
{
    int stage, i;
    for (stage = 0; stage < AMINN_N_STAGE; ++stage) {
        const aminn_stage_debug_t *view = aminn_debug(&ctx, stage);
        double work = 0.0, size = 0.0;
        for (i = 0; i < AMINN_N_WRENCH; ++i) {
            const double part = (double)in.w_e[i] * (double)view->dx[i];
            work += part;
            size += fabs(part);
        }
        for (i = 0; i < AMINN_N_WRENCH * AMINN_N_WRENCH; ++i) {
            if (!isfinite(view->k_x[i / AMINN_N_WRENCH][i % AMINN_N_WRENCH])) {
                return 0;
            }
        }
        if (!(work >= -1e-6 * size)) {
            return 0;
        }
    }
    return 1;
}

/* with the tool at 1e5 to 1e19 m float32 loses the springs beside the lever arms */
static void a_tool_out_of_reach_gives_an_error_or_a_sound_prediction(void)
{
    int i, refused = 0;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
    for (i = 0; i < 15 * 15 * 12; ++i) {
        aminn_state_t state = state_of(&in);
        const int axis = i / 225 % 3, sign = i / 675 % 2 * 2 - 1;
        state.x_ht[axis] = (float)pow(10.0, 5 + i % 15) * (i / 1350 ? 1.0F : -1.0F);
        state.x_ht[(axis + 1) % 3] = (float)(sign * pow(10.0, 5 + i / 15 % 15));
        if (aminn_predict_state(&ctx, &state, &out) == AMINN_OK) {
            TEST_ASSERT_TRUE(stages_are_sound());
        } else {
            assert_failed_output(&out);
            ++refused;
        }
    }
    TEST_ASSERT_GREATER_THAN_INT(0, refused);
}

/* loads from 1e-45 to 3e38 times the sample's: the square of the motion's size may overflow before the motion does */
static void a_load_of_any_size_gives_an_error_or_a_probability(void)
{
    int i, k, refused = 0;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
    for (i = -45; i <= 38; ++i) {
        aminn_input_t loaded = in;
        for (k = 0; k < AMINN_N_WRENCH; ++k) {
            loaded.w_e[k] = (float)((double)in.w_e[k] * pow(10.0, i));
        }
        if (aminn_predict(&ctx, &loaded, &out) == AMINN_OK) {
            TEST_ASSERT_TRUE(out.p_stable >= 0.0F && out.p_stable <= 1.0F);
            TEST_ASSERT_TRUE(i < 5 || out.p_stable < 0.5F);
        } else {
            TEST_ASSERT_GREATER_THAN_INT(15, i);
            assert_failed_output(&out);
            ++refused;
        }
    }
    TEST_ASSERT_GREATER_THAN_INT(0, refused);
}

static uint32_t random_word(void)
{
    static uint32_t state = 1;
    state = state * 1664525u + 1013904223u;
    return state >> 8;
}

static float random_between(float low, float high)
{
    return low + (high - low) * (float)random_word() / 16777216.0F;
}

/* any weights, and any bias and size of steps of the head: networks of any answer */
static void the_load_gives_its_energy_to_the_grasp_whatever_int8_weights(void)
{
    enum { MODELS = 40, LARGEST = 64 * 64 };
    static int8_t weights[2 * LARGEST];
    static float head[AMINN_N_STAGE][2 * AMINN_N_HEAD_STORED];
    golden_t g = load_golden(GOLDEN_DIR "/byte_golden.bin");
    const uint32_t h = byte_model.width[1], hc = byte_model.contact_width;
    uint32_t s, slid = 0;
    int round, i, k;
    TEST_ASSERT_TRUE(byte_model.width[0] <= h && h * AMINN_N_HEAD_STORED <= LARGEST &&
                     AMINN_N_CONTACT_INPUT * hc <= LARGEST);
    for (round = 0; round < MODELS; ++round) {
        aminn_model_t model = byte_model;
        const float size = powf(10.0F, random_between(-5.0F, 0.0F));
        for (i = 0; i < 2 * LARGEST; ++i) {
            weights[i] = (int8_t)(random_word() % 256);
        }
        for (i = 0; i < AMINN_N_STAGE; ++i) {
            model.stage[i].contact_w = weights + random_word() % LARGEST;
            model.stage[i].trunk1_w = weights + random_word() % LARGEST;
            model.stage[i].trunk2_w = weights + random_word() % LARGEST;
            model.stage[i].head_w = weights + random_word() % LARGEST;
            for (k = 0; k < AMINN_N_HEAD_STORED; ++k) {
                head[i][k] = random_between(-3.0F, 3.0F);
                head[i][AMINN_N_HEAD_STORED + k] = random_between(0.1F, 1.0F) * size;
            }
            model.stage[i].head_b = head[i];
        }
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG));
        for (s = 0; s < g.n; ++s) {
            TEST_ASSERT_EQUAL_INT(AMINN_OK, predict_golden(&ctx, &g, s, &out));
            for (i = 0; i < AMINN_N_STAGE; ++i) {
                const aminn_stage_debug_t *stage = aminn_debug(&ctx, i);
                double work = 0;
                for (k = 0; k < AMINN_N_WRENCH; ++k) {
                    work += (double)g.inputs[s].w_e[k] * (double)stage->dx[k];
                    TEST_ASSERT_TRUE(stage->k_x[k][k] > 0.0F);
                }
                TEST_ASSERT_TRUE(work >= 0.0);
                for (k = 0; k < AMINN_N_BRANCH; ++k) {
                    slid += stage->slide[k] > 0.0F;
                }
            }
        }
    }
    TEST_ASSERT_TRUE(slid > 0);
    free_golden(&g);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(init_refuses_bad_arguments);
    RUN_TEST(init_finds_a_context_of_another_size);
    RUN_TEST(a_context_must_be_initialised);
    RUN_TEST(null_arguments_are_refused);
    RUN_TEST(stage_2_is_skipped_when_the_grasp_does_not_hold);
    RUN_TEST(a_flag_runs_stage_2_always);
    RUN_TEST(the_bound_follows_the_bin_of_p_slide);
    RUN_TEST(a_bound_beyond_all_measure_is_still_a_number);
    RUN_TEST(intermediates_are_kept_on_request);
    RUN_TEST(the_threshold_belongs_to_stable);
    RUN_TEST(closure_given_or_computed_gives_the_same);
    RUN_TEST(a_prediction_depends_on_its_input_alone);
    RUN_TEST(the_model_and_the_input_are_not_written);
    RUN_TEST(the_debug_view_shows_stage_2s_outputs);
    RUN_TEST(a_tool_out_of_reach_gives_an_error_or_a_sound_prediction);
    RUN_TEST(a_load_of_any_size_gives_an_error_or_a_probability);
    RUN_TEST(the_load_gives_its_energy_to_the_grasp_whatever_int8_weights);
    return UNITY_END();
}
