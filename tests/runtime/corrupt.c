/*
 * aminn_corrupt MODEL.bin - every byte of a binary model with several other values, and every length that it can be cut
 * to: the library must refuse each. Prints figures as JSON; exits 1 at the first damage that is taken for a good model.
 */
#include "host_file.h"

#include <stdlib.h>
#include <time.h>

static aminn_output_t predict(const aminn_model_t *model)
{
    static aminn_t ctx;
    aminn_output_t out;
    memset(&out, 0, sizeof out);
    if (aminn_init(&ctx, model, AMINN_FLAG_ALWAYS_STAGE2) == AMINN_OK) {
        aminn_predict_state(&ctx, &model->known_answer->state, &out);
    }
    return out;
}

/* Ends the program if the damaged model is not refused. */
static void try_damaged(const uint8_t *bytes, size_t size, const char *what, size_t at, const aminn_output_t *whole)
{
    aminn_model_t model;
    if (aminn_model_from_blob(bytes, size, &model) == AMINN_OK) {
        const aminn_output_t out = predict(&model);
        const char *bits = memcmp(&out, whole, sizeof out) == 0 ? "the same bits" : "other bits";
        fprintf(stderr, "%s %zu: taken for a good model, predicts %s\n", what, at, bits);
        exit(1);
    }
}

int main(int argc, char **argv)
{
    static const uint8_t flips[] = {0x01, 0x80, 0xFF};
    const clock_t start = clock();
    aminn_model_t model;
    aminn_output_t whole;
    uint8_t *bytes;
    size_t size = 0, at, i, step;
    program_name = "aminn_corrupt";
    if (argc != 2) {
        fprintf(stderr, "usage: aminn_corrupt MODEL.bin\n");
        return 2;
    }
    bytes = read_file(argv[1], &size);
    if (aminn_model_from_blob(bytes, size, &model) != AMINN_OK) {
        fprintf(stderr, "%s: refused as it is\n", argv[1]);
        return 2;
    }
    whole = predict(&model);
    for (at = 0; at < size; ++at) {
        try_damaged(bytes, at, "cut to", at, &whole);
    }
    for (step = 0; step < size; ++step) { /* from both ends: defects are soon found there */
        uint8_t kept;
        at = step % 2 == 0 ? step / 2 : size - 1 - step / 2;
        kept = bytes[at];
        for (i = 0; i < sizeof flips; ++i) {
            bytes[at] = (uint8_t)(kept ^ flips[i]);
            try_damaged(bytes, size, "byte", at, &whole);
        }
        bytes[at] = kept;
    }
    printf("{\"corrupt_model_bytes\": %zu, \"corrupt_model_tried\": %zu, \"corrupt_model_refused\": %zu, "
           "\"corrupt_model_same_bits\": 0, \"corrupt_model_seconds\": %.1f}\n",
           size, size * (1 + sizeof flips), size * (1 + sizeof flips), (double)(clock() - start) / CLOCKS_PER_SEC);
    return 0;
}
