/*
 * Time of a prediction with both stages, of one library and the model that is compiled in: for comparing two builds, whose
 * programs run in turns (aminn_export.judge.cost). Uses nothing of the interface that has ever changed.
 *
 *   aminn_time STATES ROUNDS   STATES: aminn_input_t one after another, little endian
 *
 * Prints the median time of a round, microseconds a prediction. Linux.
 */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include MODEL_HEADER

enum { MOST_STATES = 256, MOST_ROUNDS = 100000 };

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    static aminn_t ctx;
    static aminn_input_t in[MOST_STATES];
    static double took[MOST_ROUNDS];
    const int rounds = argc == 3 ? atoi(argv[2]) : 0;
    FILE *file = argc == 3 ? fopen(argv[1], "rb") : NULL;
    size_t n = 0, i;
    int round;
    if (file != NULL) {
        n = fread(in, sizeof in[0], MOST_STATES, file);
        fclose(file);
    }
    if (n == 0 || rounds < 1 || rounds > MOST_ROUNDS) {
        fprintf(stderr, "usage: aminn_time STATES ROUNDS, of which there are 1 to %d\n", MOST_ROUNDS);
        return 2;
    }
    if (aminn_init(&ctx, &MODEL_SYMBOL, AMINN_FLAG_ALWAYS_STAGE2) != AMINN_OK) {
        fprintf(stderr, "aminn_time: the model does not fit the library\n");
        return 1;
    }
    for (round = 0; round < rounds; ++round) {
        const double start = seconds();
        for (i = 0; i < n; ++i) {
            aminn_output_t out;
            if (aminn_predict(&ctx, &in[i], &out) != AMINN_OK) {
                fprintf(stderr, "aminn_time: state %lu is refused\n", (unsigned long)i);
                return 1;
            }
        }
        took[round] = 1e6 * (seconds() - start) / (double)n;
    }
    qsort(took, (size_t)rounds, sizeof took[0], by_size);
    printf("%.6f\n", took[rounds / 2]);
    return 0;
}
