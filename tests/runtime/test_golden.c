/*
 * Parity: the compiled model and the blob on the golden vectors. Prints the largest difference of each output and fails
 * on it: dx_ht within 1e-4 of its own norm (rotations times 0.1 m) plus 1e-9 m, median of that ratio under 2e-6, p_stable
 * within 1e-5, the decision identical. Where a contact slides, stiffness and bound have fewer digits.
 */
#include <stdlib.h>

#include "aminn_model.h"
#include "byte_model.h"
#include "half_model.h"
#include "support.h"
#include "tiny_model.h"

static aminn_t ctx;

void setUp(void)
{
}

void tearDown(void)
{
}

typedef struct parity {
    double p_stable, dx_max, dx_median, dx_excess, k_x, k_x_excess, gate, p_slide, bound_95, bound_excess;
    uint32_t decisions;
} parity_t;

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* ref(i) reads a reference that is float or double */
static double ref(const golden_t *g, int f64, uint32_t sample, int i)
{
    const size_t at = (size_t)sample * VECTOR_N_OUT + (size_t)i;
    return f64 ? g->reference_f64[at] : (double)g->reference[at];
}

static double norm_of_difference(const float *dx, const golden_t *g, int f64, uint32_t sample, double *norm)
{
    double difference = 0, size = 0;
    int i;
    for (i = 0; i < 6; ++i) {
        const double scale = i < 3 ? 1.0 : 0.1;
        const double r = ref(g, f64, sample, 1 + i);
        difference += pow(scale * ((double)dx[i] - r), 2);
        size += pow(scale * r, 2);
    }
    *norm = sqrt(size);
    return sqrt(difference);
}

static double largest_relative(const float *values, const golden_t *g, int f64, uint32_t sample, int first, int n)
{
    double difference = 0, size = 1e-30;
    int i;
    for (i = 0; i < n; ++i) {
        const double r = ref(g, f64, sample, first + i);
        difference = fmax(difference, fabs((double)values[i] - r));
        size = fmax(size, fabs(r));
    }
    return difference / size;
}

/* A contact that slides is as soft as what its friction does not bear of the force: a small difference of large numbers. */
static int any_slides(const golden_t *g, int f64, uint32_t sample)
{
    int b, slides = 0;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        slides |= ref(g, f64, sample, 48 + b) > 1;
    }
    return slides;
}

static parity_t compare(const aminn_model_t *model, const golden_t *g, int f64)
{
    parity_t worst = {0};
    double *relative = calloc(g->n + 1, sizeof *relative);
    uint32_t s;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, model, AMINN_FLAG_ALWAYS_STAGE2));
    worst.dx_excess = worst.k_x_excess = worst.bound_excess = -1;
    for (s = 0; s < g->n; ++s) {
        aminn_output_t out;
        double norm = 0, difference;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, predict_golden(&ctx, g, s, &out));
        difference = norm_of_difference(out.dx_ht, g, f64, s, &norm);
        relative[s] = difference / (norm + 1e-12);
        worst.dx_max = fmax(worst.dx_max, relative[s]);
        worst.dx_excess = fmax(worst.dx_excess, difference - (1e-4 * norm + 1e-9));
        worst.p_stable = fmax(worst.p_stable, fabs((double)out.p_stable - ref(g, f64, s, 0)));
        difference = largest_relative(&out.k_x[0][0], g, f64, s, 7, 36);
        worst.k_x = fmax(worst.k_x, difference);
        worst.k_x_excess = fmax(worst.k_x_excess, difference - (any_slides(g, f64, s) ? 5e-4 : 1e-4));
        worst.gate = fmax(worst.gate, largest_relative(out.gate, g, f64, s, 43, 3));
        worst.p_slide = fmax(worst.p_slide, fabs((double)out.p_slide - ref(g, f64, s, 46)));
        difference = largest_relative(&out.bound_95, g, f64, s, 47, 1);
        worst.bound_95 = fmax(worst.bound_95, difference);
        worst.bound_excess = fmax(worst.bound_excess, difference - (any_slides(g, f64, s) ? 2e-4 : 1e-5));
        worst.decisions += out.stable != ((float)ref(g, f64, s, 0) >= model->tau);
    }
    qsort(relative, g->n, sizeof *relative, by_size);
    worst.dx_median = relative[g->n / 2];
    free(relative);
    return worst;
}

