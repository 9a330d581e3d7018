/*
 * aminn_compare - are the results of a replay (host or target) those of the reference in the vector file?
 *
 *   aminn_compare MODEL.bin VECTORS.bin RESULTS.bin
 *
 * Prints the largest differences, one "name value" a line, and fails on them. With lengths as they are and rotations times
 * the model's length_scale, each dx_ht must lie within max(1e-4, 1e-7 cond(K_x scaled)) of its own norm plus 1e-9 m, the
 * median of the relative difference below 2e-6, p_stable within 1e-5, and the decision must be the same. Exits with 0; 1
 * and a message on a difference or a bad file; 2 on bad arguments.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host_file.h"

enum { DX = 1, K_X = 7, GATE = 43, STABLE = 46 };

#define P_STABLE_TOLERANCE 1e-5
#define DX_TOLERANCE 1e-4
#define DX_TOLERANCE_PER_CONDITION 1e-7
#define DX_FLOOR_M 1e-9
#define DX_MEDIAN 2e-6

/* the largest difference of one output and the sample it occurs in */
typedef struct worst {
    double value;
    uint32_t sample;
} worst_t;

typedef struct comparison {
    uint32_t n, refused, first_refused, decisions, first_decision;
    worst_t p_stable, dx, dx_of_tolerance, k_x, gate;
    double dx_median;
} comparison_t;

static void note(worst_t *worst, double value, uint32_t sample)
{
    if (!(value <= worst->value)) { /* also when it is NaN */
        worst->value = value;
        worst->sample = sample;
    }
}

