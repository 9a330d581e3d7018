/*
 * Limits a commanded load to what the grasp is predicted to bear, and learns from what loads did how stiff its hand is. All
 * memory is the caller's: copy it into a controller and change the limits.
 */
#ifndef LIMITER_H
#define LIMITER_H

#include "aminn_rt.h"

typedef struct limiter {
    aminn_t aminn;
    aminn_calibrator_t calibrator;
    aminn_load_limits_t limits;
    aminn_admissible_t found; /* of the latest step; its scale is the permitted share of the commanded load */
} limiter_t;

/* Prepare it, where it is to stay, and test the library; returns what aminn_init(), aminn_self_test() or
 * aminn_calibrator_init() returns. The hand is the one that its description has. Of the limits max_scale is not used. */
aminn_status_t limiter_init(limiter_t *limiter, const aminn_model_t *model, const aminn_load_limits_t *limits);

/*
 * One tick: find how much of the commanded load is admissible.
 *
 *   state    sensors; w_e is the commanded load (N, N.m). On return w_e is the load to apply: as much of it as is admissible.
 *
 * Returns the status of aminn_admissible_load(). After an error, and where the model does not know such states, w_e is zero.
 * Takes up to AMINN_LOAD_PREDICTIONS predictions.
 */
aminn_status_t limiter_step(limiter_t *limiter, aminn_state_t *state);

/*
 * What a load did, once the tool rests under it: later predictions are for a hand that does so.
 *
 *   before   sensors before the load, and the load that was applied.
 *   dx_ht    measured displacement of the tool in the hand (m, rotation vector), of a grasp that held.
 *
 * Returns what aminn_calibrate_push() returns. Takes the time of about one prediction and a half: not in every tick.
 */
aminn_status_t limiter_learn(limiter_t *limiter, const aminn_state_t *before, const float dx_ht[AMINN_N_WRENCH]);

#endif
