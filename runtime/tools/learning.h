/*
 * learning.h - a calibration that goes along with a replay, so that its bits can be compared: of a hand that moves a quarter
 * further than the model predicts. Used by the host's replay program and by the firmware.
 */
#ifndef AMINN_LEARNING_H
#define AMINN_LEARNING_H

#include "vector_file.h"

enum { LEARNED_SAMPLES = 64 }; /* the first ones */

/* Learns from sample i and what was predicted of it; returns a status of aminn_calibrate_push(), AMINN_OK for a sample that is
 * no push. */
static inline aminn_status_t learn_sample(aminn_t *ctx, aminn_calibrator_t *calibrator, uint32_t i,
                                          const aminn_input_t *in, const float dx_ht[AMINN_N_WRENCH], int stable)
{
    aminn_state_t state;
    float dx[AMINN_N_WRENCH];
    int k;
    if (i >= LEARNED_SAMPLES || !stable) {
        return AMINN_OK;
    }
    memcpy(&state, in, sizeof state);
    for (k = 0; k < AMINN_N_WRENCH; ++k) {
        dx[k] = 1.25F * dx_ht[k];
    }
    return aminn_calibrate_push(ctx, calibrator, &state, dx);
}

/* CRC-32 of theta and its covariance, and of the friction of the last grasp, if contacts can slide; little endian. */
static inline uint32_t learned_crc(const aminn_calibrator_t *calibrator)
{
    float theta[AMINN_N_THETA], covariance[AMINN_N_FACTOR * (AMINN_N_FACTOR + 1) / 2];
    uint32_t crc;
    memcpy(theta, calibrator->calibration.theta, sizeof theta);
    memcpy(covariance, calibrator->covariance, sizeof covariance);
    vector_swap(theta, sizeof theta / sizeof *theta);
    vector_swap(covariance, sizeof covariance / sizeof *covariance);
    crc = vector_crc(vector_crc(0, theta, sizeof theta), covariance, sizeof covariance);
#if AMINN_N_SLIDE
    {
        float friction[AMINN_N_COEFFICIENT];
        memcpy(friction, calibrator->friction, sizeof friction);
        vector_swap(friction, AMINN_N_COEFFICIENT);
        crc = vector_crc(crc, friction, sizeof friction);
    }
#endif
    return crc;
}

#endif
