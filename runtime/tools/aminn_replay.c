/*
 * aminn_replay - run the compiled runtime on the inputs of a vector file and write what it predicts.
 *
 *   aminn_replay MODEL.bin VECTORS.bin OUT.bin
 *
 * Both stages are computed for every sample (AMINN_FLAG_ALWAYS_STAGE2), so that all outputs can be compared. A sample
 * that the runtime refuses is written as the runtime left the outputs, with its status code. Prints a line about a calibration
 * by the first samples (learning.h), one that says which model it is and what aminn_self_test() finds, and one of figures; to standard error where OUT.bin is /dev/stdout. Exits
 * with 0, or with 1 and a message on a bad file or where OUT.bin is one of the inputs (no OUT.bin is left then), or with
 * 2 on bad arguments.
 *
 * Compiled with -DAMINN_REPLAY_HEADER='"aminn_model.h"' -DAMINN_REPLAY_MODEL=aminn_model and linked with aminn_model.c,
 * it runs that model instead and takes no MODEL.bin:
 *
 *   aminn_replay_model VECTORS.bin OUT.bin
 */
#include "host_file.h" /* first */

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "aminn_rt.h"
#include "learning.h"
#include "vector_file.h"
#ifdef AMINN_REPLAY_HEADER
#include AMINN_REPLAY_HEADER
#endif

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* the first digits of a SHA-256, or "none" where it is not known */
static void print_digest(FILE *says, const char *what, const uint8_t digest[32])
{
    enum { SHOWN = 6 };
    static const uint8_t none[32];
    int i;
    fprintf(says, ", %s ", what);
    if (memcmp(digest, none, sizeof none) == 0) {
        fprintf(says, "none");
        return;
    }
    for (i = 0; i < SHOWN; ++i) {
        fprintf(says, "%02x", digest[i]);
    }
}

static void print_identity(FILE *says, const aminn_model_t *model)
{
    static aminn_t ctx;
    aminn_status_t status = aminn_init(&ctx, model, 0);
    status = status == AMINN_OK ? aminn_self_test(&ctx) : status;
    fprintf(says, "model %s, hand %s, made by %s", model->name, model->hand, model->made_by);
    print_digest(says, "checkpoint", model->checkpoint_sha256);
    print_digest(says, "data", model->data_sha256);
    fprintf(says, ", tau %.4f; self-test %s\n", (double)model->tau, aminn_status_name(status));
}

/* predicts all samples into rows (n x RESULT_N_OUT) and statuses (n); returns the number that was refused */
static uint32_t predict_all(const aminn_model_t *model, const vector_header_t *vectors, float *rows, int32_t *statuses)
{
    static aminn_t ctx;
    const aminn_status_t status = aminn_init(&ctx, model, AMINN_FLAG_ALWAYS_STAGE2);
    if (status != AMINN_OK) {
        die("%s: %s", aminn_status_name(status), aminn_status_text(status));
    }
    return predict_rows(&ctx, model, vectors, rows, statuses);
}

static aminn_calibrator_t calibrator;
static uint32_t loads_crc;

/* the first samples: their largest admissible loads, and a calibration by what was predicted of them */
static void calibrate_all(const aminn_model_t *model, const vector_header_t *vectors, const float *rows)
{
    static aminn_t ctx;
    aminn_status_t status = aminn_init(&ctx, model, 0);
    status = status == AMINN_OK ? aminn_calibrator_init(&calibrator, model, NULL, NULL) : status;
    if (status != AMINN_OK) {
        die("%s: %s", aminn_status_name(status), aminn_status_text(status));
    }
    learn_rows(&ctx, &calibrator, vectors, rows, &loads_crc);
}

static void write_results(const char *path, uint32_t n, float *rows, int32_t *statuses)
{
    const size_t rows_size = (size_t)n * RESULT_N_OUT * sizeof *rows;
    const size_t statuses_size = (size_t)n * sizeof *statuses;
    vector_header_t header;
    FILE *file = NULL;
    vector_swap(rows, (size_t)n * RESULT_N_OUT);
    vector_swap(statuses, n);
    header = result_header(n, rows, statuses);
    vector_swap(&header, sizeof header / sizeof(uint32_t));
    file = create_output(path);
    write_output(file, &header, sizeof header);
    write_output(file, rows, rows_size);
    write_output(file, statuses, statuses_size);
    finish_output(file);
}

int main(int argc, char **argv)
{
#ifdef AMINN_REPLAY_MODEL
    const int first = 1;
    const char *usage = "VECTORS.bin OUT.bin";
    const aminn_model_t model = AMINN_REPLAY_MODEL;
#else
    const int first = 2;
    const char *usage = "MODEL.bin VECTORS.bin OUT.bin";
    aminn_model_t model;
#endif
    const vector_header_t *vectors = NULL;
    float *rows = NULL;
    int32_t *statuses = NULL;
    uint32_t refused;
    double start_s, spent_s;
    FILE *says;
    if (argc == 2 && strcmp(argv[1], "--help") == 0) {
        printf("usage: %s %s\n", argv[0], usage);
        return 0;
    }
    if (argc != first + 2) {
        fprintf(stderr, "usage: %s %s\n", argv[0], usage);
        return 2;
    }
    program_name = "aminn_replay";
#ifndef AMINN_REPLAY_MODEL
    refuse_input(argv[first + 1], argv[1]);
    open_model(argv[1], &model);
#endif
    refuse_input(argv[first + 1], argv[first]);
    vectors = open_vectors(argv[first]);
    rows = malloc(((size_t)vectors->n * RESULT_N_OUT + 1) * sizeof *rows);
    statuses = malloc(((size_t)vectors->n + 1) * sizeof *statuses);
    if (rows == NULL || statuses == NULL) {
        die("out of memory for %u samples", (unsigned)vectors->n);
    }
    start_s = now_s();
    refused = predict_all(&model, vectors, rows, statuses);
    spent_s = now_s() - start_s;
    calibrate_all(&model, vectors, rows);
    write_results(argv[first + 1], vectors->n, rows, statuses);
    says = output_is_stdout() ? stderr : stdout;
    print_identity(says, &model);
    fprintf(says, "pushes %u, calibration_crc %u, loads_crc %u\n", (unsigned)calibrator.pushes,
            (unsigned)learned_crc(&calibrator), (unsigned)loads_crc);
    fprintf(says, "samples %u, refused %u, %.3f us per prediction\n", (unsigned)vectors->n, (unsigned)refused,
            vectors->n > 0 ? 1e6 * spent_s / vectors->n : 0.0);
    free(rows);
    free(statuses);
    return 0;
}
