/* model.cpp: aminn_model_check refuses what it cannot use */
#include "aminn_model.h"
#include "byte_model.h"
#include "half_model.h"
#include "support.h"

static aminn_model_t model;
static float table[AMINN_MAX_WIDTH * AMINN_MAX_WIDTH];

void setUp(void)
{
    model = aminn_model;
}

void tearDown(void)
{
}

#define REFUSED(status) TEST_ASSERT_EQUAL_INT(status, aminn_model_check(&model))

/* replaces one value of a table and expects AMINN_E_MODEL */
#define REFUSED_VALUE(field, n, i, value)                                \
    do {                                                                 \
        const float *kept = model.field;                                 \
        memcpy(table, kept, (size_t)(n) * sizeof(float));                \
        table[i] = (value);                                              \
        model.field = table;                                             \
        TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_model_check(&model)); \
        model.field = kept;                                              \
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_check(&model));      \
    } while (0)

#define REFUSED_SCALAR(field, value)                                     \
    do {                                                                 \
        const float kept = model.field;                                  \
        model.field = (value);                                           \
        TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_model_check(&model)); \
        model.field = kept;                                              \
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_check(&model));      \
    } while (0)

static void the_exported_model_is_good(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_check(&aminn_model));
}

static void null_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_model_check(NULL));
}

static void another_version_is_refused(void)
{
    model.format_version = AMINN_FORMAT_VERSION + 1;
    REFUSED(AMINN_E_VERSION);
    memset(&model, 0, sizeof model); /* what aminn_model_from_blob leaves after an error */
    REFUSED(AMINN_E_VERSION);
}

static void another_hand_is_refused(void)
{
    uint32_t *dims[] = {&model.n_branch, &model.n_coord, &model.n_joint, &model.n_contact_feature,
                        &model.n_wrench, &model.n_gated, &model.n_twist, &model.n_stiff,
                        &model.n_tendon, &model.n_slide, &model.n_told,  &model.n_sensed};
    size_t i;
    for (i = 0; i < sizeof dims / sizeof dims[0]; ++i) {
        *dims[i] += 1;
        REFUSED(AMINN_E_DIMS);
        *dims[i] -= 1;
    }
    REFUSED(AMINN_OK);
}

static void widths_are_bounded(void)
{
    uint32_t *widths[] = {&model.contact_width, &model.width[0], &model.width[1], &model.classifier_width};
    size_t i;
    for (i = 0; i < sizeof widths / sizeof widths[0]; ++i) {
        const uint32_t kept = *widths[i];
        *widths[i] = 0;
        REFUSED(AMINN_E_DIMS);
        *widths[i] = AMINN_MAX_WIDTH + 1;
        REFUSED(AMINN_E_DIMS);
        *widths[i] = 0xFFFFFFFFu;
        REFUSED(AMINN_E_DIMS);
        *widths[i] = kept;
    }
    REFUSED(AMINN_OK);
}

#define REFUSED_WITHOUT(table)          \
    do {                                \
        const void *kept = model.table; \
        model.table = NULL;             \
        REFUSED(AMINN_E_MODEL);         \
        model.table = kept;             \
    } while (0)

