/* blob.cpp: aminn_model_from_blob, and damage at every region of a blob */
#include <stdlib.h>

#include "aminn_model.h"
#include "support.h"

enum {
    HEADER_SIZE = 384,
    ANSWER_SIZE = 448, /* of the last table, with what fills it up */
    TABLE_ALIGNMENT = 64,
    CRC_START = 16,
    OFFSET_MAGIC = 0,
    OFFSET_VERSION = 4,
    OFFSET_SIZE = 8,
    OFFSET_CRC = 12
};

static uint8_t *blob;
static size_t size;
static aminn_model_t model;

void setUp(void)
{
    blob = load_file(GOLDEN_DIR "/aminn_model.bin", &size);
    scribble(&model, sizeof model);
}

void tearDown(void)
{
    free(blob);
}

static void assert_refused(aminn_status_t status, const void *bytes, size_t len)
{
    static const aminn_model_t zero;
    scribble(&model, sizeof model);
    TEST_ASSERT_EQUAL_INT(status, aminn_model_from_blob(bytes, len, &model));
    TEST_ASSERT_EQUAL_MEMORY(&zero, &model, sizeof model);
}

static void put_u32(size_t offset, uint32_t value)
{
    memcpy(blob + offset, &value, sizeof value);
}

static uint32_t get_u32(size_t offset)
{
    uint32_t value;
    memcpy(&value, blob + offset, sizeof value);
    return value;
}

/* so that a change gets past the CRC */
static void seal(void)
{
    put_u32(OFFSET_CRC, vector_crc(0, blob + CRC_START, size - CRC_START));
}

static void a_good_blob_is_used_in_place(void)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
    TEST_ASSERT_TRUE((const uint8_t *)model.wrench_log_scale == blob + HEADER_SIZE);
    TEST_ASSERT_TRUE((const uint8_t *)model.known_answer == blob + size - ANSWER_SIZE);
    TEST_ASSERT_TRUE((const uint8_t *)model.sure_b == blob + size - ANSWER_SIZE - TABLE_ALIGNMENT);
    TEST_ASSERT_EQUAL_UINT(0, (size_t)((const uint8_t *)model.stage[1].trunk1_w - blob) % TABLE_ALIGNMENT);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_check(&model));
}

static void it_holds_what_the_c_source_holds(void)
{
    const size_t hd = aminn_model.classifier_width, h = aminn_model.width[0];
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
    TEST_ASSERT_EQUAL_UINT32(aminn_model.contact_width, model.contact_width);
    TEST_ASSERT_EQUAL_UINT32_ARRAY(aminn_model.width, model.width, AMINN_N_STAGE);
    TEST_ASSERT_EQUAL_UINT32(aminn_model.classifier_width, model.classifier_width);
    TEST_ASSERT_EQUAL_UINT32(aminn_model.dq0, model.dq0);
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.checkpoint_sha256, model.checkpoint_sha256, 32);
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.data_sha256, model.data_sha256, 32);
    TEST_ASSERT_EQUAL_STRING(aminn_model.name, model.name);
    TEST_ASSERT_EQUAL_STRING(aminn_model.hand, model.hand);
    TEST_ASSERT_EQUAL_STRING(aminn_model.made_by, model.made_by);
    TEST_ASSERT_EQUAL_HEX32(aminn_model.content_crc, model.content_crc);
    TEST_ASSERT_EQUAL_HEX32(aminn_model.stages_crc, model.stages_crc);
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.known_answer, model.known_answer, sizeof(aminn_known_answer_t));
    TEST_ASSERT_EQUAL_MEMORY(&aminn_model.tau, &model.tau, sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(&aminn_model.friction_nominal, &model.friction_nominal, 3 * sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.bound_edge, model.bound_edge, sizeof model.bound_edge);
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.bound_factor, model.bound_factor, sizeof model.bound_factor);
    TEST_ASSERT_EQUAL_MEMORY(&aminn_model.stage[1].eps_kx, &model.stage[1].eps_kx, 2 * sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.nominal.eps_m[1], model.nominal.eps_m[1], AMINN_N_BRANCH * sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.geom_anchor, model.geom_anchor, 27 * sizeof(float));
    TEST_ASSERT_EQUAL_PTR(AMINN_LIBRARY, aminn_model.library);
    TEST_ASSERT_NULL(model.library);
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.geom_axis, model.geom_axis, 27 * sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.stage[1].trunk2_w, model.stage[1].trunk2_w, h * h * sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.cls1_w, model.cls1_w, (h + AMINN_N_AUX) * hd * sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(aminn_model.sure_w, model.sure_w, (h + AMINN_N_SURE) * 2 * sizeof(float));
}

