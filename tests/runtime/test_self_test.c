/* self_test.cpp: what is wrong is found, and named; what is right is left as it was */
#include <fenv.h>
#include <float.h>
#include <stdlib.h>
#if defined(__SSE__)
#include <xmmintrin.h>
#endif

#include "aminn_model.h"
#include "byte_model.h"
#include "half_model.h"
#include "support.h"
#include "tiny_model.h"

static aminn_t ctx;
static aminn_model_t model;

void setUp(void)
{
    model = aminn_model;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, 0));
}

void tearDown(void)
{
}

#define FOUND(status) TEST_ASSERT_EQUAL_STRING(aminn_status_name(status), aminn_status_name(aminn_self_test(&ctx)))

static void every_model_passes(void)
{
    const aminn_model_t *models[] = {&aminn_model, &half_model, &byte_model, &tiny_model};
    size_t i;
    for (i = 0; i < sizeof models / sizeof models[0]; ++i) {
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, models[i], 0));
        FOUND(AMINN_OK);
        FOUND(AMINN_OK);
    }
}

static void a_binary_model_passes(void)
{
    size_t size;
    void *blob = load_file(GOLDEN_DIR "/half_blob.bin", &size);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, 0));
    FOUND(AMINN_OK);
    free(blob);
}

static void the_known_answer_is_a_grasp_that_holds_and_is_known(void)
{
    const aminn_known_answer_t *known = aminn_model.known_answer;
    TEST_ASSERT_EQUAL_INT32(1, known->output.stable);
    TEST_ASSERT_EQUAL_UINT32(0, known->output.notes);
    TEST_ASSERT_TRUE(known->output.p_stable >= aminn_model.tau && known->output.p_stable < 0.9F);
}

/* a predictor that was tested is one that was not */
static void the_context_is_left_as_after_init(void)
{
    const aminn_input_t in = good_input();
    aminn_output_t before, after;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_DEBUG));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &before));
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 0));
    FOUND(AMINN_OK);
    TEST_ASSERT_NULL(aminn_debug(&ctx, 0));
    TEST_ASSERT_EQUAL_UINT32(AMINN_FLAG_DEBUG, ctx.flags);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &after));
    assert_same_output(&before, &after);
    TEST_ASSERT_NOT_NULL(aminn_debug(&ctx, 0));
}

static void a_context_that_is_none_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_self_test(NULL));
    memset(&ctx, 0, sizeof ctx);
    FOUND(AMINN_E_NOT_INITIALISED);
}

/* a sum and a product whose results say which mode is set; emulators such as valgrind ignore some */
static int ignores_modes(int mode)
{
    volatile float one = 1.0F, share = 0x1.8p-25F, smallest = FLT_MIN, sum, product;
    fesetround(mode);
    sum = one + share;
    product = 0.5F * smallest;
    fesetround(FE_TONEAREST);
    return (mode != FE_TONEAREST && sum == 1.0F) || (mode == FE_TONEAREST && product != 0.0F);
}

static void rounding_that_is_not_to_nearest_is_named(void)
{
    static const int modes[] = {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO};
    size_t i;
    if (ignores_modes(FE_UPWARD)) {
        TEST_IGNORE_MESSAGE("this machine rounds to nearest whatever it is told");
    }
    for (i = 0; i < sizeof modes / sizeof modes[0]; ++i) {
        aminn_status_t status;
        fesetround(modes[i]);
        status = aminn_self_test(&ctx);
        fesetround(FE_TONEAREST);
        TEST_ASSERT_EQUAL_STRING("AMINN_E_ROUNDING", aminn_status_name(status));
    }
    FOUND(AMINN_OK);
}

#if defined(__SSE__)
static void flushing_to_zero_is_named(void)
{
    static const unsigned modes[] = {0x8000u, 0x0040u, 0x8040u}; /* results; inputs; both */
    const unsigned kept = _mm_getcsr();
    int ignored;
    size_t i;
    _mm_setcsr(kept | 0x8040u);
    ignored = ignores_modes(FE_TONEAREST);
    _mm_setcsr(kept);
    if (ignored) {
        TEST_IGNORE_MESSAGE("this machine flushes nothing whatever it is told");
    }
    for (i = 0; i < sizeof modes / sizeof modes[0]; ++i) {
        aminn_status_t status;
        _mm_setcsr(kept | modes[i]);
        status = aminn_self_test(&ctx);
        _mm_setcsr(kept);
        TEST_ASSERT_EQUAL_STRING("AMINN_E_FLUSH", aminn_status_name(status));
    }
    FOUND(AMINN_OK);
}
#endif

