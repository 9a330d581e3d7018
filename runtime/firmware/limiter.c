#include "limiter.h"

#include <string.h>

aminn_status_t limiter_init(limiter_t *limiter, const aminn_model_t *model, const aminn_load_limits_t *limits)
{
    aminn_status_t status = aminn_init(&limiter->aminn, model, 0);
    limiter->limits = *limits;
    limiter->limits.max_scale = 1.0F;
    status = status == AMINN_OK ? aminn_self_test(&limiter->aminn) : status;
    status = status == AMINN_OK ? aminn_calibrator_init(&limiter->calibrator, model, NULL, NULL) : status;
    return status == AMINN_OK ? aminn_calibrate(&limiter->aminn, &limiter->calibrator.calibration) : status;
}

aminn_status_t limiter_learn(limiter_t *limiter, const aminn_state_t *before, const float dx_ht[AMINN_N_WRENCH])
{
    return aminn_calibrate_push(&limiter->aminn, &limiter->calibrator, before, dx_ht);
}

aminn_status_t limiter_step(limiter_t *limiter, aminn_state_t *state)
{
    float commanded[AMINN_N_WRENCH];
    aminn_status_t status;
    int i;
    memcpy(commanded, state->w_e, sizeof commanded);
    memset(state->w_e, 0, sizeof commanded);
    status = aminn_admissible_load(&limiter->aminn, state, commanded, &limiter->limits, &limiter->found);
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        state->w_e[i] = limiter->found.scale > 0.0F ? limiter->found.scale * commanded[i] : 0.0F;
    }
    return status;
}