static void null_arguments_are_refused(void)
{
    assert_refused(AMINN_E_NULL, NULL, size);
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_model_from_blob(blob, size, NULL));
}

static void a_misaligned_blob_is_refused(void)
{
    uint8_t *moved = malloc(size + 8);
    size_t shift;
    for (shift = 1; shift < 4; ++shift) {
        memcpy(moved + shift, blob, size);
        assert_refused(AMINN_E_ALIGN, moved + shift, size);
    }
    memcpy(moved + 4, blob, size);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(moved + 4, size, &model));
    free(moved);
}

static void every_truncation_is_refused(void)
{
    size_t len;
    for (len = 0; len < size; len += len < 2 * HEADER_SIZE ? 1 : 997) {
        assert_refused(AMINN_E_SIZE, blob, len);
    }
    assert_refused(AMINN_E_SIZE, blob, size - 1);
    assert_refused(AMINN_E_SIZE, blob, size + 1);
}

static void a_wrong_magic_version_or_size_is_named(void)
{
    put_u32(OFFSET_MAGIC, 0x464C457Fu);
    assert_refused(AMINN_E_MAGIC, blob, size);
    put_u32(OFFSET_MAGIC, 0x414D4E4Du); /* what a big-endian processor reads */
    assert_refused(AMINN_E_BYTE_ORDER, blob, size);
    put_u32(OFFSET_MAGIC, 0x4D4E4D41u);
    put_u32(OFFSET_VERSION, AMINN_FORMAT_VERSION + 1);
    assert_refused(AMINN_E_VERSION, blob, size);
    put_u32(OFFSET_VERSION, AMINN_FORMAT_VERSION);
    put_u32(OFFSET_SIZE, get_u32(OFFSET_SIZE) + 4);
    assert_refused(AMINN_E_SIZE, blob, size);
}

/* one flipped bit in each byte of the header, and in bytes spread over all tables */
static void damage_anywhere_is_found(void)
{
    size_t at;
    for (at = 0; at < size; at += at < HEADER_SIZE ? 1 : 61) {
        const uint8_t kept = blob[at];
        aminn_status_t expected = AMINN_E_CRC;
        expected = at < OFFSET_VERSION ? AMINN_E_MAGIC : expected;
        expected = at >= OFFSET_VERSION && at < OFFSET_SIZE ? AMINN_E_VERSION : expected;
        expected = at >= OFFSET_SIZE && at < OFFSET_CRC ? AMINN_E_SIZE : expected;
        blob[at] = (uint8_t)(kept ^ (1u << (at % 8)));
        assert_refused(expected, blob, size);
        blob[at] = kept;
    }
    blob[size - 1] ^= 0x80;
    assert_refused(AMINN_E_CRC, blob, size);
    blob[size - 1] ^= 0x80;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
}

