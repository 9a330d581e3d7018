#include "limiter.h"

aminn_status_t limiter_init(limiter_t *limiter, const aminn_model_t *model, limits_t limits)
{
    aminn_status_t status = aminn_init(&limiter->aminn, model, 0);
    limiter->limits = limits;
    limiter->share = 1.0F;
    status = status == AMINN_OK ? aminn_self_test(&limiter->aminn) : status;
    status = status == AMINN_OK ? aminn_calibrator_init(&limiter->calibrator, model, NULL, NULL) : status;
    return status == AMINN_OK ? aminn_calibrate(&limiter->aminn, &limiter->calibrator.calibration) : status;
}

aminn_status_t limiter_learn(limiter_t *limiter, const aminn_state_t *before, const float dx_ht[AMINN_N_WRENCH])
{
    return aminn_calibrate_push(&limiter->aminn, &limiter->calibrator, before, dx_ht);
}

/* the grasp holds, the tool moves little enough, and the model knows such inputs */
static int holds(const limiter_t *limiter)
{
    const float *dx = limiter->out.dx_ht;
    const float limit = limiter->limits.displacement_m;
    return limiter->out.stable != 0 && limiter->out.notes == 0 &&
           dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2] <= limit * limit;
}

aminn_status_t limiter_step(limiter_t *limiter, aminn_state_t *state)
{
    aminn_status_t status;
    int i, good;
    for (i = 0; i < AMINN_N_WRENCH; ++i) {
        state->w_e[i] *= limiter->share;
    }
    status = aminn_predict_state(&limiter->aminn, state, &limiter->out);
    good = status == AMINN_OK && holds(limiter);
    if (good) {
        limiter->share += limiter->limits.step_up;
        limiter->share = limiter->share > 1.0F ? 1.0F : limiter->share;
    } else {
        limiter->share *= limiter->limits.step_down;
        for (i = 0; i < AMINN_N_WRENCH; ++i) {
            state->w_e[i] = 0.0F;
        }
    }
    return status;
}
