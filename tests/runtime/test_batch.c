#define _GNU_SOURCE /* cpu_set_t */
/* host/batch.cpp: rows on several threads have the bits of single predictions, with sensors, theta and errors of their own */
#include "aminn_batch.h"
#include "aminn_model.h"
#include "support.h"

#include <pthread.h>
#include <sched.h>
#include <unistd.h>

enum { ROWS = 700, STEP = sizeof(aminn_state_t) / sizeof(float), INPUT = sizeof(aminn_input_t) / sizeof(float) };
enum { SENSORS = sizeof(aminn_sensors_t) / sizeof(float), GRASPS = 40 };

static const unsigned few_and_many[] = {1, 2, 3, 9, 0};
enum { KINDS = sizeof few_and_many / sizeof *few_and_many };

static golden_t golden;
static aminn_t ctx;
static aminn_state_t states[ROWS];
static aminn_input_t inputs[ROWS];
static aminn_sensors_t sensors[ROWS];
static float theta[ROWS][AMINN_N_THETA];
static aminn_output_t wanted[ROWS], found[ROWS];
static aminn_status_t expected[ROWS], statuses[ROWS];
static aminn_calibration_t calibration;
static int threads_started, threads_refused, affinity_unknown;
static long online;

/* The linker puts these in place of the system's. */
int __real_pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*start)(void *), void *argument);
int __wrap_pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*start)(void *), void *argument);
int __real_sched_getaffinity(pid_t process, size_t size, cpu_set_t *set);
int __wrap_sched_getaffinity(pid_t process, size_t size, cpu_set_t *set);
long __real_sysconf(int name);
long __wrap_sysconf(int name);

int __wrap_pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*start)(void *), void *argument)
{
    if (threads_refused) {
        return 11; /* EAGAIN */
    }
    __atomic_fetch_add(&threads_started, 1, __ATOMIC_RELAXED);
    return __real_pthread_create(thread, attributes, start, argument);
}

int __wrap_sched_getaffinity(pid_t process, size_t size, cpu_set_t *set)
{
    return affinity_unknown ? -1 : __real_sched_getaffinity(process, size, set);
}

long __wrap_sysconf(int name)
{
    return name == _SC_NPROCESSORS_ONLN && affinity_unknown ? online : __real_sysconf(name);
}

void setUp(void)
{
    size_t i;
    golden = load_golden(GOLDEN_DIR "/golden.bin");
    TEST_ASSERT_NOT_NULL(golden.sensors);
    for (i = 0; i < ROWS; ++i) {
        inputs[i] = golden.inputs[i % golden.n];
        states[i] = state_of(&inputs[i]);
        sensors[i] = golden.sensors[(i / 3) % golden.n];
        memset(theta[i], 0, sizeof theta[i]);
        theta[i][(i / 5) % AMINN_N_FACTOR] = 0.1F; /* five rows have the same */
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, 0));
    scribble(found, sizeof found);
    scribble(statuses, sizeof statuses);
    threads_started = threads_refused = affinity_unknown = 0;
}

void tearDown(void)
{
    free_golden(&golden);
}

/* rows first .. first + n - 1 became what is wanted */
static void assert_rows(size_t first, size_t n)
{
    TEST_ASSERT_EQUAL_MEMORY(expected + first, statuses + first, n * sizeof *statuses);
    TEST_ASSERT_EQUAL_MEMORY(wanted + first, found + first, n * sizeof *found);
}

/* with any number of threads; `bad` is the first bad row */
static void assert_batch(const aminn_batch_t *batch, size_t bad)
{
    size_t k, first;
    for (k = 0; k < KINDS; ++k) {
        const aminn_status_t status =
            aminn_predict_batch(&ctx, batch, few_and_many[k], found, NULL, statuses, k % 2 ? NULL : &first);
        TEST_ASSERT_EQUAL_INT(bad == AMINN_NO_ROW ? AMINN_OK : expected[bad], status);
        TEST_ASSERT_TRUE(k % 2 || first == bad);
        assert_rows(batch->begin, batch->n);
    }
}

static void predict_alone(aminn_t *alone)
{
    size_t i;
    for (i = 0; i < ROWS; ++i) {
        expected[i] = aminn_predict_state(alone, &states[i], &wanted[i]);
    }
}