static void assert_parity(const char *name, const aminn_model_t *model, const golden_t *g, int f64)
{
    const parity_t worst = compare(model, g, f64);
    printf("%s, %u samples: p_stable %.3g, dx %.3g (median %.3g), k_x %.3g, gate %.3g, p_slide %.3g, bound %.3g, other "
           "decisions %u\n",
           name, (unsigned)g->n, worst.p_stable, worst.dx_max, worst.dx_median, worst.k_x, worst.gate, worst.p_slide,
           worst.bound_95, (unsigned)worst.decisions);
    TEST_ASSERT_TRUE(g->n > 0);
    TEST_ASSERT_TRUE(worst.dx_excess <= 0);
    TEST_ASSERT_TRUE(worst.dx_median < 2e-6);
    TEST_ASSERT_TRUE(worst.p_stable <= 1e-5);
    TEST_ASSERT_TRUE(worst.k_x_excess <= 0);
    TEST_ASSERT_TRUE(worst.gate < 1e-3);
    TEST_ASSERT_TRUE(worst.p_slide <= 1e-5);
    TEST_ASSERT_TRUE(worst.bound_excess <= 0);
    TEST_ASSERT_EQUAL_UINT32(0, worst.decisions);
}

static void the_compiled_model_agrees(void)
{
    golden_t g = load_golden(GOLDEN_DIR "/golden.bin");
    assert_parity("aminn_model.c against ONNX Runtime", &aminn_model, &g, 0);
    if (g.reference_f64 != NULL) {
        assert_parity("aminn_model.c against float64", &aminn_model, &g, 1);
    }
    free_golden(&g);
}

/* two contexts predict the same bits on every sample */
static void assert_same_predictions(aminn_t *one, aminn_t *other, const golden_t *g)
{
    uint32_t s;
    for (s = 0; s < g->n; ++s) {
        aminn_output_t a, b;
        TEST_ASSERT_EQUAL_INT(AMINN_OK, predict_golden(one, g, s, &a));
        TEST_ASSERT_EQUAL_INT(AMINN_OK, predict_golden(other, g, s, &b));
        assert_same_output(&a, &b);
    }
}

static void the_blob_gives_the_same_bits(void)
{
    static aminn_t other;
    golden_t g = load_golden(GOLDEN_DIR "/golden.bin");
    aminn_model_t model;
    size_t size = 0;
    void *blob = load_file(GOLDEN_DIR "/aminn_model.bin", &size);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&other, &model, 0));
    assert_same_predictions(&ctx, &other, &g);
    free(blob);
    free_golden(&g);
}

/* other widths, the "inverse" form of dq0, another prefix in the same program */
static void the_second_model_agrees(void)
{
    golden_t g = load_golden(GOLDEN_DIR "/tiny_golden.bin");
    TEST_ASSERT_EQUAL_UINT32(AMINN_DQ0_INVERSE, tiny_model.dq0);
    assert_parity("tiny_model.c against float64", &tiny_model, &g, 1);
    free_golden(&g);
}

/* as C tables and as a blob */
static void assert_both_agree(const char *name, const aminn_model_t *compiled, const char *blob_file,
                              const char *golden)
{
    golden_t g = load_golden(golden);
    static aminn_t other;
    aminn_model_t model;
    size_t size = 0;
    void *blob = load_file(blob_file, &size);
    assert_parity(name, compiled, &g, 1);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&other, &model, AMINN_FLAG_ALWAYS_STAGE2));
    assert_same_predictions(&ctx, &other, &g);
    free(blob);
    free_golden(&g);
}

static void float16_weights_agree(void)
{
    TEST_ASSERT_EQUAL_UINT32(AMINN_WEIGHTS_FLOAT16, half_model.weight_type);
    assert_both_agree("half_model.c against float64", &half_model, GOLDEN_DIR "/half_blob.bin",
                      GOLDEN_DIR "/half_golden.bin");
}

static void int8_weights_agree(void)
{
    TEST_ASSERT_EQUAL_UINT32(AMINN_WEIGHTS_INT8, byte_model.weight_type);
    assert_both_agree("byte_model.c against float64", &byte_model, GOLDEN_DIR "/byte_blob.bin",
                      GOLDEN_DIR "/byte_golden.bin");
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(float16_weights_agree);
    RUN_TEST(int8_weights_agree);
    RUN_TEST(the_compiled_model_agrees);
    RUN_TEST(the_blob_gives_the_same_bits);
    RUN_TEST(the_second_model_agrees);
    return UNITY_END();
}
