/*
 * mutants - changes one number of a model after the other, and sees whether the comparison of aminn_compare finds it.
 *
 *   mutants MODEL.bin VECTORS.bin PLAN OUTCOMES [ROWS]
 *
 * PLAN holds a u32 a mutant: the offset in the blob of what is multiplied by 1.5 (a zero becomes 0.5), with the highest bit set
 * where it is a float16, the next one where it is an int8. OUTCOMES gets a byte a mutant, as below. ROWS gets the results of each that ran: n rows and n
 * statuses. The length and CRC-32 of a changed header are right: the model is as valid as it can be.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "comparison.h"
#include "host_file.h"

enum { SAME_BITS = 0, OTHER_BITS = 1, BEYOND_LIMITS = 2, REFUSED = 3, HEADER = 384, CRC = 12, BODY = 16 };

#define HALF 0x80000000u
#define BYTE 0x40000000u

static uint32_t bigger_half(uint32_t half)
{
    /* times 1.5 in steps of the last place: enough of another number, and never infinite */
    return (half & 0x7FFFu) == 0 ? half | 0x3800u : (half & 0x7C00u) >= 0x7800u ? half ^ 0x8000u : half + 0x200u;
}

static int bigger_byte(int steps)
{
    const int away = steps < 0 ? -1 : 1;
    return steps == 0 ? 64 : steps * away > 84 ? -steps - away * (steps < -127) : steps + steps / 2 + away;
}

static void change(uint8_t *place, uint32_t kind)
{
    if (kind == BYTE) {
        *place = (uint8_t)bigger_byte((int8_t)*place);
    } else if (kind == HALF) {
        uint16_t value;
        memcpy(&value, place, sizeof value);
        value = (uint16_t)bigger_half(value);
        memcpy(place, &value, sizeof value);
    } else {
        float value;
        memcpy(&value, place, sizeof value);
        value = value == 0.0F ? 0.5F : 1.5F * value;
        memcpy(place, &value, sizeof value);
    }
}

/* predicts all samples; returns whether the runtime took the model */
static int predict(const aminn_model_t *model, const vector_header_t *vectors, float *rows, int32_t *statuses)
{
    static aminn_t ctx;
    if (aminn_init(&ctx, model, AMINN_FLAG_ALWAYS_STAGE2) != AMINN_OK) {
        return 0;
    }
    predict_rows(&ctx, model, vectors, rows, statuses);
    return 1;
}

/* the model in the blob; header fields were copied when it was read, so the CRC-32 is made right and it is read again */
static int reopen(uint8_t *blob, size_t size, aminn_model_t *model)
{
    const uint32_t crc = vector_crc(0, blob + BODY, size - BODY);
    memcpy(blob + CRC, &crc, sizeof crc);
    return aminn_model_from_blob(blob, size, model) == AMINN_OK;
}

int main(int argc, char **argv)
{
    size_t size = 0, plan_size = 0, i, rows_size, statuses_size;
    uint8_t *blob, *outcomes;
    const uint32_t *plan;
    const vector_header_t *vectors;
    aminn_model_t original, model;
    results_t base, mutant;
    verdict_t verdict;
    float *rows;
    int32_t *statuses;
    FILE *file, *rows_file = NULL;
    program_name = "mutants";
    if (argc < 5) {
        die("usage: mutants MODEL.bin VECTORS.bin PLAN OUTCOMES [ROWS]");
    }
    open_model(argv[1], &original);
    blob = read_file(argv[1], &size);
    aminn_model_from_blob(blob, size, &original);
    vectors = open_vectors(argv[2]);
    plan = read_file(argv[3], &plan_size);
    plan_size /= sizeof *plan;
    base = predict_all(&original, vectors);
    rows_size = (size_t)vectors->n * RESULT_N_OUT * sizeof *rows;
    statuses_size = (size_t)vectors->n * sizeof *statuses;
    rows = malloc(rows_size);
    statuses = malloc(statuses_size);
    outcomes = malloc(plan_size + 1);
    memset(&verdict, 0, sizeof verdict);
    mutant.n = vectors->n;
    mutant.rows = rows;
    mutant.statuses = statuses;
    if (argc > 5 && (rows_file = fopen(argv[5], "wb")) == NULL) {
        die("%s: cannot write", argv[5]);
    }
    for (i = 0; i < plan_size; ++i) {
        const uint32_t offset = plan[i] & ~(HALF | BYTE);
        uint8_t *place = blob + offset;
        uint8_t before[4];
        memcpy(before, place, sizeof before);
        change(place, plan[i] & (HALF | BYTE));
        model = original;
        if ((offset < HEADER && !reopen(blob, size, &model)) || !predict(&model, vectors, rows, statuses)) {
            outcomes[i] = REFUSED;
            memset(rows, 0, rows_size);
            memset(statuses, 0xFF, statuses_size);
        } else if (memcmp(rows, base.rows, rows_size) == 0 && memcmp(statuses, base.statuses, statuses_size) == 0) {
            outcomes[i] = SAME_BITS;
        } else {
            compare_within(&verdict, &original, vectors, mutant, 0);
            outcomes[i] = verdict.n_failures > 0 ? BEYOND_LIMITS : OTHER_BITS;
        }
        memcpy(place, before, sizeof before);
        if (rows_file != NULL) {
            fwrite(rows, 1, rows_size, rows_file);
            fwrite(statuses, 1, statuses_size, rows_file);
        }
    }
    if (rows_file != NULL) {
        fclose(rows_file);
    }
    file = fopen(argv[4], "wb");
    if (file == NULL || fwrite(outcomes, 1, plan_size, file) != plan_size || fclose(file) != 0) {
        die("%s: cannot write", argv[4]);
    }
    return 0;
}
