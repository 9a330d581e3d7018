/* How well a limiter judges loads whose outcome was measured. */
#ifndef TRIAL_H
#define TRIAL_H

#include "limiter.h"

/* A load, and what came of it. */
typedef struct trial {
    aminn_state_t before;        /* sensors, and the load */
    float held;                  /* 1: the grasp held, 0: it did not */
    float dx_ht[AMINN_N_WRENCH]; /* measured */
} trial_t;

typedef struct verdict {
    uint32_t good;     /* loads that the grasp held, with no more motion than the limiter tolerates */
    uint32_t wrong;    /* let through as a whole, and not good */
    uint32_t needless; /* good, and not let through as a whole */
    uint32_t whole;    /* let through as a whole */
    float share;       /* of each load that is let through; summed */
    uint32_t compared; /* held, and predicted to hold */
    float error;       /* of the motion predicted for these, as a share of the measured one; summed */
} verdict_t;

/* Adds a load to a verdict; length_scale is the model's, `trial` is changed. */
void judge(limiter_t *limiter, float length_scale, trial_t *trial, verdict_t *verdict);

/* Mean of `error`; 0 where nothing could be compared. */
float mean_error(const verdict_t *verdict);

/* Of the same loads: no more let through wrongly, no more wrong verdicts in all, and the motion predicted better. */
int is_better(const verdict_t *verdict, const verdict_t *before);

#endif