static void a_missing_table_is_refused(void)
{
    size_t k;
    REFUSED_WITHOUT(wrench_log_scale);
    REFUSED_WITHOUT(nominal.chol);
    REFUSED_WITHOUT(tendon_dir_nom);
    REFUSED_WITHOUT(nominal.tendon_gain);
    REFUSED_WITHOUT(gate_nom);
    REFUSED_WITHOUT(theta_terms);
    REFUSED_WITHOUT(coord_mask);
    REFUSED_WITHOUT(geom_axis);
    REFUSED_WITHOUT(geom_anchor);
    REFUSED_WITHOUT(range_min);
    REFUSED_WITHOUT(range_max);
    REFUSED_WITHOUT(aux_mean);
    REFUSED_WITHOUT(aux_inv_std);
    REFUSED_WITHOUT(cls1_w);
    REFUSED_WITHOUT(cls1_b);
    REFUSED_WITHOUT(cls2_w);
    REFUSED_WITHOUT(cls2_b);
    REFUSED_WITHOUT(sure_mean);
    REFUSED_WITHOUT(sure_inv_std);
    REFUSED_WITHOUT(sure_w);
    REFUSED_WITHOUT(sure_b);
    REFUSED_WITHOUT(known_answer);
    REFUSED_WITHOUT(name);
    REFUSED_WITHOUT(hand);
    REFUSED_WITHOUT(made_by);
    for (k = 0; k < AMINN_N_STAGE; ++k) {
        REFUSED_WITHOUT(nominal.eps_m[k]);
        REFUSED_WITHOUT(stage[k].contact_mean);
        REFUSED_WITHOUT(stage[k].contact_inv_std);
        REFUSED_WITHOUT(stage[k].global_mean);
        REFUSED_WITHOUT(stage[k].global_inv_std);
        REFUSED_WITHOUT(stage[k].contact_w);
        REFUSED_WITHOUT(stage[k].contact_b);
        REFUSED_WITHOUT(stage[k].trunk1_w);
        REFUSED_WITHOUT(stage[k].trunk1_b);
        REFUSED_WITHOUT(stage[k].trunk2_w);
        REFUSED_WITHOUT(stage[k].trunk2_b);
        REFUSED_WITHOUT(stage[k].head_w);
        REFUSED_WITHOUT(stage[k].head_b);
    }
    REFUSED(AMINN_OK);
}

static void a_weight_that_is_no_number_is_refused(void)
{
    const uint32_t h1 = model.width[0], h = model.width[1];
    REFUSED_VALUE(stage[0].trunk2_w, h1 * h1, h1 * h1 - 1, NAN);
    REFUSED_VALUE(stage[1].trunk2_w, h * h, 0, INFINITY);
    REFUSED_VALUE(stage[1].head_b, AMINN_N_HEAD_STORED, AMINN_N_HEAD_STORED - 1, -INFINITY);
    REFUSED_VALUE(cls2_b, 1, 0, NAN);
    REFUSED_VALUE(sure_w, 2 * (h + AMINN_N_SURE), 2 * h, NAN);
    REFUSED_VALUE(geom_axis, 27, 26, NAN);
}

static void a_float16_weight_that_is_no_number_is_refused(void)
{
    static uint16_t weights[AMINN_N_CONTACT_INPUT * 64];
    aminn_model_t half = half_model;
    const size_t n = (size_t)AMINN_N_CONTACT_INPUT * half.contact_width;
    TEST_ASSERT_TRUE(n <= sizeof weights / sizeof weights[0]);
    memcpy(weights, half.stage[1].contact_w, n * sizeof weights[0]);
    half.stage[1].contact_w = weights;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_check(&half));
    weights[0] = 0x7C00u; /* infinity */
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_model_check(&half));
    weights[0] = 0;
    weights[n - 1] = 0xFE00u; /* NaN */
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_model_check(&half));
}

/* behind the biases */
static void a_size_of_int8_steps_that_is_not_above_zero_is_refused(void)
{
    static const float wrong[] = {0.0F, -0.0F, -1.0F, NAN, INFINITY, -INFINITY};
    const uint32_t h = byte_model.width[0];
    size_t i;
    model = byte_model;
    REFUSED(AMINN_OK);
    for (i = 0; i < sizeof wrong / sizeof wrong[0]; ++i) {
        REFUSED_VALUE(stage[0].trunk1_b, 2 * h, h, wrong[i]);
        REFUSED_VALUE(stage[1].head_b, 2 * AMINN_N_HEAD_STORED, 2 * AMINN_N_HEAD_STORED - 1, wrong[i]);
        REFUSED_VALUE(cls2_b, 2, 1, wrong[i]);
    }
    REFUSED_VALUE(sure_b, 4, 1, NAN); /* a bias */
}

static void a_type_of_weights_that_is_not_the_storages_is_refused(void)
{
    const aminn_model_t *const models[] = {&aminn_model, &half_model, &byte_model};
    uint32_t i, type;
    for (i = 0; i < 3; ++i) {
        model = *models[i];
        for (type = 0; type < 4; ++type) {
            model.weight_type = type;
            REFUSED(type == models[i]->weight_type ? AMINN_OK : AMINN_E_MODEL);
        }
        model = *models[i];
        model.storage = models[(i + 1) % 3]->storage;
        REFUSED(AMINN_E_MODEL);
    }
}

