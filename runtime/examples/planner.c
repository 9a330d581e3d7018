/*
 * A planner's question to a host: of ten thousand loads on one grasp, which does it bear? On all cores, with the bits that the
 * hand's controller would compute. The grasp is the model's known answer; put a measured state in its place.
 *
 * Ends with 0 if every load could be judged, 1 if not.
 */
#include <stdio.h>
#include <string.h>

#include "aminn_batch.h"
#include "aminn_model.h"

enum { LOADS = 10000 };

static float loads[LOADS][AMINN_N_WRENCH];
static aminn_output_t outputs[LOADS];
static aminn_status_t statuses[LOADS];
static aminn_t ctx;

/* Evenly spread numbers of -1 .. 1. */
static float next_number(void)
{
    static uint32_t seed = 1;
    seed = seed * 1664525u + 1013904223u;
    return (float)(seed >> 8) / 8388608.0F - 1.0F;
}

int main(void)
{
    const aminn_state_t grasp = aminn_model.known_answer->state;
    const aminn_batch_t batch = aminn_batch_of_loads(&grasp, loads[0], LOADS);
    size_t bad, i, held = 0, known = 0;
    aminn_status_t status;
    for (i = 0; i < LOADS; ++i) {
        int k;
        for (k = 0; k < AMINN_N_WRENCH; ++k) {
            loads[i][k] = (k < 3 ? 4.0F : 0.1F) * next_number(); /* N, N.m */
        }
    }
    status = aminn_init(&ctx, &aminn_model, 0);
    if (status == AMINN_OK) {
        status = aminn_predict_batch(&ctx, &batch, 0, outputs, NULL, statuses, &bad);
        if (status != AMINN_OK && bad != AMINN_NO_ROW) {
            printf("load %lu: ", (unsigned long)bad);
        }
    }
    if (status != AMINN_OK) {
        printf("%s\n", aminn_status_text(status));
        return 1;
    }
    for (i = 0; i < LOADS; ++i) {
        known += outputs[i].notes == 0;
        held += outputs[i].notes == 0 && outputs[i].stable;
    }
    printf("the grasp holds under %lu of %lu loads that the model knows\n", (unsigned long)held, (unsigned long)known);
    return 0;
}
