/*
 * comparison.h - results of a replay judged: against a vector file's reference within tolerances.h, or against other
 * results bit by bit. tools/export/aminn_export/judge.py does the same in Python; a test holds the two together.
 */
#ifndef AMINN_COMPARISON_H
#define AMINN_COMPARISON_H

#include "aminn_rt.h"
#include "vector_file.h"

/* What is judged. The order is that of the words of a result row; the last three are not in it. */
typedef enum output {
    P_STABLE,
    DX_HT,
    K_X,
    GATE,
    P_SLIDE,
    BOUND_95,
    FRICTION_USE,
    STABLE,
    STATUS,
    SAMPLES,
    MODEL,
    N_OUTPUT
} output_t;

/* One number that is not what it must be. */
typedef struct failure {
    output_t output;
    int32_t component; /* in the output, row-major; -1: the output has one number */
    int64_t sample;    /* -1: it is of all samples (a median, their number) */
    double got, want, limit;
    double share; /* the difference over its limit: the larger, the worse; infinite for NaN and for other bits */
} failure_t;

typedef struct results {
    uint32_t n;
    const float *rows; /* n x RESULT_N_OUT */
    const int32_t *statuses;
} results_t;

typedef struct verdict {
    int exact;  /* 1: bits are compared */
    uint32_t n; /* samples */
    uint32_t refused, decisions;
    double largest[STABLE];       /* difference of each output: dx_ht and k_x relative, infinite for NaN */
    double share_largest[STABLE]; /* the same over its limit, */
    double median[STABLE];        /* its median, */
    double dx_median;             /* and the median of the relative difference of dx_ht */
    uint64_t failed[N_OUTPUT];    /* failures of each output */
    uint64_t different_words;     /* of exact comparisons */
    failure_t *failures;
    size_t n_failures, capacity;
} verdict_t;

/* Name of an output, and of one of its components: "dx_ht[3]", "k_x[2][4]". */
extern const char *const output_names[N_OUTPUT];
void component_name(const failure_t *failure, char *text, size_t size);

/* Part of a result file. */
results_t results_of(const vector_header_t *header);

/* What this library predicts for every sample; memory that lives until the program ends. */
results_t predict_all(const aminn_model_t *model, const vector_header_t *vectors);

/*
 * Both judge every number and leave every failure in `verdict`, which they clear first. `on_demand`: the results are of a
 * runtime without AMINN_FLAG_ALWAYS_STAGE2, so dx_ht .. bound_95 are NaN where stable is 0, and must be.
 */
void compare_within(verdict_t *verdict, const aminn_model_t *model, const vector_header_t *vectors, results_t got,
                    int on_demand);
void compare_bits(verdict_t *verdict, results_t want, results_t got);

/* One more failure, of the files as wholes. */
void add_failure(verdict_t *verdict, failure_t failure);

/* The failures by how bad they are, worst first; equally bad ones as they were found. */
void sort_failures(verdict_t *verdict);

#endif