static void rows_are_single_predictions(void)
{
    const aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_t alone = ctx;
    states[130].q[1] = NAN;
    states[131].contacts[0][0] = 2.0F;
    states[699].x_ht[5] = 9.0F;
    predict_alone(&alone);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, expected[130]);
    TEST_ASSERT_EQUAL_INT(AMINN_E_CONTACT_FLAG, expected[131]);
    TEST_ASSERT_EQUAL_INT(AMINN_E_ROTATION, expected[699]);
    assert_batch(&batch, 130);
}

static void as_many_threads_as_are_worth_it(void)
{
    aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_predict_batch(&ctx, &batch, 3, found, NULL, statuses, NULL);
    TEST_ASSERT_EQUAL_INT(2, threads_started);
    aminn_predict_batch(&ctx, &batch, 1000, found, NULL, statuses, NULL);
    TEST_ASSERT_EQUAL_INT(2 + ROWS / 64 - 1, threads_started);
    batch.n = 127; /* not enough for two */
    aminn_predict_batch(&ctx, &batch, 3, found, NULL, statuses, NULL);
    TEST_ASSERT_EQUAL_INT(2 + ROWS / 64 - 1, threads_started);
}

static void as_many_threads_as_processors(void)
{
    const aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    affinity_unknown = 1;
    for (online = -1; online < 5; ++online) { /* -1: not known either */
        threads_started = 0;
        aminn_predict_batch(&ctx, &batch, 0, found, NULL, statuses, NULL);
        TEST_ASSERT_EQUAL_INT(online < 1 ? 0 : online - 1, threads_started);
    }
}

static void where_no_thread_is_to_be_had_this_one_does_all(void)
{
    const aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_t alone = ctx;
    predict_alone(&alone);
    threads_refused = 1;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_batch(&ctx, &batch, 4, found, NULL, statuses, NULL));
    assert_rows(0, ROWS);
}

static void jacobians_may_be_given(void)
{
    aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_t alone = ctx;
    size_t i;
    batch.j_x.first = inputs[0].j_x[0][0];
    batch.j_q.first = inputs[0].j_q[0][0];
    batch.j_x.step = batch.j_q.step = INPUT;
    for (i = 0; i < ROWS; ++i) {
        inputs[i].j_q[1][2][1] *= 1.5F; /* not those of the geometry */
        expected[i] = aminn_predict(&alone, &inputs[i], &wanted[i]);
    }
    assert_batch(&batch, AMINN_NO_ROW);
}

static void one_state_and_many_loads(void)
{
    static float loads[ROWS][AMINN_N_WRENCH];
    const aminn_state_t grasp = states[7];
    const aminn_batch_t batch = aminn_batch_of_loads(&grasp, loads[0], ROWS);
    aminn_t alone = ctx;
    size_t i;
    for (i = 0; i < ROWS; ++i) {
        memcpy(loads[i], states[i].w_e, sizeof loads[i]);
        states[i] = grasp;
        memcpy(states[i].w_e, loads[i], sizeof loads[i]);
    }
    predict_alone(&alone);
    assert_batch(&batch, AMINN_NO_ROW);
}

static void callers_with_threads_of_their_own_give_parts(void)
{
    aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_t alone = ctx;
    size_t bad;
    states[150].q[0] = INFINITY;
    predict_alone(&alone);
    batch.begin = 100;
    batch.n = 201;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, aminn_predict_batch(&ctx, &batch, 1, found, NULL, statuses, &bad));
    TEST_ASSERT_EQUAL_size_t(150, bad);
    assert_rows(100, 201);
    memset(statuses, 0x55, sizeof statuses);
    batch.begin = 301;
    batch.n = 0;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_batch(&ctx, &batch, 0, found, NULL, statuses, &bad));
    TEST_ASSERT_TRUE(bad == AMINN_NO_ROW);
    TEST_ASSERT_EQUAL_HEX32(0x55555555, statuses[301]);
}