/* a blob with a right CRC but a content that this runtime cannot use */
static void a_sealed_blob_is_checked_too(void)
{
    enum { OFFSET_N_BRANCH = 20, OFFSET_WIDTH = 76, OFFSET_DQ0 = 84, OFFSET_WEIGHT_TYPE = 88, OFFSET_EPS_KX = 216 };
    const uint32_t nan_bits = 0x7FC00000u;
    uint32_t type;
    size_t dim;
    for (type = 3; type != 0; type *= 4) { /* no such type, not even one whose tables had these lengths */
        put_u32(OFFSET_WEIGHT_TYPE, type);
        seal();
        assert_refused(AMINN_E_MODEL, blob, size);
    }
    put_u32(OFFSET_WEIGHT_TYPE, AMINN_WEIGHTS_INT8); /* and one that has others */
    seal();
    assert_refused(AMINN_E_SIZE, blob, size);
    put_u32(OFFSET_WEIGHT_TYPE, AMINN_WEIGHTS_FLOAT32);
    for (dim = 0; dim < 12; ++dim) {
        const size_t at = OFFSET_N_BRANCH + 4 * dim;
        const uint32_t kept = get_u32(at);
        put_u32(at, kept + 1);
        seal();
        assert_refused(AMINN_E_DIMS, blob, size);
        put_u32(at, kept);
    }
    put_u32(OFFSET_WIDTH, get_u32(OFFSET_WIDTH) - 1); /* other tables than there are bytes */
    seal();
    assert_refused(AMINN_E_SIZE, blob, size);
    put_u32(OFFSET_WIDTH, get_u32(OFFSET_WIDTH) + 2);
    seal();
    assert_refused(AMINN_E_SIZE, blob, size);
    put_u32(OFFSET_WIDTH, 0xFFFFFFFFu);
    seal();
    assert_refused(AMINN_E_DIMS, blob, size);
    put_u32(OFFSET_WIDTH, aminn_model.width[1]);
    put_u32(OFFSET_DQ0, 7);
    seal();
    assert_refused(AMINN_E_MODEL, blob, size);
    put_u32(OFFSET_DQ0, aminn_model.dq0);
    put_u32(OFFSET_EPS_KX, 0);
    seal();
    assert_refused(AMINN_E_MODEL, blob, size);
    memcpy(blob + OFFSET_EPS_KX, &aminn_model.stage[0].eps_kx, sizeof(float));
    put_u32(size - ANSWER_SIZE - TABLE_ALIGNMENT, nan_bits);
    seal();
    assert_refused(AMINN_E_MODEL, blob, size);
    memcpy(blob + size - ANSWER_SIZE - TABLE_ALIGNMENT, aminn_model.sure_b, 2 * sizeof(float));
    put_u32(size - ANSWER_SIZE + 4 * 97, nan_bits); /* the last word of the known answer */
    seal();
    assert_refused(AMINN_E_MODEL, blob, size);
}

/* a name fills its place to the last byte, where its end has to be */
static void a_name_without_an_end_is_refused(void)
{
    static const size_t names[][2] = {{232, 56}, {288, 56}, {344, 40}};
    size_t i;
    for (i = 0; i < sizeof names / sizeof names[0]; ++i) {
        uint8_t kept[56];
        memcpy(kept, blob + names[i][0], names[i][1]);
        memset(blob + names[i][0], 'x', names[i][1]);
        seal();
        assert_refused(AMINN_E_MODEL, blob, size);
        blob[names[i][0] + names[i][1] - 1] = 0;
        seal();
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob, size, &model));
        memcpy(blob + names[i][0], kept, names[i][1]);
    }
}

static void widths_beyond_the_runtime_are_refused(void)
{
    size_t offset;
    for (offset = 68; offset <= 80; offset += 4) { /* contact_width, width, classifier_width */
        const uint32_t kept = get_u32(offset);
        put_u32(offset, AMINN_MAX_WIDTH + 1);
        seal();
        assert_refused(AMINN_E_DIMS, blob, size);
        put_u32(offset, kept);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(a_good_blob_is_used_in_place);
    RUN_TEST(it_holds_what_the_c_source_holds);
    RUN_TEST(null_arguments_are_refused);
    RUN_TEST(widths_beyond_the_runtime_are_refused);
    RUN_TEST(a_misaligned_blob_is_refused);
    RUN_TEST(every_truncation_is_refused);
    RUN_TEST(a_wrong_magic_version_or_size_is_named);
    RUN_TEST(damage_anywhere_is_found);
    RUN_TEST(a_sealed_blob_is_checked_too);
    RUN_TEST(a_name_without_an_end_is_refused);
    return UNITY_END();
}
