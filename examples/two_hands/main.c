/*
 * Two hands of one kind: the model stands in flash once, each hand has a context. The right hand's springs are a tenth stiffer
 * than described, as `aminn calibrate` would find; the left one is as described. Both hold the same tool under the same load.
 *
 * Ends with 0 if the stiffer hand lets the tool move less.
 */
#include <math.h>
#include <stdio.h>

#include "aminn_model.h"

static const float STIFFER = 0.1F; /* logarithm of the factor */

static struct hand {
    const char *name;
    aminn_t ctx;
    aminn_calibration_t calibration;
    aminn_output_t out;
} left = {.name = "left"}, right = {.name = "right"};

static aminn_status_t start(struct hand *hand, const float theta[AMINN_N_THETA])
{
    aminn_status_t status = aminn_init(&hand->ctx, &aminn_model, 0);
    if (status == AMINN_OK) {
        status = aminn_calibration_set(&hand->calibration, &aminn_model, theta);
    }
    return status == AMINN_OK ? aminn_calibrate(&hand->ctx, &hand->calibration) : status;
}

static double motion_mm(const struct hand *hand)
{
    const float *dx = hand->out.dx_ht;
    return 1e3 * sqrt((double)dx[0] * (double)dx[0] + (double)dx[1] * (double)dx[1] + (double)dx[2] * (double)dx[2]);
}

int main(void)
{
    const aminn_state_t state = aminn_model.known_answer->state; /* yours: from the sensors of each hand */
    float theta[AMINN_N_THETA] = {0};
    struct hand *const hands[] = {&left, &right};
    int i;
    for (i = 0; i < AMINN_N_STIFF; ++i) {
        theta[i] = STIFFER;
    }
    for (i = 0; i < 2; ++i) {
        aminn_status_t status = start(hands[i], i == 0 ? NULL : theta);
        status = status == AMINN_OK ? aminn_predict_state(&hands[i]->ctx, &state, &hands[i]->out) : status;
        if (status != AMINN_OK) {
            fprintf(stderr, "%s: %s\n", hands[i]->name, aminn_status_text(status));
            return 1;
        }
        printf("%s hand: p_stable %.3f, the tool moves by %.4f mm\n", hands[i]->name, (double)hands[i]->out.p_stable,
               motion_mm(hands[i]));
    }
    return motion_mm(&right) < motion_mm(&left) ? 0 : 1;
}