/* one bit of a table's number, whichever bit, first and last number */
#define FLIPPED(field, type, n)                                                          \
    do {                                                                                 \
        static type copy[AMINN_MAX_WIDTH * AMINN_MAX_WIDTH];                             \
        const size_t count = (n);                                                        \
        const type *kept = model.field;                                                  \
        size_t bit;                                                                      \
        memcpy(copy, kept, count * sizeof(type));                                        \
        model.field = copy;                                                              \
        for (bit = 0; bit < 8 * sizeof(type); ++bit) {                                   \
            const size_t at = (bit % 2 != 0 ? (count - 1) * sizeof(type) : 0) + bit / 8; \
            ((uint8_t *)copy)[at] ^= (uint8_t)(1u << bit % 8);                           \
            FOUND(AMINN_E_CRC);                                                          \
            ((uint8_t *)copy)[at] ^= (uint8_t)(1u << bit % 8);                           \
        }                                                                                \
        FOUND(AMINN_OK);                                                                 \
        model.field = kept;                                                              \
    } while (0)

static void a_flipped_bit_of_any_table_is_found(void)
{
    const uint32_t hc = model.contact_width, hd = model.classifier_width, *h = model.width;
    size_t k;
    FLIPPED(wrench_log_scale, float, 6);
    FLIPPED(range_min, float, AMINN_N_STATE);
    FLIPPED(cls1_w, float, (h[0] + AMINN_N_AUX) * hd);
    FLIPPED(cls2_b, float, 1);
    FLIPPED(sure_mean, float, AMINN_N_SURE);
    FLIPPED(sure_w, float, 2 * (h[1] + AMINN_N_SURE));
    for (k = 0; k < AMINN_N_STAGE; ++k) {
        FLIPPED(stage[k].contact_w, float, AMINN_N_CONTACT_INPUT *hc);
        FLIPPED(stage[k].trunk2_w, float, h[k] * h[k]);
        FLIPPED(stage[k].head_b, float, AMINN_N_HEAD_STORED);
    }
}

static void a_flipped_bit_of_a_float16_weight_is_found(void)
{
    model = half_model;
    FLIPPED(stage[1].trunk2_w, uint16_t, model.width[1] * model.width[1]);
}

static void a_flipped_bit_of_an_int8_weight_or_of_the_size_of_its_steps_is_found(void)
{
    model = byte_model;
    FLIPPED(stage[0].head_w, int8_t, (size_t)model.width[0] * AMINN_N_HEAD_STORED);
    FLIPPED(stage[1].trunk2_b, float, 2 * (size_t)model.width[1]);
    FLIPPED(sure_b, float, 4);
}

static void a_flipped_bit_of_a_constant_is_found(void)
{
    uint8_t *const places[] = {(uint8_t *)&model.tau,
                               (uint8_t *)&model.max_rotation,
                               (uint8_t *)&model.bound_factor[3],
                               (uint8_t *)&model.length_scale,
                               (uint8_t *)&model.stage[0].eps_kx,
                               (uint8_t *)&model.stage[1].eps_jq,
                               model.checkpoint_sha256,
                               model.data_sha256 + 31,
                               (uint8_t *)&model.stages_crc,
                               (uint8_t *)&model.content_crc};
    size_t i;
    for (i = 0; i < sizeof places / sizeof places[0]; ++i) {
        *places[i] ^= 1u;
        FOUND(AMINN_E_CRC);
        *places[i] ^= 1u;
    }
    FOUND(AMINN_OK);
}

