/*
 * aminn_batch.h - many predictions on all cores of a host: for planners that try ten thousand loads.
 *
 * C99; beside aminn_rt.h, which has units, frames and meanings. The functions are in a library of their own, aminn_rt_host,
 * which needs POSIX threads: firmware has none of it. No heap either. SPDX-License-Identifier: Apache-2.0
 *
 *     static aminn_output_t outputs[10000];
 *     static aminn_status_t statuses[10000];
 *     const aminn_batch_t batch = aminn_batch_of_loads(&state, loads, 10000); // one grasp, loads (10000 x 6)
 *     size_t bad;
 *
 *     aminn_status_t status = aminn_predict_batch(&ctx, &batch, 0, outputs, NULL, statuses, &bad);
 *     if (status != AMINN_OK) {
 *         printf("row %zu: %s\n", bad, aminn_status_text(status));
 *     }
 *
 * Each row has the bits of a single prediction, however many threads there are, and whatever rows come before it.
 */
#ifndef AMINN_BATCH_H
#define AMINN_BATCH_H

#include <stddef.h>
#include <stdint.h>

#include "aminn_rt.h"

#ifdef __cplusplus
extern "C" {
#endif

/* An array of rows: the first number, and floats from one row's first number to the next row's; 0: all rows have the same
 * numbers. So arrays of numbers and arrays of structs both do. */
typedef struct aminn_rows {
    const float *first;
    size_t step;
} aminn_rows_t;

/* Inputs of n rows from row `begin` on. Row i of everything, outputs too, counts from 0 whatever `begin` is. So a caller with
 * threads of its own gives each of them a copy with other bounds, and asks for one thread. What is not given is null. */
typedef struct aminn_batch {
    size_t begin;
    size_t n;
    /* the state, field by field (aminn_state_t) */
    aminn_rows_t q;        /* (J) */
    aminn_rows_t x_ht;     /* (6) */
    aminn_rows_t w_e;      /* (6) */
    aminn_rows_t contacts; /* (B x 8) */
    /* null, or both (aminn_input_t): rows are predicted as aminn_predict() does, else as aminn_predict_state() does */
    aminn_rows_t j_x; /* (B x 3 x 6) */
    aminn_rows_t j_q; /* (B x 3 x C) */
    /* null, or theta (AMINN_N_THETA) in place of the context's calibration; takes about a fifth of a prediction more where a
     * row's differs from the one before it */
    aminn_rows_t theta;
    /* null, or fields of aminn_sensors_t in place of the context's sensors */
    aminn_rows_t friction;       /* (3) */
    aminn_rows_t tool_weight;    /* (4) */
    aminn_rows_t tendon_tension; /* (1 + T); of a hand without tendons null */
} aminn_batch_t;

/* What aminn_predict_batch() leaves in *bad where no row is bad. */
#define AMINN_NO_ROW SIZE_MAX

/* n states that lie one after another. */
static inline aminn_batch_t aminn_batch_of_states(const aminn_state_t *states, size_t n)
{
    const size_t step = sizeof *states / sizeof(float);
    const aminn_rows_t none = {NULL, 0};
    const aminn_rows_t q = {states->q, step}, x_ht = {states->x_ht, step}, w_e = {states->w_e, step};
    const aminn_rows_t contacts = {states->contacts[0], step};
    const aminn_batch_t batch = {0, n, q, x_ht, w_e, contacts, none, none, none, none, none, none};
    return batch;
}

/* One state and n loads (n x 6) that take the place of its w_e. */
static inline aminn_batch_t aminn_batch_of_loads(const aminn_state_t *state, const float *loads, size_t n)
{
    aminn_batch_t batch = aminn_batch_of_states(state, n);
    batch.q.step = batch.x_ht.step = batch.contacts.step = 0;
    batch.w_e.first = loads;
    batch.w_e.step = AMINN_N_WRENCH;
    return batch;
}

/*
 * Predict the rows of a batch.
 *
 *   ctx       initialised context, read: each thread works on a copy of its own. Its flags, calibration and sensors count for
 *             all rows that bring none of their own. Calls from several threads may share it.
 *   batch     its arrays are read.
 *   threads   at most this many, this one included; fewer where there are few rows, or where the system gives no more. 0: as
 *             many as there are processors for this process.
 *   outputs   outputs[i] is written for each row i: what a single prediction writes.
 *   stages    null; or, of a context with AMINN_FLAG_DEBUG, stages[AMINN_N_STAGE * i] and the next are what aminn_debug() shows
 *             of row i; left alone where that is null.
 *   statuses  statuses[i] is written: what a single prediction returns; before that AMINN_E_NONFINITE or AMINN_E_CALIBRATION for
 *             a bad theta, and AMINN_E_SENSORS, for all rows, where sensors are given to a model that sees none.
 *   bad       null; or written: the first row whose status is not AMINN_OK, or AMINN_NO_ROW.
 *
 * A bad row does not spoil the others. Takes 16 kB of stack on each thread, and lets none live longer than the call.
 *
 * Returns AMINN_OK; the status of the first bad row; or, where *bad is AMINN_NO_ROW and nothing was predicted, AMINN_E_NULL (also
 * for one of j_x and j_q alone) or AMINN_E_NOT_INITIALISED.
 */
aminn_status_t aminn_predict_batch(const aminn_t *ctx, const aminn_batch_t *batch, unsigned threads,
                                   aminn_output_t *outputs, aminn_stage_debug_t *stages, aminn_status_t *statuses,
                                   size_t *bad);

/*
 * Find the largest admissible load of each row, as aminn_admissible_load() does. j_x and j_q of the batch are not used.
 *
 *   directions  (6) per row.
 *   limits      of all rows.
 *   found       found[i] is written.
 *
 * All else, and the returned values, as for aminn_predict_batch(). With bad limits each row is AMINN_E_LIMITS.
 */
aminn_status_t aminn_admissible_batch(const aminn_t *ctx, const aminn_batch_t *batch, aminn_rows_t directions,
                                      const aminn_load_limits_t *limits, unsigned threads, aminn_admissible_t *found,
                                      aminn_status_t *statuses, size_t *bad);

#ifdef __cplusplus
}
#endif

#endif /* AMINN_BATCH_H */
