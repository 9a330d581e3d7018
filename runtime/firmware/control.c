/*
 * A controller at 100 Hz: wait for the tick, read a frame of sensors and the commanded load, find how much of it is admissible,
 * apply that. Prints what share of the tick it needs, and how much load it lets through.
 */
#include <string.h>

#include MODEL_HEADER
#include "figures.h"
#include "limiter.h"
#include "modes.h"
#include "semihosting.h"
#include "vector_file.h"

enum { TICK_HZ = 100, PERMILLE = 1000, CLOCK_HZ = 25000000 /* of the MPS2 boards */ };
enum { FRAMES = 20 }; /* at most: an emulator waits for a tick instruction by instruction */
/* Instructions that a core of so many MHz has in a tick if each takes one cycle; real cores need more for some. */
enum { REFERENCE_MHZ = 168 };

limiter_t limiter;

typedef struct budget {
    uint32_t ticks, limited, refused, out_of_range, overruns, worst, total;
    float share; /* of each commanded load that is applied; summed */
} budget_t;

static void control_tick(const aminn_input_t *frame, budget_t *b)
{
    aminn_state_t state;
    uint32_t start, spent;
    memcpy(&state, frame, sizeof state);
    while ((SYST_CSR & SYST_COUNTFLAG) == 0) { /* until the tick; a real controller sleeps, or does this in a handler */
    }
    while ((start = SYST_CVR) == 0) { /* the clock counts down from the period */
    }
    b->refused += limiter_step(&limiter, &state) != AMINN_OK;
    spent = start - SYST_CVR;
    b->overruns += (SYST_CSR & SYST_COUNTFLAG) != 0;
    b->limited += limiter.found.scale < 1.0F;
    b->out_of_range += limiter.found.limited_by == AMINN_LIMITED_BY_RANGE;
    b->share += limiter.found.scale;
    b->total += spent;
    b->worst = spent > b->worst ? spent : b->worst;
    ++b->ticks;
}

int run_control(const char *frames)
{
    const aminn_load_limits_t limits = {1e-3F, 0.1F, 1.0F, 0.95F, 1.0F, 1.0F};
    const int file = semihost_open(frames, SEMIHOST_READ);
    vector_header_t header;
    budget_t b = {0, 0, 0, 0, 0, 0, 0, 0.0F};
    aminn_status_t status;
    uint32_t i, rate, worst;
    if (file < 0) {
        return fail(frames, "cannot open");
    }
    if (semihost_read(file, &header, sizeof header) != 0 ||
        vector_header_error(&header, (uint32_t)semihost_length(file) - (uint32_t)sizeof header) != NULL) {
        return fail(frames, "not a whole vector file");
    }
    status = limiter_init(&limiter, &MODEL_SYMBOL, &limits);
    if (status != AMINN_OK) {
        return fail("limiter", aminn_status_name(status));
    }
    ticks_start();
    rate = calibrate();
    SYST_RVR = CLOCK_HZ / TICK_HZ - 1;
    SYST_CVR = 0;
    for (i = 0; i < header.n && i < FRAMES; ++i) {
        aminn_input_t frame;
        float other[AMINN_N_THETA + AMINN_N_SENSOR]; /* not used here */
        if (semihost_read(file, &frame, sizeof frame) != 0 ||
            semihost_read(file, other, (vector_sample(&header) - VECTOR_N_IN) * sizeof *other) != 0) {
            return fail(frames, "cannot read");
        }
        control_tick(&frame, &b);
    }
    semihost_close(file);
    worst = (uint32_t)((uint64_t)b.worst * rate / PERMILLE);
    print_figure("control_ticks", b.ticks);
    print_figure("control_ticks_limited", b.limited);
    print_figure("control_load_permille", b.ticks > 0 ? (uint32_t)((float)PERMILLE * b.share / (float)b.ticks) : 0);
    print_figure("control_load_permille_all_or_nothing", /* of a rule that applies the whole load, or none of it */
                 b.ticks > 0 ? PERMILLE * (b.ticks - b.limited) / b.ticks : 0);
    print_figure("control_refused", b.refused);
    print_figure("control_out_of_range", b.out_of_range);
    print_figure("control_overruns", b.overruns);
    print_figure("control_instructions_mean",
                 b.ticks > 0 ? (uint32_t)((uint64_t)b.total * rate / b.ticks / PERMILLE) : 0);
    print_figure("control_instructions_worst", worst);
    print_figure("control_tick_instructions_at_168_mhz", REFERENCE_MHZ * 1000000u / TICK_HZ);
    print_figure("control_tick_permille_at_168_mhz",
                 (uint32_t)((uint64_t)worst * PERMILLE * TICK_HZ / (REFERENCE_MHZ * 1000000u)));
    return b.overruns == 0 && worst <= REFERENCE_MHZ * 1000000u / TICK_HZ
               ? 0
               : fail("control", "a tick takes longer than its period");
}