static void constants_out_of_range_are_refused(void)
{
    REFUSED_SCALAR(stage[1].eps_jq, INFINITY);
    REFUSED_SCALAR(log_range, INFINITY);
    REFUSED_VALUE(wrench_log_scale, 6, 5, 0.0F);
    REFUSED_VALUE(nominal.chol, 18, 12, -1.0F);
    REFUSED_VALUE(nominal.tendon_gain, 3, 1, -1.0F);
    REFUSED_VALUE(coord_mask, 9, 4, 0.5F);
    REFUSED_SCALAR(length_scale, 0.0F);
    REFUSED_SCALAR(log_range, -1.0F);
    REFUSED_SCALAR(displacement_log_scale, NAN);
    REFUSED_SCALAR(tau, 1.5F);
    REFUSED_SCALAR(tau, NAN);
    REFUSED_SCALAR(friction_nominal, 0.0F);
    REFUSED_SCALAR(max_translation, -0.01F);
    REFUSED_SCALAR(max_rotation, INFINITY);
    REFUSED_SCALAR(bound_edge[0], -0.1F);
    REFUSED_SCALAR(bound_edge[1], NAN);
    REFUSED_SCALAR(bound_edge[1], 0.5F * model.bound_edge[0]); /* not ascending */
    REFUSED_SCALAR(bound_edge[2], 1.5F);
    REFUSED_SCALAR(bound_factor[3], 0.0F);
    REFUSED_VALUE(nominal.eps_m[0], 3, 0, 0.0F);
    REFUSED_VALUE(nominal.eps_m[1], 3, 2, -1e-5F);
    REFUSED_SCALAR(stage[1].eps_kx, INFINITY);
    REFUSED_SCALAR(stage[1].eps_jq, -1.0F);
    model.dq0 = 2;
    REFUSED(AMINN_E_MODEL);
    model.dq0 = AMINN_DQ0_INVERSE;
    REFUSED_SCALAR(stage[0].eps_jq, 0.0F); /* the thumb's j_q is singular without it */
}

/* a branch lacks its first coordinates, and those that there are are as many as the joints: else q is read beside its ends */
static void a_mask_that_is_not_the_hands_is_refused(void)
{
    static const float wrong[][9] = {
        {1, 1, 1, 1, 1, 1, 1, 1, 1},   /* one too many */
        {1, 1, 1, 1, 1, 1, 0, 0, 1},   /* one too few */
        {1, 1, 1, 1, 1, 1, 1, 0, 1},   /* not the first is absent */
        {1, 1, 1, 1, 1, 1, 1, 1, 0},   /* the last is */
        {1, 1, 0.5F, 1, 1, 1, 0, 1, 1} /* neither there nor absent */
    };
    static const float other[9] = {0, 1, 1, 1, 1, 1, 1, 1, 1}; /* a hand of as many joints */
    size_t i;
    for (i = 0; i < sizeof wrong / sizeof wrong[0]; ++i) {
        model.coord_mask = wrong[i];
        REFUSED(AMINN_E_MODEL);
    }
    model.coord_mask = other;
    REFUSED(AMINN_OK);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(the_exported_model_is_good);
    RUN_TEST(null_is_refused);
    RUN_TEST(another_version_is_refused);
    RUN_TEST(another_hand_is_refused);
    RUN_TEST(widths_are_bounded);
    RUN_TEST(a_missing_table_is_refused);
    RUN_TEST(a_weight_that_is_no_number_is_refused);
    RUN_TEST(a_float16_weight_that_is_no_number_is_refused);
    RUN_TEST(a_size_of_int8_steps_that_is_not_above_zero_is_refused);
    RUN_TEST(a_type_of_weights_that_is_not_the_storages_is_refused);
    RUN_TEST(constants_out_of_range_are_refused);
    RUN_TEST(a_mask_that_is_not_the_hands_is_refused);
    return UNITY_END();
}