static void rows_have_sensors_of_their_own(void)
{
    aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_t alone = ctx;
    aminn_sensors_t told = sensors[0];
    aminn_sensors_t known = sensors[0];
    size_t i;
    sensors[20].friction[0] = 1.0F;
    sensors[20].friction[1] = -1.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&alone, &told));
    for (i = 0; i < ROWS; ++i) {
        told = sensors[i];
        expected[i] = aminn_predict_state(&alone, &states[i], &wanted[i]);
    }
    batch.friction.first = sensors[0].friction;
    batch.tool_weight.first = sensors[0].tool_weight;
    batch.tendon_tension.first = sensors[0].tendon_tension;
    batch.friction.step = batch.tool_weight.step = batch.tendon_tension.step = SENSORS;
    assert_batch(&batch, 20);

    /* what rows do not tell is as the context was told */
    known.friction[0] = 1.0F;
    known.friction[1] = 0.6F;
    known.friction[2] = 0.1F;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, &known));
    for (i = 0; i < ROWS; ++i) {
        told = known;
        memcpy(told.tool_weight, sensors[i].tool_weight, sizeof told.tool_weight);
        expected[i] = aminn_predict_state(&alone, &states[i], &wanted[i]);
    }
    batch.friction.first = batch.tendon_tension.first = NULL;
    assert_batch(&batch, AMINN_NO_ROW);
    told = known;
    predict_alone(&alone);
    batch.tool_weight.first = NULL;
    assert_batch(&batch, AMINN_NO_ROW);
}

static void a_model_that_sees_no_sensors_says_so_of_each_row(void)
{
    static aminn_model_t blind;
    aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    size_t bad, i;
    blind = aminn_model;
    blind.n_sensed = 0; /* its tables have rows more than it needs */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &blind, 0));
    batch.tendon_tension.first = sensors[0].tendon_tension;
    TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, aminn_predict_batch(&ctx, &batch, 2, found, NULL, statuses, &bad));
    TEST_ASSERT_EQUAL_size_t(0, bad);
    for (i = 0; i < ROWS; ++i) {
        TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, statuses[i]);
        assert_failed_output(&found[i]);
    }
}

static void rows_have_thetas_of_their_own(void)
{
    aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    aminn_t alone = ctx;
    size_t i;
    theta[333][0] = 9.0F;
    for (i = 0; i < ROWS; ++i) {
        expected[i] = aminn_calibration_set(&calibration, &aminn_model, theta[i]);
        if (expected[i] != AMINN_OK) {
            aminn_predict_state(&alone, NULL, &wanted[i]);
            continue;
        }
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate(&alone, &calibration));
        expected[i] = aminn_predict_state(&alone, &states[i], &wanted[i]);
    }
    TEST_ASSERT_EQUAL_INT(AMINN_E_CALIBRATION, expected[333]);
    batch.theta.first = theta[0];
    batch.theta.step = AMINN_N_THETA;
    assert_batch(&batch, 333);
    assert_failed_output(&found[333]);

    /* without, the context's calibration counts */
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibration_set(&calibration, &aminn_model, theta[0]));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate(&ctx, &calibration));
    alone = ctx;
    predict_alone(&alone);
    batch.theta.first = NULL;
    assert_batch(&batch, AMINN_NO_ROW);
}

static void stages_are_shown(void)
{
    static aminn_stage_debug_t stages[ROWS][AMINN_N_STAGE], before[AMINN_N_STAGE];
    const aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
    size_t i, stage, skipped = 0;
    aminn_t alone;
    for (i = 0; i < ROWS; i += 2) { /* which does not hold */
        states[i].w_e[2] = 40.0F;
    }
    states[8].q[0] = NAN;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, AMINN_FLAG_DEBUG));
    alone = ctx;
    predict_alone(&alone);
    scribble(before, sizeof before);
    for (i = 0; i < ROWS; ++i) {
        memcpy(stages[i], before, sizeof before);
    }
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE, aminn_predict_batch(&ctx, &batch, 2, found, stages[0], statuses, NULL));
    assert_rows(0, ROWS);
    for (i = 0; i < ROWS; ++i) {
        aminn_predict_state(&alone, &states[i], &wanted[i]);
        for (stage = 0; stage < AMINN_N_STAGE; ++stage) {
            const aminn_stage_debug_t *shown = aminn_debug(&alone, (int)stage);
            TEST_ASSERT_EQUAL_MEMORY(shown != NULL ? shown : &before[stage], &stages[i][stage], sizeof *shown);
            skipped += shown == NULL;
        }
    }
    TEST_ASSERT_GREATER_THAN_size_t(2, skipped);
}