/* eigenvalues of a symmetric 6x6 matrix by Jacobi rotations; returns largest over smallest */
static double condition(double a[6][6])
{
    double low = HUGE_VAL, high = 0;
    int sweep, p, q, k;
    for (sweep = 0; sweep < 30; ++sweep) {
        for (p = 0; p < 5; ++p) {
            for (q = p + 1; q < 6; ++q) {
                const double theta = 0.5 * atan2(2 * a[p][q], a[q][q] - a[p][p]);
                const double c = cos(theta), s = sin(theta);
                for (k = 0; k < 6; ++k) {
                    const double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
                for (k = 0; k < 6; ++k) {
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
            }
        }
    }
    for (k = 0; k < 6; ++k) {
        low = fmin(low, a[k][k]);
        high = fmax(high, a[k][k]);
    }
    return low > 0 ? high / low : HUGE_VAL;
}

/* condition of the reference's K_x with lengths divided by length_scale */
static double scaled_condition(const float *k_x, double length)
{
    double a[6][6];
    int i, j;
    for (i = 0; i < 6; ++i) {
        for (j = 0; j < 6; ++j) {
            a[i][j] = (double)k_x[6 * i + j] / ((i < 3 ? 1 : length) * (j < 3 ? 1 : length));
        }
    }
    return condition(a);
}

/* norm of a - b (b may be null), rotations times length */
static double scaled_norm(const float *a, const float *b, double length)
{
    double sum = 0;
    int i;
    for (i = 0; i < 6; ++i) {
        const double v = ((double)a[i] - (b != NULL ? (double)b[i] : 0.0)) * (i < 3 ? 1 : length);
        sum += v * v;
    }
    return sqrt(sum);
}

static double largest_difference(const float *a, const float *b, int n, double *size)
{
    double difference = 0;
    int i;
    *size = 0;
    for (i = 0; i < n; ++i) {
        const double d = fabs((double)a[i] - (double)b[i]);
        difference = d <= difference ? difference : d;
        *size = fmax(*size, fabs((double)b[i]));
    }
    return difference;
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double compare_dx(comparison_t *c, uint32_t i, const float *got, const float *want, double length)
{
    const double norm = scaled_norm(want + DX, NULL, length);
    const double difference = scaled_norm(got + DX, want + DX, length);
    const double relative = fmax(DX_TOLERANCE, DX_TOLERANCE_PER_CONDITION * scaled_condition(want + K_X, length));
    note(&c->dx, difference / (norm + DX_FLOOR_M), i);
    note(&c->dx_of_tolerance, difference / (relative * norm + DX_FLOOR_M), i);
    return difference / (norm + DX_FLOOR_M);
}

static void compare_sample(comparison_t *c, uint32_t i, const float *got, const float *want, float tau)
{
    double size;
    const double k_x = largest_difference(got + K_X, want + K_X, 36, &size);
    note(&c->k_x, k_x / size, i);
    note(&c->p_stable, fabs((double)got[0] - (double)want[0]), i);
    note(&c->gate, largest_difference(got + GATE, want + GATE, 3, &size), i);
    if ((got[STABLE] == 1.0F) != (want[0] >= tau)) {
        c->first_decision = c->decisions++ == 0 ? i : c->first_decision;
    }
}

static comparison_t compare(const aminn_model_t *model, const vector_header_t *vectors, const vector_header_t *results)
{
    comparison_t c;
    const float *want = (const float *)(vectors + 1) + (size_t)vectors->n * VECTOR_N_IN;
    const float *got = (const float *)(results + 1);
    const int32_t *statuses = (const int32_t *)(const void *)(got + (size_t)results->n * RESULT_N_OUT);
    double *relative = calloc((size_t)vectors->n + 1, sizeof *relative);
    uint32_t i;
    memset(&c, 0, sizeof c);
    if (relative == NULL) {
        die("out of memory");
    }
    c.n = vectors->n;
    for (i = 0; i < c.n; ++i, want += VECTOR_N_OUT, got += RESULT_N_OUT) {
        if (statuses[i] != AMINN_OK) {
            c.first_refused = c.refused++ == 0 ? i : c.first_refused;
            continue;
        }
        compare_sample(&c, i, got, want, model->tau);
        relative[i] = compare_dx(&c, i, got, want, (double)model->length_scale);
    }
    qsort(relative, c.n, sizeof *relative, by_size);
    c.dx_median = relative[c.n / 2];
    free(relative);
    return c;
}

static void print(const comparison_t *c)
{
    printf("samples %u\nrefused %u\n", (unsigned)c->n, (unsigned)c->refused);
    printf("p_stable_difference_max %.3g\n", c->p_stable.value);
    printf("dx_relative_difference_max %.3g\n", c->dx.value);
    printf("dx_relative_difference_median %.3g\n", c->dx_median);
    printf("dx_difference_of_tolerance_max %.3g\n", c->dx_of_tolerance.value);
    printf("k_x_relative_difference_max %.3g\n", c->k_x.value);
    printf("gate_difference_max %.3g\n", c->gate.value);
    printf("decisions_different %u\n", (unsigned)c->decisions);
}

static void judge(const comparison_t *c)
{
    if (c->n == 0) {
        die("no sample to compare");
    }
    if (c->refused > 0) {
        die("the runtime refused %u samples, first sample %u", (unsigned)c->refused, (unsigned)c->first_refused);
    }
    if (!(c->dx_of_tolerance.value <= 1)) {
        die("dx_ht of sample %u is %.3g times its tolerance away", (unsigned)c->dx_of_tolerance.sample,
            c->dx_of_tolerance.value);
    }
    if (!(c->dx_median < DX_MEDIAN)) {
        die("dx_ht: median relative difference %.3g, allowed %.3g", c->dx_median, DX_MEDIAN);
    }
    if (!(c->p_stable.value <= P_STABLE_TOLERANCE)) {
        die("p_stable of sample %u differs by %.3g, allowed %.3g", (unsigned)c->p_stable.sample, c->p_stable.value,
            P_STABLE_TOLERANCE);
    }
    if (c->decisions > 0) {
        die("%u decisions differ, first sample %u", (unsigned)c->decisions, (unsigned)c->first_decision);
    }
}

int main(int argc, char **argv)
{
    aminn_model_t model;
    const vector_header_t *vectors, *results;
    comparison_t c;
    program_name = "aminn_compare";
    if (argc != 4) {
        fprintf(stderr, "usage: %s MODEL.bin VECTORS.bin RESULTS.bin\n", argv[0]);
        return 2;
    }
    open_model(argv[1], &model);
    vectors = open_vectors(argv[2]);
    results = open_results(argv[3]);
    if (vectors->n != results->n) {
        die("%s has %u samples, %s has %u", argv[2], (unsigned)vectors->n, argv[3], (unsigned)results->n);
    }
    c = compare(&model, vectors, results);
    print(&c);
    judge(&c);
    return 0;
}