/* any word of the state and of what is expected, any bit */
static void a_flipped_bit_of_the_known_answer_is_found(void)
{
    static aminn_known_answer_t known;
    size_t i;
    known = *aminn_model.known_answer;
    model.known_answer = &known;
    for (i = 0; i < sizeof known; ++i) {
        ((uint8_t *)&known)[i] ^= (uint8_t)(1u << i % 8);
        FOUND(AMINN_E_CRC);
        ((uint8_t *)&known)[i] ^= (uint8_t)(1u << i % 8);
    }
    FOUND(AMINN_OK);
}

/* CRC-32 of content that differs in one word: by how many bytes of the same follow, whatever they are */
static uint32_t crc_difference(uint32_t before, uint32_t after, size_t bytes_behind)
{
    uint8_t *a = calloc(bytes_behind + 4, 1), *b = calloc(bytes_behind + 4, 1);
    uint32_t difference;
    memcpy(a, &before, 4);
    memcpy(b, &after, 4);
    difference = vector_crc(0, a, bytes_behind + 4) ^ vector_crc(0, b, bytes_behind + 4);
    free(a);
    free(b);
    return difference;
}

/* as if the model had been exported with another answer: whole, and yet other bits */
static void an_answer_that_is_not_the_librarys_is_found(void)
{
    static aminn_known_answer_t known;
    const size_t n = sizeof known / 4, contact_flag = AMINN_N_JOINT + 2 * AMINN_N_WRENCH;
    size_t i, b;
    model.known_answer = &known;
    for (i = AMINN_N_STATE; i < n; ++i) { /* each word of the output */
        uint32_t before, after;
        known = *aminn_model.known_answer;
        memcpy(&before, (uint8_t *)&known + 4 * i, 4);
        after = before ^ 1u;
        memcpy((uint8_t *)&known + 4 * i, &after, 4);
        model.content_crc = aminn_model.content_crc ^ crc_difference(before, after, 4 * (n - 1 - i));
        FOUND(AMINN_E_KNOWN_ANSWER);
    }
    known = *aminn_model.known_answer; /* a state that is refused */
    model.content_crc = aminn_model.content_crc;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        const size_t word = contact_flag + AMINN_N_CONTACT_FEATURE * b;
        model.content_crc ^= crc_difference(0x3F800000u, 0, 4 * (n - 1 - word));
        known.state.contacts[b][0] = 0.0F;
    }
    FOUND(AMINN_E_KNOWN_ANSWER);
}

/* what both stages compute on the way counts too; the bytes behind its CRC-32 are those that docs/model-format.md names */
static void intermediates_that_are_not_the_librarys_are_found(void)
{
    const uint32_t hc = model.contact_width, hd = model.classifier_width, *width = model.width;
    uint32_t elements = 421 + 49 + (width[0] + 26) * hd + 22 + 2 * (width[1] + 10) + 98;
    const uint32_t before = model.stages_crc, after = before ^ 0x80u;
    int k;
    for (k = 0; k < AMINN_N_STAGE; ++k) {
        elements += 239 + 52 * hc + (hc + 40) * width[k] + (width[k] + 1) * width[k] + 56 * width[k];
    }
    model.stages_crc = after;
    model.content_crc ^= crc_difference(before, after, 14 * 4 + 64 + 16 + 4 * (size_t)elements);
    FOUND(AMINN_E_KNOWN_ANSWER);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(every_model_passes);
    RUN_TEST(a_binary_model_passes);
    RUN_TEST(the_known_answer_is_a_grasp_that_holds_and_is_known);
    RUN_TEST(the_context_is_left_as_after_init);
    RUN_TEST(a_context_that_is_none_is_refused);
    RUN_TEST(rounding_that_is_not_to_nearest_is_named);
#if defined(__SSE__)
    RUN_TEST(flushing_to_zero_is_named);
#endif
    RUN_TEST(a_flipped_bit_of_any_table_is_found);
    RUN_TEST(a_flipped_bit_of_a_float16_weight_is_found);
    RUN_TEST(a_flipped_bit_of_an_int8_weight_or_of_the_size_of_its_steps_is_found);
    RUN_TEST(a_flipped_bit_of_a_constant_is_found);
    RUN_TEST(a_flipped_bit_of_the_known_answer_is_found);
    RUN_TEST(an_answer_that_is_not_the_librarys_is_found);
    RUN_TEST(intermediates_that_are_not_the_librarys_are_found);
    return UNITY_END();
}
