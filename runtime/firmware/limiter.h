/*
 * Limits a commanded load to what the grasp is predicted to hold, and learns from what loads did how stiff its hand is. One
 * prediction a tick, all memory the caller's: copy it into a controller and change the rule.
 */
#ifndef LIMITER_H
#define LIMITER_H

#include "aminn_rt.h"

/* What a prediction has to satisfy. */
typedef struct limits {
    float displacement_m; /* largest translation of the tool in the hand that is tolerated, m */
    float step_down;      /* factor on the permitted share after a tick whose prediction does not satisfy, 0 .. 1 */
    float step_up;        /* added to the permitted share after one that does, 0 .. 1 */
} limits_t;

typedef struct limiter {
    aminn_t aminn;
    aminn_calibrator_t calibrator;
    aminn_output_t out;
    limits_t limits;
    float share; /* of the commanded load that is permitted now, 0 .. 1 */
} limiter_t;

/* Prepare it, where it is to stay, and test the library; returns what aminn_init(), aminn_self_test() or
 * aminn_calibrator_init() returns. The full load is permitted at first, and the hand is the one that its description has. */
aminn_status_t limiter_init(limiter_t *limiter, const aminn_model_t *model, limits_t limits);

/*
 * One tick: predict for the permitted share of the commanded load, and adapt the share.
 *
 *   state    sensors; w_e is the commanded load (N, N.m). On return w_e is the load to apply: scaled by a share that was
 *            predicted to hold, else zero.
 *
 * Returns the prediction's status. After an error, and where the input lies outside the training range, nothing is
 * predicted to hold.
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
