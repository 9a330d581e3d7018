/* A state that the model knows, predicted: the self-test holds the bits, the line below says what a controller looks at. */
#include <zephyr/sys/printk.h>

#include "aminn_model.h"

static aminn_t ctx; /* the library has no memory of its own */
static aminn_output_t out;

int main(void)
{
    aminn_status_t tested = aminn_init(&ctx, &aminn_model, 0), status = AMINN_E_NULL;
    if (tested == AMINN_OK) {
        tested = aminn_self_test(&ctx);
        status =
            aminn_predict_state(&ctx, &aminn_model.known_answer->state, &out); /* yours: from encoders and sensors */
    }
    printk("aminn_rt %s, model %s: self-test %s, prediction %s, holds %d, notes %u\n", aminn_version(),
           aminn_model.name, aminn_status_name(tested), aminn_status_name(status), (int)out.stable,
           (unsigned)out.notes);
    return 0;
}
