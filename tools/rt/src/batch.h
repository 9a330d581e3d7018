/*
 * Predictions of many rows with a binary model, on several threads: what the Python package aminn_rt calls.
 *
 * C99. Compiled for one hand, as the runtime that it is linked with.
 */
#ifndef AMINN_BATCH_H
#define AMINN_BATCH_H

#include <stddef.h>
#include <stdint.h>

#include "aminn_rt.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A model in memory, and a context as aminn_init() leaves it. It does not change: any number of threads may use it. */
typedef struct aminn_batch aminn_batch_t;

/* The first number of an array, and floats from one row's to the next row's; 0: all rows have the same numbers. */
typedef struct aminn_batch_rows {
    const float *first;
    size_t step;
} aminn_batch_rows_t;

/* Rows of aminn_state_t, or of aminn_input_t where j_x and j_q are not null, field by field; and, where they are not null, of
 * theta, and of the fields of aminn_sensors_t. */
typedef struct aminn_batch_inputs {
    aminn_batch_rows_t q;
    aminn_batch_rows_t x_ht;
    aminn_batch_rows_t w_e;
    aminn_batch_rows_t contacts;
    aminn_batch_rows_t j_x;
    aminn_batch_rows_t j_q;
    aminn_batch_rows_t theta;
    aminn_batch_rows_t friction;
    aminn_batch_rows_t tool_weight;
    aminn_batch_rows_t tendon_tension; /* null of a hand without tendons */
} aminn_batch_inputs_t;

/*
 * Load a copy of a blob. `flags` are those of aminn_init().
 *
 * Returns null where the model is refused, and writes why to *status; AMINN_E_SIZE too where memory is short.
 */
aminn_batch_t *aminn_batch_open(const void *blob, size_t size, uint32_t flags, aminn_status_t *status);

void aminn_batch_close(aminn_batch_t *batch);

/* Smallest and largest value of each number of a state in training, widened: (AMINN_N_STATE) each. */
void aminn_batch_ranges(const aminn_batch_t *batch, float *smallest, float *largest);

/*
 * Predict n rows, each as aminn_predict_state() or aminn_predict() does, so that the number of threads changes no bit. A row's
 * theta is set with aminn_calibration_set(), which says so first where it cannot be; its sensors with aminn_sense(), which
 * refuses all rows of a model that sees none.
 *
 *   threads   at most so many, 1 or more; fewer where there are few rows.
 *   outputs   (n) written.
 *   stages    null, or (n x AMINN_N_STAGE) written: what aminn_debug() shows; left alone after an error.
 *   statuses  (n) written.
 */
void aminn_batch_predict(const aminn_batch_t *batch, const aminn_batch_inputs_t *inputs, size_t n, unsigned threads,
                         aminn_output_t *outputs, aminn_stage_debug_t *stages, aminn_status_t *statuses);

/*
 * The largest admissible load of n rows, each as aminn_admissible_load() finds it. Of `inputs`, j_x and j_q are not used.
 *
 *   directions  (n x AMINN_N_WRENCH)
 *   found       (n) written.
 *   statuses    (n) written.
 */
void aminn_batch_admissible(const aminn_batch_t *batch, const aminn_batch_inputs_t *inputs,
                            const aminn_batch_rows_t *directions, const aminn_load_limits_t *limits, size_t n,
                            unsigned threads, aminn_admissible_t *found, aminn_status_t *statuses);

/* Status of aminn_self_test(). */
aminn_status_t aminn_batch_self_test(const aminn_batch_t *batch);

/* What the library is compiled for, as a model states it: branches, coordinates, joints, gated tendons, soft fingertips,
 * stiffnesses of theta, tendons, whether contacts slide. */
extern const uint32_t aminn_batch_counts[8];

#ifdef __cplusplus
}
#endif

#endif