static void largest_loads_are_those_of_single_searches(void)
{
    static aminn_admissible_t most[GRASPS], alone_most[GRASPS];
    static float directions[GRASPS][AMINN_N_WRENCH];
    static const aminn_load_limits_t limits = {2e-3F, 0.1F, 0.1F, 0.5F, 1.0F, 1.0F};
    aminn_load_limits_t wrong = limits;
    aminn_batch_t batch = aminn_batch_of_states(states, GRASPS);
    const aminn_rows_t along = {directions[0], AMINN_N_WRENCH}, nowhere = {NULL, 0};
    aminn_t alone = ctx;
    size_t i, k, bad;
    for (i = 0; i < GRASPS; ++i) {
        memcpy(directions[i], states[i].w_e, sizeof directions[i]);
        memset(states[i].w_e, 0, sizeof states[i].w_e);
        expected[i] = aminn_admissible_load(&alone, &states[i], directions[i], &limits, &alone_most[i]);
    }
    for (k = 0; k < KINDS; ++k) {
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_admissible_batch(&ctx, &batch, along, &limits, few_and_many[k], most,
                                                               statuses, k % 2 ? NULL : &bad));
        TEST_ASSERT_TRUE(bad == AMINN_NO_ROW);
        TEST_ASSERT_EQUAL_MEMORY(alone_most, most, sizeof most);
    }
    TEST_ASSERT_GREATER_THAN_INT(0, threads_started);

    theta[3][0] = NAN;
    batch.theta.first = theta[0];
    batch.theta.step = AMINN_N_THETA;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NONFINITE,
                          aminn_admissible_batch(&ctx, &batch, along, &limits, 2, most, statuses, &bad));
    TEST_ASSERT_EQUAL_size_t(3, bad);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, statuses[4]);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, most[3].scale);
    assert_failed_output(&most[3].at);

    wrong.max_rotation = 0.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_LIMITS, aminn_admissible_batch(&ctx, &batch, along, &wrong, 2, most, statuses, &bad));
    TEST_ASSERT_EQUAL_size_t(0, bad);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL,
                          aminn_admissible_batch(&ctx, &batch, nowhere, &limits, 2, most, statuses, &bad));
    TEST_ASSERT_TRUE(bad == AMINN_NO_ROW);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_batch(&ctx, &batch, along, NULL, 2, most, statuses, NULL));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_admissible_batch(NULL, &batch, along, &limits, 2, most, statuses, NULL));
}

static void what_is_missing_is_refused_before_anything_is_written(void)
{
    static const aminn_t zero;
    const aminn_batch_t good = aminn_batch_of_states(states, ROWS);
    aminn_batch_t batch = good;
    aminn_rows_t *const needed[] = {&batch.q, &batch.x_ht, &batch.w_e, &batch.contacts};
    size_t i, bad = 0;
    memset(statuses, 0x55, sizeof statuses);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_batch(NULL, &good, 1, found, NULL, statuses, &bad));
    TEST_ASSERT_TRUE(bad == AMINN_NO_ROW);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_batch(&ctx, NULL, 1, found, NULL, statuses, &bad));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_batch(&ctx, &good, 1, NULL, NULL, statuses, &bad));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_batch(&ctx, &good, 1, found, NULL, NULL, &bad));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NOT_INITIALISED, aminn_predict_batch(&zero, &good, 1, found, NULL, statuses, &bad));
    TEST_ASSERT_TRUE(bad == AMINN_NO_ROW);
    for (i = 0; i < sizeof needed / sizeof *needed; ++i) {
        batch = good;
        needed[i]->first = NULL;
        TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_batch(&ctx, &batch, 1, found, NULL, statuses, NULL));
    }
    batch = good;
    batch.j_q.first = inputs[0].j_q[0][0];
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_predict_batch(&ctx, &batch, 1, found, NULL, statuses, NULL));
    TEST_ASSERT_EACH_EQUAL_HEX32(0x55555555, statuses, ROWS);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(rows_are_single_predictions);
    RUN_TEST(as_many_threads_as_are_worth_it);
    RUN_TEST(as_many_threads_as_processors);
    RUN_TEST(where_no_thread_is_to_be_had_this_one_does_all);
    RUN_TEST(jacobians_may_be_given);
    RUN_TEST(one_state_and_many_loads);
    RUN_TEST(callers_with_threads_of_their_own_give_parts);
    RUN_TEST(rows_have_sensors_of_their_own);
    RUN_TEST(a_model_that_sees_no_sensors_says_so_of_each_row);
    RUN_TEST(rows_have_thetas_of_their_own);
    RUN_TEST(stages_are_shown);
    RUN_TEST(largest_loads_are_those_of_single_searches);
    RUN_TEST(what_is_missing_is_refused_before_anything_is_written);
    return UNITY_END();
}
