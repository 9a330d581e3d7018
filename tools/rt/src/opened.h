/*
 * A binary model in memory of its own, with a context for it: what the Python package aminn_rt predicts with
 * (aminn_predict_batch() and others take the context).
 *
 * C99. Compiled for one hand, as the runtime that it is linked with.
 */
#ifndef AMINN_OPENED_H
#define AMINN_OPENED_H

#include <stddef.h>
#include <stdint.h>

#include "aminn_rt.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A model in memory, and a context as aminn_init() leaves it. It does not change: any number of threads may use it. */
typedef struct aminn_opened aminn_opened_t;

/*
 * Load a copy of a blob. `flags` are those of aminn_init().
 *
 * Returns null where the model is refused, and writes why to *status; AMINN_E_SIZE too where memory is short.
 */
aminn_opened_t *aminn_open(const void *blob, size_t size, uint32_t flags, aminn_status_t *status);

void aminn_close(aminn_opened_t *opened);

/* The context, as long as the model is open. */
const aminn_t *aminn_opened_context(const aminn_opened_t *opened);

/* Smallest and largest value of each number of a state in training, widened: (AMINN_N_STATE) each. */
void aminn_opened_ranges(const aminn_opened_t *opened, float *smallest, float *largest);

/* Status of aminn_self_test(). */
aminn_status_t aminn_opened_self_test(const aminn_opened_t *opened);

/* What the library is compiled for, as a model states it: branches, coordinates, joints, gated tendons, soft fingertips,
 * stiffnesses of theta, tendons, whether contacts slide. */
extern const uint32_t aminn_hand_counts[8];

#ifdef __cplusplus
}
#endif

#endif
