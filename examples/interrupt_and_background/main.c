/*
 * An interrupt predicts each millisecond for the controller; in the background another context searches for the largest load
 * along the present one. A context is never shared between the two, so neither needs a lock, and the search finds the same
 * bits however often it is interrupted.
 *
 * Ends with 0 if it does, and if the interrupt came.
 */
#include <string.h>

#include "aminn_model.h"

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define SCB_CPACR (*(volatile uint32_t *)0xE000ED88u)
enum { CLOCK_HZ = 25000000, TICK_HZ = 1000, SEARCHES = 20 };

extern uint32_t bss_start[], bss_end[], stack_top[];
void reset(void);
void systick(void);
void fault(void);

static struct { /* the controller's: the interrupt alone uses it */
    aminn_t ctx;
    aminn_output_t out;
} controller;
static volatile uint32_t ticks, held;
static struct { /* the background's */
    aminn_t ctx;
    aminn_admissible_t first, found;
} planner;

/* ---- what the host of the emulator, or a debugger, prints ---- */

static int32_t host(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm("r0") = operation;
    register const void *r1 __asm("r1") = argument;
    __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return (int32_t)r0;
}

static void say(const char *what, uint32_t number)
{
    char digits[11], *digit = digits + sizeof digits - 1;
    *digit = '\0';
    do {
        *--digit = (char)('0' + number % 10u);
        number /= 10u;
    } while (number != 0);
    host(4, what);
    host(4, digit);
    host(4, "\n");
}

static void finish(int status)
{
    const uint32_t arguments[2] = {0x20026u, (uint32_t)status};
    for (;;) {
        host(0x20, arguments);
    }
}

/* ---- interrupt ---- */

void systick(void)
{
    /* yours: from encoders and sensors, in this interrupt or copied whole by one of higher priority */
    const aminn_status_t status =
        aminn_predict_state(&controller.ctx, &aminn_model.known_answer->state, &controller.out);
    ticks = ticks + 1;
    held = held + (status == AMINN_OK && controller.out.stable && controller.out.notes == 0);
}

/* ---- background ---- */

int main(void)
{
    static const aminn_load_limits_t limits = {2e-3F, 0.1F, 0.02F, 0.5F, 1.0F, 4.0F};
    aminn_state_t state = aminn_model.known_answer->state;
    float direction[AMINN_N_WRENCH];
    uint32_t i, different = 0;
    if (aminn_init(&controller.ctx, &aminn_model, 0) != AMINN_OK ||
        aminn_init(&planner.ctx, &aminn_model, 0) != AMINN_OK || aminn_self_test(&planner.ctx) != AMINN_OK) {
        return 1;
    }
    memcpy(direction, state.w_e, sizeof direction);
    memset(state.w_e, 0, sizeof state.w_e);
    for (i = 0; i < SEARCHES; ++i) {
        if (aminn_admissible_load(&planner.ctx, &state, direction, &limits, &planner.found) != AMINN_OK) {
            return 1;
        }
        if (i == 0) { /* the first is undisturbed */
            planner.first = planner.found;
            SYST_RVR = CLOCK_HZ / TICK_HZ - 1;
            SYST_CVR = 0;
            SYST_CSR = 7u; /* on, interrupt, processor clock */
        }
        different += memcmp(&planner.found, &planner.first, sizeof planner.found) != 0;
    }
    SYST_CSR = 0;
    say("ticks: ", ticks);
    say("of these, the grasp holds: ", held);
    say("largest load, permille of the present one: ", (uint32_t)(1000.0F * planner.found.scale));
    say("searches that an interrupt changed: ", different);
    return ticks < SEARCHES / 2 || held != ticks || different != 0;
}

/* ---- start ---- */

void reset(void)
{
    uint32_t *word;
    SCB_CPACR |= 0xFu << 20; /* the FPU; the processor saves its registers where an interrupt uses it */
    __asm volatile("dsb\n isb" ::: "memory");
    for (word = bss_start; word < bss_end; ++word) {
        *word = 0;
    }
    finish(main());
}

void fault(void)
{
    finish(70);
}

__attribute__((section(".vectors"), used)) static const struct {
    const uint32_t *stack;
    void (*handlers[15])(void);
} vectors = {
    stack_top,
    {reset, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, systick}};
