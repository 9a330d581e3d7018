/*
 * aminn_bench - time single predictions of the compiled runtime.
 *
 *   aminn_bench MODEL.bin VECTORS.bin ROUNDS
 *
 * Runs over all samples of the vector file ROUNDS times and prints, as one JSON object, mean, median, 99th percentile
 * and the largest time of one call in microseconds: of aminn_predict as a controller calls it (stage 2 only where the
 * grasp holds), of aminn_predict with both stages (the worst case), and of aminn_predict_state, which computes the
 * closure itself. Exits with 0, with 1 and a message on a bad file or a refused sample, with 2 on bad arguments.
 */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "aminn_rt.h"
#include "host_file.h"
#include "vector_file.h"

typedef aminn_status_t (*call_t)(aminn_t *ctx, const aminn_input_t *in, aminn_output_t *out);

static aminn_status_t predict_state(aminn_t *ctx, const aminn_input_t *in, aminn_output_t *out)
{
    aminn_state_t state;
    memcpy(state.q, in->q, sizeof state.q);
    memcpy(state.x_ht, in->x_ht, sizeof state.x_ht);
    memcpy(state.w_e, in->w_e, sizeof state.w_e);
    memcpy(state.contacts, in->contacts, sizeof state.contacts);
    return aminn_predict_state(ctx, &state, out);
}

static double elapsed_us(const struct timespec *from, const struct timespec *to)
{
    return 1e6 * (double)(to->tv_sec - from->tv_sec) + 1e-3 * (double)(to->tv_nsec - from->tv_nsec);
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* times every sample `rounds` times into times (n * rounds), sorted */
static void time_calls(const aminn_model_t *model, uint32_t flags, call_t call, const vector_header_t *vectors,
                       size_t rounds, double *times)
{
    static aminn_t ctx;
    const float *samples = (const float *)(vectors + 1);
    const size_t count = vectors->n * rounds;
    size_t i;
    if (aminn_init(&ctx, model, flags) != AMINN_OK) {
        die("the model is refused by aminn_init");
    }
    for (i = 0; i < count; ++i) {
        aminn_input_t in;
        aminn_output_t out;
        struct timespec start, stop;
        aminn_status_t status;
        memcpy(&in, samples + (i % vectors->n) * VECTOR_N_IN, sizeof in);
        clock_gettime(CLOCK_MONOTONIC, &start);
        status = call(&ctx, &in, &out);
        clock_gettime(CLOCK_MONOTONIC, &stop);
        if (status != AMINN_OK) {
            die("sample %u is refused: %s", (unsigned)(i % vectors->n), aminn_status_name(status));
        }
        times[i] = elapsed_us(&start, &stop);
    }
    qsort(times, count, sizeof *times, ascending);
}

static void print_times(const char *name, const double *times, size_t count, const char *end)
{
    double sum = 0.0;
    size_t i;
    for (i = 0; i < count; ++i) {
        sum += times[i];
    }
    printf("\"%s_us_mean\": %.3f, \"%s_us_median\": %.3f, ", name, sum / (double)count, name, times[count / 2]);
    printf("\"%s_us_p99\": %.3f, \"%s_us_max\": %.3f%s", name, times[(count * 99) / 100], name, times[count - 1], end);
}

int main(int argc, char **argv)
{
    aminn_model_t model;
    const vector_header_t *vectors = NULL;
    double *times = NULL;
    size_t rounds = 0, count;
    program_name = "aminn_bench";
    if (argc != 4 || (rounds = strtoul(argv[3], NULL, 10)) == 0 || rounds > 1000000) {
        fprintf(stderr, "usage: %s MODEL.bin VECTORS.bin ROUNDS\n", argv[0]);
        return 2;
    }
    open_model(argv[1], &model);
    vectors = open_vectors(argv[2]);
    if (vectors->n == 0) {
        die("%s: no samples", argv[2]);
    }
    count = vectors->n * rounds;
    times = malloc(count * sizeof *times);
    if (times == NULL) {
        die("out of memory");
    }
    printf("{");
    time_calls(&model, 0, aminn_predict, vectors, rounds, times);
    print_times("predict", times, count, ", ");
    time_calls(&model, AMINN_FLAG_ALWAYS_STAGE2, aminn_predict, vectors, rounds, times);
    print_times("both_stages", times, count, ", ");
    time_calls(&model, AMINN_FLAG_ALWAYS_STAGE2, predict_state, vectors, rounds, times);
    print_times("both_stages_and_closure", times, count, "}\n");
    return 0;
}
