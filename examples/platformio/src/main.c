/* A state that the model knows, predicted. Ends with 0 if the bits are the right ones and the grasp holds. */
#include <stdio.h>

#include "aminn_model.h"

int main(void)
{
    static aminn_t ctx;
    static aminn_output_t out;
    aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
    status = status == AMINN_OK ? aminn_self_test(&ctx) : status;
    status = status == AMINN_OK ? aminn_predict_state(&ctx, &aminn_model.known_answer->state, &out) : status;
    printf("%s: p_stable %.3f, %s\n", aminn_status_name(status), (double)out.p_stable,
           out.stable ? "holds" : "does not hold");
    return status == AMINN_OK && out.stable ? 0 : 1;
}
