/* A complete user of the installed library: one grasp, one load, one prediction. See aminn_rt.h. */
#include <stdio.h>

#include "aminn_model.h"

static aminn_t ctx;

/* a tool held between two fingers and the thumb, pushed by 2 N along -z */
static const aminn_state_t state = {
    .q = {0.0F, 0.5F, 0.6F, 0.0F, 0.5F, 0.6F, 0.5F, 0.6F},
    .x_ht = {0.0F, 0.0F, 0.085F, 0.0F, 0.0F, 0.0F},
    .w_e = {0.0F, 0.0F, -2.0F, 0.0F, 0.0F, 0.0F},
    .contacts = {{1.0F, -0.02F, 0.012F, 0.085F, 0.0F, -1.0F, 0.0F, 3.0F},
                 {1.0F, 0.02F, 0.012F, 0.085F, 0.0F, -1.0F, 0.0F, 3.0F},
                 {1.0F, 0.0F, -0.012F, 0.085F, 0.0F, 1.0F, 0.0F, 6.0F}},
};

int main(void)
{
    aminn_output_t out;
    aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
    if (status == AMINN_OK) {
        status = aminn_predict_state(&ctx, &state, &out);
    }
    if (status != AMINN_OK) {
        fprintf(stderr, "%s: %s\n", aminn_status_name(status), aminn_status_text(status));
        return 1;
    }
    printf("aminn_rt %s: p_stable %.4f, %s\n", aminn_version(), (double)out.p_stable,
           out.stable ? "holds" : "does not hold");
    if (out.stable) {
        printf("moves by %.3f %.3f %.3f mm\n", 1e3 * (double)out.dx_ht[0], 1e3 * (double)out.dx_ht[1],
               1e3 * (double)out.dx_ht[2]);
    }
    return 0;
}
