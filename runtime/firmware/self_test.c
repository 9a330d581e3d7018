/*
 * What the self-test says when the FPU is set to other modes than the library needs: the check of the firmware runs it, and
 * a board's own bring-up may.
 */
#include "aminn_rt.h"
#include "figures.h"
#include "modes.h"

enum { FPSCR_ROUND_UP = 1u << 22, FPSCR_ROUND_DOWN = 2u << 22, FPSCR_ROUND_TO_ZERO = 3u << 22, FPSCR_FLUSH = 1u << 24 };

static uint32_t fpscr(void)
{
    uint32_t value = 0;
#ifdef __ARM_FP /* else there is no FPU */
    __asm volatile("vmrs %0, fpscr" : "=r"(value));
#endif
    return value;
}

static void set_fpscr(uint32_t value)
{
#ifdef __ARM_FP
    __asm volatile("vmsr fpscr, %0" : : "r"(value) : "memory");
#else
    (void)value;
#endif
}

int run_self_test(aminn_t *ctx)
{
    static const struct {
        uint32_t bits;
        aminn_status_t expected;
    } modes[] = {
#ifdef __ARM_FP
        {FPSCR_ROUND_UP, AMINN_E_ROUNDING},
        {FPSCR_ROUND_DOWN, AMINN_E_ROUNDING},
        {FPSCR_ROUND_TO_ZERO, AMINN_E_ROUNDING},
        {FPSCR_FLUSH, AMINN_E_FLUSH},
#endif
        {0, AMINN_OK}};
    const uint32_t kept = fpscr();
    uint32_t i, rate, start, ticks;
    ticks_start();
    rate = calibrate();
    start = ticks_now();
    aminn_self_test(ctx);
    ticks = ticks_since(start);
    for (i = 0; i < sizeof modes / sizeof modes[0]; ++i) {
        aminn_status_t status;
        set_fpscr(kept | modes[i].bits);
        status = aminn_self_test(ctx);
        set_fpscr(kept);
        if (status != modes[i].expected) {
            return fail("self-test: a mode of the FPU is not found, but called", aminn_status_name(status));
        }
    }
    print_figure("self_test_modes", i);
    if (rate != 0) {
        print_figure("self_test_instructions", (uint32_t)((uint64_t)ticks * rate / 1000u));
    }
    return 0;
}
