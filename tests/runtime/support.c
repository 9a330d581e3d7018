#include "support.h"

#include <stdlib.h>

void *load_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    void *memory = NULL;
    long end = -1;
    if (file != NULL && fseek(file, 0, SEEK_END) == 0) {
        end = ftell(file);
    }
    if (end >= 0 && fseek(file, 0, SEEK_SET) == 0) {
        memory = malloc((size_t)end + 16);
    }
    if (memory == NULL || fread(memory, 1, (size_t)end, file) != (size_t)end) {
        TEST_FAIL_MESSAGE(path);
    }
    fclose(file);
    *size = (size_t)end;
    return memory;
}

golden_t load_golden(const char *path)
{
    golden_t golden = {0};
    size_t size = 0;
    uint8_t *bytes = load_file(path, &size);
    const vector_header_t *header = (const vector_header_t *)(const void *)bytes;
    const float *sample = (const float *)(const void *)(header + 1);
    aminn_input_t *inputs;
    aminn_sensors_t *sensors;
    uint32_t i;
    TEST_ASSERT_TRUE_MESSAGE(size >= sizeof *header, path);
    TEST_ASSERT_NULL_MESSAGE(vector_header_error(header, size - sizeof *header), path);
    TEST_ASSERT_EQUAL_HEX32(header->crc, vector_crc(0, header + 1, size - sizeof *header));
    TEST_ASSERT_EQUAL_UINT32(0, vector_n_theta(header));
    golden.memory = bytes;
    golden.n = header->n;
    golden.samples = malloc((size_t)golden.n * (sizeof *inputs + sizeof *sensors) + 1);
    TEST_ASSERT_NOT_NULL_MESSAGE(golden.samples, path);
    inputs = golden.samples;
    sensors = (aminn_sensors_t *)(void *)(inputs + golden.n);
    for (i = 0; i < golden.n; ++i, sample += vector_sample(header)) {
        memcpy(&inputs[i], sample, sizeof *inputs);
        memcpy(&sensors[i], sample + VECTOR_N_IN, vector_n_sensor(header) * sizeof *sample);
    }
    golden.inputs = inputs;
    golden.sensors = vector_n_sensor(header) != 0 ? sensors : NULL;
    golden.reference = sample;
    if (vector_has_f64(header)) {
        golden.reference_f64 = (const double *)(const void *)(golden.reference + (size_t)golden.n * VECTOR_N_OUT);
    }
    return golden;
}

void free_golden(golden_t *golden)
{
    free(golden->memory);
    free(golden->samples);
    golden->memory = golden->samples = NULL;
}

aminn_status_t predict_golden(aminn_t *ctx, const golden_t *golden, uint32_t i, aminn_output_t *out)
{
    aminn_status_t status = aminn_sense(ctx, golden->sensors != NULL ? &golden->sensors[i] : NULL);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, status);
    status = aminn_predict(ctx, &golden->inputs[i], out);
    aminn_sense(ctx, NULL);
    return status;
}

aminn_state_t state_of(const aminn_input_t *in)
{
    aminn_state_t state;
    memcpy(&state, in, sizeof state);
    return state;
}

aminn_input_t good_input(void)
{
    golden_t golden = load_golden(GOLDEN_DIR "/golden.bin");
    aminn_input_t in = golden.inputs[0];
    uint32_t i;
    for (i = 0; i < golden.n; ++i) {
        in = golden.inputs[i];
        if (in.contacts[0][0] > 0 && in.contacts[1][0] > 0 && in.contacts[2][0] > 0) {
            break;
        }
    }
    TEST_ASSERT_TRUE_MESSAGE(i < golden.n, "no golden sample has all branches in contact");
    free_golden(&golden);
    return in;
}

void assert_failed_output(const aminn_output_t *out)
{
    int i, j;
    TEST_ASSERT_EQUAL_FLOAT(0.0F, out->p_stable);
    TEST_ASSERT_EQUAL_INT32(0, out->stable);
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        TEST_ASSERT_FLOAT_IS_NAN(out->dx_ht[i]);
        for (j = 0; j < AMINN_N_WRENCH; ++j) {
            TEST_ASSERT_FLOAT_IS_NAN(out->k_x[i][j]);
        }
    }
    for (i = 0; i < AMINN_N_BRANCH; ++i) {
        TEST_ASSERT_FLOAT_IS_NAN(out->gate[i]);
    }
}

void assert_same_output(const aminn_output_t *a, const aminn_output_t *b)
{
    TEST_ASSERT_EQUAL_MEMORY(a, b, sizeof *a);
}

void scribble(void *memory, size_t size)
{
    memset(memory, 0xA5, size);
}
