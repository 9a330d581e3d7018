/*
 * learning.h - what goes along with a replay, so that its bits can be compared: a calibration of a hand that moves a quarter
 * further than the model predicts, and the largest admissible loads of the first samples. Used by the host's replay program, by
 * the firmware, and by the WebAssembly module.
 */
#ifndef AMINN_LEARNING_H
#define AMINN_LEARNING_H

#include "vector_file.h"

enum { LEARNED_SAMPLES = 64, LOADED_SAMPLES = 4 }; /* the first ones */

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

/* CRC-32, continued, of the largest admissible load along that of sample i, whose sensors ctx is told; of files without theta. */
static inline uint32_t load_crc(aminn_t *ctx, const vector_header_t *header, uint32_t i, const aminn_input_t *in,
                                uint32_t crc)
{
    static const aminn_load_limits_t limits = {2e-3F, 0.1F, 0.02F, 0.5F, 1.0F, 4.0F};
    float direction[AMINN_N_WRENCH];
    uint32_t words[3];
    aminn_state_t state;
    aminn_admissible_t found;
    if (i >= LOADED_SAMPLES || vector_n_theta(header) != 0) {
        return crc;
    }
    memcpy(&state, in, sizeof state);
    memcpy(direction, state.w_e, sizeof direction);
    memset(state.w_e, 0, sizeof state.w_e);
    aminn_admissible_load(ctx, &state, direction, &limits, &found);
    memcpy(words, &found, sizeof words); /* scale, admissible, limited_by */
    vector_swap(words, sizeof words / sizeof *words);
    return vector_crc(crc, words, sizeof words);
}

/* Both for all samples of a vector file, of which `rows` (n x RESULT_N_OUT) were predicted; continues *loads. ctx and calibrator are
 * initialised; ctx uses no sensors afterwards. */
static inline void learn_rows(aminn_t *ctx, aminn_calibrator_t *calibrator, const vector_header_t *vectors,
                              const float *rows, uint32_t *loads)
{
    const size_t size = vector_sample(vectors), n_sensor = vector_n_sensor(vectors);
    const float *sample = (const float *)(vectors + 1);
    aminn_sensors_t sensors;
    uint32_t i;
    memset(&sensors, 0, sizeof sensors);
    if (n_sensor != 0) {
        aminn_sense(ctx, &sensors); /* of a model that sees none all samples were refused */
    }
    for (i = 0; i < vectors->n; ++i) {
        const float *row = rows + (size_t)i * RESULT_N_OUT; /* p_stable, dx_ht .. stable */
        aminn_input_t in;
        memcpy(&in, sample, sizeof in);
        memcpy(&sensors, sample + size - n_sensor, n_sensor * sizeof *sample);
        *loads = load_crc(ctx, vectors, i, &in, *loads);
        learn_sample(ctx, calibrator, i, &in, row + 1, row[VECTOR_N_OUT] > 0.5F);
        sample += size;
    }
    aminn_sense(ctx, NULL);
}

#endif
